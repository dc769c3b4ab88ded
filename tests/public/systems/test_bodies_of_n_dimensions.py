"""Bodies of n dimensions and the top of Manakov: by hand, in closed form, and with all their integrals."""

import numpy as np
import pytest
from brackets import U, bracket, exact, rational_points
from scipy.linalg import expm, solve_sylvester

import coadjoint as co

pytestmark = pytest.mark.thinned(3)
FULL = np.array([[2.0, 0.25, -0.1], [0.25, 3.0, 0.5], [-0.1, 0.5, 4.0]])


def matrix_of(system, x):
    return np.einsum("k,kij->ij", x, system.representation)


def end_of(system, x0, t, step=0.05):
    return co.integrate(system, x0, (0.0, t), step, co.Taylor(order=20), save_every=10**6).x[-1]


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
    expected = [name for name in ("X^2 a", "X^2 a^2", "X^2 a^3", "X^2 a^4")[: n - 2]] + {
        5: ["X^4 a"],
        6: ["X^4 a", "X^4 a^2"],
    }.get(n, [])
    assert list(top.integrals) == expected
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
        top, off = co.systems.manakov_top(a, b), ~np.eye(n, dtype=bool)
        weights[off] = (np.subtract.outer(b, b)[off]) / (np.subtract.outer(a, a)[off])
        x = rng.uniform(-1, 1, top.dim)
        X = matrix_of(top, x)
        np.testing.assert_allclose(
            matrix_of(top, top.vector_field(x)),
            X @ (weights * X) - (weights * X) @ X,
            rtol=0,
            atol=1e3 * U * np.abs(weights).max(),
        )


def test_the_body_of_three_dimensions_is_the_rigid_body_and_manakovs_top():
    moments, x = np.array([1.0, 2.0, 4.0]), np.array([0.3, -0.5, 0.9])
    body = co.systems.so_n_body(moments)
    rigid = co.systems.rigid_body(moments.sum() - moments)
    top = co.systems.manakov_top(moments**2, moments)
    for other in (rigid, top):
        np.testing.assert_allclose(body.vector_field(x), other.vector_field(x), rtol=0, atol=4 * U)
    np.testing.assert_allclose(end_of(body, x, 8.0), rigid.exact(x, 8.0), rtol=0, atol=1e-12)
    tensor = co.systems.so_n_body(FULL)
    np.testing.assert_allclose(
        tensor.vector_field(x),
        co.systems.rigid_body(np.trace(FULL) * np.eye(3) - FULL).vector_field(x),
        rtol=0,
        atol=8 * U,
    )


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
