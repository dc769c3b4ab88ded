"""Modified Hamiltonians that are too large are refused before they are made."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(1)


def whole(name, sign=1):
    """A system with a full M of eighths."""
    algebra, rng = co.algebras.get(name), np.random.default_rng(3)
    B = rng.integers(-2, 3, (algebra.dim, algebra.dim)) / 8
    return co.LiePoissonSystem(algebra, co.Quadratic(np.diag(1 + np.arange(algebra.dim) / 4) + B + B.T), sign=sign)


def test_what_is_too_large_is_refused_before_it_is_made(monkeypatch):
    system = whole("so(4)")
    monkeypatch.setattr("coadjoint.program.logarithms.MAX_PRODUCTS", 10**5)
    assert co.modified_hamiltonian(system, co.Splitting(parts="coordinates"), 4).terms[2].monomials
    with refused(ValueError, "products of monomials or more,", "at most 1e+05"):
        co.modified_hamiltonian(system, co.Splitting(parts="coordinates"), 8)
