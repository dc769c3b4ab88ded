"""Streams: their values on each mode, their inverses, stacks of matrices, and shifted equations on the sphere."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.systems.matrices.mode_basis import Harmonics, Waves, mode_basis_of, stream_values
from coadjoint.systems.matrices.spherical_modes import laplacian
from coadjoint.systems.matrices.streams import DiagonalSolve, Inverse, Weights

SHIFT = 2.5


def shifted(N, factor):
    main, beside = laplacian(N)
    return DiagonalSolve(main + SHIFT * (np.add.outer(np.arange(N), np.arange(N)) < N), beside, factor)


STREAMS = {  # a stream, the eigenvalue of it for that of minus the Laplacian
    "sphere": (lambda N: co.systems.sphere_euler(N).stream, lambda e: -1 / e),
    "sphere, shifted": (lambda N: shifted(N, -3.0), lambda e: -3.0 / (e + SHIFT)),
    "sphere, inverse": (lambda N: co.systems.reduced_mhd(N).second_stream, lambda e: -e),
    "sphere, shifted, inverse": (lambda N: Inverse(shifted(N, 0.5)), lambda e: 2.0 * (e + SHIFT)),
    "torus": (lambda N: co.systems.torus_euler(N).stream, lambda e: -1 / e),
    "torus, inverse": (lambda N: co.systems.reduced_mhd(N, "torus").second_stream, lambda e: -e),
}


def random_matrices(N, lead=()):
    drawn = np.random.default_rng(N).standard_normal((2, *lead, N, N))
    return co.MatrixAlgebra("su", N).projected(drawn[0] + 1j * drawn[1])


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", STREAMS)
@pytest.mark.parametrize("N", [3, 5, 7])
def test_each_mode_is_multiplied_by_its_value(name, N):
    make, value = STREAMS[name]
    stream = make(N)
    modes = Waves(N) if "torus" in name else Harmonics(N)
    for d in range(modes.diagonals):
        numbers = modes.numbers(d)
        e = np.array([(n if n <= N // 2 else n - N) ** 2 + d**2 if "torus" in name else n * (n + 1.0) for n in numbers])
        np.testing.assert_allclose(modes.eigenvalues(d, numbers), e, rtol=1e-15)
        np.testing.assert_allclose(stream_values(stream, modes, d, numbers), value(e), rtol=1e-13)
        for k, number in enumerate(numbers):
            chosen = [np.array([number]) if m == d else numbers[:0] for m in range(modes.diagonals)]
            c = [np.array([0.3 + 0.4j]) if m == d else np.zeros(0) for m in range(modes.diagonals)]
            W = modes.matrix(c, chosen)
            assert np.abs(W).max() > 0.01
            # Solutions of tridiagonal systems, or transforms, of N entries.
            tolerance = 64 * N * 2.0**-53 * np.abs(value(e)).max()
            assert np.abs(stream(W) - value(e[k]) * W).max() < tolerance * np.abs(W).max()
            if W.any() and d:
                assert modes.coefficients(W, d, np.array([number]))[0] == pytest.approx(0.3 + 0.4j, rel=1e-13)


@pytest.mark.parametrize("name", STREAMS)
@pytest.mark.parametrize("N", [5, 9])
def test_the_inverse_and_stacks(name, N):
    stream = STREAMS[name][0](N)
    W = random_matrices(N, (2, 3))
    P = stream(W)
    size = np.abs(W).max() + np.abs(P).max()
    np.testing.assert_allclose(stream.inverse(P), W, rtol=0, atol=1e3 * N**2 * 2.0**-53 * size)
    np.testing.assert_allclose(stream(stream.inverse(W)), W, rtol=0, atol=1e3 * N**2 * 2.0**-53 * size)
    np.testing.assert_array_equal(P[1, 2], stream(W[1, 2]))
    before = W.copy()
    stream.inverse(W)
    np.testing.assert_array_equal(W, before)


def test_weights_and_their_inverse():
    w = np.array([[1.0, 2.0, 0.0], [2.0, -0.5, 4.0], [0.0, 4.0, 3.0]])
    given = w.copy()
    stream = Weights(given)
    given[0, 0] = 9.0
    W = np.arange(1.0, 19.0).reshape(2, 3, 3)
    np.testing.assert_array_equal(stream(W), w * W)
    np.testing.assert_array_equal(stream.inverse(w * W), np.where(w == 0, 0.0, W))
    # Entries of weight zero, which no W gives, are dropped.
    np.testing.assert_array_equal(stream.inverse(W), [np.where(w == 0, 0.0, one / np.where(w, w, 1.0)) for one in W])
    np.testing.assert_array_equal(stream.table, w.ravel())
    for wrong in (w[:2], np.triu(w), np.where(w == 4.0, np.inf, w)):
        with pytest.raises(ValueError, match="weights"):
            Weights(wrong)


def test_modes_of_a_shifted_equation_and_of_others():
    """Modes are those of the sphere for every shift that is equal everywhere, and of no other equations."""
    N = 5
    algebra, stream = co.MatrixAlgebra("su", N), shifted(N, -1.0)
    system = co.MatrixSystem(algebra, stream, energy_sign=-1, name="screened fluid")
    assert mode_basis_of(system) == Harmonics(N)
    assert mode_basis_of(co.systems.torus_euler(N)) == Waves(N)
    assert mode_basis_of(co.systems.matrix_body((1.0, 2.0, 3.0))) is None
    other = stream.main.copy()
    other[1, 2] += 0.5
    uneven = co.MatrixSystem(algebra, DiagonalSolve(other, stream.beside, -1.0), energy_sign=-1)
    assert mode_basis_of(uneven) is None
    with pytest.raises(ValueError, match="Viscosity acts on the modes of a fluid"):
        uneven.with_forces(co.forces.Viscosity(0.1))
    W = co.systems.sphere_euler(N).from_modes({(3, 2): 0.5 - 0.25j})
    late = co.forces.Viscosity(0.1, rotation=True).flow(system, system.to_vector(W), 0.0, 0.5)
    np.testing.assert_allclose(system.from_vector(late), np.exp(-0.1 * 12 * 0.5) * W, rtol=0, atol=1e-14)
    # H = <W, W / (e + shift)> / 2
    assert system.energy(W) == pytest.approx(np.sum(np.abs(W) ** 2) / (12 + SHIFT) / 2, rel=1e-13)
