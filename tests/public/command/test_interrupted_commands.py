"""Interrupted or killed commands: exit status, one line, the solution so far, and the files that are left."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest
import xarray

import coadjoint as co
from command import command
from configuration_files import BODY, changed
from core_only import run_python
from long import long_beyond

RUN = changed(BODY, ("[0.0, 1.0]", "[0.0, 10.0]"), ("step = 0.1", "step = 0.125"))
SIGNALS = [("SIGTERM", 143, "terminated"), ("SIGINT", 130, "interrupted"), ("SIGHUP", 129, "hung up")]
COMMAND = """
import os, signal, sys
for number in (signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_DFL)  # ignored where the tests run without a terminal
{before}
from importlib.metadata import entry_points
(script,) = entry_points(group="console_scripts", name="coadjoint")
sys.argv = ["coadjoint", *{arguments!r}]
sys.exit(script.load()())
"""
# Euler's method in slow motion, in Python, which sends a signal in the step at a time.
SIGNALLING = """
import dataclasses
import coadjoint as co
@dataclasses.dataclass(frozen=True)
class Signalling(co.methods.StepMethod):
    number: int
    at: float
    order, explicit, symmetric, compiles = 1, True, False, False
    def properties(self, system):
        return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")
    def step(self, system, x, t, h):
        if t == self.at and {armed}:
            os.kill(os.getpid(), self.number)
        return x + h / 64 * system.vector_field(x, t)
co.methods.register(Signalling)
"""
# Acts at the first event of a kind, such as "open" or "os.rename", of a temporary file or folder of the output.
AT_EVENT = """
acted = []
def hook(event, given):
    if event == {event!r} and not acted and any("/.run." in os.path.join("/", str(one)) for one in given[:2]):
        acted.append(event)
        {act}
sys.addaudithook(hook)
"""
WHOLE = """
body = co.systems.rigid_body()
co.integrate(body, [1.0, 0.1, 0.5], (0, 4000), 0.125, Signalling(0, -1.0)).to_xarray().to_netcdf("whole.nc")
"""
AT_IMPORT = """
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            {act}
sys.meta_path.insert(0, Finder())
"""
KILL = "os.kill(os.getpid(), signal.{name})"
DROPPED = "type('Deleted', (), {{'__del__': lambda self: {act}}})()"  # exceptions in deletions are dropped


EVENT, WRITING = "os.rename", "os.scandir"
"""Events when the output replaces the target, and while a store is written."""


def child(before, *arguments):
    """Return exit status, output and errors of the command in a process that runs some code before."""
    done = run_python(COMMAND.format(before=before, arguments=arguments))
    return done.returncode, done.stdout, done.stderr


def run_to(target):
    return "run", "body.toml", "--quiet", "--out", target


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "body.toml").write_text(RUN)
    return tmp_path


def signalling(name, at=5.0):
    return RUN + f'[method]\nname = "Signalling"\nnumber = {int(getattr(signal, name))}\nat = {at}\n'


def states(count):
    """Return the states of this method."""
    body, x = co.systems.rigid_body(), np.array([1.0, 0.1, 0.5])
    found = [x]
    for _ in range(count - 1):
        x = x + 0.125 / 64 * body.vector_field(x, 0.0)
        found.append(x)
    return np.array(found)


@pytest.mark.sensitive
@pytest.mark.parametrize(("name", "status", "message"), long_beyond(1, SIGNALS))
def test_interrupted_command_writes_the_partial_run(folder, name, status, message):
    (folder / "body.toml").write_text(signalling(name))
    line = f"body.toml: {message}; the solution so far is in run.nc, marked as incomplete\n"
    found = child(SIGNALLING.format(armed=True), "run", "body.toml", "--out", "run.nc")
    assert (found[0], found[1]) == (status, "") and found[2].splitlines(keepends=True)[-1] == line
    assert sorted(os.listdir(folder)) == ["body.toml", "run.nc"]
    with xarray.open_dataset("run.nc", engine="h5netcdf") as found:
        assert found.attrs["run_incomplete"] == 1 and found.attrs["incomplete_reason"] == message
        assert found.attrs["incomplete_time"] == found["time"][-1] == 5.0 and len(found["time"]) == 41
        np.testing.assert_allclose(found["x"], states(41), rtol=0, atol=1e-14)


@pytest.mark.sensitive
@pytest.mark.parametrize(("name", "status", "message"), long_beyond(1, SIGNALS[:2]))
def test_interrupted_archive_is_resumed(folder, name, status, message):
    (folder / "body.toml").write_text(signalling(name).replace("10.0]", "4000.0]").replace("at = 5.0", "at = 3000.0"))
    found = child(SIGNALLING.format(armed=True), "run", "body.toml", "--archive", "run.zarr")
    told = [line for line in found[2].splitlines() if line.startswith("body.toml: ")]
    (reached,) = (int(word) for word in told[0].replace(":", " ").split() if word.isdigit())
    continued = f"run.zarr holds the run up to step {reached}: coadjoint resume run.zarr continues it"
    assert (found[0], found[1], told) == (status, "", [f"body.toml: {message}; {continued}"])
    assert sorted(os.listdir(folder)) == ["body.toml", "run.zarr"] and 0 < reached <= 24000
    found = child(SIGNALLING.format(armed=False) + WHOLE, "resume", "run.zarr")
    assert found[0] == 0 and found[1].endswith("written: run.zarr\n")
    with xarray.open_dataset("whole.nc", engine="h5netcdf") as whole, xarray.open_zarr("run.zarr") as found:
        np.testing.assert_array_equal(found["x"], whole["x"])


def old_result(capsys, target):
    """Write the result of an earlier run, with 41 points."""
    Path("old.toml").write_text(RUN.replace("10.0]", "5.0]"))
    assert command(capsys, "run", "old.toml", "--quiet", "--out", target).status == 0
    os.remove("old.toml")


def points(target):
    return len(co.load(target).t)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("target", ["run.nc", "run.zarr"])
@pytest.mark.parametrize(("name", "status", "message"), SIGNALS[:2])
@pytest.mark.parametrize("dropped", [False, True])
def test_interrupt_while_a_result_is_replaced(folder, capsys, target, name, status, message, dropped):
    """The old result stays, or the new one is there; nothing else is left."""
    old_result(capsys, target)
    act = KILL.format(name=name)
    found = child(AT_EVENT.format(event=EVENT, act=DROPPED.format(act=act) if dropped else act), *run_to(target))
    assert found == (status, "", f"coadjoint: {message}\n")
    assert sorted(os.listdir(folder)) == ["body.toml", target]
    assert points(target) in (41, 81)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", ["click", "xarray", "coadjoint"])
@pytest.mark.parametrize("dropped", [False, True])
def test_interrupt_while_loading_modules(folder, name, dropped):
    act = KILL.format(name="SIGINT")
    before = AT_IMPORT.format(name=name, act=DROPPED.format(act=act) if dropped else act)
    if name == "coadjoint":
        before = "import coadjoint\n" + before.replace("name == 'coadjoint'", "name.startswith('coadjoint.runs.')")
    assert child(before, *run_to("run.nc")) == (130, "", "coadjoint: interrupted\n")
    assert os.listdir(folder) == ["body.toml"]


@pytest.mark.long
def test_late_interrupt_is_ignored(folder):
    found = child("import atexit\natexit.register(lambda: " + KILL.format(name="SIGINT") + ")", *run_to("run.nc"))
    assert (found[0], found[2]) == (0, "")
    assert sorted(os.listdir(folder)) == ["body.toml", "run.nc"]


@pytest.mark.long
def test_replaced_store_is_restored_after_a_kill(folder, capsys):
    """By the next command that writes to it, also if that is interrupted."""
    old_result(capsys, "run.zarr")
    killed = f"""
replace = os.replace
def act(source, target, **given):
    replace(source, target, **given)
    {KILL.format(name="SIGKILL")}
os.replace = act
"""
    assert child(killed, *run_to("run.zarr"))[0] == -signal.SIGKILL
    assert not Path("run.zarr").exists()
    assert child(AT_EVENT.format(event=WRITING, act=KILL.format(name="SIGINT")), *run_to("run.zarr"))[0] == 130
    assert points("run.zarr") == 41
    assert sorted(os.listdir(folder)) == ["body.toml", "run.zarr"]
