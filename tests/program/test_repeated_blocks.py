"""Blocks of translated basis elements, classified once for each shape: those of all elements, bit by bit."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.program import actions, repeated_blocks
from coadjoint.program.generators import BasisMatrices
from coadjoint.program.parts.decompose import decompose

LEAST = repeated_blocks.MIN_REPEATED
CELLS = {
    "so(3)": co.algebras.so(3),
    "sl(2)": co.algebras.sl(2),
    "e(3)": co.algebras.e(3),
    "su(3)": co.algebras.su(3),
    "affine": co.LieAlgebra([(0, 1, 1, 1.5)], dim=2),
    "nilpotent": co.LieAlgebra([(0, 1, 2, 1.0), (0, 2, 3, -2.0)], dim=4),
    "so(3) and so(4)": co.algebras.direct_sum(co.algebras.so(3), co.algebras.so(4)),
}


def columns_of(action):
    return {name: np.asarray(column).tolist() for name, column in action._asdict().items()}


def actions_of(system, choice, monkeypatch):
    """Return the action by shapes and the one of every element, and whether shapes were used."""
    parts = decompose(system, choice).parts
    matrices = BasisMatrices.coadjoint(system.algebra)
    by_shape = actions.build_action(matrices, parts)
    used = repeated_blocks.repeated_block_table(matrices, parts.forms) is not None
    monkeypatch.setattr(actions, "repeated_block_table", lambda *_: None)
    return by_shape, actions.build_action(matrices, parts), used


@pytest.mark.parametrize("choice", ["coordinates", "auto"])
@pytest.mark.parametrize("name", CELLS)
def test_shapes_of_copies_give_the_blocks_of_all_elements(name, choice, monkeypatch):
    cell = CELLS[name]
    algebra = co.algebras.copies(cell, LEAST // cell.dim + 1)
    diagonal = np.random.default_rng(1).uniform(0.5, 2.0, algebra.dim)
    system = co.LiePoissonSystem(algebra, co.Quadratic(diagonal), casimirs={})
    by_shape, of_all, used = actions_of(system, choice, monkeypatch)
    assert used
    assert columns_of(by_shape) == columns_of(of_all)


@pytest.mark.parametrize("changed", ["constant", "target"])
def test_elements_that_are_no_translates_have_shapes_of_their_own(changed, monkeypatch):
    count = LEAST // 3 + 2
    i, j, k, c = (np.array(column) for column in co.algebras.copies(co.algebras.so(3), count).triples)
    middle = 3 * (count // 2)
    if changed == "constant":
        c[(i >= middle) & (i < middle + 3)] *= 1.25
        algebra = co.LieAlgebra(np.stack([i, j, k, c], axis=1), dim=3 * count)
    else:
        here = (i >= middle) & (i < middle + 3)
        other = [(middle, middle + 1, middle + 1, 1.0), (middle, middle + 2, middle + 2, -1.0)]
        algebra = co.LieAlgebra([*np.stack([i, j, k, c], axis=1)[~here].tolist(), *other], dim=3 * count)
    diagonal = np.random.default_rng(2).uniform(0.5, 2.0, algebra.dim)
    system = co.LiePoissonSystem(algebra, co.Quadratic(diagonal), casimirs={})
    by_shape, of_all, used = actions_of(system, "coordinates", monkeypatch)
    assert used
    assert columns_of(by_shape) == columns_of(of_all)


def test_shapes_in_several_chunks_give_the_blocks_of_all_elements(monkeypatch):
    from coadjoint.algebra.exact import sparse_sums

    monkeypatch.setattr(sparse_sums, "CHUNK", 8)
    algebra = co.algebras.copies(CELLS["su(3)"], LEAST // 8 + 1)
    diagonal = np.random.default_rng(3).uniform(0.5, 2.0, algebra.dim)
    system = co.LiePoissonSystem(algebra, co.Quadratic(diagonal), casimirs={})
    by_shape, of_all, used = actions_of(system, "coordinates", monkeypatch)
    assert used
    assert columns_of(by_shape) == columns_of(of_all)


def test_forms_that_are_no_basis_elements_are_taken_one_by_one():
    count = LEAST
    algebra = co.algebras.copies(co.algebras.so(3), count)
    full = np.array([[2.0, 0.3, 0.1], [0.3, 1.5, 0.2], [0.1, 0.2, 1.0]])
    sparse = pytest.importorskip("scipy.sparse")
    H = co.Quadratic(sparse.kron(sparse.eye_array(count), full).tocsr())
    parts = decompose(co.LiePoissonSystem(algebra, H, casimirs={}), "auto").parts
    assert repeated_blocks.repeated_block_table(BasisMatrices.coadjoint(algebra), parts.forms) is None


def test_equal_hashes_of_different_shapes_are_noticed(monkeypatch):
    monkeypatch.setattr(repeated_blocks, "HASH_FACTOR", np.uint64(0))
    algebra = co.algebras.copies(CELLS["e(3)"], LEAST)
    parts = decompose(
        co.LiePoissonSystem(algebra, co.Quadratic(np.ones(algebra.dim)), casimirs={}), "coordinates"
    ).parts
    assert repeated_blocks.repeated_block_table(BasisMatrices.coadjoint(algebra), parts.forms) is None
