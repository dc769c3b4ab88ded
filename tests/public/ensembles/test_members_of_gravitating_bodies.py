"""Members with gravitating bodies: alone and together, of other masses and shapes, with forces, stored, and failing."""

import numpy as np
import pytest
import scipy.integrate

import coadjoint as co
from long import long_where
from refusals import refused

S = co.systems
POINT = (0.0, 0.0, 0.0)
FULL = [[0.4, 0.05, -0.02], [0.05, 0.5, 0.03], [-0.02, 0.03, 0.6]]
OCTAHEDRON = (
    np.concatenate([np.eye(3), -np.eye(3)]) * (1.0, 0.8, 0.7),
    [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]],
)
T0, H, STEPS = 3.0, 1 / 32, 48


def system_of(order, mass=2.0, G=1.0, small=POINT):
    """Return a body with a smaller one; of a polyhedron the inertia is that of its mass."""
    squares = mass / 10 * np.array([1.0, 0.64, 0.49])
    surfaces = {"surfaces": [OCTAHEDRON, None]} if order == "polyhedron" else {}
    return S.gravitating_bodies([np.diag(squares.sum() - squares), small], (mass, 0.1), G, order, **surfaces)


def starts(system, members):
    r = [[[0, 0, 0], [2.0 + 0.1 * k, 0.1 * k, 0]] for k in range(members)]
    v = [[[0, 0, 0], [0.1, 0.9, 0.3 + 0.1 * k]] for k in range(members)]
    return system.state(r, v, angular_velocities=[[0.2, 0.1, 0.6], [0, 0, 0]])


ORDERS = long_where([0, 4], [0, 2, 4, "polyhedron"])


def run(system, x0, span=(T0, T0 + H * STEPS), **options):
    return co.integrate(system, x0, span, H, co.Splitting(order=4), save_every=8, **options)


@pytest.mark.parametrize("order", long_where(["polyhedron"], ORDERS))
def test_members_end_as_alone(order, tmp_path):
    """On one and two threads, stored and resumed, with the same bits; and backward to their starts."""
    system = system_of(order)
    x0 = starts(system, 5)
    alone = np.stack([run(system, x).x for x in x0], axis=1)
    for threads in (1, 2):
        np.testing.assert_array_equal(run(system, x0, threads=threads).x, alone)
    half = T0 + H * STEPS / 2
    run(system, x0, (T0, half), archive=tmp_path / "run.zarr")
    np.testing.assert_array_equal(co.resume(tmp_path / "run.zarr", T0 + H * STEPS).x, alone)
    back = run(system, alone[-1], (T0 + H * STEPS, T0))
    np.testing.assert_allclose(back.x[-1], x0, rtol=0, atol=1e-12)


@pytest.mark.parametrize("order", ORDERS)
def test_systems_of_other_numbers(order):
    """Masses, G and inertias of each member: moments, tensors and points; positions scale as those of one Kepler."""
    systems = [system_of(order), system_of(order, G=2.0), system_of(order, 3.0), system_of(order, small=FULL)]
    x0 = starts(systems[0], len(systems))
    x0[2:] = [system.state(*_read(systems[0], x)) for system, x in zip(systems[2:], x0[2:], strict=True)]
    together = run(co.batch(systems), x0)
    for k, system in enumerate(systems):
        np.testing.assert_array_equal(together.x[:, k], run(system, x0[k]).x)
    # Twice the G is the same path, faster by the root of two.
    fast = S.get("gravitating_bodies", **{**systems[0].parameters, "G": 4.0})
    r, v, turned, omega = _read(systems[0], x0[0])
    y0 = fast.state(r, 2.0 * v, turned, 2.0 * omega)
    paths = [run(systems[0], x0[0]), co.integrate(fast, y0, (T0, T0 + H * STEPS / 2), H / 2, co.Splitting(order=4))]
    np.testing.assert_allclose(paths[1].positions[::8], paths[0].positions, rtol=0, atol=1e-13)


SWEEPS = {
    "masses": lambda value: S.gravitating_bodies([(0.4, 0.5, 0.6), (0.1, 0.1, 0.15)], (2.0 * value, 1.0), 1.0),
    "inertias": lambda value: S.gravitating_bodies([(0.4, 0.5, 0.6), (0.1 * value, 0.1, 0.15)], (2.0, 1.0), 1.5),
    "G": lambda value: S.gravitating_bodies([(0.4, 0.5, 0.6), POINT], (2.0, 0.1), value, 0),
}


@pytest.mark.parametrize("parameter", SWEEPS)
def test_a_sweep_builds_few_tables(parameter, tables_built, tmp_path):
    """Also through equal moments, where products of the field cancel; with the bits of members alone, also stored."""
    systems = [SWEEPS[parameter](value) for value in (0.75, 0.875, 1.0, 1.125, 1.25, 1.5, 1.75)]
    x0 = starts(systems[0], len(systems))
    tables_built.clear()
    whole = run(co.batch(systems), x0, threads=2)
    # One for most values; at one or two of them moments of a body, or G and a mass, are equal.
    assert len(tables_built) <= 3
    for k, system in enumerate(systems):
        alone = run(system, x0[k])
        np.testing.assert_array_equal(whole.x[:, k], alone.x)
        np.testing.assert_array_equal(whole.energy[:, k], alone.energy)
    half = T0 + H * STEPS / 2
    run(co.batch(systems), x0, (T0, half), archive=tmp_path / "run.zarr")
    np.testing.assert_array_equal(co.resume(tmp_path / "run.zarr", T0 + H * STEPS).x, whole.x)
    back = run(co.batch(systems), whole.x[-1], (T0 + H * STEPS, T0))
    np.testing.assert_allclose(back.x[-1], x0, rtol=0, atol=1e-12)


@pytest.mark.parametrize("unit", [1e-7, 1.0, 1e30])
def test_a_sweep_follows_the_equations_of_motion(unit):
    """Of two bodies by MacCullagh's formula, in other units of mass, by the eighth order of Dormand and Prince."""
    moments, m = unit * np.array([(0.4, 0.5, 0.6), (0.1, 0.12, 0.15)]), unit * np.array([2.0, 1.0])
    values = (0.9, 1.0, 1.1)
    systems = [S.gravitating_bodies(moments, m * (value, 1.0), 1.0 / unit) for value in values]
    state = systems[0].state(
        [[0, 0, 0], [2.0, 0.1, 0]], [[0, 0, 0], [0.1, 0.9, 0.3]], None, [[0.2, 0.1, 0.6], [0, 0.3, 0.5]]
    )
    x0 = np.stack([state] * len(values))
    found = co.integrate(co.batch(systems), x0, (0.0, 2.0), 1 / 64, co.Splitting(order=6), save_every=128)
    for k, (value, system) in enumerate(zip(values, systems, strict=True)):
        masses, r, v, A, omega = m * (value, 1.0), *_read(system, state)

        def rate(t, y, masses=masses):
            r, p, A, L = y[:6].reshape(2, 3), y[6:12].reshape(2, 3), y[12:30].reshape(2, 3, 3), y[30:].reshape(2, 3)
            R, G = r[0] - r[1], 1.0 / unit
            s = np.sqrt(R @ R)
            pull, torque = G * masses[0] * masses[1] * R / s**3, np.zeros((2, 3))
            for one, other in ((0, 1), (1, 0)):
                w, I = A[one].T @ R, moments[one]
                pull = pull + 1.5 * G * masses[other] / s**5 * (
                    (I.sum() - 5.0 * (I * w) @ w / s**2) * R + 2.0 * A[one] @ (I * w)
                )
                torque[one] = 3.0 * G * masses[other] / s**5 * np.cross(w, I * w)
            omega = L / moments
            turned = np.stack([np.cross(A[b], omega[b]) for b in range(2)])
            change = np.cross(L, omega) + torque
            return np.concatenate([(p / masses[:, None]).ravel(), -pull, pull, turned.ravel(), change.ravel()])

        y0 = np.concatenate([np.ravel(one) for one in (r, masses[:, None] * v, A, moments * omega)])
        exact = scipy.integrate.solve_ivp(rate, (0.0, 2.0), y0, "DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
        # The order is six: halved steps change the end by 2e-9.
        np.testing.assert_allclose(system.positions(found.x[-1, k]).ravel(), exact[:6], rtol=0, atol=1e-8)
        np.testing.assert_allclose(system.attitudes(found.x[-1, k]).ravel(), exact[12:30], rtol=0, atol=1e-8)


def _read(system, x):
    return system.positions(x), system.velocities(x), system.attitudes(x), system.angular_velocity(x)


@pytest.mark.parametrize("order", long_where([0, 4], [0, 2, 4, "polyhedron"]))
def test_forces_on_members(order):
    """Damping of another rate for each member, beside gravity."""
    system = system_of(order)
    x0 = starts(system, 3)
    damped = [system.with_forces(co.forces.LinearDamping(rate)) for rate in (0.0, 0.1, 0.2)]
    together = run(co.batch(damped), x0)
    for k, one in enumerate(damped):
        np.testing.assert_array_equal(together.x[:, k], run(one, x0[k]).x)
    np.testing.assert_allclose(together.x[-1, 0], run(system, x0[0]).x[-1], rtol=0, atol=1e-14)
    momentum = system.velocities(together.x) * system.masses[:, None]
    total = momentum.sum(axis=-2)
    decay = np.exp(-np.multiply.outer(together.t - T0, [0.0, 0.1, 0.2]))
    np.testing.assert_allclose(total, decay[..., None] * total[0], rtol=0, atol=1e-14)


@pytest.mark.parametrize("order", long_where([4], [2, 4, "polyhedron"]))
def test_a_failing_member(order):
    """Two bodies at one place, or one below the surface of the other: the other members end as alone."""
    system = system_of(order)
    x0 = starts(system, 3)
    at = [0.0, 0.0, 0.0] if order != "polyhedron" else [0.1, 0.0, 0.0]
    x0[1] = system.state([[0, 0, 0], at])
    named = "one place" if order != "polyhedron" else "below the surface"
    with refused(co.IntegrationError, "1 of 3 members", "member 1", named) as error:
        run(system, x0)
    for k in (0, 2):
        np.testing.assert_array_equal(error.value.partial.x[:, k], run(system, x0[k]).x)
    assert np.flatnonzero(error.value.partial.failed).tolist() == [1]
