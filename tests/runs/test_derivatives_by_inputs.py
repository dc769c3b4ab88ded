"""Derivatives of runs by inputs: forward, backward, and differences of order 8 of runs."""

import re
import time

import numpy as np
import pytest

import coadjoint as co
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.parameters import with_parameters

WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
DISTANCE = 2.0**-10
# As in test_every_scheme_is_differentiable: rounding of some hundred flows over the distance, and less truncation.
DIFFERENCE_ERROR = 2.0**12 * UNIT_ROUNDOFF / DISTANCE

BODY = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5))
GYROSTAT = co.systems.gyrostat(inertia=(1.0, 2.0, 2.5), rotors=(0.1, 0.0, 0.2))
TOP = co.systems.heavy_top(inertia=(1.0, 2.0, 2.5), lever=(0.1, 0.2, 1.0))
# Its parts are completed squares, whose offsets are sums of inputs.
FULL = co.LiePoissonSystem(
    co.algebras.so(3),
    co.Quadratic([[1.0, 0.1, 0.2], [0.1, 0.7, 0.0], [0.2, 0.0, 0.4]], linear=[0.1, 0.0, 0.2]),
    sign=-1,
)
CUBIC = co.LiePoissonSystem(
    co.algebras.se(2), co.Polynomial({(2, 0, 0): 0.5, (0, 2, 0): 0.3, (0, 0, 2): 0.2, (0, 1, 2): 0.4, (1, 0, 0): 0.1})
)
SPINS = co.systems.spin_lattice(shape=3, field=(0.1, 0.2, 0.3), dm=(0.1, 0.1, 0.2))
SPLIT = co.LiePoissonSystem(
    co.algebras.so(3),
    co.SplitHamiltonian(
        [((0,), co.Polynomial({(1,): 0.2, (4,): 0.1})), ((1,), co.Quadratic(0.4)), ((2,), co.Quadratic(0.7))]
    ),
)
DRIVEN = co.LiePoissonSystem(
    co.algebras.so(3),
    co.Quadratic([1.0, 0.5, 0.4])
    + co.Separable({0: (lambda y, t: np.cos(3 * t) * y, lambda y, t: np.cos(3 * t), lambda y, t: 0 * y)}),
    name="driven",
)
X3, X6 = np.array([0.3, 1.0, 0.2]), np.array([0.3, 1.0, 0.2, 0.1, 0.4, 0.9])
UNIT_SPINS = np.array([0.6, 0.0, 0.8, 0.48, 0.64, 0.6, 0.0, 0.6, -0.8])

RATES, TWO = {"rates": (0, 2)}, {"rates": np.array([0.3, -0.1])}
FIELDS = {"fields": [[3, 4], [5, 1]], "rotor": (0,)}
FOUR = {"fields": np.array([[0.3, 0.1], [0.2, 0.4]]), "rotor": np.array([-0.2])}
COMPILED = [
    (BODY, co.Splitting(order=2), X3, RATES, TWO, True),
    (BODY, co.Splitting(order=2, rotation="rational", parts="coordinates"), X3, RATES, TWO, True),
    (GYROSTAT, co.Splitting(order=4), X3, RATES, TWO, True),
    (FULL, co.Splitting(order=4), X3, True, {"linear": np.array([0.3, -0.1, 0.2])}, "coadjoint"),
    (FULL, co.Splitting(order=2, compensated=True), X3, {"one": (1,)}, {"one": [0.3]}, True),
    (CUBIC, co.Splitting(order=2), X3, True, {"linear": np.array([0.3, 0.1, 0.2])}, False),
    (SPLIT, co.Splitting(order=2), X3, RATES, TWO, False),
    (TOP, co.Splitting(order=4), X6, FIELDS, FOUR, True),
    (TOP, co.Splitting(scheme="blanes_casas_murua6"), X6, FIELDS, {"rotor": [0.4]}, "coadjoint"),
    (SPINS, co.Splitting(order=2), UNIT_SPINS, {"B": np.arange(9).reshape(3, 3)}, {"B": np.eye(3) / 4}, False),
    (FULL, co.GaussLegendre(2), X3, True, {"linear": np.array([0.3, -0.1, 0.2])}, "coadjoint"),
    (CUBIC, co.GaussLegendre(2), X3, RATES, TWO, False),
    (TOP, co.ExplicitRungeKutta("rk4"), X6, FIELDS, FOUR, "coadjoint"),
    (TOP, co.Composition(co.GaussLegendre(1), (0.7, -0.4, 0.7)), X6, FIELDS, FOUR, False),
]
STEPWISE = [
    (BODY, co.Taylor(order=8), X3, RATES, TWO, False),
    (BODY, co.RadauEnergy(), X3, RATES, TWO, False),
    (DRIVEN, co.CommutatorFree(), X3, RATES, TWO, False),
    (TOP, co.CommutatorFree(), X6, FIELDS, FOUR, False),
    (FULL, co.Projected(co.GaussLegendre(1)), X3, RATES, TWO, False),
    (DRIVEN, co.Composition(co.SphericalMidpoint(), (0.7, -0.4, 0.7)), X3, RATES, TWO, False),
]
SPANS = {
    "forward": ((0.5, 1.5), {"save_every": 7}),
    "backward": ((1.0, 0.0), {"save_every": 3}),
    "times": ((0.5, 1.5), {"t_eval": [0.5, 0.52, 1.0, 1.33]}),
    "brief": ((0.5, 0.65), {"t_eval": [0.52, 0.65]}),
    "back": ((0.5, 0.35), {"t_eval": [0.48, 0.35]}),
}


def named(case):
    return f"{case[0].name}-{case[1]}-{case[5]}"


def outputs(found):
    names = ("x", "energy") if found.attitude is None else ("x", "energy", "attitude")
    return {name: np.asarray(getattr(found, name)) for name in names}


def product(weights, found):
    return sum((weights[name] * one).sum() for name, one in outputs(found).items())


def assert_derivatives(case, span, start, values, seed, reverse="exact"):
    """Compare backward with forward derivatives by everything, and those by inputs with differences of runs."""
    system, method, _, inputs, _, attitude = case
    rng = np.random.default_rng(seed)
    t_span, options = SPANS[span]
    ready = co.prepare(system, method, 0.05, attitude=attitude, inputs=inputs)
    plain = ready.run(start, t_span, **options, **values)
    sol, pullback = ready.vjp(start, t_span, reverse=reverse, **options, **values)
    assert np.array_equal(sol.x, plain.x) and np.array_equal(sol.energy, plain.energy)
    weights = {name: rng.standard_normal(one.shape) for name, one in outputs(sol).items()}
    gradient = pullback(**weights)
    of_inputs = {name: rng.standard_normal(np.shape(one)) for name, one in gradient["inputs"].items()}
    assert {name: one.shape for name, one in of_inputs.items()} == {
        name: np.shape(values.get(name, indices)) for name, indices in ready.inputs.indices.items()
    }
    others = {name: rng.standard_normal(np.shape(one)) for name, one in gradient.items() if name != "inputs"}
    same, tangents = ready.jvp(start, t_span, {**others, "inputs": of_inputs}, **options, **values)
    assert np.array_equal(same.x, plain.x) and set(tangents.rule) == set(gradient.rule)
    products = [gradient[name] * one for name, one in others.items()]
    products += [gradient["inputs"][name] * one for name, one in of_inputs.items()]
    backward, size = sum(one.sum() for one in products), sum(np.abs(one).sum() for one in products)
    assert abs(backward - product(weights, tangents)) <= 2.0**10 * UNIT_ROUNDOFF * size

    def moved(by):
        at = {name: values.get(name, np.zeros(one.shape)) for name, one in of_inputs.items()}
        missing = {name: ready.inputs.values[ready.inputs.indices[name]] for name in at if name not in values}
        at = {name: np.asarray((at | missing)[name]) + by * of_inputs[name] for name in at}
        return product(weights, ready.run(start, t_span, **options, **at))

    differences = sum(w * (moved(k * DISTANCE) - moved(-k * DISTANCE)) / DISTANCE for k, w in enumerate(WEIGHTS, 1))
    _, alone = ready.jvp(start, t_span, {"inputs": of_inputs}, **options, **values)
    assert abs(product(weights, alone) - differences) <= DIFFERENCE_ERROR * size
    return gradient


@pytest.mark.thinned(1)
@pytest.mark.parametrize("span", ["forward", "backward", "times"])
@pytest.mark.parametrize("case", COMPILED, ids=named)
def test_compiled_derivatives_by_inputs_are_those_of_runs(case, span):
    gradient = assert_derivatives(case, span, case[2], case[4], 5)
    assert gradient.rule["inputs"] == "exact"


@pytest.mark.parametrize("span", ["brief", "back"])
@pytest.mark.parametrize("case", STEPWISE, ids=named)
def test_derivatives_by_inputs_step_by_step_are_those_of_runs(case, span):
    gradient = assert_derivatives(case, span, case[2], case[4], 6)
    assert gradient.rule["inputs"] == "differences"


@pytest.mark.parametrize("case", [COMPILED[0], COMPILED[7]], ids=named)
def test_undone_steps_give_derivatives_by_inputs(case):
    assert_derivatives(case, "forward", case[2], case[4], 7, "reversible")


@pytest.mark.parametrize(
    "case", [COMPILED[3], COMPILED[7], COMPILED[12], pytest.param(STEPWISE[0], marks=pytest.mark.long)], ids=named
)
def test_derivatives_of_ensembles_by_inputs(case):
    """With values of members some, all of the same, or one state with several values."""
    rng, span = np.random.default_rng(8), "brief" if case in STEPWISE else "forward"
    states = case[2] * (1.0 + 0.05 * rng.standard_normal((3, len(case[2]))))
    first, *_ = case[4]
    own = {first: case[4][first] + 0.1 * rng.standard_normal((3, *np.shape(case[4][first])))}
    for start, values in ((states, case[4]), (states, {**case[4], **own}), (case[2], {**case[4], **own})):
        together = assert_derivatives(case, span, start, values, 9)
        assert together["x0"].shape == states.shape


@pytest.mark.parametrize("case", [COMPILED[3], COMPILED[7], COMPILED[12]], ids=named)
def test_each_member_has_the_derivatives_of_its_own_run(case):
    system, method, x0, inputs, given, attitude = case
    rng = np.random.default_rng(10)
    states = x0 * (1.0 + 0.05 * rng.standard_normal((3, len(x0))))
    values = {name: one + 0.1 * rng.standard_normal((3, *np.shape(one))) for name, one in given.items()}
    ready = co.prepare(system, method, 0.05, attitude=attitude, inputs=inputs, threads=2)
    sol, pullback = ready.vjp(states, (0.5, 1.5), 7, **values)
    weights = {name: rng.standard_normal(one.shape) for name, one in outputs(sol).items()}
    gradient = pullback(**weights)
    directions = {name: rng.standard_normal(one.shape) for name, one in values.items()}
    _, tangents = ready.jvp(states, (0.5, 1.5), {"inputs": directions}, 7, **values)
    for m in range(3):
        own = {name: one[m] for name, one in values.items()}
        sol, pullback = ready.vjp(states[m], (0.5, 1.5), 7, **own)
        alone = pullback(**{name: one[:, m] for name, one in weights.items()})
        np.testing.assert_array_equal(gradient["x0"][m], alone["x0"])
        for name in given:
            # The products of the energy are summed in another order.
            size = np.abs(alone["inputs"][name]).max()
            np.testing.assert_allclose(
                gradient["inputs"][name][m], alone["inputs"][name], rtol=0, atol=2.0**6 * UNIT_ROUNDOFF * size
            )
        of_member = {name: one[m] for name, one in directions.items()}
        _, one = ready.jvp(states[m], (0.5, 1.5), {"inputs": of_member}, 7, **own)
        np.testing.assert_array_equal(tangents.x[:, m], one.x)


def test_the_derivative_by_inputs_is_that_by_the_linear_term():
    linear = np.array([0.3, -0.1, 0.2])
    H = co.Quadratic([1.0, 0.7, 0.4], linear=linear)
    for method in (co.Splitting(order=4, parts="coordinates"), co.GaussLegendre(2)):
        system = co.LiePoissonSystem(co.algebras.so(3), H)
        _, own = co.prepare(system, method, 0.05).vjp(X3, (0.0, 2.0))
        _, steered = co.prepare(system, method, 0.05, inputs=True).vjp(X3, (0.0, 2.0), linear=linear)
        expected, found = (pullback(np.ones((41, 3))) for pullback in (own, steered))
        np.testing.assert_allclose(found["inputs"]["linear"], expected["linear"], rtol=2.0**9 * UNIT_ROUNDOFF)
        assert not found["linear"].any()
        np.testing.assert_allclose(found["M"], expected["M"], rtol=2.0**9 * UNIT_ROUNDOFF)


@pytest.mark.parametrize("method", [co.Splitting(order=2), co.GaussLegendre(2)], ids=str)
def test_parameters_do_not_move_coefficients_that_are_inputs(method):
    """The field of all spins acts on those coordinates that inputs have not replaced."""

    def run(by):
        spins = co.systems.spin_lattice(shape=3, field=np.array([0.1, 0.2, 0.3]) + by)
        ready = co.prepare(spins, method, 0.05, inputs={"B": (0, 7)})
        return ready, ready.run(UNIT_SPINS, (0.0, 1.0), B=[0.3, -0.2]).x

    ready, _ = run(np.zeros(3))
    _, tangents = ready.jvp(UNIT_SPINS, (0.0, 1.0), {"field": np.eye(3)}, B=[0.3, -0.2])
    for k, unit in enumerate(np.eye(3)):
        moved = ((run(j * DISTANCE * unit)[1], run(-j * DISTANCE * unit)[1]) for j in range(1, 5))
        differences = sum(w * (one - other) / DISTANCE for w, (one, other) in zip(WEIGHTS, moved, strict=True))
        np.testing.assert_allclose(tangents.x[..., k], differences, rtol=0, atol=DIFFERENCE_ERROR)


DAMPED = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.4], linear=[0.1, 0.2, 0.3])).with_forces(
    co.forces.DoubleBracketDamping(0.3)
)


@pytest.mark.parametrize(
    ("system", "method", "name", "x0"),
    [
        (TOP, co.CommutatorFree(), "lever", X6),
        (CUBIC, co.Taylor(order=4), "coefficients", X3),
        (DAMPED, co.Splitting(order=2), "linear", X3),
    ],
    ids=["steps in Python", "coefficients", "flow of a force"],
)
def test_differences_by_parameters_keep_coefficients_that_are_no_inputs(system, method, name, x0):
    """Systems with moved parameters have their own linear terms where no input has replaced them."""
    rates, span = {"u": (1,)}, (0.0, 0.15)
    ready = co.prepare(system, method, 0.05, inputs=rates)
    value, rng = ready.parameters[name], np.random.default_rng(9)
    direction = rng.standard_normal(value.shape)

    def run(by):
        moved = co.prepare(with_parameters(system, {name: value + by * direction}), method, 0.05, inputs=rates)
        return moved.run(x0, span, u=[0.3]).x

    _, tangents = ready.jvp(x0, span, {name: direction}, u=[0.3])
    moved = ((run(j * DISTANCE), run(-j * DISTANCE)) for j in range(1, 5))
    differences = sum(w * (one - other) / DISTANCE for w, (one, other) in zip(WEIGHTS, moved, strict=True))
    assert np.max(np.abs(differences)) > 0.01
    np.testing.assert_allclose(tangents.x, differences, rtol=0, atol=DIFFERENCE_ERROR)


def test_several_directions_of_inputs_are_carried_together():
    ready = co.prepare(TOP, co.Splitting(order=4), 0.05, inputs=FIELDS)
    units = {"fields": np.zeros((2, 2, 5)), "rotor": np.zeros((1, 5))}
    for k, (name, *index) in enumerate([("fields", 0, 0), ("fields", 0, 1), ("fields", 1, 0), ("rotor", 0)]):
        units[name][(*index, k)] = 1.0
    _, tangents = ready.jvp(X6, (0.0, 1.0), {"inputs": units}, 20, **FOUR)
    for k in range(5):
        _, one = ready.jvp(X6, (0.0, 1.0), {"inputs": {n: u[..., k] for n, u in units.items()}}, 20, **FOUR)
        np.testing.assert_allclose(tangents.x[..., k], one.x, rtol=0, atol=2.0**6 * UNIT_ROUNDOFF)
        np.testing.assert_allclose(tangents.energy[..., k], one.energy, rtol=0, atol=2.0**6 * UNIT_ROUNDOFF)
    assert not tangents.x[..., 4].any()


READY = co.prepare(BODY, co.Splitting(), 0.125, inputs=RATES)


@pytest.mark.parametrize(
    ("directions", "error", "words"),
    [
        ({"inputs": [1.0, 2.0]}, TypeError, "the direction inputs is [1.0, 2.0]; give a mapping from names of inputs"),
        ({"inputs": {"rate": [1.0, 2.0]}}, ValueError, "unknown input of this run 'rate'; did you mean 'rates'"),
        ({"inputs": {"rates": [1.0]}}, ValueError, "the direction inputs.rates has the shape (1,); it must be (2,)"),
        ({"rates": [1.0, 2.0]}, ValueError, "unknown direction of this run 'rates'"),
        ({"inputs": {}}, ValueError, "no direction was given; the names are x0, inertia, inputs"),
        ({"inputs": {"rates": np.ones((2, 3))}, "x0": X3}, ValueError, "the directions differ in number"),
    ],
)
def test_wrong_directions_of_inputs_are_refused(directions, error, words):
    with pytest.raises(error, match=re.escape(words)):
        READY.jvp(X3, (0.0, 1.0), directions, rates=[0.1, 0.2])


def test_wrong_inputs_are_refused():
    for call in (READY.vjp, lambda *args, **given: READY.jvp(*args, {"x0": X3}, **given)):
        with pytest.raises(ValueError, match="rates has the shape"):
            call(X3, (0.0, 1.0), rates=[0.1])
        with pytest.raises(ValueError, match="unknown input"):
            call(X3, (0.0, 1.0), rotor=[0.1])
    with pytest.raises(TypeError, match="prepared without inputs"):
        co.prepare(BODY, co.Splitting(), 0.125).vjp(X3, (0.0, 1.0), rates=[0.1, 0.2])


@pytest.mark.parametrize("method", [co.Splitting(order=2), co.Splitting(order=4), co.GaussLegendre(2)], ids=str)
@pytest.mark.parametrize("system", [BODY, FULL], ids=["body", "full"])
def test_tangents_by_new_inputs_are_no_new_preparation(system, method):
    """A derivative at new values costs at most ten steps; preparing would take a hundred."""
    step, values = co.stepper(system, method, 0.1, inputs=RATES), np.linspace(-0.5, 0.5, 80).reshape(40, 2)
    times = {}
    for call in (step, step.tangent_by_inputs, step.tangent):
        call(X3, rates=[0.0, 0.0])
        elapsed = []
        for value in values:
            begin = time.perf_counter()
            call(X3, rates=value)
            elapsed.append(time.perf_counter() - begin)
        times[call] = min(elapsed)
    assert max(times[step.tangent_by_inputs], times[step.tangent]) <= 10 * times[step]
