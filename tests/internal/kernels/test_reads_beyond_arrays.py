"""Functions that read beyond an array: the result is no number, and the run fails where a run in Python would raise."""

import ctypes
import dataclasses

import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.functions.compiled_functions import CompiledFunction
from coadjoint.systems.user_functions import MultipleOf
from methods.own_schemes import NOTHING

pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")

CALL = ctypes.CFUNCTYPE(None, ctypes.POINTER(ctypes.c_double), ctypes.c_double, ctypes.POINTER(ctypes.c_double))
TABLE = np.array([0.5, -1.5])
BODY = co.systems.rigid_body(inertia=(1, 2, 3))
FACTORS = np.array([1.0, 1.5, 2.0])
FLUID = co.systems.sphere_euler(N=3)
X0 = np.array([0.8, 0.5, 0.6])
START, STEP = 10.0, 0.25
# The functions of runs read the entry max(0, 4 t - 39) of three: 1 at the start, and beyond them from t = 10.5 on.


@pytest.mark.thinned(18)
@pytest.mark.parametrize("place", [3, 4, -4])
@pytest.mark.parametrize(
    ("function", "how"),
    [
        (lambda y, t: y[int(t)], {"timed": True}),
        (lambda y, t: y[int(t)] + y[::-1], {"timed": True, "flat": True, "results": 3}),
        (MultipleOf(lambda y, t: y[int(t)], 2.0, True), {"timed": True}),
        (lambda y: y[int(y[0])], {}),
        (lambda y: 2.0 * y + y[int(y[0])], {"flat": True, "results": 3}),
        (lambda y: TABLE[int(y)], {"scalar": True}),
    ],
    ids=["time", "array of time", "multiple", "state", "array of state", "global table"],
)
def test_every_way_of_calling_gives_no_number(function, how, place):
    """The numbers beside the array are finite: they are never the result."""
    how = {"scalar": False, "flat": False, "timed": False, "results": 1, **how}
    results = how.pop("results")
    compiled = CompiledFunction(function, 1 if how["scalar"] else 3, results, what="the test function", **how)
    numbers = (ctypes.c_double * 16)(*np.arange(16.0))
    start = ctypes.addressof(numbers) + 8 * 6  # six numbers before the array, and seven after it
    given, out = (ctypes.c_double * 3).from_address(start), (ctypes.c_double * 3)()
    for inside in (True, False):
        given[0] = float(1 if inside else place)
        CALL(compiled.address)(given, given[0], out)
        assert all(np.isfinite(out[k]) == inside for k in range(results))


@dataclasses.dataclass(frozen=True)
class Beyond(co.methods.StepMethod):
    order, explicit, symmetric = 1, True, False

    def properties(self, system):
        return NOTHING

    def step(self, system, x, t, h):
        return x + h * x[max(0, int(4.0 * t) - 39)] * system.vector_field(x, t)


def with_torque(torque, system=BODY):
    return system.with_forces(co.forces.Torque(torque))


W0 = np.array([[0.5, 0.9, -0.2], [0.1, -0.5, 0.8], [0.3, 0.0, 0.1]])
RUNS = {
    "step": lambda: (BODY, Beyond(), X0),
    "torque of time": lambda: (
        with_torque(lambda t: np.array([0.1, 0.2, 0.3])[max(0, int(4.0 * t) - 39)] * np.ones(3)),
        co.Splitting(order=2),
        X0,
    ),
    "own flow": lambda: (
        BODY.with_forces(
            co.forces.OwnForce(lambda x, t, tau: x * np.exp(-tau * x[max(0, int(4.0 * t) - 39)] ** 2), name="drag")
        ),
        co.Splitting(order=2),
        X0,
    ),
    "torque on matrices": lambda: (
        with_torque(lambda x, t: 0.1 * FACTORS[max(0, int(4.0 * t) - 39)] * x, FLUID),
        co.IsospectralGauss(1),
        FLUID.random(seed=1),
    ),
    "stream": lambda: (
        co.MatrixSystem(
            co.MatrixAlgebra("gl", 3),
            lambda W, t: FACTORS[max(0, int(4.0 * t) - 39)] * W.T,
            energy=lambda W, t: 0.5 * np.sum(W * W),
        ),
        co.IsospectralGauss(1),
        W0,
    ),
    "Hamiltonian": lambda: (
        co.LiePoissonSystem(
            co.algebras.so(3),
            co.Hamiltonian(
                lambda x, t: 0.5 * FACTORS[max(0, int(4.0 * t) - 39)] * (x[0] * x[0] + 2.0 * x[1] * x[1]),
                lambda x, t: FACTORS[max(0, int(4.0 * t) - 39)] * np.array([1.0, 2.0, 0.0]) * x,
            ),
        ),
        co.GaussLegendre(1),
        X0,
    ),
}


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", RUNS)
def test_a_run_fails_before_it_uses_what_is_beside_an_array(name):
    """Until then it has the bits of a run that ends earlier; all stages are evaluated within a step."""
    system, method, x0 = RUNS[name]()
    with pytest.raises(co.IntegrationError) as failure:
        co.integrate(system, x0, (START, START + 2.0), STEP, method)
    partial = failure.value.partial
    # The first step is whole; the second one may evaluate at its end.
    assert 1 <= failure.value.step <= 3 and np.all(np.isfinite(partial.x))
    early = co.integrate(system, x0, (START, START + STEP), STEP, method)
    assert np.array_equal(partial.x[: len(early.x)], early.x) and not np.array_equal(early.x[0], early.x[-1])
