"""The matrix algebras: dimensions, ranks, representations, Casimirs, Killing forms; all exactly."""

from fractions import Fraction

import numpy as np
import pytest

from coadjoint.algebra import catalogue
from coadjoint.algebra.catalogue import e, gl, heisenberg, se, sl, so, sp, su, u
from coadjoint.algebra.exact.elimination import Span
from coadjoint.algebra.families.matrix_bases import MAX_REPRESENTATION_NUMBERS, Sparse, matrices
from coadjoint.algebra.polynomials.quadratic_forms import MAX_STORED_EXPONENTS, casimirs_fit
from drawn_matrices import constants_of

# algebra, dimension, number of Casimirs, semisimple
FAMILIES = [
    *((gl(n), n * n, n, False) for n in (1, 2, 3, 4)),
    *((sl(n), n * n - 1, n - 1, True) for n in (2, 3, 4, 5)),
    *((so(n), n * (n - 1) // 2, n // 2, n > 2) for n in (2, 3, 4, 5, 6, 7)),
    *((so(p, q), (p + q) * (p + q - 1) // 2, (p + q) // 2, True) for p, q in ((2, 1), (3, 1), (1, 3), (2, 2), (4, 1))),
    *((su(n), n * n - 1, n - 1, True) for n in (2, 3, 4, 5)),
    *((u(n), n * n, n, False) for n in (1, 2, 3, 4)),
    *((sp(2 * n), n * (2 * n + 1), n, True) for n in (1, 2, 3)),
    *((e(n), n * (n + 1) // 2, (n + 1) // 2, False) for n in (2, 3, 4, 5)),
    *((heisenberg(n), 2 * n + 1, 1, False) for n in (1, 2, 3)),
]


def independent(rows):
    try:
        Span([{i: Fraction(v) for i, v in enumerate(row) if v} for row in rows])
    except ValueError:
        return False
    return True


@pytest.mark.parametrize(("g", "dim", "casimirs", "semisimple"), FAMILIES, ids=str)
def test_families(g, dim, casimirs, semisimple):
    c, rho = constants_of(g), g.representation
    assert g.dim == dim and dim - g.generic_rank() == casimirs
    # the constants are multiples of 1/2 below 8, so these sums of products are exact
    double = np.einsum("ijm,mkl->ijkl", c, c)
    assert not np.any(double + double.transpose(2, 0, 1, 3) + double.transpose(1, 2, 0, 3))
    commutators = np.einsum("iab,jbc->ijac", rho, rho)
    assert np.array_equal(commutators - commutators.transpose(1, 0, 2, 3), np.einsum("ijk,kab->ijab", c, rho))
    assert independent(rho.reshape(dim, -1))
    killing = np.einsum("iab,jba->ij", c, c)
    assert independent(killing) == semisimple
    rng = np.random.default_rng(4)
    x = np.array([Fraction(int(v), 6) for v in rng.integers(-50, 50, dim)], dtype=object)
    gradients = [casimir.gradient(x) for casimir in g.casimirs_known.values()]
    assert gradients and independent(gradients)
    for gradient in gradients:
        assert all(g.structure_matrix(x) @ gradient == 0)


def test_matrices_are_those_that_the_names_say():
    rng = np.random.default_rng(5)

    def element(g):
        return np.tensordot(rng.integers(-5, 6, g.dim).astype(float), g.representation, axes=1)

    signs = np.diag([1.0, 1.0, 1.0, -1.0])
    x = element(so(3, 1))
    assert np.array_equal(x.T @ signs, -signs @ x)
    turn = np.kron([[0.0, 1.0], [-1.0, 0.0]], np.eye(3))
    x = element(sp(6))
    assert np.array_equal(x.T @ turn, -turn @ x)
    for g in (su(3), u(3)):
        x = element(g)
        assert np.array_equal(x.T, -x)  # anti-Hermitian
        assert np.array_equal(x @ turn, turn @ x)  # complex linear
    assert np.trace(element(su(3))[:3, 3:]) == 0.0  # trace of the imaginary part
    assert np.trace(element(sl(4))) == 0.0
    assert not element(e(3))[3].any()


def test_conventions():
    pauli = np.array([[[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]]])
    spin = -0.5j * pauli
    assert np.array_equal(su(2).representation, np.block([[spin.real, -spin.imag], [spin.imag, spin.real]]))
    assert su(2) == so(3) and se(4) == e(4) and so(0, 4) == so(4) and so(4, 0) == so(4)
    assert sl(2).basis == ("e1", "e2", "e3") and sl(2).representation.tolist()[1] == [[0.5, 0.0], [0.0, -0.5]]
    upper = gl(3).representation.reshape(9, 9)
    assert np.array_equal(upper, np.eye(9))
    rotation, translation = e(4).representation[0], e(4).representation[6:]
    assert rotation[0, 1] == 1.0 and rotation[1, 0] == -1.0
    assert np.array_equal(translation[:, :4, 4], np.eye(4))


def test_large_algebras_are_sparse():
    g = so(60)
    assert g.dim == 1770 and g.triples.c.size == 3 * (60 * 59 * 58 // 6)
    assert g.representation.shape == (1770, 60, 60)
    assert list(g.casimirs_known) == ["|x|^2"] and len(g.casimirs_known["|x|^2"].monomials) == 1770
    h = heisenberg(10_000)
    assert h.triples.c.size == 10_000 and h.representation is None


def test_limits_of_size():
    assert casimirs_fit(MAX_STORED_EXPONENTS, 1) and not casimirs_fit(MAX_STORED_EXPONENTS + 1, 1)
    one = Sparse([(0, 0, 0, 1.0)])
    assert matrices(one, MAX_REPRESENTATION_NUMBERS // 4**2 + 1, 4) is None
    assert matrices(one, 2, 4).shape == (2, 4, 4)


def test_everything_public_is_listed():
    assert set(catalogue.__all__) <= set(dir(catalogue)) and list(catalogue.__all__) == sorted(catalogue.__all__)
