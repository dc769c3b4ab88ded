"""Structure constants: what is read, and what is refused, by name."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coadjoint.algebra import catalogue
from coadjoint.algebra.brackets import parse_brackets as read_written
from coadjoint.algebra.constants import Triples
from coadjoint.algebra.lie_algebra import LieAlgebra
from drawn_matrices import constants_of


def copies(g, m):
    i, j, k, c = g.triples
    shift = np.repeat(g.dim * np.arange(m), c.size)
    return Triples(*(np.tile(q, m) + shift for q in (i, j, k)), np.tile(c, m))


ALGEBRAS = [
    catalogue.so(4),
    catalogue.so(5),
    catalogue.e(3),
    catalogue.sl(2),
    catalogue.heisenberg(2),
    catalogue.A3_7(0.3),
]


@pytest.mark.parametrize("g", ALGEBRAS, ids=str)
def test_every_input_form_gives_the_same_algebra(g):
    rows = list(zip(*(column.tolist() for column in g.triples), strict=True))
    brackets = {}
    for i, j, k, c in rows:
        brackets.setdefault((j, i), {})[k] = -c  # the other order
    both = rows + [(j, i, k, -c) for i, j, k, c in rows]
    for other in (
        LieAlgebra(constants_of(g)),
        LieAlgebra(constants_of(g).tolist()),
        LieAlgebra(rows[::-1], dim=g.dim),
        LieAlgebra(both + rows, dim=g.dim),
        LieAlgebra(g.triples, dim=g.dim),
        LieAlgebra.from_brackets(g.dim, brackets, basis=[f"b{i}" for i in range(g.dim)]),
    ):
        assert other == g
        assert hash(other) == hash(g)
        assert all(np.array_equal(a, b) for a, b in zip(other.triples, g.triples, strict=True))


def test_triples_are_sorted_unique_nonzero_and_read_only():
    g = LieAlgebra([(3, 1, 0, 2.0), (1, 2, 0, 0.0), (0, 2, 3, 0.0), (1, 3, 0, -2.0)], dim=4)
    assert [column.tolist() for column in g.triples] == [[1], [3], [0], [-2.0]]
    assert [column.dtype for column in g.triples] == [np.int64] * 3 + [np.float64]
    for column in (*g.triples, *g.neighbours(), catalogue.so(4).representation):
        with pytest.raises(ValueError, match="read-only"):
            column[0] = 1


def test_input_is_copied():
    c = constants_of(catalogue.so(4))
    g = LieAlgebra(c)
    c[:] = 7.0
    assert g == catalogue.so(4)


def test_abelian_algebras():
    assert LieAlgebra([], dim=3) == LieAlgebra(np.zeros((3, 3, 3))) == LieAlgebra.from_brackets(3, {})
    assert LieAlgebra([], dim=3) != LieAlgebra([], dim=4)
    assert LieAlgebra([], dim=3).structure_matrix(np.ones(3)).tolist() == np.zeros((3, 3)).tolist()
    assert [part.size for part in LieAlgebra([], dim=3).coadjoint_entries(np.ones(3))] == [0, 0, 0]


def test_jacobi_violation_names_triple_component_and_defect():
    # [[e1,e2],e4] + [[e2,e4],e1] + [[e4,e1],e2] = [e1,e4]/2 = e3/2, and nothing else is violated
    rows = [(0, 1, 0, 0.5), (0, 3, 2, 1.0)]
    message = r"Jacobi identity violated for \(e1, e2, e4\) = indices \(0, 1, 3\): defect 0.5 in component e3"
    with pytest.raises(ValueError, match=message):
        LieAlgebra(rows, dim=4)
    with pytest.raises(ValueError, match=r"\(a, b, d\) = indices \(0, 1, 3\): defect 0.5 in component c"):
        LieAlgebra(rows, dim=4, basis=tuple("abcd"))


def reference_defects(c):
    """The Jacobi identity as written, with the sum of absolute products of each, from a dense array."""
    terms = [np.einsum(s, c, c) for s in ("ijm,mkl->ijkl", "jkm,mil->ijkl", "kim,mjl->ijkl")]
    sizes = [np.einsum(s, abs(c), abs(c)) for s in ("ijm,mkl->ijkl", "jkm,mil->ijkl", "kim,mjl->ijkl")]
    return abs(sum(terms)), sum(sizes)


@settings(deadline=None, max_examples=150)
@given(st.data())
def test_jacobi_agrees_with_the_dense_identity(data):
    n = data.draw(st.integers(3, 5))
    c = np.zeros((n, n, n))
    keys = list(itertools.product(itertools.combinations(range(n), 2), range(n)))
    for (i, j), k in data.draw(st.lists(st.sampled_from(keys), max_size=6)):
        value = data.draw(st.integers(-2, 2))
        c[i, j, k], c[j, i, k] = value, -value
    defect, size = reference_defects(c)
    if (defect > 64 * 2.0**-53 * size).any():
        with pytest.raises(ValueError, match="Jacobi identity violated"):
            LieAlgebra(c)
    else:
        assert np.array_equal(constants_of(LieAlgebra(c)), c)


@settings(deadline=None, max_examples=25)
@given(st.sampled_from(["so(4)", "e(3)"]), st.integers(0, 2**32 - 1))
def test_a_random_rational_change_of_basis_is_accepted(name, seed):
    rng = np.random.default_rng(seed)
    a = [[Fraction(int(p), int(q)) for p, q in zip(*rng.integers(1, 9, (2, 6)), strict=True)] for _ in range(6)]
    a = [[v + 40 * (i == j) for j, v in enumerate(row)] for i, row in enumerate(a)]  # regular
    broken = constants_of(catalogue.change_of_basis(catalogue.get(name), a))  # each constant rounded once
    assert np.array_equal(constants_of(LieAlgebra(broken)), broken)
    i, j, k = np.unravel_index(np.argmax(abs(broken)), broken.shape)
    broken[i, j, k] *= 1 + 1e-9
    broken[j, i, k] = -broken[i, j, k]
    with pytest.raises(ValueError, match="Jacobi identity violated"):
        LieAlgebra(broken)


@pytest.mark.parametrize("scale", [2.0**-600, 1.0, 2.0**600])
def test_jacobi_is_relative_whatever_the_unit(scale):
    g = catalogue.so(4)
    i, j, k, c = g.triples
    assert LieAlgebra(Triples(i, j, k, scale * c), dim=6).dim == 6
    wrong = scale * c
    wrong[0] *= 1 + 1e-10
    with pytest.raises(ValueError, match="Jacobi identity violated"):
        LieAlgebra(Triples(i, j, k, wrong), dim=6)


def test_jacobi_finds_a_small_violation_beside_a_large_algebra():
    i, j, k, c = copies(catalogue.so(4), 2)
    c[12:] *= 2.0**-60
    assert LieAlgebra(Triples(i, j, k, c), dim=12).dim == 12
    c[12] *= 1.001
    with pytest.raises(ValueError, match=r"Jacobi identity violated for \(e7, e8"):
        LieAlgebra(Triples(i, j, k, c), dim=12)


def test_many_copies_and_large_rotations_are_checked_sparsely():
    m = 30_000
    triples = copies(catalogue.so(3), m)
    assert LieAlgebra(triples, dim=3 * m).triples.c.size == 3 * m
    assert catalogue.so(60).triples.c.size == 102_660
    triples.k[-1] = 5  # a bracket of the last copy now leaves its copy
    with pytest.raises(ValueError, match="Jacobi identity violated"):
        LieAlgebra(triples, dim=3 * m)


@pytest.mark.parametrize("chunk", [1, 7, 100])
def test_the_jacobi_check_does_not_depend_on_the_runs_it_is_cut_into(monkeypatch, chunk):
    monkeypatch.setattr("coadjoint.algebra.exact.sparse_sums.CHUNK", chunk)
    g = catalogue.so(5)
    i, j, k, c = g.triples
    assert LieAlgebra(g.triples, dim=10, representation=g.representation) == g
    for at in range(0, c.size, 7):
        wrong = c.copy()
        wrong[at] = 2.0
        with pytest.raises(ValueError, match="Jacobi identity violated"):
            LieAlgebra(Triples(i, j, k, wrong), dim=10)


def test_antisymmetry_is_relative():
    c = constants_of(catalogue.so(4)) * 2.0**40
    c[0, 1, 3] *= 1 + 2.0**-50
    assert LieAlgebra(c).dim == 6
    c[0, 1, 3] *= 1 + 2.0**-40
    with pytest.raises(ValueError, match=r"antisymmetry violated for \(e1, e2\) = indices \(0, 1\): component e4"):
        LieAlgebra(c)


NAN = float("nan")


@pytest.mark.parametrize(
    ("constants", "dim", "error", "message"),
    [
        ([(0, 1, 0, 1.0)], None, ValueError, "dim must be given"),
        (np.zeros((0, 0, 0)), None, ValueError, "n >= 1"),
        (np.zeros((2, 2, 2)), 3, ValueError, "dim = 3 does not fit"),
        ([(0, 0, 1, 1.0)], 2, ValueError, r"\[e1, e1\] \(index 0\) must be zero, but has component 1 along e2"),
        ([(0, 1, 0, 1.0), (0, 1, 0, 2.0)], 2, ValueError, r"\(e1, e2, e1\) = .* given twice, as 1 and as 2"),
        ([(0, 1, 0, 1.0), (1, 0, 0, 1.0)], 2, ValueError, r"antisymmetry violated for \(e1, e2\)"),
        ([(0, 1, 0, 1.0), (1, 0, 1, -1.0)], 2, ValueError, r"antisymmetry violated for \(e1, e2\)"),
        ([(0, 1, 0, 1j)], 2, TypeError, "must be an array of real numbers"),
        ([(0, 1, 0, 1.0), (0, 1)], 2, TypeError, "rows of the same length"),
        ([(0, 1, 0, 10**400)], 2, ValueError, "too large for float64"),
    ],
)
def test_wrong_constants_are_refused(constants, dim, error, message):
    with pytest.raises(error, match=message):
        LieAlgebra(constants, dim=dim)


@pytest.mark.parametrize("column", range(4))
def test_columns_of_triples_have_one_length(column):
    columns = [np.array([0, 1]), np.array([2, 2]), np.array([0, 1]), np.array([1.0, -1.0])]
    assert LieAlgebra(Triples(*columns), dim=3).triples.c.tolist() == [1.0, -1.0]
    for wrong in (columns[column][:1], np.append(columns[column], 0), columns[column][:, None]):
        given = [wrong if k == column else values for k, values in enumerate(columns)]
        with pytest.raises(ValueError, match="columns i, j, k, c of the triples must be one-dimensional and of equal"):
            LieAlgebra(Triples(*given), dim=3)


@pytest.mark.parametrize("column", range(3))
def test_the_first_wrong_index_is_named(column):
    rows = np.array([(0, 1, 1, 1.0), (0, 2, 2, 1.0), (0, 3, 3, 1.0), (0, 4, 4, 1.0)])
    rows[1, column], rows[3, column] = 7, -2
    with pytest.raises(ValueError, match=f"^index {'ijk'[column]} = 7 in row 1 of the structure constants"):
        LieAlgebra(rows, dim=5)
    rows[1:3, 3] = np.nan, np.inf
    rows[1, column], rows[3, column] = 1, 1
    place = ", ".join(str(int(entry)) for entry in rows[1, :3])
    with pytest.raises(ValueError, match=rf"^structure constant \(i, j, k\) = \({place}\) is nan; it must be finite"):
        LieAlgebra(rows, dim=5)


def test_brackets_come_with_everything_that_an_algebra_has():
    g = catalogue.so(3)
    brackets = ({(0, 1): {2: 1.0}, (1, 2): {0: 1.0}, (2, 0): {1: 1.0}}, ["[a, b] = c", "[b, c] = a", "[c, a] = b"])
    given = {"basis": ("a", "b", "c"), "name": "turns", "representation": g.representation}
    for first in ((3, brackets[0]), (3, brackets[1]), (brackets[1],)):
        made = LieAlgebra.from_brackets(*first, **given, casimirs=g.casimirs_known)
        assert made == g and made.name == "turns" and made.basis == ("a", "b", "c")
        assert np.array_equal(made.representation, g.representation)
        assert dict(made.casimirs_known) == dict(g.casimirs_known)
        with pytest.raises(ValueError, match="representation violates the commutator"):
            LieAlgebra.from_brackets(*first, **{**given, "representation": -g.representation})


def test_one_order_only_in_a_dense_array_is_refused():
    c = np.zeros((2, 2, 2))
    c[0, 1, 1] = 1.0
    with pytest.raises(ValueError, match="antisymmetry violated"):
        LieAlgebra(c)


@pytest.mark.parametrize(
    ("brackets", "error", "message"),
    [
        ([((0, 1), {0: 1.0})], TypeError, "brackets must be a mapping"),
        ({0: {0: 1.0}}, TypeError, "must be a pair of indices"),
        ({(0, 1): 1.0}, TypeError, "must be a mapping {k: c}"),
        ({(0, 1): {2: 1.0}}, ValueError, "index k = 2"),
        ({(0, 1): {0: 1.0}, (1, 0): {}}, ValueError, "antisymmetry violated"),
        ({(0, 1): {"a": 1.0}}, ValueError, "brackets name 'a', which is not in the basis"),
    ],
)
def test_wrong_brackets_are_refused(brackets, error, message):
    with pytest.raises(error, match=message):
        LieAlgebra.from_brackets(2, brackets)


@pytest.mark.parametrize("seed", range(8))
def test_written_brackets_are_the_sums_of_their_terms(seed):
    """Elements may occur several times, with signs, quotients, decimals and exponents, with or without spaces."""
    rng = np.random.default_rng(seed)
    basis = ("e1", "e12", "E", "p_x", "x")
    lines, expected = [], {}
    for i, j in ((0, 1), (3, 2), (4, 0)):
        total, text = {}, ""
        for number in range(int(rng.integers(1, 8))):
            sign = str(rng.choice(["-", "+"])) if number or rng.random() < 0.5 else ""
            factor, size = [("", 1.0), ("2", 2.0), ("1/3", 1 / 3), ("0.5*", 0.5), ("25e-2 ", 0.25), (".5/4 * ", 0.125)][
                rng.integers(6)
            ]
            k = int(rng.integers(len(basis)))
            text += f"{' ' * int(rng.integers(2))}{sign} {factor} {basis[k]}"
            total[k] = total.get(k, 0.0) + (-size if sign == "-" else size)
        lines.append(f"[{basis[i]}, {basis[j]}] ={text}")
        expected[i, j] = total
    assert read_written(lines, basis) == expected


def test_lines_of_brackets_with_a_basis_and_without():
    """The names are in order of appearance, or as they are given, with elements that no bracket has."""
    lines = ["[h, e] = 2 e", "[f, h] = 2 f", "[e, f] = h"]
    assert LieAlgebra.from_brackets(lines).basis == ("h", "e", "f")
    for basis in (("h", "e", "f"), ("e", "f", "h"), ("z", "f", "h", "y", "e")):
        g = LieAlgebra.from_brackets(lines, basis=basis)
        assert g == LieAlgebra.from_brackets(len(basis), lines, basis=basis) and g.basis == basis
        h, e, f = (np.eye(g.dim)[basis.index(name)] for name in "hef")
        for one, other, expected in ((h, e, 2 * e), (h, f, -2 * f), (e, f, h)):
            assert np.array_equal(g.bracket(one, other), expected)
        pairs = {("h", "e"): {"e": 2.0}, ("h", "f"): {"f": -2.0}, ("e", "f"): {"h": 1.0}}
        assert LieAlgebra.from_brackets(len(basis), pairs, basis=basis) == g
    for again in ("[h, e] = 2 e", "[e, h] = -2 e", "[e, h] = 0"):
        for one, other in (([lines[0], again], again), ([again, lines[0]], lines[0])):
            i, j = other.split("]")[0].strip("[").split(", ")
            with pytest.raises(ValueError, match=f"^the bracket of {i} and {j} is given twice"):
                LieAlgebra.from_brackets(one)
    with pytest.raises(ValueError, match=r"is not a bracket of h, e"):
        LieAlgebra.from_brackets(lines, basis=("h", "e"))


@pytest.mark.parametrize("large", [0, 1])
def test_antisymmetry_is_measured_by_the_smaller_element(large):
    """An error that is small beside the constants of one element is not beside those of the other."""
    small = 1 - large
    constants = np.zeros((4, 4, 4))
    constants[large, 2, 2], constants[2, large, 2] = 1e12, -1e12
    constants[large, small, small], constants[small, large, small] = 1e-3, -1e-3
    LieAlgebra(constants)
    constants[small, large, small] += 1e-8
    with pytest.raises(ValueError, match="antisymmetry violated"):
        LieAlgebra(constants)
