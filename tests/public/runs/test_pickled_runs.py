"""Pickled prepared runs have the same bits, in this process and in another one."""

import subprocess
import sys

import cloudpickle
import numpy as np

import coadjoint as co

BODY, TOP, FLUID = co.systems.rigid_body(inertia=(1, 2, 3)), co.systems.heavy_top(), co.systems.sphere_euler(4)
X = np.array([(1.0, 0.2, 0.1), (0.1, 1.0, 0.3), (0.5, 0.4, 0.7)])
POTENTIAL = co.LiePoissonSystem(
    co.algebras.so(3), co.Separable({0: (np.cos, lambda y: -np.sin(y)), 2: (np.exp, np.exp)}), name="own functions"
)
SPIRAL = co.LiePoissonSystem(co.algebras.get("A3,7", a=2.0), co.Quadratic([1.0, 2.0, 0.5]))
BATCH = co.batch([co.systems.rigid_body(inertia=(1, second, 3)) for second in (2.0, 2.25, 2.5)])
NOISES = co.batch([body.with_forces(co.forces.HeatBath(0.3, temperature=0.5, seed=4)) for body in BATCH])
CASES = {
    "a Casimir taken off, attitude": (BODY, co.Splitting(order=2), True, X),
    "stages": (TOP, co.GaussLegendre(2), "coadjoint", np.hstack([X, X])),
    "series": (BODY, co.Taylor(order=8), False, X),
    "functions": (POTENTIAL, co.Splitting(), False, X),
    "a Casimir with a logarithm": (SPIRAL, co.Splitting(), "coadjoint", X),
    "batch": (BATCH, co.Splitting(order=4), True, X),
    "batch of series": (BATCH, co.Taylor(order=8), False, X),
    "batch with noise": (NOISES, None, False, X),
    "a scheme inside of another": (BODY, co.ReversibleSteps(co.Splitting()), False, X),
    "steps of their own": (BODY, co.Taylor(8, tolerance=1e-9), False, X),
    "exponentials": (BODY, co.CommutatorFree(order=3), "coadjoint", X),
    "Kahan": (BODY, co.Kahan(), False, X),
    "matrices": (FLUID, co.IsospectralGauss(2), False, np.stack([FLUID.random(seed) for seed in range(len(X))])),
}
CHILD = """
import sys
import cloudpickle
import numpy as np
with open(sys.argv[1], "rb") as file:
    cases = cloudpickle.load(file)
for name, (ready, x0, expected) in cases.items():
    assert np.array_equal(ready.run(x0, (0.0, 2.0)).x, expected), name
print(len(cases))
"""


def prepared(name):
    system, method, attitude, x0 = CASES[name]
    return co.prepare(system, method, 0.125, attitude=attitude), x0


def test_pickles_have_the_same_bits_in_another_process(tmp_path):
    """Addresses of functions differ there. Functions of this file are pickled by value."""
    cases = {}
    for name in CASES:
        ready, x0 = prepared(name)
        cases[name] = ready, x0, ready.run(x0, (0.0, 2.0)).x
    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    try:
        (tmp_path / "runs").write_bytes(cloudpickle.dumps(cases))
    finally:
        cloudpickle.unregister_pickle_by_value(sys.modules[__name__])
    command = [sys.executable, "-c", CHILD, str(tmp_path / "runs")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (0, f"{len(cases)}\n"), done.stderr
