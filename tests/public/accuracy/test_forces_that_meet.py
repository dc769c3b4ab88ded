"""Forces side by side, in every order: the declared order of convergence, and laws that see their sample."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from long import long_beyond
from matrix.cases import value_of
from matrix.forces import force_on, is_noise
from satellite_forces import CASES, PERIOD, SPIN, TENSOR, TURNED, Case, F, error_of, path, reference_of, together

ON_ORBITS = {"DoubleBracketDamping", "HamiltonianNoise", "HeatBath", "RandomTorque"}  # no torques of the state


def torque(x, A, t):
    """Return a torque of everything, in the body frame."""
    return np.array([0.4 * A[2, 1] - 0.2 * x[0], 0.3 * np.sin(2.0 * t) * A[0, 2], -0.3 * x[2] * A[1, 0]])


def torque_by_hand(t, omega, A, L):
    return np.array([0.4 * A[2, 1] - 0.2 * L[0], 0.3 * np.sin(2.0 * t) * A[0, 2], -0.3 * L[2] * A[1, 0]])


def gravity_by_hand(t, omega, A):
    r = A.T @ path(t)
    return 3 * 0.8 * np.cross(r, TENSOR @ r) / np.linalg.norm(r) ** 5


def drag(x, t, tau):
    """Return the flow of x' = -0.4 |x| x on the momentum of the body."""
    y = x.copy()
    y[:3] = x[:3] / (1.0 + 0.4 * np.abs(x[:3]) * tau)
    return y


RATES = np.array([0.5, 0.3, 0.7])
KINDS = {
    "Torque": Case(F.Torque(torque), torque_by_hand, of_momentum=True),
    "LinearDamping": Case(F.LinearDamping(RATES), lambda t, omega, A, L: -RATES * L, of_momentum=True),
    "OwnForce": Case(F.OwnForce(drag), lambda t, omega, A, L: -0.4 * np.abs(L) * L, of_momentum=True),
    "GravityGradient": Case(F.GravityGradient(0.8, path), gravity_by_hand),
    **{name.partition(" ")[0]: case for name, case in CASES.items() if not name.startswith("GravityGradient")},
}


def on_body(names):
    """Return the cases of these names, with the rates of the damping for all coordinates of the body."""
    cases = [KINDS[name] for name in names]
    bare = together([case for case in cases if not isinstance(case.force, F.LinearDamping)])
    dim = bare.system.dim if bare.force else bare.free.dim
    rates = np.r_[RATES, np.zeros(dim - 3)]
    return [
        case._replace(force=F.LinearDamping(rates)) if isinstance(case.force, F.LinearDamping) else case
        for case in cases
    ]


def ends(case, begin, span, steps):
    """Return the end of a run by steps in NumPy, which the kernels have to rounding."""
    system, h, x = case.system, span / steps, case.start
    method = co.methods.Forced(co.Splitting())
    for k in range(steps):
        x = method.step(system, x, begin + k * h, h)
    return x


def check_orders(cases, begin):
    """Check that the error of order two falls by 16 from steps of 1/16 to 1/64, less half an order.

    A pulse that ends within a step h is off by up to h^2/8 times its acceleration, 0.5/1.2, by the phase of its end:
    two pulses about each of three axes, counted twice for the laws that see the error.
    """
    case, wanted = together(cases), reference_of(cases, begin, begin + 1.0)
    coarse, fine = (error_of(case, ends(case, begin, 1.0, steps), wanted) for steps in (16, 64))
    if any(one.actuator == "thrusters" for one in cases):
        assert fine < 2 * 6 * 0.5 / 1.2 / 8 / 64**2, fine
    else:
        assert fine < 1e-4 and np.log2(coarse / fine) / 2 > 1.5, (coarse, fine)


@pytest.mark.thinned(66)
@pytest.mark.parametrize("begin", [0.0, -1.5])
@pytest.mark.parametrize("pair", [*itertools.permutations(KINDS, 2)], ids=" then ".join)
def test_pairs_of_forces_on_a_body(pair, begin):
    check_orders(on_body(pair), begin)


SAMPLED = [name for name in KINDS if issubclass(getattr(F, name), F.Sampled)]
IN_PAIRS = {"BDot", "Magnetorquers", "WheelFriction"}
"""Tested in pairs alone: triples are many."""


@pytest.mark.thinned(96)
@pytest.mark.parametrize("begin", [0.0, 3.5])
@pytest.mark.parametrize("order", range(6))
@pytest.mark.parametrize("other", [name for name in KINDS if name not in {*SAMPLED, *IN_PAIRS}])
@pytest.mark.parametrize("pair", [*itertools.combinations(sorted({*SAMPLED} - IN_PAIRS), 2)], ids=" and ".join)
def test_triples_with_sampled_laws(pair, other, order, begin):
    three = [*itertools.permutations((*pair, other))][order]
    check_orders(on_body(three), begin)


@pytest.mark.thinned(9)
@pytest.mark.parametrize("other", sorted({*KINDS} - {*SAMPLED} | ON_ORBITS))
@pytest.mark.parametrize("pair", [*itertools.combinations(SAMPLED, 2)], ids=" and ".join)
def test_a_law_sees_the_state_of_its_sample(pair, other):
    """What is held after a step is, in every bit, what is held if the force is alone, whatever acts beside it."""
    cases = [KINDS[name] for name in pair]
    body = together([*cases, *(KINDS[name] for name in (other,) if name in KINDS)])
    free, rotors = body.free, body.rotors
    method, h, t = co.methods.Forced(co.Splitting()), PERIOD, -4.0
    held = {}
    for case in cases:
        alone = free.with_forces(case.force)
        x = method.step(alone, alone.state(TURNED, SPIN, **rotors), t, h)
        held[type(case.force)] = x[free.dim :]
    force = {
        "DoubleBracketDamping": F.DoubleBracketDamping(0.2),
        "HamiltonianNoise": F.HamiltonianNoise(np.eye(free.dim)[:2], 0.3, seed=4),
        "HeatBath": F.HeatBath(0.2, temperature=0.3, seed=4),
        "RandomTorque": F.RandomTorque(0.3, "space", seed=4),
    }
    third = force[other] if other in force else on_body([*pair, other])[-1].force
    for order in itertools.permutations([*(case.force for case in cases), third]):
        system = free.with_forces(*order)
        x = method.step(system, system.state(TURNED, SPIN, **rotors), t, h)
        found = {type(one): x[free.dim + one.first :] for one in system.forces if isinstance(one, F.Sampled)}
        for kind, numbers in held.items():
            np.testing.assert_array_equal(found[kind][: len(numbers)], numbers)


@pytest.mark.parametrize("first", [True, False])
def test_a_constant_disturbance_is_held_by_a_sampled_spring(first):
    """Where stiffness times the error is the disturbance, 0.05, for any step and any order of the forces."""
    pair = [F.Sampled(F.Pointing(1.0, 1.5), period=0.5), F.Torque((0.05, 0.0, 0.0))]
    sat = co.systems.body((1.0, 1.0, 1.0)).with_forces(*(pair if first else pair[::-1]))
    for h in (0.5, 0.125):
        angle = co.integrate(sat, sat.state(), (0, 60), h).rotation[-1].as_rotvec()
        # Deviations decay as exp(-0.7 t) or faster.
        np.testing.assert_allclose(angle, (np.arcsin(0.05), 0.0, 0.0), rtol=0, atol=1e-12)


def three_forces(*kinds):
    """Return a body with a torque before two sampled forces, and a state."""
    law = F.Pointing(0.5, 1.5)
    forces = [F.Torque(lambda t: np.array([0.3 * np.cos(t), 0.1, -0.2 * np.sin(2.0 * t)])), F.Sampled(law, 0.5)]
    forces.append(F.Thrusters(law, 0.25, 0.4))
    sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(*(forces[k] for k in kinds))
    return sat, sat.state(TURNED, SPIN)


@pytest.mark.parametrize("kinds", [(0, 1, 2), pytest.param((2, 0, 1), marks=pytest.mark.long)])
def test_kernels_steppers_and_derivatives_sample_as_the_steps_in_numpy(kinds):
    sat, x0 = three_forces(*kinds)
    h, span, method = 0.125, (-1.0, 0.5), co.Splitting()
    ready, plain = co.prepare(sat, method, h), co.methods.Forced(method)
    run = ready.run(x0, span)
    x, step = x0, co.stepper(sat, method, h)
    for k, t in enumerate(run.t[:-1]):
        np.testing.assert_array_equal(step(run.x[k], t), run.x[k + 1])
        x = plain.step(sat, x, t, h)
        # A step has less than 1e3 operations on numbers below 2.
        np.testing.assert_allclose(run.x[k + 1], x, rtol=0, atol=2e3 * (k + 1) * 2.0**-53)
    wanted = {"x0": np.cos(np.arange(len(x0))), "Sampled.law.damping": 1.0, "Thrusters.law.stiffness": 1.0}
    _, tangents = ready.jvp(x0, span, {name: np.asarray(value)[..., None] for name, value in wanted.items()})
    _, pullback = ready.vjp(x0, span)
    weights = np.zeros(run.x.shape)
    weights[-1] = np.sin(1.0 + np.arange(len(x0)))
    change, gradient = np.asarray(tangents.x)[-1, :, 0], pullback(weights)
    assert weights[-1] @ change == pytest.approx(sum(np.sum(gradient[n] * wanted[n]) for n in wanted), abs=1e-9)
    e, ends = 1e-5, []
    for way in (e, -e):
        given = {name.partition(".")[0]: way for name in wanted}
        forces = [
            replace(f, law=replace(f.law, damping=1.5 + given["Sampled"]))
            if f.label == "Sampled"
            else replace(f, law=replace(f.law, stiffness=0.5 + given["Thrusters"]))
            if f.label == "Thrusters"
            else f
            for f in sat.forces
        ]
        moved = co.systems.body((1.0, 2.0, 2.5)).with_forces(*forces)
        ends.append(follow(moved, x0 + way * wanted["x0"], span, h))
    # Differences have errors of e^2 and u / e.
    np.testing.assert_allclose(change, (ends[0] - ends[1]) / (2 * e), rtol=0, atol=1e-8)


def follow(system, x, span, h):
    """Return the end of steps in NumPy."""
    method = co.methods.Forced(co.Splitting())
    for k in range(round((span[1] - span[0]) / h)):
        x = method.step(system, x, span[0] + k * h, h)
    return x


@pytest.mark.long
@pytest.mark.parametrize("kinds", [*itertools.permutations(range(3))], ids=str)
def test_xla_samples_as_the_kernels(kinds):
    jax, (sat, x0) = pytest.importorskip("jax"), three_forces(*kinds)
    ready, span = co.prepare(sat, co.Splitting(), 0.125), (-1.0, 0.5)
    jax.config.update("jax_enable_x64", True)
    try:
        found = np.asarray(co.jax.solution(ready, span, backend="xla")(x0))
    finally:
        jax.config.update("jax_enable_x64", False)
    np.testing.assert_allclose(found, ready.run(x0, span).x, rtol=0, atol=1e-12)


SYSTEMS = (
    "co.systems.rigid_body((1.0, 2.0, 2.5))",
    "co.systems.spin_lattice('chain', 3)",
    "co.systems.torus_euler(N=3)",
    "co.systems.sphere_euler(N=4, rotation=0.7)",
)


def torques(system):
    """Return torques of the time and of both on a system of vectors."""
    k = np.arange(system.dim)
    return [F.Torque(lambda t: 0.3 * np.cos(t + k)), F.Torque(lambda x, t: 0.3 * np.sin(t + x[::-1]))]


def forces_with_a_field(text):
    """Return the registered forces that act on a system and are not random."""
    system, found = value_of(text), []
    for name in F.names():
        if not issubclass(getattr(F, name), F.Sampled) and not is_noise(name):
            try:
                found += system.with_forces(force_on(name, system)).forces
            except (TypeError, ValueError, AttributeError):
                continue
    return found + ([] if system.has_matrices else torques(system))


@pytest.mark.parametrize("way", long_beyond(1, [-1.0, 1.0]))
@pytest.mark.parametrize("text", long_beyond(1, SYSTEMS))
def test_pairs_of_forces_on_systems(text, way):
    """Against DOP853 on their field, from a time other than zero, forward, and backward if both act backward."""
    system, method = value_of(text), co.methods.Forced(co.IsospectralGauss(1) if "euler" in text else co.Splitting())
    x0 = system.random(seed=1) if system.has_matrices else np.random.default_rng(1).normal(size=system.dim)
    begin, start = 0.7 * way, system.to_vector(x0) if system.has_matrices else x0
    for pair in itertools.permutations(forces_with_a_field(text), 2):
        forced = system.with_forces(*pair)
        if way < 0.0 and not forced.reversible:
            continue

        def field(t, y, forced=forced):
            if not system.has_matrices:
                return forced.vector_field(y, t)
            return system.to_vector(forced.vector_field(system.algebra.projected(system.from_vector(y)), t))

        wanted = solve_ivp(field, (begin, begin + way), start, "DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
        errors = []
        for steps in (8, 16):
            y = start
            for k in range(steps):
                y = method.step(forced, y, begin + way * k / steps, way / steps)
            errors.append(np.abs(y - wanted).max())
        assert errors[1] < 1e-10 or np.log2(errors[0] / errors[1]) > 1.5, (pair, errors)


@pytest.mark.parametrize("x0", [[0.0, 0.1, 0.2, 0.3, 0.4], [0.1, 0.2, 0.3, 0.0, 0.4]])
@pytest.mark.parametrize("method", [co.Splitting(), co.ExplicitRungeKutta()], ids=str)
def test_a_casimir_without_a_value_does_not_end_a_damped_run(x0, method):
    """log|x| at x = 0, where damping leaves it: the motion is that of DOP853, and the energy keeps its balance."""
    algebra = co.algebras.get("A5,25", p=0.5, b=0.75)
    system = co.LiePoissonSystem(algebra, co.Quadratic(np.eye(5)))
    damped = co.integrate(system.with_forces(co.forces.LinearDamping(0.1)), x0, (0, 1), 0.01, method)
    rate = lambda t, x: system.structure_matrix(x) @ x - 0.1 * x  # noqa: E731
    expected = solve_ivp(rate, (0, 1), x0, method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(damped.x[-1], expected, atol=1e-4)  # of order two: 0.01^2 by rates of about one
    deviations = dict(damped.balance())
    assert np.max(np.abs(deviations.pop("energy"))) < 1e-4
    assert deviations and all(np.isnan(np.max(values)) for values in deviations.values())
