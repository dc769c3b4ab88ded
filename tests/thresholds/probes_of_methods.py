"""Thresholds of `methods/`, `kernels/` and `runs/`."""

import warnings

import numpy as np

import coadjoint as co
from coadjoint.runs.tangent_stretching import make_orthonormal
from coadjoint.runs.times import times_between
from thresholds.probing import U, accepted, limit, probe, sides

COMPOSITION, TIMES = "methods/composition.py", "runs/times.py"
BODY = co.systems.rigid_body((1, 2, 3))


@limit(("methods/gauss_legendre.py", "MAX_STAGES"), at=256)
def stages_are_not_too_many(stages):
    return accepted(lambda: co.GaussLegendre(stages), "256")


@limit(("methods/taylor.py", "MAX_ORDER"), at=64)
def an_order_of_taylor_is_in_range(order):
    return accepted(lambda: co.Taylor(order), "64")


@sides(("methods/taylor.py", "MIN_TOLERANCE"), below=2e-18, above=0.5e-18)
@sides(("methods/taylor.py", "MAX_TOLERANCE"), below=0.05, above=0.2)
def a_tolerance_of_taylor_is_in_range(tolerance):
    return accepted(lambda: co.Taylor(tolerance=tolerance), "tolerance")


@limit(("methods/isospectral_gauss.py", "MAX_STAGES"), at=8)
def isospectral_stages_are_not_too_many(stages):
    return accepted(lambda: co.IsospectralGauss(stages), "8")


@probe((COMPOSITION, "MAX_SUM"), at=1000.0)
def coefficients_are_not_too_large(total):
    """A sum of absolute values of three, symmetric, that add up to 1."""
    a = (total + 1.0) / 4.0
    return accepted(lambda: co.Composition(co.Splitting(order=2), (a, 1.0 - 2.0 * a, a)), "add up")


@probe(
    (
        COMPOSITION,
        "abs(total - 1.0) > 4 * len(self.coefficients) * UNIT_ROUNDOFF * sum(map(abs, self.coefficients))",
    ),
    at=4 * 3 * U * 3.0,
)
def coefficients_add_up_to_one(off):
    return accepted(lambda: co.Composition(co.Splitting(order=2), (1.0, -1.0 + off, 1.0)), "add up to 1")


@limit((COMPOSITION, "MAX_SUBSTEPS"), at=1000)
def substeps_are_not_too_many(count):
    """A mean of equal steps, of a composition of one step."""
    base = co.Composition(co.Splitting(order=2), (1.0,))
    return accepted(lambda: co.Composition(base, (1.0 / count,) * count), "substeps")


@probe(
    ("methods/protocol/composed.py", "UNIT_ROUNDOFF * 8 * len(coefficients) * scale ** order"),
    at=24 * U * 1.7024143839193153**3,
)
def a_triple_jump_has_order_four(off):
    """Its condition 2 a^3 + (1 - 2 a)^3 = 0 is missed by `off`."""
    a = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
    a += off / (6.0 * a**2 - 6.0 * (1.0 - 2.0 * a) ** 2)
    return co.Composition(co.Splitting(order=2), (a, 1.0 - 2.0 * a, a)).order == 4


@probe(
    ("methods/kahan.py", "deviation <= 64 * system.dim * UNIT_ROUNDOFF * largest"),
    at=64 * 3 * U,
)
def a_structure_matrix_is_linear(off):
    """J(x) of so(3) and a part of second degree; its largest share of J, at the points that are tried, is `off`."""
    draw = np.random.default_rng(1993)
    shares = []
    for size in (1.0, 1.0, 32.0):
        a, b = size * draw.standard_normal((2, 3))
        shares.append(2.0 * abs(a[2] * b[2]) / max(np.abs(point).max() for point in (a, b, a + b)))
    bent = off / max(shares)

    def J(x):
        z = x[2] + bent * x[2] ** 2
        return np.array([[0 * z, -z, x[1]], [z, 0 * z, -x[0]], [-x[1], x[0], 0 * z]])

    return accepted(lambda: co.Kahan().properties(co.PoissonSystem(J, co.Quadratic((1.0, 2.0, 3.0)))))


@probe(("methods/spherical_midpoint.py", "np.abs(cyclic - first) <= 8 * UNIT_ROUNDOFF * np.abs(first)"), at=8 * U)
def three_coordinates_are_those_of_a_spin(off):
    algebra = co.LieAlgebra.from_brackets(3, {(0, 1): {2: 1.0}, (1, 2): {0: 1.0}, (2, 0): {1: 1.0 + off}})
    system = co.LiePoissonSystem(algebra, co.Quadratic((1.0, 2.0, 3.0)))
    return accepted(lambda: co.integrate(system, (1, 2, 3), (0, 0.1), 0.1, co.SphericalMidpoint()), "spins")


@probe((TIMES, "TIME_ROUNDING"), at=256 * U)
def a_step_divides_the_span(off):
    """Sixteen steps, with the rounding of sixteen times of this size."""
    (found,) = {
        accepted(lambda ends=ends: times_between(ends, (1.0 + off) / 16.0, 1), "divide")
        for ends in ((0.0, 1.0), (1.0, 0.0))
    }
    return found


@probe((TIMES, "STEP_SHARE"), at=0.01)
def rounding_of_many_steps_is_a_small_part_of_one(share):
    return accepted(lambda: times_between((0.0, 2.0**26 + share), 1.0, 2**20), "divide")


@sides((TIMES, "quotient < 2.0 ** 53"), below=2.0**51, above=2.0**54)
def steps_can_be_counted(count):
    """Between these the steps are shorter than the distance of the times."""
    return accepted(lambda: times_between((-0.4375, 0.4375), 0.875 / count, 2**40), "counted")


@probe(at=0.25)
def times_can_be_told_apart(share):
    """The last place of the times, as a part of the step."""
    step = np.spacing(2.0**40) / share
    return accepted(lambda: times_between((2.0**40, 2.0**40 + 8.0 * step), step, 1), "neighbouring")


@limit(("runs/events.py", "MAX_EVENTS"), at=64)
def events_are_not_too_many(count):
    return accepted(lambda: co.integrate(BODY, (1, 2, 3), (0.0, 1.0), 0.5, events=[co.Event(0)] * count), "64")


@probe(("runs/output_times.py", "ULP_TOLERANCE"), at=4)
def a_time_is_that_of_a_step(places):
    """In the last places of the end, before which the body turns far."""
    end = 2.0**20
    times = [0.5 * end, 0.5 * end + places * np.spacing(end)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", co.LargeStepWarning)
        first, second = co.integrate(BODY, (1, 2, 3), (0.0, end), 0.25 * end, co.Splitting(), t_eval=times).x
    return np.array_equal(first, second)


@probe(("runs/tangent_stretching.py", "NEARLY_DEPENDENT"), at=2.0**-26)
def vectors_are_nearly_dependent(angle):
    return make_orthonormal(np.array([[1.0, np.cos(angle)], [0.0, np.sin(angle)]])) is None
