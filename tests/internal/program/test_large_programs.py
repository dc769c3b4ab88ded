"""Large systems: the tables are those of a plain construction, and their cost grows with what is not zero."""

import sys
import tracemalloc

import numpy as np
import pytest
from scipy.sparse import block_diag, diags_array, random_array

import coadjoint as co
from coadjoint.algebra.exact import sparse_sums
from coadjoint.program import actions, block_table
from coadjoint.program.generators import BasisMatrices
from coadjoint.program.parts.casimir_shifts import candidate_shifts, quadratic_casimirs
from coadjoint.program.parts.decompose import decompose
from coadjoint.program.parts.split import split
from coadjoint.program.parts.squares import complete_squares, sparse_squares
from coadjoint.program.sparse_rows import SparseRows, layers
from coadjoint.program.table import build_program

SO3 = co.algebras.so(3)


def chain(count, site=(1.0, 0.5, 0.25), coupling=(0.1, 0.1, 0.2)):
    bonds = np.tile(coupling, count)[3:]
    return co.Quadratic(diags_array([np.tile(np.array(site), count), bonds, bonds], offsets=[0, 3, -3]))


def spins(count, **options):
    return co.LiePoissonSystem(co.algebras.copies(SO3, count), chain(count, **options))


def twisted(count):
    """Couplings of x with the y of the neighbour, which makes one connected set of noncommuting coordinates."""
    M = diags_array([np.zeros(3 * count), np.tile([0.3, 0, 0], count)[: 3 * count - 4]], offsets=[0, 4]).tocsr()
    return co.LiePoissonSystem(co.algebras.copies(SO3, count), co.Quadratic(M + M.T, linear=np.ones(3 * count)))


def nilpotent(n, seed=0):
    random, half = np.random.default_rng(seed), n // 2
    first, second = np.sort(random.integers(0, half, (2 * n, 2)), axis=1).T
    rows = np.unique(np.stack([first, second, random.integers(half, n, 2 * n)], axis=1)[first < second], axis=0)
    return co.LieAlgebra(np.column_stack([rows, random.standard_normal(len(rows))]), dim=n)


def test_layers_are_longest_paths():
    random = np.random.default_rng(2)
    edges = np.sort(random.integers(0, 50, (120, 2)), axis=1)
    edges = edges[edges[:, 0] < edges[:, 1]]
    longest = [0] * 50
    for a, b in sorted(edges.tolist(), key=lambda edge: edge[1]):
        longest[b] = max(longest[b], longest[a] + 1)
    assert layers(50, *edges.T).tolist() == longest


def sparse(matrix):
    rows = [np.flatnonzero(row) for row in matrix]
    values = [row[own].tolist() for row, own in zip(matrix, rows, strict=True)]
    return SparseRows.of_lists([own.tolist() for own in rows], values)


@pytest.mark.parametrize("hollow", [False, True])
def test_sparse_squares_are_bit_for_bit_the_dense_ones(hollow):
    random = np.random.default_rng(5)
    A = random_array((40, 40), density=0.04, rng=random).toarray()
    matrix = A + A.T + (0.0 if hollow else 1.0) * np.diag(random.uniform(-1.0, 1.0, 40))
    for given in (matrix, chain(20).hessian(np.zeros(60)), twisted(10).hamiltonian.hessian(np.zeros(30))):
        linear = np.where(random.uniform(size=len(given)) < 0.5, 1.0, 0.0)
        found, expected = sparse_squares(sparse(given), linear), complete_squares(given, linear)
        forms = np.zeros_like(expected.forms)
        forms[found.forms.owner, found.forms.coordinate] = found.forms.value
        assert np.count_nonzero(given) < 16 * len(given)  # else both were dense
        assert np.array_equal(forms, expected.forms)
        assert np.array_equal(found.weights, expected.weights) and np.array_equal(found.linear, expected.linear)


@pytest.mark.parametrize("M", [(1.0, 1.0, 2.0), (1.0, 1.0, 1.0), (3.0, 2.0, 1.0)])
@pytest.mark.parametrize("copies", [1, 2, 5])
def test_a_shift_is_tried_once(M, copies):
    system = co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), copies), co.Quadratic(np.tile(M, copies)))
    shifts = list(candidate_shifts(system, split(system), quadratic_casimirs(system)))
    assert shifts and len(set(shifts)) == len(shifts)


def calls(make):
    """Count the calls of functions, Python's and built-in ones, while a program is built."""
    system, counted = make(), 0

    def count(frame, event, argument):
        nonlocal counted
        counted += event in ("call", "c_call")

    build_program(make(), co.Splitting())  # nothing is loaded for the first time while counting
    sys.setprofile(count)
    try:
        build_program(system, co.Splitting())
    finally:
        sys.setprofile(None)
    return counted


@pytest.mark.parametrize(
    "make",
    [
        lambda n: spins(n),
        lambda n: co.LiePoissonSystem(co.algebras.copies(SO3, n), co.Quadratic(np.tile([1.0, 0.5, 0.25], n))),
        lambda n: co.LiePoissonSystem(nilpotent(3 * n), co.Quadratic(np.ones(3 * n))),
    ],
    ids=["chain", "bodies", "nilpotent"],
)
def test_no_python_runs_for_each_coordinate(make):
    """Sixteen times as many coordinates take about as many calls: the loops are those of layers, not of coordinates."""
    small, large = (calls(lambda n=n: make(n)) for n in (700, 11_200))
    assert large < 1.5 * small


@pytest.mark.parametrize("choice", ["auto", "coordinates"])
def test_memory_grows_with_the_number_of_spins(choice):
    def peak(count):
        algebra, H = co.algebras.copies(SO3, count), co.Quadratic(np.tile([1.0, 0.5, 0.25], count))
        tracemalloc.start()
        build_program(co.LiePoissonSystem(algebra, H), co.Splitting(parts=choice))
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    assert peak(16_000) < 4.4 * peak(4000)


def test_tables_are_lean():
    program = build_program(spins(2000), co.Splitting())
    n = 6000
    state, terms = program.state, program.terms
    assert len(state.kind) == 3  # one run for each part
    assert len(state.indices) == 2 * n and len(state.constants) == n
    assert len(terms.column) == 3 * n - 6 and len(terms.kind) == 3
    whole = [column for table in (state, terms) for column in table if isinstance(column, np.ndarray)]
    assert {column.dtype for column in whole} <= {np.dtype(kind) for kind in ("uint8", "uint32", "float64")}
    # indices 2, constants 1, target, offset, entry 1 each, 3 columns and weights: nothing is held twice
    assert sum(column.nbytes for column in whole) <= (2 * 4 + 8 + 4 + 8 + 4 + 3 * (4 + 8)) * n + 1000


LEAST = block_table.MIN_REPEATED
CELLS = {
    "so(3)": co.algebras.so(3),
    "sl(2)": co.algebras.sl(2),
    "e(3)": co.algebras.e(3),
    "su(3)": co.algebras.su(3),
    "affine": co.LieAlgebra([(0, 1, 1, 1.5)], dim=2),
    "nilpotent": co.LieAlgebra([(0, 1, 2, 1.0), (0, 2, 3, -2.0)], dim=4),
    "so(3) and so(4)": co.algebras.direct_sum(co.algebras.so(3), co.algebras.so(4)),
}


def diagonal_system(cell, copies, changed=None):
    """Copies of an algebra; the middle one with another constant, or of another algebra, so(3) becoming solvable."""
    algebra = co.algebras.copies(cell, copies)
    if changed:
        rows, middle = np.stack(algebra.triples, axis=1), cell.dim * (copies // 2)
        here = (rows[:, 0] >= middle) & (rows[:, 0] < middle + cell.dim)
        other = [(middle, middle + 1, middle + 1, 1.0), (middle, middle + 2, middle + 2, -1.0)]
        own = rows[here] * [1, 1, 1, 1.25] if changed == "constant" else other
        algebra = co.LieAlgebra(np.concatenate([rows[~here], own]), dim=algebra.dim)
    diagonal = np.random.default_rng(1).uniform(0.5, 2.0, algebra.dim)
    return co.LiePoissonSystem(algebra, co.Quadratic(diagonal), casimirs={})


def repeated_blocks_of(system, choice):
    parts, matrices = decompose(system, choice).parts, BasisMatrices.coadjoint(system.algebra)
    return parts, matrices, block_table.repeated_block_table(matrices, parts.forms)


@pytest.mark.parametrize(
    ("name", "choice", "changed", "chunk"),
    [
        *((name, choice, None, None) for name in CELLS for choice in ("coordinates", "auto")),
        ("so(3)", "coordinates", "constant", None),
        ("so(3)", "coordinates", "target", None),
        ("su(3)", "coordinates", None, 8),
    ],
)
def test_shapes_of_copies_give_the_blocks_of_all_elements(name, choice, changed, chunk, monkeypatch):
    if chunk:
        monkeypatch.setattr(sparse_sums, "CHUNK", chunk)
    system = diagonal_system(CELLS[name], LEAST // CELLS[name].dim + 2, changed)
    parts, matrices, used = repeated_blocks_of(system, choice)
    by_shape = actions.build_action(matrices, parts)
    monkeypatch.setattr(actions, "repeated_block_table", lambda *_: None)
    of_all = actions.build_action(matrices, parts)
    assert used is not None
    for column, other in zip(by_shape, of_all, strict=True):
        np.testing.assert_array_equal(column, other)


def test_forms_or_hashes_that_do_not_serve_are_taken_one_by_one(monkeypatch):
    tensor = np.array([[2.0, 0.3, 0.1], [0.3, 1.5, 0.2], [0.1, 0.2, 1.0]])
    bodies = co.LiePoissonSystem(
        co.algebras.copies(SO3, LEAST), co.Quadratic(block_diag([tensor] * LEAST).tocsr()), casimirs={}
    )
    assert repeated_blocks_of(bodies, "auto")[-1] is None  # the forms are no basis elements
    monkeypatch.setattr(block_table, "HASH_FACTOR", np.uint64(0))  # different shapes have equal hashes
    assert repeated_blocks_of(diagonal_system(CELLS["e(3)"], LEAST), "coordinates")[-1] is None
