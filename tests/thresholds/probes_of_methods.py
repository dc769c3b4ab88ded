"""Thresholds of `program/`, `kernels/` and `runs/`."""

import warnings

import numpy as np

import coadjoint as co
from coadjoint.program.parts.bonds import bonds
from coadjoint.program.parts.split import NotSplittable
from coadjoint.program.shifts.group_correction import _cholesky
from coadjoint.runs.tangent_stretching import make_orthonormal
from coadjoint.runs.times import times_between
from thresholds.probing import U, accepted, limit, probe, sides

TIMES = "runs/times.py"
BODY = co.systems.rigid_body((1, 2, 3))


def bonded(system):
    try:
        bonds(system)
    except NotSplittable:
        return False
    return True


@sides(("program/parts/bonds.py", "8 * UNIT_ROUNDOFF"), below=0.0, above=2.0 * U)
def a_coupling_of_spins_is_isotropic(off):
    """Coordinates of spins have the scale 1, and are compared to the last bit."""
    return bonded(co.systems.spin_lattice("chain", 2, tensor=(1.0, 1.0, 1.0 + off)))


@probe(("program/parts/bonds.py", "8 * UNIT_ROUNDOFF"), at=8 * U)
def a_coupling_of_scaled_spins_is_isotropic(off):
    """[e1, e2] = 4 e3, [e2, e3] = e1, [e3, e1] = e2: an isotropic energy has the form (1, 1, 1/4) or the like."""
    brackets = {}
    for k in (0, 3):
        brackets |= {(k, k + 1): {k + 2: 4.0}, (k + 1, k + 2): {k: 1.0}, (k + 2, k): {k + 1: 1.0}}
    algebra = co.LieAlgebra.from_brackets(6, brackets)
    for form in ((1.0, 1.0, 0.25), (1.0, 1.0, 4.0), (4.0, 4.0, 1.0), (0.25, 0.25, 1.0)):
        for place in (0, 2):
            own = list(form)
            M = np.zeros((6, 6))
            M[range(3), range(3, 6)] = M[range(3, 6), range(3)] = own
            if bonded(co.LiePoissonSystem(algebra, co.Quadratic(M))):
                own[place] *= 1.0 + off
                M[range(3), range(3, 6)] = M[range(3, 6), range(3)] = own
                return bonded(co.LiePoissonSystem(algebra, co.Quadratic(M)))
    raise AssertionError("no form is isotropic")


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


@sides(("program/shifts/group_correction.py", "MIN_CHOLESKY_PIVOT"), below=2.0**-19, above=2.0**-21)
def a_form_is_definite(pivot):
    return _cholesky(np.diag([1.0, pivot])) is not None
