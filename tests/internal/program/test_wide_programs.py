"""Splittings of many coupled coordinates: quick decisions are those of the plain ones, and costs are known before."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials
from coadjoint.long_operations import LongWait
from coadjoint.program import blocks, commutation, logarithms, modified_series
from coadjoint.program.added_part import Places
from coadjoint.program.generators import NotSplittable, check_products
from coadjoint.program.logarithms import Commutators
from coadjoint.program.modified_series import estimated_products
from coadjoint.program.parts import decompose
from coadjoint.program.parts.split import quadratic_atoms, split
from coadjoint.systems.energy_derivatives import EnergyDerivative
from coadjoint.systems.parameters import parameters_of
from refusals import refused

ALGEBRAS = {
    "so(6)": co.algebras.so(6),
    "su(4)": co.algebras.su(4),
    "sp": co.algebras.get("sp(4)"),
    "sl(4)": co.algebras.sl(4),
    "e(4)": co.algebras.e(4),
    "Heisenberg": co.algebras.heisenberg(6),
    "a sum": co.algebras.direct_sum(co.algebras.so(4), co.algebras.sl(3)),
}


def symmetric(rng, n, density):
    M = rng.normal(size=(n, n)) * (rng.random((n, n)) < density)
    return M + M.T + np.diag(rng.normal(size=n))


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", ALGEBRAS)
@pytest.mark.parametrize("density", [0.05, 0.3, 1.0])
def test_clashes_are_those_of_all_products(name, density, monkeypatch):
    algebra = ALGEBRAS[name]
    rng = np.random.default_rng(len(name))
    (term,) = co.LiePoissonSystem(algebra, co.Quadratic(symmetric(rng, algebra.dim, density))).hamiltonian.terms()
    parts = quadratic_atoms(term, algebra, separate=True)
    monkeypatch.setattr(commutation, "CHUNK", 0)  # every sum is a long one
    quick = commutation._find_coupled_pairs(algebra, parts)
    found = commutation.noncommuting_pairs(algebra, parts, quick)
    monkeypatch.setattr(commutation, "MAX_TABLE_SIZE", 0)
    plain = commutation._find_coupled_pairs(algebra, parts)
    for one, other in ((quick, plain), (found, commutation.noncommuting_pairs(algebra, parts, plain))):
        np.testing.assert_array_equal(one, other)


def test_forms_that_commute_are_never_said_to_clash():
    """Multiples of one form commute, to rounding; forms beside them in a Cartan subalgebra exactly."""
    algebra, rng = co.algebras.su(5), np.random.default_rng(3)
    form = rng.normal(size=algebra.dim)
    forms = np.array([form, 3.7 * form, form / 7, rng.normal(size=algebra.dim)])
    first, second = np.triu_indices(4, 1)
    said = commutation.surely_noncommuting(forms, algebra, first, second, np.full(6, 10**9))
    np.testing.assert_array_equal(said, second == 3)


@pytest.mark.parametrize("seed", range(6))
def test_kinds_of_blocks_are_those_of_whole_products(seed, monkeypatch):
    rng, n = np.random.default_rng(seed), 9
    full = rng.normal(size=(n, n))
    u, v = rng.normal(size=(2, n))
    matrices = {
        "full": full,
        "sparse": full * (rng.random((n, n)) < 0.3) + np.roll(np.eye(n), 1, axis=1),
        "D^2 = 0": np.outer(u, v - (u @ v) / (u @ u) * u),
        "D^3 = lam D": np.outer(u, v) - np.outer(v, u),
        "D^2 = lam D": np.outer(u, v),
    }
    for matrix in matrices.values():
        local = tuple((i, j, matrix[i, j]) for i, j in np.argwhere(matrix != 0).tolist())
        monkeypatch.setattr(blocks, "MAX_SQUARED_SIZE", 1000)
        plain = blocks.larger_block(n, local, 2.0**-53)
        monkeypatch.setattr(blocks, "MAX_SQUARED_SIZE", 2)
        assert blocks.larger_block(n, local, 2.0**-53) == plain


def test_shifts_take_no_more_than_a_bounded_work(monkeypatch):
    algebra = co.algebras.so(8)
    M = symmetric(np.random.default_rng(5), algebra.dim, 1.0)
    system = co.LiePoissonSystem(algebra, co.Quadratic(M))
    calls = []
    monkeypatch.setattr(decompose, "split", lambda *given, split=decompose.split: (calls.append(1), split(*given))[1])
    decompose.candidates(system, comparing=False)
    every = len(calls)
    work = decompose._shift_work(system, decompose.split(system))
    calls.clear()
    monkeypatch.setattr(decompose, "MIN_SHIFTS", 3)
    monkeypatch.setattr(decompose, "MAX_WORK", 5 * work)
    decompose.candidates(system, comparing=False)
    assert len(calls) == 6 < every


def test_lattices_are_not_too_wide():
    check_products(np.full(10**7, 30), "a lattice")
    with pytest.raises(NotSplittable, match=r"H has 1000 flows of 60000 products each: .* about 120 s and 9.0 GB"):
        check_products(np.full(1000, 60_000), "H")
    with pytest.warns(LongWait, match="preparing a splitting of H takes about 32 s; GaussLegendre"):
        check_products(np.full(270, 60_000), "H")


@pytest.mark.long
def test_brackets_that_are_too_many_are_refused_ahead(monkeypatch):
    """Before most of them are made, on su(6) of 35 coordinates, also where their number was not foreseen."""
    monkeypatch.setattr(modified_series, "estimated_products", lambda *given: 0.0)

    g = co.algebras.su(6)
    system = co.LiePoissonSystem(g, co.Quadratic(symmetric(np.random.default_rng(1), g.dim, 1.0)))
    made = []
    plain = logarithms.Commutators.count_products
    monkeypatch.setattr(
        logarithms.Commutators,
        "count_products",
        lambda self, count: (made.append(count), plain(self, count))[1],
    )
    monkeypatch.setattr(logarithms, "MAX_PRODUCTS", 10**6)
    monkeypatch.setattr(logarithms, "WARN_PRODUCTS", 10**4)
    with refused(ValueError, "modified Hamiltonian"):
        co.modified_hamiltonian(system, co.Splitting(order=2), order=4)
    assert sum(made) < 5 * 10**5


ALGEBRAS_BRACKET = {
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


pytest.importorskip("flint")


@pytest.mark.parametrize("name", ["so(3)", "so(4)", "su(3)", "A3,2", "so(6)"])
@pytest.mark.parametrize("sign", [1, -1])
def test_bracket_is_that_of_the_ring(name, sign):
    rng, g = np.random.default_rng(4), co.algebras.get(name)
    ring = ExactPolynomials(g)
    drawn = []
    for degree in (2, 3):
        total = ring.zero
        for _ in range(8):
            exponents = np.bincount(rng.integers(0, g.dim, degree), minlength=g.dim).tolist()
            total += ring.monomial(exponents) * int(rng.integers(1, 9))
        drawn.append(total)
    F, G = drawn
    found = Commutators(ring, sign)(F, G)
    assert found == sign * ring.bracket(G, F)
    assert found != 0
    assert Commutators(ring, sign)(F, ring.zero) == 0


SQUARE = {"lattice": "square", "shape": (4, 4), "periodic": True}
SYSTEMS = {
    "lattice": co.systems.spin_lattice(**SQUARE, tensor=(1.0, 1.0, 0.5), field=(0.0, 0.1, 0.2)),
    "bonds": co.systems.spin_lattice(**SQUARE, exchange=np.linspace(1.0, 2.0, 32), on_site=(0.0, 0.0, 0.5)),
    # A Casimir is subtracted.
    "rigid body": co.systems.rigid_body((1.0, 2.0, 3.0)),
    "heavy top": co.systems.heavy_top((1.0, 2.0, 2.5), lever=(0.1, 0.2, 0.3)),
    "polynomial": co.LiePoissonSystem(
        co.algebras.so(3), co.Polynomial({(2, 0, 0): 1.0, (1, 0, 0): 0.5, (3, 0, 0): 0.25, (0, 1, 0): 2.0})
    ),
}


def triplets(found):
    return sorted(zip(*(column.tolist() for column in found), strict=True))


@pytest.mark.parametrize("name", SYSTEMS)
def test_monomials_are_found_at_once_as_each_alone(name):
    system, compared = SYSTEMS[name], 0
    for parts in ("auto", "coordinates"):
        places = Places(co.Splitting(order=2, parts=parts).program(system))
        for parameter in parameters_of(system).values():
            G = parameter.energy()
            alone = [places.of(EnergyDerivative.of_monomials(G.size, [one])) for one in G.as_monomials]
            *found, missing = places.of(G)
            assert sorted(missing) == sorted(entry for *_, own in alone for entry in own)
            for kind, of_all in enumerate(found):
                assert triplets(of_all) == sorted(triplet for one in alone for triplet in triplets(one[kind]))
                compared += len(of_all.number)
    assert compared


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
@pytest.mark.parametrize("name", ALGEBRAS_BRACKET)
def test_products_of_the_lowest_brackets_are_counted_exactly(name, density, driven, choice):
    """A product x_k x_l of the two factors of a field is one monomial, in whichever factor x_k is."""
    system = drawn(ALGEBRAS_BRACKET[name], density, driven, len(name))
    parts = split(system, choice)
    assert estimated_products(system.algebra, parts, 2) == enumerated(system.algebra, parts)
