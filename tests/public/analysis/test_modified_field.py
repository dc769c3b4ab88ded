"""Modified fields: known series, what they keep, and the steps that they are the flow of."""

from __future__ import annotations

from fractions import Fraction

import mpmath
import numpy as np
import pytest
from fields_under_test import ALGEBRAS, along, elementary, field_of, motion_by, whole

import coadjoint as co
from long import long_between, long_beyond
from refusals import refused
from rounding import UNIT_ROUNDOFF

pytestmark = pytest.mark.thinned(3)

C1 = 1 / (2 - 2 ** (1 / 3))


@pytest.mark.thinned(12)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", ALGEBRAS)
def test_midpoint_rule_has_its_known_series(name: str, sign: int):
    """f_2 = (f'f'f - f''(f, f)/2)/12; for x' = ax it is the logarithm of (1 + ah/2)/(1 - ah/2), ah + (ah)^3/12."""
    system = whole(name, sign, linear=True)
    f = field_of(system)
    _, inner, bent = elementary(f)
    found = co.modified_field(system, co.GaussLegendre(1), 4)
    assert found.exact
    assert list(found.terms[0]) == f
    assert list(found.terms[2]) == [
        (a - b * Fraction(1, 2)) * Fraction(1, 12) for a, b in zip(inner, bent, strict=True)
    ]
    for k in (1, 3):
        assert all(F.degree == 0 and not F.monomials for F in found.terms[k])


@pytest.mark.parametrize("freeze", ["structure", "gradient"])
@pytest.mark.parametrize("stages", [1, 2, 3])
def test_lemma_3_1_is_read_off_the_first_term(stages: int, freeze: str):
    system = whole("so(3)", -1)
    for m in range(1, 2 * stages + 2):
        scheme = co.ModifiedGaussLegendre(stages, iterations=m, freeze=freeze)
        found = co.modified_field(system, scheme, 2 * stages + 1, way="exact")
        assert found.first_error == min(m, 2 * stages) == scheme.order


@pytest.mark.thinned(12)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", ALGEBRAS)
def test_gauss_keeps_quadratic_invariants_at_every_order(name: str, sign: int):
    system = whole(name, sign)
    found = co.modified_field(system, co.GaussLegendre(2), 7 if system.dim < 6 else 5, way="exact")
    assert found.first_error == 4
    assert found.keeps("energy") is None
    for C, F in system.casimirs.items():
        if isinstance(F, co.Invariant):
            with refused(TypeError, "is not a polynomial"):
                found.keeps(C)
        elif getattr(F, "degree", 2) == 2:
            assert found.keeps(C) is None


@pytest.mark.thinned(4)
@pytest.mark.parametrize("name", ["so(3)", "e(3)", "so(4)", "moments"])
def test_what_is_frozen_is_what_is_kept(name: str):
    system = whole(name, -1)
    structure, gradient = (
        co.modified_field(system, co.ModifiedGaussLegendre(1, freeze=freeze), 5 if system.dim < 8 else 4)
        for freeze in ("structure", "gradient")
    )
    assert structure.keeps("energy") is None and gradient.keeps("energy") == 2
    quadratic = [C for C, F in system.casimirs.items() if getattr(F, "degree", 2) == 2]
    assert quadratic
    for C in quadratic:
        assert gradient.keeps(C) is None and structure.keeps(C) is not None
        assert structure.rate(C)[structure.keeps(C)].degree > 2


def skew_systems():
    """M full, with a linear term, singular with a linear term in and out of its range (a heavy top), and J(x)."""
    e3 = co.algebras.e(3)
    inertia = np.diag([1.0, 0.5, 0.25, 0.0, 0.0, 0.0])
    flat = inertia.copy()
    flat[0, 1] = flat[1, 0] = 0.25
    turn = np.cross(np.eye(3)[:, None], np.eye(3))
    bent = np.array([[1.0, 0.25, 0.0], [0.25, 0.5, 0.125], [0.0, 0.125, 2.0]])  # J(x) v = v x grad(x.A x/2)
    spun = co.PoissonSystem(
        lambda x: turn @ (bent @ x), co.Quadratic([1.0, 0.5, 0.25]), -1, derivative=lambda x: turn @ bent
    )
    return {
        **{f"{name} {sign:+d}": whole(name, sign) for name in ALGEBRAS if name != "moments" for sign in (1, -1)},
        "linear": whole("so(4)", -1, linear=True),
        "heavy top": co.LiePoissonSystem(e3, co.Quadratic(inertia, linear=[0, 0, 0, 0.5, 0, 1]), sign=-1),
        "linear in range": co.LiePoissonSystem(e3, co.Quadratic(flat, linear=[0.5, 0.25, 1, 0, 0, 0])),
        "J(x)": spun,
    }


@pytest.mark.thinned(5)
@pytest.mark.parametrize("which", long_between(3, skew_systems()))
def test_modified_midpoint_is_skew_to_every_order(which: str):
    system = skew_systems()[which]
    found = co.modified_field(system, co.ModifiedGaussLegendre(1), 5 if system.dim < 6 else 4)
    assert found.exact and found.first_error == 2
    n, H = system.dim, system.hamiltonian
    exact = [co.Polynomial({(0,) * n: Fraction(float(v))}, dim=n) for v in H.gradient(np.zeros(n))]
    slope = [
        exact[i] + sum(co.Polynomial.variable(j, n) * Fraction(float(v)) for j, v in enumerate(row))
        for i, row in enumerate(H.hessian(np.zeros(n)))
    ]
    zero = co.Polynomial({}, dim=n)
    for k, K in found.skew_terms.items():
        for i in range(n):
            assert all(K[i][j] == -K[j][i] for j in range(n))
            assert sum((K[i][j] * slope[j] for j in range(n)), zero) * system.sign == found.terms[k][i]
    states = np.random.default_rng(1).normal(size=(4, n))
    values = found.skew_matrix(states, 0.125)
    product = np.einsum("mij,mj->mi", values, [H.gradient(x) for x in states]) * system.sign
    np.testing.assert_allclose(product, found(states, 0.125), rtol=0, atol=1e-12 * np.abs(values).max() * 10)
    np.testing.assert_allclose(found.skew_matrix(states[0], 0.0), system.structure_matrix(states[0]), atol=1e-15)


def test_a_rational_rotation_of_irrational_frequency_is_exact():
    """2/(w h) atan(w h theta/2) = theta (1 - w^2 h^2 theta^2/12 + w^4 h^4 theta^4/80 - ...), theta = l.x, w^2 = l.l."""
    l = np.array([1, 2, 3])
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(np.outer(l, l)))
    found = co.modified_field(system, co.Splitting(rotation="rational"), 7, way="exact")
    theta = sum((int(c) * co.Polynomial.variable(i, 3) for i, c in enumerate(l)), co.Polynomial({}, dim=3))
    square, f = theta * theta * int(l @ l), field_of(system)
    assert found.known_to == 0.0
    assert list(found.terms[2]) == [square * F * Fraction(-1, 12) for F in f]
    assert list(found.terms[4]) == [square * square * F * Fraction(1, 80) for F in f]
    assert list(found.terms[6]) == [square * square * square * F * Fraction(-1, 448) for F in f]


def test_gauss_is_no_poisson_map_and_says_where():
    found = co.modified_field(whole("e(3)"), co.GaussLegendre(1), 3)
    assert list(found.poisson_defects) == [2]
    with refused(ValueError, "not a Poisson map on", ": at h^2", "coefficient of"):
        found.hamiltonians  # noqa: B018


SCHEMES = [
    co.GaussLegendre(1),
    co.GaussLegendre(3),
    co.ModifiedGaussLegendre(2, iterations=3),
    co.ModifiedGaussLegendre(2, freeze="gradient"),
    co.IteratedGaussLegendre(3, iterations=2),
    co.ExplicitRungeKutta("rk4"),
    co.ExplicitRungeKutta("runge2"),
    co.Splitting(order=1),
    co.Splitting(order=1, adjoint=True),
    co.Splitting(order=2),
    co.Splitting(order=4),
    co.Splitting(scheme="blanes_casas_murua6"),
    co.Composition(co.Splitting(order=2), (C1, 1 - 2 * C1, C1)),
    co.Composition(co.GaussLegendre(1), (C1, 1 - 2 * C1, C1)),
    co.Taylor(2, projected=False),
    co.Kahan(),
]


def kinds_of_fields():
    """Fields that no formula was fitted to: a full M, a linear term, a cubic H, no unimodular algebra, both signs."""
    cubic = co.Polynomial({(3, 0, 0): 0.25, (0, 2, 0): 0.5, (0, 0, 2): 1, (0, 0, 3): 0.5})
    return [whole("A3,7", -1, seed=8, linear=True), co.LiePoissonSystem(co.algebras.so(3), cubic, sign=-1)]


def flow(terms, x, h, highest=7):
    """The motion over h of the sum of h^k f_k, by its power series in time."""
    fields = [{} for _ in x]
    for k, term in terms.items():
        for monomials, F in zip(fields, term, strict=True):
            for e, c in F.monomials.items():
                c = Fraction(c)
                monomials[e] = monomials.get(e, 0) + h**k * mpmath.mpf(c.numerator) / c.denominator
    series = [[v] for v in x]
    for m in range(highest):
        slopes = []
        for monomials in fields:
            total = 0
            for e, c in monomials.items():
                product = [c, *[0] * m]
                for factor in (s for s, power in zip(series, e, strict=True) for _ in range(power)):
                    product = [sum(product[j] * factor[q - j] for j in range(q + 1)) for q in range(m + 1)]
                total += product[m]
            slopes.append(total / (m + 1))
        for s, slope in zip(series, slopes, strict=True):
            s.append(slope)
    return [sum(v * h**q for q, v in enumerate(s)) for s in series]


@pytest.mark.thinned(6)
@pytest.mark.parametrize("which", long_beyond(1, [0, 1]))
@pytest.mark.parametrize("scheme", long_between(3, SCHEMES), ids=str)
def test_a_step_is_the_flow_of_its_field(scheme, which: int):
    """One step and the flow of the terms below h^r differ by h^(r+1) f_r and less, forward and backward."""
    system, order = kinds_of_fields()[which], 4
    try:
        scheme.properties(system)
    except ValueError:
        pytest.skip("the scheme does not serve a cubic H")
    found = co.modified_field(system, scheme, order)
    assert found.exact, found.reason
    first = next((k for k in range(1, order) if any(F.monomials for F in found.terms[k])), order)
    assert first == min(scheme.order, order)
    errors = []
    with mpmath.workdps(40):
        x = np.array([mpmath.mpf(v) for v in (0.5, -0.75, 0.625)], dtype=object)
        for h in (mpmath.mpf("1e-3"), mpmath.mpf("5e-4"), mpmath.mpf("-1e-3")):
            end = flow({k: found.terms[k] for k in range(order)}, x, h)
            step = scheme.step(system, x, mpmath.mpf(0), h)
            errors.append(max(abs(a - b) for a, b in zip(step, end, strict=True)))
        slope = float(mpmath.log(errors[0] / errors[1], 2))
    # The first term left out, f_4 or, where symmetry or order remove that, one after it.
    assert slope > order + 1 - 0.05
    assert errors[2] < 10 * errors[0]


def test_projected_series_keep_what_they_restore():
    system = whole("so(3)", 1)
    found = co.modified_field(system, co.Taylor(2), 4)
    assert not found.exact
    assert found.keeps("energy") is None and found.keeps(next(iter(system.casimirs))) is None
    assert found.first_error == 2


def test_a_scheme_at_a_wrong_speed_has_another_field():
    system = whole("so(3)")

    def slow(x, h):
        return co.GaussLegendre(1).step(system, x, 0 * h, h / 4)

    for way in ("numerical", "auto"):
        found = co.modified_field(system, slow, 3, way=way)
        assert found.first_error == 0 and found.keeps("energy") is None
    exact = co.modified_field(system, lambda x, h: x + h / 4 * system.vector_field(x), 2)
    assert exact.exact and exact.first_error == 0


def test_a_function_is_a_scheme():
    system = whole("A3,7")
    found = co.modified_field(system, lambda x, h: x + h * system.vector_field(x + h / 2 * system.vector_field(x)), 4)
    known = co.modified_field(system, co.ExplicitRungeKutta("runge2"), 4)
    assert found.exact and dict(found.terms) == dict(known.terms)


def test_a_step_that_branches_is_not_read_in_series():
    system = whole("so(3)")

    def step(x, h, small=lambda change: all(abs(v) < 1e-300 for v in change)):
        end = x
        for _ in range(60):
            end, last = x + h * system.vector_field((x + end) / 2), end
            if small(end - last):
                break
        return end

    def stopped(x, h):  # the constant terms of corrections are zero from the first on
        return step(x, h, lambda change: getattr(change[0], "coefficients", [1])[0] == 0)

    with refused(TypeError, "contradicts the step at a sample point", "a step that branches"):
        co.modified_field(system, stopped, 4, way="exact")
    found = co.modified_field(system, step, 4)
    known = co.modified_field(system, co.GaussLegendre(1), 4)
    x = np.array([[0.5, 0.25, -1.0]])
    np.testing.assert_allclose(found.values(x), known.values(x), atol=1e-14)
    assert np.array_equal(found.values(x[0].tolist()), found.values(x)[:, 0])


@pytest.mark.thinned(8)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", ["so(3)", "e(3)", "so(4)", "A3,7", "A4,7"])
def test_splittings_are_poisson_with_hamiltonians(name, sign):
    system = whole(name, sign)
    found = co.modified_field(system, co.Splitting(order=2), 5 if system.dim < 6 else 3)
    assert found.first_error == 2 and not found.poisson_defects
    for k, H in found.hamiltonians.items():
        H = co.Polynomial(dict(H.monomials), dim=system.dim)
        assert motion_by(system, [H.derivative(i) for i in range(system.dim)]) == list(found.terms[k])
    for C in system.casimirs:
        if isinstance(system.casimirs[C], co.Polynomial | co.Quadratic):
            assert found.keeps(C) is None


LARGE = co.LiePoissonSystem(co.algebras.so(10), co.Quadratic(np.arange(1.0, 46.0)), casimirs={})
RUNGE, FROZEN = co.ExplicitRungeKutta("runge2"), co.ModifiedGaussLegendre(1, freeze="gradient")


def test_a_field_too_large_for_memory_is_computed_at_points():
    found, x = co.modified_field(LARGE, RUNGE, 7), np.cos(np.arange(45.0))
    assert not found.exact and "order 7" in found.reason
    rounding = 16 * 16 * 45 * UNIT_ROUNDOFF  # of sums of 16 products up to 45
    np.testing.assert_allclose(found(x, 0.0), LARGE.vector_field(x), rtol=0, atol=rounding)


@pytest.mark.thinned(2)
@pytest.mark.parametrize(
    ("name", "sign", "scheme"),
    [("so(3)", 1, RUNGE), ("so(3)", -1, FROZEN), ("A3,7", -1, RUNGE), ("A3,7", -1, FROZEN)],
)
def test_rates_of_change_are_those_of_steps(name, sign, scheme):
    """A step changes F by h^(k + 1) r_k first; the mean over h and -h leaves out the next term."""
    system = whole(name, sign, linear=name == "so(3)")
    found = co.modified_field(system, scheme, 4)
    x = np.array([0.5, -0.75, 0.625])
    own = co.Polynomial({(1, 1, 0): 1, (0, 0, 3): Fraction(-1, 2), (1, 0, 0): Fraction(1, 4)})
    for given, value in (("energy", system.energy), (own, own)):
        rates = found.rate(given)
        first = min(rates)
        assert found.keeps(given) == first and all(F.monomials for F in rates.values())
        means = []
        for h in (0.02, 0.01):
            changes = [(value(co.stepper(system, scheme, s)(x)) - value(x)) / s ** (first + 1) for s in (h, -h)]
            means.append(sum(changes) / 2)
        error = [abs(mean - rates[first](x)) for mean in means]
        # What is left is of the size h^2, above rounding of 1e-16 / h^(k + 1).
        assert error[1] < 0.3 * error[0] + 1e-9 and error[0] < 0.05 * abs(rates[first](x))
    assert first == 0
    for k, term in found.terms.items():
        assert found.rate(own).get(k, co.Polynomial({}, dim=3)) == along(term, own)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("way", ["exact", "numerical"])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_matrix_at_points_is_skew_and_gives_the_field(sign, way):
    """The exact flow of a quartic energy over h + h^3 - 2 h^4 keeps it: f_2 = f and f_3 = -2 f."""
    H = co.Polynomial({(0, 4, 0): 0.25, (0, 1, 0): 1.0, (0, 2, 0): 0.5, (2, 0, 0): 0.125})
    system = co.LiePoissonSystem(co.algebras.get("A3,1"), H, sign=sign)

    def step(x, h):  # x1 and x2 are constant
        return x + (h + h**3 - 2 * h**4) * system.vector_field(x)

    found = co.modified_field(system, step, 4, way=way)
    assert found.exact == (way == "exact") and found.first_error == 2 and found.keeps("energy") is None
    states = np.array([[0.5, -0.75, 1.0], [1.0, 0.25, -0.5]])
    gradients = [system.hamiltonian.gradient(x) for x in states]
    motion = np.array([system.vector_field(x) for x in states])
    J = np.array([system.structure_matrix(x) for x in states])
    for h in (0.125, -0.25, 0.0):
        K = found.skew_matrix(states, h)
        assert K.shape == (2, 3, 3) and np.array_equal(K, -np.swapaxes(K, 1, 2))
        product = sign * np.einsum("mij,mj->mi", K, gradients)
        np.testing.assert_allclose(product, (1.0 + h**2 - 2 * h**3) * motion, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(found(states, h), product, rtol=1e-12, atol=1e-15)
        np.testing.assert_array_equal(found.skew_matrix(states[1], h), K[1])
        # Twice the change of the field: of it and its mirror image.
        excess = np.linalg.norm(K - J, axis=(1, 2))
        expected = abs(h**2 - 2 * h**3) * np.linalg.norm(motion, axis=1) / np.linalg.norm(gradients, axis=1)
        np.testing.assert_allclose(excess, np.sqrt(2.0) * expected, rtol=1e-9, atol=1e-14)
    level = co.LiePoissonSystem(co.algebras.get("A3,1"), co.Polynomial({(0, 4, 0): 0.25}), sign=sign)
    flat = co.modified_field(level, lambda x, h: x + h * level.vector_field(x), 2, way=way)
    with refused(ValueError, "gradient of H is zero at [1.0, 0.0, 2.0]"):
        flat.skew_matrix([[1.0, 1.0, 1.0], [1.0, 0.0, 2.0]], 0.1)


def test_a_derivation_is_poisson_and_not_hamiltonian():
    """On the Heisenberg algebra (2 x1, x2, x3) respects the bracket, and moves the Casimir x1."""
    system = co.LiePoissonSystem(co.algebras.get("A3,1"), co.Quadratic([0.0, 1.0, 0.0]))

    def step(x, h):
        y = x + h * system.vector_field(x)  # the exact flow, since x1 and x2 are constant
        growth = 1 + h * h + h**4 / 2
        return np.array([growth * growth * y[0], growth * y[1], growth * y[2]])

    found = co.modified_field(system, step, 3)
    assert found.exact and not found.poisson_defects and found.first_error == 1
    with refused(ValueError, "is not Hamiltonian: at h^1 it moves x1, with a coefficient of 2"):
        found.hamiltonians  # noqa: B018
    uneven = co.modified_field(system, lambda x, h: step(x, h) + h * h * np.array([x[0], 0 * x[0], 0 * x[0]]), 3)
    assert uneven.poisson_defects[1] == 1.0
    with refused(ValueError, "not a Poisson map", "at h^1"):
        uneven.hamiltonians  # noqa: B018
