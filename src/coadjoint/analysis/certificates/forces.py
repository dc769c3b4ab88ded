"""Checks of forces: the flow against the field, the compiled flow against that in NumPy, and the recorded work."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.certificates.certificate import INAPPLICABLE, Row, checked
from coadjoint.analysis.certificates.convergence import MARGIN, measured_order
from coadjoint.analysis.certificates.invariants import size_of
from coadjoint.analysis.certificates.noise import noise_rows
from coadjoint.analysis.certificates.reference import FINE_TOLERANCE, integrated
from coadjoint.analysis.certificates.subject import Subject
from coadjoint.errors import IntegrationError
from coadjoint.methods.forced import Forced
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.forces.base import Force
from coadjoint.systems.system import System
from coadjoint.validation import set_fields

Floats = NDArray[np.float64]
FAILURES = (IntegrationError, ArithmeticError, TypeError, ValueError)

DURATIONS = 6  # of flows, each half of the one before
# Fraction of what a force changes below which a difference is rounding: fields by differences have 12 digits, and
# a contradiction has the size of the change.
CANCELLED = 2.0**-30


def force_rows(subject: Subject, forced: System) -> list[Row]:
    """Return rows on the flow, the compiled flow and the work of each force, on states at the times of steps."""
    order, rows = Forced(subject.method).order, []
    for label, force in zip(forced.labels, forced.forces, strict=True):
        alone = copy.copy(forced)
        vars(alone).pop("in_numbers", None)
        set_fields(alone, forces=(force,), labels=(label,))
        rows.append(_flow_row(subject, forced.unforced, force, label, order))
        rows += _step_rows(subject, alone, label)
        if force.around_steps:
            rows += noise_rows(subject, forced.unforced, force, label)
    return rows


def _timed_states(subject: Subject) -> Iterator[tuple[Floats, float]]:
    return ((x, k * subject.h) for k, x in enumerate(subject.states))


def _flow_row(subject: Subject, system: System, force: Force, label: str, order: int) -> Row:
    """Return the row on the order of the flow in schemes of an order, as a solution of x' = field."""
    row = checked(f"flow of {label}", f"flow of {label}", "that of its field", True, None)
    if force.random:
        return replace(row, verdict=INAPPLICABLE, reason="it is random, and has no field")
    flow = partial(force.flow_of_order, system)
    durations = 0.5 * subject.h / 2.0 ** np.arange(DURATIONS)
    errors, floors, left = np.zeros((3, DURATIONS))
    try:
        for number, (x, t) in enumerate(_timed_states(subject)):
            rate = partial(_rate, force, system, t)
            for k, tau in enumerate(-durations if force.reversible and number % 2 else durations):
                end = integrated(rate, x, tau, subject.norm, FINE_TOLERANCE)
                if end is None:
                    return replace(row, reason="DOP853 cannot solve x' = field")
                after = flow(x.copy(), t, tau, order)
                floor = CANCELLED * subject.norm(end - x) + 64 * UNIT_ROUNDOFF * subject.norm(x)
                errors[k], floors[k] = np.maximum([errors[k], floors[k]], [subject.norm(after - end), floor])
                if order > 2:
                    left[k] = max(left[k], subject.norm(flow(after.copy(), t + tau, -tau, order) - x) - floor)
    except FAILURES as failure:
        return replace(row, reason=str(failure))
    if not np.isfinite(errors).all():
        return replace(row, reason="the flow is not finite")
    fitted = measured_order(np.abs(durations).tolist(), errors.tolist(), floors.tolist())
    # A symmetric flow of order two may be composed to any order.
    least = float(min(order, 2) if np.all(left <= 0.0) else order)
    # Without a fit all errors, or those of shorter durations, are round-off.
    found = np.inf if fitted is None else fitted.order - 1.0
    text = "round-off" if fitted is None else f"order {found:.2f}"
    return checked(
        row.key,
        row.what,
        row.declared,
        True,
        fitted is None or found + fitted.uncertainty >= least - MARGIN,
        f"off by {errors[0]:.2g} over {durations[0]:.3g}, {text}",
        value=None if fitted is None else found,
        bound=least,
        source="order of the step; the slope may be lower by 1/4 and its uncertainty",
        evidence={"durations": np.abs(durations), "errors": errors, "round-off": floors},
    )


def _rate(force: Force, system: System, begin: float, x: Floats, t: float) -> Floats:
    return force.field(system, x, begin + t)


def _step_rows(subject: Subject, system: System, label: str) -> list[Row]:
    """Return the rows on a compiled step with one force: its end and the recorded work, against those in NumPy."""
    names = {f"compiled flow of {label}": "that in NumPy", f"work of {label}": "of its flow"}
    rows = [checked(name, name, declared, True, None) for name, declared in names.items()]
    compared: list[tuple[int, float, float]] = []  # number of the row, defect, bound
    compiled, norm = replace(subject, system=system), subject.norm
    try:
        for x, t in _timed_states(subject):
            run = compiled.run(system.states_of(x), subject.h, 1, t=t)
            end, flows = _step_in_numpy(subject, system, x, t)
            size, moved = float(norm(x)), sum(float(norm(after - y)) for y, after, _ in flows)
            rounding = 8.0 * (subject.rounding(subject.h) + subject.noise / (size or 1.0))
            compared.append((0, float(norm(system.rows_of(run.x[-1]) - end)), CANCELLED * moved + rounding * size))
            for name, invariant in _invariants(system, run.work[label]).items():
                changes = np.array([_change(system, name, *flow) for flow in flows])
                recorded = run.work[label][name][-1] if name in run.work[label] else 0.0
                size = max(size_of(invariant, y, norm) for y in (x, end))
                bound = CANCELLED * float(np.abs(changes).sum()) + rounding * size
                compared.append((1, float(abs(recorded - changes.sum())), bound))
    except FAILURES as failure:
        return [replace(row, reason=str(failure)) for row in rows]
    for k, row in enumerate(rows):
        pairs = [(defect, bound) for one, defect, bound in compared if one == k]
        defect, bound = max(pairs, key=lambda pair: (not pair[0] <= pair[1], pair[0] / (pair[1] or 1.0)))
        measured = f"off by {defect:.2g} in a step of {subject.h:.3g}"
        rows[k] = row.bounded(defect, bound, measured, source="round-off of a step, and of what the force changes")
    return rows


def _invariants(system: System, recorded: Iterable[str]) -> dict[str, Any]:
    """Return the invariants of which the work is recorded, and those that the force preserves."""
    names = system.casimirs if system.forces[0].casimirs else recorded
    return {"energy": system.hamiltonian} | {name: system.casimirs[name] for name in names if name != "energy"}


def _change(system: System, name: str, before: Floats, after: Floats, t: float) -> float:
    """Return the change of an invariant at a time, up to the period of a multivalued one."""
    numbers = system.unforced.in_numbers
    if name == "energy":
        return float(numbers.energy(after, t) - numbers.energy(before, t))
    casimir = numbers.casimirs[name]
    change, period = float(casimir(after) - casimir(before)), getattr(casimir, "period", 0.0)
    return change - period * round(change / period) if period else change


def _step_in_numpy(
    subject: Subject, system: System, x: Floats, t: float
) -> tuple[Floats, list[tuple[Floats, Floats, float]]]:
    """Return the end of a step, and the states before and after each flow with the time of the energy."""
    scheme, y, late = Forced(subject.method), x, 0.0
    flows: list[tuple[Floats, Floats, float]] = []
    for position, part, begin, length in scheme.parts_of_step(system, t, subject.h):
        if position is None:
            y, late = np.asarray(part.step(system.unforced, y.copy(), begin, length)), 1.0
            continue
        after = np.asarray(part.flow_of_order(system.unforced, y.copy(), begin, length, scheme.order))
        # The energy is that at the begin of the substep before the scheme, and at its end after it.
        flows.append((y, after, begin + late * length))
        y, late = after, 0.0
    return y, flows
