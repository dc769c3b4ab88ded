"""Modified Hamiltonians against printed formulas, matrix logarithms, exact motions, and what runs keep."""

from __future__ import annotations

import pickle
from fractions import Fraction
from itertools import pairwise

import mpmath
import numpy as np
import pytest

import coadjoint as co
from drawn_matrices import full
from moments import moments

pytestmark = pytest.mark.thinned(3)

C1 = 1 / (2 - 2 ** (1 / 3))
JUMP = (C1, 1 - 2 * C1, C1)
SIX = [1.0, 0.5, -0.4, 0.7, -1.0, 0.3]


def system_of(name, H, sign=1):
    """Return the system of coefficients, or of a matrix or diagonal, on an algebra with a name."""
    algebra = moments() if name == "moments" else co.algebras.A3_7(1.5) if name == "A3,7" else co.algebras.get(name)
    return co.LiePoissonSystem(algebra, co.Polynomial(H) if isinstance(H, dict) else co.Quadratic(H), sign=sign)


BENT = {(2, 0, 0, 0, 0, 0): 0.5, (0, 2, 0, 0, 0, 0): 0.25, (0, 0, 2, 0, 0, 0): 0.2, (0, 0, 0, 0, 3, 0): 0.3}
# <pp>/2 and a potential that is quadratic in the moments of q.
PLASMA = {(0, 0, 1, 0, 0, 0, 0, 0): 0.5, (2, 0, 0, 0, 0, 0, 0, 0): 0.4, (1, 0, 0, 1, 0, 0, 0, 0): 0.3}
TILTED = {(2, 0, 0): 0.5, (0, 2, 0): 0.25, (0, 0, 2): 0.125, (1, 0, 0): 0.2, (0, 0, 1): -0.3}
SYSTEMS = {
    "so(3)": (system_of("so(3)", TILTED), [1.0, 2.0, 0.5]),
    "so(3), full, body": (system_of("so(3)", full(3, 1), -1), [1.0, -1.5, 1.2]),
    "A3,7, body": (system_of("A3,7", [1.0, 1.5, 0.3], -1), [0.7, 0.5, 0.6]),
    "e(3), cubic": (system_of("e(3)", BENT), SIX),
    "so(4)": (system_of("so(4)", [2.0, 0.4, 0.7, 0.3, 0.5, 1.0], -1), SIX),
    "so(4), full": (system_of("so(4)", full(6, 3)), SIX),
    "moments": (system_of("moments", PLASMA), [1.0, 0.3, 0.8, 1.2, 0.1, 0.4, -0.2, 0.9]),
}


def exact(x):
    return np.array([mpmath.mpf(float(value)) for value in x], dtype=object)


@pytest.fixture(autouse=True)
def digits():
    with mpmath.workdps(50):
        yield


def slope_of(defects):
    return float(mpmath.log(defects[0] / defects[1], 2))


def changes_in_a_step(kept, scheme, system, x0):
    """Return how much a step of 2^-7, and one of 2^-8, change a modified Hamiltonian."""
    x, steps = exact(x0), [mpmath.mpf(2) ** -k for k in (7, 8)]
    return [abs(kept(scheme.step(system, x, mpmath.mpf(0), h), h) - kept(x, h)) for h in steps]


def test_the_printed_formula_of_so3_to_the_letter():
    """24 H2 of the splitting by coordinates, in symbols."""
    for sign in (1, -1):
        body = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]), sign=sign)
        found = co.modified_hamiltonian(body, co.Splitting(parts="coordinates"), order=4, symbols=True)
        p = {(2, 1, 0): 1, (2, 0, 1): -1, (1, 2, 0): -2, (1, 1, 1): 2, (0, 2, 1): -1}
        q = {(2, 1, 0): -1, (2, 0, 1): 1, (1, 1, 1): 2, (1, 0, 2): -2, (0, 1, 2): 2}
        r = {(1, 2, 0): 2, (1, 1, 1): -4, (1, 0, 2): 2, (0, 2, 1): 1, (0, 1, 2): -2}
        expected = {
            x: co.Polynomial({e: Fraction(c, 24) for e, c in terms.items()})
            for x, terms in {(2, 2, 0): p, (2, 0, 2): q, (0, 2, 2): r}.items()
        }
        assert dict(found.terms[2].coefficients) == expected
        assert set(found.terms) == {0, 2}
        assert repr(found.terms[0]) == "(1/2)*m1*x1^2 + (1/2)*m2*x2^2 + (1/2)*m3*x3^2"


@pytest.mark.thinned(8)
@pytest.mark.parametrize(
    ("algebra", "sign"), [(co.algebras.so(3), -1), (co.algebras.e(3), 1), (co.algebras.A3_7(1.5), -1)], ids=str
)
@pytest.mark.parametrize(
    "method",
    [
        co.Splitting(order=1),
        co.Splitting(order=1, adjoint=True, parts="coordinates"),
        co.Splitting(parts="coordinates"),
        co.Splitting(scheme="suzuki4"),
        co.Splitting(scheme="blanes_moan4", parts="coordinates"),
        co.Splitting(scheme="blanes_casas_murua6"),
    ],
    ids=str,
)
def test_logarithm_of_matrices(algebra, method, sign):
    """A linear H flows by matrices; the logarithm of a step is that of H~, which is linear as well."""
    b, sizes = np.random.default_rng(3).integers(-4, 5, algebra.dim) / 4, []
    system = co.LiePoissonSystem(algebra, co.Quadratic(0.0, linear=b), sign=sign)
    for k in (5, 6):
        h = mpmath.mpf(2) ** -k
        columns = [method.step(system, exact(row), mpmath.mpf(0), h) for row in np.eye(algebra.dim)]
        step = mpmath.matrix([list(row) for row in np.array(columns, dtype=object).T])
        # log(1 + e) by its series: e is of the size of h.
        e, power, log = step - mpmath.eye(algebra.dim), mpmath.eye(algebra.dim), mpmath.zeros(algebra.dim)
        for j in range(1, 41):
            power = power * e
            log += power * (mpmath.mpf((-1) ** (j + 1)) / j)
        kept = co.modified_hamiltonian(system, method, order=9)
        assert all(term.degree <= 1 for term in kept.terms.values())
        u = kept.gradient(exact(np.ones(algebra.dim)), h)
        field = mpmath.zeros(algebra.dim)
        for row, value in zip(np.eye(algebra.dim), u, strict=True):
            field += sign * value * mpmath.matrix(algebra.coadjoint(row).tolist())
        sizes.append(mpmath.norm(log / h - field))
    # The error is O(h^9); where all of the series is there, only the rounding of coefficients is left.
    assert sizes[1] < 1e-17 or 8.6 < slope_of(sizes) < 12.5
    assert sizes[1] < 1e-9


@pytest.mark.thinned(4)
@pytest.mark.parametrize("name", ["so(3)", "e(3), cubic", "A3,7, body", "moments"])
def test_order_eight_in_many_digits(name):
    system, x0 = SYSTEMS[name]
    for scheme in (co.Splitting(), co.Splitting(order=4)):
        defects = changes_in_a_step(co.modified_hamiltonian(system, scheme, 8), scheme, system, x0)
        assert slope_of(defects) > 8.4 and defects[0] > 1e-25, defects


@pytest.mark.thinned(12)
@pytest.mark.parametrize("order", [1, 2, 4, "blanes_moan4", "processed", "composition"])
@pytest.mark.parametrize("sign", [1, -1])
def test_rational_rotations(order, sign):
    H = {(4, 0, 0): 0.25, (2, 0, 0): 0.5, (0, 2, 0): 0.75, (0, 0, 3): 0.5, (0, 1, 0): 0.5}
    system = co.LiePoissonSystem(co.algebras.so(3), co.Polynomial(H), sign=sign)
    options = {"parts": "coordinates", "rotation": "rational"}
    if order == "composition":
        scheme = co.Composition(co.Splitting(**options), JUMP)
    elif isinstance(order, str):
        scheme = co.Splitting(scheme={"processed": "blanes_casas_murua6"}.get(order, order), **options)
    else:
        scheme = co.Splitting(order=order, **options)
    assert 2 in co.modified_hamiltonian(system, co.Splitting(**options), 4).terms
    for r in (4, 6, 8):
        kept = co.modified_hamiltonian(system, scheme, r)
        defects = changes_in_a_step(kept, scheme, system, [0.3, 0.4, -0.6])
        # Of a composition by floats the order conditions hold up to rounding.
        floor = 10 * kept.neglected * 2.0**-24
        assert defects[1] < floor or slope_of(defects) > max(r, scheme.order) + 0.4, (r, slope_of(defects))


def test_first_order_and_its_adjoint():
    """Odd terms of the adjoint have the other sign, even ones the same."""
    system, _ = SYSTEMS["e(3), cubic"]
    one, other = (
        co.modified_hamiltonian(system, co.Splitting(order=1, parts="coordinates", adjoint=back), 5)
        for back in (False, True)
    )
    assert set(one.terms) == {0, 1, 2, 3, 4}
    assert all(one.terms[k] == (-1) ** k * other.terms[k] for k in one.terms)
    assert one.error_term == (1, one.terms[1])
    # sign {H2, H1}/2 for two parts, the first flowing first.
    for sign in (1, -1):
        s = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([0.0, 1.0, 3.0]), sign=sign)
        found = co.modified_hamiltonian(s, co.Splitting(order=1, parts="coordinates"), 2)
        assert found.terms[1].monomials == {(1, 1, 1): sign * Fraction(-3, 2)}


def test_sizes_of_error_terms_compare_schemes():
    """The deviation of the energy in a run is the difference of the error term, for each scheme of order 4 and 6."""
    system, x0 = SYSTEMS["so(4)"]
    for name in ("yoshida4", "suzuki4", "blanes_moan4", "mclachlan4", "blanes_moan6", "blanes_casas_murua6"):
        scheme = co.Splitting(scheme=name, parts="coordinates")
        kept = co.modified_hamiltonian(system, scheme, 2)
        power, term = kept.error_term
        assert power == scheme.order and term.degree == power + 2
        assert kept.neglected < 1e-35  # texts of 40 digits and more
        if name == "blanes_casas_murua6":  # its term is too small to stand out
            continue
        h = {"yoshida4": 0.01, "blanes_moan6": 0.1}.get(name, 0.02)
        run = co.integrate(system, x0, (0, 2), h, scheme)
        predicted = -(h**power) * (term(run.x) - term(run.x[0]))
        measured = run.energy - run.energy[0]
        assert np.max(np.abs(measured)) > 1e-10
        assert measured == pytest.approx(predicted, abs=0.1 * np.max(np.abs(measured)))


class Own(co.methods.FlowMethod):
    """The triple jump from a cube root, which is no rational number."""

    order, explicit, symmetric, offered = 4, True, True, False

    def __init__(self, coefficient):
        self.chosen = coefficient

    def properties(self, system):
        return co.methods.Properties(poisson=True, energy=False, casimirs="all", attitude="every representation")

    def sweeps(self, number=float):
        c = self.chosen(number)
        sweep = co.methods.Sweep
        return [s for w in (c, 1 - 2 * c, c) for s in (sweep(True, w / 2, number(0)), sweep(False, w / 2, number(0)))]


def test_a_flow_method_of_a_user():
    system, _ = SYSTEMS["so(3)"]
    reference = co.modified_hamiltonian(system, co.Splitting(scheme="yoshida4"), 6)
    in_balls = Own(lambda number: 1 / (2 - number(2) ** (number(1) / number(3))))
    in_floats = Own(lambda number: C1)
    for scheme, tolerance in ((in_balls, 1e-15), (in_floats, 1e-13)):
        found = co.modified_hamiltonian(system, scheme, 6)
        assert set(found.terms) == {0, 4} and found.error_term.power == 4
        for exponents, value in reference.terms[4].monomials.items():
            assert found.terms[4].monomials[exponents] == pytest.approx(value, rel=tolerance, abs=1e-16)
    # Floats are rational numbers; what their rounding leaves of the order conditions is said, and taken as zero.
    found = co.modified_hamiltonian(system, in_floats, 6)
    assert all(not isinstance(value, float) for value in found.terms[4].monomials.values())
    assert 0 < found.neglected < 1e-14


def test_values_at_many_states_are_those_one_by_one():
    system, x0 = SYSTEMS["so(4), full"]
    kept = co.modified_hamiltonian(system, co.Splitting(order=1), 4)
    x = np.random.default_rng(1).uniform(-1, 1, (7, 3, 6))
    values, gradients = kept(x, 0.1), kept.gradient(x, 0.1)
    assert values.shape == (7, 3) and gradients.shape == x.shape
    for i in np.ndindex(7, 3):
        assert values[i] == pytest.approx(kept(x[i], 0.1), rel=1e-14)
        assert gradients[i] == pytest.approx(kept.gradient(x[i], 0.1), rel=1e-13, abs=1e-14)
    assert isinstance(kept(x0, 0.1), float)
    fractions = np.array([[Fraction(1, 3)] * 6, [Fraction(i, 7) for i in range(6)]], dtype=object)
    exactly = kept(fractions, Fraction(1, 10))
    assert all(isinstance(value, Fraction) for value in exactly)
    assert exactly.astype(float) == pytest.approx(kept(fractions.astype(float), 0.1), rel=1e-14)


def test_modified_energy_of_a_solution():
    """Odd terms tell the direction of a run."""
    system, x0 = SYSTEMS["so(3)"]
    scheme = co.Splitting(order=1, parts="coordinates")
    for t_span in ((0, 2), (2, 0)):
        run = co.integrate(system, x0, t_span, 1 / 64, scheme)
        drifts = [np.ptp(run.modified_energy(order)) for order in (1, 2, 3, 4)]
        assert run.modified_energy(1) == pytest.approx(run.energy, rel=1e-15)
        assert all(later < 0.1 * drift for drift, later in pairwise(drifts))
    again = pickle.loads(pickle.dumps(run))
    assert np.array_equal(again.modified_energy(3), run.modified_energy(3))


def test_fractions_of_the_hamiltonian_stay_exact():
    H = co.Polynomial({(2, 0, 0): Fraction(1, 6), (0, 2, 0): Fraction(1, 10), (0, 0, 2): Fraction(1, 14)})
    system = co.LiePoissonSystem(co.algebras.so(3), H)
    term = co.modified_hamiltonian(system, co.Splitting(parts="coordinates"), 4).terms[2]
    m1, m2, m3 = Fraction(1, 3), Fraction(1, 5), Fraction(1, 7)
    assert 24 * term.monomials[2, 2, 0] == m1**2 * m2 - m1**2 * m3 - 2 * m1 * m2**2 + 2 * m1 * m2 * m3 - m2**2 * m3


def test_casimirs_that_were_taken_off_are_in_the_first_term():
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    assert co.modified_hamiltonian(body, co.Splitting(), 2)([1.0, 2.0, 3.0], 0.1) == body.energy([1.0, 2.0, 3.0])


@pytest.mark.parametrize("order", [1, 2])
def test_all_forms_of_a_modified_hamiltonian_have_one_value(order):
    sympy = pytest.importorskip("sympy")
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]), sign=-1)
    method = co.Splitting(order=order, parts="coordinates")
    found = co.modified_hamiltonian(system, method, 4)
    symbolic = co.modified_hamiltonian(system, method, 4, symbols=True)
    assert set(found.terms) == ({0, 1, 2, 3} if order == 1 else {0, 2})
    x, h = [0.5, -2.0, 1.5], -0.25
    expected = sum(h**k * term(x) for k, term in found.terms.items())
    assert found(x, h) == pytest.approx(expected, rel=1e-14)
    places = {sympy.Symbol(f"x{i + 1}"): v for i, v in enumerate(x)} | {sympy.Symbol("h"): h}
    assert float(found.to_sympy().subs(places)) == pytest.approx(expected, rel=1e-14)
    values = {sympy.Symbol(name): float(value) for name, value in symbolic.values.items()}
    assert float(symbolic.to_sympy().subs({**places, **values})) == pytest.approx(expected, rel=1e-14)
    from sympy.parsing.sympy_parser import parse_expr

    text = parse_expr(repr(found).replace("^", "**"))
    assert float(text.subs(places)) == pytest.approx(expected, rel=1e-5)  # readable numbers have six digits
    powers = [k for k in found.terms if k]
    for written in (found.to_latex(), symbolic.to_latex()):
        assert [k for k in range(1, 4) if f"h^{{{k}}}" in written or (k == 1 and r"h\," in written)] == powers


# Symbols


# Exponents and the factor of each symbol; of a square the symbol is twice its coefficient.
WITH_SYMBOLS = {
    "so(3)": (co.algebras.so(3), {"m1": ((2, 0, 0), 2), "m2": ((0, 2, 0), 2), "b3": ((0, 0, 1), 1)}),
    "A3,7": (co.algebras.A3_7(1.5), {"m1": ((2, 0, 0), 2), "m3": ((0, 0, 2), 2), "c222": ((0, 3, 0), 1)}),
    "e(3)": (
        co.algebras.e(3),
        {"m1": ((2, 0, 0, 0, 0, 0), 2), "c455": ((0, 0, 0, 1, 2, 0), 1), "b6": ((0, 0, 0, 0, 0, 1), 1)},
    ),
}
SCHEMES = {
    "strang": (co.Splitting(parts="coordinates"), 4),
    "first order": (co.Splitting(order=1, parts="coordinates"), 3),
    "rounded coefficients": (co.Splitting(scheme="blanes_moan4", parts="coordinates"), 5),
}


@pytest.mark.thinned(6)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("method", SCHEMES)
@pytest.mark.parametrize("name", WITH_SYMBOLS)
def test_given_numbers_replace_those_of_the_system_and_no_others(name, method, sign):
    """For none, one and several of the symbols, where all or some coefficients are symbols."""
    (algebra, names), (scheme, order) = WITH_SYMBOLS[name], SCHEMES[method]
    rng = np.random.default_rng(len(name) + sign)

    def system_of(values):
        H = co.Polynomial({names[key][0]: Fraction(value) / names[key][1] for key, value in values.items()})
        return co.LiePoissonSystem(algebra, H, sign=sign)

    own = {key: Fraction(int(rng.choice([-5, -3, 2])), int(rng.choice([1, 3, 8]))) for key in names}
    first, _, third = names
    for wanted in (list(names), [first, third]):
        symbolic = co.modified_hamiltonian(system_of(own), scheme, order, symbols=wanted)
        for given in ({}, {third: 0}, {third: Fraction(7, 3)}, {first: 1.375, third: -2}):
            found, plain = symbolic.with_values(given), co.modified_hamiltonian(system_of(own | given), scheme, order)
            assert (found.order, found.radius, found.neglected) == (order, symbolic.radius, symbolic.neglected)
            assert not found.values and dict(symbolic.values) == {key: own[key] for key in wanted}
            x = rng.uniform(-1.0, 1.0, (4, algebra.dim))
            for h in (0.25, -0.5):
                # A few hundred monomials of a few factors each, all below 2^10, are each rounded.
                assert found(x, h) == pytest.approx(plain(x, h), rel=2.0**-40, abs=2.0**-40)
