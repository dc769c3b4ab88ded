"""Derivatives of runs by every scheme: adjoint to each other, and equal to differences of runs of order 8."""

import numpy as np
import pytest
from derivative_cases import wave, wave_curvature, wave_slope

import coadjoint as co
from coadjoint.methods import registry
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.parameters import with_parameters
from coadjoint.systems.protocol import shape_of
from coadjoint.systems.registry import ready_made_systems

WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
# So small that the choice of the parts does not change.
DISTANCE = 2.0**-11
# Differences of order 8 in runs of size one: rounding of some hundred steps over the distance, and less truncation.
DIFFERENCE_ERROR = 2.0**12 * UNIT_ROUNDOFF / DISTANCE

BODY = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5))
TOP = co.systems.heavy_top(inertia=(1.0, 2.0, 2.5), lever=(0.1, 0.2, 1.0))
FULL = co.LiePoissonSystem(
    co.algebras.so(3),
    co.Quadratic([[1.0, 0.1, 0.2], [0.1, 0.7, 0.0], [0.2, 0.0, 0.4]], linear=[0.1, 0.0, 0.2]),
    sign=-1,
)
CUBIC = co.LiePoissonSystem(
    co.algebras.se(2), co.Polynomial({(2, 0, 0): 0.5, (0, 2, 0): 0.3, (0, 0, 2): 0.2, (0, 1, 2): 0.4, (1, 0, 0): 0.1})
)
# Its matrices turn by half the angle of the momentum.
SPINORS = co.LiePoissonSystem(co.algebras.get("su(2)"), co.Quadratic([0.3, 0.6, 1.0]), sign=-1)
SPINS = co.systems.spin_lattice(shape=2, field=(0.1, 0.2, 0.3), dm=(0.1, 0.1, 0.2))


TIMED = co.LiePoissonSystem(
    co.algebras.so(3), co.Separable(dict.fromkeys(range(3), (wave, wave_slope, wave_curvature))), name="timed"
)
X3, X6 = np.array([0.3, 1.0, 0.2]), np.array([0.3, 1.0, 0.2, 0.1, 0.4, 0.9])
UNIT_SPINS = np.array([0.6, 0.0, 0.8, 0.48, 0.64, 0.6])

COMPILED = [
    (TOP, co.Splitting(order=1), X6, False),
    (TOP, co.Splitting(order=4), X6, True),
    (TOP, co.Splitting(order=4), X6, "coadjoint"),
    (BODY, co.Splitting(order=2, compensated=True), X3, True),
    (BODY, co.Splitting(order=2, rotation="rational"), X3, True),
    (BODY, co.Splitting(order=2, parts="coordinates"), X3, True),
    (SPINORS, co.Splitting(order=2, rotation="rational"), X3, True),
    (BODY, co.Splitting(scheme="blanes_casas_murua6"), X3, False),
    (CUBIC, co.Splitting(order=2), X3, False),
    (TOP, co.Composition(co.Splitting(order=2), (0.7, -0.4, 0.7)), X6, False),
    (TIMED, co.Splitting(order=2), X3, False),
    (TIMED, co.GaussLegendre(2), X3, False),
    (BODY, co.GaussLegendre(1), X3, True),
    (TOP, co.GaussLegendre(3), X6, "coadjoint"),
    (CUBIC, co.GaussLegendre(2), X3, False),
    (FULL, co.GaussLegendre(2), X3, False),
    (SPINS, co.GaussLegendre(2), UNIT_SPINS, False),
    (co.systems.toda(sites=4), co.GaussLegendre(2), np.linspace(-0.5, 0.6, 7), False),
    (co.systems.toda(sites=5), co.GaussLegendre(2), np.linspace(-0.5, 0.6, 9), False),
    (TOP, co.ExplicitRungeKutta("rk4"), X6, "coadjoint"),
    (TOP, co.ModifiedGaussLegendre(2), X6, False),
    (BODY, co.ModifiedGaussLegendre(1, freeze="gradient"), X3, "coadjoint"),
    (TOP, co.IteratedGaussLegendre(2, iterations=3), X6, False),
    (TOP, co.Composition(co.GaussLegendre(1), (0.7, -0.4, 0.7)), X6, "coadjoint"),
    (SPINORS, co.Splitting(order=4), X3, True),
]
STEPWISE = [
    (BODY, co.Taylor(order=8), X3, False),
    (BODY, co.Kahan(), X3, False),
    (BODY, co.RadauEnergy(), X3, False),
    (TOP, co.CommutatorFree(), X6, False),
    (BODY, co.Projected(co.GaussLegendre(1)), X3, False),
    (SPINS, co.SphericalMidpoint(), UNIT_SPINS, False),
    (BODY, co.Taylor(order=6), X3, True),
    (TOP, co.Taylor(order=3, projected=False), X6, "coadjoint"),
    (SPINORS, co.CommutatorFree(3), X3, True),
    (TOP, co.CommutatorFree(), X6, "coadjoint"),
    (CUBIC, co.Taylor(order=4), X3, "coadjoint"),
    (TIMED, co.CommutatorFree(), X3, "coadjoint"),
]
SPANS = {
    "forward": ((0.5, 1.5), {"save_every": 7}),
    "backward": ((1.0, 0.0), {"save_every": 3}),
    "times": ((0.5, 1.5), {"t_eval": [0.5, 0.52, 1.0, 1.33]}),
    "brief": ((0.5, 0.8), {"t_eval": [0.52, 0.73, 0.8]}),
    "back": ((0.5, 0.2), {"t_eval": [0.48, 0.3, 0.2]}),
}


def named(case):
    system, method, _, attitude = case
    return f"{system.name}-{method}-{attitude}"


def functional(sol, weights):
    total = (weights["x"] * sol.x).sum() + (weights["energy"] * sol.energy).sum()
    return total if sol.attitude is None else total + (weights["attitude"] * sol.attitude).sum()


def derivatives(case, span, seed, members=()):
    """Return the derivative of a random functional along random directions, backward, forward and by differences."""
    system, method, x0, attitude = case
    rng = np.random.default_rng(seed)
    start = x0 * (1.0 + 0.05 * rng.standard_normal((*members, len(x0)))) if members else x0
    t_span, options = SPANS[span]
    ready = co.prepare(system, method, 0.05, attitude=attitude)
    plain = ready.run(start, t_span, **options)
    sol, pullback = ready.vjp(start, t_span, **options)
    assert np.array_equal(sol.x, plain.x) and np.array_equal(sol.energy, plain.energy)
    weights = {"x": rng.standard_normal(sol.x.shape), "energy": rng.standard_normal(sol.energy.shape)}
    if sol.attitude is not None:
        assert np.array_equal(sol.attitude, plain.attitude)
        weights["attitude"] = rng.standard_normal(sol.attitude.shape)
    gradient = pullback(**weights)
    directions = {"x0": rng.standard_normal(np.shape(start))}
    directions |= {name: rng.standard_normal(np.shape(value)) for name, value in ready.parameters.items()}
    assert set(gradient) - {"attitude0"} == set(directions)
    products = [gradient[name] * direction for name, direction in directions.items()]
    backward, size = sum(one.sum() for one in products), sum(np.abs(one).sum() for one in products)
    _, tangents = ready.jvp(start, t_span, directions, **options)
    forward = functional(tangents, weights)

    def moved(by):
        values = {name: value + by * directions[name] for name, value in ready.parameters.items()}
        other = co.prepare(with_parameters(system, values) if values else system, method, 0.05, attitude=attitude)
        return functional(other.run(start + by * directions["x0"], t_span, **options), weights)

    differences = sum(
        weight * (moved(k * DISTANCE) - moved(-k * DISTANCE)) / DISTANCE for k, weight in enumerate(WEIGHTS, start=1)
    )
    return backward, forward, differences, size, gradient


@pytest.mark.parametrize("span", ["forward", "backward", "times"])
@pytest.mark.parametrize("case", COMPILED, ids=named)
def test_compiled_derivatives_are_those_of_runs(case, span):
    backward, forward, differences, size, gradient = derivatives(case, span, 3)
    assert abs(backward - forward) <= 2.0**10 * UNIT_ROUNDOFF * size
    if set(gradient.rule.values()) <= {"exact"}:
        assert abs(backward - differences) <= DIFFERENCE_ERROR * size


@pytest.mark.parametrize("members", [(1,), (3,), (40,)])
@pytest.mark.parametrize("case", [COMPILED[1], COMPILED[7], COMPILED[9]], ids=named)
def test_derivatives_of_ensembles_are_those_of_runs(case, members):
    backward, forward, differences, size, _ = derivatives(case, "forward", 4, members)
    assert abs(backward - forward) <= 2.0**10 * UNIT_ROUNDOFF * size
    assert abs(backward - differences) <= DIFFERENCE_ERROR * size


@pytest.mark.parametrize("span", ["brief", "back"])
@pytest.mark.parametrize("case", STEPWISE, ids=named)
def test_derivatives_step_by_step_are_those_of_runs(case, span):
    backward, forward, differences, size, gradient = derivatives(case, span, 5)
    assert gradient.rule == dict.fromkeys(gradient.keys() - {"x0", "attitude0"}, "differences")
    assert abs(backward - forward) <= 2.0**10 * UNIT_ROUNDOFF * size
    assert abs(backward - differences) <= DIFFERENCE_ERROR * size


def test_differences_by_an_entry_far_below_the_others_do_not_show_rounding():
    """The derivative changes by as little as the entry; differences on the scale of the entry would lose ten digits."""
    found = []
    for entry in (0.0, 1e-9):
        M = [[1.0, entry, 0.1], [entry, 0.7, 0.0], [0.1, 0.0, 0.4]]
        ready = co.prepare(co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M)), co.Kahan(), 0.05)
        _, tangents = ready.jvp(X3, (0.0, 0.2), {"M": np.eye(9)[3].reshape(3, 3)}, save_every=4)
        found.append(tangents.x[-1])
    assert np.abs(found[1] - found[0]).max() <= DIFFERENCE_ERROR


@pytest.mark.parametrize("step", [0.25, 4.0])
@pytest.mark.parametrize("method", [co.GaussLegendre(2), co.GaussLegendre(4)], ids=str)
def test_derivatives_of_long_steps_are_those_of_runs(method, step):
    """The iteration for the derivatives of the stages converges for the smaller step, and not for the larger one."""
    ready, x0 = co.prepare(BODY, method, step), 2.0 * X3
    sol, pullback = ready.vjp(x0, (0.0, 4 * step), save_every=4)
    gradient = pullback(x=np.ones(sol.x.shape))["x0"]
    differences = [
        sum(
            w * (ready.end(x0 + k * DISTANCE * u, (0.0, 4 * step)) - ready.end(x0 - k * DISTANCE * u, (0.0, 4 * step)))
            for k, w in enumerate(WEIGHTS, start=1)
        ).sum()
        / DISTANCE
        for u in np.eye(3)
    ]
    size = np.abs(gradient).max()
    np.testing.assert_allclose(gradient, 1.0 + np.array(differences), rtol=0, atol=4 * DIFFERENCE_ERROR * size)
    _, tangents = ready.jvp(x0, (0.0, 4 * step), {"x0": np.eye(3)}, save_every=4)
    np.testing.assert_allclose(tangents.x.sum(axis=(0, 1)), gradient, rtol=0, atol=2.0**12 * UNIT_ROUNDOFF * size)


BODIES = [BODY, TOP, SPINS, co.systems.matrix_body((1.0, 2.0, 3.0))]
REFUSED = {("ReversibleSteps", "forces"): "chooses its own steps"}
"""Schemes that are not differentiated with forces or with attitudes, and the reason."""
MATRIX_SCHEMES = {"IsospectralGauss", "LineSplitting"}
"""Schemes for matrices alone."""


def assert_adjoint(ready, x0):
    """Compare the tangent along the state and the attitude with the gradient, in a run of two steps."""
    sol, pullback = ready.vjp(x0, (0.0, 0.1))
    turned = sol.attitude is not None
    gradient = pullback(sol.x, energy=sol.energy, attitude=sol.attitude)
    directions = {"x0": x0} | ({"attitude0": sol.attitude[0]} if turned else {})
    directions |= {name: np.ones(np.shape(value)) for name, value in ready.parameters.items()}
    _, tangents = ready.jvp(x0, (0.0, 0.1), directions)
    product = np.sum(sol.x * tangents.x) + sol.energy @ tangents.energy
    product += np.sum(sol.attitude * tangents.attitude) if turned else 0.0
    products = [gradient[name] * direction for name, direction in directions.items()]
    size = sum(np.sum(np.abs(one)) for one in products)
    assert abs(sum(np.sum(one) for one in products) - product) <= 2.0**10 * UNIT_ROUNDOFF * size


@pytest.mark.parametrize("system", BODIES, ids=str)
def test_every_scheme_has_derivatives(system):
    """A new scheme is differentiated step by step, with forces and with attitudes, or is on the list of refusals."""
    x0 = {3: X3, 6: UNIT_SPINS if system is SPINS else X6}.get(system.dim)
    x0 = system.algebra.projected(np.arange(9.0).reshape(3, 3) / 9) if x0 is None else x0
    forced = system.with_forces(co.forces.LinearDamping(0.2))
    seen = set()
    for name in registry.names():
        method = registry.scheme(name).examples()[0]
        for attitude in (False, "coadjoint"):
            for kind, one in (("alone", system), ("forces", forced)):
                try:
                    ready = co.prepare(one, method, 0.05, attitude=attitude)
                except (TypeError, ValueError):
                    continue
                seen.add((name, kind, bool(attitude)))
                reason = REFUSED.get((name, kind))
                if reason is None:
                    assert_adjoint(ready, x0)
                else:
                    with pytest.raises(TypeError, match=reason):
                        ready.vjp(x0, (0.0, 0.1))
    assert {one[1:] for one in seen} >= {("alone", False), ("forces", False)}
    if system is BODY:
        everything = {name for name in registry.names() if name not in MATRIX_SCHEMES}
        assert {name for name, kind, _ in seen if kind == "forces"} == everything
        assert {name for name, kind, turned in seen if kind == "forces" and turned} >= {"Taylor", "CommutatorFree"}


MATRICES = {"matrix_body": {"inertia": (1.0, 2.0, 3.0)}} | {
    name: {"N": 3} for name in ("sphere_euler", "torus_euler", "reduced_mhd", "passive_scalar")
}
WITHOUT: set[str] = set()


def test_every_ready_made_system_is_differentiated_or_refused():
    """Those of `WITHOUT` are refused by name."""
    refused = set()
    for name in ready_made_systems():
        system = co.systems.get(name, **MATRICES.get(name, {}))
        try:
            ready = co.prepare(system, None, 2.0**-10)
        except ValueError:  # no parts with exact flows
            ready = co.prepare(system, co.GaussLegendre(2), 2.0**-10)
        rows = 0.1 * np.cos(np.arange(1.0, 1.0 + system.dim))
        x0 = (
            rows
            if len(shape_of(system)) == 1
            else system.states(system.to_vector(system.algebra.projected(system.from_vector(rows))))
        )
        try:
            sol, tangents = ready.jvp(x0, (0.0, 2.0**-9), {"x0": x0})
        except TypeError as error:
            assert system.name in str(error) or "hessian" in str(error), error
            refused.add(name)
            continue
        _, pullback = ready.vjp(x0, (0.0, 2.0**-9))
        gradient = pullback.gradient(sol.x, None, None, None, ())["x0"]
        product, size = np.sum(np.real(np.conj(sol.x) * tangents.x)), np.sum(np.abs(gradient * x0))
        assert abs(np.sum(np.real(np.conj(gradient) * x0)) - product) <= 2.0**12 * UNIT_ROUNDOFF * size, name
    assert refused == WITHOUT


@pytest.mark.parametrize("case", [COMPILED[0], COMPILED[3], COMPILED[7]], ids=named)
def test_undone_steps_give_the_same_gradient(case):
    system, method, x0, attitude = case
    ready = co.prepare(system, method, 0.05, attitude=attitude)
    gradients = []
    for reverse in ("exact", "reversible"):
        sol, pullback = ready.vjp(x0, (0.0, 5.0), save_every=9, reverse=reverse)
        cotangent = None if sol.attitude is None else np.cos(np.arange(sol.attitude.size)).reshape(sol.attitude.shape)
        gradients.append(pullback(np.sin(np.arange(sol.x.size)).reshape(sol.x.shape), attitude=cotangent))
    for name, exact in gradients[0].items():
        # The states differ by rounding, whose growth over 100 steps is below 2^14 for these motions.
        np.testing.assert_allclose(
            gradients[1][name], exact, rtol=0, atol=2.0**14 * UNIT_ROUNDOFF * np.abs(exact).max()
        )


def test_runs_prepared_for_an_accuracy_are_refused():
    ready = co.prepare(BODY, accuracy=1e-6, x0=X3, t_span=(0.0, 10.0))
    for derivative in (ready.vjp, lambda x0, span: ready.jvp(x0, span, {"x0": X3})):
        with pytest.raises(TypeError, match=r"accuracy.*step="):
            derivative(X3, (0.0, 1.0))


def test_schemes_that_cannot_be_undone_are_refused_by_name():
    with pytest.raises(TypeError, match=r"GaussLegendre.*reverse"):
        co.prepare(BODY, co.GaussLegendre(2), 0.05).vjp(X3, (0.0, 1.0), reverse="reversible")
    with pytest.raises(ValueError, match="reverse"):
        co.prepare(BODY, co.Splitting(), 0.05).vjp(X3, (0.0, 1.0), reverse="backward")


def test_derivatives_do_not_depend_on_the_stretches(monkeypatch):
    from coadjoint.runs.derivatives import differentiable_run

    ready = co.prepare(TOP, co.Splitting(order=4), 0.05, attitude=True)
    gradients = []
    for numbers in (2**15, 100):
        monkeypatch.setattr(differentiable_run, "STEPS_OF_STRETCH", 1)
        monkeypatch.setattr(differentiable_run, "NUMBERS_OF_STRETCH", numbers)
        sol, pullback = ready.vjp(X6, (0.0, 3.0), save_every=7)
        gradients.append(pullback(np.ones(sol.x.shape), attitude=np.ones(sol.attitude.shape)))
    for name, one in gradients[0].items():
        np.testing.assert_allclose(gradients[1][name], one, rtol=0, atol=2.0**10 * UNIT_ROUNDOFF * np.abs(one).max())


@pytest.mark.parametrize("span", [(0.3, 1.3), (1.3, 0.3)], ids=["forward", "backward"])
@pytest.mark.parametrize("base", [co.GaussLegendre(1), co.GaussLegendre(2)], ids=str)
def test_substeps_of_driven_runs_are_differentiated_at_their_times(base, span):
    """A field that turns once in each step is another one in every substep."""
    driven = co.systems.spin_lattice("chain", 2, field=lambda t: [np.cos(60.0 * t), np.sin(60.0 * t), 0.3 * t])
    ready = co.prepare(driven, co.Composition(base, (0.4, 0.2, 0.4)), 0.1)
    direction = np.linspace(-1.0, 1.0, 6)
    sol, tangents = ready.jvp(X6, span, {"x0": direction})

    def moved(by):
        return ready.run(X6 + by * direction, span).x

    differences = sum(w * (moved(k * DISTANCE) - moved(-k * DISTANCE)) / DISTANCE for k, w in enumerate(WEIGHTS, 1))
    assert np.max(np.abs(differences)) > 0.1
    np.testing.assert_allclose(tangents.x, differences, rtol=0, atol=DIFFERENCE_ERROR)
    _, pullback = ready.vjp(X6, span)
    found = pullback(np.ones(sol.x.shape))["x0"] @ direction
    assert found == pytest.approx(np.sum(tangents.x), abs=2.0**12 * UNIT_ROUNDOFF)


@pytest.mark.parametrize("method", [co.Splitting(order=4), co.GaussLegendre(2)], ids=str)
def test_step_derivatives_are_differences_of_steps(method):
    inputs = {"field": (3, 4, 5), "rotor": (1,)}
    step = co.stepper(TOP, method, 0.1, inputs=inputs)
    values = {"field": np.array([0.1, 0.2, 0.3]), "rotor": np.array([0.3])}

    def differences(count, moved):
        units = np.eye(count)
        columns = [
            sum(w * (moved(k * DISTANCE * u) - moved(-k * DISTANCE * u)) / DISTANCE for k, w in enumerate(WEIGHTS, 1))
            for u in units
        ]
        return np.stack(columns, axis=1)

    by_inputs = differences(4, lambda u: step(X6, field=values["field"] + u[:3], rotor=values["rotor"] + u[3:]))
    tolerance = {"rtol": 0, "atol": DIFFERENCE_ERROR}
    np.testing.assert_allclose(step.tangent_by_inputs(X6, **values), by_inputs, **tolerance)
    by_state = differences(6, lambda u: step(X6 + u, **values))
    np.testing.assert_allclose(step.tangent(X6, **values), by_state, **tolerance)
    with pytest.raises(TypeError, match="inputs"):
        co.stepper(TOP, method, 0.1).tangent_by_inputs(X6)
