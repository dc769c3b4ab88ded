"""Thresholds of `analysis/`: what counts as round-off in a certificate, and limits."""

from functools import cache

import numpy as np

import coadjoint as co
from coadjoint.analysis.certificates.claims import scheme_and_claims
from coadjoint.analysis.checks.convergence import allowed_error
from coadjoint.analysis.checks.reference import motion, natural_time
from coadjoint.analysis.fits import fit_order
from coadjoint.analysis.periods import period
from coadjoint.analysis.poisson_defect import defect_of_tangent
from thresholds.probing import U, accepted, limit, perturbed, probe, sides

TURNING = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic((0.0, 0.0, 1.0)), sign=1)
KEPT = co.methods.Properties(poisson=True, energy=True, casimirs="all", attitude="none")


@cache
def verdicts(size=0.0, speed=0.0, order=None, plain=False):
    """Verdicts on a step that is exact but for a factor of the state, and one of the speed.

    The speed may have an error of some order in h; a plain step takes no complex numbers.
    """

    def step(x, h):
        x = x.astype(float, casting="safe") if plain else x
        angle = x[2] * h * (1.0 + speed * (1.0 if order is None else abs(h) ** order))
        turn = np.array(
            [[np.cos(angle), -np.sin(angle), 0.0 * x[2]], [np.sin(angle), np.cos(angle), 0.0 * x[2]], [0, 0, 1]]
        )
        return (turn @ x) * (1.0 + size)

    found = co.certify(TURNING, step, (0.6, 0.0, 0.8), 0.125, properties=KEPT, order=2, symmetric=True, steps=128)
    return {row.key: row for row in found.rows}


def holds(key, **given):
    found = verdicts(**given)[key].verdict
    assert found in ("holds", "fails")
    return found == "holds"


@probe(
    ("analysis/poisson_defect.py", "64 * UNIT_ROUNDOFF * operations * size"),
    ("analysis/checks/poisson.py", "MIN_OPERATIONS"),
    at=64 * U * (64 + 4) * 3 * 3,
)
def a_step_is_a_poisson_map(off):
    """P = (1 + off) R and J(y) = (1 + off) R J R^T differ by off |J|; |P|^2 is 3, and evaluations are 64 + 4."""
    return holds("poisson", size=off)


@probe(("analysis/poisson_defect.py", "64 * UNIT_ROUNDOFF * operations * size"), at=64 * U * 3 * 10)
def a_tangent_is_one_of_a_poisson_map(off):
    J = np.array([[0.0, 1.0], [-1.0, 0.0]])
    found = defect_of_tangent(np.eye(2), J, (1.0 + off * 2 / 3) * J, operations=10)
    return found.defect <= found.bound


@sides(
    ("analysis/checks/subject.py", "4 * self.system.dim * UNIT_ROUNDOFF * (count + 1)"),
    below=0.5 * 6 * U,
    above=64 * 12 * U,
)
def a_step_back_undoes_a_step(off):
    """2 off against 2 cond 12 u, where the condition of a turn is 3; what is seen of rounding is added."""
    return holds("symmetry", size=off)


@sides(
    (
        "analysis/checks/invariants.py",
        "4 * subject.system.dim * UNIT_ROUNDOFF * evaluations + 8 * noise * solution.stats.steps",
    ),
    below=3 * U,
    above=128 * U,
)
def invariants_are_kept_over_a_run(off):
    """Over n steps |x|^2 grows by 2 n off, and its size is 3: 12 u of that for each, and what is seen of rounding."""
    (found,) = {holds(key, size=off) for key in ("energy", "casimir |x|^2")}
    return found


@probe(
    ("analysis/signals.py", "off <= max(64.0 * UNIT_ROUNDOFF * float(np.max(np.abs(t))), rounding)"), at=129 * 16 * U
)
def times_are_even(off):
    """The rounding of 129 times."""
    t = perturbed(np.arange(129.0) / 128.0, (64,), off)
    return accepted(lambda: co.frequencies(t, np.cos(40.0 * t), count=1), "equidistant")


@sides(("analysis/frequencies.py", "MIN_SAMPLES"), below=64, above=63)
def samples_are_enough_for_frequencies(count):
    t = np.arange(float(count))
    return accepted(lambda: co.frequencies(t, np.cos(t), count=1), "64")


@sides(("analysis/fits.py", "MIN_POINTS"), below=3, above=2)
def errors_are_enough_for_an_order(count):
    h = 0.5 ** np.arange(count)
    return accepted(lambda: fit_order(h, h**2, 1e-15), "needs 3")


@limit(("analysis/backward_error/modified_field.py", "MAX_ORDER"), at=64)
def an_order_of_a_modified_field_is_in_range(order):
    """Refused for its number, and not for the Hamiltonian in time."""
    timed = co.LiePoissonSystem(
        co.algebras.so(3), co.Hamiltonian(lambda x, t: t * x[0], lambda x, t: t * np.array([1.0, 0.0, 0.0]))
    )
    try:
        co.modified_field(timed, co.GaussLegendre(1), order)
    except ValueError as refusal:
        return "time" in str(refusal)
    raise AssertionError("accepted")


@limit(("analysis/certificates/claims.py", "MAX_ORDER"), at=256)
def a_stated_order_is_in_range(order):
    return accepted(lambda: scheme_and_claims(TURNING, lambda x, h: x, order, None, None), "256")


@limit(("analysis/certificates/certify.py", "MAX_STEPS"), at=10**7)
def a_certificate_has_not_too_many_steps(steps):
    """Refused for their number, and otherwise for the state."""
    try:
        co.certify(TURNING, co.GaussLegendre(1), (np.nan, 0, 0), 0.1, steps=steps)
    except ValueError as refusal:
        return "steps" not in str(refusal)
    raise AssertionError("accepted")


@sides(("analysis/certificates/certify.py", "ALLOWED_SIZES"), below=(2e-75, 0.5e75), above=(0.5e-75, 2e75))
def states_of_a_certificate_have_a_size(sizes):
    """States at rest; what is in range is looked at."""
    (found,) = {accepted(lambda s=s: co.certify(TURNING, co.GaussLegendre(1), (s, 0, 0), 0.1, steps=1)) for s in sizes}
    return found


@probe(("analysis/checks/convergence.py", "ERROR_FACTOR"), at=6.0)
def an_error_is_that_of_the_last_change(factor):
    """A change by 3 where the step is halved leaves an error of 1 at order two."""
    return factor <= allowed_error(3.0, 2.0, 2)


@probe(("analysis/checks/reference.py", "CLOSED_FORM_TOLERANCE"), at=1e-8)
def a_closed_form_agrees_with_the_field(off):
    def exact(x, t, attitude=None):
        angle = x[2] * t
        c, s = np.cos(angle), np.sin(angle)
        return np.array([c * x[0] - s * x[1], c * x[1] + s * x[0], x[2] + off * np.linalg.norm(x)])

    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic((0.0, 0.0, 1.0)), exact=exact)
    return not motion(system, np.array([[0.6, 0.0, 0.8]]), 1.0).contradiction


@probe(("analysis/checks/reference.py", "speed > 64 * UNIT_ROUNDOFF * size"), at=64 * U)
def a_state_is_at_rest(speed):
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(np.zeros(3), linear=(0.0, 0.0, speed)))
    return natural_time(system, np.array([1.0, 0.0, 0.0])) == 0.0


@sides(("analysis/fits.py", "FLOOR_FACTOR"), below=1e-13, above=4e-12)
def a_motion_has_the_right_speed(off):
    """After 1.25 radians: 16 times twice the error of the reference, an eighth of what two runs of it differ by."""
    return holds("reference", speed=off)


@probe(("analysis/checks/poisson.py", "DIFFERENCE_FLOOR"), at=3e-9)
def a_tangent_by_differences_is_one_of_a_poisson_map(off):
    """The defect is off |J|, and the floor 1e-9 |P|^2 |J| with |P|^2 = 3."""
    return holds("poisson", size=off, plain=True)


@sides(("analysis/checks/convergence.py", "MARGIN"), below=2.0 - 0.125, above=2.0 - 0.5)
def an_order_is_that_which_is_declared(order):
    """Declared is 2; a quarter is left for what the uncertainty of a slope does not contain."""
    return holds("order", speed=0.01, order=order)


@probe(("analysis/periods.py", "RETURN_TOLERANCE"), at=1e-8)
def an_orbit_returns(off):
    """A spiral that grows by pi off in a turn; the orbit is two wide."""
    growth = off / np.pi
    return accepted(
        lambda: period(lambda y: np.array([growth * y[0] - y[1], y[0] + growth * y[1]]), (1.0, 0.0)), "return"
    )


@probe(("analysis/periods.py", "EQUILIBRIUM_SPEED"), at=2.0**-40 * np.sqrt(2.0))
def a_state_beside_a_centre_is_at_rest(speed):
    """Turns about a point at the distance `speed`; the rate is the norm of the derivative of the field, sqrt(2)."""
    try:
        period(lambda y: np.array([-y[1], y[0] - 1.0 + speed]), (1.0, 0.0))
    except ValueError as refusal:
        return "at rest" in str(refusal)
    return False


def stability_of_two_bodies(d):
    """A body about an axis of inverse inertia 1, beside 1 + d and 0; and another one with the frequency 1."""
    two = co.algebras.copies(co.algebras.so(3), 2)
    bodies = co.LiePoissonSystem(two, co.Quadratic([1.0 + d, 1.0, 0.0, 3.0, 2.0, 2.0]), sign=-1)
    return co.equilibrium(bodies, (0.0, 1.0, 0.0, 1.0, 0.0, 0.0), relax="none").stability


@probe(("analysis/equilibrium.py", "GROWTH"), at=1e-6)
def a_growth_is_round_off(rate):
    return stability_of_two_bodies(rate**2) != "unstable"


@probe(("analysis/equilibrium.py", "ZERO"), at=1e-8)
def a_second_variation_is_not_definite(smallest):
    """It has the eigenvalues -d, -1, -1 and -1."""
    return stability_of_two_bodies(-smallest) != "stable"


@probe(("analysis/orbit.py", "RANK_TOLERANCE"), at=1e-10)
def a_small_spin_does_not_count(size):
    two = co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), 2), co.Quadratic([1.0, 2.0, 3.0] * 2))
    return not accepted(lambda: co.equilibrium(two, (1.0, 0.0, 0.0, size, 0.0, 0.0)), "singular")
