"""Interrupted or killed commands that write archives: messages, and continuation from any write."""

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
from coadjoint import cli
from coadjoint.files.configuration.loading import load
from core_only import ENVIRONMENT, run_python
from long import long_beyond

TOP = """
[system]
name = "heavy_top"
[initial]
x = [1.0, 0.1, 0.5, 0.25, 0.5, 1.0]
attitude = "coadjoint"
[method]
name = "GaussLegendre"
[run]
t_span = [0.0, 32.0]
step = 0.0625
"""
# Chunks of 64 points, each of which is committed, and a signal at one of the written files.
AT_WRITE = """
import os, signal, sys
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored where the tests run without a terminal
from coadjoint.files.archives import stored_arrays
stored_arrays.MIN_CHUNK_ROWS = stored_arrays.MAX_CHUNK_ROWS = 64
original, writes = os.replace, 0
def replace(source, target, **folders):
    global writes
    writes += 1
    if writes == {write}:
        os.kill(os.getpid(), signal.{name})
    original(source, target, **folders)
os.replace = replace
from coadjoint.cli import run
sys.argv = ["coadjoint", *{arguments!r}]
run()
"""
REASONS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}
NONE = 10**6


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "top.toml").write_text(TOP)
    return tmp_path


def child(arguments, write=NONE, name="SIGKILL", before=""):
    code = before + AT_WRITE.format(arguments=arguments, write=write, name=name)
    return run_python(code)


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
            # The root of the archive is written as file 27, of its first commit as file 42, and then every 15.
            (20, "SIGKILL", 57, "SIGINT"),
            (43, "SIGTERM", 30, "SIGKILL"),
            (4, "SIGINT", 61, "SIGTERM"),
            (57, "SIGINT", 41, "SIGHUP"),
            (70, "SIGKILL", 3, "SIGINT"),
        ],
    ),
)
def test_interrupt_at_any_write(folder, capsys, write, name, again, then):
    """While the archive is created, or in a commit, of the first and of the resuming command."""
    first = ["run", "top.toml", "--archive", "run.zarr"]
    first_reached = check_stopped(child(first, write, name), name, "top.toml")
    if first_reached is None:
        # Only a killed command leaves a hidden folder, which the next run removes.
        assert len(list(folder.glob(".run.zarr-*"))) == (name == "SIGKILL")
        reached = check_stopped(child(first, again, then), then, "top.toml")
        assert sorted(os.listdir(folder)) == ["run.zarr", "top.toml"]
    else:
        reached = check_stopped(child(["resume", "run.zarr"], again, then), then, "run.zarr")
    assert (first_reached or 0) <= reached < 512 and reached
    assert cli.main(["resume", "run.zarr"]) == 0
    assert capsys.readouterr().out.endswith("written: run.zarr\n")
    assert cli.main(["run", "top.toml", "--out", "alone.nc", "--quiet"]) == 0
    found, alone = co.open_archive("run.zarr").to_xarray().load(), xarray.load_dataset("alone.nc", engine="h5netcdf")
    assert found.sizes["time"] == 513 and set(alone.variables) == set(found.variables)
    for label, variable in alone.variables.items():
        assert np.array_equal(found[label].values, variable.values), label


FULL = """
import os
really, left = os.replace, {write}
def full(source, target, **folders):
    global left
    left -= 1
    if left <= 0:
        raise OSError(28, "No space left on device")
    really(source, target, **folders)
os.replace = full
"""


@pytest.mark.long
def test_full_disk_is_one_line(folder):
    """Status 1 during the run, and 2 before its first step."""
    end = "could not be written (No space left on device); it holds the run up to step"
    for write, arguments, status, message in (
        (
            4,
            ["run", "top.toml", "--archive", "run.zarr"],
            2,
            "cannot be created (No space left on device); give another",
        ),
        (60, ["run", "top.toml", "--archive", "run.zarr"], 1, end),
        (4, ["resume", "run.zarr"], 2, "cannot be written (No space left on device); its content is unchanged"),
        (25, ["resume", "run.zarr"], 1, end),
    ):
        code = FULL.format(write=write) + AT_WRITE.format(arguments=arguments, write=NONE, name="SIGKILL")
        done = run_python(code)
        assert (done.returncode, done.stdout) == (status, ""), done.stderr
        assert message in done.stderr and done.stderr.count("\n") == 1
        assert write != 4 or arguments[0] == "resume" or os.listdir(folder) == ["top.toml"]


MANY = (
    TOP.replace("GaussLegendre", "Splitting")
    .replace('attitude = "coadjoint"', "")
    .replace("x = [1.0, 0.1, 0.5, 0.25, 0.5, 1.0]", "x = {states}")
    .replace("32.0", "80000.0")
    + """
save_every = 100
workers = 1
[output]
archive = "run.zarr"
"""
)


@pytest.mark.long
def test_interrupted_ensemble_with_workers(folder):
    states = [[1.0, 0.1 * k, 0.5, 0.25, 0.5, 1.0] for k in range(12)]
    Path("many.toml").write_text(MANY.format(states=states))
    code = "from coadjoint.cli import run; import sys; sys.argv = ['coadjoint', 'run', 'many.toml']; run()"
    command = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True, env=ENVIRONMENT)
    end = time.monotonic() + 300
    while not list(Path("run.zarr/.coadjoint").glob("block-*.lock")):
        assert time.monotonic() < end, "timeout"
        time.sleep(0.02)
    command.send_signal(signal.SIGTERM)
    message = command.communicate(timeout=300)[1]
    line = r"many.toml: terminated; run.zarr holds \d+ of 12 members: coadjoint resume run.zarr continues it"
    # Python may warn about the semaphore of a killed worker.
    assert command.returncode == 143 and re.fullmatch(line, message.splitlines()[0]), message
    assert not co.open_archive("run.zarr").finished
    assert cli.main(["resume", "run.zarr", "--quiet"]) == 0
    Path("alone.toml").write_text(MANY.format(states=states).replace("workers = 1", ""))
    assert np.array_equal(co.open_archive("run.zarr").x, load("alone.toml").integrate().x)
