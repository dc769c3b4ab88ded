"""Runs: saved points, watched invariants, drifts, observed quantities and failures."""

import math

import numpy as np
import pytest

import coadjoint as co
from drawn_matrices import wide
from refusals import refused
from rounding import UNIT_ROUNDOFF as U


def driven():
    a = (lambda y, t: 0.5 * y * y * (2 + math.sin(t)), lambda y, t: y * (2 + math.sin(t)))
    return co.SplitHamiltonian(
        [((0,), co.Separable({0: a})), ((1, 4), co.Quadratic([1.0, 0.5])), ((2,), co.Quadratic(0.7))]
    )


SYSTEMS = {
    "e(3)": co.LiePoissonSystem(co.algebras.e(3), co.Quadratic(wide(6, 1), linear=np.arange(6) / 5), sign=-1),
    "sl(2)": co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic(wide(3, 2))),
    "A3,7": co.LiePoissonSystem(co.algebras.get("A3,7", a=0.25), co.Quadratic([1.0, 2.0, 0.25])),
    "driven so(4)": co.LiePoissonSystem(co.algebras.so(4), driven()),
}


def start_of(system):
    return np.linspace(-0.5, 0.75, system.dim)


def e3_and_start():
    return SYSTEMS["e(3)"], start_of(SYSTEMS["e(3)"])


def test_energy_and_casimirs_of_the_saved_states():
    """The compiled values against the system's own: 16 roundings of n^2 products."""
    for s in SYSTEMS.values():
        sol = co.integrate(s, start_of(s), (0.5, 1.5), 0.125)
        for t, x, energy in zip(sol.t, sol.x, sol.energy, strict=True):
            assert abs(energy - s.energy(x, t)) <= 16 * U * (1 + 4 * (x @ x))
        for name, casimir in s.casimirs.items():
            assert abs(sol.casimirs[name][0] - casimir(sol.x[0])) <= 16 * U * (1 + sol.x[0] @ sol.x[0])


@pytest.mark.parametrize("name", SYSTEMS)
def test_drift_is_over_every_step(name):
    s = SYSTEMS[name]
    every = co.integrate(s, start_of(s), (0, 8.125), 0.0625, co.Splitting(order=2))
    steps = every.stats.steps
    assert steps == 130
    tenths = (np.arange(1, steps + 1) - 1) * 10 // steps
    for k in (1, 37, 1000):
        sol = co.integrate(s, start_of(s), (0, 8.125), 0.0625, co.Splitting(order=2), save_every=k)
        for key, values in {"energy": every.energy, **every.casimirs}.items():
            deviation = np.abs(values - values[0])[1:]
            drift = sol.drift(relative=False)[key]
            assert drift == deviation.max() and drift.initial == values[0] and drift.members is None
            assert drift.tenths.tolist() == [deviation[tenths == tenth].max() for tenth in range(10)]
            assert drift.growth == drift.tenths[9] / drift.tenths[0]


@pytest.mark.parametrize(
    "method", [co.ExplicitRungeKutta("runge2"), co.RadauEnergy(stages=2), co.Taylor(order=3, projected=False)], ids=repr
)
@pytest.mark.parametrize("members", [1, 9])
def test_branches_are_followed_between_saved_points(method, members):
    """For schemes that lose the Casimir: its branch is followed at every step."""
    s = co.LiePoissonSystem(co.algebras.get("A3,7", a=0.005), co.Quadratic([0.01, 0.02, 1.0]))
    x0 = np.array([(1.0, 0.0, 3.0)] * members) * np.linspace(1, 1.2, members)[:, None]
    watched = co.integrate(s, x0, (0, 10), 0.125, method, save_every=70)
    others = co.integrate(s, x0, (0, 10), 0.125, method, save_every=70, watch=False)
    values = others.casimirs["log C"]
    assert np.array_equal(watched.casimirs["log C"], values)
    assert np.ptp(values, axis=0).max() > 0.5 * s.casimirs["log C"].period  # ambiguous from saved points alone
    # Unwatched drifts are over the saved points.
    for key, each in {"log C": values, "energy": others.energy}.items():
        assert others.drift(relative=False)[key] == np.abs(each - each[0]).max()
        assert not others.drift(relative=False)[key].tenths[..., 1:8].any()  # saved are the steps 0, 70 and 80


def test_observed_quantities():
    s, x0 = e3_and_start()
    height = co.Polynomial({(1, 0, 0, 0, 0, 1): 2.0, (0, 1, 0, 0, 0, 0): 1})
    observe = {"height": height, "angle": lambda x: math.atan2(x[1], x[0]), "late": lambda x, t: t * x[2]}
    for start in (x0, np.stack([x0, -x0])):
        sol = co.integrate(s, start, (0.5, 1.5), 0.125, save_every=3, observe=observe)
        x1, x2, x3, x6 = (sol.x[..., i] for i in (0, 1, 2, 5))
        assert np.abs(sol.observed["height"] - (2 * x1 * x6 + x2)).max() <= 8 * U
        assert np.abs(sol.observed["angle"] - np.arctan2(x2, x1)).max() <= 8 * U
        t = sol.t if start.ndim == 1 else sol.t[:, None]
        assert np.array_equal(sol.observed["late"], t * x3)


UNSTABLE = co.LiePoissonSystem(
    co.algebras.sl(2), co.Quadratic([[1.0, 0.3, 0.0], [0.3, -2.0, 0.1], [0.0, 0.1, 0.5]]), name="runaway"
)
RUNAWAY = np.array([0.1, 0.2, 0.3])  # overflows after some thirty steps


@pytest.mark.parametrize("every", [1, 7])
@pytest.mark.parametrize("order", [1, 2, 4])
def test_overflow_returns_the_partial_solution(order, every):
    with refused(co.IntegrationError, "overflowed", "0.1") as failure:
        co.integrate(UNSTABLE, RUNAWAY, (1, 11), 0.1, co.Splitting(order=order), save_every=every, attitude="coadjoint")
    error = failure.value
    assert 5 < error.step < 100 and error.time == 1 + (error.step - 1) * 0.1 and math.isnan(error.residual)
    partial = error.partial
    assert np.all(np.isfinite(partial.x)) and np.all(np.isfinite(partial.attitude))
    assert len(partial.t) == len(partial.x) == len(partial.energy) == 1 + (error.step - 1) // every
    assert partial.t[-1] <= error.time + 1e-12
    assert "\n" not in str(error) and f"in step {error.step}" in str(error)


ESCAPE = co.LiePoissonSystem(  # x2' = x2^2 from 1 escapes at t = 1
    co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1}}), co.Polynomial("x1*x2", basis=("x1", "x2")), sign=-1
)


@pytest.mark.parametrize("start", [(1.0, 1.0), [(1.0, 0.1), (1.0, 1.0)]])
@pytest.mark.parametrize("method", [co.Splitting(), co.GaussLegendre(2), co.Taylor(order=8)])
def test_failure_of_a_growing_motion_names_both_reasons(method, start):
    with refused(co.IntegrationError, "smaller step", "the motion itself") as failure:
        co.integrate(ESCAPE, start, (0, 2), 0.01, method)
    assert abs(failure.value.time - 1.0) < 0.05
    if not isinstance(method, co.Splitting):  # a bounded motion
        with refused(co.IntegrationError, "smaller step than 5") as failure:
            co.integrate(co.systems.rigid_body((1.0, 2.0, 2.5)), (1.0, 5.0, 2.0), (0, 100), 5.0, method)
        assert "motion itself" not in str(failure.value)


@pytest.mark.parametrize("written", ["Splitting", {"name": "Splitting", "order": 4}])
def test_schemes_may_be_given_by_name_everywhere(written):
    body, X = co.systems.rigid_body(), (1.0, 0.2, 0.1)
    method = co.Splitting() if isinstance(written, str) else co.Splitting(order=4)
    calls = (
        lambda given: co.integrate(body, X, (0, 1), 0.125, given).x,
        lambda given: co.prepare(body, given, 0.125).end(X, (0, 1)),
        lambda given: co.stepper(body, given, 0.125)(X),
        lambda given: co.integrate_ensemble(body, [X, X], (0, 1), 0.125, given).x,
        lambda given: co.poincare_section(body, [X], co.Event(1), (0, 20), 0.125, given).x,
        lambda given: co.lyapunov(body, X, (0, 5), 0.125, given).exponents,
        lambda given: co.choose(body, X, (0, 1), 1e-3, methods=given).step,
        lambda given: co.choose(body, X, (0, 1), 1e-3, methods=[given, co.GaussLegendre(3)]).step,
        lambda given: [row.value for row in co.certify(body, given, X, 0.125, steps=5).table],
        lambda given: co.modified_hamiltonian(body, given, 4)(X, 0.125),
        lambda given: co.modified_field(body, given, 4)(X, 0.125),
        lambda given: co.suggest_step(body, given, X, energy=1e-5),
        lambda given: co.make_corrector(body, given, X)(X, 0.125),
    )
    for call in calls:
        np.testing.assert_array_equal(np.asarray(call(written), float), np.asarray(call(method), float))


@pytest.mark.parametrize("name", ["rk4", "RK4", "runge2", "Runge2"])
def test_tableaux_are_schemes_by_their_names_in_any_case(name):
    assert co.prepare(co.systems.rigid_body(), name, 0.125).method == co.ExplicitRungeKutta(name.lower())


ADAPTIVE = ["RK45", "rk23", "DOP853", "Radau", "BDF", "LSODA", "dopri5", "vode", "Tsit5", "odeint"]


@pytest.mark.parametrize("name", ADAPTIVE)
def test_adaptive_schemes_of_other_packages_are_refused_by_their_names(name):
    with refused(ValueError, name, "estimate of the error", "accuracy="):
        co.integrate(co.systems.rigid_body(), (1.0, 0.2, 0.1), (0, 1), 0.125, name)


NEAR_ZERO = {
    "m.p of a top": (co.systems.heavy_top(), lambda x: x - np.eye(6)[:, 0] * (x[:3] @ x[3:] - 2e-2) / x[3]),
    "momenta of a chain": (co.systems.toda_ring(3), lambda x: x - np.eye(6)[:, 0] * (x[:3].sum() - 2e-2)),
    "spin and field": (co.systems.clebsch_body(), lambda x: x - np.eye(6)[:, 1] * (x[:3] @ x[3:] - 2e-2) / x[4]),
}


@pytest.mark.parametrize("unit", [1.0, 1e-7])
@pytest.mark.parametrize("name", NEAR_ZERO)
def test_a_casimir_near_zero_in_one_member_is_not_lost_by_rounding(name, unit):
    """Rounding is relative to the terms that are added up, in every member, alone too."""
    system, near_zero = NEAR_ZERO[name]
    states = np.random.default_rng(1).uniform(0.5, 1.5, (200, 6))
    states[7] = near_zero(states[7])
    run = (0, 0.5), 0.1, co.GaussLegendre(2)
    drift = co.integrate(system, unit * states if name.startswith("momenta") else states, *run).drift()
    kept = {key: one for key, one in drift.items() if key not in ("energy", "product of a")}
    # Five steps, each with a few roundings of every term.
    assert kept and all(one < 20 * U for one in kept.values())
    assert all(one == max(one.members) and one.absolute <= one * one.scale.max() for one in kept.values())
    if unit == 1.0:
        alone = co.integrate(system, states[7], *run).drift()
        assert all(alone[key].scale == one.scale[7] for key, one in drift.items())
        values = [abs(casimir(states[7])) for casimir in system.casimirs.values()]
        assert min(values) < 0.03 and min(one.scale[7] for one in kept.values()) > 0.05
