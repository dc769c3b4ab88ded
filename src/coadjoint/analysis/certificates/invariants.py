"""Checks of energy and Casimirs: errors in one step, and their growth over a long run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.analysis.certificates.certificate import INAPPLICABLE, UNDECIDED, Row, checked, declaration
from coadjoint.analysis.certificates.reference import Norm, motion
from coadjoint.analysis.certificates.subject import Subject
from coadjoint.analysis.powers import growth
from coadjoint.errors import IntegrationError
from coadjoint.methods.protocol.properties import Properties
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.results.quantities import sum_of_absolute_terms
from coadjoint.runs.results.solution import Solution
from coadjoint.systems.hamiltonians.quadratic import Quadratic

Floats = NDArray[np.float64]

STEPS = 2000  # of the long run; a drift of one unit of round-off a step is then plain
MIN_STEPS = 32
"""Smallest default number of steps of the long run; fewer steps do not show the growth of deviations."""
TIME_LIMIT = 3.0  # seconds, about, of the long run
SAVED_POINTS = 128  # of the long run, enough to classify the growth of deviations
MAX_GROWTH_FACTOR = 16.0  # of a state; beyond it, round-off of the start dominates
SIZE_SAMPLES = 8
"""Number of points along the run at which the sizes of the invariants are evaluated."""


def keeps(properties: Properties, casimir: Any) -> bool:
    """Return whether a scheme declares that it preserves a Casimir."""
    if properties.casimirs == "all":
        return True
    if not isinstance(casimir, Polynomial | Quadratic) or properties.casimirs == "none":
        return False
    return properties.casimirs == "polynomial" or isinstance(casimir, Quadratic) or casimir.degree <= 2


def steps_of(subject: Subject) -> int:
    """Return the number of steps of the long run: as given, or limited to `TIME_LIMIT` of computing time."""
    if subject.steps is not None:
        return subject.steps
    return min(STEPS, max(MIN_STEPS, subject.affordable(TIME_LIMIT)))


def long_run(subject: Subject) -> tuple[Solution | None, IntegrationError | None]:
    """Integrate from every state, halving the steps until that succeeds; return the run, and the first failure."""
    # Also where states have grown by more than `MAX_GROWTH_FACTOR`: the step is then too large for the motion, and the
    # linear systems are worse conditioned than the bounds on round-off assume.
    count, failure = steps_of(subject), None
    start = subject.norm(subject.states, axis=1)
    while count:
        try:
            run = subject.run(subject.states, subject.h, count, max(1, count // SAVED_POINTS), watch=True)
        except IntegrationError as error:
            failure = failure or error
        else:
            if count == 1 or np.all(subject.norm(run.x, axis=-1) <= MAX_GROWTH_FACTOR * start):
                return run, failure
        count //= 2
    return None, failure


def run_row(subject: Subject, failure: IntegrationError | None) -> Row:
    """Return the row on completion of the long run, which any scheme that declares something must reach."""
    key, what, declared = "run", "long run", "ends"
    count, reason = steps_of(subject), ""
    if subject.steps is None and count < STEPS:
        seconds = subject.seconds * len(subject.states) * STEPS
        reason = f"a step takes about {subject.seconds:.1g} s; steps={STEPS} would take about {seconds:.2g} s"
    steps = f"{count} steps of {subject.h:g} from {len(subject.states)} states"
    declares = any(claim is not None for claim in (subject.order, subject.symmetric, subject.properties))
    if failure is None:
        return checked(key, what, declared, declares, True, steps, reason=reason)
    if motion(subject.system, subject.states, failure.time + subject.h) is None:
        reason = "an independent code cannot compute the motion so far either"
        return Row(key, what, declared, str(failure), UNDECIDED, reason=reason)
    return checked(key, what, declared, declares, False, str(failure))


def invariant_rows(
    subject: Subject, run: Solution | None, failure: IntegrationError | None, coarse_step: float
) -> list[Row]:
    """Return a row for the energy, and one for each Casimir; `coarse_step` is the larger step that is tested."""
    system, properties = subject.system, subject.properties
    single = _single_steps(subject, coarse_step)
    rows = []
    for name, invariant in {"energy": system.hamiltonian, **system.casimirs}.items():
        energy = invariant is system.hamiltonian
        key = name if energy else f"casimir {name}"
        what = "energy" if energy else f"Casimir {name}"
        claimed = False
        if properties is not None:
            claimed = properties.energy if energy else keeps(properties, invariant)
        declared = declaration(None if properties is None else claimed)
        if energy and system.hamiltonian.timed:
            reason = "the Hamiltonian depends on time"
            rows.append(Row(key, what, declared, "-", INAPPLICABLE, claimed=claimed, reason=reason))
        else:
            row = checked(key, what, declared, claimed, None)
            rows.append(_row(subject, run, failure, single, name, invariant, row))
    return rows


def _single_steps(subject: Subject, coarse_step: float) -> list[tuple[float, Solution]]:
    runs = []
    for h in dict.fromkeys((subject.h, coarse_step)):
        try:
            runs.append((h, subject.run(subject.states, h, 1)))
        except IntegrationError:
            continue
    return runs


def _row(
    subject: Subject,
    run: Solution | None,
    failure: IntegrationError | None,
    single: list[tuple[float, Solution]],
    name: str,
    invariant: Any,
    row: Row,
) -> Row:
    """Return the row of an invariant: its errors in one step and over the run, each with its round-off bound."""
    noise = subject.noise / (float(np.min(subject.norm(subject.states, axis=1))) or 1.0)
    measurements: list[tuple[float, float, str, str]] = []  # error, bound, text, source of the bound
    evidence: dict[str, Any] = {}
    for h, step in single:
        values = _series(step, name)
        sizes = np.maximum(*(_sizes(invariant, states, subject.norm) for states in step.x))
        errors = np.abs(values[1] - values[0])
        rounding = subject.rounding(h, step.stats.evaluations / len(subject.states)) + 8 * UNIT_ROUNDOFF + 8 * noise
        k = int(np.argmax(errors / np.where(sizes > 0.0, sizes, 1.0)))
        scale = step.drift()[name].scale[k]
        text, source = f"{errors[k] / scale:.2g} in a step of {h:.3g}", "round-off of a step, 4 n u each evaluation"
        measurements.append((float(errors[k] / scale), float(rounding * sizes[k] / scale), text, source))
        evidence[f"errors in a step of {h:.6g}"] = errors
    if run is not None and len(run.t) > 1:
        values = _series(run, name)
        evidence |= {"times": run.t, "deviations": values - values[0]}
        fitted = growth(run.t, values - values[0])
        evidence |= {"window times": fitted.times, "window sizes": fitted.sizes, "power of time": fitted.power}
        drift = run.drift()[name]
        samples = np.linspace(0, len(run.x) - 1, SIZE_SAMPLES).astype(int)
        sizes = np.max([_sizes(invariant, states, subject.norm) for states in run.x[samples]], axis=0) / drift.scale
        members = np.asarray(drift.members)
        k = int(np.argmax(members / np.where(sizes > 0.0, sizes, 1.0)))
        evaluations = run.stats.evaluations / len(subject.states) + run.stats.steps + 1
        rounding = 4 * subject.system.dim * UNIT_ROUNDOFF * evaluations + 8 * noise * run.stats.steps
        value, scale = float(members[k]), drift.scale[k]
        text = f"{value:.2g} after {run.stats.steps} steps, relative to {scale:.2g}, growth {fitted.kind}"
        source = "round-off of the run, 4 n u each evaluation, all of one sign"
        measurements.append((value, float(rounding * sizes[k]), text, source))
    finite = [entry for entry in measurements if np.isfinite(entry[0]) and np.isfinite(entry[1])]
    if not finite or len(finite) < len(measurements):
        return replace(row, reason="its value is not finite" if failure is None else str(failure))
    value, bound, _, source = max(finite, key=lambda entry: entry[0] / entry[1] if entry[1] else np.inf * entry[0])
    texts, reason = ", ".join(text for _, _, text, _ in finite), _shortening(subject, run, failure)
    return row.bounded(value, bound, texts, source=source, reason=reason, evidence=evidence)


def _shortening(subject: Subject, run: Solution | None, failure: IntegrationError | None) -> str:
    """Return the reason for a shorter long run; empty if it has all steps."""
    if failure is not None:
        return "of the steps that did not fail"
    shorter = run is not None and run.stats.steps < steps_of(subject)
    return f"of the steps before a state has grown {MAX_GROWTH_FACTOR:.0f} times" if shorter else ""


def _sizes(invariant: Any, states: Floats, norm: Norm) -> Floats:
    return np.array([size_of(invariant, x, norm) for x in states])


def _series(solution: Solution, name: str) -> Floats:
    return np.asarray(solution.energy if name == "energy" else solution.casimirs[name])


def size_of(invariant: Any, x: Floats, norm: Norm) -> float:
    """Return |gradient| |x| plus the sum of the absolute terms, the effect of rounding in units of u."""
    value = invariant(x) if callable(invariant) else invariant.value(x)
    terms = max(abs(float(value)), float(sum_of_absolute_terms(invariant, x)))
    return terms + float(np.linalg.norm(norm.gradient(_gradient(invariant, x, norm))) * norm(x))


def _gradient(invariant: Any, x: Floats, norm: Norm) -> Floats:
    if getattr(invariant, "gradient", None) is not None:
        return np.asarray(invariant.gradient(x), dtype=np.float64)
    small = 2.0**-17 * (float(np.max(np.abs(norm.scaled(x)))) or 1.0)
    moves = norm.unscaled(small * np.eye(len(x)))
    slopes = [(invariant(x + e) - invariant(x - e)) / (2 * e.sum()) for e in moves]
    return np.array(slopes, dtype=np.float64)
