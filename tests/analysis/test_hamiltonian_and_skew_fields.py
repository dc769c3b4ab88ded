"""Polynomial fields alone: Hamiltonians, skew factors, and those that have none."""

from __future__ import annotations

from itertools import permutations

import pytest

import coadjoint as co
from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials
from coadjoint.analysis.backward_error.polynomial_fields import bracket_change, hamiltonian_of, skew_factor


def heisenberg():
    ring = ExactPolynomials(co.algebras.get("A3,1"))
    x1, x2, x3 = ring.coordinates
    J = [[ring.bracket(a, b) for b in ring.coordinates] for a in ring.coordinates]
    return ring, J, (x1, x2, x3)


def test_a_derivation_is_poisson_without_a_hamiltonian() -> None:
    ring, J, (x1, x2, x3) = heisenberg()
    scaling = [2 * x1, x2, x3]  # [e2, e3] = e1 scales with it, and so does the Casimir x1
    assert bracket_change(ring, J, scaling) == 0.0
    assert hamiltonian_of(ring, J, scaling) is None
    assert bracket_change(ring, J, [x1, x2, x3]) == 1.0
    turned = [0 * x1, x3, x2]
    assert bracket_change(ring, J, turned) == 0.0 and hamiltonian_of(ring, J, turned) is None


def test_a_hamiltonian_of_several_degrees_is_found() -> None:
    ring, J, (x1, x2, x3) = heisenberg()
    H = x2**3 + x2 * x3 + x3 + x1 * x2
    found = hamiltonian_of(ring, J, ring.field(H))
    assert ring.field(found) == ring.field(H)
    with pytest.raises(ValueError, match="have the degrees"):
        hamiltonian_of(ring, [[0 * x1, x1, x2 * x2], [-x1, 0 * x1, x1], [-x2 * x2, -x1, 0 * x1]], ring.field(H))


def test_skew_factors_are_refused_where_there_are_none() -> None:
    ring = ExactPolynomials(co.algebras.so(3))
    x1, x2, x3 = ring.coordinates
    energy = (x1**2 + x2**2) / 2
    with pytest.raises(ValueError, match="does not vanish where grad H does"):
        skew_factor(ring, energy, [0 * x1, 0 * x1, 1 + 0 * x1])
    with pytest.raises(ValueError, match="does not keep the energy"):
        skew_factor(ring, energy, [x1, x2, 0 * x1])
    with pytest.raises(ValueError, match="not quadratic"):
        skew_factor(ring, x1**3, [0 * x1, x1, 0 * x1])
    K = skew_factor(ring, energy, [x2 * x3, -x1 * x3, x1 * x2])
    slope = ring.gradient(energy)
    assert [sum((a * b for a, b in zip(row, slope, strict=True)), ring.zero) for row in K] == [
        x2 * x3,
        -x1 * x3,
        x1 * x2,
    ]


@pytest.mark.parametrize("rates", [*permutations((1, 1, 0)), *permutations((1, 2, 8))])
def test_the_change_of_the_bracket_is_the_largest_of_all_entries(rates) -> None:
    """A field (a x1, b x2, c x3) changes the entry x3 of the bracket of so(3) by (c - a - b) x3, and so on."""
    ring = ExactPolynomials(co.algebras.so(3))
    J = [[ring.bracket(a, b) for b in ring.coordinates] for a in ring.coordinates]
    field = [rate * x for rate, x in zip(rates, ring.coordinates, strict=True)]
    total = sum(rates)
    assert bracket_change(ring, J, field) == max(abs(2 * rate - total) for rate in rates)
