"""A command that is told to stop, or killed: its exit status, one line, and what it leaves behind."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import xarray

import coadjoint
from coadjoint import cli
from coadjoint.files.output.output_files import check_target, write_dataset
from test_cli import BODY

pytestmark = pytest.mark.thinned(3)

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(coadjoint.__file__).parents[1])}
# Acts when the piece of a number is about to be written, from whatever thread writes.
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


def child(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=ENVIRONMENT, timeout=120)


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
def test_stopped_while_a_result_is_written(folder, target, name, status, message):
    old_result(target)
    done = child(AT_PIECE.format(piece=3, act=KILL.format(name=name)) + RUN.format(target=target))
    assert (done.returncode, done.stdout, done.stderr) == (status, "", f"coadjoint: {message}\n")
    assert sorted(os.listdir(folder)) == ["body.toml", target]
    assert is_old(target)


@pytest.mark.parametrize("name", ["click", "xarray", "coadjoint.runs.integrate"])
def test_interrupted_while_modules_are_loaded(folder, name):
    done = child(AT_IMPORT.format(name=name, act=KILL.format(name="SIGINT")) + RUN.format(target="run.nc"))
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "coadjoint: interrupted\n")
    assert os.listdir(folder) == ["body.toml"]


def test_interrupted_where_python_drops_exceptions(folder):
    # As in a callback of a weak reference, an exception that is raised while an object is deleted goes nowhere.
    act = f"type('Deleted', (), {{'__del__': lambda self: {KILL.format(name='SIGINT')}}})()"
    done = child(AT_IMPORT.format(name="xarray", act=act) + RUN.format(target="run.nc"))
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "coadjoint: interrupted\n")


def test_interrupt_that_comes_too_late_changes_nothing(folder):
    late = "import atexit\natexit.register(lambda: " + KILL.format(name="SIGINT") + ")\nimport os, signal, sys\n"
    done = child(late + RUN.format(target="run.nc"))
    assert (done.returncode, done.stderr) == (0, "")
    assert sorted(os.listdir(folder)) == ["body.toml", "run.nc"]


@pytest.mark.long
def test_signals_that_were_ignored_stay_so(folder):
    ignored = "import os, signal, sys\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
    done = child(
        ignored + AT_IMPORT.format(name="xarray", act=KILL.format(name="SIGINT")) + RUN.format(target="run.nc")
    )
    assert done.returncode == 0
    assert sorted(os.listdir(folder)) == ["body.toml", "run.nc"]


@pytest.mark.long
@pytest.mark.parametrize("target", ["run.nc", "run.zarr"])
def test_what_a_killed_run_leaves_is_removed_by_the_next_to_the_same_target(folder, target):
    done = child(AT_PIECE.format(piece=3, act=KILL.format(name="SIGKILL")) + RUN.format(target=target))
    assert done.returncode == -signal.SIGKILL
    (left,) = (name for name in os.listdir(folder) if name != "body.toml")
    assert left.startswith(f".{target}-")
    other = {"run.nc": "run.zarr", "run.zarr": "run.nc"}[target]
    assert cli.main(["run", "body.toml", "--quiet", "--out", other]) == 0
    assert sorted(os.listdir(folder)) == sorted([left, "body.toml", other])
    assert cli.main(["run", "body.toml", "--quiet", "--out", target]) == 0
    assert sorted(os.listdir(folder)) == ["body.toml", "run.nc", "run.zarr"]


@pytest.mark.long
def test_what_a_run_that_lives_is_writing_is_not_removed(folder):
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
def test_a_store_that_had_stepped_aside_for_a_killed_run_comes_back(folder):
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
    assert child(act + RUN.format(target="run.zarr")).returncode == -signal.SIGKILL
    assert not Path("run.zarr").exists()
    check_target("run.zarr")
    assert is_old("run.zarr")
    assert sorted(os.listdir(folder)) == ["body.toml", "run.zarr"]


@pytest.mark.long
def test_what_is_left_of_another_target_with_a_like_name_stays(folder):
    one, other = ("a" * 60 + end for end in ("1.nc", "2.nc"))
    child(AT_PIECE.format(piece=3, act=KILL.format(name="SIGKILL")) + RUN.format(target=one))
    left = sorted(os.listdir(folder))
    check_target(other)
    assert sorted(os.listdir(folder)) == left != ["body.toml"]
    check_target(one)
    assert os.listdir(folder) == ["body.toml"]


@pytest.mark.long
@pytest.mark.parametrize("target", ["run.nc", "run.zarr"])
@pytest.mark.parametrize("dropped", [False, True])
def test_interrupted_in_a_program_that_hears_interrupts_itself(folder, target, dropped):
    # Python's own handler raises an exception in the main thread, which waits for the one that writes. There it would
    # be dropped, raised while an object is deleted.
    old_result(target)
    act = KILL.format(name="SIGINT")
    code = AT_PIECE.format(piece=3, act=f"type('D', (), {{'__del__': lambda self: {act}}})()" if dropped else act)
    code += f"from coadjoint.cli import main\nsys.exit(main(['run', 'body.toml', '--out', {target!r}]))"
    done = child(code)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "coadjoint: interrupted\n")
    assert sorted(os.listdir(folder)) == ["body.toml", target]
    assert is_old(target)


@pytest.mark.long
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_output_that_nobody_can_read(folder):
    code = "import sys\nfrom coadjoint.cli import run\nsys.argv = ['coadjoint', 'systems']\nrun()"
    with open("/dev/full", "w") as full:
        done = subprocess.run([sys.executable, "-c", code], stdout=full, stderr=-1, text=True, env=ENVIRONMENT)
    assert done.returncode == 1
    assert done.stderr.startswith("coadjoint: ") and done.stderr.endswith("\n") and done.stderr.count("\n") == 1
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run([sys.executable, "-c", code], stdout=writing, stderr=-1, text=True, env=ENVIRONMENT)
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, "")
