"""Modified Hamiltonians with symbols take any values of them, as the system with these values, or are refused."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from coadjoint.program.modified_energy.second_order import second_order_term
from coadjoint.program.parts.decompose import decompose

ALGEBRAS = {
    "so(3)": co.algebras.so(3),
    "sl(2)": co.algebras.sl(2),
    "A3,7": co.algebras.A3_7(1.5),
    "e(3)": co.algebras.e(3),
    "so(4)": co.algebras.so(4),
}
# Coordinates of e(3) that commute, as one part.
TOGETHER = [(0,), (1,), (2,), (3, 4, 5)]


def product(n, *coordinates):
    """Return the exponents of a product of coordinates."""
    return tuple(coordinates.count(i) for i in range(n))


def drawn(rng, n):
    """Return squares of all coordinates and some linear terms, {exponents: Fraction}."""
    squares = {product(n, i, i): Fraction(int(rng.integers(1, 9)), 6) for i in range(n)}
    return squares | {product(n, int(i)): Fraction(int(rng.integers(1, 9)), 5) for i in rng.choice(n, 2, replace=False)}


def changed(rng, monomials, names):
    """Return other coefficients of the monomials with these symbols, and the values of the symbols."""
    values = {name: Fraction(int(rng.integers(1, 9)), 7) for name in names}
    exponents = {name: e for e in monomials for name in names if name == name_of(e)}
    new = {e: values[name] / (2 if max(e) == sum(e) == 2 else 1) for name, e in exponents.items()}
    return {**monomials, **new}, values


def name_of(exponents):
    """Return the symbol of a coefficient: b1, m1 (of a square), m12, c112."""
    factors = "".join(str(i + 1) * e for i, e in enumerate(exponents))
    if len(factors) == 2:
        return "m" + (factors[0] if factors[0] == factors[1] else factors)
    return {1: "b", 3: "c"}[len(factors)] + factors


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("whole", [True, False], ids=["all", "some"])
@pytest.mark.parametrize("name", [*ALGEBRAS, "parts of several"])
def test_values_of_symbols_are_coefficients_of_the_hamiltonian(name, whole, sign):
    rng, together = np.random.default_rng([31, len(name), whole]), name == "parts of several"
    algebra = ALGEBRAS["e(3)" if together else name]
    n = algebra.dim
    monomials = drawn(rng, n)
    if together:
        monomials |= {product(n, 3, 4): Fraction(1, 3), product(n, 3, 3, 5): Fraction(2, 7)}
    method = co.Splitting(order=1 if whole else 2, parts=TOGETHER if together else "coordinates")
    names = [name_of(e) for e in monomials]
    chosen = names if whole else rng.choice(names, 3, replace=False).tolist()

    def system(terms):
        return co.LiePoissonSystem(algebra, co.Polynomial(terms), sign=sign)

    found = co.modified_hamiltonian(system(monomials), method, 3, symbols=True if whole else chosen)
    assert set(found.values) == set(chosen)
    assert found.with_values().terms == co.modified_hamiltonian(system(monomials), method, 3).terms
    other, values = changed(rng, monomials, chosen)
    assert found.with_values(values).terms == co.modified_hamiltonian(system(other), method, 3).terms


@pytest.mark.parametrize("square", [True, False], ids=["one square", "two squares"])
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", list(ALGEBRAS))
def test_symbols_of_coupled_coordinates_are_refused(name, seed, square):
    """a x1^2 + b x1 x2 + c x2^2 is a (x1 + b x2/2a)^2 + (c - b^2/4a) x2^2: each part depends on several coefficients.

    Also if it is (x1 + x2)^2/2, whose form has the coefficients 1 and whose piece those of H.
    """
    rng, algebra = np.random.default_rng([32, seed]), ALGEBRAS[name]
    n = algebra.dim
    constants = algebra.structure_matrix(rng.uniform(1.0, 2.0, n))
    pairs = [(i, j) for i in range(n) for j in range(i) if constants[i, j]]
    j, i = sorted(pairs[rng.integers(len(pairs))])
    half = Fraction(1, 2)
    coupling = {(i, i): half, (i, j): Fraction(1), (j, j): half} if square else {(i, j): Fraction(1, 10)}
    monomials = drawn(rng, n) | {product(n, *factors): value for factors, value in coupling.items()}
    system = co.LiePoissonSystem(algebra, co.Polynomial(monomials), sign=(1, -1)[seed % 2])
    method = co.Splitting(parts="coordinates")
    assert 2 in co.modified_hamiltonian(system, method, 3).terms
    three = [name_of(product(n, *factors)) for factors in ((i, i), (i, j), (j, j))]
    for symbols in (True, three, *([one] for one in three)):
        with pytest.raises(ValueError, match=r"symbols .* completed squares"):
            co.modified_hamiltonian(system, method, 3, symbols=symbols)


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


def drawn_fractions(rng, names):
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
    own = drawn_fractions(rng, names)
    system, (first, _, third) = system_of(algebra, names, own, sign), names
    for wanted in (list(names), [first, third]):
        symbolic = co.modified_hamiltonian(system, scheme, order, symbols=wanted)
        new = {key: own[key] + 1 + abs(value) for key, value in drawn_fractions(rng, wanted).items()}
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
