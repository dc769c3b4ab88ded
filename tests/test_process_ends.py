"""Ends of processes: daemon threads inside loops, and closed or full standard streams."""

import os
import subprocess
import sys

import pytest

from core_only import ENVIRONMENT, run_python

# The main thread exits after a loop of the daemon thread has begun; further loops begin while the interpreter ends.
DAEMON = """
import dataclasses, sys, threading
import numpy as np
import coadjoint as co
from coadjoint.kernels.loop import MemberBatch

@dataclasses.dataclass(frozen=True)
class Euler(co.methods.StepMethod):
    order, explicit, symmetric, compiles = 1, True, False, False
    def properties(self, system):
        return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")
    def step(self, system, x, t, h):
        return x + h * system.vector_field(x, t)

body, inside, original = co.systems.rigid_body(inertia=(1, 2, 3)), threading.Event(), MemberBatch.advance
X = np.random.default_rng(0).normal(size=(640, 3))

def advance(self, *given):
    inside.set()
    return original(self, *given)

def work():
    while True:
        co.integrate(body, X[:{members}], (0, 1e7), 0.01, save_every=10**8, {options})

MemberBatch.advance = advance
threading.Thread(target=work, daemon=True).start()
assert inside.wait(100)
{before}
sys.exit(3)
"""
LATER = """
def follow():
    inside.clear(); co.integrate(body, X[0], (0, 1), 0.01)
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
        ("nonsense", ">&-", 2, "unknown command"),
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


def test_closed_streams_keep_their_descriptors(tmp_path):
    code = (
        "import os, sys; from coadjoint import cli; cli._open_closed_streams(); "
        f"file = os.open({str(tmp_path / 'file')!r}, os.O_CREAT | os.O_WRONLY); sys.exit(file)"
    )
    command = f'"{sys.executable}" -c "{code}" <&- >&- 2>&-'
    done = subprocess.run(["bash", "-c", command], env=ENVIRONMENT, timeout=200)
    assert done.returncode > 2
