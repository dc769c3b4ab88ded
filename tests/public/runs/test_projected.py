"""Any scheme, projected: steps of every family, alone, in ensembles and batches, and what comes out of the base."""

from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from drawn_matrices import full
from own_schemes import Classical
from refusals import refused
from rounding import UNIT_ROUNDOFF

E3 = co.LiePoissonSystem(co.algebras.e(3), co.Quadratic(full(6), linear=np.linspace(-0.3, 0.4, 6)), sign=-1)
SU3 = co.LiePoissonSystem(co.algebras.su(3), co.Quadratic(0.5 * full(8)))
SO5 = co.LiePoissonSystem(co.algebras.so(5), co.Quadratic(full(10)))
SPIRAL = co.LiePoissonSystem(co.algebras.A3_7(0.7), co.Quadratic(full(3)))
BASES = [
    co.Splitting(order=1),
    co.Splitting(order=4, compensated=True),
    co.ExplicitRungeKutta("runge2"),
    co.GaussLegendre(2),
    co.ModifiedGaussLegendre(1, freeze="gradient"),
    co.Kahan(),
    co.CommutatorFree(3),
    co.Taylor(5, projected=False),
    co.Composition(co.Kahan(), (0.5, 0.5)),
    co.Projected(co.ExplicitRungeKutta("rk4")),
    Classical(),
]


def random_polynomial(n, degrees, seed):
    """Return a sum of a square and of products with so many factors, which may be equal."""
    rng = np.random.default_rng(seed)
    terms = {tuple(2 * (k == i) for k in range(n)): Fraction(1, 2) for i in range(n)}
    for degree in degrees:
        exponents = np.bincount(rng.integers(n, size=degree), minlength=n)
        terms[tuple(map(int, exponents))] = Fraction(int(rng.integers(1, 9)), 16)
    return co.Polynomial(terms)


# The energy is written out for eight factors at most, and held in registers in two blocks of eight coordinates.
OF_DEGREES = {
    "degrees up to 8 in one block": (co.algebras.e(3), (0, 1, 2, 3, 3, 4, 5, 8, 8)),
    "degrees up to 8 in two blocks": (co.algebras.so(5), (0, 1, 2, 3, 4, 4, 8)),
    "degrees up to 4 in three blocks": (co.algebras.su(5), (1, 3, 3, 4, 4)),
    "degrees up to 10": (co.algebras.sl(3), (1, 3, 9, 10)),
}
LARGE = {
    name: co.LiePoissonSystem(algebra, random_polynomial(algebra.dim, degrees, seed))
    for seed, (name, (algebra, degrees)) in enumerate(OF_DEGREES.items())
}
LARGE["so(5), quartic Casimir"] = SO5
LARGE["so(6), cubic and quartic Casimirs"] = co.LiePoissonSystem(
    co.algebras.so(6), co.Quadratic(np.linspace(0.5, 1.5, 15))
)


def squares(algebra, forms):
    """Return an energy |x|^2 / 2 + sum_i f_i(x)^2 / 4; its derivatives have the sums f_i in common."""
    x = [co.Polynomial.variable(i, algebra.dim) for i in range(algebra.dim)]
    energy = sum((y * y / 2 for y in x), sum((f * f / 4 for f in forms(x)), 0 * x[0]))
    return co.LiePoissonSystem(algebra, energy)


LARGE["squares in four coordinates"] = squares(
    co.algebras.gl(2), lambda x: (x[0] * x[3] - x[1] * x[2], x[0] * x[1] + x[2] * x[3])
)
# Six sums occur in its derivatives, more than a vector of four has lanes.
LARGE["a quartic in four coordinates"] = co.LiePoissonSystem(
    co.algebras.gl(2),
    co.Polynomial(
        {(1, 1, 0, 2): 7, (0, 0, 3, 1): 3, (2, 0, 1, 1): 3, (2, 1, 0, 1): 6, (1, 3, 0, 0): 2, (3, 1, 0, 0): 7}
        | {(1, 1, 2, 0): 2, (3, 0, 1, 0): 9}
    )
    / 8,
)
LARGE["squares of ten forms"] = squares(
    co.algebras.so(6), lambda x: [x[i] * x[i + 1] - x[i + 2] * x[i + 5] for i in range(10)]
)
LARGE["squares of cubic forms"] = squares(
    co.algebras.su(3),
    lambda x: (x[0] * x[1] * x[2] - x[3] * x[4] * x[5] + x[5] * x[6] * x[7], x[0] * x[0] * x[7] - x[1] * x[4] * x[6]),
)
# No quadratic invariant asks for further corrections.
LARGE["cubic alone"] = co.LiePoissonSystem(
    co.algebras.A3_7(0.7), co.Polynomial({(3, 0, 0): 2, (0, 3, 0): Fraction(1, 2), (1, 1, 1): 3, (0, 0, 3): 1})
)


def start_of(system):
    return np.linspace(0.7, -0.5, system.dim)


@pytest.mark.thinned(32)
@pytest.mark.parametrize("base", BASES, ids=str)
@pytest.mark.parametrize("system", [E3, SU3, SPIRAL], ids=["e(3)", "su(3), cubic Casimir", "A3,7"])
@pytest.mark.parametrize("h", [0.05, -0.05])
def test_a_step_is_the_nearest_point_along_gradients(base, system, h):
    check_nearest_point(base, system, h)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("base", ["runge2", "rk4"])
@pytest.mark.parametrize("name", LARGE)
@pytest.mark.parametrize("h", [0.05, -0.05])
def test_invariants_of_any_degree_in_any_number_of_coordinates(base, name, h):
    check_nearest_point(co.ExplicitRungeKutta(base), LARGE[name], h)


@pytest.mark.parametrize(("n", "places"), [(8, range(8)), (12, (0, 7, 8, 11)), (20, (3, 8, 19))])
def test_the_largest_coordinate_may_be_any(n, places):
    """The bound on what a correction leaves grows with the largest coordinate, in any vector; the others are small."""
    energy = co.Polynomial({tuple(4 * (i == k) for k in range(n)): 0.25 + i / 64 for i in range(n)})
    for c in places:
        planes = {(2 * k, 2 * k + 1): {2 * k + 1 - c % 2: 1.0} for k in range(n // 2)}
        system = co.LiePoissonSystem(co.LieAlgebra.from_brackets(n, planes), energy)
        x, H = np.full(n, 0.3), system.hamiltonian
        x[c] = 16.0
        for h in 2.0 ** -np.arange(13, 20):
            y = co.stepper(system, co.Projected(co.ExplicitRungeKutta("runge2")), h)(x)
            terms = np.sum(np.abs(x * H.gradient(x))) + H.value(x)
            assert abs(H.value(y) - H.value(x)) < 8 * UNIT_ROUNDOFF * terms, (c, h)


SQUARE = co.Polynomial({tuple(2 * (i == k) for i in range(3)): 1.0 for k in range(3)})
DEPENDENT = {  # in each place among the invariants
    "e(3), p = 0": (co.LiePoissonSystem(co.algebras.e(3), co.Quadratic(np.linspace(0.5, 1.5, 6))),
        (0.3, 1.0, 0.2, 0.0, 0.0, 0.0)),
    "Casimirs of Casimirs": (co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(full(3)),
        casimirs={"a": SQUARE, "b": 2.0 * SQUARE, "c": SQUARE * SQUARE}), (0.3, 1.0, 0.2)),
}  # fmt: skip


@pytest.mark.parametrize("h", [0.3, -0.3])
@pytest.mark.parametrize("name", DEPENDENT)
def test_dependent_gradients_of_casimirs_add_no_direction(name, h):
    system, x = DEPENDENT[name]
    check_nearest_point(co.ExplicitRungeKutta("rk4"), system, h, np.array(x))


PROJECTING = [co.Projected(co.ExplicitRungeKutta("rk4")), co.Taylor(3)]


def so4_beside(copies):
    """A system whose Casimirs of so(4) have dependent gradients at its state, on which the energy moves along both."""
    M = np.diag(np.r_[np.arange(1.0, 7.0), np.ones(3 * copies)])
    M[0, 3] = M[3, 0] = 1.0
    algebra = co.algebras.direct_sum(co.algebras.so(4), *[co.algebras.so(3)] * copies) if copies else co.algebras.so(4)
    x = np.array([1.0, 0.5, 0.2, 0.2, -0.5, 1.0, *(0.3, 1.0, 0.2) * copies])
    return co.LiePoissonSystem(algebra, co.Quadratic(M)), x


@pytest.mark.parametrize("scheme", PROJECTING, ids=str)
@pytest.mark.parametrize("copies", [0, 1, 2, 5])
@pytest.mark.parametrize("sign", [1, -1])
def test_casimirs_that_cannot_be_restored_are_not_lost_in_silence(scheme, copies, sign):
    """Of large steps one Casimir is off by 1e-11 after the correction of the others; of small ones by rounding."""
    system, x = so4_beside(copies)
    for h, restored in ((0.3 * sign, False), (0.01 * sign, True)):
        ways = (
            lambda h=h: scheme.step(system, x, 0.0, h),
            lambda h=h: co.stepper(system, scheme, h)(x),
            lambda h=h: co.integrate(system, x, (0, h), abs(h), scheme).x[-1],
            lambda h=h: co.integrate(system, [x] * 9, (0, h), abs(h), scheme).x[-1, 4],
        )
        for way in ways:
            if not restored:
                with refused(co.IntegrationError, "converge", "take a smaller step"):
                    way()
                continue
            y = way()
            for C in system.casimirs.values():
                assert abs(C(y) - C(x)) <= 16 * UNIT_ROUNDOFF * np.sum(np.abs(x * C.gradient(x)))


@pytest.mark.parametrize("h", [0.3, -0.3])
@pytest.mark.parametrize("scheme", PROJECTING, ids=str)
def test_tangents_where_gradients_are_dependent_everywhere(scheme, h):
    system, x = DEPENDENT["Casimirs of Casimirs"]
    step = co.stepper(system, scheme, h)
    np.testing.assert_allclose(step.tangent(x), difference_of(step, np.array(x)), rtol=0, atol=1e-8)


def check_nearest_point(base, system, h, x=None):
    """y - z is a combination of the gradients at the step z of the base, and the values at y are those at x."""
    method, x = co.Projected(base), start_of(system) if x is None else x
    z, y = co.stepper(system, base, h)(x), co.stepper(system, method, h)(x)
    invariants = [(system.energy, system.hamiltonian.gradient)]
    invariants += [(C, C.gradient) for C in system.casimirs.values() if isinstance(C, co.Polynomial)]
    gradients = np.array([gradient(z) for _, gradient in invariants])
    rest = (y - z) - gradients.T @ np.linalg.lstsq(gradients.T, y - z, rcond=None)[0]
    assert np.max(np.abs(rest)) < 16 * UNIT_ROUNDOFF
    for value, gradient in invariants:
        terms = np.sum(np.abs(x * gradient(x))) + abs(value(x))
        change = abs(value(y) - value(x))
        assert change < 16 * UNIT_ROUNDOFF * terms or change == 0.0 == terms
    assert np.max(np.abs(y - method.step(system, x, 0.0, h))) < 256 * UNIT_ROUNDOFF
    assert np.max(np.abs(y - x)) > 1e-3


def difference_of(step, x, e=1e-3):
    """Richardson's difference of order 4 of a step, one column for each coordinate."""
    wide, narrow = (
        np.stack([(step(x + d * unit) - step(x - d * unit)) / (2 * d) for unit in np.eye(len(x))], axis=1)
        for d in (2 * e, e)
    )
    return (4 * narrow - wide) / 3


@pytest.mark.parametrize("h", [0.4, -0.4])
@pytest.mark.parametrize("scheme", [co.Projected(co.ExplicitRungeKutta("runge2")), co.Taylor(2)], ids=str)
@pytest.mark.parametrize("name", ["cubic alone", "degrees up to 8 in one block"])
def test_tangents_of_long_projections_are_derivatives(name, scheme, h):
    """Multipliers are so large that second derivatives at the step of the base and at its projection differ."""
    system = LARGE[name]
    x = start_of(system)
    step, base = co.stepper(system, scheme, h), getattr(scheme, "base", co.Taylor(2, projected=False))
    # Truncation e^4 and rounding u/e balance at e = 1e-3, times derivatives of fifth order.
    np.testing.assert_allclose(step.tangent(x, t=0.7), difference_of(step, x), rtol=0, atol=1e-8)
    assert np.abs(step(x) - co.stepper(system, base, h)(x)).max() > 1e-3


def test_values_are_those_of_the_start_of_the_run():
    """Each step is off by less than what rounding may leave; from step to step that would add up."""
    base, span, step = co.ExplicitRungeKutta("rk4"), (0, 100), 2**-7
    kept = co.integrate(E3, start_of(E3), span, step, co.Projected(base), save_every=1000)
    alone = co.integrate(E3, start_of(E3), span, step, base, save_every=1000)
    # An invariant of degree two in six coordinates, and what the projection accepts.
    bound = (36 + 4) * UNIT_ROUNDOFF * np.max(np.sum(kept.x**2, axis=1))
    for name, drift in kept.drift(relative=False).items():
        assert drift < bound < alone.drift(relative=False)[name] / 10


def test_a_projection_that_fails_knows_the_time():
    system = LARGE["cubic alone"]
    for scheme in (co.Projected(co.ExplicitRungeKutta("runge2")), co.Taylor(2)):
        for take in (scheme.step, scheme.tangent):
            with refused(co.IntegrationError, "projection", "converge") as failure:
                take(system, start_of(system), 0.75, 0.8)
            assert (failure.value.time, failure.value.step) == (0.75, 1) and failure.value.residual > 1e-12


SCALING = co.LiePoissonSystem(co.algebras.get("A2,1"), co.Quadratic([0.0, 0.0], linear=[1.0, 1.0]))


def run(system, base, end=1.0, step=0.1):
    return co.integrate(system, start_of(system), (0, end), step, co.Projected(base))


def test_a_singular_step_of_the_base_is_a_failure():
    backward = np.sign(SCALING.vector_field(start_of(SCALING))[1] * start_of(SCALING)[1])
    with refused(co.IntegrationError, "singular"):
        run(SCALING, co.Kahan(), 2.0 * backward, 2.0)
