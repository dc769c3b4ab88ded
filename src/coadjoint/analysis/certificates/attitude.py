"""Check of the group element: spatial momentum, invariant form of the group, and convergence to the exact element."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.representation import invariant_form
from coadjoint.analysis.certificates.certificate import INAPPLICABLE, Row, checked, verdict
from coadjoint.analysis.certificates.convergence import Study, allowed_error
from coadjoint.analysis.certificates.reference import motion, worst_group
from coadjoint.analysis.certificates.subject import Subject
from coadjoint.analysis.powers import FLOOR_FACTOR
from coadjoint.errors import IntegrationError
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.results.solution import Solution
from coadjoint.systems.coordinates import CoordinateGroups

Floats = NDArray[np.float64]

MAX_DIM = 64
"""Largest dimension in which the coadjoint matrix is integrated."""
MAX_REFERENCE_DIM = 16
"""Largest dimension in which the group element is compared with an independent integration."""
SAVED_POINTS = 16  # of a run with elements, each of which is compared
MAX_WORK = 5e7
"""Bound on steps times the cube of the dimension, which limits the steps with an element on large algebras."""
TIME_LIMIT, MIN_STEPS, MAX_STEPS = 1.0, 4, 2**53
"""Approximate time limit of the steps with an element, and the limits of their number."""
MAX_CONDITION = 1e3  # of an element; rounding grows with it, and the bound with its square
CONSERVING_KINDS = ("every representation", "coadjoint")

Measurement = tuple[float, float, str]
"""Defect, bound, and description of the measurement."""


def attitude_rows(subject: Subject, study: Study | None, steps: int) -> list[Row]:
    """Return the rows on the group element over at most `steps` steps, or one row with the reason if there is none."""
    system, properties = subject.system, subject.properties
    kind = "none" if properties is None else properties.attitude
    reason = ""
    if system.algebra is None:
        reason = "the system has no Lie algebra"
    elif kind == "none":
        reason = "the scheme carries none"
    elif steps == 0:
        reason = "no step could be taken"
    elif system.dim > MAX_DIM:
        reason = f"the coadjoint matrix of dimension {system.dim} is not carried for this"
    if reason:
        claimed = system.algebra is not None and kind != "none"
        result = verdict(claimed, None) if claimed else INAPPLICABLE
        return [Row("attitude", "group element", kind, "-", result, claimed=claimed, reason=reason)]
    steps = max(min(steps, SAVED_POINTS), min(steps, int(MAX_WORK / system.dim**3)))
    matrix_steps = min(steps, _affordable(subject, "coadjoint"))
    claimed = kind in CONSERVING_KINDS
    rows = [
        _row(subject, "spatial momentum", "spatial momentum", kind, claimed, lambda: _momentum(subject, matrix_steps))
    ]
    representation = system.representation
    if representation is not None and _supports_attitude(subject):
        form = invariant_form(representation)
        if form is not None:
            count = min(steps, _affordable(subject, representation))
            rows.append(_row(subject, "group", "group of a form", kind, claimed, lambda: _form(subject, form, count)))
        if kind == "every representation":
            rows.append(
                _row(
                    subject, "element", "one group element", kind, claimed, lambda: _one_element(subject, matrix_steps)
                )
            )
    # Without a declared order the rate of convergence of the element is unknown.
    if study is not None and subject.order is not None and system.dim <= MAX_REFERENCE_DIM:
        rows.append(_row(subject, "attitude", "limit of the element", kind, True, lambda: _limit(subject, study)))
    return rows


def _row(
    subject: Subject, key: str, what: str, kind: str, claimed: bool, measure: Callable[[], Measurement | None]
) -> Row:
    row = checked(key, what, kind, claimed, None)
    try:
        measurement = measure()
    except IntegrationError as error:
        return replace(row, reason=str(error))
    if measurement is None:
        return replace(row, reason="the group element could not be computed")
    source = "round-off of the run, 4 d u each evaluation"
    if key == "attitude":
        source = "6 times the error that the last change of the step implies, and round-off"
    return row.bounded(*measurement, source=source)


def _affordable(subject: Subject, representation: Any) -> int:
    """Return the number of steps with an element that fit into the time limit, by the cost model."""
    seconds = subject.seconds_with(representation) * len(subject.states)
    return max(MIN_STEPS, int(TIME_LIMIT / seconds)) if seconds > 0.0 else MAX_STEPS


def _supports_attitude(subject: Subject) -> bool:
    try:
        subject.method.check_attitude(subject.system, subject.system.representation)
    except ValueError:
        return False
    return True


def _run(subject: Subject, attitude: Any, steps: int) -> tuple[Solution, Floats, float]:
    """Run the steps, halved until the condition is at most `MAX_CONDITION`; return run, elements and condition."""
    # A rounding error at time s is multiplied by g_s^-1 g_t until time t, so elements that grow and shrink lose digits.
    while True:
        try:
            run = subject.run(subject.states, subject.h, steps, max(1, steps // SAVED_POINTS), attitude)
        except IntegrationError:
            if steps == 1:
                raise
        else:
            assert run.attitude is not None
            condition = _condition(subject, run, attitude)
            if condition <= MAX_CONDITION or steps == 1:
                return run, run.attitude, condition
        steps //= 2


def _condition(subject: Subject, run: Solution, attitude: Any) -> float:
    """Return the largest factor by which elements multiply rounding errors until the end of the run."""
    # For groups of coordinates with different units it is the growth of the bound of a group of K x by K_s K_s^-1.
    groups, g = CoordinateGroups(subject.system), np.asarray(run.attitude)
    if attitude != "coadjoint" or groups.count == 1:
        values = np.linalg.svd(g, compute_uv=False)
        return float(np.max(values[..., 0] / np.maximum(values[..., -1], np.finfo(float).tiny)))
    sizes = np.max(groups.matrix_norms(g), axis=0)
    end = np.max(_sizes_of_moved(groups, run), axis=0)
    moved = sizes @ np.max(groups.matrix_norms(np.asarray(np.linalg.inv(g))), axis=0) @ end[..., None]
    return float(np.max(np.divide(moved[..., 0], end, out=np.ones_like(end), where=end > 0.0)))


def _sizes_of_moved(groups: CoordinateGroups, run: Solution) -> Floats:
    """Return the bounds (times, members, groups) of the groups of K x."""
    return np.asarray((groups.matrix_norms(np.asarray(run.attitude)) @ groups.norms(run.x)[..., None])[..., 0])


def _rounding(subject: Subject, run: Solution) -> float:
    assert run.attitude is not None
    evaluations = run.stats.evaluations / len(subject.states) + run.stats.steps + 1
    return 4 * run.attitude.shape[-1] * UNIT_ROUNDOFF * evaluations


def _norm(matrices: Floats) -> Floats:
    return np.asarray(np.linalg.norm(matrices, axis=(-2, -1)))


def _momentum(subject: Subject, steps: int) -> Measurement:
    """Measure the spatial momentum K x, which is constant; K is the coadjoint matrix."""
    run, K, condition = _run(subject, "coadjoint", steps)
    moved = np.einsum("kmij,kmj->kmi", K, run.x) - run.x[0]
    groups = CoordinateGroups(subject.system)
    defects = np.max(groups.norms(moved), axis=(0, 1))
    bounds = _rounding(subject, run) * (np.max(_sizes_of_moved(groups, run), axis=(0, 1)) * condition)
    defect, bound = worst_group(defects, bounds)
    return defect, bound, f"moves by {defect:.2g} in {run.stats.steps} steps"


def _form(subject: Subject, form: Floats, steps: int) -> Measurement:
    """Measure g^T P g - P, with P the invariant form of the representation (the unit matrix for rotations)."""
    run, g, condition = _run(subject, True, steps)
    defect = float(np.max(_norm(np.swapaxes(g, -1, -2) @ form @ g - form)))
    size = float(np.max(_norm(g)) ** 2 * np.linalg.norm(form)) * condition
    name = "g^T g - 1" if np.array_equal(form, np.eye(len(form))) else "g^T P g - P"
    return defect, 2 * _rounding(subject, run) * size, f"{name} is {defect:.2g} after {run.stats.steps} steps"


def _one_element(subject: Subject, steps: int) -> Measurement:
    """Compare the element of the representation with the coadjoint matrix: rho_i g = g sum_j K_ij rho_j."""
    rho = np.asarray(subject.system.representation)
    K_run, K, K_condition = _run(subject, "coadjoint", steps)
    g_run, g, g_condition = _run(subject, True, K_run.stats.steps)
    if g_run.stats.steps < K_run.stats.steps:
        K_run, K, K_condition = _run(subject, "coadjoint", g_run.stats.steps)
    left = np.einsum("iab,kmbc->kmiac", rho, g)
    right = np.einsum("kmab,kmij,jbc->kmiac", g, K, rho, optimize=True)
    groups = CoordinateGroups(subject.system)
    defects = np.max(groups.norms(_norm(left - right)), axis=(0, 1))
    sizes = _norm(g)[..., None] * (groups.matrix_norms(K) @ groups.norms(_norm(rho)))
    rounding = 2 * (_rounding(subject, g_run) + _rounding(subject, K_run))
    bounds = rounding * (np.max(sizes, axis=(0, 1)) * max(g_condition, K_condition))
    defect, bound = worst_group(defects, bounds)
    return defect, bound, f"representation and coadjoint matrix differ by {defect:.2g} after {g_run.stats.steps} steps"


def _limit(subject: Subject, study: Study) -> Measurement | None:
    """Compare the element at small steps with an independent integration."""
    n, x = subject.system.dim, subject.states[0]
    start = np.concatenate([x, np.eye(n).ravel()])
    reference = motion(subject.system, start[None], study.span, subject.norm.with_matrix(n), element=True)
    if reference is None:
        return None
    element = reference.states[0, n:].reshape(n, n)
    size = float(_norm(subject.norm.matrix(element)))
    # The smallest step at which the error of the momentum is above round-off, else the smallest step.
    measurable = [k for k, error in enumerate(study.errors) if error > FLOOR_FACTOR * study.floors[k]]
    count = study.counts[measurable[-1] if measurable else len(study.counts) - 1]
    runs = [subject.run(x, study.span / steps, steps, attitude="coadjoint") for steps in (count, 2 * count)]
    elements = [run.attitude[-1] for run in runs if run.attitude is not None]
    error = float(_norm(subject.norm.matrix(elements[1] - element))) / size
    change = float(_norm(subject.norm.matrix(elements[1] - elements[0]))) / size
    floor = FLOOR_FACTOR * (2 * reference.error + UNIT_ROUNDOFF * (8 + 2 * np.sqrt(runs[1].stats.evaluations)))
    text = f"error {error:.2g} at the step {abs(study.span) / (2 * count):.3g}, against {reference.by}"
    return error, floor + allowed_error(change, 0.5 ** (subject.order or 1)), text
