"""Systems of matrices against the same systems by structure constants, and what they say of themselves."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.analysis.poisson_defect import poisson_defect
from coadjoint.systems.matrices.streams import Weights
from long import long_where
from served import state_of

G = co.MatrixAlgebra
U = 2.0**-53


def square_root(W):
    """P of H = sum of |W W^T|^2 / 4 on gl."""
    return W.T @ W @ W.T


def quartic(W):
    return np.sum((W @ W.T) ** 2) / 4


def basis_of(algebra):
    """The matrices of a basis as it is in the library: complex ones are there as real ones of twice the size."""
    rho = np.asarray(algebra.representation)
    if algebra.name.startswith(("su", "u")):
        n = rho.shape[1] // 2
        rho = rho[:, :n, :n] + 1j * rho[:, n:, :n]
    return rho


def in_constants(s, algebra):
    """The same system by structure constants: coordinates c of W = sum c^i b_i, and mu_i = <b_i, W>."""
    b = basis_of(algebra)
    gram = np.array([[s.algebra.pairing(one, other) for other in b] for one in b])
    dual = np.linalg.inv(gram)
    # H(W), W = sum over i of (dual mu)_i b_i.
    P = np.array([[s.algebra.pairing(one, s.slope_of(other)) for other in b] for one in b])
    linear = None if s.linear is None else s.energy_sign * dual @ [s.algebra.pairing(one, s.linear) for one in b]
    M = s.energy_sign * dual @ P @ dual
    return b, dual, co.Quadratic((M + M.T) / 2, linear=linear)


CASES = {
    "so(4)": (G("so", 4), co.algebras.so(4), 1),
    "so(5)": (G("so", 5), co.algebras.so(5), -1),
    "su(3)": (G("su", 3), co.algebras.su(3), 1),
    "gl(3)": (G("gl", 3), co.algebras.gl(3), -1),
    "sl(3)": (G("sl", 3), co.algebras.sl(3), 1),
    "sp(4)": (G("sp", 4), co.algebras.sp(4), 1),
}


def linear_map(g, seed):
    """A symmetric map: of a seeded form of the entries, to the algebra and back."""
    rng = np.random.default_rng(seed)
    A, B = (g.projected(rng.normal(size=g.shape) + 1j * rng.normal(size=g.shape)) for _ in range(2))

    def stream(W):
        # Symmetric: <P, V> = <A, W><A, V> + <B, W><B, V>/2 + <W, V>/4.
        return g.pairing(A, W) * A + 0.5 * g.pairing(B, W) * B + 0.25 * W

    return stream


@pytest.mark.thinned(3)
@pytest.mark.filterwarnings("ignore:the stream stream is called in Python")
@pytest.mark.parametrize(
    ("name", "of"),
    long_where(
        [(name, "function") for name in ("so(4)", "su(3)", "sl(3)", "sp(4)")],
        [(name, of) for name in CASES for of in ("function", "function and constant")],
    ),
)
def test_it_moves_as_by_structure_constants(name, of):
    g, algebra, sign = CASES[name]
    constant = g.projected(np.random.default_rng(9).normal(size=g.shape)) if "constant" in of else None
    s = co.MatrixSystem(g, linear_map(g, 3), constant, energy_sign=sign)
    b, dual, H = in_constants(s, algebra)
    W = state_of(s)
    mu = np.array([g.pairing(one, W) for one in b])
    assert np.abs(np.einsum("i,iab->ab", dual @ mu, b) - W).max() < 1e-14
    # <b_i, [P, W]> = <[b_i, P], W> = -mu([P, b_i]); of which sign the bracket is, the fields at the start say.
    fields = {k: co.LiePoissonSystem(algebra, H, sign=k) for k in (1, -1)}
    moved = np.array([g.pairing(one, s.vector_field(W)) for one in b])
    off = {k: np.abs(one.vector_field(mu) - moved).max() for k, one in fields.items()}
    same = min(off, key=off.get)
    assert off[same] < 1e-13 < 1e-3 < off[-same]
    assert abs(fields[same].energy(mu) - s.energy(W)) < 1e-13
    by_constants = co.integrate(fields[same], mu, (0.0, 1.0), 1 / 64, co.GaussLegendre(6), save_every=64).x[-1]
    by_matrices = co.integrate(s, W, (0.0, 1.0), 1 / 64, co.IsospectralGauss(6), save_every=64).x[-1]
    # Both have errors of order 12 far below round-off: (1/64)^12 is 2e-22.
    back = np.array([g.pairing(one, by_matrices) for one in b])
    assert np.abs(back - by_constants).max() < 1e-13 < 1e-3 < np.abs(back - mu).max()


def test_the_body_of_matrices_is_that_of_constants():
    inertia = (1.0, 1.5, 2.5, 4.0)
    body, other = co.systems.matrix_body(inertia), co.systems.so_n_body(inertia)
    x = np.array([0.3, -0.2, 0.5, 0.4, 0.1, -0.6])
    X = np.einsum("i,iab->ab", x, np.asarray(other.representation))
    moved = np.einsum("i,iab->ab", other.vector_field(x), np.asarray(other.representation))
    assert np.abs(body.vector_field(X) - moved).max() < 1e-15
    assert abs(body.energy(X) - 2 * other.energy(x)) < 1e-15
    ends = [
        co.integrate(one, start, (0.0, 5.0), 1 / 32, method, save_every=160).x[-1]
        for one, start, method in ((body, X, co.IsospectralGauss(5)), (other, x, co.GaussLegendre(5)))
    ]
    assert np.abs(ends[0] - np.einsum("i,iab->ab", ends[1], np.asarray(other.representation))).max() < 1e-13


@pytest.mark.parametrize("kind", ["so", "u", "gl", "sp", "sl(C)"])
def test_the_gradient_is_that_of_the_energy(kind):
    g = G(kind, 4)
    s = co.MatrixSystem(g, linear_map(g, 5), g.projected(np.eye(4) + 0.3), energy_sign=-1)
    x = s.to_vector(state_of(s))
    direction = s.to_vector(state_of(s, seed=8))
    d = 2.0**-10
    slope = (s.energy(x + d * direction) - s.energy(x - d * direction)) / (2 * d)
    # A quadratic has no error of truncation.
    assert abs(slope - s.hamiltonian.gradient(x) @ direction) < 64 * U * abs(s.energy(x) / d) + 1e-13
    assert np.abs(s.structure_matrix(x) @ s.hamiltonian.gradient(x) - s.vector_field(x)).max() < 1e-14
    columns = [(s.hamiltonian.gradient(x + u) - s.hamiltonian.gradient(x - u)) / 2 for u in np.eye(s.dim)[:5]]
    assert np.abs(np.array(columns) - s.hamiltonian.hessian(x)[:, :5].T).max() < 1e-14
    for trace in s.casimirs.values():
        seen = (trace(x + d * direction) - trace(x - d * direction)) / (2 * d)
        assert abs(seen - trace.gradient(x) @ direction) < 10 * d * d
        assert np.abs(s.structure_matrix(x) @ trace.gradient(x)).max() < 1e-14


def of_diagonal(W):
    """A slope on su(3) that is none beside it: of H = (a^2 + a^4/2 + b^2/2)/2, i a and i b the first two entries."""
    P = np.zeros((3, 3), dtype=np.complex128)
    a, b = W[0, 0].imag, W[1, 1].imag
    P[0, 0], P[1, 1] = 1j * (a + a**3), 0.5j * b
    mean = (P[0, 0] + P[1, 1]) / 3
    for i in range(3):
        P[i, i] -= mean
    P[0, 1], P[1, 0] = W[0, 1], W[1, 0]
    return P


def of_diagonal_energy(W):
    a, b = W[0, 0].imag, W[1, 1].imag
    return (a**2 + a**4 / 2 + b**2 / 2) / 2 + np.abs(W[0, 1]) ** 2


@pytest.mark.long
def test_a_function_does_not_see_the_trace_of_stages():
    """Else the step would be no Poisson map: the stages M of matrices of trace zero have a trace."""
    s = co.MatrixSystem(G("su", 3), of_diagonal, energy=of_diagonal_energy)
    seen = []
    co.MatrixSystem(G("su", 3), lambda W: seen.append(np.trace(W)) or W).stream(np.eye(3) + 0j)
    assert max(map(abs, seen)) < 1e-15
    for method in (co.IsospectralGauss(1), co.IsospectralGauss(2)):
        step, W = co.stepper(s, method, 0.1), 3.0 * state_of(s)
        assert poisson_defect(step, W).defect < 1e-8  # by differences
        assert np.abs(method.step(s, W, 0.0, 0.1) - step(W)).max() < 1e-14


def test_stacks_are_taken_one_by_one():
    s = co.MatrixSystem(G("su", 3), lambda W: 0.5 * W, 0.1 * state_of(co.systems.sphere_euler(3)))
    W = np.stack([[state_of(s, seed) for seed in (1, 2, 3)], [state_of(s, seed) for seed in (4, 5, 6)]])
    for look in (s.energy, s.spectrum, s.vector_field, lambda V: s.casimirs_at(V)["tr W^3"]):
        assert np.array_equal(look(W), np.array([[look(one) for one in row] for row in W]))
    assert s.energy(s.to_vector(W)).shape == (2, 3) and np.array_equal(s.from_vector(s.to_vector(W)), W)
    for name, trace in s.casimirs.items():
        assert np.allclose(trace(W), s.casimirs_at(W)[name], rtol=0, atol=1e-15)
        assert np.isrealobj(trace(W))
    eigenvalues = s.spectrum(W)
    assert np.abs(np.sum(eigenvalues**3, axis=-1) - s.casimirs_at(W)["tr W^3"]).max() < 1e-14


def test_spectra_that_are_not_real_are_sorted_alike():
    s = co.MatrixSystem(G("gl", 4), np.transpose)
    A = np.array([[0.0, 2.0, 0, 0], [-2.0, 0, 0, 0], [0, 0, 1.0, 3.0], [0, 0, -3.0, 1.0]])
    T = np.eye(4) + 0.1 * np.arange(16).reshape(4, 4) ** 0.5
    found = s.spectrum(np.stack([A, T @ A @ np.linalg.inv(T)]))
    assert np.abs(found - [[-2j, 2j, 1 - 3j, 1 + 3j]] * 2).max() < 1e-12


@pytest.mark.filterwarnings("ignore:the stream stream is called in Python")
def test_sums_couple_their_blocks():
    """Two bodies that feel each other: the energy has a term of both, and each keeps its own spectrum."""
    g = G.sum(G("so", 3), G("so", 3))

    weights, same = np.ones((6, 6)), np.kron(np.eye(2), np.ones((3, 3)))
    weights[0, 1] = weights[1, 0] = 2.0

    def stream(W):
        return weights * W + 0.5 * same * np.roll(W, 3, axis=(0, 1))

    s = co.MatrixSystem(g, stream)
    sol = co.integrate(s, state_of(s), (0.0, 5.0), 0.05, co.IsospectralGauss(2))
    assert list(s.casimirs) == ["tr W1^2", "tr W2^2"]
    assert all(sol.drift()[name] < 200 * U * np.abs(values).max() for name, values in sol.casimirs.items())
    assert 1e-13 < sol.drift()["energy"] < 1e-5
    assert np.abs(sol.x[-1] - sol.x[0]).max() > 0.01


def good(W):
    return 2.0 * W


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: co.MatrixSystem(G("so", 3), Weights), "a Stream"),
        (lambda: co.MatrixSystem(G("so", 3), lambda W: W @ W), "leaves so"),
        (lambda: co.MatrixSystem(G("sl", 3), lambda W: W @ W), "leaves sl"),
        (lambda: co.MatrixSystem(G("gl", 3), lambda W: W @ W), "not linear"),
        (lambda: co.MatrixSystem(G("gl", 3), lambda W: np.triu(W)), "not symmetric"),
        (lambda: co.MatrixSystem(G("u", 3), lambda W: W.real + 1j * W.imag**3), "not linear"),
        (lambda: co.MatrixSystem(G("u", 3), lambda W: W.real**3 + 1j * W.imag), "not linear"),
        (lambda: co.MatrixSystem(G("gl(C)", 3), lambda W: W.real + 1j * np.triu(W.imag)), "not symmetric"),
        (lambda: co.MatrixSystem(G("gl", 3), square_root, energy=lambda W: 2 * quartic(W)), "not the gradient"),
        (lambda: co.MatrixSystem(G("gl", 3), square_root, energy=quartic, energy_sign=-1), "not the gradient"),
        (lambda: co.MatrixSystem(G("gl", 3), square_root, energy=lambda W: W), "one real number"),
        (lambda: co.MatrixSystem(G("gl", 3), square_root, energy=lambda W, t: 0.0), "give both the same"),
        (lambda: co.MatrixSystem(G("so", 4), Weights(np.ones((3, 3)))), "3 rows"),
        (lambda: co.MatrixSystem(G("gl", 3), co.systems.sphere_euler(3).stream), "skew-Hermitian"),
        (lambda: co.MatrixSystem(G("so", 3), lambda W: [1.0, [2.0]]), "stream"),
        (lambda: co.MatrixSystem(G("so", 3), lambda W: 1j * W), "real"),
        (lambda: co.MatrixSystem(G("so", 3), lambda W: W[:2]), "shape"),
        (lambda: co.systems.matrix_body((1e-320, 1e-320)), "float64"),
        (lambda: co.batch([co.systems.matrix_body(), co.systems.matrix_body()]), "member 0"),
        (lambda: co.lyapunov(co.systems.matrix_body(), np.zeros((5, 5)), (0, 1), 0.1), "has matrix states"),
        (lambda: co.choose(co.systems.matrix_body(), np.zeros((5, 5)), (0, 1), 1e-3), "give step= and method="),
        (lambda: co.modified_field(co.systems.matrix_body(), co.IsospectralGauss(), 3), "has matrix states"),
        (lambda: co.modified_hamiltonian(co.systems.matrix_body(), co.IsospectralGauss()), "LiePoissonSystem"),
        (lambda: co.prepare(co.systems.matrix_body(), None, 0.1, inputs=True), "linear"),
        (lambda: co.prepare(co.systems.matrix_body(), None, 0.1, attitude=True), "attitude"),
        (lambda: co.prepare(co.systems.matrix_body(), None, 0.1, attitude="coadjoint"), "attitude|group element"),
        (lambda: co.prepare(co.systems.matrix_body(), co.Splitting(), 0.1), "IsospectralGauss"),
        (lambda: co.stepper(co.systems.rigid_body(), co.IsospectralGauss(), 0.1), "integrates matrices"),
    ],
)
def test_refused_by_name(make, message):
    with pytest.raises((ValueError, TypeError), match=message) as refused:
        make()
    assert "\n" not in str(refused.value)
