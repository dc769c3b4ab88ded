"""Bodies and tops with equal moments: integrals for every pattern of equal moments and of components that vanish."""

import itertools

import numpy as np
import pytest

import coadjoint as co

PATTERNS = list(itertools.product((1.0, 2.0), repeat=3))
VECTORS = list(itertools.product((0.0, 0.5, -0.5), repeat=3))


def hat(a):
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def constant_momenta(moments, vector):
    """Return the projection on the axes a with a . (m x M m) = 0 for every m, and a x vector = 0."""
    M = np.diag(1.0 / np.array(moments))
    conditions = []
    for a in np.eye(3):
        turned = hat(a) @ M
        conditions.append(np.concatenate([(turned + turned.T).ravel(), np.cross(a, vector)]))
    _, sizes, axes = np.linalg.svd(np.array(conditions).T)
    null = axes[np.sum(sizes > 1e-9) :]
    return null.T @ null


def along_an_axis(integrals, moments, vector, dim):
    """Whether the momentum along an axis is among the integrals; it must be one that is constant."""
    names = [name for name in integrals if name != "K"]
    kept = constant_momenta(moments, vector)
    assert len(names) == (np.trace(kept) > 0.5), (moments, vector, names)
    for name in names:
        slope = np.asarray(integrals[name].gradient(np.zeros(dim)))
        assert not slope[3:].any()
        np.testing.assert_allclose(kept @ slope[:3], slope[:3], rtol=0, atol=2.0**-50)
        assert np.linalg.norm(slope) == pytest.approx(1.0, rel=2.0**-50)
        if name[1:] in ("1", "2", "3"):
            np.testing.assert_array_equal(slope[:3], np.eye(3)[int(name[1:]) - 1])
    return bool(names)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("moments", PATTERNS)
def test_heavy_tops(moments):
    for lever in VECTORS:
        integrals = co.systems.heavy_top(moments, lever).integrals
        along_an_axis(integrals, moments, lever, 6)
        orders = [(c, (c + 1) % 3, (c + 2) % 3) for c in range(3)]
        kovalevskaya = any(moments[a] == moments[b] == 2.0 * moments[c] and lever[c] == 0.0 for c, a, b in orders)
        assert ("K" in integrals) == kovalevskaya, lever


@pytest.mark.thinned(2)
@pytest.mark.parametrize("moments", PATTERNS)
def test_gyrostats(moments):
    x0, h = np.array([0.6, -0.3, 0.9]), 2.0**-17
    for rotors in VECTORS:
        system = co.systems.gyrostat(moments, rotors)
        known = along_an_axis(system.integrals, moments, np.array(rotors) / moments, 3)
        assert (system.closed_form is not None) == known
        if known:
            # The error of the central difference is about h^2, 6e-11, and u / h, 1.5e-11.
            ends = system.exact(x0, [-0.7 - h, -0.7, -0.7 + h])
            field = system.vector_field(ends[1])
            np.testing.assert_allclose((ends[2] - ends[0]) / (2 * h), field, rtol=0, atol=1e-9)


@pytest.mark.parametrize("moments", PATTERNS)
def test_bodies_of_revolution_and_satellites(moments):
    axes = [k for k in range(3) if moments[k - 1] == moments[k - 2]]
    assert list(co.systems.satellite(moments).integrals) == [f"L{k + 1}" for k in axes]
    for mass in PATTERNS:
        both = [k for k in axes if mass[k - 1] == mass[k - 2]]
        assert list(co.systems.kirchhoff_body(moments, mass).integrals) == [f"m{k + 1}" for k in both]
    tilted = np.diag(moments)
    tilted[0, 1] = tilted[1, 0] = 0.25
    assert co.systems.kirchhoff_body(tilted, (1.0, 1.0, 1.0)).integrals == {}


@pytest.mark.filterwarnings("ignore:.*no body has")
@pytest.mark.parametrize("place", range(3))
def test_moments_whose_inverse_overflows(place):
    """Half and a quarter of a moment may overflow where the moment itself does not."""
    moments = [1.0, 1.0, 1.0]
    moments[place] = 2.0**-1023
    for make in (co.systems.rigid_body, co.systems.heavy_top, co.systems.gyrostat, co.systems.kirchhoff_body):
        with pytest.raises(ValueError, match=rf"inertia\[{place}\] is 1.11\d*e-308, and its inverse overflows"):
            make(moments)
    for make, least in ((co.systems.kovalevskaya_top, 2.0**-1021), (co.systems.goryachev_chaplygin_top, 2.0**-1020)):
        with pytest.raises(ValueError, match=r"equatorial is .* and its inverse overflows"):
            make(least / 2)


@pytest.mark.parametrize("make", [co.systems.so_n_body, co.systems.matrix_body])
@pytest.mark.parametrize("order", list(itertools.permutations(range(4))))
def test_second_moments_of_a_mass_in_any_order(make, order):
    """The two smallest decide, wherever they are."""
    with pytest.raises(ValueError, match="positive"):
        make(np.array([-1.5, 1.0, 3.0, 4.0])[list(order)])
    with pytest.warns(UserWarning, match="a second moment of the mass is negative"):
        make(np.array([-0.5, 1.0, 3.0, 4.0])[list(order)])


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_coefficients_that_miss_the_condition_of_clebsch_by_more_than_rounding(order):
    inertia, c = (np.array(v)[list(order)] for v in ((1.0, 2.0, 4.0), (1.25, 2.0, 3.5)))
    assert list(co.systems.clebsch_body(inertia, c).integrals) == ["F"]
    for k in range(3):
        with pytest.raises(ValueError, match="not a Clebsch case"):
            co.systems.clebsch_body(inertia, c * np.where(np.arange(3) == k, 1.0 + 1e-12, 1.0))
