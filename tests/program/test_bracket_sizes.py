"""Cost estimate of a modified Hamiltonian: products of monomials, against an enumeration of the monomials."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.program.modified_energy.bracket_cost import estimated_products
from coadjoint.program.parts.split import split

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


def support(rows, row):
    return rows.coordinate[rows.start[row] : rows.start[row + 1]].tolist()


def slope(monomials, i):
    """Return the monomials of the derivative by x_i; each is the sorted tuple of its factors."""
    return {(*e[: e.index(i)], *e[e.index(i) + 1 :]) for e in monomials if i in e}


def products(first, second):
    return {tuple(sorted(a + b)) for a in first for b in second}


def enumerated(algebra, parts, highest):
    """Count the products in the brackets of each angle with the series of the later parts, up to h^2 or h^3.

    No monomials cancel, as for random coefficients. Linear terms of the series and of {p, R} are left out.
    """
    total, energy, second = 0, set(), set()
    i, j, k, _ = algebra.triples
    structure = set(zip(i.tolist(), j.tolist(), k.tolist(), strict=True))
    structure |= {(j, i, k) for i, j, k in structure}
    for p in reversed(range(len(parts))):
        own, brackets = set(), set()
        for angle in np.flatnonzero(parts.part_of_angle == p):
            form, weights = support(parts.forms, angle), support(parts.weights, angle)
            own |= {tuple(sorted((a, b))) for a in form for b in weights}
            turned = {i: {(k,) for a, j, k in structure if a == i and j in form} for i in range(algebra.dim)}
            quadratic = {i: products(linear, {(b,) for b in weights}) for i, linear in turned.items()}
            shifted = parts.offset[angle] != 0
            bracket = {e for i, component in quadratic.items() for e in products(component, slope(energy, i))}
            for series in [energy, second, bracket] if highest > 2 else [energy]:
                lengths = (len(quadratic[i]) + shifted * len(turned[i]) for i in turned)
                total += sum(length * len(slope(series, i)) for i, length in enumerate(lengths))
            brackets |= bracket
        energy |= own
        second |= brackets
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
    assert estimated_products(system.algebra, parts, 2) == enumerated(system.algebra, parts, 2)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("choice", ["auto", "coordinates"])
@pytest.mark.parametrize("driven", [False, True])
@pytest.mark.parametrize("density", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("name", ["so(3)", "sl(2)", "A3,7", "Heisenberg", "e(3)", "so(4)"])
def test_products_of_cubic_brackets_are_counted_within_a_factor_of_two(name, density, driven, choice):
    """The slope of w.x Q(x) has two terms, whose common monomials are counted twice, and half of the squares in Q are
    left out. With one coordinate per part there are neither.
    """
    system = drawn(ALGEBRAS[name], density, driven, len(name))
    parts = split(system, choice)
    counted, expected = estimated_products(system.algebra, parts, 3), enumerated(system.algebra, parts, 3)
    if density == 0.0 and choice == "coordinates":
        assert counted == expected > 0
    assert expected / 2 <= counted <= 2 * expected
    # Brackets of higher orders have more products, which are not all counted.
    assert estimated_products(system.algebra, parts, 4) == counted
