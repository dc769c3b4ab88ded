"""Large systems: tables and their cost grow with what is not zero, and products of brackets are counted beforehand."""

import sys
import tracemalloc

import numpy as np
import pytest
from scipy.sparse import diags_array

import coadjoint as co
from coadjoint.program.modified_series import estimated_products
from coadjoint.program.parts.split import split
from coadjoint.program.table import build_flow_table

SO3 = co.algebras.so(3)


def chain(count, site=(1.0, 0.5, 0.25), coupling=(0.1, 0.1, 0.2)):
    bonds = np.tile(coupling, count)[3:]
    return co.Quadratic(diags_array([np.tile(np.array(site), count), bonds, bonds], offsets=[0, 3, -3]))


def spins(count, **options):
    return co.LiePoissonSystem(co.algebras.copies(SO3, count), chain(count, **options))


def nilpotent(n, seed=0):
    random, half = np.random.default_rng(seed), n // 2
    first, second = np.sort(random.integers(0, half, (2 * n, 2)), axis=1).T
    rows = np.unique(np.stack([first, second, random.integers(half, n, 2 * n)], axis=1)[first < second], axis=0)
    return co.LieAlgebra(np.column_stack([rows, random.standard_normal(len(rows))]), dim=n)


def calls(make):
    """Count the calls of functions, Python's and built-in ones, while a program is built."""
    system, counted = make(), 0

    def count(frame, event, argument):
        nonlocal counted
        counted += event in ("call", "c_call")

    build_flow_table(make(), co.Splitting())  # nothing is loaded for the first time while counting
    sys.setprofile(count)
    try:
        build_flow_table(system, co.Splitting())
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
        build_flow_table(co.LiePoissonSystem(algebra, H), co.Splitting(parts=choice))
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    assert peak(16_000) < 4.4 * peak(4000)


def test_tables_are_lean():
    program = build_flow_table(spins(2000), co.Splitting())
    n = 6000
    state, terms = program.state, program.terms
    assert len(state.kind) == 3  # one run for each part
    assert len(state.indices) == 2 * n and len(state.constants) == n
    assert len(terms.column) == 3 * n - 6 and len(terms.kind) == 3
    whole = [column for table in (state, terms) for column in table if isinstance(column, np.ndarray)]
    assert {column.dtype for column in whole} <= {np.dtype(kind) for kind in ("uint8", "uint32", "float64")}
    # indices 2, constants 1, target, offset, entry 1 each, 3 columns and weights: nothing is held twice
    assert sum(column.nbytes for column in whole) <= (2 * 4 + 8 + 4 + 8 + 4 + 3 * (4 + 8)) * n + 1000


ALGEBRAS = {
    "so(3)": co.algebras.so(3),
    "sl(2)": co.algebras.sl(2),
    "A3,7": co.algebras.A3_7(1.5),
    "Heisenberg": co.algebras.heisenberg(2),
    "e(3)": co.algebras.e(3),
    "so(4)": co.algebras.so(4),
    "sl(3)": co.algebras.sl(3),
}


def drawn(algebra, density, driven, seed):
    rng, n = np.random.default_rng(seed), algebra.dim
    M = rng.normal(size=(n, n)) * (rng.random((n, n)) < density)
    linear = rng.normal(size=n) if driven else np.zeros(n)
    return co.LiePoissonSystem(algebra, co.Quadratic(M + M.T + np.diag(rng.normal(size=n)), linear=linear))


def slopes(monomials, i):
    """Count the monomials of the derivative by x_i; each is the sorted tuple of its factors."""
    return len({(*e[: e.index(i)], *e[e.index(i) + 1 :]) for e in monomials if i in e})


def enumerated(algebra, parts):
    """Count the products in the brackets of each angle with the energy of the later parts.

    No monomials cancel, as for random coefficients. Linear terms of the energy are left out.
    """
    total, energy = 0, set()
    structure = {(a, j, k) for i, b, k, _ in zip(*algebra.triples, strict=True) for a, j in ((i, b), (b, i))}
    for p in reversed(range(len(parts))):
        own = set()
        for angle in np.flatnonzero(parts.part_of_angle == p):
            form, weights = (
                rows.coordinate[rows.start[angle] : rows.start[angle + 1]].tolist()
                for rows in (parts.forms, parts.weights)
            )
            own |= {tuple(sorted((a, b))) for a in form for b in weights}
            for i in range(algebra.dim):
                turned = {k for a, j, k in structure if a == i and j in form}
                quadratic = {tuple(sorted((k, b))) for k in turned for b in weights}
                total += (len(quadratic) + (parts.offset[angle] != 0) * len(turned)) * slopes(energy, i)
        energy |= own
    return total


@pytest.mark.thinned(2)
@pytest.mark.parametrize("choice", ["auto", "coordinates"])
@pytest.mark.parametrize("driven", [False, True])
@pytest.mark.parametrize("density", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("name", ALGEBRAS)
def test_products_of_the_lowest_brackets_are_counted_exactly(name, density, driven, choice):
    """A product x_k x_l of the two factors of a field is one monomial, in whichever factor x_k is."""
    system = drawn(ALGEBRAS[name], density, driven, len(name))
    parts = split(system, choice)
    assert estimated_products(system.algebra, parts, 2) == enumerated(system.algebra, parts)
