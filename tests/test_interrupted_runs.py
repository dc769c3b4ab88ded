"""Interrupted runs: partial results, messages, and continuation of archives."""

import os
import signal

import numpy as np
import pytest
import xarray

import coadjoint as co
from coadjoint import cli
from coadjoint.interruption import Interrupted
from core_only import run_python
from long import long_beyond

LONG = """
[system]
name = "rigid_body"
[initial]
x = [1.0, 0.1, 0.5]
[run]
t_span = [0.0, 1000000000.0]
step = 0.1
save_every = 1000000
"""
COMMAND = """
from coadjoint.cli import run
sys.argv = ["coadjoint", *{arguments!r}]
run()
"""
# A signal from another thread after the loop has saved its second point; 10^10 steps take minutes.
SIGNAL = (
    """
import os, signal, sys, threading, time
import numpy as np
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored where the tests run without a terminal
from coadjoint.kernels.loop import MemberBatch
original = MemberBatch.advance
def advance(self, layout, schedule, saved, *given):
    def later():
        while np.isnan(saved["x"][1]).any():
            time.sleep(0.001)
        os.kill(os.getpid(), signal.{name})
    saved["x"][1] = np.nan
    MemberBatch.advance = original
    threading.Thread(target=later, daemon=True).start()
    return original(self, layout, schedule, saved, *given)
MemberBatch.advance = advance
"""
    + COMMAND
)
# A signal after half of the steps of the fifth call.
SIGNAL_AT_HALF = (
    """
import os, signal, sys
from coadjoint.kernels.loop import MemberBatch
original, calls = MemberBatch.advance, []
def advance(self, layout, schedule, saved, state, k0, k1, stop):
    calls.append(None)
    if len(calls) != 5:
        return original(self, layout, schedule, saved, state, k0, k1, stop)
    original(self, layout, schedule, saved, state, k0, (k0 + k1) // 2, stop)
    os.kill(os.getpid(), signal.{name})
MemberBatch.advance = advance
"""
    + COMMAND
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "long.toml").write_text(LONG)
    return tmp_path


@pytest.mark.sensitive
@pytest.mark.parametrize(
    ("name", "status", "message"),
    long_beyond(1, [("SIGTERM", 143, "terminated"), ("SIGINT", 130, "interrupted"), ("SIGHUP", 129, "hung up")]),
)
def test_interrupted_command_writes_the_partial_run(folder, name, status, message):
    done = run_python(SIGNAL.format(name=name, arguments=["run", "long.toml", "--out", "run.nc"]))
    line = f"long.toml: {message}; the solution so far is in run.nc, marked as incomplete\n"
    assert (done.returncode, done.stdout, done.stderr) == (status, "", line)
    assert sorted(os.listdir(folder)) == ["long.toml", "run.nc"]
    with xarray.open_dataset("run.nc", engine="h5netcdf") as found:
        assert found.attrs["run_incomplete"] == 1 and found.attrs["incomplete_reason"] == message
        assert found.attrs["incomplete_time"] == found["time"][-1] and len(found["time"]) >= 1
        assert np.isfinite(found["x"]).all() and np.array_equal(found["x"][0], [1.0, 0.1, 0.5])
        body = co.systems.rigid_body()
        count = min(len(found["time"]), 3)
        first = co.integrate(body, [1.0, 0.1, 0.5], (0.0, (count - 1) * 1e5), 0.1, save_every=10**6)
        assert np.array_equal(found["x"][:count], first.x)


@pytest.mark.sensitive
@pytest.mark.parametrize(
    ("name", "status", "message"), long_beyond(1, [("SIGINT", 130, "interrupted"), ("SIGTERM", 143, "terminated")])
)
def test_interrupted_archive_is_resumed(folder, capsys, name, status, message):
    (folder / "long.toml").write_text(LONG.replace("1000000000.0", "1000000.0").replace("1000000\n", "1000\n"))
    done = run_python(SIGNAL_AT_HALF.format(name=name, arguments=["run", "long.toml", "--archive", "run.zarr"]))
    reached = co.open_archive("run.zarr").reached
    line = (
        f"long.toml: {message}; run.zarr holds the run up to step {reached}: coadjoint resume run.zarr continues it\n"
    )
    assert (done.returncode, done.stdout, done.stderr) == (status, "", line)
    assert sorted(os.listdir(folder)) == ["long.toml", "run.zarr"] and 0 < reached < 10**7
    assert cli.main(["resume", "run.zarr"]) == 0
    assert capsys.readouterr().out.endswith("written: run.zarr\n")
    expected = co.integrate(co.systems.rigid_body(), [1.0, 0.1, 0.5], (0.0, 1e6), 0.1, save_every=1000)
    found = co.open_archive("run.zarr")
    assert found.finished and np.array_equal(found.x, expected.x) and found.attributes["configuration"]
    assert np.array_equal(found.drift(relative=False)["energy"].tenths, expected.drift(relative=False)["energy"].tenths)


@pytest.mark.long
def test_second_interrupt_ends_the_command(folder):
    code = SIGNAL.format(name="SIGINT", arguments=["run", "long.toml", "--out", "run.nc"])
    twice = "import coadjoint.files.output.output_files as output, os, signal\n"
    twice += "output.write_netcdf = lambda *given: os.kill(os.getpid(), signal.SIGINT)\n"
    done = run_python(twice + code)
    assert (done.returncode, done.stderr) == (130, "coadjoint: interrupted\n")
    assert os.listdir(folder) == ["long.toml"]


def test_interrupt_before_the_archive_exists(folder, capsys, monkeypatch):
    """Without an archive the message names none, and nothing remains of it."""
    from coadjoint.files.archives.store import ArchiveStore

    first = f"x = {[[1.0, 0.1, 0.5]] * 2}\n"
    (folder / "many.toml").write_text(LONG.replace("x = [1.0, 0.1, 0.5]\n", first))
    for number, message in (
        (signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated"), (signal.SIGHUP, "hung up"),
    ):  # fmt: skip
        for place in ("create_archive", "write", "commit", "moved"):
            for file in ("long.toml", "many.toml"):

                def interrupt(*args, number=number):
                    raise Interrupted(number)

                with monkeypatch.context() as patched:
                    patched.setattr(ArchiveStore, place, interrupt)
                    status = cli.main(["run", file, "--archive", "run.zarr"])
                written = capsys.readouterr()
                assert (status, written.err) == (128 + number, f"coadjoint: {message}\n"), place
                assert sorted(os.listdir(folder)) == ["long.toml", "many.toml"], place


def interrupt_after(calls, monkeypatch):
    """Interrupt a run in one of the calls of its loops, after some of its steps."""
    from coadjoint.kernels.loop import MemberBatch

    original, left = MemberBatch.advance, [calls]

    def advance(self, layout, schedule, saved, state, k0, k1, stop):
        left[0] -= 1
        if left[0]:
            return original(self, layout, schedule, saved, state, k0, k1, stop)
        original(self, layout, schedule, saved, state, k0, (k0 + k1) // 2, stop)
        raise KeyboardInterrupt

    monkeypatch.setattr(MemberBatch, "advance", advance)


BODY, X = co.systems.rigid_body(inertia=(1, 2, 3)), (0.3, -1.0, 0.7)


@pytest.mark.parametrize("options", [{}, {"attitude": True}, {"watch": False, "save_every": 7}, {"threads": 2}])
def test_keyboard_interrupt_has_the_partial_solution(monkeypatch, options):
    x0 = np.multiply.outer(1.0 - 0.01 * np.arange(70), X) if "threads" in options else X
    expected = co.integrate(BODY, x0, (0, 10), 0.125, **options)
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt) as stopped:
        interrupt_after(1, patched)
        co.integrate(BODY, x0, (0, 10), 0.125, **options)
    found = stopped.value.partial
    assert stopped.value.__notes__ == [
        "The solution so far is the attribute partial of the error; archive= stores it on disk"
    ]
    count = len(found.t)
    finite = np.isfinite(found.x)
    # Of two batches the first one is finished.
    assert 1 < count < len(expected.t) or not finite.all()
    assert np.array_equal(found.t, expected.t[:count])
    assert finite.any(axis=-1).reshape(count, -1).any(axis=1).all()
    assert np.array_equal(found.x[finite], expected.x[:count][finite])
    assert np.array_equal(found.energy[np.isfinite(found.energy)], expected.energy[:count][np.isfinite(found.energy)])
    deviation = np.nanmax(np.abs(found.energy - expected.energy[0]))
    assert found.drift(relative=False)["energy"] == deviation and not found.watched
    if options.get("attitude"):
        assert np.array_equal(found.attitude, expected.attitude[:count])


def test_keyboard_interrupt_of_a_later_call_has_the_partial_solution(monkeypatch):
    """Later calls of a prepared run are one call of a loop; here the interrupt follows its last step."""
    prepared, x0 = co.prepare(BODY, None, 0.125, threads=1), np.array(X)
    expected = prepared.run(x0, (0, 10))
    loop = prepared._recent_setup.whole_run

    def interrupted(arrays):
        assert loop(arrays) == 0
        raise KeyboardInterrupt

    monkeypatch.setattr(prepared._recent_setup, "_whole_run", interrupted)
    with pytest.raises(KeyboardInterrupt) as stopped:
        prepared.run(x0, (0, 10))
    found = stopped.value.partial
    assert stopped.value.__notes__ == [
        "The solution so far is the attribute partial of the error; archive= stores it on disk"
    ]
    assert np.array_equal(found.t, expected.t) and np.array_equal(found.x, expected.x)


def test_interrupt_before_the_first_step(monkeypatch):
    def stop(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr("coadjoint.kernels.loop.MemberBatch.advance", stop)
    with pytest.raises(KeyboardInterrupt) as stopped:
        co.integrate(BODY, X, (0, 10), 0.125)
    assert len(stopped.value.partial.t) == 0 and stopped.value.partial.x.shape == (0, 3)


def test_keyboard_interrupt_leaves_a_resumable_archive(tmp_path, monkeypatch):
    expected = co.integrate(BODY, X, (0, 100), 0.125)
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt) as stopped:
        interrupt_after(5, patched)
        co.integrate(BODY, X, (0, 100), 0.125, archive=tmp_path / "run.zarr")
    partial, path = stopped.value.partial, tmp_path / "run.zarr"
    assert stopped.value.__notes__ == [
        f"{path} contains the computed steps; co.resume({str(path)!r}) continues the run"
    ]
    assert 0 < partial.reached < 800 and np.array_equal(partial.x, expected.x[: partial.reached + 1])
    assert np.array_equal(co.resume(tmp_path / "run.zarr").x, expected.x)
