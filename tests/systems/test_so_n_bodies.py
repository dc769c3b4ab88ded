"""Bodies of n dimensions and the top of Manakov: by hand, and with all their integrals."""

import numpy as np
import pytest
from motions import FULL, U, assert_bounded, assert_order, bracket, polynomial_of
from scipy.linalg import expm, solve_sylvester

import coadjoint as co

pytestmark = pytest.mark.thinned(3)


def matrix_of(system, x):
    return np.einsum("k,kij->ij", x, system.representation)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("n", [3, 4, 5, 6])
@pytest.mark.parametrize("full", [False, True])
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
    if not (full and n == 6):  # that has quartics of thousands of terms
        assert_bounded(body, x0, T=10.0, h=0.05)


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
                assert bracket(top, F, G) == 0
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
            assert polynomial_of(F)(x) == pytest.approx((-1) ** j / m * coefficients[power], rel=1e-8)
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
    assert_order(body, x, rigid.exact(x, 8.0), 8.0, 0.5)
    tensor = co.systems.so_n_body(FULL)
    np.testing.assert_allclose(
        tensor.vector_field(x),
        co.systems.rigid_body(np.trace(FULL) * np.eye(3) - FULL).vector_field(x),
        rtol=0,
        atol=8 * U,
    )


@pytest.mark.parametrize("n", [3, 4])
def test_two_principal_values_whose_sum_vanishes_up_to_rounding_are_refused(n):
    rng, signs = np.random.default_rng(n), set()
    for _ in range(12):
        Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
        tensor = (Q * np.array([-1.0, 1.0, 2.0, 3.0])[:n]) @ Q.T
        tensor = (tensor + tensor.T) / 2
        signs.add(np.sign(np.linalg.eigvalsh(tensor)[:2].sum()))
        with pytest.raises(ValueError, match=r"inertia has the principal values .*their sum must be positive"):
            co.systems.so_n_body(tensor)
    assert 1.0 in signs


@pytest.mark.parametrize("n", [3, 4])
def test_a_tensor_symmetric_up_to_rounding_counts_by_its_upper_half(n):
    """As for the other bodies: the stored tensor is symmetric, and makes the same system again."""
    root = np.random.default_rng(n).uniform(-1.0, 1.0, (n, n))
    upper = np.triu(root @ root.T + n * np.eye(n))
    symmetric = upper + np.triu(upper, 1).T
    nearly = symmetric * (1.0 + 4 * U * np.tril(np.ones((n, n)), -1))
    assert not np.array_equal(nearly, nearly.T)
    x = np.cos(np.arange(n * (n - 1) / 2))
    makers = [co.systems.so_n_body, co.systems.rigid_body] if n == 3 else [co.systems.so_n_body]
    for make in makers:
        body, wanted = make(nearly), make(symmetric)
        np.testing.assert_array_equal(body.hamiltonian.hessian(x), wanted.hamiltonian.hessian(x))
        again = co.systems.get(body.name, **body.parameters)
        np.testing.assert_array_equal(again.hamiltonian.hessian(x), wanted.hamiltonian.hessian(x))
    assert co.systems.so_n_body(nearly).parameters == co.systems.so_n_body(symmetric).parameters
    for far in (1e-13, -1e-13):
        wrong = symmetric.copy()
        wrong[n - 1, 1] += far * symmetric.max()
        with pytest.raises(ValueError, match=rf"inertia is not symmetric: .* at \[1, {n - 1}\] and \[{n - 1}, 1\]"):
            co.systems.so_n_body(wrong)


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
    assert_order(body, x0, states, t, 0.25)


def test_a_body_of_four_dimensions_that_moves_in_three():
    """Rows and columns of one axis stay zero: a free body whose moments are sums of two of the values."""
    values, left_out, t = np.array([1.0, 2.5, 0.5, 1.75]), 1, 6.0
    body, kept = co.systems.so_n_body(values), [0, 2, 3]
    rigid = co.systems.rigid_body(values[kept].sum() - values[kept])
    y0 = np.array([0.75, -0.5, 1.0])

    def state(y):
        X = np.zeros((4, 4))
        X[np.ix_(kept, kept)] = np.array([[0, -y[2], y[1]], [y[2], 0, -y[0]], [-y[1], y[0], 0]])
        return np.linalg.lstsq(body.representation.reshape(6, 16).T, X.ravel(), rcond=None)[0]

    assert not matrix_of(body, state(y0))[left_out].any()
    assert_order(body, state(y0), state(rigid.exact(y0, t)), t, 0.25)


S = co.systems
WRONG = [
    (S.manakov_top, {"a": (1, 2.5, 3, 2.5), "b": (1, 2, 3, 4)}, r"a\[1\] and a\[3\] are both 2.5"),
    (S.manakov_top, {"a": (1, 1 + 2**-52, 3), "b": (1e300, -1e300, 0)}, "overflows"),
    (S.manakov_top, {"a": (1e200, 2, 3, 4), "b": (1, 2, 3, 4)}, "the power 2 of the entries overflows"),
    (S.manakov_top, {"a": (1, 2, 3, 1e120, 5), "b": (1, 2, 3, 4, 5)}, "the power 3 of the entries overflows"),
    (S.manakov_top, {"a": (1, 2, 3, 1e200, 5), "b": (1, 2, 3, 4, 5)}, "the power 2 of the entries overflows"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "given", "message"), WRONG)
def test_wrong_parameters(make, given, message):
    with pytest.raises(ValueError, match=message):
        make(**given)
