"""Small coordinates beside large ones: products that cancel leave no rounding errors, nor do steps, in 50 digits."""

import numpy as np
import pytest
from mpmath import mp
from scipy.integrate import solve_ivp

import coadjoint as co

GRAVITY, RADIUS = 3.986004418e14, 6.778e6
RATE = np.sqrt(GRAVITY / RADIUS**3)
RELEASE = np.radians(10.0)
# Mass, in kg, and moments of inertia, in kg m^2.
BODIES = {
    "3U CubeSat": (4.0, (0.0067, 0.0333, 0.0350)),
    "Envisat": (7827.0, (17023.3, 124825.7, 129112.2)),
    "space station": (4.2e5, (1.0e8, 1.5e8, 2.0e8)),
}
SCHEMES = (co.Splitting(order=4), co.GaussLegendre(2), co.GaussLegendre(3), co.RadauEnergy(3))


def released(mass, inertia):
    """Return a state on a circular orbit, the body rotated from the radius in the plane of the orbit."""
    c, s = np.cos(RELEASE), np.sin(RELEASE)
    return np.r_[0, 0, inertia[2] * RATE, mass * RADIUS * RATE * np.array([-s, c, 0]), RADIUS * np.array([c, s, 0]), 1]


def as_users_write_it(inertia, mass, gravity):
    """Return the satellite as a system of one's own, its potential as one function of the position."""
    a, b, c = inertia

    def V(r):
        distance = np.sqrt(r[0] ** 2 + r[1] ** 2 + r[2] ** 2)
        u, v, w = r[0] / distance, r[1] / distance, r[2] / distance
        return -gravity * (mass / distance + (a + b + c - 3 * (a * u**2 + b * v**2 + c * w**2)) / (2 * distance**3))

    pieces = [((i,), co.Quadratic(1 / inertia[i])) for i in range(3)]
    pieces += [((3, 4, 5), co.Quadratic(1 / mass)), ((6, 7, 8), co.Hamiltonian(V))]
    return co.LiePoissonSystem(co.systems.satellite().algebra, co.SplitHamiltonian(pieces), sign=-1)


def pitch_by_euler(inertia, times):
    """Return the angle of the radius from the first axis by Euler's equations with the gravity-gradient torque."""

    def derivative(t, y):
        angle = RATE * t + RELEASE - y[0]
        return [y[1], 3 * RATE**2 * (inertia[1] - inertia[0]) / inertia[2] * np.sin(angle) * np.cos(angle)]

    found = solve_ivp(derivative, (0, times[-1]), [0.0, RATE], method="DOP853", rtol=1e-12, atol=1e-14, t_eval=times)
    return RATE * times + RELEASE - found.y[0]


@pytest.mark.parametrize("scheme", SCHEMES, ids=str)
@pytest.mark.parametrize("name", BODIES)
def test_the_pitch_of_a_satellite_of_real_size(name, scheme):
    # The step has an error of the order of 1e-6 degrees (order four) and less, or 1e-5 at order two times three; by
    # rounding errors of r cross dV/dr it was 15 degrees.
    mass, inertia = BODIES[name]
    system = co.systems.satellite(inertia=inertia, mass=mass, gravity=GRAVITY)
    end = 3 * 2 * np.pi / RATE
    sol = co.integrate(system, released(mass, inertia), (0, end), end / 1080, scheme)
    pitch = np.unwrap(np.arctan2(sol.x[:, 7], sol.x[:, 6]))
    assert np.degrees(np.abs(pitch - pitch_by_euler(inertia, sol.t)).max()) < 2e-5


@pytest.mark.parametrize("make", [co.systems.satellite, as_users_write_it])
@pytest.mark.parametrize("ratio", [1.0, 1e4, 1e8, 1e12])
def test_the_field_is_right_to_rounding_of_each_vector(make, ratio):
    # The torque of the moments is a few products of numbers of its own size; each is rounded a few times.
    rng = np.random.default_rng(7)
    inertia = (1.0, 1.5, 2.0)
    system = make(inertia, ratio, 1.0)
    for _ in range(5):
        r = rng.standard_normal(3)
        x = np.r_[rng.standard_normal(3), ratio * rng.standard_normal(3), r * 2.0 / np.linalg.norm(r), 1]
        with mp.workdps(50):
            f = system.vector_field(np.array([mp.mpf(value) for value in x.tolist()], dtype=object))
            error = np.array(
                [float(mp.mpf(value) - other) for value, other in zip(system.vector_field(x), f, strict=True)]
            )
        size = np.abs(f.astype(float))
        for group in (slice(3), slice(3, 6), slice(6, 9)):
            assert np.abs(error[group]).max() <= 64 * 2.0**-53 * size[group].max()


@pytest.mark.thinned(2)
@pytest.mark.parametrize(
    "function",
    [
        lambda r: -1.0 / np.sqrt(r[0] ** 2 + r[1] ** 2 + r[2] ** 2),
        lambda r: -1.0 / np.linalg.norm(r),
        lambda r: np.log(r @ r) + np.exp(-np.sum(r**2)),
        lambda r: (r[0] ** 2 + r[1] ** 2 + r[2] ** 2) ** -0.5 * np.cos(r @ r),
    ],
)
def test_central_forces_have_no_torque(function):
    H = co.SplitHamiltonian([((6, 7, 8), co.Hamiltonian(function)), ((3, 4, 5), co.Quadratic(0.5))])
    system = co.LiePoissonSystem(co.systems.satellite().algebra, H, sign=-1)
    x = np.random.default_rng(3).standard_normal(10) * np.repeat([1e-12, 1e6, 1.0, 1.0], [3, 3, 3, 1])
    assert np.all(system.vector_field(x)[:3] == 0.0)
    for scheme in (co.Splitting(order=4), co.GaussLegendre(2)):
        step = 1e-7
        moved = co.integrate(system, x, (0, 10 * step), step, scheme).x
        assert np.all(moved[:, :3] == x[:3])


def test_a_force_that_is_not_central_keeps_its_torque():
    # A tenth of a millionth of a millionth beside the central part: found by no difference of numbers.
    def V(r):
        return -1.0 / np.sqrt(r @ r) + 1e-13 * r[0] * r[1]

    system = co.LiePoissonSystem(co.systems.satellite().algebra, co.SplitHamiltonian([((6, 7, 8), co.Hamiltonian(V))]))
    x = np.r_[0, 0, 0, 0, 0, 0, 0.3, -0.7, 1.1, 1.0]
    torque = np.cross(x[6:9], 1e-13 * np.array([x[7], x[6], 0.0]))
    assert np.allclose(-system.vector_field(x)[:3], torque, rtol=1e-14, atol=0)
    end = co.integrate(system, x, (0, 1), 0.5, co.Splitting(order=2)).x[-1]
    assert np.allclose(-end[:3], torque, rtol=1e-14, atol=0)


@pytest.mark.parametrize("scheme", [co.Splitting(order=4), co.GaussLegendre(2)], ids=str)
def test_derivatives_by_coefficients_whose_products_cancel(scheme):
    # p x M p vanishes for equal coefficients, but not its derivative by one of them.
    diagonal = np.array([1.0, 0.5, 0.4, 0.01, 0.01, 0.01, 1.0, 1.0, 2.0, 0.0])
    x0 = np.r_[0.1, 0.2, 0.3, 1.0, 2.0, 3.0, 0.4, 0.5, 0.6, 1.0]

    def system(values):
        return co.LiePoissonSystem(co.systems.satellite().algebra, co.Quadratic(values), sign=-1)

    ready = co.prepare(system(diagonal), scheme, step=0.05)
    for k in (0, 4, 7, 8):
        unit = np.eye(10)[k]
        sol, tangents = ready.jvp(x0, (0, 2), {"M": unit})
        _, pullback = ready.vjp(x0, (0, 2))
        above, below = (
            co.integrate(system(diagonal + side * 1e-5 * unit), x0, (0, 2), 0.05, scheme).x for side in (1, -1)
        )
        assert np.abs(tangents.x - (above - below) / 2e-5).max() < 1e-6 * np.abs(tangents.x).max()
        weights = np.random.default_rng(k).standard_normal(sol.x.shape)
        expected = np.sum(weights * tangents.x)
        assert abs(pullback(weights)["M"] @ unit - expected) < 1e-12 * np.sum(np.abs(weights * tangents.x))


def beside_a_central_force(*pieces):
    """Return a body on the algebra of the satellite, with a function of r that is central and not, and other terms."""

    def V(x):
        distance = np.sqrt(x[0] ** 2 + x[1] ** 2 + x[2] ** 2)
        return -1.0 / distance + 0.1 * np.cos(x[0]) / distance

    parts = [((i,), co.Quadratic(1 / moment)) for i, moment in enumerate((1.0, 2.0, 2.5))]
    parts += [((3, 4, 5), co.Quadratic(0.5)), ((6, 7, 8), co.Hamiltonian(V)), *pieces]
    return co.LiePoissonSystem(co.systems.satellite().algebra, co.SplitHamiltonian(parts), sign=-1)


R = (6, 7, 8)
TERMS = {
    "linear": (R, co.Quadratic(np.zeros(3), linear=[0.3, -0.2, 0.5])),
    "quadratic": (R, co.Quadratic([0.3, 0.1, 0.2])),
    "quartic of the second coordinates": (R, co.Polynomial({(0, 3, 0): 0.4, (0, 1, 2): -0.3, (0, 0, 4): 0.2})),
    "isotropic quartic": (R, co.Polynomial("0.1*(x1^2 + x2^2 + x3^2)^2", 3)),
}


@pytest.mark.parametrize("name", TERMS)
def test_other_terms_beside_a_central_force(name):
    system = beside_a_central_force(TERMS[name])
    x = np.r_[0.1, -0.2, 0.3, 0.5, 0.9, -0.1, 1.2, -0.4, 0.3, 1.0]
    expected = system.sign * system.structure_matrix(x) @ system.hamiltonian.gradient(x)
    assert np.abs(system.vector_field(x) - expected).max() < 1e-14
    compiled = co.integrate(system, x, (0, 0.05), 0.05, co.GaussLegendre(3)).x[-1]
    assert np.abs(compiled - co.GaussLegendre(3).step(system, x, 0.0, 0.05)).max() < 1e-14
    assert np.abs(compiled - co.integrate(system, x, (0, 0.05), 0.05 / 64, co.Splitting(order=4)).x[-1]).max() < 1e-9


def test_derivatives_by_a_coefficient_of_an_isotropic_quartic():
    low = {tuple((2 * np.eye(10, dtype=int)[k]).tolist()): c for k, c in enumerate([0.5, 0.25, 0.2, 0.5, 0.5, 0.5])}
    quartic = co.Polynomial("0.1*(x1^2 + x2^2 + x3^2)^2", 3)
    high = {(0,) * 6 + e + (0,): c for e, c in quartic.monomials.items()}

    def system(change, which):
        terms = {**low, **high}
        terms[which] += change
        return co.LiePoissonSystem(co.systems.satellite().algebra, co.Polynomial(terms), sign=-1)

    x0, scheme = np.r_[0.1, -0.2, 0.3, 0.5, 0.9, -0.1, 1.2, -0.4, 0.3, 1.0], co.Splitting(order=4)
    weights, which = np.random.default_rng(5).standard_normal(10), next(iter(high))
    _, pullback = co.prepare(system(0.0, which), scheme, step=0.05).vjp(x0, (0, 1), save_every=20)
    found = pullback(np.stack([0 * weights, weights]))["coefficients"]
    names = list(system(0.0, which).hamiltonian.polynomial.monomials)
    for key in (which, next(reversed(high))):
        above, below = (co.integrate(system(d, key), x0, (0, 1), 0.05, scheme).x[-1] for d in (1e-5, -1e-5))
        # With another coefficient the parts are others, and so is the error of the steps.
        assert abs(found[names.index(key)] - weights @ (above - below) / 2e-5) < 1e-5


STEPS, DIGITS = 3, 50
VECTOR, OTHER = np.array([0.2, 0.5, -0.9]), np.array([0.4, -0.3, 1.1])
M = np.diag([1.0, 0.5, 0.3, 0.7, 0.2, 0.9])
M[:3, 3:] = [[0.1, 0.2, 0.3], [0.2, 0.4, 0.1], [0.3, 0.1, 0.5]]
M[3:, :3] = M[:3, 3:].T
Q = np.array([[0.6, 0.0, -0.8], [0.0, 0.28, 0.96]])
S = co.systems
CASES = {  # system, state and step for a ratio of sizes, and the sizes of the groups of coordinates
    "spins": lambda r: (
        co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), 2), co.Quadratic(M)),
        (np.r_[np.array([0.3, -0.8, 0.5]) / r, 0.9, 0.2, -0.7], 0.1, (3, 3)),
    ),
    "heavy top": lambda r: (S.heavy_top((1, 2, 2.5)), (np.r_[OTHER, VECTOR * r], 0.05 / np.sqrt(r), (3, 3))),
    "pendulum": lambda r: (
        S.double_spherical_pendulum(masses=(1.0, 1 / r)),
        (
            np.r_[Q.ravel(), (np.cross(Q, [[0.3, 1.0, -0.2], [1.1, -0.4, 0.5]]) / [[1.0], [r]]).ravel(), 1.0],
            *(0.02, (3, 3, 3, 3, 1)),
        ),
    ),
    "particles": lambda r: (
        S.decorated_particles(weights=(1.0, 1 / r)),
        (
            S.canonical_state([1.0, -0.5], [0.3, 0.1 / r], [0.5, 0.1, 0.3, 0.2 / r, 0.05 / r, 0.1 / r]),
            0.05,
            (2, 1, 1, 1, 3, 3),
        ),
    ),
    "body in a fluid": lambda r: (
        S.kirchhoff_body((1, 2, 2.5), mass=(r, 1.5 * r, 2 * r)),
        (np.r_[OTHER, VECTOR * np.sqrt(r)], 0.05, (3, 3)),
    ),
    "satellite": lambda r: (
        S.satellite((1.0, 2.0, 2.5), mass=r),
        (np.r_[0.1, -0.2, 0.3, np.array([0.2, 0.9, -0.1]) * r, 1.5, -0.4, 0.3, 1.0], 0.05, (3, 3, 3, 1)),
    ),
}


def two_stages(f, x, step):
    """Take steps of the Gauss-Legendre method of two stages in 50 digits, from its textbook tableau."""
    with mp.workdps(DIGITS):
        a = np.array([[mp.mpf(1) / 4, mp.mpf(1) / 4 - mp.sqrt(3) / 6], [mp.mpf(1) / 4 + mp.sqrt(3) / 6, mp.mpf(1) / 4]])
        x, step = np.array([mp.mpf(float(value)) for value in x], dtype=object), mp.mpf(step)
        for _ in range(STEPS):
            k = np.array([f(x), f(x)])
            for _ in range(300):
                before, k = k, np.array([f(x + step * (row @ k)) for row in a])
                if np.all(np.abs(k - before) <= mp.mpf(10) ** -38 * np.abs(before)):
                    break
            x = x + step * (k[0] + k[1]) / 2
        return x


@pytest.mark.parametrize("ratio", [1.0, 1e4, 1e8, 1e12])
@pytest.mark.parametrize("name", CASES)
def test_each_group_has_the_rounding_errors_of_its_own_size(name, ratio):
    # A step is some ten products and sums of each component, each rounded once.
    system, (x0, h, groups) = CASES[name](ratio)
    end = co.integrate(system, x0, (0, STEPS * h), h, co.GaussLegendre(2)).x[-1]
    exact = two_stages(system.vector_field, x0, h)
    error = np.array([float(mp.mpf(a) - b) for a, b in zip(end.tolist(), exact, strict=True)])
    for off, group in zip(*(np.split(v, np.cumsum(groups)[:-1]) for v in (error, end)), strict=True):
        assert np.abs(off).max() <= 8 * STEPS * 2.0**-53 * np.abs(group).max()
