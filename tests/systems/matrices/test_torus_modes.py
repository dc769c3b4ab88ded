"""Modes and grids of the torus."""

from itertools import product

import numpy as np
import pytest

import coadjoint as co
from coadjoint.rounding import UNIT_ROUNDOFF

N = 9
S = co.systems.torus_euler(N=N)
ROUNDED = 8 * N**2 * UNIT_ROUNDOFF


def summed(modes, x, y):
    return sum((w * np.exp(1j * (n1 * x - n2 * y))).real for (n1, n2), w in modes.items())


@pytest.mark.parametrize("shape", [None, (12, 20), (5, 4), (1, 3), (16, 9)])
def test_values_are_sums_of_waves(shape):
    W = S.random(3, degrees=(1, N // 2))
    x, y = S.grid(shape)
    wanted = summed(S.modes(W), x[:, None], y[None, :])
    found = S.to_grid(W, shape)
    assert found.shape == (len(x), len(y)) == (shape or (N, N))
    assert np.abs(found - wanted).max() < 10 * ROUNDED


@pytest.mark.parametrize("shape", [(N, N), (10, 9), (32, 15)])
def test_there_and_back(shape):
    W = np.stack([S.random(4), S.random(5)])
    back = S.from_grid(S.to_grid(W, shape) + 3.0)
    assert back.shape == W.shape and np.abs(back - W).max() < ROUNDED * np.abs(W).max()
    assert np.abs(S.from_modes(S.mode_array(W)) - W).max() < ROUNDED * np.abs(W).max()


def test_coarse_grids_and_small_sizes_keep_what_they_resolve():
    W = S.from_modes({(1, 2): 1.0, (2, -1): 1j, (3, 0): 0.5, (0, 2): 0.25})
    assert set(S.modes(S.from_grid(S.to_grid(W, (32, 4))))) == {(2, -1), (-2, 1), (3, 0), (-3, 0)}
    small = co.systems.torus_euler(N=5)
    assert set(small.modes(small.from_grid(S.to_grid(W)))) == {(1, 2), (-1, -2), (2, -1), (-2, 1), (0, 2), (0, -2)}


@pytest.mark.parametrize(
    ("modes", "kind", "said"),
    [
        (np.ones((3, 3)), ValueError, r"shape \(3, 3\)"),
        (np.eye(N), ValueError, "not conjugate, or that of"),
        (np.full((N, N), np.nan), ValueError, "finite"),
        ("(1, 0)", TypeError, "modes is"),
        ({(1, 0): 10**400}, ValueError, "too large for float64"),
        ([[10**400] * N] * N, ValueError, "too large for float64"),
        ({(1, 2): 1j, (-1, -2): 1j}, ValueError, r"modes \(1, 2\) and \(-1, -2\) are not conjugate"),
        ({(-1, 2): 0.5, (1, -2): -0.5}, ValueError, "are not conjugate"),
        ({(0, 2): 0.5, (0, -2): 0.25}, ValueError, "are not conjugate"),
        ({(0, 0): 1.0}, ValueError, "not both 0"),
        ({(0, N // 2 + 1): 1.0}, ValueError, "give n1, n2 from -4 to 4"),
        ({(-N // 2, 1): 1.0}, ValueError, "give n1, n2 from -4 to 4"),
        ({(1, 1): np.inf}, ValueError, "a finite w"),
    ],
)
def test_what_is_no_field_is_refused(modes, kind, said):
    with pytest.raises(kind, match=said):
        S.from_modes(modes)


@pytest.mark.parametrize("mode", [(1.7, 0), (0, -0.5), "10", (True, 0.5), (1, 0, 0), 1])
@pytest.mark.parametrize("fluid", [co.systems.torus_euler(N=5), co.systems.sphere_euler(N=5)], ids=str)
def test_mode_numbers_are_whole(fluid, mode):
    with pytest.raises(TypeError, match="modes has"):
        fluid.from_modes({mode: 0.5})


def test_wave_numbers_beyond_the_range_are_refused():
    """Otherwise they would be taken for others mod N."""
    for size in (3, 5, 9):
        s, half = co.systems.torus_euler(N=size), size // 2
        x, y = s.grid()
        for n1, n2 in {*product(range(-half - 2, half + 3), repeat=2), (-(10**30), 0), (1, -size)} - {(0, 0)}:
            modes = {(n1, n2): 0.5 + 0.25j}
            if max(n1, n2, -n1, -n2) > half:
                with pytest.raises(ValueError, match=f"give n1, n2 from -{half} to {half}"):
                    s.from_modes(modes)
            else:
                wave = 2.0 * summed(modes, x[:, None], y[None, :])
                assert np.abs(s.to_grid(s.from_modes(modes)) - wave).max() < ROUNDED
