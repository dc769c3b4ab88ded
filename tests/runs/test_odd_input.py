"""Odd input of new users: refused in one sentence, or accepted."""

import math
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import coadjoint as co

BODY = co.systems.rigid_body()
X = (0.1, 1.0, 0.2)


def run(x0=X, **options):
    return co.integrate(
        options.pop("system", BODY), x0, options.pop("t_span", (0, 1)), options.pop("step", 0.1), **options
    )


@pytest.mark.parametrize(
    ("error", "message", "call"),
    [
        (TypeError, "system is 'rigid_body'.*LiePoissonSystem", lambda: run(system="rigid_body")),
        (TypeError, "LiePoissonSystem", lambda: co.stepper(co.algebras.so(3), co.Splitting(), 0.1)),
        (TypeError, "x0 is 'abc'.*real numbers", lambda: run("abc")),
        (TypeError, "x0 is .*real numbers", lambda: run(((1, 2), (3,)))),
        (TypeError, "x0 is .*real numbers", lambda: run((1j, 2, 3))),
        (TypeError, "watch is 'no'", lambda: run(watch="no")),
        (TypeError, "observe is", lambda: run(observe=[1])),
        (TypeError, "observe is", lambda: run(observe={1: lambda x: x[0]})),
        (TypeError, "must return one real number", lambda: run(observe={"a": lambda x: x})),
        (TypeError, "must return one real number", lambda: run(observe={"a": lambda x: "s"})),
        (ValueError, "attitude is a singular matrix", lambda: run(attitude=np.ones((3, 3)))),
        (ValueError, "attitude is False", lambda: co.stepper(BODY, co.Splitting(), 0.1).group(X, attitude=False)),
        (ValueError, "coordinate 2 more than once", lambda: co.Splitting(parts=((0,), (1,), (2,), (2,)))),
        (ValueError, "add up to 2e\\+300", lambda: co.Composition(co.Splitting(), (1e300, -1e300, 1))),
        (ValueError, "stages .* at most 256", lambda: co.GaussLegendre(10**9)),
        (ValueError, "too small beside the times", lambda: run(t_span=(1e17, 1e17 + 1024), step=1.0)),
        (ValueError, "called 'energy'", lambda: co.LiePoissonSystem(BODY.algebra, co.Quadratic(1.0), casimirs={
            "energy": co.Polynomial({(2, 0, 0): 1, (0, 2, 0): 1, (0, 0, 2): 1})})),
    ],
)  # fmt: skip
def test_odd_input_is_refused(error, message, call):
    with pytest.raises(error, match=message) as refusal:
        call()
    assert "\n" not in str(refusal.value)


def test_function_reading_beyond_its_argument_raises():
    with pytest.raises((TypeError, IndexError)):
        run(observe={"a": lambda x: x[50]})


def test_energy_that_is_not_finite_is_an_error():
    H = co.Hamiltonian(lambda x: math.log(x[0]), lambda x: np.array([1 / x[0], 0.0, 0.0]))
    with pytest.raises(co.IntegrationError, match="energy at t = 0 is not") as failure:
        run((-1.0, 1.0, 1.0), system=co.LiePoissonSystem(BODY.algebra, H), method=co.GaussLegendre(2))
    assert np.all(np.isfinite(failure.value.partial.x))


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_first_point_without_energy_is_named(way):
    """x1 is cos(t - 1), negative from step 13 on, of which step 15 is saved."""
    H = co.Hamiltonian(lambda x: x[2] + 0.0 * math.log(x[0]), lambda x: np.array([0.0, 0.0, 1.0]))
    turning, span = co.LiePoissonSystem(BODY.algebra, H, casimirs={}), (1.0, 1.0 + 2.5 * way)
    with pytest.raises(co.IntegrationError) as failure:
        co.integrate(turning, (1.0, 0.0, 0.5), span, 0.125, co.GaussLegendre(2), save_every=3)
    error = failure.value
    assert (error.step, error.time) == (15, 1.0 + way * 15 * 0.125)
    assert f"energy at t = {error.time:g} is not" in str(error)
    assert len(error.partial.t) == 8 and np.isnan(error.partial.energy).tolist() == [False] * 5 + [True] * 3


def test_integration_error_is_picklable():
    error = co.IntegrationError("no convergence", step=3, time=0.2, residual=1e-3)
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.step, again.time, again.residual) == ("no convergence", 3, 0.2, 1e-3)


def test_stepper_is_thread_safe():
    step = co.stepper(BODY, co.Splitting(), 0.1)
    states = np.random.default_rng(0).standard_normal((400, 3))
    alone = [step(x) for x in states]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(step, states))
    assert all(np.array_equal(a, b) for a, b in zip(alone, together, strict=True))


def test_save_every_beyond_the_run():
    sol = run(save_every=10**30)
    assert sol.t.tolist() == [0.0, 1.0]
