"""Ends of processes: daemon threads inside loops, and closed or full standard streams."""

import os
import subprocess
import sys

import pytest

import coadjoint as co
from core_only import ENVIRONMENT, run_python

# The main thread exits while a daemon thread runs loops, one after the other; the loops of the first run are compiled.
DAEMON = """
import dataclasses, sys, threading
import numpy as np
import coadjoint as co

@dataclasses.dataclass(frozen=True)
class Euler(co.methods.StepMethod):
    order, explicit, symmetric, compiles = 1, True, False, False
    def properties(self, system):
        return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")
    def step(self, system, x, t, h):
        inside.set()
        return x + h * system.vector_field(x, t)

body, inside = co.systems.rigid_body(inertia=(1, 2, 3)), threading.Event()
X = np.random.default_rng(0).normal(size=(640, 3))

def run(end):
    co.integrate(body, X[:{members}], (0, end), 0.01, save_every=10**8, {options})

def work():
    inside.set()
    while True:
        run(1e7)

run(0.02)
inside.clear()
threading.Thread(target=work, daemon=True).start()
assert inside.wait(100)
{before}
sys.exit(3)
"""
LATER = """
def follow():
    co.integrate(body, X[0], (0, 1), 0.01)
    print("integrated at exit", flush=True)
import atexit; atexit.register(follow)
"""


@pytest.mark.thinned(3)
@pytest.mark.parametrize(
    ("members", "options", "before"),
    [
        (64, "threads=1", ""),
        (64, "threads=1", LATER),
        (640, "threads=4", ""),
        (2, "method=Euler()", ""),
        (640, "method=Euler(), threads=2", ""),
        (64, "threads=2, progress=True", ""),
    ],
)
def test_daemon_threads_end_with_the_process(members, options, before):
    code = DAEMON.format(members=members, options=options, before=before)
    done = run_python(code)
    assert done.returncode == 3, done.stderr
    assert "terminate" not in done.stderr and "Traceback" not in done.stderr and "Fatal" not in done.stderr
    assert ("integrated" in done.stdout) == bool(before)


def test_run_threads_start_after_the_main_thread():
    code = """
import threading
import numpy as np
import coadjoint as co
body, X = co.systems.rigid_body(inertia=(1, 2, 3)), np.ones((640, 3))
def work():
    threading.main_thread().join()
    co.integrate(body, X, (0, 1), 0.01, threads=2)
    print("integrated")
threading.Thread(target=work).start()
"""
    done = run_python(code)
    assert (done.returncode, done.stdout, done.stderr) == (0, "integrated\n", "")


@pytest.mark.thinned(3)
@pytest.mark.parametrize(
    ("arguments", "streams", "status", "message"),
    [
        ("--version", ">&-", 1, "cannot be written"),
        ("--version", "2>&-", 0, ""),
        ("--version", "<&- >&- 2>&-", 1, ""),
        ("nonsense", ">&-", 2, "command"),
        ("nonsense", "2>&-", 2, ""),
        ("nonsense", "2>/dev/full", 2, ""),
        ("schema", ">/dev/full", 1, "cannot be written"),
        ("schema", "| true; exit ${PIPESTATUS[0]}", 141, ""),
    ],
)
def test_closed_or_full_standard_streams(arguments, streams, status, message):
    if "/dev/full" in streams and not os.path.exists("/dev/full"):
        pytest.skip("this system has no /dev/full")
    command = f'"{sys.executable}" -m coadjoint {arguments} {streams}'
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, env=ENVIRONMENT, timeout=200)
    assert done.returncode == status
    assert message in done.stderr and len(done.stderr.splitlines()) == bool(message)


def test_closed_streams_do_not_write_into_results(tmp_path):
    """Without standard streams files would get their descriptors."""
    (tmp_path / "body.toml").write_text(
        '[system]\nname = "rigid_body"\n[initial]\nx = [1.0, 0.1, 0.5]\n[run]\nt_span = [0.0, 1.0]\nstep = 0.125\n'
    )
    command = f'"{sys.executable}" -m coadjoint run body.toml --out run.nc <&- >&- 2>&-'
    done = subprocess.run(["bash", "-c", command], env=ENVIRONMENT, timeout=200, cwd=tmp_path)
    assert done.returncode in (0, 1) and len(co.load(tmp_path / "run.nc").t) == 9
