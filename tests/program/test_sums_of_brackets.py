"""Brackets of exact polynomials, summed in pairs, against the Lie-Poisson bracket of all components."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials
from coadjoint.program.modified_energy.sweep_logarithm import Commutators

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
