"""Interrupted or killed commands: exit status, one line, and remaining files."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import xarray

from coadjoint import cli
from coadjoint.files.output.output_files import check_target, write_dataset
from core_only import ENVIRONMENT, run_python

pytestmark = pytest.mark.thinned(3)
BODY = """
[system]
name = "rigid_body"
[initial]
x = [1.0, 0.1, 0.5]
[run]
t_span = [0.0, 1.0]
step = 0.1
"""

# Acts after a given piece was written, in any thread.
AT_PIECE = """
import os, signal, sys
from contextlib import contextmanager
from coadjoint.files.output import atomic_output as unfinished
original, pieces = unfinished.PendingOutput.writing, 0
@contextmanager
def writing(self):
    global pieces
    pieces += 1
    with original(self):
        yield
    if pieces == {piece}:
        {act}
unfinished.PendingOutput.writing = writing
"""
AT_IMPORT = """
import os, signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            {act}
sys.meta_path.insert(0, Finder())
"""
RUN = """
from coadjoint.cli import run
sys.argv = ["coadjoint", "run", "body.toml", "--out", {target!r}]
run()
"""
KILL = "os.kill(os.getpid(), signal.{name})"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "body.toml").write_text(BODY)
    return tmp_path


def old_result(target):
    write_dataset(xarray.Dataset({"old": ("time", [1.0])}), target)


def is_old(target):
    with xarray.open_dataset(target, engine={".nc": "h5netcdf", ".zarr": "zarr"}[Path(target).suffix]) as found:
        return list(found) == ["old"]


@pytest.mark.long
@pytest.mark.parametrize("target", ["run.nc", "run.zarr"])
@pytest.mark.parametrize(
    ("name", "status", "message"), [("SIGINT", 130, "interrupted"), ("SIGTERM", 143, "terminated")], ids=["int", "term"]
)
def test_interrupt_while_writing_a_result(folder, target, name, status, message):
    old_result(target)
    done = run_python(AT_PIECE.format(piece=3, act=KILL.format(name=name)) + RUN.format(target=target))
    assert (done.returncode, done.stdout, done.stderr) == (status, "", f"coadjoint: {message}\n")
    assert sorted(os.listdir(folder)) == ["body.toml", target]
    assert is_old(target)


@pytest.mark.parametrize("name", ["click", "xarray", "coadjoint.runs.integrate"])
def test_interrupt_while_loading_modules(folder, name):
    done = run_python(AT_IMPORT.format(name=name, act=KILL.format(name="SIGINT")) + RUN.format(target="run.nc"))
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "coadjoint: interrupted\n")
    assert os.listdir(folder) == ["body.toml"]


def test_interrupt_where_exceptions_are_dropped(folder):
    # Python drops exceptions raised while an object is deleted.
    act = f"type('Deleted', (), {{'__del__': lambda self: {KILL.format(name='SIGINT')}}})()"
    done = run_python(AT_IMPORT.format(name="xarray", act=act) + RUN.format(target="run.nc"))
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "coadjoint: interrupted\n")


@pytest.mark.long
def test_late_interrupt_is_ignored(folder):
    late = "import atexit\natexit.register(lambda: " + KILL.format(name="SIGINT") + ")\nimport os, signal, sys\n"
    done = run_python(late + RUN.format(target="run.nc"))
    assert (done.returncode, done.stderr) == (0, "")
    assert sorted(os.listdir(folder)) == ["body.toml", "run.nc"]


@pytest.mark.long
@pytest.mark.parametrize("target", ["run.nc", "run.zarr"])
def test_next_run_removes_leftovers_of_its_target(folder, target):
    done = run_python(AT_PIECE.format(piece=3, act=KILL.format(name="SIGKILL")) + RUN.format(target=target))
    assert done.returncode == -signal.SIGKILL
    (left,) = (name for name in os.listdir(folder) if name != "body.toml")
    assert left.startswith(f".{target}-")
    other = {"run.nc": "run.zarr", "run.zarr": "run.nc"}[target]
    assert cli.main(["run", "body.toml", "--quiet", "--out", other]) == 0
    assert sorted(os.listdir(folder)) == sorted([left, "body.toml", other])
    assert cli.main(["run", "body.toml", "--quiet", "--out", target]) == 0
    assert sorted(os.listdir(folder)) == ["body.toml", "run.nc", "run.zarr"]


@pytest.mark.long
def test_files_of_a_running_command_are_not_removed(folder):
    wait = "print('waiting', flush=True) or sys.stdin.readline()"
    code = AT_PIECE.format(piece=3, act=wait) + RUN.format(target="run.zarr")
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdin=-1, stdout=-1, stderr=-1, text=True, env=ENVIRONMENT) as other:
        assert other.stdout.readline() == "waiting\n"
        assert cli.main(["run", "body.toml", "--quiet", "--out", "run.zarr"]) == 0
        assert len(os.listdir(folder)) == 3
        _, complaint = other.communicate("go on\n", timeout=120)
    assert (other.returncode, complaint) == (0, "")
    assert sorted(os.listdir(folder)) == ["body.toml", "run.zarr"]


@pytest.mark.long
def test_replaced_store_is_restored_after_a_kill(folder):
    old_result("run.zarr")
    act = "\n".join(
        [
            "import os, signal, sys, coadjoint.files.output.atomic_output",
            "replace = os.replace",
            "def killed(source, target):",
            "    replace(source, target)",
            f"    {KILL.format(name='SIGKILL')}",
            "os.replace = killed",
        ]
    )
    assert run_python(act + RUN.format(target="run.zarr")).returncode == -signal.SIGKILL
    assert not Path("run.zarr").exists()
    check_target("run.zarr")
    assert is_old("run.zarr")
    assert sorted(os.listdir(folder)) == ["body.toml", "run.zarr"]


@pytest.mark.long
@pytest.mark.parametrize("target", ["run.nc", "run.zarr"])
@pytest.mark.parametrize("dropped", [False, True])
def test_interrupt_with_the_default_handler(folder, target, dropped):
    # The default handler raises in the main thread, which waits for the writing one; in a deleted object it is dropped.
    old_result(target)
    act = KILL.format(name="SIGINT")
    code = AT_PIECE.format(piece=3, act=f"type('D', (), {{'__del__': lambda self: {act}}})()" if dropped else act)
    code += f"from coadjoint.cli import main\nsys.exit(main(['run', 'body.toml', '--out', {target!r}]))"
    done = run_python(code)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "coadjoint: interrupted\n")
    assert sorted(os.listdir(folder)) == ["body.toml", target]
    assert is_old(target)
