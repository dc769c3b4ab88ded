"""Rigid bodies, gyrostats, tops, bodies in fluids and of n dimensions: by hand, in 40 digits, and their integrals."""

import itertools
import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from brackets import U, assert_integrals, bracket, exact, rational_points
from scipy.linalg import expm, solve_sylvester

import coadjoint as co
from refusals import refused

S = co.systems
FULL = np.array([[2.0, 0.25, -0.1], [0.25, 3.0, 0.5], [-0.1, 0.5, 4.0]])
MASS = np.array([[3.0, -0.5, 0.2], [-0.5, 2.0, 0.1], [0.2, 0.1, 4.0]])
MIXED = np.array([[0.2, 0.5, -0.1], [0.0, -0.3, 0.4], [0.3, 0.1, 0.25]])
ORDERS = [(0, 1, 2), (1, 2, 0), (2, 0, 1), (1, 0, 2), (0, 2, 1), (2, 1, 0)]
X = np.array([1.0, 0.5, -0.7, 0.6, 0.2, 0.8])
REFERENCE = json.loads((Path(__file__).parent / "tops_reference.json").read_text())["systems"]


def turned(order, *triples):
    """The same vectors with their axes in another order."""
    return [np.asarray(v)[list(order)] for v in triples]


def end_of(system, x0, t, step=0.05, method=None):
    return co.integrate(system, x0, (0.0, t), step, method or co.Taylor(order=20), save_every=10**6).x[-1]


def tensor(moments):
    return np.diag(moments) if np.ndim(moments) == 1 else np.asarray(moments)


@pytest.mark.parametrize("inertia", [(1.0, 2.0, 2.75), FULL], ids=["diagonal", "full"])
def test_fields_and_energies_by_hand(inertia):
    m, gamma, M = X[:3], X[3:], tensor(inertia)
    k = lever = np.array([0.3, -0.4, 0.8])
    omega = np.linalg.solve(M, m)
    body, top, gyrostat = S.rigid_body(inertia), S.heavy_top(inertia, lever), S.gyrostat(inertia, k)
    turning = np.concatenate([np.cross(m, omega) + np.cross(gamma, lever), np.cross(gamma, omega)])
    relative = np.linalg.solve(M, m - k)
    for system, x, field, energy in (
        (body, m, np.cross(m, omega), m @ omega / 2),
        (top, X, turning, m @ omega / 2 + lever @ gamma),
        (gyrostat, m, np.cross(m, relative), (m - k) @ relative / 2),
    ):
        np.testing.assert_allclose(system.vector_field(x), field, rtol=0, atol=8 * U)
        assert system.energy(x) == pytest.approx(energy, rel=32 * U)
        assert system.sign == -1 and system.integrals == {}
        np.testing.assert_array_equal(system.hamiltonian.hessian(x), system.hamiltonian.hessian(x).T)
    assert list(gyrostat.casimirs) == ["|x|^2"]
    np.testing.assert_array_equal(S.gyrostat(inertia, (0, 0, 0)).vector_field(m), body.vector_field(m))


def test_the_papers_systems_by_hand():
    x = np.array([1.0, 2.0, 0.5])
    inertia = np.array([1.0, 2.0, 2.5])
    paper = S.paper_rigid_body(1 / inertia)
    np.testing.assert_allclose(paper.vector_field(x), np.cross(x / inertia, x), rtol=1e-15)
    assert paper.sign == 1
    assert S.paper_a37().energy(np.ones(3)) == pytest.approx(1.505, rel=1e-15)
    # [e1, e3] = a e1 - e2 and [e2, e3] = e1 + a e2: x' = J(x) M x
    for a, masses in ((1.3, (0.7, -0.4, 1.1)), (-0.5, (0.0, 2.0, 0.25)), (0.0, (1.0, 0.5, 2.0))):
        system = S.paper_a37(a, masses)
        one, two, three = np.array(masses) * x
        first, second = a * x[0] - x[1], x[0] + a * x[1]
        wanted = [first * three, second * three, -first * one - second * two]
        np.testing.assert_allclose(system.vector_field(x), wanted, rtol=0, atol=1e-15)
        assert system.energy(x) == pytest.approx(0.5 * np.dot(masses, x**2), rel=1e-15)
        assert system.sign == 1 and system.parameters == {"a": a, "masses": masses}
        if a > 0:
            log = np.log(x[0] ** 2 + x[1] ** 2) - 2 * a * np.arctan2(x[1], x[0])
            assert system.casimirs["log C"](x) == pytest.approx(log, rel=1e-13)


@pytest.mark.parametrize(
    ("inertia", "mass", "coupling"),
    [((1.0, 2.0, 3.5), (1.5, 0.5, 2.0), np.zeros((3, 3))), (FULL, MASS, MIXED), ((1.0, 2.0, 3.5), MASS, 0 * MIXED)],
)
def test_kirchhoffs_body_by_hand(inertia, mass, coupling):
    K = np.block([[tensor(inertia), coupling], [coupling.T, tensor(mass)]])
    body = S.kirchhoff_body(inertia, mass, coupling)
    omega, v = np.split(np.linalg.solve(K, X), 2)
    field = np.concatenate([np.cross(X[:3], omega) + np.cross(X[3:], v), np.cross(X[3:], omega)])
    np.testing.assert_allclose(body.vector_field(X), field, rtol=0, atol=64 * U)
    assert body.energy(X) == pytest.approx(0.5 * X @ np.linalg.solve(K, X), rel=64 * U)
    assert body.sign == -1 and body.integrals == {}


@pytest.mark.parametrize("name", REFERENCE)
def test_tops_in_40_digits(name):
    given, system = REFERENCE[name], S.get(name)
    x0, x = [float(Fraction(v)) for v in given["x0"]], np.cos(np.arange(6.0))
    names = {f"x{i + 1}": v for i, v in enumerate(x)}
    field = [eval(text, {}, names) for text in given["vector_field"]]
    np.testing.assert_allclose(system.vector_field(x), field, rtol=0, atol=16 * U)
    assert system.energy(x) == pytest.approx(eval(given["hamiltonian"], {}, names), rel=16 * U)
    for value in given["values"][:2]:
        wanted, t = np.array(value["x"], dtype=float), float(value["t"])
        error = np.abs(end_of(system, x0, t) - wanted).max()
        assert error < 64 * U * (1.0 + t / 0.05) * max(1.0, np.abs(wanted).max())
    states = np.random.default_rng(3).uniform(-1.0, 1.0, (3, 6))
    for text, F in zip(given["integrals"], system.integrals.values(), strict=True):
        theirs = [eval(text, {}, {f"x{i + 1}": v for i, v in enumerate(x)}) for x in states]
        factor = theirs[0] / F(states[0])
        np.testing.assert_allclose(theirs, np.multiply(factor, [F(x) for x in states]), rtol=1e-13)
        # The reference has integers for coefficients.
        assert min(abs(abs(factor) - known) for known in (0.5, 1, 2)) < 1e-13


@pytest.mark.parametrize("up", [1.0, -1.0])
def test_steady_precession_of_lagranges_top(up):
    """Omega = p gamma + s e3, gamma turns about e3 by -s t, and I1 p^2 cos - I3 (p cos + s) p + w = 0."""
    one, three, w, p, tilt = 1.5, 0.75, up * 0.8, 0.9, 0.6
    spin = (one * p**2 * np.cos(tilt) + w) / (three * p) - p * np.cos(tilt)

    def state(t):
        gamma = np.array([np.sin(tilt) * np.sin(spin * t), np.sin(tilt) * np.cos(spin * t), np.cos(tilt)])
        return np.concatenate([np.array([one, one, three]) * (p * gamma + [0, 0, spin]), gamma])

    top, named = S.heavy_top((one, one, three), (0, 0, w)), S.lagrange_top(one, three, w)
    np.testing.assert_allclose(end_of(top, state(0.0), 4.0), state(4.0), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(named.vector_field(state(1.0)), top.vector_field(state(1.0)))
    assert named.integrals == top.integrals and list(named.integrals) == ["m3"]


@pytest.mark.parametrize("order", ORDERS)
def test_integrals_in_any_order_of_the_axes(order):
    """Kovalevskaya's and Clebsch's, with all of their independent companions."""
    for lever in ((1.0, 0.0, 0.0), (0.5, -0.75, 0.0)):
        assert assert_integrals(S.heavy_top(*turned(order, (2.0, 2.0, 1.0), lever)), ["K"]) == 4
    for inertia, c in (
        ((1, 1, 1), (1.0, 1.5, 3.0)),
        ((2, 2, 2), (-1, 0.5, 4)),
        ((1, 2, 4), (1.25, 2.0, 3.5)),
        ((1, 1, 4), (2, 2, 0.5)),
    ):
        inertia, c = turned(order, np.array(inertia, float), np.array(c, float))
        body = S.clebsch_body(inertia, c)
        assert assert_integrals(body, ["F"]) == 4
        if (c > 0).all():
            x = np.cos(np.arange(6.0))
            same = S.kirchhoff_body(inertia, 1 / c)
            np.testing.assert_allclose(body.vector_field(x), same.vector_field(x), rtol=0, atol=32 * U)
    inertia, c = turned(order, np.array([1.0, 2.0, 4.0]), np.array([1.25, 2.0, 3.5]))
    for k in range(3):
        with refused(ValueError, "Clebsch"):
            S.clebsch_body(inertia, c * np.where(np.arange(3) == k, 1.0 + 1e-12, 1.0))


def test_cases_of_clebsch():
    """Rounded coefficients are accepted; of others the nearest case is named."""
    rng = np.random.default_rng(5)
    for _ in range(50):
        inertia, (alpha, beta) = rng.uniform(0.3, 3.0, 3), rng.uniform(-2.0, 2.0, 2)
        assert S.clebsch_body(inertia, alpha + beta * inertia).integrals
    with refused(ValueError, "Clebsch", "0.833333", "1.83333", "2.83333"):
        S.clebsch_body(inertia=(1, 2, 3))


@pytest.mark.parametrize(("size", "lever"), [(3.0, (0.5, -0.75)), (0.5, (0.0, 2.0)), (4.0, (1.0, 0.0))])
def test_named_tops_are_heavy_tops(size, lever):
    x = np.cos(1.0 + np.arange(6.0))
    for named, ratio in ((S.kovalevskaya_top, 2.0), (S.goryachev_chaplygin_top, 4.0)):
        top, other = named(size, lever), S.heavy_top((size, size, size / ratio), (*lever, 0.0))
        np.testing.assert_array_equal(top.vector_field(x), other.vector_field(x))
        assert top.energy(x) == other.energy(x) and top.sign == -1
        assert top.integrals == other.integrals and top.parameters == {"equatorial": size, "lever": lever}
    K = S.kovalevskaya_top(size, lever).integrals["K"]
    spun, along = complex(x[0], x[1]) ** 2 / (2 * size), complex(*lever) * complex(x[3], x[4])
    assert K(x) == pytest.approx(abs(spun - along) ** 2, rel=1e-13)
    # m3 (m1^2 + m2^2) / I1 - gamma3 (u m1 + v m2) changes at the rate (v m1 - u m2)(m . gamma) / I1
    m1, m2, m3, g1, g2, g3 = (co.Polynomial.variable(k, 6) for k in range(6))
    u, v = map(Fraction, lever)
    chaplygin = m3 * (m1**2 + m2**2) / Fraction(size) - g3 * (u * m1 + v * m2)
    rate = (v * m1 - u * m2) * (m1 * g1 + m2 * g2 + m3 * g3) / Fraction(size)
    top = S.goryachev_chaplygin_top(size, lever)
    assert top.integrals == {}
    for point in rational_points(6):
        found, wanted = bracket(top, chaplygin, top.hamiltonian, point), exact(rate)(point)
        assert min(abs(found - wanted), abs(found + wanted)) < 64 * U and wanted != 0


PATTERNS = list(itertools.product((1.0, 2.0), repeat=3))
VECTORS = list(itertools.product((0.0, 0.5, -0.5), repeat=3))


def hat(a):
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def momentum_along_an_axis(integrals, moments, vector, dim):
    """Check that it is among the integrals if one is constant: a . (m x M m) = 0 for every m, and a x vector = 0."""
    M = np.diag(1.0 / np.array(moments))
    conditions = []
    for a in np.eye(3):
        crossed = hat(a) @ M
        conditions.append(np.concatenate([(crossed + crossed.T).ravel(), np.cross(a, vector)]))
    _, sizes, axes = np.linalg.svd(np.array(conditions).T)
    null = axes[np.sum(sizes > 1e-9) :]
    kept, names = null.T @ null, [name for name in integrals if name != "K"]
    assert len(names) == (np.trace(kept) > 0.5), (moments, vector, names)
    for name in names:
        slope = np.asarray(integrals[name].gradient(np.zeros(dim)))
        assert not slope[3:].any()
        np.testing.assert_allclose(kept @ slope[:3], slope[:3], rtol=0, atol=2.0**-50)
        assert np.linalg.norm(slope) == pytest.approx(1.0, rel=2.0**-50)
        if name[1:] in ("1", "2", "3"):
            np.testing.assert_array_equal(slope[:3], np.eye(3)[int(name[1:]) - 1])
    return bool(names)


@pytest.mark.parametrize("moments", PATTERNS)
def test_integrals_and_closed_forms_of_equal_moments(moments):
    orders = [(c, (c + 1) % 3, (c + 2) % 3) for c in range(3)]
    for vector in VECTORS:
        integrals = S.heavy_top(moments, vector).integrals
        momentum_along_an_axis(integrals, moments, vector, 6)
        kovalevskaya = any(moments[a] == moments[b] == 2.0 * moments[c] and vector[c] == 0.0 for c, a, b in orders)
        assert ("K" in integrals) == kovalevskaya, vector
        gyrostat = S.gyrostat(moments, vector)
        if momentum_along_an_axis(gyrostat.integrals, moments, np.array(vector) / moments, 3):
            gyrostat.exact((0.6, -0.3, 0.9), 0.5)  # `test_every_system` has its motion
        else:
            with refused(TypeError, "closed form", "gyrostat"):
                gyrostat.exact((0.6, -0.3, 0.9), 0.5)
    axes = [k for k in range(3) if moments[k - 1] == moments[k - 2]]
    assert list(S.satellite(moments).integrals) == [f"L{k + 1}" for k in axes]
    for mass in PATTERNS:
        both = [k for k in axes if mass[k - 1] == mass[k - 2]]
        assert list(S.kirchhoff_body(moments, mass).integrals) == [f"m{k + 1}" for k in both]
    for moment, w in ((1.0 + 2**-50, 0.0), (1.0, 0.1)):  # nearly Kovalevskaya's top
        assert S.heavy_top((2.0, 2.0, moment), (1, 0, w)).integrals == {}
    tilted = np.diag(moments)
    tilted[0, 1] = tilted[1, 0] = 0.25
    assert S.kirchhoff_body(tilted, (1.0, 1.0, 1.0)).integrals == {}


def matrix_of(system, x):
    return np.einsum("k,kij->ij", x, system.representation)


@pytest.mark.thinned(1)
@pytest.mark.parametrize(("n", "full"), [(3, False), (4, True), (5, False), (5, True), (6, False)])
def test_so_n_body_by_hand(n, full):
    rng = np.random.default_rng(n)
    root = rng.uniform(-1.0, 1.0, (n, n))
    Lambda = root @ root.T + np.eye(n) if full else np.diag(rng.uniform(0.5, 2.0, n))
    body = co.systems.so_n_body(Lambda if full else np.diag(Lambda))
    x0 = rng.uniform(-1.0, 1.0, body.dim)
    X = matrix_of(body, x0)
    Omega = solve_sylvester(Lambda, Lambda, X)
    np.testing.assert_allclose(matrix_of(body, body.vector_field(x0)), X @ Omega - Omega @ X, rtol=0, atol=1e3 * U)
    assert body.energy(x0) == pytest.approx(0.25 * np.sum(X * Omega), rel=1e3 * U)
    assert body.sign == -1
    sol = co.integrate(body, x0, (0.0, 2.0), 0.05, co.Splitting(order=2), attitude=True)
    spatial = [g @ matrix_of(body, x) @ g.T for g, x in zip(sol.attitude, sol.x, strict=True)]
    np.testing.assert_allclose(spatial[-1], spatial[0], rtol=0, atol=1e4 * U)


@pytest.mark.parametrize("n", [3, 4, 5, 6])
def test_integrals_of_manakov_are_in_involution_and_complete(n):
    a = np.array([1.0, -2.0, 0.5, 3.0, 4.0, -1.5])[:n]
    top = co.systems.manakov_top(a, a**3 - 2 * a**2)  # all coefficients are short binary fractions
    dim, rank = n * (n - 1) // 2, n // 2
    squares, fourth = ["X^2 a", "X^2 a^2", "X^2 a^3", "X^2 a^4"], ["X^4 a", "X^4 a^2"]
    assert list(top.integrals) == squares[: n - 2] + fourth[: max(n - 4, 0)]
    found = list(top.integrals.values())
    for F in [*found, top.hamiltonian]:
        for G in found:
            if n < 6 or F is top.hamiltonian or not isinstance(F, co.Polynomial):
                (point,) = rational_points(dim, 1)
                assert bracket(top, F, G, point) == 0
    x = np.cos(1.0 + np.arange(dim) ** 2)
    X, mu = matrix_of(top, x), 0.37
    # (-1)^j / m times the coefficient of mu^(m - 2j), from values at many mu by interpolation
    for m in range(3, n + 1):
        nodes = np.linspace(-1.0, 1.0, m + 1) + mu
        values = [np.trace(np.linalg.matrix_power(X + v * np.diag(a), m)) for v in nodes]
        coefficients = np.linalg.solve(np.vander(nodes, increasing=True), values)
        for j in range(1, (m + 1) // 2):
            power = m - 2 * j
            F = top.integrals[f"X^{2 * j} a" + (f"^{power}" if power > 1 else "")]
            assert exact(F)(x) == pytest.approx((-1) ** j / m * coefficients[power], rel=1e-8)
    gradients = [F.gradient(x) for F in found]
    for j in range(1, rank + 1):  # those of the Casimirs tr X^2j
        power = np.linalg.matrix_power(X, 2 * j - 1)
        gradients.append([np.sum(power * E.T) for E in top.representation])
    assert np.linalg.matrix_rank(gradients) == (dim - rank) // 2 + rank  # complete: half of the orbit, and the Casimirs


def test_manakovs_top_by_hand():
    rng = np.random.default_rng(8)
    for n in (3, 4, 5):
        a, b, weights = rng.uniform(-2, 2, n), rng.uniform(-2, 2, n), np.zeros((n, n))
        top, apart = co.systems.manakov_top(a, b), ~np.eye(n, dtype=bool)
        weights[apart] = np.subtract.outer(b, b)[apart] / np.subtract.outer(a, a)[apart]
        x = rng.uniform(-1, 1, top.dim)
        X = matrix_of(top, x)
        wanted = X @ (weights * X) - (weights * X) @ X
        off = np.abs(matrix_of(top, top.vector_field(x)) - wanted)
        assert off.max() < 1e3 * U * np.abs(weights).max()


def test_the_body_of_three_dimensions_is_the_rigid_body_and_manakovs_top():
    moments, x = np.array([1.0, 2.0, 4.0]), np.array([0.3, -0.5, 0.9])
    body = co.systems.so_n_body(moments)
    rigid = co.systems.rigid_body(moments.sum() - moments)
    top = co.systems.manakov_top(moments**2, moments)
    full = co.systems.rigid_body(np.trace(FULL) * np.eye(3) - FULL)
    for one, other, rounding in ((body, rigid, 4), (body, top, 4), (co.systems.so_n_body(FULL), full, 8)):
        np.testing.assert_allclose(one.vector_field(x), other.vector_field(x), rtol=0, atol=rounding * U)
    np.testing.assert_allclose(end_of(body, x, 8.0), rigid.exact(x, 8.0), rtol=0, atol=1e-12)


def test_a_symmetric_body_of_four_dimensions_in_closed_form():
    """For (a, a, a, b) the block of the first three axes is constant, and the last column turns by it."""
    a, b, t = 1.25, 0.5, 6.0
    body = co.systems.so_n_body((a, a, a, b))
    x0 = np.array([0.5, -0.75, 0.25, 1.0, 0.5, -0.5])
    X = matrix_of(body, x0)
    exact = X.copy()
    exact[:3, 3] = expm((1 / (a + b) - 1 / (2 * a)) * t * X[:3, :3]) @ X[:3, 3]
    exact[3, :3] = -exact[:3, 3]
    states = np.linalg.lstsq(body.representation.reshape(6, 16).T, exact.ravel(), rcond=None)[0]
    np.testing.assert_allclose(end_of(body, x0, t), states, rtol=0, atol=1e-12)
