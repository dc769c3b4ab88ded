"""Gravity of polyhedra in full: closed forms of a box, integrals over the volume, another library, DOP853, refusals."""

from itertools import product

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from surfaces import BODIES, integral, surface

import coadjoint as co
from long import long_beyond
from refusals import refused

S = co.systems
POINT = np.zeros(3)
A = Rotation.from_rotvec([0.3, -1.0, 0.5])
HALF = np.array([1.0, 1.5, 0.75])  # of the edges of a box
RHO = 2.0


def homogeneous(body, rho=RHO, unit=1.0):
    """Return the mass properties of a body of `surfaces`, from integrals over its volume."""
    mass = rho * integral(body, lambda p: np.ones(len(p)))
    centre = rho / mass * integral(body, lambda p: p)
    second = rho * integral(body, lambda p: np.einsum("ni,nj->nij", p - centre, p - centre))
    mesh = surface(body)
    inertia = unit**2 * (np.trace(second) * np.eye(3) - 0.5 * (second + second.T))
    return co.bodies.MassProperties(mass, inertia, surface=(unit * (mesh.vertices - centre), mesh.triangles)), centre


def box(unit=1.0):
    corners = np.array(list(product((-1.0, 1.0), repeat=3))) * HALF
    return homogeneous([(1, corners)], unit=unit)[0]


def beside(body, *others, masses=None, **options):
    """Return a polyhedron with other bodies."""
    given = [1e-3] * len(others) if masses is None else masses
    return S.gravitating_bodies([body, *others], [body.mass, *given], order="polyhedron", **options)


def potential_of_box(at, half=HALF):
    """Return the integral of 1/r over a box, and its gradient (MacMillan 1930)."""
    U, g = 0.0, np.zeros(3)
    for signs in product((-1.0, 1.0), repeat=3):
        x, y, z = d = np.array(signs) * half - at
        r, sign = np.linalg.norm(d), np.prod(signs)
        logs = np.log(d + r)
        angles = np.arctan(np.array([y * z / (x * r), z * x / (y * r), x * y / (z * r)]))
        U += sign * (np.array([y * z, z * x, x * y]) @ logs - 0.5 * d**2 @ angles)
        g -= sign * np.array([y * logs[2] + z * logs[1], z * logs[0] + x * logs[2], x * logs[1] + y * logs[0]])
        g += sign * d * angles
    return U, g


def test_a_box_in_closed_form():
    """Energy, force, torque and their balance near a box that is turned; no sources outside of it."""
    body, m, G = box(), 1e-3, 0.7
    pair = beside(body, POINT, masses=[m], G=G)
    # From near an edge to far away, where the closed form of the reference loses as many digits.
    for at, lost in (([1.02, 1.55, 0.2], 1), ([0.3, -0.4, 1.0], 1), ([-1.2, 0.4, 0.1], 1), ([9.0, 7.0, -8.0], 1e4)):
        x = pair.state([[0, 0, 0], A.apply(at)], attitudes=[A, Rotation.identity()])
        U, g = potential_of_box(np.array(at))
        force, field = G * RHO * m * A.apply(g), pair.vector_field(x)
        assert pair.energy(x) == pytest.approx(-G * RHO * m * U, rel=1e-14 * lost)
        size = 1e-14 * lost * np.abs(force).max()
        np.testing.assert_allclose(field[27:30], force, rtol=0, atol=4 * size)
        np.testing.assert_allclose(field[24:27], -field[27:30], rtol=0, atol=0)
        torque = A.inv().apply(np.cross(A.apply(at), -force))
        np.testing.assert_allclose(field[:3], torque, rtol=0, atol=40 * size)
        curvature = pair.hamiltonian.hessian(x)[-4:-1, -4:-1]
        assert abs(np.trace(curvature)) < 1e-13 * lost * np.abs(curvature).max()


BOXES = {  # of each its place, half of its edges, and whether it is filled
    "in an L": [((0, 0, 0), (1, 1, 1), 1), ((2, 0, 0), (1, 1, 1), 1), ((0, 2, 0), (1, 1, 1), 1)],
    "at an edge": [((0, 0, 0), (1, 1, 1), 1), ((2, 2, 0), (1, 1, 1), 1)],
    "at a corner": [((0, 0, 0), (1, 1, 1), 1), ((2, 2, 2), (1, 1, 1), 1)],
    "with a cavity": [((0, 0, 0), (2, 2, 2), 1), ((0.5, 0.25, 0), (1, 1, 1), -1)],
}


@pytest.mark.parametrize("name", BOXES)
def test_boxes_that_touch_and_cavities(name):
    """The sum of closed forms near corners that go inward, and in a cavity; there edges have up to four triangles."""
    unit = np.array(list(product((-1.0, 1.0), repeat=3)))
    boxes = [(np.array(place), np.array(half), sign) for place, half, sign in BOXES[name]]
    body, centre = homogeneous([(sign, place + half * unit) for place, half, sign in boxes])
    pair = beside(body, POINT)
    for at in ([1.1, 1.2, 0.3], [1.05, -1.1, 1.02], [0.2, 1.3, 1.2], [0.6, 0.1, -0.4], [-2.3, 1.7, 0.9]):
        inside = sum(sign * (np.abs(np.array(at) - place) < half).all() for place, half, sign in boxes)
        x = pair.state([POINT, A.apply(at - centre)], attitudes=[A, Rotation.identity()])
        if inside:
            with refused(ValueError, "below the surface"):
                pair.energy(x)
            continue
        fields = [(sign, *potential_of_box(np.array(at) - place, half)) for place, half, sign in boxes]
        g = sum(sign * gradient for sign, _, gradient in fields)
        assert pair.energy(x) == pytest.approx(-RHO * 1e-3 * sum(sign * U for sign, U, _ in fields), rel=1e-13)
        np.testing.assert_allclose(pair.vector_field(x)[27:30], RHO * 1e-3 * A.apply(g), rtol=0, atol=1e-15)


def test_integrals_over_the_volume():
    """Bodies with cavities and parts, where Gauss quadrature of degree 6 has an error of 1e-11."""
    for name in ("tetrahedron", "hollow box", "two apart", "ball in a shell"):
        body, centre = homogeneous(BODIES[name])
        pair = beside(body, POINT)
        direction = np.array([2.0, -1.0, 2.0]) / 3.0
        at = 12.0 * np.abs(body.surface[0]).max() * direction
        x = pair.state([[0, 0, 0], at])
        exact = RHO * integral(BODIES[name], lambda p, q=centre + at: 1.0 / np.linalg.norm(q - p, axis=-1))
        assert pair.energy(x) == pytest.approx(-1e-3 * exact, rel=1e-10), name


def test_the_field_of_another_library():
    polyhedral = pytest.importorskip("polyhedral_gravity")
    for name in ("pyramid", "hexagonal prism"):
        body, _ = homogeneous(BODIES[name])
        pair = beside(body, POINT)
        source = body.surface[0].tolist(), body.surface[1].tolist()
        field = polyhedral.GravityEvaluable(
            polyhedral.Polyhedron(source, RHO, metric_unit=polyhedral.MetricUnit.UNITLESS)
        )
        for direction in np.random.default_rng(4).normal(size=(6, 3)):
            # A tenth of the size above the sphere around the body; then ten sizes away.
            for distance in (1.1, 10.0):
                at = distance * np.linalg.norm(body.surface[0], axis=1).max() * direction / np.linalg.norm(direction)
                x = pair.state([[0, 0, 0], A.apply(at)], attitudes=[A, Rotation.identity()])
                value, pull, _ = field(at.tolist(), parallel=False)
                assert pair.energy(x) == pytest.approx(-1e-3 * value, rel=1e-10)
                np.testing.assert_allclose(
                    pair.vector_field(x)[27:30], 1e-3 * A.apply(pull), rtol=0, atol=1e-10 * 1e-3 * np.abs(pull).max()
                )


@pytest.mark.parametrize("name", long_beyond(1, ["tetrahedron", "pyramid"]))
def test_far_away_it_is_the_expansion(name):
    """The difference falls by the first power that each order leaves out: the field is that of the same body."""
    body, _ = homogeneous(BODIES[name])
    directions = [one / np.linalg.norm(one) for one in np.random.default_rng(2).normal(size=(8, 3))]
    far = np.linalg.norm(body.surface[0], axis=1).max() * np.array([16.0, 32.0])
    full = beside(body, POINT)
    for order, power in ((0, 3), (2, 4)):
        pair = S.gravitating_bodies([body, POINT], [body.mass, 1e-3], order=order)
        states = [[full.state([[0, 0, 0], d * one]) for one in directions] for d in far]
        off = [[full.energy(x) - pair.energy(x) for x in row] for row in states]
        before, after = np.linalg.norm(off, axis=1)
        assert abs(np.log2(before / after) - power) < 0.15


def test_far_away_it_is_of_second_order():
    """Without a jump beyond rounding there; farther away, such as the Sun, without the rounding of the closed form."""
    body, _ = homogeneous(BODIES["tetrahedron"])
    size = np.linalg.norm(body.surface[0], axis=1).max()
    u = np.array([2.0, -1.0, 2.0]) / 3.0
    full, second = beside(body, POINT), S.gravitating_bodies([body, POINT], [body.mass, 1e-3])
    for distance, tolerance in ((499.999, 4e-9), (500.001, 1e-15), (1e10, 1e-15)):
        x = full.state([POINT, distance * size * u], attitudes=[A, A])
        assert full.energy(x) == pytest.approx(second.energy(x), rel=tolerance)
        forces = full.vector_field(x), second.vector_field(x)
        np.testing.assert_allclose(*(one[27:30] for one in forces), rtol=0, atol=tolerance * np.abs(forces[1]).max())
    # A moonlet near the asteroid, with the Sun: of two polyhedra one may be near for the other, and not the reverse.
    first, small = homogeneous(BODIES["tetrahedron"])[0], homogeneous(BODIES["tetrahedron"], unit=1e-4)[0]
    small = co.bodies.MassProperties(1e-3, small.inertia * 1e-3 / small.mass, surface=small.surface)
    pair = S.gravitating_bodies([first, small], order="polyhedron")
    r = [POINT, 3.0 * size * u]
    near = pair.energy(pair.state(r, attitudes=[A, A]))
    assert near == pytest.approx(full.energy(full.state(r, attitudes=[A, A])), rel=1e-8)
    sun = beside(body, POINT, POINT, masses=[1e-3, 1e9])
    r = [*r, [3e8, 0, 0]]
    pulled = sun.vector_field(sun.state(r, attitudes=[A, A, A]))[36:45].reshape(3, 3)
    alone = full.vector_field(full.state(r[:2], attitudes=[A, A]))[24:30].reshape(2, 3)
    towards = np.array(
        [1e9 * m * (r[2] - at) / np.linalg.norm(r[2] - at) ** 3 for m, at in zip(sun.masses[:2], r[:2], strict=True)]
    )
    np.testing.assert_allclose(pulled[:2], alone + towards, rtol=0, atol=1e-14 * np.abs(alone).max())


def pieces(d):
    """Return places of six equal masses and their inertia per mass; their third moments vanish."""
    places = np.concatenate([np.diag(d), -np.diag(d)])
    second = places.T @ places / 6
    return places, np.trace(second) * np.eye(3) - second


def test_second_moments_of_another_body_in_the_full_field():
    """Energy and torques of six masses about it, whose fourth moments are left out."""
    body, B = box(), Rotation.from_rotvec([1.0, 0.4, -0.2])
    single, errors = beside(body, POINT, masses=[1.0 / 6]), np.zeros((2, 3, 7))
    for k, scale in enumerate((0.1, 0.05)):
        places, inertia = pieces(scale * np.array([1.0, 0.7, 1.2]))
        pair = beside(body, inertia, masses=[1.0])
        for n, at in enumerate(np.array([[1.4, -1.2, 1.0], [0.3, 2.0, -0.5], [-1.6, 0.2, 0.3]])):
            found = pair.state([POINT, at], attitudes=[A, B])
            slope = pair.vector_field(found)
            errors[k, n] = -np.r_[pair.energy(found), slope[:3], slope[12:15]]
            for place in B.apply(places):
                x = single.state([POINT, at + place], attitudes=[A, Rotation.identity()])
                slope = single.vector_field(x)
                errors[k, n] += np.r_[single.energy(x), slope[:3], B.inv().apply(np.cross(place, slope[27:30]))]
    before, after = np.linalg.norm(errors, axis=1)
    np.testing.assert_allclose(np.log2(before / after), 4.0, atol=0.25)


def two_tetrahedra():
    first, _ = homogeneous(BODIES["tetrahedron"])
    second, _ = homogeneous([(1, BODIES["tetrahedron"][0][1] * (0.5, -1.0, 0.4))], 3.0)
    return first, second


def test_two_polyhedra():
    """What is left out falls as the product of third moments, by the integral over one in the field of another."""
    first, second = two_tetrahedra()
    pair = S.gravitating_bodies([first, second], order="polyhedron")
    single = beside(first, POINT, masses=[1.0])
    direction, errors = np.array([2.0, -1.0, 2.0]) / 3.0, []
    volume = [(1, second.surface[0])]
    for distance in (8.0, 16.0):
        exact = integral(
            volume,
            lambda p, r=distance * direction: np.array([3.0 * single.energy(single.state([POINT, r + q])) for q in p]),
        )
        errors.append(pair.energy(pair.state([POINT, distance * direction])) - exact)
    assert abs(np.log2(abs(errors[0] / errors[1])) - 7.0) < 0.4


SYSTEMS = {
    "with a point": lambda: beside(box(), POINT),
    "with two bodies": lambda: beside(box(), (0.1, 0.2, 0.25), POINT, masses=[0.5, 0.3]),
    "two polyhedra": lambda: S.gravitating_bodies(two_tetrahedra(), order="polyhedron"),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_derivatives_and_integrals(name):
    """Central differences at states that are no attitudes; total momentum and angular momentum at those that are."""
    system = SYSTEMS[name]()
    count = len(system.masses)
    r = 4.0 * np.array([[0.0, 0.0, 0.0], [1.0, 0.4, -0.6], [-0.3, 1.0, 0.7]])[:count]
    x = system.state(r, attitudes=Rotation.random(count, 1))
    for integral_ in system.integrals.values():
        assert abs(integral_.gradient(x) @ system.vector_field(x)) < 1e-14 * np.abs(system.vector_field(x)).max() * 10
    x = x + 0.01 * np.random.default_rng(2).normal(size=x.shape)
    H, h = system.hamiltonian, 2.0**-16
    moved = np.random.default_rng(3).normal(size=(6, len(x)))
    for along in moved:
        slope = (H.value(x + h * along) - H.value(x - h * along)) / (2 * h)
        assert slope == pytest.approx(H.gradient(x) @ along, rel=1e-6, abs=1e-7)
        slopes = (H.gradient(x + h * along) - H.gradient(x - h * along)) / (2 * h)
        if count == 2:
            np.testing.assert_allclose(H.hessian(x) @ along, slopes, rtol=0, atol=1e-6 * np.abs(slopes).max())


COUNT = 56  # and the box: bodies from which on threads share the pairs


def particles():
    """Return masses and places of particles about the box, and the system of all."""
    rng = np.random.default_rng(6)
    r = rng.normal(size=(COUNT, 3))
    r *= ((3.0 + rng.random(COUNT)) / np.linalg.norm(r, axis=1))[:, None]
    m = 1e-3 * (0.1 + rng.random(COUNT))
    return m, r, beside(box(), *[POINT] * COUNT, masses=m)


def test_many_particles():
    """Sums over pairs: of the box and each, and of the particles alone."""
    m, r, system = particles()
    single = beside(box(), POINT, masses=[1.0])
    points = S.gravitating_bodies([POINT] * COUNT, m, order=0)
    x, y, pairs = system.state([POINT, *r]), points.state(r), [single.state([POINT, at]) for at in r]
    energy = sum(mass * single.energy(one) for mass, one in zip(m, pairs, strict=True)) + points.energy(y)
    assert system.energy(x) == pytest.approx(energy, rel=1e-13)
    forces = system.vector_field(x)[12 * (COUNT + 1) :][: 3 * (COUNT + 1)].reshape(-1, 3)
    pulls = np.array([mass * single.vector_field(one)[27:30] for mass, one in zip(m, pairs, strict=True)])
    between = points.vector_field(y)[12 * COUNT :][: 3 * COUNT].reshape(-1, 3)
    wanted = np.concatenate([-pulls.sum(axis=0)[None], pulls + between])
    np.testing.assert_allclose(forces, wanted, rtol=0, atol=1e-13 * np.abs(wanted).max())


@pytest.mark.long
def test_particles_on_threads():
    _, r, system = particles()
    x = system.state([POINT, *r])
    runs = [co.integrate(system, x, (0, 0.05), 0.01, co.Splitting(), threads=n) for n in (1, 2)]
    np.testing.assert_array_equal(runs[0].x, runs[1].x)
    short = co.integrate(system, x, (0, 0.05), 0.01, co.GaussLegendre(2))
    np.testing.assert_allclose(runs[0].x, short.x, rtol=0, atol=1e-5)


# Runs: a moonlet and a box that turns, on an orbit within the sphere around the box, and out of it.


def moonlet(unit=1.0, mass=0.05):
    pair = beside(box(unit), POINT, masses=[mass], G=unit**3)
    x0 = pair.state(
        unit * np.array([[0, 0, 0], [1.75, 0.1, 0.2]]),
        unit * np.array([[0, 0, 0], [0.3, 3.6, 1.4]]),
        angular_velocities=[[0.2, 0.1, 1.5], [0, 0, 0]],
    )
    return pair, x0


def newton_and_euler(pair, x0, t_span):
    """Return positions, velocities, attitude and angular velocity of the box at the end, by DOP853."""
    m, I = pair.masses, np.diag(pair.inertias[0].tensor)

    def slope(t, y):
        r, v, q, omega = y[:6].reshape(2, 3), y[6:12], y[12:16], y[16:]
        turn = Rotation.from_quat(q)
        at = turn.inv().apply(r[1] - r[0])
        force = RHO * m[1] * potential_of_box(at)[1]
        dq = 0.5 * np.r_[q[3] * omega + np.cross(q[:3], omega), -q[:3] @ omega]
        turning = (np.cross(at, -force) - np.cross(omega, I * omega)) / I
        push = turn.apply(force)
        return np.concatenate([v, -push / m[0], push / m[1], dq, turning])

    start = [pair.positions(x0).ravel(), pair.velocities(x0).ravel()]
    start += [Rotation.from_matrix(pair.attitudes(x0)[0]).as_quat(), pair.angular_velocity(x0)[0]]
    y = solve_ivp(slope, t_span, np.concatenate(start), method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    return y[:6].reshape(2, 3), y[6:12].reshape(2, 3), Rotation.from_quat(y[12:16]).as_matrix(), y[16:]


SCHEME = co.Splitting(order=8, parts="free_body")


def test_a_moonlet_by_dop853(tmp_path):
    """From a time other than 0, of members, stored, resumed, and backward to the start."""
    pair, x0 = moonlet()
    first = co.integrate(pair, x0, (5.0, 8.0), 1 / 256, SCHEME, archive=tmp_path / "run.zarr", save_every=16)
    distances = np.linalg.norm(first.positions[:, 1] - first.positions[:, 0], axis=1)
    assert distances.min() < np.linalg.norm(HALF) < distances.max()
    sol = co.resume(tmp_path / "run.zarr", 10.0)
    r, v, turned, omega = newton_and_euler(pair, x0, (5.0, 10.0))
    np.testing.assert_allclose(pair.positions(sol.x[-1]), r, rtol=0, atol=1e-9)
    np.testing.assert_allclose(pair.velocities(sol.x[-1]), v, rtol=0, atol=4e-9)
    np.testing.assert_allclose(pair.attitudes(sol.x[-1])[0], turned, rtol=0, atol=1e-9)
    np.testing.assert_allclose(pair.angular_velocity(sol.x[-1])[0], omega, rtol=0, atol=1e-9)
    x1 = sol.x[-1]
    back = co.integrate(pair, [x1, x1 + 1e-9 * (np.arange(37) == 33), x1], (10.0, 5.0), 1 / 256, SCHEME, save_every=64)
    np.testing.assert_allclose(back.x[-1, [0, 2]], [x0, x0], rtol=0, atol=1e-10)
    assert 0.0 < np.abs(back.x[-1, 1] - x0).max() < 1e-6
    loaded = co.load(tmp_path / "run.zarr")
    assert loaded.system.parameters == pair.parameters and loaded.system.energy(x0) == pair.energy(x0)


def test_long_runs_keep_energy_and_momenta():
    """The energy of the moonlet has no trend over 60 turns; momenta in space stay at round-off."""
    pair, _ = moonlet()
    slower = pair.state(
        [[0, 0, 0], [5, 0, 0]], [[0, 0, 0], [0, 1.7, 0.8]], angular_velocities=[[0.1, 0.05, 1.5], [0, 0, 0]]
    )
    sol = co.integrate(
        pair, slower, (0, 250), 0.05, co.Splitting(order=4, parts="free_body"), observe=pair.integrals, save_every=8
    )
    for name, values in sol.observed.items():
        assert np.abs(values - values[0]).max() < 1e-12, name
    off = np.abs(sol.energy - sol.energy[0])
    quarter = len(off) // 4
    assert off[:quarter].max() < 1e-3 * abs(sol.energy[0])
    assert off.max() < 2.0 * off[:quarter].max()


@pytest.mark.parametrize("unit", [1e-7, 1e30])
def test_other_units(unit):
    pair, x0 = moonlet()
    scaled, y0 = moonlet(unit)
    ends = [co.integrate(s, x, (0, 0.5), 1 / 128, SCHEME).x[-1] for s, x in ((pair, x0), (scaled, y0))]
    np.testing.assert_allclose(scaled.positions(ends[1]) / unit, pair.positions(ends[0]), rtol=0, atol=1e-12)
    np.testing.assert_allclose(scaled.velocities(ends[1]) / unit, pair.velocities(ends[0]), rtol=0, atol=4e-12)
    np.testing.assert_allclose(scaled.attitudes(ends[1]), pair.attitudes(ends[0]), rtol=0, atol=1e-12)


def test_systems_in_a_batch():
    """Members with other masses and surfaces end where they do alone."""
    pair, x0 = moonlet()
    heavier = beside(box(), POINT, masses=[0.1])
    batch = co.batch([pair, heavier])
    sol = co.integrate(batch, np.stack([x0, x0]), (0, 0.5), 1 / 64, co.Splitting(order=4))
    for k, one in enumerate((pair, heavier)):
        alone = co.integrate(one, x0, (0, 0.5), 1 / 64, co.Splitting(order=4))
        np.testing.assert_array_equal(sol.x[-1, k], alone.x[-1])


@pytest.mark.long
def test_derivatives_by_masses_and_G_are_those_of_units():
    """With units of mass, momenta and 1/G change and motions do not."""
    pair = beside(box(), (0.1, 0.2, 0.25), masses=[1.0])
    x0 = pair.state([[0, 0, 0], [3, 0.5, 0]], [[0, 0, 0], [0, 2.0, 1.0]], [A, A], [[0.1, 0.2, 1.5], [0.3, 0, 0]])
    ready, moving = co.prepare(pair, co.Splitting(order=8), step=1 / 32), np.ones(pair.dim)
    moving[[*range(3, 12), *range(15, 24), *range(30, 37)]] = 0.0  # axes, positions and z
    shapes, masses, G = (np.array(ready.parameters[name]) for name in ("inertias", "masses", "G"))
    sol, tangents = ready.jvp(x0, (0, 1), {"x0": moving * x0, "inertias": shapes, "masses": masses, "G": -G}, 16)
    np.testing.assert_allclose(tangents.x, moving * sol.x, rtol=0, atol=1e-10)
    weights = np.cos(np.arange(sol.x.size)).reshape(sol.x.shape)
    gradient = ready.vjp(x0, (0, 1), 16)[1](weights)
    along = sum((gradient[n] * v).sum() for n, v in (("inertias", shapes), ("masses", masses)))
    along += gradient["x0"] @ (moving * x0) - G * gradient["G"]
    np.testing.assert_allclose(along, (weights * tangents.x).sum(), rtol=1e-9)


def test_states_below_the_surface():
    """Inside, on faces and on edges there is no field; a run that reaches the surface ends above it."""
    pair = beside(box(), POINT)
    for at in ([0.1, 0.2, 0.3], 0.999 * HALF, [1.0, 0.2, 0.1], [1.0, 1.5, 0.3], HALF):
        x = pair.state([[0, 0, 0], A.apply(at)], attitudes=[A, Rotation.identity()])
        for function in (pair.energy, pair.vector_field):
            try:
                assert np.isfinite(function(x)).all()  # where rounding sets it above the surface
            except ValueError as reason:
                assert "surface of a polyhedron" in str(reason)
    for at in ([0.1, 0.2, 0.3], 0.999 * HALF):
        with refused(ValueError, "below the surface"):
            pair.energy(pair.state([[0, 0, 0], at]))
    for at in (HALF, [1.0, 1.5, 0.0], [1.0, 0.25, 0.125]):
        x = pair.state([[0, 0, 0], at])
        with np.errstate(all="raise"), refused(ValueError, "on or below the surface"):
            pair.energy(x)
    falling = pair.state([[0, 0, 0], [3, 0, 0]])
    with refused(co.IntegrationError, "below the surface of a polyhedron", "x0") as caught:
        co.integrate(pair, falling, (0, 10), 0.01, co.Splitting(order=4, parts="free_body"))
    reached = caught.value.partial
    assert 0.9 < reached.positions[-1, 1, 0] - reached.positions[-1, 0, 0] < 1.2
    with refused(co.IntegrationError, "step 1", "below the surface"):
        co.integrate(pair, pair.state([[0, 0, 0], [0.1, 0, 0]]), (0, 10), 0.01)


def test_a_mesh_from_a_file(tmp_path):
    pytest.importorskip("trimesh")
    from surfaces import obj_plain

    body, _ = homogeneous(BODIES["pyramid"])
    obj_plain(tmp_path / "mesh.obj", surface(BODIES["pyramid"]))
    found = co.bodies.read(tmp_path / "mesh.obj", scale=1.0, density=RHO)
    assert len(found.surface[0]) == 5 and not found.surface[0].flags.writeable
    pairs = [beside(one, POINT) for one in (body, found)]
    again = S.get("gravitating_bodies", **pairs[1].parameters)
    x = pairs[0].state([[0, 0, 0], [1.0, -0.5, 1.5]])
    assert pairs[1].energy(x) == pytest.approx(pairs[0].energy(x), rel=1e-14)
    assert again.energy(x) == pairs[1].energy(x) and again.parameters == pairs[1].parameters
    # Through another order a body from a mesh is what it was.
    assert S.gravitating_bodies([found, POINT], [found.mass, 1.0]).parameters["surfaces"] is None


TETRAHEDRON = BODIES["tetrahedron"]
MESH = surface(TETRAHEDRON)
CENTRED = homogeneous(TETRAHEDRON)[0].surface


@pytest.mark.parametrize(
    "arguments, named",
    [
        ({"order": "polyhedron"}, ["none of the bodies", "surfaces"]),
        ({"order": "polyhedra"}, ["order", "polyhedra"]),
        ({"surfaces": [CENTRED, None]}, ["surfaces", "order=2"]),
        ({"order": "polyhedron", "surfaces": [CENTRED]}, ["surfaces", "1 entries", "2 bodies"]),
        ({"order": "polyhedron", "surfaces": [None, ()]}, ["none of the bodies"]),
        ({"order": "polyhedron", "surfaces": [MESH, None]}, ["surfaces[0]", "centre of mass", "0.5"]),
        ({"order": "polyhedron", "surfaces": [(CENTRED[0], CENTRED[1][1:]), None]}, ["surfaces[0]", "is open"]),
        ({"order": "polyhedron", "surfaces": [(CENTRED[0], CENTRED[1][:, ::-1]), None]}, ["inside out"]),
        ({"order": "polyhedron", "surfaces": [(CENTRED[0], CENTRED[1] + 1), None]}, ["surfaces[0]", "0 to 3"]),
        ({"order": "polyhedron", "surfaces": [(CENTRED[0][:, :2], CENTRED[1]), None]}, ["vertices", "(4, 2)"]),
        ({"order": "polyhedron", "surfaces": [(np.nan * CENTRED[0], CENTRED[1]), None]}, ["surfaces[0]", "nan"]),
        ({"order": "polyhedron", "surfaces": [CENTRED[0], None]}, ["surfaces[0]", "pair"]),
        (
            {"order": "polyhedron", "surfaces": [(CENTRED[0], np.tile(CENTRED[1], (25001, 1))), None]},
            ["surfaces[0]", "100004 triangles", "100000"],
        ),
        ({"order": "polyhedron", "surfaces": [CENTRED, None], "higher_moments": np.zeros((2, 25))}, ["higher_moments"]),
    ],
)
def test_wrong_surfaces_are_refused(arguments, named):
    with refused(ValueError, *named):
        S.gravitating_bodies(**arguments)


def test_an_inertia_that_is_not_that_of_the_surface_warns():
    body = box()
    with pytest.warns(UserWarning, match=r"inertias\[0\] differs by 3 of its size"):
        S.gravitating_bodies(
            [4.0 * body.inertia, POINT], (body.mass, 1.0), order="polyhedron", surfaces=[body.surface, None]
        )


def test_the_field_is_that_of_the_surface():
    """Not of the inertia beside it, which turns the body: also where second moments of two bodies are subtracted."""
    bodies = two_tetrahedra()
    surfaces, masses = [one.surface for one in bodies], [one.mass for one in bodies]
    pairs = [
        S.gravitating_bodies([k * one.inertia for one in bodies], masses, order="polyhedron", surfaces=surfaces)
        for k in (1.0, 1.005)
    ]
    x = pairs[0].state([POINT, [2.5, 1.0, -1.5]])
    assert pairs[0].energy(x) == pairs[1].energy(x)
