"""States and solutions of bodies in space: attitudes, velocities, members, archives, events, derivatives."""

import numpy as np
import pytest
from pairs_of_bodies import (
    MASSES,
    PLACES,
    SHAPES,
    SPEEDS,
    SPINS,
    TURNED,
    S,
    pair_of_bodies,
    splitting,
    spring,
    spring_slopes,
)

import coadjoint as co
from refusals import refused


def test_states_from_matrices_rotations_and_quaternions():
    pair = S.gravitating_bodies(SHAPES, MASSES)
    wanted = pair.state(PLACES, SPEEDS, TURNED, SPINS)
    quaternions, matrices = TURNED.as_quat(), TURNED.as_matrix()
    scalar_first = quaternions[:, [3, 0, 1, 2]]
    for given, options in (
        (matrices, {}),
        (list(TURNED), {}),
        ([TURNED[0], matrices[1]], {}),
        ([TURNED[0], quaternions[1][[3, 0, 1, 2]]], {"scalar_first": True}),
        ([matrices[0], TURNED[1]], {}),
        (quaternions, {}),
        ([TURNED[0], quaternions[1]], {}),
        (scalar_first, {"scalar_first": True}),
        ([TURNED[0], scalar_first[1]], {"scalar_first": True}),
        ([scalar_first[0], TURNED[1]], {"scalar_first": True}),
    ):
        np.testing.assert_allclose(pair.state(PLACES, SPEEDS, given, SPINS, **options), wanted, rtol=0, atol=4e-16)
    space = np.einsum("kij,kj->ki", matrices, SPINS)
    for given, options in (
        (np.degrees(SPINS), {"degrees": True}),
        (space, {"frame": "space"}),
        (np.degrees(space), {"frame": "space", "degrees": True}),
    ):
        found = pair.state(PLACES, SPEEDS, TURNED, given, **options)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=2e-15)
    np.testing.assert_array_equal(pair.positions(wanted), PLACES)
    np.testing.assert_allclose(pair.velocities(wanted), SPEEDS, rtol=1e-15, atol=1e-17)
    np.testing.assert_allclose(pair.angular_velocity(wanted), SPINS, rtol=0, atol=1e-15)
    np.testing.assert_allclose(pair.angular_velocity(wanted, frame="space"), space, rtol=0, atol=1e-15)
    np.testing.assert_allclose(pair.momentum(SPINS), pair.angular_momentum(wanted), rtol=0, atol=1e-15)
    many = pair.state(np.stack([PLACES] * 3), SPEEDS, matrices, SPINS)
    np.testing.assert_array_equal(many, [wanted] * 3)
    resting = pair.state(PLACES)
    assert not pair.angular_momentum(resting).any() and (pair.attitudes(resting) == np.eye(3)).all()
    body = S.body(SHAPES[0])
    one = body.state(TURNED[0], SPINS[0])
    np.testing.assert_array_equal(one, body.state(matrices[0], SPINS[0]))
    assert body.attitudes(one).shape == (3, 3) and body.angular_velocity(one).shape == (3,)
    np.testing.assert_array_equal(body.momentum([SPINS[0]] * 4), [one[:3]] * 4)
    np.testing.assert_array_equal(S.body(attitude=False).state(angular_velocity=(1, 2, 4)), [1.0, 4.0, 10.0])
    # Rounded matrices become rotations to the last digits.
    A = body.attitudes(body.state(matrices[0].round(8)))
    assert np.abs(A @ A.T - np.eye(3)).max() < 1e-15 and np.abs(A - matrices[0]).max() < 2e-8


def test_impossible_bodies_warn_by_number():
    with pytest.warns(UserWarning, match=r"inertias\[1\]"):
        S.gravitating_bodies([(1, 1, 1), (1, 1, 3)])


def test_solutions_of_members_and_of_batches():
    pair, x0 = pair_of_bodies()
    heavier = S.gravitating_bodies(SHAPES, (4.0, 2.0))
    members = np.stack([x0, heavier.state(PLACES, SPEEDS, TURNED, SPINS)])
    many = co.integrate(co.batch([pair, heavier]), members, (0, 1), 0.1, splitting(2))
    assert many.positions.shape == many.velocities.shape == many.angular_velocity.shape == (11, 2, 2, 3)
    np.testing.assert_allclose(many.velocities[0], [SPEEDS] * 2, rtol=0, atol=1e-15)
    assert len(many.rotation) == 44 and many.angular_momentum.shape == (11, 2, 2, 3)
    one = co.integrate(heavier, members[1], (0, 1), 0.1, splitting(2))
    np.testing.assert_array_equal(one.positions, many.positions[:, 1])
    toda = S.toda(3)
    run = co.integrate(toda, np.ones(toda.dim), (0, 1), 0.1)
    for name in ("positions", "velocities", "angular_velocity", "angular_momentum", "rotation"):
        with refused(TypeError, "toda"):
            getattr(run, name)


def test_stored_runs_have_the_motion_of_bodies(tmp_path):
    pair, x0 = pair_of_bodies()
    sol = co.integrate(pair, x0, (0, 1), 0.1, splitting(2))
    again = co.results.rebuild(sol.to_xarray())
    archived = co.integrate(pair, x0, (0, 1), 0.1, splitting(2), archive=tmp_path / "run.zarr")
    for found in (again, archived):
        for name in ("positions", "velocities", "angular_velocity", "angular_momentum"):
            np.testing.assert_array_equal(getattr(found, name), getattr(sol, name))
        np.testing.assert_array_equal(found.rotation.as_matrix(), sol.rotation.as_matrix())


def test_contact_is_an_event_and_states_are_found_between_steps():
    """Two balls fall on each other from rest."""
    pair = S.gravitating_bodies([(0.4, 0.4, 0.4)] * 2, (1.0, 1.0))
    x0 = pair.state([[-1.0, 0, 0], [1.0, 0, 0]])

    def gap(x):
        return np.sqrt(((x[33:36] - x[30:33]) ** 2).sum()) - 0.5

    sol = co.integrate(pair, x0, (0, 4), 0.01, splitting(6), events=co.Event(gap, terminal=True))
    eta = np.arccos(np.sqrt(0.25))
    wanted = np.sqrt(2.0**3 / (2 * 2.0)) * (eta + np.sqrt(0.25) * np.sin(eta))
    assert sol.t_span[1] == pytest.approx(wanted, abs=1e-9)
    at = sol.at(0.123).x
    np.testing.assert_allclose(at, co.integrate(pair, x0, (0, 0.123), 0.123 / 12, splitting(6)).x[-1], atol=1e-9)


def test_derivatives_of_runs_of_bodies():
    """By the state, forward and backward, and by masses and inertias of free bodies."""
    pair, x0 = pair_of_bodies()
    ready = co.prepare(pair, splitting(4), 0.05)
    rng = np.random.default_rng(3)
    d, w = rng.standard_normal((2, 37)) * (np.arange(37) < 36)  # not by the coordinate that must be 1
    _, tangents = ready.jvp(x0, (0, 1), {"x0": d[:, None]})
    moved = [ready.run(x0 + h * d, (0, 1)).x[-1] for h in (1e-5, -1e-5)]
    np.testing.assert_allclose(tangents.x[-1][:, 0], (moved[0] - moved[1]) / 2e-5, rtol=0, atol=1e-6)
    _, pullback = ready.vjp(x0, (0, 1), save_every=20)
    assert pullback(np.stack([0.0 * w, w]))["x0"] @ d == pytest.approx(w @ tangents.x[-1][:, 0], rel=1e-11)
    given = co.prepare(S.bodies(SHAPES, MASSES, spring, spring_slopes), splitting(2), 0.05)
    with refused(TypeError, "hessian="):
        given.jvp(x0, (0, 1), {"x0": d[:, None]})
    for system, start in ((S.bodies(SHAPES[:1] * 2, MASSES), x0), (S.body(SHAPES[1]), x0[:12])):
        prepared = co.prepare(system, splitting(2), 0.05)
        for name in {"inertia", "inertias", "masses"} & set(system.parameters):
            value = np.array(system.parameters[name])
            direction = value * rng.uniform(0.5, 1.0)
            _, found = prepared.jvp(start, (0, 1), {name: direction[..., None]})
            ends = [
                co.integrate(
                    S.get(system.name, **(system.parameters | {name: value + h * direction})),
                    start,
                    (0, 1),
                    0.05,
                    splitting(2),
                ).x[-1]
                for h in (1e-5, -1e-5)
            ]
            np.testing.assert_allclose(found.x[-1][:, 0], (ends[0] - ends[1]) / 2e-5, rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    "system",
    [
        S.rigid_body(SHAPES[1]),
        S.gyrostat((1.0, 2.0, 2.5), (0.3, -0.2, 0.5)),
        S.heavy_top(SHAPES[0], (0.1, 0.2, 0.9)),
        S.kovalevskaya_top(),
        S.kirchhoff_body(),
        S.satellite(),
    ],
    ids=lambda system: system.name,
)
def test_angular_velocities_of_classical_bodies(system):
    """A' = A hat(Omega), by differences of the attitude."""
    x0 = np.array([0.3, -0.2, 0.5, 0.6, 0.0, 0.8, 3.0, 1.0, -2.0, 1.0])[: system.dim]
    if system.name == "satellite":
        x0[3:6] *= 50.0
    h = 1e-3
    sol = co.integrate(system, x0, (0, 2 * h), h, co.Splitting(order=6), attitude=True)
    A = sol.attitude[:, 1:4, 1:4] if system.name == "satellite" else sol.attitude[:, :3, :3]
    hat = A[1].T @ (A[2] - A[0]) / (2 * h)
    np.testing.assert_allclose(sol.angular_velocity[1], [hat[2, 1], hat[0, 2], hat[1, 0]], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(sol.angular_momentum, sol.x[:, :3])


def test_a_satellite_in_its_own_frame_is_the_same_motion():
    """The classical form beside positions in space, with a planet that is heavy."""
    inertia, mass, gravity = (1.0, 2.0, 2.5), 2.0, 1.5
    classical = S.satellite(inertia, mass, gravity)
    pair = S.gravitating_bodies([(0, 0, 0), inertia], [1e14, mass], G=gravity / 1e14)
    A, r, v, omega = TURNED[0].as_matrix(), np.array([5.0, 1.0, 0.5]), np.array([0.1, 0.5, 0.1]), np.array(SPINS[0])
    first = np.eye(5)
    first[1:4, 1:4] = A
    x0 = np.r_[np.array(inertia) * omega, mass * A.T @ v, A.T @ r, 1.0]
    sol = co.integrate(classical, x0, (0, 5), 0.01, co.Splitting(order=6), attitude=first)
    x0 = pair.state([[0, 0, 0], r], [[0, 0, 0], v], [np.eye(3), A], [[0, 0, 0], omega])
    found = co.integrate(pair, x0, (0, 5), 0.01, splitting(6))
    turned = sol.attitude[-1][1:4, 1:4]
    np.testing.assert_allclose(found.rotation[-1].as_matrix(), turned, rtol=0, atol=1e-10)
    apart = found.positions[-1, 1] - found.positions[-1, 0]
    np.testing.assert_allclose(apart, turned @ sol.x[-1, 6:9], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.angular_velocity[-1, 1], sol.angular_velocity[-1], rtol=0, atol=1e-10)
