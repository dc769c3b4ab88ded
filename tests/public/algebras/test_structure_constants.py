"""Structure constants: what is read, and the identities that they must fulfil."""

import itertools
from contextlib import nullcontext
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lie_algebras import catalogue, coadjoint_matrices, constants_of, known_casimirs

import coadjoint as co
from commuting_actions import acting
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

pytestmark = pytest.mark.thinned(1)

LieAlgebra = co.LieAlgebra
NAMES = ["so(4)", "so(5)", "e(3)", "sl(2)", "heisenberg(2)"]


def rows_of(c):
    """(i, j, k, c) with i < j."""
    return [(i, j, k, c[i, j, k]) for i, j, k in zip(*np.nonzero(c), strict=True) if i < j]


def spoiled(g, size=1.0, place=0, factor=1.0):
    """Rows of the constants, all scaled, and one of them by a factor."""
    rows = rows_of(size * constants_of(g))
    rows[place] = (*rows[place][:3], rows[place][3] * factor)
    return rows


@pytest.mark.parametrize("name", NAMES)
def test_every_input_form_gives_the_same_algebra(name):
    g = co.algebras.get(name)
    c = constants_of(g)
    rows, brackets = rows_of(c), {}
    for i, j, k, value in rows:
        brackets.setdefault((j, i), {})[k] = -value  # the other order
    both = rows + [(j, i, k, -value) for i, j, k, value in rows]
    for other in (
        LieAlgebra(c),
        LieAlgebra(c.tolist()),
        LieAlgebra(rows[::-1], dim=g.dim),
        LieAlgebra(np.array(both + rows), dim=g.dim),
        LieAlgebra([*rows, (0, 1, 0, c[0, 1, 0])], dim=g.dim),
        LieAlgebra.from_brackets(g.dim, brackets, basis=[f"b{i}" for i in range(g.dim)]),
    ):
        assert other == g and hash(other) == hash(g)
    c[:] = 7.0  # what was given is copied
    assert LieAlgebra(rows, dim=g.dim) == g


def test_algebras_without_brackets():
    assert LieAlgebra([], dim=3) == LieAlgebra(np.zeros((3, 3, 3))) == LieAlgebra.from_brackets(3, {})
    assert LieAlgebra([], dim=3) != LieAlgebra([], dim=4)
    assert not LieAlgebra([], dim=3).structure_matrix(np.ones(3)).any()


def test_jacobi_violation_names_triple_component_and_defect():
    # [[e1,e2],e4] + [[e2,e4],e1] + [[e4,e1],e2] = [e1,e4]/2 = e3/2, and nothing else is violated
    rows = [(0, 1, 0, 0.5), (0, 3, 2, 1.0)]
    for basis, triple, component in ((None, "(e1, e2, e4)", "component e3"), ("abcd", "(a, b, d)", "component c")):
        with refused(ValueError, "Jacobi", triple, "(0, 1, 3)", "0.5", component):
            LieAlgebra(rows, dim=4, basis=basis and tuple(basis))


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
    if (defect > 64 * U * size).any():
        with refused(ValueError, "Jacobi"):
            LieAlgebra(c)
    else:
        assert np.array_equal(constants_of(LieAlgebra(c)), c)


@settings(deadline=None, max_examples=15)
@given(st.sampled_from(["so(4)", "e(3)"]), st.integers(0, 2**32 - 1))
def test_constants_rounded_once_in_a_rational_basis_are_accepted(name, seed):
    rng = np.random.default_rng(seed)
    a = [[Fraction(int(p), int(q)) for p, q in zip(*rng.integers(1, 9, (2, 6)), strict=True)] for _ in range(6)]
    a = [[v + 40 * (i == j) for j, v in enumerate(row)] for i, row in enumerate(a)]  # regular
    c = constants_of(co.algebras.change_of_basis(co.algebras.get(name), a))
    assert np.array_equal(constants_of(LieAlgebra(c)), c)
    i, j, k = np.unravel_index(np.argmax(abs(c)), c.shape)
    c[i, j, k] *= 1 + 1e-9
    c[j, i, k] = -c[i, j, k]
    with refused(ValueError, "Jacobi"):
        LieAlgebra(c)


@pytest.mark.parametrize("scale", [2.0**-600, 1.0, 2.0**600])
def test_jacobi_is_relative_whatever_the_unit(scale):
    so4 = co.algebras.so(4)
    assert LieAlgebra(spoiled(so4, scale), dim=6).dim == 6
    with refused(ValueError, "Jacobi"):
        LieAlgebra(spoiled(so4, scale, factor=1 + 1e-10), dim=6)


@pytest.mark.parametrize(("share", "accepted"), [(0.5, True), (2.0, False)])
def test_the_jacobi_identity_holds_to_64_units_of_round_off(share, accepted):
    """Two matrices that act on a plane commute up to a difference of two products of one size."""
    first = np.array([[0.0, np.pi], [np.pi, 0.0]])
    second = first * [[1.0], [1.0 + 2.0 * share * 64 * U]]
    with nullcontext() if accepted else refused(ValueError, "Jacobi"):
        assert acting(first, second).dim == 4


@pytest.mark.parametrize("place", range(0, 12, 3))
def test_every_constant_counts(place):
    """A violation in a small summand beside a large one."""
    large, small = spoiled(co.algebras.so(4)), spoiled(co.algebras.so(4), 2.0**-60, place, 1.001)
    right = spoiled(co.algebras.so(4), 2.0**-60)
    for part, accepted in ((right, True), (small, False)):
        rows = large + [(i + 6, j + 6, k + 6, c) for i, j, k, c in part]
        with nullcontext() if accepted else refused(ValueError, "Jacobi", "e"):
            assert LieAlgebra(rows, dim=12).generic_rank() == 8


def test_many_copies_and_large_rotations_are_checked_sparsely():
    m = 30_000
    first = 3 * np.arange(m)
    turns = np.concatenate([np.stack([first + a, first + b, first + c, np.ones(m)], axis=1)
                            for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1))])  # fmt: skip
    assert LieAlgebra(turns, dim=3 * m) == co.algebras.copies(co.algebras.so(3), m)
    assert co.algebras.so(60).dim == 1770
    turns[-1, 2] = 5  # a bracket of the last copy now leaves its copy
    with refused(ValueError, "Jacobi"):
        LieAlgebra(turns, dim=3 * m)


def test_antisymmetry_is_relative():
    c = constants_of(co.algebras.so(4)) * 2.0**40
    c[0, 1, 3] *= 1 + 2.0**-50
    assert LieAlgebra(c).dim == 6
    c[0, 1, 3] *= 1 + 2.0**-40
    with refused(ValueError, "antisymmetry", "(e1, e2)", "(0, 1)", "e4"):
        LieAlgebra(c)


@pytest.mark.parametrize("large", [0, 1])
def test_antisymmetry_is_measured_by_the_smaller_element(large):
    """An error that is small beside the constants of one element is not beside those of the other."""
    small = 1 - large
    constants = np.zeros((4, 4, 4))
    constants[large, 2, 2], constants[2, large, 2] = 1e12, -1e12
    constants[large, small, small], constants[small, large, small] = 1e-3, -1e-3
    LieAlgebra(constants)
    constants[small, large, small] += 1e-8
    with refused(ValueError, "antisymmetry"):
        LieAlgebra(constants)


ONE_SIDED = np.zeros((2, 2, 2))
ONE_SIDED[0, 1, 1] = 1.0


@pytest.mark.parametrize("name", [*NAMES, "A3,7", "A3,7 "])
def test_representations_are_checked(name):
    """The own one, the adjoint one and its dual are accepted, another is not, whichever entry is wrong."""
    g = co.algebras.get(name.strip(), **({"a": -7.0 if " " in name else 0.3} if name.startswith("A") else {}))
    c, actions = constants_of(g), coadjoint_matrices(g)
    for matrices in (g.representation, actions, -actions.transpose(0, 2, 1)):
        made = LieAlgebra(c, representation=matrices)
        assert np.array_equal(made.representation, matrices)
        assert not made.representation.flags.writeable
    rho = g.representation
    for flat in range(0, rho.size, 7):
        wrong = rho.copy()
        wrong.flat[flat] += 1e-3 * (1 + abs(wrong.flat[flat]))
        commutators = np.einsum("iab,jbc->ijac", wrong, wrong)
        defect = commutators - commutators.transpose(1, 0, 2, 3) - np.einsum("ijk,kab->ijab", c, wrong)
        found = np.abs(defect).max() > 1e-6
        with refused(ValueError, "representation", "commutator") if found else nullcontext():
            LieAlgebra(c, representation=wrong)
    twice = co.algebras.so(3).representation * [[[1.0]], [[1.0]], [[2.0]]]
    with refused(ValueError, "(e1, e2)", "(0, 1)", "1"):
        LieAlgebra(constants_of(co.algebras.so(3)), representation=twice)


def test_brackets_come_with_everything_that_an_algebra_has():
    g = co.algebras.so(3)
    brackets = ({(0, 1): {2: 1.0}, (1, 2): {0: 1.0}, (2, 0): {1: 1.0}}, ["[a, b] = c", "[b, c] = a", "[c, a] = b"])
    given = {"basis": ("a", "b", "c"), "name": "turns", "representation": g.representation}
    for first in ((3, brackets[0]), (3, brackets[1]), (brackets[1],)):
        made = LieAlgebra.from_brackets(*first, **given, casimirs=known_casimirs(g))
        assert made == g and made.name == "turns" and made.basis == ("a", "b", "c")
        assert np.array_equal(made.representation, g.representation)
        assert known_casimirs(made) == known_casimirs(g)
        with refused(ValueError, "representation"):
            LieAlgebra.from_brackets(*first, **{**given, "representation": -g.representation})


@pytest.mark.parametrize("seed", range(6))
def test_written_brackets_are_the_sums_of_their_terms(seed):
    """Elements may occur several times, with signs, quotients, decimals and exponents, with or without spaces."""
    rng = np.random.default_rng(seed)
    basis = ("e1", "e12", "E", "p_x", "x")
    total, text = np.zeros(5), ""
    for number in range(int(rng.integers(1, 8))):
        sign = str(rng.choice(["-", "+"])) if number or rng.random() < 0.5 else ""
        factor, size = [("", 1.0), ("2", 2.0), ("3/4", 0.75), ("0.5*", 0.5), ("25e-2 ", 0.25), (".5/4 * ", 0.125)][
            rng.integers(6)
        ]
        k = int(rng.integers(2, 5))
        text += f"{' ' * int(rng.integers(2))}{sign} {factor} {basis[k]}"
        total[k] += -size if sign == "-" else size
    g = LieAlgebra.from_brackets([f"[e1, e12] ={text}"], basis=basis)
    assert np.array_equal(g.bracket([1, 0, 0, 0, 0], [0, 1, 0, 0, 0]), total)


def test_lines_of_brackets_with_a_basis_and_without():
    """The names are in order of appearance, or as they are given, with elements that no bracket has."""
    lines = ["[h, e] = 2 e", "[f, h] = 2 f", "[e, f] = h"]
    pairs = {("h", "e"): {"e": 2.0}, ("h", "f"): {"f": -2.0}, ("e", "f"): {"h": 1.0}}
    assert LieAlgebra.from_brackets(lines).basis == ("h", "e", "f")
    for basis in (("h", "e", "f"), ("e", "f", "h"), ("z", "f", "h", "y", "e")):
        g = LieAlgebra.from_brackets(lines, basis=basis)
        h, e, f = (np.eye(g.dim)[basis.index(name)] for name in "hef")
        for one, other, expected in ((h, e, 2 * e), (h, f, -2 * f), (e, f, h)):
            assert np.array_equal(g.bracket(one, other), expected)
        for form in (lines, pairs):
            assert g == LieAlgebra.from_brackets(len(basis), form, basis=basis) and g.basis == basis
    for again in ("[h, e] = 2 e", "[e, h] = -2 e", "[e, h] = 0"):
        for one in ([lines[0], again], [again, lines[0]]):
            with refused(ValueError, "h", " and ", "e", "twice"):
                LieAlgebra.from_brackets(one)
    with refused(ValueError, "h, e", "[f, h]"):
        LieAlgebra.from_brackets(lines, basis=("h", "e"))


def test_brackets_may_be_one_text():
    lines = ["[n, a] = b", "[n, b] = -a", "[a, b] = z"]
    expected = co.LieAlgebra.from_brackets(lines)
    for text in ("\n".join(lines), "; ".join(lines), f"\n    {lines[0]}\n\n    {lines[1]};\n    {lines[2]}\n"):
        found = co.LieAlgebra.from_brackets(text)
        assert found == expected and found.basis == expected.basis == ("n", "a", "b", "z")
    with refused(ValueError, "[a, c", "bracket"):
        co.LieAlgebra.from_brackets("[a, b] = c; [a, c")
    with refused(ValueError, "no brackets"):
        co.LieAlgebra.from_brackets("\n")


def test_names_of_other_libraries_lead_to_the_constructor():
    for name, meant in {
        "from_tensor": "LieAlgebra(constants)",
        "from_structure_constants": "LieAlgebra(constants)",
        "from_commutators": "LieAlgebra.from_brackets",
        "from_generators": "LieAlgebra.from_matrices",
        "lie_closure": "LieAlgebra.closure",
    }.items():
        with refused(AttributeError, name, meant):
            getattr(co, name)


@pytest.mark.parametrize("name", [name for name in catalogue() if name != "heisenberg"])
def test_brackets_that_are_shown_are_read_again(name):
    g = catalogue()[name]
    heading, *lines = str(g).splitlines()
    if lines and not lines[-1].strip().startswith("and"):
        assert LieAlgebra.from_brackets(g.dim, [line.strip() for line in lines], basis=g.basis) == g
    assert heading == f"{g.name}, of dimension {g.dim}"


def test_equality_is_by_value_and_texts_are_short():
    g = co.algebras.so(4)
    other = LieAlgebra(constants_of(g), basis=tuple("abcdef"), name="other")
    assert g == other and len({g, other, co.algebras.e(3)}) == 2 and g != "so(4)"
    assert repr(g) == "LieAlgebra('so(4)', dim=6, 12 brackets)"
    assert repr(LieAlgebra([], dim=2)) == "LieAlgebra(dim=2, commutative)"
    assert repr(co.algebras.A3_7(2.0)).endswith("dim=3: [e1, e3] = 2 e1 - e2, [e2, e3] = e1 + 2 e2)")
    shown = str(co.algebras.so(6)).splitlines()
    assert len(shown) == 32 and shown[-1].strip() == "and 30 more"
    assert len(repr(co.algebras.copies(co.algebras.so(3), 1000))) < 60
    for count in (0, 1, 6, 7, 11):
        rows = [(0, k, k, float(k)) for k in range(1, count + 1)]
        g = LieAlgebra(rows, dim=12, basis=tuple("hijklmnopqrs"))
        lines = [f"[h, {g.basis[k]}] = {'' if k == 1 else f'{k} '}{g.basis[k]}" for k in range(1, count + 1)]
        assert str(g).splitlines() == ["a Lie algebra, of dimension 12", *(f"  {line}" for line in lines)]
        short = f": {', '.join(lines)}" if 0 < count <= 6 else f", {count} brackets" if count else ", commutative"
        assert repr(g) == f"LieAlgebra(dim=12{short})"
