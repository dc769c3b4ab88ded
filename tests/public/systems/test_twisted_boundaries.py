"""Twisted boundaries of spin models: the motion of a larger lattice, energies of spirals, and what is refused."""

import importlib.util

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.skipif(importlib.util.find_spec("gemmi") is None, reason="gemmi is not installed")

SQUARE = co.spins.crystal(lattice=(1, 1.3, 1.7, 90, 90, 90), sites={"Cu": (0, 0, 0)}, space_group="P 1")
BONDS = {bond.offset: bond for bond in SQUARE.bonds(2.01)}
ROW, SECOND, COLUMN, DIAGONAL = (BONDS[n, m, 0] for n, m in ((1, 0), (2, 0), (0, 1), (1, -1)))
AXIS = np.array([0.48, 0.6, 0.64])


def about(axis, angle):
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def invariant(axis):
    """Return a matrix that commutes with rotations about an axis, with a Dzyaloshinskii-Moriya vector along it."""
    x, y, z = axis
    return 0.7 * np.eye(3) - 0.5 * np.outer(axis, axis) + 0.3 * np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])


def lattice(size, axis, **twisted):
    model = co.systems.spins(SQUARE, size, spin=1.5, periodic=(True, True, False), axis=axis, **twisted)
    model = model.exchange(ROW, invariant(axis)).exchange(COLUMN, -0.4).exchange(DIAGONAL, 0.3 * invariant(axis).T)
    return model.biquadratic(ROW, 0.2).single_ion(0, 0.1 * np.outer(axis, axis)).field(0.2 * np.array(axis))


@pytest.mark.parametrize("axis", [(0, 0, 1), AXIS])
def test_motion_is_that_of_a_larger_lattice(axis):
    """Cells of 3 x 4 spins, turned by 2 pi/2 and -2 pi/3 along a and b, fill a periodic lattice of 6 x 12."""
    axis = np.array(axis, dtype=float)
    angles = (np.pi, -2 * np.pi / 3, 0)
    small, large = lattice((3, 4, 1), axis, twist=angles), lattice((6, 12, 1), axis)
    x = np.random.default_rng(1).standard_normal((3, 4, 3))
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    whole = np.concatenate(
        [np.concatenate([x @ about(axis, a * angles[0] + b * angles[1]).T for b in range(3)], axis=1) for a in range(2)]
    )
    assert abs(6 * small.energy(x.ravel()) - large.energy(whole.ravel())) < 1e-12
    ends = [
        co.integrate(model, start.ravel(), (1, 2), 0.02, co.GaussLegendre(3)).x[-1]
        for model, start in ((small, x), (large, whole))
    ]
    assert np.abs(ends[0].reshape(3, 4, 3) - ends[1].reshape(6, 12, 3)[:3, :4]).max() < 1e-12
    if axis[2] == 1:
        splitting = co.integrate(small, x.ravel(), (1, 2), 0.01, co.Splitting(order=6)).x[-1]
        assert np.abs(splitting - ends[0]).max() < 1e-7
        assert list(small.integrals) == ["total S3"]


@pytest.mark.parametrize("axis", [(0, 0, 1), AXIS])
@pytest.mark.parametrize("neutrons", [None, co.spectra.Neutrons()])
@pytest.mark.parametrize("span", [(1, 3), (3, 1)])
def test_spectra_are_those_of_a_larger_lattice(axis, neutrons, span):
    """Where components have no waves the larger lattice has none; elsewhere it has as many times the intensity."""
    axis, angles = np.array(axis, dtype=float), (2 * np.pi / 3, -np.pi / 2, 0)
    small, large = lattice((3, 3, 1), axis, twist=angles), lattice((9, 12, 1), axis)
    x = np.random.default_rng(1).standard_normal((2, 3, 3, 3))
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    rows = [np.concatenate([x @ about(axis, a * angles[0] + b * angles[1]).T for b in range(4)], 2) for a in range(3)]
    runs = [
        co.integrate(model, start.reshape(2, -1), span, 0.1, co.GaussLegendre(3))
        for model, start in ((small, x), (large, np.concatenate(rows, axis=1)))
    ]
    k = np.array([1 / 9, -1 / 12, 0])
    whole = co.spectra.structure_factor(runs[1], co.spectra.Plane((0, 0, 0), (1, 0, 0), (0, 1, 0)), "hann", neutrons)
    number = {tuple(np.rint(q * (9, 12, 1)).astype(int)): row for row, q in enumerate(whole.q)}
    seen = []
    for sign in (0, 1, -1):
        plane = co.spectra.Plane(sign * k, (1, 0, 0), (0, 1, 0))
        S = co.spectra.structure_factor(runs[0], plane, "hann", neutrons)
        assert len(S.q) == 16
        inside = np.all((S.q > -1e-9) & (S.q < 1 + 1e-9), axis=1)
        same = [number[tuple(q)] for q in np.rint(S.q[inside] * (9, 12, 1)).astype(int)]
        for part in ("intensity", "static", "error"):
            found, wanted = 12 * getattr(S, part)[inside], getattr(whole, part)[same]
            np.testing.assert_allclose(found, wanted, rtol=1e-8, atol=1e-9 * wanted.max())
        wanted = whole.components[:, same]
        np.testing.assert_allclose(12 * S.components[:, inside], wanted, rtol=1e-8, atol=1e-9 * wanted.max())
        seen += same
        path = co.spectra.structure_factor(runs[0], [sign * k, sign * k + [1 / 3, 0, 0]], "hann", neutrons)
        np.testing.assert_allclose(path.intensity, S.intensity[[0, 4]], rtol=1e-10, atol=1e-12 * S.intensity.max())
    rest = np.setdiff1d(np.arange(len(whole.q)), seen)
    assert len(rest) > 50 and whole.static[rest].max() < 1e-20 * whole.static.max()
    for path in ([0 * k, k], [0.5 * k, 0.5 * k]):
        with refused(ValueError, "does not fit", "twist / 2 pi"):
            co.spectra.structure_factor(runs[0], path)


def test_components_across_half_a_turn_are_together():
    """A twist of pi has S+ and S- at the same wave vectors, where the spins across the axis are whole."""
    model = lattice((4, 3, 1), (0, 0, 1), twist=(np.pi, 0, 0))
    x = np.random.default_rng(2).standard_normal((4, 3, 3))
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    sol = co.integrate(model, x.ravel(), (0, 1), 0.1)
    S = co.spectra.structure_factor(sol, [(1 / 8, 0, 0), (3 / 8, 0, 0)], None)
    waves = np.exp(-2j * np.pi * model.cells @ S.q.T)
    sums = 1.5 * np.einsum("tia,ik->tak", sol.x.reshape(len(sol.t), -1, 3), waves)
    np.testing.assert_allclose(S.static, np.mean(np.sum(abs(sums[:, :2]) ** 2, axis=1), axis=0) / 12, rtol=1e-12)


def test_what_a_twist_conserves():
    """Of the total spin the component along the axis alone, also where no exchange is twisted."""
    row = co.systems.spins(SQUARE, (3, 1, 1), periodic=(True, False, False), twist=(1.0, 0, 0)).biquadratic(ROW, 0.5)
    x0 = np.random.default_rng(3).standard_normal((3, 3))
    x0 /= np.linalg.norm(x0, axis=1, keepdims=True)
    sol = co.integrate(row, x0.ravel(), (0, 1), 0.01, co.GaussLegendre(3))
    totals = np.ptp(sol.x.reshape(len(sol.t), 3, 3).sum(axis=1), axis=0)
    assert list(row.integrals) == ["total S3"] and totals[2] < 1e-13 and totals[:2].min() > 1e-3


def test_spirals_of_any_wave_vector():
    """A chain with J1 < 0 < J2 has at the wave vector q the energy S^2 (J1 cos q + J2 cos 2q) a site, at rest."""
    J1, J2, S, cells = -1.0, 0.4, 1.5, 5
    for q in (0.37, np.arccos(-J1 / (4 * J2)), 2.0):
        chain = co.systems.spins(SQUARE, (cells, 1, 1), spin=S, periodic=(True, False, False), twist=(q * cells, 0, 0))
        chain = chain.exchange(ROW, J1).exchange(SECOND, J2)
        turns = q * np.arange(cells)
        spiral = np.stack([np.cos(turns), np.sin(turns), 0 * turns], axis=-1).ravel()
        assert abs(chain.energy(spiral) / cells - S**2 * (J1 * np.cos(q) + J2 * np.cos(2 * q))) < 1e-13
        assert np.abs(chain.vector_field(spiral)).max() < 1e-13
    best = -J1 / (4 * J2)
    ground = co.systems.spins(
        SQUARE, (cells, 1, 1), spin=S, periodic=(True, False, False), twist=(np.arccos(best) * cells, 0, 0)
    )
    found = co.equilibrium(ground.exchange(ROW, J1).exchange(SECOND, J2), spiral + 0.0)
    assert found.energy >= cells * S**2 * (J1 * best + J2 * (2 * best**2 - 1)) - 1e-9


def test_what_is_refused():
    plain = co.systems.spins(SQUARE, (4, 4, 4), twist=(0.5, 0, 0))
    assert plain.twist == (0.5, 0, 0) and "twist" in str(plain)
    assert co.systems.spins(SQUARE, (4, 4, 4), twist=(0, 0, 0)).twist == (0, 0, 0)
    with refused(ValueError, "exchange on bond", "axis", "twist"):
        plain.exchange(ROW, np.diag([1.0, 0.9, 1.0]))
    with refused(ValueError, "dzyaloshinskii_moriya", "twist"):
        plain.dzyaloshinskii_moriya(ROW, (0.1, 0, 0))
    plain.dzyaloshinskii_moriya(ROW, (0, 0, 0.1)).single_ion(0, {"B20": 1.0, "B40": 0.1})
    for term in (np.diag([1.0, 0, 0]), {"B44": 0.1}, {"B21": 0.1}):
        with refused(ValueError, "single_ion on site Cu 0", "twist"):
            plain.single_ion(0, term)
    with refused(ValueError, "field", "twist"):
        plain.field((0.1, 0, 1.0))
    with refused(ValueError, "function", "twisted"):
        plain.field(lambda t: (0.0, 0.0, 1.0))
    with refused(ValueError, "dipolar", "twisted"):
        plain.dipolar()
    with refused(ValueError, "twist", "along a", "open"):
        co.systems.spins(SQUARE, (4, 4, 4), periodic=(False, True, True), twist=(0.5, 0, 0))
    with refused(ValueError, "twist", "(2,)"):
        co.systems.spins(SQUARE, (4, 4, 4), twist=(0.5, 0))
    with refused(ValueError, "axis", "direction"):
        co.systems.spins(SQUARE, (4, 4, 4), twist=(0.5, 0, 0), axis=(0, 0, 0))
    still = plain.exchange(ROW, 1.0)
    sol = co.integrate(still, np.tile([0.0, 0, 1], 64), (0, 1), 0.1, co.GaussLegendre(1))
    with refused(ValueError, "with the twist", "Powder"):
        co.spectra.structure_factor(sol, co.spectra.Powder([1, 2]))
    other = co.systems.spins(SQUARE, (4, 4, 4), twist=(0.1, 0, 0)).exchange(ROW, 1.0)
    both = co.integrate(co.batch([still, other]), np.tile([0.0, 0, 1], (2, 64)), (0, 1), 0.1, co.GaussLegendre(1))
    with refused(ValueError, "different lattices", "with the twist (0.1, 0.0, 0.0)"):
        co.spectra.structure_factor(both, [(0, 0, 0)])
