"""Numbers for the symbols of a modified Hamiltonian, against the system that has them, without symbols."""

from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from coadjoint.program.modified_energy.second_order import second_order_term
from coadjoint.program.parts.decompose import decompose

# Exponents and the factor of each symbol; of a square the symbol is twice its coefficient.
SYSTEMS = {
    "so(3)": (co.algebras.so(3), {"m1": ((2, 0, 0), 2), "m2": ((0, 2, 0), 2), "b3": ((0, 0, 1), 1)}),
    "A3,7": (co.algebras.A3_7(1.5), {"m1": ((2, 0, 0), 2), "m3": ((0, 0, 2), 2), "c222": ((0, 3, 0), 1)}),
    "A3,8": (co.algebras.get("A3,8"), {"m2": ((0, 2, 0), 2), "m3": ((0, 0, 2), 2), "b1": ((1, 0, 0), 1)}),
    "e(3)": (
        co.algebras.e(3),
        {"m1": ((2, 0, 0, 0, 0, 0), 2), "c455": ((0, 0, 0, 1, 2, 0), 1), "b6": ((0, 0, 0, 0, 0, 1), 1)},
    ),
}
METHODS = {
    "strang": (co.Splitting(parts="coordinates"), 4),
    "first order": (co.Splitting(order=1, parts="coordinates"), 3),
    "rounded coefficients": (co.Splitting(scheme="blanes_moan4", parts="coordinates"), 5),
}


def system_of(algebra, names, values, sign):
    """Return the system whose coefficients are those that the values stand for."""
    H = co.Polynomial({names[name][0]: Fraction(value) / names[name][1] for name, value in values.items()})
    return co.LiePoissonSystem(algebra, H, sign=sign)


def drawn(rng, names):
    """Return small fractions of either sign."""
    return {name: Fraction(int(rng.choice([-5, -3, -1, 1, 2, 4])), int(rng.choice([1, 2, 3, 8]))) for name in names}


@pytest.mark.thinned(10)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_given_numbers_replace_those_of_the_system_and_no_others(name, method, sign):
    """For none, one and several of the symbols, where all or some coefficients are symbols."""
    (algebra, names), (scheme, order) = SYSTEMS[name], METHODS[method]
    rng = np.random.default_rng(len(name) + sign)
    own = drawn(rng, names)
    system, (first, _, third) = system_of(algebra, names, own, sign), names
    for wanted in (list(names), [first, third]):
        symbolic = co.modified_hamiltonian(system, scheme, order, symbols=wanted)
        new = {key: own[key] + 1 + abs(value) for key, value in drawn(rng, wanted).items()}
        for given in ({}, {third: 0}, {third: new[third]}, {first: float(new[first]), third: -2}):
            found, other = symbolic.with_values(given), system_of(algebra, names, {**own, **given}, sign)
            plain, x = co.modified_hamiltonian(other, scheme, order), rng.uniform(-1.0, 1.0, (4, algebra.dim))
            assert (found.order, found.radius, found.neglected) == (order, symbolic.radius, symbolic.neglected)
            assert not found.values and dict(symbolic.values) == {key: own[key] for key in wanted}
            for h in (0.25, -0.5):
                # A few hundred monomials of a few factors each, all below 2^10, are each rounded.
                assert found(x, h) == pytest.approx(plain(x, h), rel=2.0**-40, abs=2.0**-40)
            if method == "strang":
                H2 = second_order_term(algebra, decompose(other, "coordinates").parts, x)
                assert found.terms[2](x) == pytest.approx(H2, rel=2.0**-40, abs=2.0**-40)
