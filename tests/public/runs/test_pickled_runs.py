"""Pickled prepared runs: the same bits in another process, without deriving tables again."""

import pickle
import subprocess
import sys

import cloudpickle
import numpy as np
import pytest

import coadjoint as co

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X = np.array([(1.0, 0.2, 0.1), (0.1, 1.0, 0.3), (0.5, 0.4, 0.7), (0.2, 0.1, 0.9), (0.3, 0.8, 0.1)])
POTENTIAL = co.LiePoissonSystem(
    co.algebras.so(3), co.Separable({0: (np.cos, lambda y: -np.sin(y)), 2: (np.exp, np.exp)}), name="own functions"
)
SPIRAL = co.LiePoissonSystem(co.algebras.get("A3,7", a=2.0), co.Quadratic([1.0, 2.0, 0.5]))
BATCH = co.batch([co.systems.rigid_body(inertia=(1, second, 3)) for second in (2.0, 2.25, 2.5, 2.75, 3.0)])
NOISE = BODY.with_forces(co.forces.HeatBath(0.3, temperature=0.5, seed=4))
NOISES = co.batch([body.with_forces(co.forces.HeatBath(0.3, temperature=0.5, seed=4)) for body in BATCH])

CASES = {
    "splitting": (BODY, co.Splitting(order=4), False),
    "a Casimir taken off, attitude": (BODY, co.Splitting(order=2), True),
    "coadjoint": (BODY, co.GaussLegendre(2), "coadjoint"),
    "series": (BODY, co.Taylor(order=8), False),
    "functions": (POTENTIAL, co.Splitting(), False),
    "a Casimir with a logarithm": (SPIRAL, co.Splitting(), "coadjoint"),
    "batch": (BATCH, co.Splitting(order=4), True),
    "batch of series": (BATCH, co.Taylor(order=8), False),
    "noise": (NOISE, None, False),
    "batch with noise": (NOISES, None, False),
    "a scheme inside of another": (BODY, co.ReversibleSteps(co.Splitting()), False),
}


def pickled(value):
    return cloudpickle.loads(cloudpickle.dumps(value))


@pytest.mark.thinned(4)
@pytest.mark.parametrize(
    ("name", "span"),
    [(name, (0.0, 2.0)) for name in CASES] + [(name, (1.0, -1.0)) for name in CASES if "noise" not in name],
)
def test_pickled_run_has_the_same_bits(name, span):
    system, method, attitude = CASES[name]
    ready = co.prepare(system, method, 0.125, attitude=attitude, observe={"first": co.Polynomial({(1, 0, 0): 1})})
    here = ready.run(X, span)
    there = pickled(ready).run(X, span)
    for one, other in zip(here.to_xarray().data_vars.values(), there.to_xarray().data_vars.values(), strict=True):
        np.testing.assert_array_equal(one.values, other.values)


def test_pickle_runs_in_another_process(tmp_path):
    """Function addresses differ there."""
    ready = co.prepare(SPIRAL, co.Splitting(), 0.125, attitude="coadjoint")
    (tmp_path / "ready").write_bytes(pickle.dumps(ready))
    code = f"""
import pickle, numpy
ready = pickle.loads(open({str(tmp_path / "ready")!r}, "rb").read())
numpy.save({str(tmp_path / "x.npy")!r}, ready.run((0.1, 1.0, 0.2), (0, 2)).x)
"""
    subprocess.run([sys.executable, "-c", code], check=True)
    np.testing.assert_array_equal(np.load(tmp_path / "x.npy"), ready.run((0.1, 1.0, 0.2), (0, 2)).x)


TOP, FLUID = co.systems.heavy_top(), co.systems.sphere_euler(4)
PICKLED = {
    **{name: (system, method, attitude, X) for name, (system, method, attitude) in CASES.items()},
    "steps of their own": (BODY, co.Taylor(8, tolerance=1e-9), False, X),
    "stages": (TOP, co.GaussLegendre(2), "coadjoint", np.hstack([X, X])),
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


@pytest.mark.long
def test_all_pickles_have_the_same_bits_elsewhere(tmp_path):
    cases = {}
    for name, (system, method, attitude, x0) in PICKLED.items():
        ready = co.prepare(system, method, 0.125, attitude=attitude)
        cases[name] = ready, x0, ready.run(x0, (0.0, 2.0)).x
    path = tmp_path / "runs"
    # Functions of this file are pickled by value, since the other process cannot import it.
    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    try:
        path.write_bytes(cloudpickle.dumps(cases))
    finally:
        cloudpickle.unregister_pickle_by_value(sys.modules[__name__])
    done = subprocess.run([sys.executable, "-c", CHILD, str(path)], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (0, f"{len(cases)}\n"), done.stderr
