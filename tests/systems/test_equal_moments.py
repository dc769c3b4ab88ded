"""Bodies and tops with equal moments, and warnings for inertias that no body has."""

import itertools
import warnings

import numpy as np
import pytest

import coadjoint as co
from coadjoint.systems.bodies.inertia import warn_negative_mass

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


NO_BODY = [(1, 1, 5), (5, 1, 1), (1, 5, 1), (1, 2, 4), (1.0, 2.0, 3.0 + 1e-12)]
BODIES = [(1, 2, 3), (3, 1, 2), (0.1, 0.7, 0.8), (0.1, 0.2, 0.3), (1, 1, 1), (1e-3, 1, 1), (2e200, 3e200, 4e200)]
MAKERS = {
    "rigid_body": co.systems.rigid_body,
    "heavy_top": co.systems.heavy_top,
    "gyrostat": co.systems.gyrostat,
    "satellite": lambda inertia: co.systems.satellite(np.array(inertia) / max(inertia)),
}
WARNING = "inertia: a principal moment exceeds the sum of the other two, which no body has"


def turned(moments, seed=4):
    Q = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    tensor = Q @ np.diag(moments) @ Q.T
    return (tensor + tensor.T) / 2


@pytest.mark.parametrize("inertia", NO_BODY)
@pytest.mark.parametrize("maker", MAKERS)
def test_an_inertia_that_no_body_has_is_told(maker, inertia):
    with pytest.warns(UserWarning, match=WARNING) as noticed:
        MAKERS[maker](inertia)
    assert len(noticed) == 1 and noticed[0].filename == __file__


@pytest.mark.parametrize("inertia", BODIES)
@pytest.mark.parametrize("maker", MAKERS)
def test_a_body_is_made_without_a_word(maker, inertia):
    MAKERS[maker](inertia)


@pytest.mark.parametrize("scale", [1e-150, 1.0, 1e150])
def test_a_tensor_is_looked_at_in_its_principal_axes(scale):
    for moments in BODIES[:-1]:
        co.systems.rigid_body(scale * turned(moments))
    with pytest.warns(UserWarning, match=WARNING):
        co.systems.rigid_body(scale * turned((1, 2, 4)))


def test_a_mass_of_points_in_a_plane_is_a_body_whatever_its_axes():
    random = np.random.default_rng(8)
    for _ in range(50):
        turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
        points = np.column_stack([random.normal(size=(20, 2)), np.zeros(20)]) @ turn.T
        tensor = (points**2).sum() * np.eye(3) - points.T @ points
        co.systems.rigid_body((tensor + tensor.T) / 2)


def test_what_is_said_is_a_way_out():
    with pytest.warns(UserWarning, match=r"co.LiePoissonSystem\(co.algebras.so\(3\), co.Quadratic\(...\), sign=-1\)"):
        body = co.systems.rigid_body((1, 1, 5))
    with pytest.warns(UserWarning, match=r"co.algebras.e\(3\)"):
        co.systems.heavy_top((1, 1, 5))
    meant = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1, 1, 1 / 5]), sign=-1)
    assert np.array_equal(meant.vector_field([0.3, 0.4, 0.5]), body.vector_field([0.3, 0.4, 0.5]))


def test_a_line_that_makes_many_is_told_once():
    with warnings.catch_warnings(record=True) as noticed:
        warnings.simplefilter("default")
        for third in range(1, 100):
            co.systems.rigid_body((1, 2, third))
    assert len(noticed) == 1


def test_lagrange_s_top_is_a_body_up_to_a_disk():
    co.systems.lagrange_top(equatorial=1.0, axial=2.0)
    with pytest.warns(UserWarning, match="axial: .* no body has"):
        co.systems.lagrange_top(equatorial=1.0, axial=2.25)


@pytest.mark.parametrize("maker", [co.systems.so_n_body, co.systems.matrix_body])
def test_second_moments_are_of_a_mass(maker):
    maker((0.0, 1.0, 2.0, 3.0))
    with pytest.warns(UserWarning, match=r"negative, which no body has; .* co.LiePoissonSystem\(co.algebras.so\(4\)"):
        maker((-0.5, 1.0, 2.0, 3.0))


@pytest.mark.parametrize("scale", [1e-120, 1.0, 1e120])
@pytest.mark.parametrize("n", [3, 4, 5])
def test_a_flat_mass_has_a_second_moment_of_zero_up_to_rounding(n, scale):
    """Its matrix in other axes has an eigenvalue that is zero up to rounding, of either sign."""
    random, signs = np.random.default_rng(n), set()
    for draw in range(20):
        Q = np.linalg.qr(random.normal(size=(n, n)))[0] * [*[1.0] * (n - 1), 0.0]
        flat = scale * (Q * random.uniform(0.5, 2.0, n)) @ Q.T
        flat = (flat + flat.T) / 2
        signs.add(np.sign(np.linalg.eigvalsh(flat)[0]))
        warn_negative_mass(flat)
        if n == 3 and draw < 4:
            co.systems.so_n_body(flat)
    assert {1.0, -1.0} <= signs
    below = np.eye(n) - 1.001 * np.outer(Q[:, 0], Q[:, 0])
    with pytest.warns(UserWarning, match=rf"is negative, which no body has; .*co.algebras.so\({n}\)") as noticed:
        warn_negative_mass(scale * (below + below.T) / 2)
    assert len(noticed) == 1


def test_what_a_fluid_adds_is_no_body():
    co.systems.kirchhoff_body(inertia=(1, 2, 4))
    co.systems.clebsch_body(inertia=(1.0, 2.0, 4.0), inverse_mass=(1.0, 2.0, 4.0))
