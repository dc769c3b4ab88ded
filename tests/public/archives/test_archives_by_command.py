"""Archives of the command: results that the file declares, signals at any write, full disks, sweeps on workers."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray

import coadjoint as co
from command import command
from core_only import ENVIRONMENT, run_python
from hostile_archives import edit_attributes
from long import long_beyond
from same_runs import check_same

RUN = """
[system]
name = "rigid_body"
parameters = { inertia = [1.0, 2.0, 2.5] }
[initial]
x = [1.0, 0.2, 0.1]
[run]
t_span = [0.0, 0.25]
step = 0.125
save_every = 16
[output]
archive = "run.zarr"
"""
DECLARED = 'file = "run.nc"\nfigure = "run.png"\nmovie = "run.gif"\n'


@pytest.fixture
def begun(tmp_path, monkeypatch, capsys):
    """Begin the run of a file, and stop it after 10 of 32 steps."""
    monkeypatch.chdir(tmp_path)

    def begin(output):
        (tmp_path / "run.toml").write_text(RUN)
        assert command(capsys, "run", "run.toml").status == 0
        edit_attributes(tmp_path / "run.zarr", configuration=RUN + output)
        assert co.resume("run.zarr", 4.0, until=10).attributes["configuration"] == RUN + output
        (tmp_path / "run.toml").unlink()
        return tmp_path

    return begin


def test_declared_results_are_written(begun, capsys):
    folder = begun(DECLARED)
    done = command(capsys, "resume", "run.zarr")
    assert done.status == 0
    assert {path.name for path in folder.iterdir()} == {"run.zarr", "run.nc", "run.png", "run.gif"}
    written = [line for line in done.out.splitlines() if line.startswith("written: ")]
    assert written == [f"written: run.{suffix}" for suffix in ("zarr", "nc", "png", "gif")]
    found = co.load("run.nc")
    whole = co.integrate(co.systems.rigid_body((1.0, 2.0, 2.5)), (1.0, 0.2, 0.1), (0, 4), 0.125, save_every=16)
    check_same(found, whole)
    assert "inertia" in found.attributes["configuration"]


def test_options_take_precedence(begun, capsys):
    folder = begun(DECLARED.rpartition("movie")[0])
    options = ["--out", "other.zarr", "--figure", "other.pdf"]
    assert command(capsys, "resume", "run.zarr", "--t-end", "6", "--quiet", *options).status == 0
    assert {path.name for path in folder.iterdir()} == {"run.zarr", "other.zarr", "other.pdf"}
    assert co.load("other.zarr").t[-1] == 6.0


def test_finished_runs_write_their_results_too(begun, capsys):
    folder = begun("")
    assert command(capsys, "resume", "run.zarr").status == 0
    assert {path.name for path in folder.iterdir()} == {"run.zarr"}, "nothing is declared"
    assert command(capsys, "resume", "run.zarr", "--out", "late.nc").status == 0
    assert len(co.load("late.nc").t) == 3


def test_unwritable_results_are_refused_before_the_run(begun, capsys):
    begun('file = "missing/run.nc"\n')
    done = command(capsys, "resume", "run.zarr")
    assert done.status == 2 and "output.file: missing/run.nc" in done.err
    assert co.open_archive("run.zarr").reached == 10
    assert command(capsys, "resume", "run.zarr", "--out", "run.csv").status == 2
    assert command(capsys, "resume", "run.zarr", "--out", "run.nc", "--quiet").status == 0


@pytest.mark.parametrize(
    ("declared", "option"),
    [
        ('file = "{above}/run.nc"', "--out"),
        ('figure = "../run.png"', "--figure"),
        ('movie = "linked/a.gif"', "--movie"),
    ],
)
def test_results_outside_of_the_folder_are_refused(begun, tmp_path_factory, capsys, declared, option):
    """An archive may come from others, who choose what it declares."""
    above = tmp_path_factory.mktemp("above")
    folder = begun(declared.format(above=above) + "\n")
    (folder / "linked").symlink_to(above)
    done = command(capsys, "resume", "run.zarr")
    assert done.status == 2 and f"is outside of the current folder; give {option}" in done.err
    assert not list(above.iterdir()) and co.open_archive("run.zarr").reached == 10
    if option != "--movie":
        own = {"--out": "own.nc", "--figure": "own.png"}[option]
        assert command(capsys, "resume", "run.zarr", "--quiet", option, own).status == 0
        assert (folder / own).exists()


TOP = """
[system]
name = "heavy_top"
[initial]
x = [1.0, 0.1, 0.5, 0.25, 0.5, 1.0]
attitude = "coadjoint"
[method]
name = "GaussLegendre"
[run]
t_span = [0.0, {end}]
step = 0.0625
"""
END = 4096.0
# A signal, or a full disk, at one of the written files.
AT_WRITE = """
import os, signal, sys
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored where the tests run without a terminal
original, writes = os.replace, 0
def replace(source, target, **folders):
    global writes
    writes += 1
    if writes == {write} and {name!r}:
        os.kill(os.getpid(), getattr(signal, {name!r}))
    if writes >= {write} and not {name!r}:
        raise OSError(28, "No space left on device")
    original(source, target, **folders)
os.replace = replace
import runpy
sys.argv = ["coadjoint", *{arguments!r}]
runpy.run_module("coadjoint", run_name="__main__")
"""
REASONS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}
FIRST = ["run", "top.toml", "--archive", "run.zarr"]
LATER = ["resume", "run.zarr", "--t-end", str(END)]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "top.toml").write_text(TOP.format(end=32.0))
    return tmp_path


def child(arguments, write, name=""):
    return run_python(AT_WRITE.format(arguments=arguments, write=write, name=name))


def check_stopped(done, name, what):
    """Check exit status and message of an interrupted command; return the step that the archive has reached."""
    number, there = getattr(signal, name), Path("run.zarr").exists()
    reached = co.open_archive("run.zarr").reached if there else None
    line = ""
    if name in REASONS:
        line = f"coadjoint: {REASONS[name]}\n"
        if there:
            line = f"{what}: {REASONS[name]}; run.zarr holds the run up to step {reached}: coadjoint resume run.zarr "
            line += "continues it\n"
    status = -number if name == "SIGKILL" else 128 + number
    assert (done.returncode, done.stdout, done.stderr) == (status, "", line)
    return reached


@pytest.mark.parametrize(
    ("write", "name", "again", "then"),
    long_beyond(
        1,
        [
            # The pieces of the resumed run end with writes 28, 43, 58 and so on.
            (20, "SIGKILL", 60, "SIGINT"),
            (4, "SIGINT", 61, "SIGTERM"),
            (38, "SIGTERM", 70, "SIGKILL"),
            (10, "SIGHUP", 55, "SIGHUP"),
        ],
    ),
)
def test_signal_at_any_write(folder, capsys, write, name, again, then):
    """While the archive is created, and in a commit of the resuming command."""
    first = check_stopped(child(FIRST, write, name), name, "top.toml")
    if first is None:
        # Only a killed command leaves a hidden folder, which the next run removes.
        assert len(list(folder.glob(".run.zarr-*"))) == (name == "SIGKILL")
        assert command(capsys, *FIRST, "--quiet").status == 0
        assert sorted(os.listdir(folder)) == ["run.zarr", "top.toml"]
    reached = check_stopped(child(LATER, again, then), then, "run.zarr")
    assert 0 < reached < END / 0.0625
    done = command(capsys, "resume", "run.zarr")
    assert done.status == 0 and done.out.endswith("written: run.zarr\n")
    (folder / "top.toml").write_text(TOP.format(end=END))
    assert command(capsys, "run", "top.toml", "--out", "alone.nc", "--quiet").status == 0
    found, alone = co.open_archive("run.zarr").to_xarray().load(), xarray.load_dataset("alone.nc", engine="h5netcdf")
    alone = alone.drop_vars(["angular_velocity", "angular_momentum"])  # of states, which archives do not load
    assert found.sizes["time"] == END / 0.0625 + 1 and set(alone.variables) == set(found.variables)
    for label, variable in alone.variables.items():
        assert np.array_equal(found[label].values, variable.values), label


@pytest.mark.long
def test_full_disk_is_one_line(folder):
    """Status 1 during the run, and 2 before its first step."""
    full = "No space left on device"
    for write, arguments, status, said in (
        (4, FIRST, 2, ("cannot be created", "give another")),
        (10**6, FIRST, 0, ()),
        (4, LATER, 2, ("cannot be written", "unchanged")),
        (60, LATER, 1, ("could not be written", "up to step")),
    ):
        done = child(arguments, write)
        assert done.returncode == status, done.stderr
        assert all(text in done.stderr for text in said) and (full in done.stderr) == bool(said)
        assert done.stderr.count("\n") == bool(said)
        assert write != 4 or arguments is LATER or os.listdir(folder) == ["top.toml"]


STATES = [[1.0, 0.1 * k, 0.5, 0.25, 0.5, 1.0] for k in range(12)]
MANY = (
    TOP.format(end=160000.0).replace("GaussLegendre", "Splitting").replace('attitude = "coadjoint"', "")
    .replace("x = [1.0, 0.1, 0.5, 0.25, 0.5, 1.0]", f"x = {STATES}")
    + "save_every = 100\n"
)  # fmt: skip


@pytest.mark.long
def test_interrupted_ensemble_with_workers(folder, capsys):
    Path("many.toml").write_text(MANY + 'workers = 1\n[output]\narchive = "run.zarr"\n')
    run = [sys.executable, "-m", "coadjoint", "run", "many.toml"]
    process = subprocess.Popen(run, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT)
    end = time.monotonic() + 300
    while not list(Path("run.zarr/.coadjoint").glob("block-*.lock")):
        assert time.monotonic() < end, "timeout"
        time.sleep(0.02)
    process.send_signal(signal.SIGTERM)
    message = process.communicate(timeout=300)[1]
    line = r"many.toml: terminated; run.zarr holds \d+ of 12 members: coadjoint resume run.zarr continues it"
    # Python may warn about the semaphore of a killed worker.
    assert process.returncode == 143 and re.fullmatch(line, message.splitlines()[0]), message
    assert not co.open_archive("run.zarr").finished
    assert command(capsys, "resume", "run.zarr", "--quiet").status == 0
    Path("alone.toml").write_text(MANY)
    assert command(capsys, "run", "alone.toml", "--out", "alone.nc", "--quiet").status == 0
    assert np.array_equal(co.open_archive("run.zarr").x, co.load("alone.nc").x)


SWEEP = """
[system]
name = "rigid_body"
parameters = { inertia = [1.0, 2.0, 2.5] }
[initial]
x = [1.0, 0.1, 0.5]
[sweep.over]
"system.parameters.inertia[2]" = { linear = [2.25, 3.0], count = 4 }
"initial.x[1]" = [0.25, -0.5]
[run]
t_span = [0.0, 1.0]
step = 0.125
"""
EVENTS = '[events.flip]\ng = "x2"\n[events.far]\ng = "x1^2 - 0.49"\ndirection = -1\nterminal = true\n'
ON_WORKERS = SWEEP + "workers = 2\n" + EVENTS + '[output]\narchive = "many.zarr"\n'


def test_command_stores_events_and_resumes_them(tmp_path, monkeypatch, capsys):
    """The run of a file is stopped after 10 of 32 steps; a terminal event ends it."""
    monkeypatch.chdir(tmp_path)
    ending = EVENTS.replace("0.49", "1.005").replace("-1", "1")
    Path("alone.toml").write_text(RUN.replace("0.25]", "4.0]").partition("[output]")[0] + ending)
    Path("run.toml").write_text(RUN + ending)
    assert command(capsys, "run", "alone.toml", "--out", "alone.nc", "--quiet").status == 0
    assert command(capsys, "run", "run.toml", "--quiet").status == 0
    assert co.resume("run.zarr", 4.0, until=10).reached == 10
    assert command(capsys, "resume", "run.zarr", "--out", "run.nc", "--quiet").status == 0
    alone = co.load("alone.nc")
    assert alone.t[-1] == alone.events["far"].t[0] < 4.0
    for found in (co.open_archive("run.zarr"), co.load("run.nc")):
        check_same(found, alone, work=False)


@pytest.mark.long
def test_command_runs_a_sweep_on_workers(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("run.toml").write_text(ON_WORKERS)
    Path("alone.toml").write_text(SWEEP + EVENTS)
    done = command(capsys, "run", "run.toml")
    assert done.status == 0 and "written: many.zarr" in done.out
    assert command(capsys, "run", "alone.toml", "--out", "alone.nc", "--quiet").status == 0
    alone, found = co.load("alone.nc"), co.open_archive("many.zarr")
    check_same(found, alone)
    stored = found.to_xarray()
    np.testing.assert_array_equal(stored["swept_inertia_2"], alone.to_xarray()["swept_inertia_2"])
    assert "swept_x_1" in stored.coords and stored.attrs["configuration"] == ON_WORKERS
    (tmp_path / "many.zarr" / "x" / "c.0.1.0").unlink()
    assert command(capsys, "resume", "many.zarr", "--workers", "1", "--quiet").status == 0
    check_same(co.open_archive("many.zarr"), alone)
