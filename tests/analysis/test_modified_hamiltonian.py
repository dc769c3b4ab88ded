"""Modified Hamiltonians against printed formulas, matrix logarithms, exact motions, and what runs keep."""

from __future__ import annotations

import pickle
from fractions import Fraction
from functools import partial
from itertools import pairwise

import mpmath
import numpy as np
import pytest
from modified_systems import systems
from scipy.integrate import solve_ivp

import coadjoint as co
from coadjoint.methods.numerics.splitting_schemes import SCHEMES
from coadjoint.program.modified_energy.second_order import second_order_term
from long import long_where

pytestmark = pytest.mark.thinned(3)

SYSTEMS = systems()
C1 = 1 / (2 - 2 ** (1 / 3))
JUMP = (C1, 1 - 2 * C1, C1)
METHODS = {
    "sweep": co.Splitting(order=1),
    "adjoint": co.Splitting(order=1, adjoint=True, parts="coordinates"),
    "strang": co.Splitting(),
    "strang, coordinates": co.Splitting(parts="coordinates"),
    "suzuki4": co.Splitting(scheme="suzuki4"),
    "blanes_moan4": co.Splitting(scheme="blanes_moan4", parts="coordinates"),
    "processed": co.Splitting(scheme="blanes_casas_murua6"),
    "composition": co.Composition(co.Splitting(parts="coordinates"), JUMP),
}


def exact(x):
    return np.array([mpmath.mpf(float(value)) for value in x], dtype=object)


@pytest.fixture(autouse=True)
def digits():
    with mpmath.workdps(50):
        yield


def slope_of(defects):
    return float(mpmath.log(defects[0] / defects[1], 2))


# --- against formulas that were found otherwise


def test_the_printed_formula_of_so3_to_the_letter():
    """24 H2 of the splitting by coordinates, in symbols."""
    body = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]))
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


def linear(algebra, seed, sign):
    b = np.random.default_rng(seed).integers(-4, 5, algebra.dim) / 4
    return co.LiePoissonSystem(algebra, co.Quadratic(0.0, linear=b), sign=sign), b


@pytest.mark.thinned(8)
@pytest.mark.parametrize(
    ("algebra", "sign"), [(co.algebras.so(3), -1), (co.algebras.e(3), 1), (co.algebras.A3_7(1.5), -1)], ids=str
)
@pytest.mark.parametrize("name", ["sweep", "adjoint", "strang, coordinates", "suzuki4", "blanes_moan4", "processed"])
def test_logarithm_of_matrices(algebra, name, sign):
    """A linear H flows by matrices; the logarithm of a step is that of H~, which is linear as well."""
    system, _ = linear(algebra, 3, sign)
    method = METHODS[name]
    sizes = []
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


@pytest.mark.thinned(6)
@pytest.mark.parametrize("name", SYSTEMS)
def test_the_term_at_points_agrees(name):
    """`second_order_term` nests pairs by gradients and Hessians; here it is a polynomial."""
    system, _ = SYSTEMS[name]
    points = np.random.default_rng(4).uniform(-1, 1, (5, system.dim))
    for parts in ("auto", "coordinates"):
        method = co.Splitting(parts=parts)
        expected = second_order_term(system.algebra, method.program(system).parts, points)
        term = co.modified_hamiltonian(system, method, order=4).terms.get(2, co.Polynomial({}, dim=system.dim))
        assert term(points) == pytest.approx(expected, rel=1e-12, abs=1e-13)


# --- against motions


@pytest.mark.thinned(28)
@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("method", METHODS)
def test_the_step_is_its_flow(name, method):
    """An absolute reference: x' = sign J grad H~, solved to round-off, against the step."""
    system, x0 = SYSTEMS[name]
    scheme = METHODS[method]
    order = scheme.order + 2 if scheme.order < 6 else 7
    if system.dim > 6 and scheme.order > 2:
        order = scheme.order  # the next term has thousands of monomials
    kept = co.modified_hamiltonian(system, scheme, order)
    apart = []
    largest = 1 / 16 if order > 4 else 1 / 64
    for h in (largest, largest / 2):
        field = partial(field_of, system, kept, h)
        flow = solve_ivp(field, (0, h), x0, method="DOP853", rtol=3e-14, atol=1e-15).y[:, -1]
        apart.append(np.max(np.abs(flow - co.stepper(system, scheme, h)(x0))))
    assert apart[1] < 2e-13 or np.log2(apart[0] / apart[1]) > order + 0.4, apart
    assert apart[0] < 100 * largest ** (order + 1)


def field_of(system, kept, h, t, x):
    return system.sign * system.structure_matrix(x) @ kept.gradient(x, h)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("name", ["so(3)", "e(3), cubic", "A3,7, body", "moments"])
def test_order_eight_in_many_digits(name):
    system, x0 = SYSTEMS[name]
    for scheme in (co.Splitting(), co.Splitting(order=4)):
        kept, defects = co.modified_hamiltonian(system, scheme, 8), []
        for k in (7, 8):
            h = mpmath.mpf(2) ** -k
            defects.append(abs(kept(scheme.step(system, exact(x0), mpmath.mpf(0), h), h) - kept(exact(x0), h)))
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
        kept, defects = co.modified_hamiltonian(system, scheme, r), []
        for k in (7, 8):
            h = mpmath.mpf(2) ** -k
            x = exact([0.3, 0.4, -0.6])
            defects.append(abs(kept(scheme.step(system, x, mpmath.mpf(0), h), h) - kept(x, h)))
        # Of a composition by floats the order conditions hold up to rounding.
        floor = 10 * kept.neglected * h**3
        assert defects[1] < floor or slope_of(defects) > max(r, scheme.order) + 0.4, (r, slope_of(defects))


def test_one_rational_rotation_is_integrated_exactly():
    """theta = x1: the derivative is 2/h atan(h x1/2) = x1 - h^2 x1^3/12 + h^4 x1^5/80 - ..., also where turns meet."""
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0, 0]))
    found = co.modified_hamiltonian(system, co.Splitting(parts="coordinates", rotation="rational"), 6)
    assert found.terms[2].monomials == {(4, 0, 0): Fraction(-1, 48)}
    assert found.terms[4].monomials == {(6, 0, 0): Fraction(1, 480)}
    assert found.error_term.power == 2


# --- error terms


@pytest.mark.thinned(19)
@pytest.mark.parametrize("name", long_where(["blanes_casas_murua10", "kahan_li10a", "kahan_li10d"], sorted(SCHEMES)))
def test_every_scheme_has_its_first_term_at_its_order(name):
    system, _ = SYSTEMS["so(3)"]
    scheme = co.Splitting(scheme=name, parts="coordinates")
    kept = co.modified_hamiltonian(system, scheme, order=2)
    power, term = kept.error_term
    assert power == scheme.order and term.degree == power + 2
    assert kept.neglected < 1e-35  # texts of 40 digits and more


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
    for name, h in {
        "yoshida4": 0.01,
        "suzuki4": 0.02,
        "blanes_moan4": 0.02,
        "mclachlan4": 0.02,
        "blanes_moan6": 0.1,
    }.items():
        scheme = co.Splitting(scheme=name, parts="coordinates")
        power, term = co.modified_hamiltonian(system, scheme, 2).error_term
        run = co.integrate(system, x0, (0, 2), h, scheme)
        predicted = -(h**power) * (term(run.x) - term(run.x[0]))
        measured = run.energy - run.energy[0]
        assert np.max(np.abs(measured)) > 1e-10
        assert measured == pytest.approx(predicted, abs=0.1 * np.max(np.abs(measured)))


@pytest.mark.long
def test_a_kernel_and_its_processor():
    """P K P^-1: the Hamiltonian of K at the unprocessed state is that of the scheme at the processed one."""
    system, x0 = SYSTEMS["so(3)"]
    scheme = co.Splitting(scheme="blanes_casas_murua6", parts="coordinates")
    kept = co.modified_hamiltonian(system, scheme, 9)
    assert kept.kernel.error_term.power < kept.error_term.power == 6
    apart = []
    for k in (5, 6):
        h = mpmath.mpf(2) ** -k
        program = scheme.program(system, number=mpmath.mpf)
        assert program is not None
        x = exact(x0)
        y = Processor(scheme).step(system, x, mpmath.mpf(0), h)
        apart.append(abs(kept.kernel(x, h) - kept(y, h)))
    assert slope_of(apart) > 8.5 or apart[1] < 1e-17
    plain = co.modified_hamiltonian(system, co.Splitting(), 4)
    assert plain.kernel.terms == plain.terms


class Processor(co.methods.FlowMethod):
    """The processor of a scheme, and then one step over nothing: its sweeps cover no time."""

    order, explicit, symmetric, offered = 1, True, False, False

    def __init__(self, scheme):
        self._scheme = scheme

    parts = property(lambda self: self._scheme.parts)

    def properties(self, system):
        return self._scheme.properties(system)

    def sweeps(self, number=float):
        # One step over the whole and its inverse, so that the coefficients add up to 1 as a program wants them.
        return self._scheme.processor(number)

    def program(self, system, *, group=None, number=float):
        from coadjoint.program.table import build_program

        return build_program(system, self, group=group, number=number)


# --- schemes of users


class Own(co.methods.FlowMethod):
    """The triple jump from a cube root, which is no rational number."""

    order, explicit, symmetric, offered = 4, True, True, False

    def __init__(self, coefficient):
        self._coefficient = coefficient

    def properties(self, system):
        return co.methods.Properties(poisson=True, energy=False, casimirs="all", attitude="every representation")

    def sweeps(self, number=float):
        c = self._coefficient(number)
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


# --- evaluation


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
    ensemble = co.integrate(system, [x0, x0[::-1]], (0, 1), 1 / 16, scheme)
    assert ensemble.modified_energy(3).shape == ensemble.energy.shape
    others = [co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, m])) for m in (0.2, 0.7)]
    several = co.integrate(co.batch(others), x0, (0, 1), 1 / 16, scheme)
    for m, other in enumerate(others):
        alone = co.integrate(other, x0, (0, 1), 1 / 16, scheme)
        assert np.array_equal(several.modified_energy(4)[:, m], alone.modified_energy(4))
    again = pickle.loads(pickle.dumps(run))
    assert np.array_equal(again.modified_energy(3), run.modified_energy(3))


def test_casimirs_that_were_taken_off_are_in_the_first_term():
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    assert co.Splitting().program(body).shift
    kept = co.modified_hamiltonian(body, co.Splitting(), 2)
    assert kept([1.0, 2.0, 3.0], 0.1) == body.energy([1.0, 2.0, 3.0])


def test_fractions_of_the_hamiltonian_stay_exact():
    H = co.Polynomial({(2, 0, 0): Fraction(1, 6), (0, 2, 0): Fraction(1, 10), (0, 0, 2): Fraction(1, 14)})
    system = co.LiePoissonSystem(co.algebras.so(3), H)
    term = co.modified_hamiltonian(system, co.Splitting(parts="coordinates"), 4).terms[2]
    m1, m2, m3 = Fraction(1, 3), Fraction(1, 5), Fraction(1, 7)
    assert 24 * term.monomials[2, 2, 0] == m1**2 * m2 - m1**2 * m3 - 2 * m1 * m2**2 + 2 * m1 * m2 * m3 - m2**2 * m3


# --- what is refused


def test_refusals():
    body, strang = SYSTEMS["so(3)"][0], co.Splitting()
    with pytest.raises(TypeError, match="not made of exact flows"):
        co.modified_hamiltonian(body, co.GaussLegendre(1))
    with pytest.raises(TypeError, match="is for one LiePoissonSystem"):
        co.modified_hamiltonian(co.batch([body, body]), strang)
    with pytest.raises(TypeError, match="it must be a scheme"):
        co.modified_hamiltonian(body, 0.5)
    with pytest.raises(ValueError, match=r"unknown method 'strang'; there are: .*Splitting"):
        co.modified_hamiltonian(body, "strang")
    with pytest.raises(ValueError, match="order must be at most 12"):
        co.modified_hamiltonian(body, strang, 14)
    driven = co.Separable({i: (lambda y, t: y * t, lambda y, t: t + 0 * y) for i in range(3)})
    with pytest.raises(ValueError, match="depends on time"):
        co.modified_hamiltonian(co.LiePoissonSystem(co.algebras.so(3), driven), strang)
    shifted = co.systems.rigid_body(inertia=(1, 2, 3))
    with pytest.raises(ValueError, match=r'Casimir .* subtracted from H.*parts="coordinates"'):
        co.modified_hamiltonian(shifted, strang, symbols=True)
    with pytest.raises(ValueError, match="completed squares"):
        co.modified_hamiltonian(SYSTEMS["so(3), full, body"][0], co.Splitting(parts="coordinates"), symbols=True)
    with pytest.raises(ValueError, match="m7"):
        co.modified_hamiltonian(body, co.Splitting(parts="coordinates"), symbols=("m7",))
    kept = co.modified_hamiltonian(body, co.Splitting(parts="coordinates"), symbols=True)
    with pytest.raises(TypeError, match=r"has the symbols b1, b3, m1, m2, m3; use with_values\(\)"):
        kept([1.0, 2.0, 3.0], 0.1)
    with pytest.raises(ValueError, match="values has 'm9'"):
        kept.with_values({"m9": 1})
    with pytest.raises(TypeError, match="step h"):
        kept.with_values()([1.0, 2.0, 3.0], "0.1")


def test_what_is_too_large_is_refused_before_it_is_made(monkeypatch):
    system, _ = SYSTEMS["so(4), full"]
    monkeypatch.setattr("coadjoint.program.modified_energy.sweep_logarithm.MAX_PRODUCTS", 10**5)
    assert co.modified_hamiltonian(system, co.Splitting(parts="coordinates"), 4).terms[2].monomials
    with pytest.raises(ValueError, match=r"products of monomials or more, .* at most 1e\+05"):
        co.modified_hamiltonian(system, co.Splitting(parts="coordinates"), 8)
    monkeypatch.setattr("coadjoint.memory.available", lambda: 10**5)
    monkeypatch.setattr("coadjoint.memory.UNCHECKED_BYTES", 10**4)
    with pytest.raises(ValueError, match="a bracket in a modified Hamiltonian needs about"):
        co.modified_hamiltonian(system, co.Splitting(parts="coordinates"), 4)
