"""Latitude-longitude grids: against the harmonics themselves, there and back, coarser and finer, from files."""

import numpy as np
import pytest
import scipy.special

import coadjoint as co
from coadjoint.optional_packages import MissingPackageError
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.matrices.sphere_grid import GRIDS, resolved

N = 9
S = co.systems.sphere_euler(N=N)


def harmonic(l, m, latitude, longitude):
    """Return Y_lm with the phase of Condon and Shortley, m >= 0."""
    factor = np.sqrt((2 * l + 1) / (4 * np.pi) * scipy.special.gamma(l - m + 1) / scipy.special.gamma(l + m + 1))
    return factor * scipy.special.lpmv(m, l, np.sin(latitude)) * np.exp(1j * m * longitude)


def summed(modes, latitude, longitude):
    found = np.zeros(np.broadcast_shapes(latitude.shape, longitude.shape))
    for (l, m), c in modes.items():
        if m >= 0:
            found += (c * harmonic(l, m, latitude, longitude)).real * (2 if m else 1)
    return found


@pytest.mark.parametrize("points", GRIDS)
@pytest.mark.parametrize("shape", [None, (12, 7), (3, 1), (40, 61)])
def test_values_are_sums_of_harmonics(points, shape):
    W = S.random(3, degrees=(1, N - 1))
    latitude, longitude = S.grid(shape, points)
    wanted = summed(S.modes(W), latitude[:, None], longitude[None, :])
    found = S.to_grid(W, shape, points)
    assert found.shape == (len(latitude), len(longitude)) == (shape or (N + 1, 2 * N))
    # some N^2 products, with the functions of SciPy good to some N round-offs
    assert np.abs(found - wanted).max() < 8 * N**2 * UNIT_ROUNDOFF * np.abs(wanted).max() + 1e-13
    assert np.all(np.diff(latitude) < 0) and longitude[0] == 0.0


@pytest.mark.parametrize("points", GRIDS)
@pytest.mark.parametrize("shape", [(N + 1, 2 * N), (N + 2, 2 * N - 1), (31, 50)])
def test_there_and_back(points, shape):
    W = S.random(5, degrees=(1, N - 1))
    back = S.from_grid(S.to_grid(W, shape, points), points)
    assert np.abs(back - W).max() < 64 * N**2 * UNIT_ROUNDOFF * np.abs(W).max()


def test_a_grid_of_other_longitudes_and_a_mean():
    W = S.random(6)
    latitude, longitude = S.grid((12, 20))
    field = summed(S.modes(W), latitude[:, None], longitude[None, :] + 0.3)
    back = S.from_grid(field + 5.0, longitude=0.3)
    assert np.abs(back - W).max() < 1e-12 * np.abs(W).max()
    assert abs(np.trace(back)) < 1e-13 * np.abs(W).max()


def test_coarser_and_finer_grids_keep_what_they_resolve():
    W = S.random(7, degrees=(1, 4))
    assert np.abs(S.from_grid(S.to_grid(W, (7, 12))) - W).max() < 1e-12 * np.abs(W).max()
    small = co.systems.sphere_euler(N=5)
    fine = S.to_grid(S.random(8, degrees=(1, N - 1)), (20, 40))
    cut = small.modes(small.from_grid(fine))
    kept = {mode: c for mode, c in S.modes(S.from_grid(fine)).items() if mode[0] < 5}
    assert list(cut) == list(kept)
    assert max(abs(cut[mode] - kept[mode]) for mode in kept) < 1e-12
    # eight columns do not tell the phase of an order of 4
    assert np.abs(S.from_grid(S.to_grid(S.from_modes({(5, 4): 1.0}), (12, 8)))).max() < 1e-12
    degrees = {l for l, _ in S.modes(S.from_grid(S.to_grid(S.random(9), (6, 30))))}
    assert max(degrees) == resolved("clenshaw-curtis", 6) == 4


def test_leading_axes():
    W = np.stack([S.random(1), S.random(2)])[:, None]
    field = S.to_grid(W)
    assert field.shape == (2, 1, N + 1, 2 * N)
    assert np.abs(field[1, 0] - S.to_grid(W[1, 0])).max() < 1e-13
    assert np.abs(S.from_grid(field) - W).max() < 1e-12 * np.abs(W).max()


@pytest.mark.parametrize(
    ("call", "kind", "said"),
    [
        (lambda: S.to_grid(S.random(1), (1, 4)), ValueError, r"shape\[0\] must be a whole number from 2"),
        (lambda: S.to_grid(S.random(1), 12), TypeError, "give two whole numbers"),
        (lambda: S.to_grid(S.random(1), points="gauss"), ValueError, "gauss-legendre"),
        (lambda: S.grid(points="gauss"), ValueError, "gauss-legendre"),
        (lambda: S.from_grid(np.zeros((2, 8))), ValueError, "needs at least 3"),
        (lambda: S.from_grid(np.zeros(8)), ValueError, "rows, columns"),
        (lambda: S.from_grid(np.full((9, 8), np.nan)), ValueError, "finite"),
        (lambda: S.from_grid(np.zeros((9, 8), dtype=complex)), TypeError, "real numbers"),
    ],
)
def test_what_is_refused(call, kind, said):
    with pytest.raises(kind, match=said):
        call()


def test_without_ducc0(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(
        MissingPackageError, match=r'a grid on the sphere needs the package ducc0, .*"coadjoint.fluids."'
    ):
        S.to_grid(S.random(1))
