"""Derivatives of runs whose scheme chooses its steps: those of the steps with their lengths fixed; and of batches."""

import dataclasses

import numpy as np
import pytest

import coadjoint as co
from coadjoint.methods.protocol.own_steps import OwnSteps
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.parameters import with_parameters
from group_elements import random_element

WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
DISTANCE = 2.0**-11
DIFFERENCE_ERROR = 2.0**10 * UNIT_ROUNDOFF / DISTANCE

BODY = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5))
TOP = co.systems.heavy_top(inertia=(1.0, 2.0, 2.5), lever=(0.1, 0.2, 1.0))
X3, X6 = np.array([0.3, 1.0, 0.2]), np.array([0.3, 1.0, 0.2, 0.1, 0.4, 0.9])
CASES = {
    "flows": (TOP, co.ReversibleSteps(co.Splitting(order=4), 0.1), X6, (0.5, 3.5), {}, False),
    "flows backward": (TOP, co.ReversibleSteps(co.Splitting(), 0.1), X6, (0.5, -2.5), {}, False),
    "times": (BODY, co.ReversibleSteps(co.Splitting(), 0.1), X3, (0.5, 3.5), {"t_eval": [0.5, 1.5, 3.5]}, False),
    "stages": (BODY, co.ReversibleSteps(co.GaussLegendre(2), 0.2), X3, (0.5, -2.5), {"t_eval": [-0.5, -2.5]}, False),
    "series": (BODY, co.Taylor(order=8, tolerance=1e-10), X3, (0.5, 3.5), {}, False),
}


def lengths_of_steps(method, system, x, span):
    """Return the lengths of the steps of a scheme; states are those of the steps in Python."""
    sign, elapsed, memory, found = np.sign(span[1] - span[0]), 0.0, None, []
    while True:
        length, memory = method.next_length(system, x, sign, memory)
        if sign * (elapsed + length) > sign * (span[1] - span[0]):
            return found
        found.append(float(length))
        x = method.fixed_steps.step(system, x, span[0] + elapsed, found[-1])
        elapsed += found[-1]


def fixed_run(system, base, x, t0, lengths, times):
    """Return the states at times by steps of these lengths, and partial ones after them."""
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    states = [x]
    for start, length in zip(ends, lengths, strict=False):
        states.append(base.step(system, states[-1], t0 + start, length))
    found = []
    for t in times - t0:
        k = int(np.flatnonzero(np.abs(ends) <= abs(t) * (1 + 1e-14))[-1])
        left = t - ends[k]
        found.append(base.step(system, states[k], t0 + ends[k], left) if abs(left) > 1e-13 else states[k])
    return np.array(found)


@pytest.mark.parametrize("name", CASES)
def test_the_derivative_is_that_of_the_steps_with_fixed_lengths(name):
    system, method, x0, span, options, attitude = CASES[name]
    rng, ready = np.random.default_rng(2), co.prepare(system, method, 1.0, attitude=attitude)
    plain = ready.run(x0, span, **options)
    sol, pullback = ready.vjp(x0, span, **options)
    assert np.array_equal(sol.x, plain.x)
    weights = rng.standard_normal(sol.x.shape)
    directions = {"x0": rng.standard_normal(x0.shape)}
    directions |= {k: rng.standard_normal(v.shape) for k, v in ready.parameters.items()}
    gradient = pullback(weights)
    _, tangents = ready.jvp(x0, span, directions, **options)
    backward = sum(np.sum(gradient[k] * direction) for k, direction in directions.items())
    size = sum(np.sum(np.abs(gradient[k] * direction)) for k, direction in directions.items())
    assert abs(backward - np.sum(weights * tangents.x)) <= 2.0**11 * UNIT_ROUNDOFF * size

    lengths = lengths_of_steps(method, system, x0, span)
    assert len(lengths) > 3

    def after(by):
        other = with_parameters(system, {k: v + by * directions[k] for k, v in ready.parameters.items()})
        x = x0 + by * directions["x0"]
        return np.sum(weights * fixed_run(other, method.fixed_steps, x, span[0], lengths, sol.t))

    np.testing.assert_allclose(after(0.0), np.sum(weights * sol.x), rtol=0, atol=2.0**12 * UNIT_ROUNDOFF)
    if set(gradient.rule.values()) <= {"exact", "differences"}:
        found = sum(w * (after(k * DISTANCE) - after(-k * DISTANCE)) / DISTANCE for k, w in enumerate(WEIGHTS, 1))
        assert abs(backward - found) <= DIFFERENCE_ERROR * size


def test_attitudes_of_own_steps_are_adjoint():
    rng, ready = np.random.default_rng(2), co.prepare(TOP, co.ReversibleSteps(co.Splitting(), 0.1), 1.0, attitude=True)
    sol, pullback = ready.vjp(X6, (0.5, 2.5))
    weights = rng.standard_normal(sol.attitude.shape)
    direction = rng.standard_normal(6)
    _, tangents = ready.jvp(X6, (0.5, 2.5), {"x0": direction})
    gradient = pullback(attitude=weights)
    size = np.sum(np.abs(gradient["x0"] * direction))
    assert abs(gradient["x0"] @ direction - np.sum(weights * tangents.attitude)) <= 2.0**10 * UNIT_ROUNDOFF * size


def test_steps_of_own_lengths_are_not_undone():
    with pytest.raises(TypeError, match="no steps that can be undone"):
        co.prepare(BODY, co.ReversibleSteps(co.Splitting(), 0.1), 1.0).vjp(X3, (0.0, 1.0), reverse="reversible")


def test_a_thousand_steps_of_own_lengths_take_little_memory(monkeypatch):
    """They store about a kilobyte each."""
    monkeypatch.setattr("coadjoint.memory.available", lambda: 10**8)
    ready = co.prepare(BODY, co.ReversibleSteps(co.Splitting(), 0.1), 300.0, attitude=True)
    pullback = ready.vjp(X3, (0.0, 300.0))[1]
    assert len(pullback._trajectory.stretches) > 1024


@dataclasses.dataclass(frozen=True)
class Unknown(co.ReversibleSteps):
    """A scheme that does not give its steps."""

    fixed_steps = OwnSteps.fixed_steps


def test_schemes_that_do_not_give_their_steps_are_refused_by_name():
    with pytest.raises(TypeError, match=r"Unknown.*define fixed_steps and next_length"):
        co.prepare(BODY, Unknown(co.Splitting(), 0.1), 1.0).vjp(X3, (0.0, 1.0))


BATCH = co.batch([co.systems.rigid_body(inertia=(1.0, 2.0, third)) for third in (2.25, 2.5, 2.75)])


@pytest.mark.parametrize("attitude", [False, True])
@pytest.mark.parametrize("method", [co.Splitting(order=4), co.GaussLegendre(2)], ids=str)
def test_members_of_a_batch_have_the_derivatives_of_single_runs(method, attitude):
    if attitude and isinstance(method, co.GaussLegendre):
        attitude = "coadjoint"
    rng, x0, span = np.random.default_rng(3), np.array([X3, X3[::-1], [0.5, 0.2, 0.9]]), (1.0, -0.5)
    ready = co.prepare(BATCH, method, 0.125, attitude=attitude)
    starts = random_element(BATCH[0].representation, 4, members=3) if attitude else [None] * 3
    start = starts if attitude else None
    assert ready.parameters["inertia"].tolist() == [[1.0, 2.0, 2.25], [1.0, 2.0, 2.5], [1.0, 2.0, 2.75]]
    directions = {"x0": rng.standard_normal((3, 3, 2)), "inertia": rng.standard_normal((3, 3, 2))}
    sol, tangents = ready.jvp(x0, span, directions, save_every=5, attitude=start)
    _, pullback = ready.vjp(x0, span, save_every=5, attitude=start)
    weights = {
        name: rng.standard_normal(getattr(sol, name).shape) for name in ("x", *(["attitude"] if attitude else []))
    }
    gradient = pullback(**weights, energy=sol.energy)
    assert np.array_equal(sol.x, ready.run(x0, span, save_every=5, attitude=start).x)
    assert tangents.x.shape == (*sol.x.shape, 2) and gradient["inertia"].shape == (3, 3)
    for m, system in enumerate(BATCH):
        single = co.prepare(system, method, 0.125, attitude=attitude)
        given = {name: direction[m] for name, direction in directions.items()}
        alone, one = single.jvp(x0[m], span, given, save_every=5, attitude=starts[m])
        assert np.array_equal(sol.x[:, m], alone.x)
        for name in ("x", "energy", "attitude"):
            if getattr(one, name) is not None:
                assert np.array_equal(getattr(tangents, name)[:, m], getattr(one, name))
        _, pullback = single.vjp(x0[m], span, save_every=5, attitude=starts[m])
        found = pullback(**{name: one[:, m] for name, one in weights.items()}, energy=alone.energy)
        assert all(np.array_equal(gradient[name][m], found[name]) for name in found)


def test_directions_of_a_batch_of_other_shapes_are_refused():
    ready = co.prepare(BATCH, co.Splitting(), 0.125)
    with pytest.raises(ValueError, match=r"direction inertia has the shape \(3,\); it must be \(3, 3\)"):
        ready.jvp(X3, (0.0, 1.0), {"inertia": np.ones(3)})
    turning = co.prepare(BATCH, co.Splitting(), 0.125, attitude=True)
    for wrong, shape in ((1.0, r"\(\)"), (np.eye(3)[:2], r"\(2, 3\)")):
        with pytest.raises(ValueError, match=rf"attitude0 has the shape {shape}; its first axis must be that of the 3"):
            turning.jvp(X3, (0.0, 1.0), {"attitude0": wrong})
    _, pullback = ready.vjp(X3, (0.0, 1.0))
    with pytest.raises(ValueError, match=r"x has the shape \(9, 3\)"):
        pullback(np.ones((9, 3)))


COEFFICIENTS = {(1, 0, 0): 0.3, (0, 3, 0): 0.2}
DIFFERENT = {
    "coefficients": [
        co.LiePoissonSystem(co.algebras.so(3), co.Polynomial(terms))
        for terms in (COEFFICIENTS, COEFFICIENTS | {(0, 0, 2): 0.4})
    ],
    "names": [co.systems.gyrostat(rotors=(0.1, 0.2, 0.0)), BODY],
    "forces": [BODY.with_forces(co.forces.LinearDamping(rate)) for rate in (0.1, (0.1, 0.2, 0.3))],
}
SHARED = {"coefficients": [], "names": ["inertia"], "forces": ["inertia", "LinearDamping.toward"]}


@pytest.mark.parametrize("name", DIFFERENT)
def test_gradients_of_a_batch_are_by_the_parameters_of_all_members(name):
    """Those that only some members have, or in another shape, are those of runs of single members."""
    ready = co.prepare(co.batch(DIFFERENT[name]), co.GaussLegendre(2), 0.125)
    assert list(ready.parameters) == SHARED[name]
    x0 = np.array([X3, X3[::-1]])
    sol, pullback = ready.vjp(x0, (0.0, 1.0))
    gradient = pullback(sol.x)
    assert list(gradient) == ["x0", *SHARED[name]] and list(gradient.rule) == SHARED[name]
    for m, system in enumerate(DIFFERENT[name]):
        _, single = co.prepare(system, co.GaussLegendre(2), 0.125).vjp(x0[m], (0.0, 1.0))
        found = single(sol.x[:, m])
        assert all(np.array_equal(gradient[one][m], found[one]) for one in gradient)


def test_the_rule_of_a_batch_is_the_least_exact_of_its_members():
    """Bodies with equal moments have fewer parts, of which the forms change with the moments."""
    bodies = [co.systems.rigid_body(inertia) for inertia in ((1.0, 2.0, 2.5), (2.0, 2.0, 2.5))]
    singles = [co.prepare(body, co.Splitting(), 0.125) for body in bodies]
    rules = [one.jvp(X3, (0.0, 1.0), {"inertia": np.ones(3)})[1].rule for one in singles]
    assert rules == [{"inertia": "exact"}, {"inertia": "added part"}]
    for order in (bodies, bodies[::-1]):
        ready = co.prepare(co.batch(order), co.Splitting(), 0.125)
        sol, tangents = ready.jvp(X3, (0.0, 1.0), {"inertia": np.ones((2, 3))})
        assert tangents.rule == ready.vjp(X3, (0.0, 1.0))[1](sol.x).rule == {"inertia": "added part"}
