"""Angular velocities and momenta of every ready-made body: in its frame and in space, in solutions, datasets, plots."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import coadjoint as co
from refusals import refused

BODIES = [name for name in co.systems.names() if hasattr(co.systems.get(name), "angular_velocity")]
RNG = np.random.default_rng(11)
U = 2.0**-53


def start(system, omega):
    """A state with an angular velocity; beside it random coordinates, and attitudes that are not that of space."""
    count = system.bodies[0] if system.bodies else 1
    turned = Rotation.from_rotvec(np.array([[0.3, -0.5, 0.2], [1.0, 0.2, 0.1]])[:count])
    if hasattr(system, "positions"):
        places = 3.0 * np.arange(count)[:, None] * np.array([1.0, 0.3, 0.2])
        return system.state(places, attitudes=turned, angular_velocities=omega)
    if hasattr(system, "state"):
        return system.state(turned[0], omega)
    rest = np.r_[RNG.standard_normal(system.dim - 4) + 1.0, 1.0] if system.dim > 3 else np.zeros(0)
    try:
        return np.r_[system.momentum(omega), rest]
    except TypeError:  # in a fluid
        return np.r_[omega, rest]


def run_of(name, members=0):
    system = co.systems.get(name)
    omega = np.array([0.2, -0.1, 0.4])
    x0 = start(system, np.stack([omega] * system.bodies[0]) if system.bodies else omega)
    carried = not getattr(system, "has_attitude", False)
    x0 = np.stack([x0] * members) if members else x0
    return co.integrate(system, x0, (0.0, 0.4), 0.1, co.Splitting(order=2), attitude=carried), omega


def test_every_body_is_among_them():
    assert {"rigid_body", "gyrostat", "heavy_top", "lagrange_top", "satellite", "satellite_on_orbit", "body", "bodies",
            "gravitating_bodies", "rigid_molecules", "kirchhoff_body"} <= set(BODIES)  # fmt: skip


@pytest.mark.parametrize("members", [0, 2])
@pytest.mark.parametrize("name", BODIES)
def test_solutions_have_the_motion_in_both_frames(name, members):
    sol, _ = run_of(name, members)
    system = sol.system
    shape = (5, *((members,) if members else ()), *system.bodies, 3)
    A = sol.rotation.as_matrix().reshape(*shape, 3)
    for quantity in ("angular_velocity", "angular_momentum"):
        body = getattr(sol, quantity)
        assert body.shape == shape
        np.testing.assert_array_equal(body, getattr(system, quantity)(sol.x))
        space = sol.in_space(body)
        # Products of three terms, and matrices that SciPy makes orthogonal.
        np.testing.assert_allclose(
            space, np.einsum("...ij,...j->...i", A, body), rtol=0, atol=64 * U * np.abs(body).max()
        )
        if getattr(system, "has_attitude", False):
            np.testing.assert_allclose(space, getattr(system, quantity)(sol.x, frame="space"), rtol=1e-14)
    axis = sol.in_space((0.0, 0.0, 1.0))
    np.testing.assert_allclose(axis, A[..., 2], rtol=0, atol=8 * U)


@pytest.mark.parametrize("name", BODIES)
def test_the_angular_velocity_is_that_of_the_attitude(name):
    """A^T A' is the matrix of the angular velocity in the body; central differences of 2e-3 have errors of 1e-5."""
    sol, _ = run_of(name)
    h = 1e-3
    carried = not getattr(sol.system, "has_attitude", False)
    short = co.integrate(sol.system, sol.x[0], (0.0, 2 * h), h / 2, co.Splitting(order=4), attitude=carried)
    shape = (5, *sol.system.bodies, 3, 3)
    A = short.rotation.as_matrix().reshape(shape)
    spin = np.swapaxes(A[2], -1, -2) @ (A[4] - A[0]) / (2 * h)
    found = np.stack([spin[..., 2, 1], spin[..., 0, 2], spin[..., 1, 0]], axis=-1)
    omega = short.angular_velocity[2]
    if name == "satellite_on_orbit":  # its attitude is relative to the orbital frame
        frame = Rotation.from_matrix(A[2]).inv().apply(np.array([0.0, 0.0, 1.0]))
        found = found + frame * np.linalg.norm(found - omega) / np.linalg.norm(frame)
    np.testing.assert_allclose(found, omega, rtol=0, atol=1e-5 * max(1.0, np.abs(omega).max() ** 3))


@pytest.mark.parametrize("name", BODIES)
def test_momenta_of_angular_velocities(name):
    system, omega = co.systems.get(name), RNG.standard_normal(3)
    omega = np.stack([omega] * system.bodies[0]) if system.bodies else omega
    if name == "kirchhoff_body":
        coupled = np.abs(system.hamiltonian.hessian(np.zeros(6))[:3, 3:]).max() > 0
        if coupled:
            with refused(TypeError, "kirchhoff_body", "angular velocity"):
                system.momentum(omega)
            return
    L = system.momentum(omega)
    x = start(system, omega)
    # Inertia tensors have condition numbers below 1e2.
    np.testing.assert_allclose(system.angular_velocity(x), omega, rtol=0, atol=1e3 * U * np.abs(omega).max())
    np.testing.assert_allclose(system.angular_momentum(x), L, rtol=1e-13)
    np.testing.assert_array_equal(system.momentum(np.stack([omega] * 4)), [L] * 4)
    with refused(ValueError, "angular_velocity", "(2,)"):
        system.momentum((1.0, 2.0))


@pytest.mark.parametrize("name", BODIES)
def test_datasets_have_the_motion_over_axes_of_bodies(name):
    pytest.importorskip("xarray")
    sol, _ = run_of(name)
    data = sol.to_xarray()
    dims = ("time", *(("body",) if sol.system.bodies else ()), "axis")
    for quantity in ("angular_velocity", "angular_momentum"):
        assert data[quantity].dims == dims
        np.testing.assert_array_equal(data[quantity].values, getattr(sol, quantity))


@pytest.mark.parametrize("frame", ["body", "space"])
@pytest.mark.parametrize("name", BODIES)
def test_pictures_show_them_in_either_frame(name, frame):
    pytest.importorskip("matplotlib")
    sol, _ = run_of(name)
    for quantity in ("angular velocity", "angular momentum"):
        figure = sol.plot(co.plotting.Picture(quantity, frame=frame))
        (axes,) = figure.axes
        vectors = getattr(sol, quantity.replace(" ", "_"))
        vectors = sol.in_space(vectors) if frame == "space" else vectors
        drawn = np.array(axes.lines[2].get_ydata())
        offset = vectors.reshape(5, -1, 3)[:, 0, 2] - drawn
        assert np.ptp(offset) < 1e-12 and frame in axes.get_title()


def test_what_has_no_attitude_is_refused_in_space():
    top = co.systems.heavy_top()
    sol = co.integrate(top, (1.0, 0.2, 0.1, 0.0, 0.0, 1.0), (0, 1), 0.1)
    with refused(TypeError, "attitude=True"):
        sol.in_space(sol.angular_velocity)
    with refused(ValueError, "attitude=True"):
        sol.plot(co.plotting.Picture("angular velocity", frame="space"))
    sol, _ = run_of("rigid_body")
    with refused(ValueError, "vectors", "(2,)"):
        sol.in_space((1.0, 2.0))
    with refused(ValueError, "frame", "inertial"):
        sol.plot(co.plotting.Picture("angular velocity", frame="inertial"))


def gravity(x, A):
    """The torque gamma cross lever of a top, whose vertical gamma is the third row of the attitude."""
    return np.array(
        [A[2, 1] - A[2, 2] * 0.5, A[2, 2] * 0.75 - A[2, 0], A[2, 0] * 0.5 - A[2, 1] * 0.75],
    )


def test_a_top_with_wheels_is_a_body_under_gravity():
    """Without wheels it is `heavy_top`, to order 2 of the torque; motors keep the vertical momentum of all together."""
    inertia, omega = (1.0, 2.0, 2.5), (0.3, -0.2, 1.0)
    top, torque = co.systems.heavy_top(inertia, (0.75, 0.5, 1.0)), co.forces.Torque(gravity)
    wanted = co.integrate(top, np.r_[top.momentum(omega), 0, 0, 1], (0, 4), 0.01, co.Splitting(order=8)).x[-1]
    body = co.systems.body(inertia).with_forces(torque)
    x0 = body.state(None, omega)
    errors = [
        np.abs(co.integrate(body, x0, (0, 4), h, co.Splitting(order=2)).x[-1, [0, 1, 2, 9, 10, 11]] - wanted).max()
        for h in (0.02, 0.01)
    ]
    assert errors[1] < 1e-3 and errors[0] / errors[1] == pytest.approx(4.0, abs=0.1)
    motors = co.forces.ReactionWheels(co.forces.Pointing(stiffness=0.0, damping=0.5), period=0.1)
    with refused(TypeError, "ReactionWheels", "heavy_top", "Torque"):
        top.with_forces(motors)
    wheeled = co.systems.body(inertia, wheels=0.05 * np.eye(3)).with_forces(torque, motors)
    sol = co.integrate(wheeled, wheeled.state(None, omega), (0, 4), 0.01, co.Splitting(order=2))
    vertical = sol.in_space(sol.angular_momentum)[:, 2]
    # Rounding of 400 steps of some ten operations each, of one sign.
    assert np.ptp(vertical) < 400 * 16 * U * np.abs(sol.angular_momentum).max()
    assert np.abs(wheeled.wheel_speeds(sol.x[-1])).max() > 1.0


def test_rates_of_damping_in_body_frames_are_those_of_angular_momenta():
    """Exponentials of balls, whose momenta are otherwise constant, and the bits of rates of all coordinates."""
    rates, omega = np.array([[0.1, 0.2, 0.3], [0.0, 0.5, -0.1]]), np.array([0.3, -0.4, 0.5])
    S = co.systems
    pair = S.gravitating_bodies([(1.0, 1.0, 1.0), (2.0, 2.0, 2.0)], (1.0, 2.0))
    at = pair.state([[1, 0, 0], [-1, 0, 0.0]], [[0, 1, 0], [0, -0.5, 0.0]], angular_velocities=[omega, omega])
    ball, wheeled = S.body((2.0, 2.0, 2.0)), S.body((2.0, 2.5, 3.0), wheels=[(0.1, 0.2, 0.2)])
    orbiting = S.satellite_on_orbit((1.0, 2.0, 2.5), 1.1)
    starts = ball.state(None, omega), wheeled.state(None, omega, wheel_speeds=[9.0]), orbiting.state(None, omega)
    top = S.heavy_top(), np.array([0.3, -0.4, 0.5, 0.6, 0.0, 0.8])
    for system, x0 in (*zip((ball, wheeled, orbiting), starts, strict=True), top, (pair, at)):
        rate = rates if system is pair else rates[0]
        places = np.add.outer([0, 12], range(3)) if system is pair else np.arange(3)
        each = np.zeros(system.dim)
        each[places] = rate
        ideal = system is ball or system is pair
        short, whole = (
            co.integrate(
                system.with_forces(co.forces.LinearDamping(one)),
                x0,
                (0, 2),
                0.125,
                co.Splitting(parts="free_body" if ideal else "auto"),
            )
            for one in (rate, each)
        )
        np.testing.assert_array_equal(short.x, whole.x)
        if ideal:
            np.testing.assert_allclose(short.x[-1][places], x0[places] * np.exp(-2 * rate), rtol=0, atol=1e-14)
    for system, wrong in ((ball, (0.1, 0.2)), (ball, rates), (pair, rates[0]), (top[0], np.ones((6, 3)))):
        with pytest.raises(ValueError, match=r"rate of LinearDamping has the shape .* in body frames"):
            system.with_forces(co.forces.LinearDamping(wrong))
