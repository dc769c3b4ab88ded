"""Coefficients of Hamiltonians as arrays, and their derivatives by many entries at once."""

from types import SimpleNamespace

import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.polynomials.monomials import factors_of
from coadjoint.systems.coefficient_derivatives import derivatives_by_entries
from coadjoint.systems.coefficients import Coefficients, Monomials, coefficients_of, decoded, encoded
from coadjoint.systems.hamiltonians.terms import PolynomialTerm


def sums_of(*energies):
    """Return the sums of coefficients of polynomials by key, each added in its order."""
    found = {(): 0.0}
    for energy in energies:
        for exponents, value in energy.monomials.items():
            key = tuple(factors_of(exponents))
            found[key] = found.get(key, 0.0) + value
    return found


def test_coefficients_are_summed_in_the_order_of_the_terms():
    """Sums of these numbers depend on their order."""
    n, rng = 6, np.random.default_rng(1)
    powers = [
        *np.eye(n, dtype=int),
        *(np.eye(n, dtype=int)[i] + np.eye(n, dtype=int)[j] for i in range(n) for j in range(i, n)),
        [1, 1, 1, 0, 0, 0],
        [0, 0, 0, 0, 3, 0],
        [2, 0, 0, 0, 0, 2],
    ]
    energies = [
        co.Polynomial({tuple(map(int, e)): rng.standard_normal() * 10.0**size for e in powers}) for size in (0, 8, -3)
    ]
    energies[1] = co.Polynomial({e: c for e, c in energies[1].monomials.items() if sum(e) <= 2})
    (quadratic,) = co.Quadratic.from_polynomial(energies[1]).terms()
    terms = [PolynomialTerm(energies[0]), quadratic, PolynomialTerm(energies[2])]
    found = coefficients_of(SimpleNamespace(hamiltonian=SimpleNamespace(terms=lambda: terms)))
    assert found.by_key() == sums_of(*energies)
    assert found.monomials.keys == sorted(found.by_key(), key=lambda key: (len(key), key))


def test_coefficients_of_a_quadratic_are_half_its_squares_and_its_products():
    M = np.array([[1.0, 2.0, 0.0], [2.0, 3.0, 4.0], [0.0, 4.0, 0.0]])
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M, linear=[0.0, 5.0, 0.0], constant=6.0))
    expected = {(): 6.0, (1,): 5.0, (0, 0): 0.5, (0, 1): 2.0, (1, 1): 1.5, (1, 2): 4.0}
    assert coefficients_of(system).by_key() == expected


def test_codes_sort_monomials_by_degree_and_coordinates():
    last = 2**31 - 2
    pairs = np.array([(-1, -1), (-1, 0), (-1, last), (0, 0), (0, last), (1, 1), (last, last)])
    codes = encoded(*pairs.T)
    assert np.all(np.diff(codes) > 0) and np.array_equal(np.stack(decoded(codes), axis=1), pairs)


def of(codes, values, others=None):
    return Coefficients.summed(np.asarray(codes, dtype=np.int64), np.asarray(values, dtype=float), others or {})


def test_changes_and_missing_monomials_are_zero():
    first, second = of([1, 2, 5], [1.0, 2.0, 3.0], {(0, 0, 0): 1.0}), of([2, 3], [2.0, 4.0], {(0, 1, 2): 7.0})
    changed = second.changed_from(first)
    assert changed.by_key() == {(0,): 0.0, (2,): 4.0, (4,): 0.0, (0, 0, 0): 0.0, (0, 1, 2): 7.0}
    every = Monomials.joined([first.monomials, second.monomials])
    assert first.at(every).tolist() == [1.0, 2.0, 0.0, 3.0, 1.0, 0.0]
    assert first.equal(of([5, 2, 1], [3.0, 2.0, 1.0], {(0, 0, 0): 1.0})) and not first.equal(second)


@pytest.mark.parametrize("count", [2, 5, 16, 17, 1000])
def test_entries_of_their_own_take_a_logarithm_of_calls(count):
    """With four blocks for each digit of the number of an entry, at most, and five nodes."""
    calls = []
    value = np.linspace(1.0, 2.0, count)

    def squares(shifts):
        calls.append(shifts)
        return of(np.arange(1, count + 1), (value + shifts) ** 2, {(0, 0, 0): 1.0})

    energy, radii = derivatives_by_entries(squares, value)
    digits = int(np.ceil(np.log(count) / np.log(4) - 1e-9))
    assert len(calls) <= 5 + 4 * digits
    assert energy.linear.tolist() == energy.linear_entry.tolist() == list(range(count))
    np.testing.assert_allclose(energy.linear_factor, 2.0 * value, rtol=2.0**-45)
    assert np.array_equal(radii, 0.25 * value) and energy.others == ()


@pytest.mark.parametrize("pair", [(0, 1), (0, 16), (3, 19), (5, 18)])
def test_a_coefficient_of_two_entries_is_differentiated_by_both(pair):
    """Also if the numbers of both entries share digits."""
    value = np.linspace(1.0, 2.0, 20)

    def shared(shifts):
        entries = value + shifts
        return of(np.arange(1, 22), [*entries, entries[list(pair)].sum()])

    energy, _ = derivatives_by_entries(shared, value)
    at_shared = energy.linear == 20
    assert energy.linear_entry[at_shared].tolist() == list(pair)
    np.testing.assert_allclose(energy.linear_factor, 1.0, rtol=2.0**-40)
    assert len(energy.linear) == 22
