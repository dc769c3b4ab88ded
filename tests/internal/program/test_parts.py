"""Parts of commuting forms: few of them, on every algebra of the catalogue, whose pieces add up to the Hamiltonian."""

import math

import numpy as np
import pytest
from scipy.sparse import coo_array

import coadjoint as co
from catalogue_cases import EXAMPLES
from coadjoint.algebra.catalogue import entries
from coadjoint.program.parts.decompose import decompose
from coadjoint.program.parts.split import split
from coadjoint.program.table import build_flow_table
from drawn_matrices import whole_matrix
from guards import bounded_work


def lattice(count, seed=1):
    """Exchange of neighbours and of random pairs, different along x, y and z, and a field."""
    rng = np.random.default_rng(seed)
    a = np.concatenate([np.arange(count - 1), rng.integers(0, count, count)])
    b = np.concatenate([np.arange(1, count), rng.integers(0, count, count)])
    a, b = a[a != b], b[a != b]
    rows = np.concatenate([3 * a + axis for axis in range(3)])
    columns = np.concatenate([3 * b + axis for axis in range(3)])
    J = coo_array((rng.uniform(0.5, 1.5, len(rows)), (rows, columns)), shape=(3 * count, 3 * count))
    return co.Quadratic((J + J.T).tocsr(), linear=rng.standard_normal(3 * count))


def full(n, seed):
    A = np.random.default_rng(seed).standard_normal((n, n))
    return A + A.T


E3, SO4, SL2, SO3 = co.algebras.e(3), co.algebras.so(4), co.algebras.sl(2), co.algebras.so(3)
A37, HEISENBERG, SO5 = co.algebras.get("A3,7", a=1.75), co.algebras.heisenberg(2), co.algebras.so(5)
HOLLOW = np.array([[0.0, 1.0, 0.5], [1.0, 0.0, -2.0], [0.5, -2.0, 0.0]])
COUPLED = np.diag([1.0, 2.0, 3.0, 0.5, 0.25, 0.75])
COUPLED[3, 4] = COUPLED[4, 3] = 0.125
COUPLED[3, 5] = COUPLED[5, 3] = -0.5


def kepler(y):
    return 1.0 / (1.0 + y[0] * y[0] + y[1] * y[1])


def kepler_slope(y):
    r = 1.0 + y[0] * y[0] + y[1] * y[1]
    return np.array([-2.0 * y[0] / (r * r), -2.0 * y[1] / (r * r)])


QUARTIC = {
    (4, 0, 0): 0.25,
    (2, 0, 0): 0.5,
    (0, 3, 0): 1.0,
    (0, 0, 4): -0.125,
    (1, 0, 1): 0.75,
    (0, 1, 0): 2.0,
    (0, 0, 0): 3.0,
}
CUBIC_IN_P = {(0, 0, 0, 2, 1, 0): 0.5, (0, 0, 0, 0, 1, 3): -0.25, (2, 0, 0, 0, 0, 0): 1.0, (0, 1, 0, 0, 0, 0): 0.5}
PIECES = [
    ((3, 4), co.Hamiltonian(kepler, kepler_slope)),
    ((0,), co.Quadratic(2.0)),
    ((5, 3), co.Polynomial({(1, 2): 0.5})),
    ((1, 4), co.Quadratic([[1.0, 0.5], [0.5, 2.0]])),
]
SYSTEMS = {
    "e(3) diagonal": (E3, co.Quadratic([1.0, 0.5, 0.25, 2.0, 3.0, 4.0], linear=[0, 0, 1, 0, 0.5, 0])),
    "e(3) couplings inside commuting sets": (E3, co.Quadratic(COUPLED)),
    "e(3) full": (E3, co.Quadratic(full(6, 2), linear=np.arange(6.0))),
    "so(4) full": (SO4, co.Quadratic(full(6, 3))),
    "so(4) diagonal": (SO4, co.Quadratic(np.arange(1.0, 7.0))),
    "sl(2) indefinite": (SL2, co.Quadratic(full(3, 4), linear=[1.0, 0, -1.0])),
    "A3,7 full": (A37, co.Quadratic(full(3, 5), linear=[0, 0, 0.5])),
    "A3,7 diagonal": (A37, co.Quadratic([1.0, 2.0, 0.01])),
    "Heisenberg singular": (HEISENBERG, co.Quadratic(np.outer(np.arange(5.0), np.arange(5.0)))),
    "so(5) diagonal": (SO5, co.Quadratic(np.arange(1.0, 11.0))),
    "so(5) full": (SO5, co.Quadratic(full(10, 6))),
    "so(3) zero diagonal": (SO3, co.Quadratic(HOLLOW, linear=[1.0, 2.0, 3.0])),
    "so(3) permuted": (co.algebras.change_of_basis(SO3, np.eye(3)[[2, 0, 1]]), co.Quadratic([1.0, 2.0, 4.0])),
    "so(3) other basis": (co.algebras.change_of_basis(SO3, whole_matrix(3, 7)), co.Quadratic([1.0, 2.0, 4.0])),
    "e(3) other basis": (co.algebras.change_of_basis(E3, whole_matrix(6, 8)), co.Quadratic(full(6, 9))),
    "3 spins": (co.algebras.copies(SO3, 3), lattice(3)),
    "3 spins full": (co.algebras.copies(SO3, 3), co.Quadratic(full(9, 10))),
    "quartic on so(3)": (SO3, co.Polynomial(QUARTIC)),
    "cubic in p on e(3)": (E3, co.Polynomial(CUBIC_IN_P)),
    "pieces on e(3)": (E3, co.SplitHamiltonian(PIECES)),
    "separable on sl(2)": (
        SL2,
        co.Separable(
            {0: (math.cosh, math.sinh), 2: (lambda y, t: 0.5 * y * y * (2.0 + t), lambda y, t: y * (2.0 + t))}
        ),
    ),
}


def system(name):
    return co.LiePoissonSystem(*SYSTEMS[name])


@pytest.mark.parametrize("count", [1, 40, 2000])
def test_any_lattice_of_spins_has_three_parts(count):
    """Found in time nearly linear in the spins: 2000 take about a second."""
    s = co.LiePoissonSystem(co.algebras.copies(SO3, count), lattice(count))
    with bounded_work():
        parts = split(s)
        program = build_flow_table(s, co.Splitting(order=2))
    assert [sorted(i for (i,), _ in part) for part in parts] == [list(range(axis, 3 * count, 3)) for axis in range(3)]
    assert len(program.state.kind) == 3  # one run for each part, however many spins


# Numbers of sets of commuting coordinates; two elsewhere.
THREE = """A3_8 A3_9 A4_7 A4_8 A4_9 A4_10 A4_11 A5_3 A5_6 A5_19 A5_20 A5_21 A5_23 A5_24 A5_25 A5_26 A5_28 A5_29 A5_30
A5_31 A5_36 A5_37 A5_39 A5_40""".split()


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", entries())
def test_as_few_parts_as_commuting_sets_that_cover_the_coordinates(name):
    count, algebra = 3 if name in THREE else 2, co.algebras.get(name, **EXAMPLES.get(name, {}))
    system = co.LiePoissonSystem(algebra, co.Quadratic(np.linspace(1.0, 2.0, algebra.dim)))
    parts = split(system, "auto")
    assert len(parts) <= count
    assert len(decompose(system, "auto").parts) <= len(parts)
    covered = sorted(i for part in parts for form, _ in part for i in form)
    assert covered == list(range(algebra.dim))
    for part in parts:
        chosen = [i for form, _ in part for i in form]
        assert all(algebra.commuting(i, j) for i in chosen for j in chosen)
