"""Heavy tops and gyrostats by hand, as a pendulum, in steady precession, and their special integrals."""

import numpy as np
import pytest
from motions import (
    FULL,
    ORDERS,
    U,
    assert_bounded,
    assert_integrals,
    assert_order,
    by_hand,
    errors,
    polynomial_of,
    turned,
)
from scipy.integrate import quad
from scipy.special import ellipj, ellipk

import coadjoint as co
from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials
from coadjoint.systems.bodies.goryachev_chaplygin_top import goryachev_chaplygin_integral


@pytest.mark.parametrize("inertia", [(1.0, 2.0, 2.75), FULL])
def test_heavy_top_by_hand(inertia):
    w, x0 = np.array([0.3, -0.4, 0.8]), np.array([1.0, 0.5, -0.7, 0.6, 0.0, 0.8])
    tensor = np.diag(inertia) if np.ndim(inertia) == 1 else inertia
    top = co.systems.heavy_top(inertia, w)

    def field(x):
        omega = np.linalg.solve(tensor, x[:3])
        return np.concatenate([np.cross(x[:3], omega) + np.cross(x[3:], w), np.cross(x[3:], omega)])

    np.testing.assert_allclose(top.vector_field(x0), field(x0), rtol=0, atol=8 * U)
    assert top.sign == -1 and top.integrals == {}
    coarse, fine = errors(top, x0, by_hand(field, x0, 5.0), 5.0, 0.05, co.Splitting(order=2))
    assert 3.0 < coarse / fine < 5.4


def test_a_top_that_swings_in_a_plane_is_a_pendulum():
    """With m and the axis of the swing along e1: I theta'' = -w sin theta, theta from the lowest point, sn of scipy."""
    inertia, w, amplitude = 2.0, 3.0, 1.2
    top = co.systems.heavy_top((inertia, 1.0, 1.5), (0.0, 0.0, w))
    k, rate = np.sin(amplitude / 2), np.sqrt(w / inertia)
    t = 3.0
    sn, cn, dn, _ = ellipj(rate * t, k**2)
    theta, speed = 2 * np.arcsin(k * sn), 2 * rate * k * cn
    assert dn == pytest.approx(np.cos(theta / 2))

    # theta turns the body about e1; the lever along e3 hangs along -vertical where theta = 0.
    def state(theta, speed):
        return np.array([inertia * speed, 0, 0, 0, -np.sin(theta), -np.cos(theta)])

    assert_order(top, state(0.0, 2 * rate * k), state(theta, speed), t, 0.05)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("up", [1.0, -1.0])
def test_steady_precession_of_lagranges_top(order, up):
    """Omega = p gamma + s e3, gamma turns about e3 by -s t, and I1 p^2 cos - I3 (p cos + s) p + w = 0."""
    one, three, w, p, tilt = 1.5, 0.75, up * 0.8, 0.9, 0.6
    spin = (one * p**2 * np.cos(tilt) + w) / (three * p) - p * np.cos(tilt)

    def state(t):
        gamma = np.array([np.sin(tilt) * np.sin(spin * t), np.sin(tilt) * np.cos(spin * t), np.cos(tilt)])
        omega = p * gamma + [0, 0, spin]
        return gamma, np.array([one, one, three]) * omega

    turn = -1.0 if order in ORDERS[3:] else 1.0  # an odd order of the axes is a reflection, and m is no vector there

    def ordered(t):
        gamma, m = state(t)
        return np.concatenate([turn * m[list(order)], gamma[list(order)]])

    inertia, lever = turned(order, np.array([one, one, three]), np.array([0, 0, w]))
    top = co.systems.heavy_top(inertia, lever)
    assert_order(top, ordered(0.0), ordered(4.0), 4.0, 0.05)
    axis = order.index(2) + 1
    assert assert_integrals(top, [f"m{axis}"]) == 4
    if order == (0, 1, 2):
        named = co.systems.lagrange_top(one, three, w)
        np.testing.assert_array_equal(named.vector_field(ordered(1.0)), top.vector_field(ordered(1.0)))
        assert named.integrals == top.integrals and list(named.integrals) == ["m3"]


@pytest.mark.parametrize("height", [1.5, -1.5])
@pytest.mark.parametrize("spin", [0.5, 3.0])
def test_nutation_of_lagranges_top(height, spin):
    """u = gamma3 nutates by (u')^2 = f(u), f of third degree, between two of its roots: by an elliptic sine.

    With c = m3 and b = m . gamma, (I1 u')^2 = 2 I1 (1 - u^2)(E - c^2 / 2 I3 - w u) - (b - c u)^2. The run starts where
    u' = 0. Then gamma' = gamma x Omega also gives how fast gamma turns about the third axis, by an integral over time.
    """
    one, three, tilt, across = 1.5, 0.6, 0.8, 0.4
    top = co.systems.lagrange_top(one, three, height)
    x0 = np.array([across, 0.0, spin, np.sin(tilt), 0.0, np.cos(tilt)])
    b, rest = x0[:3] @ x0[3:], across**2 / (2 * one) + height * np.cos(tilt)
    cubic = np.polynomial.Polynomial([1, 0, -1]) * np.polynomial.Polynomial([2 * one * rest, -2 * one * height])
    cubic -= np.polynomial.Polynomial([b, -spin]) ** 2
    low, middle, high = np.sort(np.real(cubic.roots()))
    # the motion goes on between the roots within [-1, 1]; the third lies beyond, on the side of the sign of the height
    near, far, third = (low, middle, high) if height > 0 else (high, middle, low)
    k2, rate = (far - near) / (third - near), np.sqrt(abs(height) * abs(third - near) / (2 * one))
    K = ellipk(k2)
    from_far = abs(x0[5] - far) < 1e-9
    assert from_far or abs(x0[5] - near) < 1e-9, "the start is a turning point"

    def height_of_axis(t):
        return near + (far - near) * ellipj(rate * t + (K if from_far else 0.0), k2)[0] ** 2

    T = 7.0
    # psi is the angle of (gamma1, gamma2): psi' = -Omega3 + (m1 gamma1 + m2 gamma2) gamma3 / I1 (1 - gamma3^2)
    psi = quad(
        lambda t: (
            -spin / three + (b - spin * height_of_axis(t)) * height_of_axis(t) / one / (1 - height_of_axis(t) ** 2)
        ),
        0.0,
        T,
        epsabs=1e-13,
        epsrel=1e-13,
        limit=200,
    )[0]
    u, radius = height_of_axis(T), np.sqrt(1 - height_of_axis(T) ** 2)
    for scheme in (co.Taylor(order=20), co.GaussLegendre(6)):
        end = co.integrate(top, x0, (0.0, T), 0.05, scheme).x[-1]
        np.testing.assert_allclose(end[3:], [radius * np.cos(psi), radius * np.sin(psi), u], rtol=0, atol=1e-11)
        assert end[:3] @ end[3:] == pytest.approx(b, abs=1e-13) and end[2] == pytest.approx(spin, abs=1e-13)


def test_a_spherical_top_keeps_the_momentum_along_its_lever():
    top = co.systems.heavy_top((2, 2, 2), (0.0, 1.5, 2.0))
    ((name, F),) = top.integrals.items()
    assert name == "m along the axis"
    np.testing.assert_allclose(F.gradient(np.zeros(6)), [0, 0.6, 0.8, 0, 0, 0], rtol=4 * U)
    assert list(co.systems.heavy_top((2, 2, 2), (1, 0, 0)).integrals) == ["m1"]
    assert list(co.systems.heavy_top((2, 2, 2), (0, -3.0, -4.0)).integrals) == ["m along the axis"]
    assert list(co.systems.heavy_top((2, 2, 3), (0, 0.5, 1)).integrals) == []
    assert list(co.systems.heavy_top(np.diag([2.0, 2.0, 3.0]), (0, 0, 1)).integrals) == ["m3"]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("lever", [(1.0, 0.0, 0.0), (0.5, -0.75, 0.0)])
def test_kovalevskayas_integral_in_any_order_of_the_axes(order, lever):
    inertia, w = turned(order, np.array([2.0, 2.0, 1.0]), np.array(lever))
    top = co.systems.heavy_top(inertia, w)
    assert assert_integrals(top, ["K"]) == 4
    if order == (0, 1, 2):
        named = co.systems.kovalevskaya_top(2.0, lever[:2])
        assert named.integrals == top.integrals
        assert_bounded(named, (1.0, 0.5, -0.5, 0.6, 0.8, 0.0))


@pytest.mark.parametrize(("size", "lever"), [(3.0, (0.5, -0.75)), (0.5, (0.0, 2.0))])
def test_named_tops_are_heavy_tops(size, lever):
    x = np.cos(1.0 + np.arange(6.0))
    for named, ratio in ((co.systems.kovalevskaya_top, 2.0), (co.systems.goryachev_chaplygin_top, 4.0)):
        top, other = named(size, lever), co.systems.heavy_top((size, size, size / ratio), (*lever, 0.0))
        omega, m, gamma = x[:3] / [size, size, size / ratio], x[:3], x[3:]
        wanted = np.concatenate([np.cross(m, omega) + np.cross(gamma, [*lever, 0.0]), np.cross(gamma, omega)])
        np.testing.assert_allclose(top.vector_field(x), wanted, rtol=0, atol=32 * U)
        assert top.energy(x) == pytest.approx(m @ omega / 2 + lever[0] * gamma[0] + lever[1] * gamma[1], rel=32 * U)
        assert top.integrals == other.integrals and top.parameters == {"equatorial": size, "lever": lever}
    K = co.systems.kovalevskaya_top(size, lever).integrals["K"]
    turned, along = complex(x[0], x[1]) ** 2 / (2 * size), complex(*lever) * complex(x[3], x[4])
    assert K(x) == pytest.approx(abs(turned - along) ** 2, rel=1e-13)


def test_a_top_that_is_near_kovalevskayas_has_no_integral():
    assert co.systems.heavy_top((2.0, 2.0, 1.0 + 2**-50), (1, 0, 0)).integrals == {}
    assert co.systems.heavy_top((2.0, 2.0, 1.0), (1, 0, 0.1)).integrals == {}


@pytest.mark.parametrize(("size", "lever"), [(4.0, (1.0, 0.0)), (2.0, (0.5, -0.75))])
def test_goryachev_and_chaplygin(size, lever):
    top, F = co.systems.goryachev_chaplygin_top(size, lever), goryachev_chaplygin_integral(size, lever)
    assert top.integrals == {} and top.sign == -1
    np.testing.assert_array_equal(
        top.vector_field(np.arange(6.0)),
        co.systems.heavy_top((size, size, size / 4), (*lever, 0.0)).vector_field(np.arange(6.0)),
    )
    ring = ExactPolynomials(top.algebra)
    m1, m2, _, g1, g2, g3 = ring.coordinates
    momentum = m1 * g1 + m2 * g2 + ring.coordinates[2] * g3
    u, v = (ring.from_polynomial(co.Polynomial({(0,) * 6: c})) for c in lever)
    rate = ring.along(
        [-f for f in ring.field(ring.from_polynomial(polynomial_of(top.hamiltonian)))], ring.from_polynomial(F)
    )
    assert rate == (v * m1 - u * m2) * momentum / int(size) and rate != 0
    level = (1.0, 0.5, -0.5, 0.0, 0.6, 0.6)  # m . gamma = 0
    assert_bounded(top, level, F={"F": F})
    run = co.integrate(top, (1.0, 0.5, -0.5, 0.6, 0.8, 0.0), (0, 5), 0.01, co.Taylor(16), observe={"F": F})
    assert np.ptp(run.observed["F"]) > 0.01  # off the level set it is none
    x0 = np.array(level)

    def field(x):
        omega = x[:3] / [size, size, size / 4]
        return np.concatenate([np.cross(x[:3], omega) + np.cross(x[3:], [*lever, 0]), np.cross(x[3:], omega)])

    coarse, fine = errors(top, x0, by_hand(field, x0, 4.0), 4.0, 0.05, co.Splitting(order=2))
    assert 3.0 < coarse / fine < 5.4


def test_the_blocks_of_the_group_element_of_a_heavy_top():
    w = np.array([0.3, -0.4, 0.8])
    top = co.systems.heavy_top(FULL, w)
    h = 1e-3
    sol = co.integrate(top, (1.0, 0.5, -0.7, 0.6, 0.0, 0.8), (0.0, 1.0), h, co.Splitting(order=4), attitude=True)
    A, r = sol.attitude[:, :3, :3], sol.attitude[:, :3, 3]
    m, gamma = (np.einsum("kij,kj->ki", A, part) for part in (sol.x[:, :3], sol.x[:, 3:]))
    rounding = 64 * U * len(sol.t)
    assert np.abs(gamma - gamma[0]).max() < rounding
    assert np.abs(m + np.cross(r, gamma) - m[0]).max() < rounding
    slope = (r[2:] - r[:-2]) / (2 * h)
    assert np.abs(slope - A[1:-1] @ w).max() < h**2  # a sixth of the third derivative is below 1
    assert np.abs(r[-1]).max() > 0.1


@pytest.mark.parametrize("inertia", [(1.0, 2.0, 2.75), FULL])
def test_gyrostat_by_hand(inertia):
    k, x0 = np.array([0.3, -0.4, 0.8]), np.array([1.0, 0.5, -0.7])
    tensor = np.diag(inertia) if np.ndim(inertia) == 1 else inertia
    system = co.systems.gyrostat(inertia, k)

    def field(x):
        return np.cross(x, np.linalg.solve(tensor, x - k))

    np.testing.assert_allclose(system.vector_field(x0), field(x0), rtol=0, atol=8 * U)
    assert system.energy(x0) == pytest.approx(0.5 * (x0 - k) @ np.linalg.solve(tensor, x0 - k), rel=32 * U)
    assert system.sign == -1 and system.integrals == {} and list(system.casimirs) == ["|x|^2"]
    coarse, fine = errors(system, x0, by_hand(field, x0, 5.0), 5.0, 0.05, co.Splitting(order=2))
    assert 3.0 < coarse / fine < 5.4
    with pytest.raises(TypeError, match="no closed form"):
        system.exact(x0, 1.0)


def test_without_rotors_it_is_the_rigid_body():
    x = np.array([1.0, 0.5, -0.7])
    np.testing.assert_array_equal(
        co.systems.gyrostat(FULL, (0, 0, 0)).vector_field(x), co.systems.rigid_body(FULL).vector_field(x)
    )


@pytest.mark.thinned(2)
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    ("inertia", "rotors"), [((2, 2, 3), (0, 0, 0.7)), ((2, 2, 2), (0.3, -0.4, 0.8)), ((2, 2, 1), (0, 0, 0))]
)
def test_symmetric_gyrostat_in_closed_form(order, inertia, rotors):
    inertia, k, x0 = turned(order, np.array(inertia, float), np.array(rotors, float), [1.0, 0.5, -0.7])
    system = co.systems.gyrostat(inertia, k)
    first = co.systems.rigid_body((1, 2, 3)).exact((0.3, 0.4, 0.5), 1.0, attitude=True)[1]
    h = 2.0**-17  # the error of the central difference is about h^2, 6e-11, and u / h, 1.5e-11
    t = np.array([0.0, 1.3 - h, 1.3, 1.3 + h])
    x, A = system.exact(x0, t, attitude=first)
    np.testing.assert_allclose(x[0], x0, rtol=0, atol=4 * U)
    np.testing.assert_allclose(A @ x[..., None], np.broadcast_to((first @ x0)[:, None], (4, 3, 1)), rtol=0, atol=32 * U)
    omega = (x[2] - k) / inertia
    hat = np.array([[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]])
    np.testing.assert_allclose((A[3] - A[1]) / (2 * h), A[2] @ hat, rtol=0, atol=1e-9)
    np.testing.assert_allclose((x[3] - x[1]) / (2 * h), np.cross(x[2], omega), rtol=0, atol=1e-9)
    run = co.integrate(system, x0, (0.0, 3.0), 0.05, co.Splitting(order=6), attitude=first)
    np.testing.assert_allclose(run.x[-1], system.exact(x0, 3.0), rtol=0, atol=1e-10)
    np.testing.assert_allclose(run.attitude[-1], system.exact(x0, 3.0, attitude=first)[1], rtol=0, atol=1e-10)
    assert assert_integrals(system, list(system.integrals), rounded=rotors[1] != 0) >= 2 and len(system.integrals) == 1


S = co.systems
WRONG = [
    (S.gyrostat, {"rotors": (1e200, 0, 0)}, r"the energy of the rotors, \[1e\+200, 0.0, 0.0\], leaves the range"),
    (S.gyrostat, {"inertia": FULL, "rotors": (1e200, 1e200, 0)}, "the energy of the rotors, .*, leaves the range"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "given", "message"), WRONG)
def test_wrong_parameters(make, given, message):
    with pytest.raises(ValueError, match=message):
        make(**given)
