"""Tolerances of variable-step schemes for an accuracy."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.choosing import tolerances
from coadjoint.choosing.candidates import supported_candidates
from coadjoint.choosing.pilot import Pilot
from coadjoint.methods.protocol.own_steps import reaching
from coadjoint.methods.suggested_scheme import candidate_schemes

pytestmark = pytest.mark.thinned(3)

OWN = [method for method in candidate_schemes() if method.own_steps]


def systems():
    rng = np.random.default_rng(7)
    B = rng.uniform(-1.0, 1.0, (6, 6))
    so4 = co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(np.diag(np.linspace(0.5, 1.5, 6)) + 0.2 * (B + B.T)))
    line = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}})
    return {
        "body": (co.systems.rigid_body(inertia=(1, 2, 2.5)), (0.6, 0.3, 0.8), 200.0),
        "chain": (co.systems.toda(5), np.concatenate([np.zeros(5), np.full(4, 0.5)]), 60.0),
        "chain of nine": (co.systems.toda(9), np.concatenate([np.linspace(0.2, -0.2, 9), np.full(8, 0.4)]), 100.0),
        "so(4)": (so4, rng.uniform(-1.0, 1.0, 6), 60.0),
        "growth": (co.LiePoissonSystem(line, co.Quadratic(0.0, linear=[-1.0, 0.0])), (0.0, 1e-12), 8.0),
        "decay": (co.LiePoissonSystem(line, co.Quadratic(0.0, linear=[1.0, 0.0])), (0.0, 1e12), 8.0),
    }


@pytest.mark.thinned(48)
@pytest.mark.parametrize("name", list(systems()))
@pytest.mark.parametrize("accuracy", [1e-3, 1e-6, 1e-9, 1e-11])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_accuracy_is_reached(name, accuracy, direction):
    system, x0, time = systems()[name]
    span = (0.0, direction * time)
    exact = co.integrate(system, x0, span, time, co.Taylor(28, tolerance=1e-17), watch=False)
    path = co.integrate(system, x0, span, time / 50, co.Taylor(28, tolerance=1e-15))
    size = np.max(np.linalg.norm(path.x, axis=1))
    choice = co.choose(system, x0, span, accuracy, methods=OWN)
    assert choice.method.own_steps and abs(time / choice.step - round(time / choice.step)) < 1e-9
    sol = co.integrate(system, x0, span, choice.step, choice.method, watch=False)
    error = np.linalg.norm(sol.x[-1] - exact.x[-1]) / size
    assert error <= accuracy, str(choice)
    assert choice.error <= accuracy
    free = co.integrate(system, x0, span, accuracy=accuracy, watch=False)
    assert np.linalg.norm(free.x[-1] - exact.x[-1]) / size <= accuracy


@pytest.mark.parametrize("accuracy", [1e-3, 1e-6, 1e-9, 1e-12])
def test_chain_that_flies_apart_gets_variable_steps(accuracy):
    """A constant step must resolve the encounter of the particles over the whole run."""
    system, x0, _ = systems()["chain"]
    choice = co.choose(system, x0, (0.0, 200.0), accuracy)
    assert choice.method.own_steps
    constant = [other for other in choice.others if not other.method.own_steps]
    assert all(other.cost > 1.5 * choice.cost for other in constant)


def test_error_estimate_is_that_of_the_tolerance():
    for name in ("body", "chain", "so(4)"):
        system, x0, time = systems()[name]
        exact = co.integrate(system, x0, (0.0, time), time, co.Taylor(28, tolerance=1e-17), watch=False).x[-1]
        for accuracy in (1e-4, 1e-8):
            sol = co.integrate(system, x0, (0.0, time), accuracy=accuracy, method=co.Taylor(tolerance=1e-3))
            error = np.linalg.norm(sol.x[-1] - exact) / np.max(np.linalg.norm(sol.x, axis=1))
            assert error / 10 < sol.error_estimate() < 10 * error


def test_order_grows_with_accuracy():
    for name in ("body", "so(4)", "chain"):
        system = systems()[name][0]
        orders = [co.Taylor(tolerance=0.1).reaching(system, 10.0**-k).order for k in range(2, 17, 2)]
        assert orders == sorted(orders) and orders[0] < 14 and orders[-1] >= 20
    assert co.Taylor(tolerance=0.1).reaching(system, 1e-30).tolerance == 1e-18
    with pytest.raises(TypeError, match="no tolerance"):
        reaching(co.Splitting(), system, 1e-6)


def test_expensive_variable_steps_get_one_trial(monkeypatch):
    """Where constant steps cost half as much, one trial suffices; alone they are fitted as before."""
    trials = []

    def counted(pilot, candidate):
        trials.append(candidate.method)
        return variable_step_trial(pilot, candidate)

    variable_step_trial = tolerances.variable_step_trial
    monkeypatch.setattr(tolerances, "variable_step_trial", counted)
    system, x0, time = systems()["body"]
    choice = co.choose(system, x0, (0.0, time), 1e-6)
    assert not choice.method.own_steps and len(trials) == 1
    trials.clear()
    alone = co.choose(system, x0, (0.0, time), 1e-6, methods=OWN)
    assert alone.method.own_steps and alone.cost > 1.2 * choice.cost and len(trials) > 1


@pytest.mark.parametrize("name", ["body", "chain", "decay"])
@pytest.mark.parametrize("goal", [1e-2, 1e-6])
def test_predicted_steps_are_the_steps_taken(name, goal):
    system, x0, time = systems()[name]
    pilot = Pilot(system, np.array([x0], dtype=float), 0.0, time)
    (candidate,) = supported_candidates(system, OWN, x0, False, strict=True)
    trial = tolerances.first_tolerance_trial(pilot, candidate, goal)
    found = tolerances.fit_of_tolerance(pilot, candidate, goal, np.inf, trial)
    for fit in (trial, found):
        taken = tolerances.variable_step_trial(pilot, fit.candidate)
        assert fit.steps == np.ceil(taken.steps * pilot.windows)


def test_few_tolerances_are_tried_where_all_fail(monkeypatch):
    tried = []
    monkeypatch.setattr(
        tolerances, "variable_step_trial", lambda pilot, candidate: tried.append(candidate.method.tolerance)
    )
    system, x0, time = systems()["body"]
    pilot = Pilot(system, np.array([x0], dtype=float), 0.0, time)
    (candidate,) = supported_candidates(system, OWN, x0, False, strict=True)
    assert tolerances.fit_of_tolerance(pilot, candidate, 1e-9, np.inf) is None
    assert len(tried) == len(set(tried)) <= 3


def test_schemes_spoiled_by_rounding_do_not_win():
    """Splittings without compensation are cheaper in ensembles, and lose too many digits."""
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    ensemble = np.array((1.0, 0.2, 0.5)) * (1.0 + 0.01 * np.random.default_rng(0).standard_normal((40, 3)))
    plain = [co.Splitting(order=p, compensated=False) for p in (10, 8)]
    choice = co.choose(body, ensemble, (0.0, 300.0), 1e-12, methods=[*OWN, *plain])
    assert choice.method.own_steps
    with pytest.raises(ValueError, match="float64"):
        co.choose(body, ensemble, (0.0, 300.0), 1e-12, methods=plain)


def test_accurate_first_trial_is_not_repeated():
    system, x0, time = systems()["body"]
    pilot = Pilot(system, np.array([x0], dtype=float), 0.0, time)
    (candidate,) = supported_candidates(system, OWN, x0, False, strict=True)
    found = tolerances.fit_of_tolerance(pilot, candidate, 1e-6, np.inf)
    assert tolerances.fit_of_tolerance(pilot, candidate, 1e-6, 0.01 * found.cost, found) is found
