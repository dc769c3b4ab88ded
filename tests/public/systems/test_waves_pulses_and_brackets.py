"""Waves of fluids, Maxwell-Bloch, Riccati and Sklyanin: their equations, references of 40 digits, and closed forms."""

import json
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest

import coadjoint as co
import refusals
from refusals import refused

S = co.systems
(FILE,) = Path(refusals.__file__).parent.rglob("lie_poisson_systems.json")
REFERENCE = next(s for s in json.loads(FILE.read_text())["systems"] if s["name"] == "maxwell_bloch_real")


K, L = 0.75, 1.25
FIRST, SECOND = (1.0, 0.5), (-0.25, 1.5)
SYSTEMS = {
    "Lorenz": S.lorenz_1960(K, L),
    "Lorenz, stable": S.lorenz_1960(2.0, 1.0),
    "triad": S.fluid_triad(FIRST, SECOND),
    "triad, other sense": S.fluid_triad(SECOND, FIRST),
}
X0 = np.array([0.7, -1.1, 0.4])


def euler(waves, stream, x):
    """What the vorticity equation does to amplitudes: -J(psi, zeta), by projection on the waves.

    `waves` are functions of (X, Y) with their gradients; `stream[i]` is -1/k^2 of wave i. Means are over many periods
    of whole numbers of waves, on a grid that is exact for trigonometric polynomials of this degree.
    """
    shapes, slopes = zip(*waves, strict=True)
    zx, zy = (sum(a * s[d] for a, s in zip(x, slopes, strict=True)) for d in (0, 1))
    px, py = (sum(a * c * s[d] for a, c, s in zip(x, stream, slopes, strict=True)) for d in (0, 1))
    rate = -(px * zy - py * zx)
    return np.array([np.mean(rate * w) / np.mean(w * w) for w in shapes])


def grid(period):
    ticks = np.arange(96) * (period / 96)
    return np.meshgrid(ticks, ticks, indexing="ij")


def lorenz_waves(k, l):
    X, Y = grid(8 * np.pi)  # 4 periods of 1, so whole numbers of quarters
    cx, sx, cy, sy, o = np.cos(k * X), np.sin(k * X), np.cos(l * Y), np.sin(l * Y), 0 * X
    waves = [(cy, (o, -l * sy)), (cx, (-k * sx, o)), (2 * sy * sx, (2 * k * sy * cx, 2 * l * cy * sx))]
    return waves, [-1 / l**2, -1 / k**2, -1 / (k**2 + l**2)]


def triad_waves(first, second):
    X, Y = grid(8 * np.pi)
    ks = [np.array(first), np.array(second), -np.array(first) - np.array(second)]
    waves = [(np.cos(p * X + q * Y), (-p * np.sin(p * X + q * Y), -q * np.sin(p * X + q * Y))) for p, q in ks]
    return waves, [-1 / (k @ k) for k in ks]


GRIDS = {
    "Lorenz": lambda: lorenz_waves(K, L),
    "Lorenz, stable": lambda: lorenz_waves(2.0, 1.0),
    "triad": lambda: triad_waves(FIRST, SECOND),
    "triad, other sense": lambda: triad_waves(SECOND, FIRST),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_it_is_the_fluid(name):
    system, (waves, stream) = SYSTEMS[name], GRIDS[name]()
    np.testing.assert_allclose(system.vector_field(X0), euler(waves, stream, X0), rtol=0, atol=1e-13)
    shapes, slopes = zip(*waves, strict=True)
    vorticity = sum(a * w for a, w in zip(X0, shapes, strict=True))
    speed = [sum(a * c * s[d] for a, c, s in zip(X0, stream, slopes, strict=True)) for d in (0, 1)]
    assert system.energy(X0) == pytest.approx(np.mean(speed[0] ** 2 + speed[1] ** 2) / 2, rel=1e-12)
    assert system.casimirs["enstrophy"](X0) == pytest.approx(np.mean(vorticity**2) / 2, rel=1e-12)
    assert system.sign == -1


def test_the_equations_as_lorenz_wrote_them():
    A, F, G = X0
    wanted = [
        -(1 / K**2 - 1 / (K**2 + L**2)) * K * L * F * G,
        (1 / L**2 - 1 / (K**2 + L**2)) * K * L * A * G,
        -0.5 * (1 / L**2 - 1 / K**2) * K * L * A * F,
    ]
    np.testing.assert_allclose(SYSTEMS["Lorenz"].vector_field(X0), wanted, rtol=0, atol=1e-15)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", SYSTEMS)
def test_closed_forms_of_waves(name):
    system = SYSTEMS[name]
    with mp.workdps(25):
        c = [mp.mpf(v) for v in system.vector_field([1.0, 1.0, 1.0])]
        motion = mp.odefun(
            lambda t, x: [c[0] * x[1] * x[2], c[1] * x[2] * x[0], c[2] * x[0] * x[1]], 0, [*map(mp.mpf, X0)]
        )
        wanted = np.array([float(v) for v in motion(2)])
    np.testing.assert_allclose(system.exact(X0, 2.0), wanted, rtol=0, atol=1e-14)
    np.testing.assert_allclose(system.exact(wanted, [-2.0, 0.0]), [X0, wanted], rtol=0, atol=1e-14)


def test_a_triad_is_a_body_of_the_textbook():
    triad = S.fluid_triad((2.0, 2.0), (-1.0, 0.0))  # k^2 = 8, 1, 5, and S/2 = 1
    with pytest.warns(UserWarning, match="no body has"):  # its moments are those of waves
        body = S.rigid_body((8.0, 1.0, 5.0))
    np.testing.assert_allclose(triad.vector_field(X0), body.vector_field(X0), rtol=1e-14)
    np.testing.assert_allclose(triad.exact(X0, 3.0), body.exact(X0, 3.0), rtol=0, atol=1e-14)


PULSE = np.array([0.5, 0.6, 0.8])


def as_pendulum(coupling, x0, t):
    """theta' = E, E' = coupling R sin(theta) with Jacobi's functions of mpmath, in 40 digits; libration and rotation.

    phi = theta - pi hangs: phi'' = -w^2 sin(phi). From the bottom with phi' = 2 w k: sin(phi/2) = k sn(w t | k^2), or
    sn(w k t | 1/k^2). The time from the bottom to the start is an incomplete integral.
    """
    with mp.workdps(40):
        E, P, D = map(mp.mpf, x0)
        R, w = mp.hypot(P, D), mp.sqrt(coupling * mp.hypot(P, D))
        half = mp.atan2(-P, -D) / 2
        k2 = mp.sin(half) ** 2 + (E / (2 * w)) ** 2
        if k2 < 1:
            k = mp.sqrt(k2)
            am = mp.atan2(mp.sin(half) / k, E / (2 * w * k))
            u = mp.ellipf(am, k2) + w * t
            s, c, v = k * mp.ellipfun("sn", u, m=k2), mp.ellipfun("dn", u, m=k2), k * mp.ellipfun("cn", u, m=k2)
        else:
            k = mp.sqrt(k2) * mp.sign(E)
            u = mp.ellipf(half, 1 / k2) + w * k * t
            s, c, v = (mp.ellipfun(f, u, m=1 / k2) for f in ("sn", "cn", "dn"))
            v *= k
        return np.array([float(2 * w * v), float(-2 * R * s * c), float(-R * (c**2 - s**2))])


def test_field_energy_casimir_and_sign():
    system = S.maxwell_bloch(2.5)
    E, P, D = PULSE
    np.testing.assert_allclose(system.vector_field(PULSE), [2.5 * P, E * D, -E * P], rtol=0, atol=1e-15)
    assert system.energy(PULSE) == pytest.approx(E**2 / 2 + 2.5 * D, rel=1e-15)
    assert system.sign == 1 and list(system.casimirs) == ["P^2 + D^2"]


@pytest.mark.parametrize("k", range(len(REFERENCE["states"])))
def test_reference_in_40_digits(k):
    system, late = S.maxwell_bloch(), REFERENCE["states"][k]
    wanted = np.array([float(v) for v in late["x"]])
    x0 = [float(eval(v, {"__builtins__": {}})) for v in REFERENCE["x0"]]
    np.testing.assert_allclose(x0, PULSE, rtol=1e-16)
    # 3/5 and 4/5 are rounded, and the phase goes with them: u t at most
    np.testing.assert_allclose(system.exact(PULSE, late["t"]), wanted, rtol=0, atol=4e-16 * (1 + late["t"]))
    if late["t"] <= 5:
        run = co.integrate(system, PULSE, (0, float(late["t"])), 0.05, co.GaussLegendre(6))
        np.testing.assert_allclose(run.x[-1], wanted, rtol=0, atol=1e-13)


@pytest.mark.parametrize("seed", range(8))
def test_exact_is_the_pendulum(seed):
    rng = np.random.default_rng(seed)
    coupling, x0, t = rng.uniform(0.2, 3.0), rng.uniform(-2, 2, 3), rng.uniform(-20, 20)
    x0[0] *= 1 + 3 * (seed % 2)
    found = S.maxwell_bloch(coupling).exact(x0, t)
    turns = abs(t) * (abs(x0[0]) / 2 + np.sqrt(coupling * np.hypot(x0[1], x0[2])))  # of the phase: rounding grows so
    np.testing.assert_allclose(found, as_pendulum(coupling, x0, t), rtol=0, atol=1e-15 * (4 + turns))


@pytest.mark.parametrize("gap", [1e-2, 1e-6, 1e-10, 1e-12, -1e-2, -1e-6, -1e-10, -1e-12])
def test_near_the_separatrix(gap):
    x0 = np.array([4.0 + gap, 0.0, -2.0])
    for t in (1.0, 10.0, 20.0):
        found = S.maxwell_bloch(2.0).exact(x0, t)
        np.testing.assert_allclose(found, as_pendulum(2.0, x0, t), rtol=0, atol=1e-13)


def test_on_the_separatrix_and_at_rest():
    system, t = S.maxwell_bloch(2.0), np.array([0.0, 0.5, 3.0])
    # w = 2: phi/2 has the sine tanh(2 t)
    s, c = np.tanh(2 * t), 1 / np.cosh(2 * t)
    for way in (1, -1):
        wanted = np.stack([way * 4 * c, -way * 4 * s * c, 2 * (s * s - c * c)], axis=1)
        np.testing.assert_allclose(system.exact([way * 4.0, 0.0, -2.0], t), wanted, rtol=0, atol=2e-15)
    for rest in ([0.0, 0.0, 2.0], [0.0, 0.0, -2.0], [3.0, 0.0, 0.0], [0.0, 0.0, 0.0]):
        np.testing.assert_array_equal(system.exact(rest, t), [rest] * 3)
    # an atom a little off the top: it falls as cosh(2 t)
    np.testing.assert_allclose(system.exact([0.0, 1e-9, 2.0], 1.0)[1], 1e-9 * np.cosh(2.0), rtol=0, atol=1e-15)


def test_the_state_at_time_zero_is_the_given_one():
    system = S.maxwell_bloch(1.7)
    for x0 in np.random.default_rng(2).uniform(-2.0, 2.0, (10, 3)):
        np.testing.assert_array_equal(system.exact(x0, [0.3, 0.0, -0.0, -2.0])[1:3], [x0, x0])
        np.testing.assert_array_equal(system.exact(x0, 0.0), x0)


def test_the_group_element_turns_by_the_area_of_the_pulse():
    system = S.maxwell_bloch(1.5)
    run = co.integrate(system, PULSE, (0.0, 6.0), 0.02, co.Splitting(order=4), attitude=True)
    theta = np.unwrap(np.arctan2(run.x[:, 1], run.x[:, 2]))
    area = theta - theta[0]
    turn = np.stack([[np.cos(area), -np.sin(area)], [np.sin(area), np.cos(area)]]).transpose(2, 0, 1)
    np.testing.assert_allclose(run.attitude[:, :2, :2], turn, rtol=0, atol=1e-13)


CASES = [(1.0, 0.0, 1.0), (1.0, 0.0, -1.0), (0.3, -0.7, 0.4), (-0.5, 0.25, 0.75), (0.25, 1.0, 1.0), (0.5, 0.3, 0.0)]


def solution(coefficients, w, t):
    """w(t) by separating the variables, for complex w: with the roots p, q of quadratic w^2 + linear w + constant."""
    c, b, a = coefficients
    if a == 0.0:
        return (w + c / b) * np.exp(b * t) - c / b
    root = np.sqrt(complex(b * b - 4 * a * c))
    p, q = (-b + root) / (2 * a), (-b - root) / (2 * a)
    if root == 0.0:
        return p + 1 / (1 / (w - p) - a * t)
    ratio = (w - p) / (w - q) * np.exp(a * (p - q) * t)
    return (p - q * ratio) / (1 - ratio)


def roots(x):
    return np.roots([x[0], -2 * x[1], -x[2]])


@pytest.mark.parametrize("coefficients", CASES)
@pytest.mark.parametrize("pair", [(0.2, 1.1), (-0.6, 0.4), (0.3 + 0.5j, 0.3 - 0.5j)])
def test_roots_obey_the_equation(coefficients, pair):
    system = S.riccati(*coefficients)
    x0 = np.real([1.0, sum(pair) / 2, -pair[0] * pair[1]])
    for t in (0.4, -0.3, 1.7):
        wanted = np.array([solution(coefficients, w, t) for w in pair])
        distances = np.abs(wanted[:, None] - roots(system.exact(x0, t)))
        nearest = 1e-12 * np.abs(wanted).max()
        assert distances.min(axis=0).max() < nearest and distances.min(axis=1).max() < nearest


def test_riccati_by_hand():
    c, b, a = 0.3, -0.7, 0.4
    x1, x2, x3 = x = np.array([0.5, -1.2, 0.8])
    system = S.riccati(c, b, a)
    wanted = [-b * x1 - 2 * a * x2, c * x1 + a * x3, -2 * c * x2 + b * x3]
    np.testing.assert_allclose(system.vector_field(x), wanted, rtol=0, atol=1e-15)
    # a root of the moved quadratic moves as the equation says: (x1 w^2 - 2 x2 w - x3)' = 0
    w = (x2 + np.sqrt(x2 * x2 + x1 * x3)) / x1
    d1, d2, d3 = wanted
    assert -(d1 * w * w - 2 * d2 * w - d3) / (2 * (x1 * w - x2)) == pytest.approx(c + b * w + a * w * w, rel=1e-14)
    assert system.energy(x) == pytest.approx(-c * x1 - b * x2 + a * x3) and system.sign == 1
    assert system.casimirs["discriminant"](x) == pytest.approx(x1 * x3 + x2 * x2)


@pytest.mark.parametrize("coefficients", CASES)
def test_runs_and_the_group_element(coefficients):
    system, x0 = S.riccati(*coefficients), np.array([1.0, 0.65, -0.22])
    wanted, g = system.exact(x0, 1.5, attitude=True)
    assert np.linalg.det(g) == pytest.approx(1.0, rel=1e-14)
    moved = complex((g[0, 0] * 0.2 + g[1, 0]) / (g[0, 1] * 0.2 + g[1, 1]))
    assert moved == pytest.approx(solution(coefficients, 0.2, 1.5), rel=1e-12)
    run = co.integrate(system, x0, (0.0, 1.5), 0.05, co.Splitting(order=4), attitude=True)
    coarse = co.integrate(system, x0, (0.0, 1.5), 0.1, co.Splitting(order=4), attitude=True)
    errors = [np.abs(sol.attitude[-1] - g).max() for sol in (coarse, run)]
    assert errors[1] < errors[0] / 8 or errors[0] < 1e-13  # order four; one coefficient alone is one exact flow
    again = system.exact(x0, 1.5, attitude=np.array([[2.0, 1.0], [0.0, 0.5]]))[1]
    np.testing.assert_allclose(again, np.array([[2.0, 1.0], [0.0, 0.5]]) @ g, rtol=1e-14)
    np.testing.assert_allclose(run.x[-1], wanted, rtol=0, atol=1e-4)
    if coefficients == (0.25, 1.0, 1.0):  # a double root: D is nilpotent, and the Cayley transform its exponential
        end = co.integrate(system, x0, (0.0, 1.5), 0.05, co.GaussLegendre(stages=1)).x[-1]
        np.testing.assert_allclose(end, wanted, rtol=0, atol=1e-13)


def test_through_a_pole():
    system = S.riccati()
    x = system.exact([1.0, 0.0, 0.0], np.linspace(0.0, 3.0, 7))  # both roots start at 0: tan t
    np.testing.assert_allclose(x[:, 1] / x[:, 0], np.tan(np.linspace(0.0, 3.0, 7)), rtol=1e-12, atol=1e-14)
    assert np.isfinite(x).all()


J, M = (1.0, 2.5, 4.0), (1.0, 0.5, 2.0, 1.5)


def by_hand(x, J=J, M=M):
    a, b, c, d = x
    j = (J[1] - J[2], J[2] - J[0], J[0] - J[1])
    g = [m * y for m, y in zip(M, x, strict=True)]
    return [
        -j[0] * c * d * g[1] - j[1] * d * b * g[2] - j[2] * b * c * g[3],
        j[0] * c * d * g[0] - a * d * g[2] + a * c * g[3],
        j[1] * d * b * g[0] - a * b * g[3] + a * d * g[1],
        j[2] * b * c * g[0] - a * c * g[1] + a * b * g[2],
    ]


ANY = np.array([0.9, 0.7, -1.1, 0.4])


def test_field_and_derivative():
    system = S.sklyanin(J, M)
    np.testing.assert_allclose(system.vector_field(ANY), by_hand(ANY), rtol=0, atol=2e-15)
    h = 1e-6
    shifts = [(np.array(by_hand(ANY + h * e)) - by_hand(ANY - h * e)) / (2 * h) for e in np.eye(4)]
    np.testing.assert_allclose(system.jacobian(ANY), np.transpose(shifts), rtol=0, atol=1e-9)  # u / h and h^2


@pytest.mark.parametrize("masses", [(1.0, 0.0, 0.0, 0.0), (0.3, 2.0, 2.0, 2.0), (-1.0, 1.5, 3.0, 4.5)])
def test_closed_form_where_the_clock_is_constant(masses):
    system = S.sklyanin(J, masses)
    with mp.workdps(20):
        motion = mp.odefun(lambda t, x: by_hand(x, M=masses), 0, [mp.mpf(v) for v in ANY])
        wanted = np.array([float(v) for v in motion(1)])
    np.testing.assert_allclose(system.exact(ANY, 1.0), wanted, rtol=0, atol=4e-15)
    np.testing.assert_allclose(system.exact([0.0, *ANY[1:]], 5.0), [0.0, *ANY[1:]], rtol=0, atol=1e-15)


def test_closed_forms_that_overflow_or_are_not_known_are_refused():
    for call in (
        lambda: S.maxwell_bloch().exact([1e200, 1.0, 1.0], 1.0),
        lambda: S.riccati(0.0, 1.0, 0.0).exact([1.0, 0.0, 0.0], -1e4),
    ):
        with refused(ValueError, "overflows"):
            call()
    with refused(TypeError, "closed form", "sklyanin"):
        S.sklyanin(J, M).exact(ANY, 1.0)
    with refused(ValueError, "Lie algebra"):
        co.integrate(S.sklyanin(J, M), ANY, (0.0, 1.0), 0.1, co.Splitting(order=2))
