"""Systems of matrices: against structure constants, in time, their traces and spectra, and streams."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused
from served import state_of

G, Weights, DiagonalSolve = co.MatrixAlgebra, co.systems.Weights, co.systems.DiagonalSolve
U = 2.0**-53


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
    linear = s.energy_sign * dual @ [s.algebra.pairing(one, s.linear) for one in b]
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
@pytest.mark.parametrize("name", CASES)
def test_it_moves_as_by_structure_constants(name):
    g, algebra, sign = CASES[name]
    constant = g.projected(np.random.default_rng(9).normal(size=g.shape))
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


KINDS = {"so": 3, "su": 3, "gl": 2, "sl": 3, "sl(C)": 2}


def breathing(kind, sign=-1):
    """H = sign ((2 + sin t) <W, W>/2 + <A, W>), once by its stream alone and once with a function for the energy."""
    g = co.MatrixAlgebra(kind, KINDS[kind])
    A = g.projected(np.random.default_rng(4).standard_normal(g.shape))

    def stream(W, t):
        return (2.0 + np.sin(t)) * W

    def energy(W, t):
        return sign * (2.0 + np.sin(t)) * g.pairing(W, W) / 2

    alone = co.MatrixSystem(g, stream, A, energy_sign=sign)
    return A, [alone, co.MatrixSystem(g, stream, A, energy=energy, energy_sign=sign)]


@pytest.mark.parametrize("kind", KINDS)
def test_everything_is_a_function_of_the_time_too(kind):
    A, systems = breathing(kind)
    for s in systems:
        assert s.timed and s.hamiltonian.timed
        W = np.stack([[state_of(s, seed) for seed in (1, 2)], [state_of(s, seed) for seed in (3, 4)]])
        pairing = s.algebra.pairing
        for t in (0.0, 0.7, -1.3):
            factor = 2.0 + np.sin(t)
            # Numbers of order one, each the sum of at most 2 N^2 products.
            P = factor * W + A
            np.testing.assert_allclose(s.stream_of(W, t), P, rtol=0, atol=1e-14)
            np.testing.assert_allclose(s.vector_field(W, t), P @ W - W @ P, rtol=0, atol=1e-13)
            energies = -(factor * pairing(W, W) / 2 + pairing(A, W))
            np.testing.assert_allclose(s.energy(W, t), energies, rtol=0, atol=1e-13)
            x, direction = s.to_vector(W[1, 0]), s.to_vector(W[0, 1])
            np.testing.assert_allclose(s.vector_field(x, t), s.to_vector(s.vector_field(W[1, 0], t)), atol=1e-13)
            assert s.hamiltonian.value(x, t) == pytest.approx(energies[1, 0], abs=1e-13)
            slope = s.hamiltonian.gradient(x, t)
            assert slope @ direction == pytest.approx(-pairing(factor * W[1, 0] + A, W[0, 1]), abs=1e-13)
            if s.linear_stream:
                moved = s.hamiltonian.gradient(x + direction, t) - slope
                np.testing.assert_allclose(s.hamiltonian.hessian(x, t) @ direction, moved, rtol=0, atol=1e-13)


@pytest.mark.parametrize("kind", KINDS)
def test_states_and_constants_that_are_given_stay_as_they_are(kind):
    A, (s, _) = breathing(kind)
    given = A.copy()
    again = co.MatrixSystem(s.algebra, lambda W: 2.0 * W, given)
    given += 1.0
    np.testing.assert_array_equal(again.linear, A)
    with refused(ValueError, "read-only"):
        again.linear[0, 1] = 2.0
    # With a trace where the algebra has none, as stages of a step have it.
    W = state_of(s) + 0.25 * np.eye(s.algebra.N)
    x = s.to_vector(W).copy()
    for state in (W, x):
        before = state.copy()
        for look in (s.vector_field, s.energy, s.stream_of, s.casimirs_at, s.hamiltonian.value, s.structure_matrix):
            look(state)
            np.testing.assert_array_equal(state, before)


def test_blocks_of_trace_zero_are_centred_each():
    """In a sum of algebras the stages have a trace in every block of trace zero, and in no other."""
    g = co.MatrixAlgebra.sum(co.MatrixAlgebra("sl", 2), co.MatrixAlgebra("gl", 2), co.MatrixAlgebra("sl", 3))
    seen = []
    s = co.MatrixSystem(g, lambda W: seen.append(W.copy()) or W)
    W = np.diag(np.arange(1.0, 8.0))
    s.stream(W)
    np.testing.assert_allclose(np.diag(seen[-1]), [-0.5, 0.5, 3.0, 4.0, -1.0, 0.0, 1.0], rtol=0, atol=1e-15)


@pytest.mark.parametrize("seed", range(8))
def test_eigenvalues_of_equal_real_parts_are_in_the_order_of_the_imaginary_ones(seed):
    """Real parts that differ by round-off are equal; those that differ by more decide."""
    rng = np.random.default_rng(seed)
    A, wanted = np.zeros((7, 7)), []
    A[0, 0] = rng.choice([-1.5, 2.5])
    for k, (real, imaginary) in enumerate(((1.0, 3.0), (1.0, 0.5), (-0.5, 2.0))):
        A[1 + 2 * k : 3 + 2 * k, 1 + 2 * k : 3 + 2 * k] = [[real, imaginary], [-imaginary, real]]
        wanted += [complex(real, imaginary), complex(real, -imaginary)]
    wanted = sorted([*wanted, complex(A[0, 0])], key=lambda v: (v.real, v.imag))
    T = np.eye(7) + 0.2 * rng.standard_normal((7, 7))
    s = co.MatrixSystem(co.MatrixAlgebra("gl", 7), Weights(np.ones((7, 7))))
    W = np.stack([T @ A @ np.linalg.inv(T), A])
    np.testing.assert_allclose(s.spectrum(W), [wanted, wanted], rtol=0, atol=1e-11)
    np.testing.assert_allclose(s.spectrum(1e200 * W) / 1e200, [wanted, wanted], rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("kind", "N", "names"),
    [
        ("gl(C)", 2, ["Re tr W", "Im tr W", "Re tr W^2", "Im tr W^2"]),
        ("sl(C)", 3, ["Re tr W^2", "Im tr W^2", "Re tr W^3", "Im tr W^3"]),
        ("so(C)", 4, ["Re tr W^2", "Im tr W^2", "Re tr W^4", "Im tr W^4"]),
        ("su", 3, ["tr W^2", "tr W^3"]),
        ("u", 2, ["tr W", "tr W^2"]),
        ("sp", 4, ["tr W^2", "tr W^4"]),
    ],
)
def test_as_many_traces_as_are_independent(kind, N, names):
    g = co.MatrixAlgebra(kind, N)
    s = co.MatrixSystem(g, lambda W: 2.0 * W)
    assert list(s.casimirs) == names
    few = co.MatrixSystem(g, lambda W: 2.0 * W, powers=1)
    assert list(few.casimirs) == names[: 2 if names[0].startswith("Re") else 1]
    quadratic = [name for name in names if name in ("tr W^2", "Re tr W^2")]
    assert list(s.quadratic_casimirs) == quadratic
    W = state_of(s)
    slopes = [trace.gradient(s.to_vector(W)) for trace in s.casimirs.values()]
    assert np.linalg.matrix_rank(slopes, tol=1e-8) == len(names)
    base = -1j * W if g.skew else W
    for name, trace in s.casimirs.items():
        power = int(name.partition("^")[2] or 1)
        whole = np.trace(np.linalg.matrix_power(base, power))
        assert trace(W) == pytest.approx(whole.imag if name.startswith("Im") else whole.real, abs=1e-13)
        d, x, direction = 2.0**-10, s.to_vector(W), s.to_vector(state_of(s, seed=8))
        seen = (trace(x + d * direction) - trace(x - d * direction)) / (2 * d)
        assert abs(seen - trace.gradient(x) @ direction) < 10 * d * d
        assert np.abs(s.structure_matrix(x) @ trace.gradient(x)).max() < 1e-14


SHIFT = 2.5


def shifted(N, factor):
    stream, places = co.systems.sphere_euler(N).stream, np.add.outer(np.arange(N), np.arange(N))
    return DiagonalSolve(stream.main + SHIFT * (places < N), stream.beside, factor)


STREAMS = {  # a stream, the eigenvalue of it for that of minus the Laplacian
    "sphere": (lambda N: co.systems.sphere_euler(N).stream, lambda e: -1 / e),
    "sphere, shifted": (lambda N: shifted(N, -3.0), lambda e: -3.0 / (e + SHIFT)),
    "sphere, inverse": (lambda N: co.systems.reduced_mhd(N).second_stream, lambda e: -e),
    "torus": (lambda N: co.systems.torus_euler(N).stream, lambda e: -1 / e),
    "torus, inverse": (lambda N: co.systems.reduced_mhd(N, "torus").second_stream, lambda e: -e),
}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", STREAMS)
@pytest.mark.parametrize("N", [3, 7])
def test_streams_multiply_each_mode_by_its_value(name, N):
    make, value = STREAMS[name]
    fluid = (co.systems.torus_euler if "torus" in name else co.systems.sphere_euler)(N)
    stream, drawn = make(N), np.random.default_rng(N).standard_normal((2, 2, 3, N, N))
    W = fluid.algebra.projected(drawn[0] + 1j * drawn[1])
    e = fluid.eigenvalues
    wanted = fluid.mode_array(W) * np.where(e > 0, value(np.where(e > 0, e, 1.0)), 0.0)
    P = stream(W)
    # Solutions of tridiagonal systems, or transforms, of N entries.
    np.testing.assert_allclose(fluid.mode_array(P), wanted, rtol=0, atol=256 * N * U * np.abs(wanted).max())
    size = np.abs(W).max() + np.abs(P).max()
    np.testing.assert_allclose(stream.inverse(P), W, rtol=0, atol=1e3 * N**2 * U * size)
    np.testing.assert_allclose(stream(stream.inverse(W)), W, rtol=0, atol=1e3 * N**2 * U * size)
    np.testing.assert_array_equal(P[1, 2], stream(W[1, 2]))


def test_weights_and_their_inverse():
    w = np.array([[1.0, 2.0, 0.0], [2.0, -0.5, 4.0], [0.0, 4.0, 3.0]])
    given = w.copy()
    stream = Weights(given)
    given[0, 0] = 9.0
    W = np.arange(1.0, 19.0).reshape(2, 3, 3)
    np.testing.assert_array_equal(stream(W), w * W)
    # Entries of weight zero, which no W gives, are dropped.
    np.testing.assert_array_equal(stream.inverse(w * W), np.where(w == 0, 0.0, W))
    np.testing.assert_array_equal(stream.inverse(W), [np.where(w == 0, 0.0, one / np.where(w, w, 1.0)) for one in W])
    for wrong in (w[:2], np.triu(w), np.where(w == 4.0, np.inf, w)):
        with refused(ValueError, "weights"):
            Weights(wrong)


def test_modes_of_a_shifted_equation_are_those_of_the_sphere():
    """For every shift that is equal everywhere; an uneven one has no modes."""
    N = 5
    algebra, stream = G("su", N), shifted(N, -1.0)
    system = co.MatrixSystem(algebra, stream, energy_sign=-1, name="screened fluid")
    other = stream.main.copy()
    other[1, 2] += 0.5
    uneven = co.MatrixSystem(algebra, DiagonalSolve(other, stream.beside, -1.0), energy_sign=-1)
    with refused(ValueError, "Viscosity", "modes of a fluid"):
        uneven.with_forces(co.forces.Viscosity(0.1))
    W = co.systems.sphere_euler(N).from_modes({(3, 2): 0.5 - 0.25j})
    late = co.forces.Viscosity(0.1, rotation=True).flow(system, system.to_vector(W), 0.0, 0.5)
    np.testing.assert_allclose(system.from_vector(late), np.exp(-0.1 * 12 * 0.5) * W, rtol=0, atol=1e-14)
    # H = <W, W / (e + shift)> / 2
    assert system.energy(W) == pytest.approx(np.sum(np.abs(W) ** 2) / (12 + SHIFT) / 2, rel=1e-13)
