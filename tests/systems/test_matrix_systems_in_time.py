"""Systems of matrices that depend on the time: functions of states and vectors, alone and stacked; inputs unchanged."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.systems.matrices.streams import Weights
from served import state_of

KINDS = {"so": 3, "su": 3, "gl": 2, "sl": 3, "sl(C)": 2}
TIMES = (0.0, 0.7, -1.3)


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
        for t in TIMES:
            factor = 2.0 + np.sin(t)
            # Numbers of order one, each the sum of at most 2 N^2 products.
            P = factor * W + A
            np.testing.assert_allclose(s.stream_of(W, t), P, rtol=0, atol=1e-14)
            np.testing.assert_allclose(s.vector_field(W, t), P @ W - W @ P, rtol=0, atol=1e-13)
            energies = -(factor * pairing(W, W) / 2 + pairing(A, W))
            np.testing.assert_allclose(s.energy(W, t), energies, rtol=0, atol=1e-13)
            x = s.to_vector(W[1, 0])
            np.testing.assert_allclose(s.vector_field(x, t), s.to_vector(s.vector_field(W[1, 0], t)), atol=1e-13)
            assert s.hamiltonian.value(x, t) == pytest.approx(energies[1, 0], abs=1e-13)
            slope = s.hamiltonian.gradient(x, t)
            direction = s.to_vector(W[0, 1])
            assert slope @ direction == pytest.approx(-pairing(factor * W[1, 0] + A, W[0, 1]), abs=1e-13)
            if s.linear_stream:
                moved = s.hamiltonian.gradient(x + direction, t) - slope
                np.testing.assert_allclose(s.hamiltonian.hessian(x, t) @ direction, moved, rtol=0, atol=1e-13)


@pytest.mark.parametrize("kind", KINDS)
def test_states_and_constants_that_are_given_stay_as_they_are(kind):
    A, systems = breathing(kind)
    s = systems[0]
    given = A.copy()
    again = co.MatrixSystem(s.algebra, lambda W: 2.0 * W, given)
    given += 1.0
    np.testing.assert_array_equal(again.linear, A)
    with pytest.raises(ValueError, match="read-only"):
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


def test_vectors_that_are_not_finite_are_refused_as_states():
    s = co.systems.sphere_euler(3).in_numbers
    x = np.zeros((2, s.dim))
    assert s.read(x).shape == x.shape and s.in_numbers is s
    for wrong in (np.nan, np.inf):
        x[1, 4] = wrong
        for given in (x, x[1]):
            with pytest.raises(ValueError, match="x0"):
                s.read(given)


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
