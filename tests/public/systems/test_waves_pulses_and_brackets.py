"""Waves of fluids, functions of momenta, Maxwell-Bloch, Riccati and Sklyanin: equations, closed forms, 40 digits."""

import json
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest

import coadjoint as co
import refusals

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


@pytest.mark.filterwarnings("ignore:.*no body has")
def test_equations_of_waves():
    """As Lorenz wrote them; of a triad as of a body whose moments are the squares of its wave numbers."""
    A, F, G = X0
    wanted = [
        -(1 / K**2 - 1 / (K**2 + L**2)) * K * L * F * G,
        (1 / L**2 - 1 / (K**2 + L**2)) * K * L * A * G,
        -0.5 * (1 / L**2 - 1 / K**2) * K * L * A * F,
    ]
    lorenz = SYSTEMS["Lorenz"]
    np.testing.assert_allclose(lorenz.vector_field(X0), wanted, rtol=0, atol=1e-15)
    # means of u^2 / 2 and of vorticity^2 / 2 of A cos(l y) + F cos(k x) + 2 G sin(l y) sin(k x)
    assert lorenz.energy(X0) == pytest.approx((A**2 / L**2 + F**2 / K**2 + 2 * G**2 / (K**2 + L**2)) / 4, rel=1e-14)
    assert lorenz.casimirs["enstrophy"](X0) == pytest.approx((A**2 + F**2 + 2 * G**2) / 4, rel=1e-14)
    triad = S.fluid_triad((2.0, 2.0), (-1.0, 0.0))  # k^2 = 8, 1, 5, and half the area of the triangle is 1/2
    body = S.rigid_body((8.0, 1.0, 5.0))
    np.testing.assert_allclose(triad.vector_field(X0), body.vector_field(X0), rtol=1e-14)
    assert triad.energy(X0) == pytest.approx(np.sum(X0**2 / [8, 1, 5]) / 4, rel=1e-14)
    assert triad.casimirs["enstrophy"](X0) == pytest.approx(np.sum(X0**2) / 4, rel=1e-14)
    assert lorenz.sign == triad.sign == -1


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
def test_motion_and_group_element_of_riccati(coefficients):
    system, x0 = S.riccati(*coefficients), np.array([1.0, 0.65, -0.22])
    _, g = system.exact(x0, 1.5, attitude=True)
    assert np.linalg.det(g) == pytest.approx(1.0, rel=1e-14)
    moved = complex((g[0, 0] * 0.2 + g[1, 0]) / (g[0, 1] * 0.2 + g[1, 1]))
    assert moved == pytest.approx(solution(coefficients, 0.2, 1.5), rel=1e-12)
    again = system.exact(x0, 1.5, attitude=np.array([[2.0, 1.0], [0.0, 0.5]]))[1]
    np.testing.assert_allclose(again, np.array([[2.0, 1.0], [0.0, 0.5]]) @ g, rtol=1e-14)


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


def test_field_of_sklyanin():
    np.testing.assert_allclose(S.sklyanin(J, M).vector_field(ANY), by_hand(ANY), rtol=0, atol=2e-15)


@pytest.mark.parametrize("masses", [(1.0, 0.0, 0.0, 0.0), (0.3, 2.0, 2.0, 2.0), (-1.0, 1.5, 3.0, 4.5)])
def test_closed_form_where_the_clock_is_constant(masses):
    system = S.sklyanin(J, masses)
    with mp.workdps(20):
        motion = mp.odefun(lambda t, x: by_hand(x, M=masses), 0, [mp.mpf(v) for v in ANY])
        wanted = np.array([float(v) for v in motion(1)])
    np.testing.assert_allclose(system.exact(ANY, 1.0), wanted, rtol=0, atol=4e-15)
    np.testing.assert_allclose(system.exact([0.0, *ANY[1:]], 5.0), [0.0, *ANY[1:]], rtol=0, atol=1e-15)


def test_energies_of_functions_of_momenta():
    masses, x = np.array([1.0, 0.7, -0.3]), np.array([0.7, 0.5, 0.4])
    for stiffness in (1.25, 2.0):
        system = S.separable_cosh("A3,7", masses, stiffness, {"a": 1.5})
        # near zero without cancellation: masses y^2 / 2
        for size in (1.0, 1e-9):
            wanted = np.sum(masses * 2 * (np.sinh(stiffness * size * x / 2) / stiffness) ** 2)
            assert system.energy(size * x) == pytest.approx(wanted, rel=1e-14)
        assert system.sign == 1
