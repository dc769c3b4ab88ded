"""What the constants define: brackets, J(x), the coadjoint action, ranks; in any kind of number."""

import subprocess
import sys
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coadjoint.algebra import catalogue
from coadjoint.algebra.brackets import count_of_brackets, format_brackets, parse_brackets
from coadjoint.algebra.constants import Triples
from coadjoint.algebra.lie_algebra import LieAlgebra

ALGEBRAS = [
    catalogue.so(3),
    catalogue.so(4),
    catalogue.so(5),
    catalogue.e(3),
    catalogue.sl(2),
    catalogue.heisenberg(2),
    catalogue.A3_7(0.3),
]
WITH_VECTORS = st.sampled_from(ALGEBRAS).flatmap(
    lambda g: st.tuples(
        st.just(g),
        *(st.lists(st.fractions(-5, 5, max_denominator=9), min_size=g.dim, max_size=g.dim) for _ in range(3)),
    )
)


def exact(values):
    return np.array([Fraction(v) for v in values], dtype=object)


@pytest.mark.long
@settings(deadline=None, max_examples=80)
@given(WITH_VECTORS)
def test_identities_hold_exactly_in_fractions(drawn):
    g, u, v, w = drawn
    u, v, w = exact(u), exact(v), exact(w)
    assert all(g.bracket(u, v) == -g.bracket(v, u))
    cyclic = g.bracket(g.bracket(u, v), w) + g.bracket(g.bracket(v, w), u) + g.bracket(g.bracket(w, u), v)
    assert all(cyclic == 0)
    assert all(g.coadjoint(u) @ w == g.structure_matrix(w) @ u)
    assert u @ g.structure_matrix(w) @ v == g.bracket(u, v) @ w  # J_ij(x) = <x, [e_i, e_j]>
    commutator = g.coadjoint(u) @ g.coadjoint(v) - g.coadjoint(v) @ g.coadjoint(u)
    assert (commutator == g.coadjoint(g.bracket(u, v))).all()


@settings(deadline=None, max_examples=30)
@given(WITH_VECTORS)
def test_floats_agree_with_fractions(drawn):
    g, u, _, w = drawn
    u, w = exact(u), exact(w)
    uf, wf = u.astype(float), w.astype(float)
    # sums of at most 2 n products, each within 3 u of the exact one
    bound = 64 * g.dim * 2.0**-53 * (1 + float(np.abs(u).max()) * (1 + float(np.abs(w).max())))
    for there, here in (
        (g.structure_matrix(wf), g.structure_matrix(w)),
        (g.coadjoint(uf), g.coadjoint(u)),
        (g.bracket(uf, wf), g.bracket(u, w)),
        (g.structure_operator(wf) @ uf, g.structure_matrix(w) @ u),
        (g.structure_operator(wf).T @ uf, -(g.structure_matrix(w) @ u)),
    ):
        assert np.abs(there - here.astype(float)).max() <= bound


@pytest.mark.long
@settings(deadline=None, max_examples=80)
@given(WITH_VECTORS)
def test_sparse_entries_are_the_nonzero_entries_of_the_matrix(drawn):
    g, u, _, _ = drawn
    for vector in (exact(u), exact(u).astype(float)):
        rows, columns, values = g.coadjoint_entries(vector)
        matrix = g.coadjoint(vector)
        where = np.argwhere(matrix != 0)
        assert np.array_equal(where, np.stack([rows, columns], axis=1))
        assert all(values == matrix[rows, columns])
        chosen = {i: value for i, value in enumerate(vector) if value}
        backward = {np.int64(i): vector[i] for i in reversed(range(g.dim))}  # with zeros, in descending order
        outward = dict(sorted(chosen.items(), key=lambda entry: abs(2 * entry[0] - g.dim)))
        for mapping in (chosen, backward, outward):
            for one, other in zip(g.coadjoint_entries(mapping), (rows, columns, values), strict=True):
                assert np.array_equal(one, other)


KINDS = {
    "int": lambda rng, n: rng.integers(-9, 10, n),
    "int8": lambda rng, n: rng.integers(-9, 10, n).astype(np.int8),
    "float32": lambda rng, n: (rng.integers(-9, 10, n) / 4).astype(np.float32),
    "float": lambda rng, n: rng.integers(-9, 10, n) / 4,
    "complex": lambda rng, n: (rng.integers(-9, 10, n) + 1j * rng.integers(-9, 10, n)) / 4,
    "fraction": lambda rng, n: np.array([Fraction(int(a), 3) for a in rng.integers(-9, 10, n)], dtype=object),
}
RESULTS = {"complex": np.complex128, "fraction": object}
# Their constants are small multiples of powers of two, so that all products of the numbers above are exact.
DYADIC = [catalogue.so(4), catalogue.e(3), catalogue.sl(2), catalogue.A3_7(0.25), LieAlgebra([], dim=2)]


def by_constants(g, u, v):
    """Return [u, v], constant by constant, with exact numbers where both are real."""
    found = [0] * g.dim
    real = not np.iscomplexobj(u) and not np.iscomplexobj(v)
    u, v = ([Fraction(value) for value in w] if real else list(w) for w in (u.tolist(), v.tolist()))
    for i, j, k, c in zip(*(column.tolist() for column in g.triples), strict=True):
        found[k] += (Fraction(c) if real else c) * (u[i] * v[j] - u[j] * v[i])
    return found


@pytest.mark.parametrize("g", DYADIC, ids=str)
@pytest.mark.parametrize("first", KINDS)
@pytest.mark.parametrize("second", KINDS)
def test_operations_in_each_kind_of_numbers(g, first, second):
    """Brackets and actions on vectors of any two kinds, strided ones and lists, against the sum over the constants."""
    if {first, second} == {"fraction", "complex"}:
        return  # there are no exact complex numbers
    rng = np.random.default_rng(g.dim)
    u, v = (np.repeat(KINDS[kind](rng, g.dim), 2)[::2] for kind in (first, second))
    wanted = RESULTS.get("fraction" if "fraction" in (first, second) else "complex")
    if "complex" not in (first, second) and "fraction" not in (first, second):
        wanted = np.float64
    expected = by_constants(g, u, v)
    for found in (g.bracket(u, v), -g.bracket(v, u), g.bracket(u.tolist(), v.tolist())):
        assert found.tolist() == expected and found.dtype == wanted
    if first != second:
        return
    e = np.eye(g.dim, dtype=int).astype(object)
    structure = [[sum(b * x for b, x in zip(by_constants(g, p, q), u.tolist(), strict=True)) for q in e] for p in e]
    assert g.structure_matrix(u).tolist() == structure
    # D_u x = J(x) u for every x, here for those of the basis
    rows = [[sum(w * by_constants(g, e[j], e[i])[k] for i, w in enumerate(u.tolist())) for k in range(g.dim)]
            for j in range(g.dim)]  # fmt: skip
    assert g.coadjoint(u).tolist() == rows
    for matrix in (g.structure_matrix(u), g.coadjoint(u)):
        assert matrix.dtype == RESULTS.get(first, np.float64)


@pytest.mark.parametrize("g", DYADIC, ids=str)
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "fraction"])
def test_the_operator_acts_on_each_kind_of_numbers(g, kind):
    rng = np.random.default_rng(7)
    x, v = KINDS["float"](rng, g.dim), np.repeat(KINDS[kind](rng, g.dim), 2)[::2]
    J, operator = g.structure_matrix(x), g.structure_operator(x)
    assert np.array_equal(operator @ v, J @ v) and np.array_equal(operator.T @ v, -J @ v)
    assert np.array_equal(operator.H @ v, -J @ v) and np.array_equal(operator.rmatvec(v), -J @ v)
    assert np.array_equal(operator @ np.stack([v, 2 * v], axis=1), np.stack([J @ v, 2 * J @ v], axis=1))
    assert (operator @ v).dtype == (J @ v).dtype and operator.shape == J.shape


@pytest.mark.parametrize("g", ALGEBRAS, ids=str)
def test_multiprecision(g):
    rng = np.random.default_rng(1)
    a, b = rng.integers(1, 50, (2, g.dim)).tolist()
    with mpmath.workdps(50):
        x = np.array([mpmath.sqrt(v) for v in a], dtype=object)
        u = np.array([mpmath.sqrt(v) for v in b], dtype=object)
        defect = g.coadjoint(u) @ x - g.structure_matrix(x) @ u
        rows, columns, values = g.coadjoint_entries(u)
        sparse = np.zeros(g.dim, dtype=object)
        np.add.at(sparse, rows, values * x[columns])
        assert max(map(abs, defect)) < mpmath.mpf(10) ** -46
        assert max(map(abs, sparse - g.coadjoint(u) @ x)) < mpmath.mpf(10) ** -46
        assert max(map(abs, g.bracket(u, x) + g.bracket(x, u))) == 0


def test_signs_of_the_rigid_body():
    g, rng = catalogue.so(3), np.random.default_rng(2)
    u, x = rng.standard_normal((2, 3))
    assert np.allclose(g.structure_matrix(x) @ u, np.cross(u, x), rtol=0, atol=64 * 2.0**-53)
    assert np.allclose(g.coadjoint(u), [[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]], rtol=0, atol=0)


def test_heavy_top_equations():
    g, rng = catalogue.e(3), np.random.default_rng(3)
    x, u = rng.standard_normal((2, 6))
    m, p, w, v = x[:3], x[3:], u[:3], u[3:]
    body = np.concatenate([np.cross(m, w) + np.cross(p, v), np.cross(p, w)])  # sign = -1
    assert np.abs(-g.structure_matrix(x) @ u - body).max() < 64 * 2.0**-53


def test_manakov_equations():
    g, rng = catalogue.so(4), np.random.default_rng(4)
    x, u = rng.standard_normal((2, 6))
    first, second = np.triu_indices(4, 1)
    momentum, velocity = np.tensordot(x, g.representation, 1), np.tensordot(u, g.representation, 1)
    body = momentum @ velocity - velocity @ momentum  # M' = [M, Omega], sign = -1
    assert np.abs(-(g.structure_matrix(x) @ u) - body[first, second]).max() < 64 * 2.0**-53


@pytest.mark.parametrize(
    ("g", "rank"),
    [
        (catalogue.A3_7(2.0), 2),
        (catalogue.A3_7(0.1), 2),
        (LieAlgebra([(0, 1, 1, 1.0)], dim=2), 2),
        (LieAlgebra([(0, 1, 1, 2.0**-1000)], dim=2), 2),
        (LieAlgebra([], dim=4), 0),
    ],
    ids=str,
)
def test_generic_rank(g, rank):
    assert g.generic_rank() == rank == g.generic_rank()


def test_generic_rank_is_not_fooled_by_sizes():
    """A block of tiny constants counts as much as a block of large ones: no floating tolerance is involved."""
    i, j, k, c = catalogue.so(4).triples
    both = Triples(*(np.concatenate([q, q + 6]) for q in (i, j, k)), np.concatenate([c * 2.0**200, c * 2.0**-200]))
    assert LieAlgebra(both, dim=12).generic_rank() == 8


@pytest.mark.parametrize("g", ALGEBRAS, ids=str)
def test_commuting_and_neighbours(g):
    indptr, indices = g.neighbours()
    basis = np.eye(g.dim)
    for i in range(g.dim):
        expected = [j for j in range(g.dim) if g.bracket(basis[i], basis[j]).any()]
        assert indices[indptr[i] : indptr[i + 1]].tolist() == expected
        assert [j for j in range(g.dim) if not g.commuting(i, j)] == expected


def test_wrong_arguments_are_refused():
    g = catalogue.so(4)
    for call in (g.structure_matrix, g.coadjoint, g.structure_operator, g.coadjoint_entries, lambda x: g.bracket(x, x)):
        with pytest.raises(ValueError, match=r"must have shape \(6,\), not \(5,\)"):
            call(np.zeros(5))
        with pytest.raises(TypeError, match="must be an array of real numbers"):
            call(np.array(list("abcdef")))
    with pytest.raises(TypeError, match="real floats"):
        g.structure_operator(exact(range(6)))
    with pytest.raises(TypeError, match="real floats, not complex128"):
        g.structure_operator(1j * np.arange(6))
    for wrong in (-1, 6, 1.0):
        with pytest.raises(ValueError, match=f"an index of u must be a whole number from 0 to 5, not {wrong}"):
            g.coadjoint_entries({0: 2.0, wrong: 1.0})
        for pair in ((0, wrong), (wrong, 0)):
            with pytest.raises(ValueError, match=f"of a basis element must be a whole number from 0 to 5, not {wrong}"):
                g.commuting(*pair)
    with pytest.raises(TypeError, match=r"u is .*; it must be an array of real numbers"):
        g.coadjoint_entries({5: "a"})
    with pytest.raises(TypeError, match="casimirs must be a mapping"):
        LieAlgebra([], dim=1, casimirs=[1])
    with pytest.raises(TypeError, match="name of a Lie algebra"):
        LieAlgebra([], dim=1, name=1)


def test_equality_is_by_value_and_repr_is_short():
    g = catalogue.so(4)
    other = LieAlgebra(g.triples, dim=6, basis=tuple("abcdef"), name="other")
    assert g == other
    assert len({g, other, catalogue.e(3)}) == 2
    assert g != "so(4)"
    assert repr(g) == "LieAlgebra('so(4)', dim=6, 12 brackets)"
    assert repr(LieAlgebra([], dim=2)) == "LieAlgebra(dim=2, commutative)"
    assert (
        repr(catalogue.get("A3_7", a=2.0))
        == "LieAlgebra('A3_7(a=2)', dim=3: [e1, e3] = 2 e1 - e2, [e2, e3] = e1 + 2 e2)"
    )
    shown = str(catalogue.so(6)).splitlines()
    assert shown[0] == "so(6), of dimension 15" and len(shown) == 32 and shown[-1].strip() == "and 30 more"
    assert "and 30 more" in catalogue.so(6)._repr_html_() and "<td>15</td>" in catalogue.so(6)._repr_html_()
    for count in range(12):
        rows = [(0, k, k, float(k)) for k in range(1, count + 1)]
        g = LieAlgebra(rows, dim=12, basis=tuple("hijklmnopqrs"))
        lines = [f"[h, {g.basis[k]}] = {'' if k == 1 else f'{k} '}{g.basis[k]}" for k in range(1, count + 1)]
        assert str(g).splitlines() == ["a Lie algebra, of dimension 12", *(f"  {line}" for line in lines)]
        assert (", ".join(lines) or "none") in g._repr_html_() and "more" not in g._repr_html_() + str(g)
        short = f": {', '.join(lines)}" if 0 < count <= 6 else f", {count} brackets" if count else ", commutative"
        assert repr(g) == f"LieAlgebra(dim=12{short})"
    assert len(repr(catalogue.copies(catalogue.so(3), 1000))) < 60


def test_brackets_that_are_shown_are_read_again():
    for g in (catalogue.so(4), catalogue.get("A5_13", a=0.5, p=0.25, s=2), catalogue.sl(3), catalogue.heisenberg(2)):
        lines = format_brackets(g.triples, g.basis, 1000)
        assert len(lines) == count_of_brackets(g.triples)
        assert LieAlgebra.from_brackets(g.dim, parse_brackets(lines, g.basis)) == g


def test_vectors_are_not_changed():
    g = catalogue.e(3)
    x = np.arange(6.0)
    g.structure_matrix(x), g.coadjoint(x), g.bracket(x, x[::-1]), g.coadjoint_entries(x), g.structure_operator(x) @ x
    assert x.tolist() == list(range(6))


def test_the_algebra_layer_loads_numpy_only():
    code = (
        "import sys, coadjoint.algebra.catalogue as c; c.so(4).generic_rank();"
        "print([m for m in ('scipy', 'numba', 'mpmath', 'xarray', 'matplotlib', 'pydantic') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
