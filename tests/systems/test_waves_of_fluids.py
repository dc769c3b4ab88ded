"""Lorenz 1960 and the fluid triad: against the Euler equations on a grid, by hand, and against the closed form."""

import mpmath as mp
import numpy as np
import pytest
from two_steps import assert_bounded_by_order, assert_order

import coadjoint as co
from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials

K, L = 0.75, 1.25
FIRST, SECOND = (1.0, 0.5), (-0.25, 1.5)
SYSTEMS = {
    "Lorenz": co.systems.lorenz_1960(K, L),
    "Lorenz, stable": co.systems.lorenz_1960(2.0, 1.0),
    "triad": co.systems.fluid_triad(FIRST, SECOND),
    "triad, other sense": co.systems.fluid_triad(SECOND, FIRST),
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
def test_closed_form_and_orders(name):
    system = SYSTEMS[name]
    with mp.workdps(25):
        c = [mp.mpf(v) for v in system.vector_field([1.0, 1.0, 1.0])]
        motion = mp.odefun(
            lambda t, x: [c[0] * x[1] * x[2], c[1] * x[2] * x[0], c[2] * x[0] * x[1]], 0, [*map(mp.mpf, X0)]
        )
        wanted = np.array([float(v) for v in motion(2)])
    np.testing.assert_allclose(system.exact(X0, 2.0), wanted, rtol=0, atol=1e-14)
    np.testing.assert_allclose(system.exact(wanted, [-2.0, 0.0]), [X0, wanted], rtol=0, atol=1e-14)
    for method in (co.Splitting(order=2), co.Splitting(order=4), co.GaussLegendre(stages=1)):
        assert_order(system, X0, 2.0, 0.1, method, wanted)


@pytest.mark.parametrize("name", SYSTEMS)
def test_enstrophy_and_energy(name):
    system = SYSTEMS[name]
    ring = ExactPolynomials(system.algebra)
    enstrophy = ring.from_polynomial(system.casimirs["enstrophy"])
    assert all(ring.bracket(enstrophy, x) == ring.zero for x in ring.coordinates)
    run = co.integrate(system, X0, (0.0, 100.0), 0.1, co.Splitting(order=2))
    assert run.drift()["enstrophy"] < 1e-14
    assert_bounded_by_order(system.energy, system, X0, 20.0, 0.1, co.Splitting(order=2))


def test_a_triad_is_a_body_of_the_textbook():
    triad = co.systems.fluid_triad((2.0, 2.0), (-1.0, 0.0))  # k^2 = 8, 1, 5, and S/2 = 1
    with pytest.warns(UserWarning, match="no body has"):  # its moments are those of waves
        body = co.systems.rigid_body((8.0, 1.0, 5.0))
    np.testing.assert_allclose(triad.vector_field(X0), body.vector_field(X0), rtol=1e-14)
    np.testing.assert_allclose(triad.exact(X0, 3.0), body.exact(X0, 3.0), rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"first": (1e-160, 0.0), "second": (0.0, 1e-160)}, "leave the range of float64"),
        ({"first": (1e170, 0.0), "second": (0.0, 1e-10)}, "leave the range of float64 when squared"),
    ],
)
def test_wrong_triads(given, message):
    with pytest.raises(ValueError, match=message):
        co.systems.fluid_triad(**given)


@pytest.mark.parametrize(
    ("k", "l", "message"),
    [
        (1e-170, 1.0, "leave the range of float64"),
        (9.6e153, 9.6e153, "the squares of k = 9.6e\\+153 and l = 9.6e\\+153 leave the range of float64"),
    ],
)
def test_wrong_wave_numbers(k, l, message):
    with pytest.raises(ValueError, match=message):
        co.systems.lorenz_1960(k, l)
