"""The catalogue of dimensions 2 to 5 against a second typing of each entry, and what one changed term would do."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from classification import FORMS, ROOTS, Pair, structure
from flint import fmpq, fmpq_mat, fmpq_poly
from lie_invariants import adjoint_polynomial, exact, invariants, is_lie_algebra

from coadjoint.algebra.families.low_dimensional import entries, exact_constants, parameters_of, read_parameters

ROWS = structure()
POINTS = [
    [Fraction(2), Fraction(-3, 5), Fraction(7, 3), Fraction(-11, 2), Fraction(13, 7)],
    [Fraction(-1, 3), Fraction(4), Fraction(5, 2), Fraction(3, 7), Fraction(-17, 5)],
]


def joined(size, shift):
    """A basis of A5_18 with e3, e4 scaled, and shifted along e2, e1."""
    return [
        [1, 0, 0, shift, 0],
        [0, 1, shift, 0, 0],
        [0, 0, size, 0, 0],
        [0, 0, 0, size, 0],
        [0, 0, 0, 0, 1],
    ]


# Changes of one term after which all invariants agree, by no mere scaling of the basis: with a matrix whose columns are
# a basis in which the changed algebra is the old one, or with the parameters of the entry that it has become.
SAME: dict[tuple[str, str, tuple[int, int, int]], list[list[Fraction | int]] | dict[str, int]] = {
    # A multiple of the joined unit matrix is left, and one of diag(1, -1), a commutator with the rotation.
    ("A5_18", "left out", (3, 5, 1)): joined(Fraction(2), Fraction(1, 2)),
    ("A5_18", "left out", (4, 5, 2)): joined(Fraction(2), Fraction(-1, 2)),
    ("A5_18", "twice as large", (3, 5, 1)): joined(Fraction(2, 3), Fraction(-1, 6)),
    ("A5_18", "twice as large", (4, 5, 2)): joined(Fraction(2, 3), Fraction(1, 6)),
    # Another real form of the same complex algebra.
    **{("A5_32", "with the other sign", place): {"a": -3} for place in ((2, 4, 1), (3, 4, 2), (3, 5, 1))},
}


def catalogued(name, parameters):
    """The constants of the catalogue, exactly, shape (n, n, n)."""
    n = entries()[name]["dim"]
    c = np.full((n, n, n), Fraction(0), dtype=object)
    for (i, j), bracket in exact_constants(name, read_parameters(name, parameters)).items():
        for exponents, value in bracket.monomials.items():
            c[i, j, exponents.index(1)] += Fraction(value)
            c[j, i, exponents.index(1)] -= Fraction(value)
    return c


def expected_polynomial(roots, n):
    """Coefficients, lowest first, of the polynomial with these roots and else zeros."""
    s = fmpq_poly([0, 1])
    whole = fmpq_poly([1])
    for root in roots:
        if isinstance(root, Pair):
            total, square = (fmpq(int(Fraction(v).numerator), int(Fraction(v).denominator)) for v in root)
            whole *= s * s - s * total + square
        else:
            whole *= s - fmpq(int(root.numerator), int(root.denominator))
    return list((whole * s ** (n - whole.degree())).coeffs())


def disagreement(c, name, parameters, expected):
    """What tells the constants from those of the classification without a look at single ones, or None."""
    if not is_lie_algebra(c):
        return "Jacobi"
    found = invariants(c)
    for field, here, there in zip(found._fields, found, expected, strict=True):
        if here != there:
            return field
    n = len(c)
    for x in POINTS:
        if adjoint_polynomial(c, x[:n]) != expected_polynomial(ROOTS[name]([None, *x], **parameters), n):
            return "roots"
    return None


LABELS = [" ".join([name, *(f"{key}={value}" for key, value in chosen.items())]) for name, chosen, _ in ROWS]


def test_every_entry_is_typed_again():
    assert list(FORMS) == list(ROOTS) == list(entries())
    assert {name for name, _, _ in ROWS} == set(entries())
    for name, parameters, _ in ROWS:
        assert tuple(parameters) == parameters_of(name)


@pytest.mark.parametrize(("name", "parameters", "expected"), ROWS, ids=LABELS)
def test_the_catalogue_has_the_algebra_of_the_classification(name, parameters, expected):
    c = catalogued(name, parameters)
    assert np.array_equal(c, FORMS[name](**parameters))
    assert disagreement(c, name, parameters, expected) is None


def terms(c):
    """Places (i, j, k) with i < j and c_ij^k not zero."""
    return [place for place in zip(*np.nonzero(c), strict=True) if place[0] < place[1]]


def changed(c, place, factor):
    """The constants with one term of one bracket multiplied by a factor."""
    i, j, k = place
    other = c.copy()
    other[i, j, k] *= factor
    other[j, i, k] *= factor
    return other


def scaled(c, place, factor):
    """Whether e_i -> t_i e_i, t_i > 0 or signs alone, multiplies this term by the factor and leaves all others."""
    n, rows = len(c), terms(c)
    if factor == -1:
        for signs in product((1, -1), repeat=n):
            if all(signs[i] * signs[j] * signs[k] == (-1 if (i, j, k) == place else 1) for i, j, k in rows):
                return True
        return False
    exponents = np.zeros((len(rows), n + 1), dtype=int)
    for row, (i, j, k) in zip(exponents, rows, strict=True):
        row[i] += 1
        row[j] += 1
        row[k] -= 1
        row[n] = (i, j, k) == place
    return fmpq_mat(exponents[:, :n].tolist()).rank() == fmpq_mat(exponents.tolist()).rank()


def in_basis(c, basis):
    """The constants in the basis of the columns."""
    n, P = len(c), np.array([[Fraction(v) for v in row] for row in basis], dtype=object)
    brackets = np.einsum("ia,jb,ijk->abk", P, P, c)
    back = exact(P).inv()
    inverse = np.array([[Fraction(int(back[i, j].p), int(back[i, j].q)) for j in range(n)] for i in range(n)])
    return brackets @ inverse.T


def is_as_said(name, parameters, changed_constants, said):
    """Whether a basis turns the changed constants into the old ones, or signs into those of other parameters."""
    c = catalogued(name, parameters)
    if not isinstance(said, dict):
        return np.array_equal(in_basis(changed_constants, said), c)
    wanted = FORMS[name](**said)
    signs = product((1, -1), repeat=len(c))
    return any(np.array_equal(in_basis(changed_constants, np.diag(each)), wanted) for each in signs)


CHANGES = {"left out": 0, "with the other sign": -1, "twice as large": 2}
FIRST = {name: (parameters, expected) for name, parameters, expected in reversed(ROWS)}


@pytest.mark.thinned(7)
@pytest.mark.parametrize("name", FIRST)
def test_no_term_can_change_unnoticed(name):
    """Each term left out, negated, doubled: the second typing differs, and so does what no basis alters.

    Where the invariants agree, the changed algebra is the same in another basis: by scalings that are found here, or
    as `SAME` says.
    """
    parameters, expected = FIRST[name]
    c, again = catalogued(name, parameters), FORMS[name](**parameters)
    for place in terms(c):
        for what, factor in CHANGES.items():
            other = changed(c, place, factor)
            assert not np.array_equal(other, again)
            if disagreement(other, name, parameters, expected) is None:
                same = (name, what, tuple(int(i) + 1 for i in place))
                assert scaled(c, place, factor) or is_as_said(name, parameters, other, SAME[same]), same


@pytest.mark.parametrize("value", [0.1, 1 / 3, 2.0**-40, -0.7071067811865476, np.float64(0.3), np.float32(0.1), 1e-300])
def test_a_float_is_the_rational_number_that_it_is(value):
    """No simpler fraction is put in its place: the constants are those of this very number."""
    assert read_parameters("A4_9", {"b": value}) == {"b": Fraction(float(value))}
    assert catalogued("A4_9", {"b": value})[0, 3, 0] == 1 + Fraction(float(value))
