"""Couplings of different components of spins: few parts of commuting products, where squares would fill up."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from coadjoint.program.commutation import Commutation
from coadjoint.program.parts import quadratic_atoms
from coadjoint.program.parts.few_parts import first_fit
from coadjoint.program.parts.part import Parts
from coadjoint.program.parts.split import split
from coadjoint.program.parts.squares import MAX_RATIONAL_SIZE
from coadjoint.program.sparse_rows import SparseRows


def ring(copies, algebra, seed):
    """Random couplings of neighbours in a ring of copies of an algebra, of all components and within each copy."""
    rng, n = np.random.default_rng(seed), algebra.dim
    M = np.zeros((copies * n, copies * n))
    for k in range(copies):
        here, there = slice(n * k, n * k + n), slice(n * ((k + 1) % copies), n * ((k + 1) % copies) + n)
        M[here, here] = rng.standard_normal((n, n))
        M[here, there] += rng.standard_normal((n, n)) * (rng.random((n, n)) < 3 / n)
    energy = co.Quadratic(M + M.T, linear=rng.standard_normal(copies * n), constant=2.0)
    return co.LiePoissonSystem(co.algebras.copies(algebra, copies), energy, sign=-1)


SYSTEMS = {
    "square, vector in the plane": lambda: co.systems.spin_lattice("square", (4, 4), periodic=True, dm=(0, 0, 0.3)),
    "square, all terms": lambda: co.systems.spin_lattice(
        "square", (3, 4), dm=(0.1, 0.2, 0.3), field=(0.1, 0.2, 0.3), on_site=(0.1, -0.2, 0.4)
    ),
    "odd ring": lambda: co.systems.spin_lattice("chain", 9, periodic=True, dm=(0.1, 0.2, 0.3)),
    "so(3)": lambda: ring(7, co.algebras.so(3), 1),
    "sl(2)": lambda: ring(6, co.algebras.sl(2), 2),
    "e(3)": lambda: ring(4, co.algebras.e(3), 3),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_parts_commute_and_add_up_to_the_energy(name):
    system, rng = SYSTEMS[name](), np.random.default_rng(4)
    parts, x = split(system), rng.standard_normal(SYSTEMS[name]().dim)
    rates = parts.offset.copy()
    np.add.at(rates, parts.weights.owner, parts.weights.value * x[parts.weights.coordinate])
    gradient = np.zeros(system.dim)
    np.add.at(gradient, parts.forms.coordinate, parts.forms.value * rates[parts.forms.owner])
    scale = np.abs(system.hamiltonian.gradient(x)).max()
    np.testing.assert_allclose(gradient, system.hamiltonian.gradient(x), rtol=0, atol=1e-13 * scale)
    structure = system.structure_matrix(x)
    for first, last in zip(parts.angle[:-1], parts.angle[1:], strict=True):
        forms = np.zeros((last - first, system.dim))
        entries = slice(parts.forms.start[first], parts.forms.start[last])
        forms[parts.forms.owner[entries] - first, parts.forms.coordinate[entries]] = parts.forms.value[entries]
        assert np.abs(forms @ structure @ forms.T).max() < 1e-12 * scale


@pytest.mark.parametrize("name", SYSTEMS)
def test_steps_converge_to_the_motion(name):
    system = SYSTEMS[name]()
    x = np.random.default_rng(5).standard_normal(system.dim)
    end = 0.4 / np.linalg.norm(system.vector_field(x)) * np.linalg.norm(x)
    given = {"rtol": 1e-12, "atol": 1e-13, "method": "DOP853"}
    expected = solve_ivp(lambda _, y: system.vector_field(y), (0, end), x, **given).y[:, -1]
    coarse, fine = (
        np.linalg.norm(co.integrate(system, x, (0, end), end / k, co.Splitting(order=2), watch=False).x[-1] - expected)
        for k in (16, 32)
    )
    assert 3.8 < coarse / fine < 4.2


def test_number_of_parts_does_not_grow_with_the_lattice():
    """Three parts of equal components, and two of different ones, in which the sites of each sublattice are alike."""
    for side in (4, 6, 10):
        lattice = co.systems.spin_lattice("square", (side, side), periodic=True, dm=(0, 0, 0.3))
        assert len(co.Splitting(order=2).program(lattice).parts) == 5


def test_small_systems_have_squares():
    most = MAX_RATIONAL_SIZE // 3
    few, many = (split(ring(copies, co.algebras.so(3), 6)) for copies in (most, most + 1))
    per_angle = [np.diff(parts.forms.start) for parts in (few, many)]
    assert per_angle[0].max() > 3 >= per_angle[1].max(), "only coordinates of one site are in one square"


def test_colors_are_the_groups_of_first_fit():
    """Products conflict if some coordinate of one does not commute with one of the other."""
    rng = np.random.default_rng(7)
    for cell in (co.algebras.so(3), co.algebras.e(3), co.algebras.sl(2)):
        algebra = co.algebras.copies(cell, 20)
        commutation = Commutation(algebra)
        i, j = rng.integers(0, algebra.dim, (2, 150))
        apart = i // cell.dim != j // cell.dim
        i, j = i[apart], j[apart]
        units = SparseRows.units(np.stack([i, j], axis=1).ravel())
        count = 2 * len(i)
        pairs = Parts.linear(units, np.zeros(count), SparseRows.empty(count), 2 * np.arange(len(i) + 1))
        first, second = commutation.coupled_pairs(pairs)
        distinct = first != second
        expected = first_fit(len(i), first[distinct], second[distinct])
        np.testing.assert_array_equal(quadratic_atoms._colors(i, j, commutation), expected)
