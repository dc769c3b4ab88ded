"""The loops hear a signal whatever they are at, and what comes after has the bits that it always has."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import coadjoint as co

# A hang guard, far above the fraction of a second that is measured.
GUARD = 30.0

SETUP = """
import signal, sys, time
import numpy as np
import coadjoint as co

class Heard(Exception):
    pass

def hear(*_):
    raise Heard

def run_for_ever():
    {run}

body, y = co.systems.rigid_body((1, 2, 3)), np.array([0.1, 1.0, 0.2])
rng = np.random.default_rng(7)
basis = np.eye(10, dtype=int) + np.eye(10, k=1, dtype=int) + np.eye(10, k=3, dtype=int)
turned = co.LiePoissonSystem(co.algebras.change_of_basis(co.algebras.so(5), basis), co.Quadratic(np.arange(1.0, 11.0)))
large = co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), 20000), co.Quadratic(np.tile([1.0, 2, 3], 20000)))
wide = np.tile(y, (20000, 1))
signal.signal(signal.SIGALRM, hear)
signal.setitimer(signal.ITIMER_REAL, 1.0)
try:
    run_for_ever()
except Heard:
    print("heard")
after = co.integrate(body, y, (0, 5), 0.1, {after})
print(after.x.tobytes().hex())
"""
SHORT = "co.integrate(body, y, (0, 1e8), 0.001, {}, save_every=10**9, watch={})"
RUNS = {
    "Gauss-Legendre": (SHORT.format("co.GaussLegendre(2)", False), "co.GaussLegendre(2)"),
    "Taylor": (SHORT.format("co.Taylor(8)", True), "co.Taylor(8)"),
    "substeps of a series": (
        "co.integrate(turned, 5.0 * rng.standard_normal((17, 10)), (0, 1e5), 1.0, "
        "co.Splitting(order=10, parts='coordinates'), threads=1)",
        "co.Splitting(order=10, parts='coordinates')",
    ),
    "a large system": (
        "co.integrate(large, np.tile(y, 20000), (0, 1e6), 0.1, co.GaussLegendre(8), save_every=10**9)",
        "co.GaussLegendre(8)",
    ),
    "a batch": (
        "co.integrate(co.batch([co.systems.rigid_body((1, 2, 2.5 + 0.01 * k)) for k in range(40)]), y, (0, 1e7), 0.01,"
        " co.GaussLegendre(2), save_every=10**9)",
        "co.GaussLegendre(2)",
    ),
    "tangent vectors of an ensemble": (
        "co.lyapunov(body, wide, (0, 1e6), 0.01, co.Splitting(order=2), save_every=10**10, threads=2)",
        "co.Splitting(order=2)",
    ),
}


def told_by(script: str) -> list[str]:
    """Return the lines that a process prints, which must not take long."""
    environment = os.environ | {"PYTHONPATH": str(Path(co.__file__).parents[1])}
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, timeout=GUARD, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.thinned(4)
@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="timers of signals are POSIX's")
@pytest.mark.parametrize("name", RUNS)
def test_a_signal_is_heard_and_leaves_nothing_behind(name):
    run, after = RUNS[name]
    body = co.systems.rigid_body((1, 2, 3))
    expected = co.integrate(body, (0.1, 1.0, 0.2), (0, 5), 0.1, eval(after, {"co": co})).x
    assert told_by(SETUP.format(run=run, after=after)) == ["heard", expected.tobytes().hex()]


@pytest.mark.long
def test_what_does_not_settle_ends():
    """Nobody of a block settles in the momentum: the group iteration has nobody to go for, alone and in an ensemble."""
    script = """
import numpy as np, coadjoint as co
x = np.array([[5., 5.005, 5.01], [5.015, 5.02, 5.025], [5.03, 5.035, 5.04]])
body = co.systems.rigid_body((1, 2, 3))
whole = co.integrate(body, x, (0, 3), 1.0, co.GaussLegendre(2), attitude=True)
for m in range(3):
    alone = co.integrate(body, x[m], (0, 3), 1.0, co.GaussLegendre(2), attitude=True)
    print(np.array_equal(whole.x[:, m], alone.x) and np.array_equal(whole.attitude[:, m], alone.attitude))
try:
    co.integrate(body, 1e6 * x, (0, 3), 1.0, co.ModifiedGaussLegendre(2, freeze="gradient"), attitude=True)
except co.IntegrationError as error:
    pass
print("ended")
"""
    assert told_by(script) == ["True", "True", "True", "ended"]
