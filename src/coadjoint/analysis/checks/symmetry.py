"""Checks of symmetry (a step back inverts a step) and of reversibility under reflections."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.certificates.certificate import INAPPLICABLE, Row, verdict
from coadjoint.analysis.checks.study import order_of_defects
from coadjoint.analysis.checks.subject import DIRECTIONS, MAX_DENSE_DIM, Subject
from coadjoint.analysis.powers import OrderFit
from coadjoint.errors import IntegrationError
from coadjoint.rounding import UNIT_ROUNDOFF

Floats = NDArray[np.float64]
StepMap = Callable[[Floats, float], Floats]

MAX_COORDINATES = 10
"""Largest dimension in which all reflections of coordinates are tested; above it, only x -> -x."""
SLOPE_STEPS = 6  # lengths of steps for the order of a defect, over a factor of 5.7
DIRECTIONS_NOTE = f", seen along {DIRECTIONS} directions"
# Largest relative noise allowed for the iteration error of a step given as a function.
MAX_NOISE = 1e-6


def symmetry_row(subject: Subject, coarse_step: float) -> Row:
    """Return the row on psi_(-h) psi_h = 1; `coarse_step` is the larger step that is tested."""
    claim = subject.claims.symmetric

    def back(x: Floats, h: float) -> Floats:
        return subject.step(subject.step(x, h), -h, h)

    return _row(subject, coarse_step, "symmetry", "a step back undoes a step", claim, back)


def reversibility_row(subject: Subject, coarse_step: float) -> Row:
    """Return the row on R psi_h R psi_h = 1, without a claim, for a reflection R that reverses the motion."""
    what = "reversible as the motion"
    signs = None if subject.system.hamiltonian.timed else reversing(subject)
    if signs is None:
        timed = subject.system.hamiltonian.timed
        reason = "the Hamiltonian depends on time" if timed else "no reflection was found that reverses the motion"
        return Row("reversibility", what, "nothing", "-", INAPPLICABLE, reason=reason)

    def reflected(x: Floats, h: float) -> Floats:
        return np.asarray(signs * subject.step(signs * subject.step(x, h), h))

    row = _row(subject, coarse_step, "reversibility", what, None, reflected)
    text = ", ".join(("-" if sign < 0 else "+") for sign in signs[:12])
    return Row(**{**vars(row), "reason": f"under the reflection ({text})"})


def reversing(subject: Subject) -> Floats | None:
    """Return signs R with R f(R x) = -f(x) at every state, preferably x -> -x; None if there are none."""
    n, field = subject.system.dim, subject.system.vector_field
    candidates: Any = [(-1.0,) * n]
    if n <= MAX_COORDINATES:
        candidates = itertools.chain(candidates, itertools.product((-1.0, 1.0), repeat=n))
    velocities = [np.asarray(field(x)) for x in subject.states]
    for candidate in candidates:
        signs = np.array(candidate)
        for x, velocity in zip(subject.states, velocities, strict=True):
            size = max(float(subject.norm(velocity)), float(subject.norm(x)))
            if not subject.norm(signs * field(signs * x) + velocity) <= 256 * n * UNIT_ROUNDOFF * size:
                break
        else:
            return signs
    return None


def _row(subject: Subject, coarse_step: float, key: str, what: str, claim: bool | None, step_map: StepMap) -> Row:
    claimed = bool(claim)
    declared = "nothing" if claim is None else "kept" if claim else "not kept"
    if subject.system.dim > MAX_DENSE_DIM and not subject.expensive:
        reason = f"its bound needs a dense matrix of dimension {subject.system.dim}"
        return Row(key, what, declared, "-", verdict(claimed, None), claimed=claimed, reason=reason)
    worst: tuple[float, float, float] | None = None
    failed = ""
    for h in dict.fromkeys((subject.h, coarse_step)):
        try:
            for x, moved in zip(subject.states, step_map(subject.states, h) - subject.states, strict=True):
                defect, bound = float(subject.norm(moved)), _bound(subject, x, h)
                if worst is None or defect * worst[1] > worst[0] * bound:
                    worst = (defect, bound, h)
        except (IntegrationError, np.linalg.LinAlgError) as error:
            failed = failed or f"at the step {h:g}: {error}"
    if worst is None:
        return Row(key, what, declared, "-", verdict(claimed, None), claimed=claimed, reason=failed)
    defect, bound, h = worst
    fitted = None if subject.expensive and defect <= bound else _defect_order(subject, step_map, coarse_step)
    measured = f"defect {defect:.2g} at the step {h:.3g}"
    if defect > bound and fitted is not None:
        measured += f", of order {fitted}"
    evidence = {} if fitted is None else {"steps": fitted.steps, "defects": fitted.errors, "slope": fitted.order}
    return Row(
        key,
        what,
        declared,
        measured,
        verdict(claimed, defect <= bound),
        claimed=claimed,
        value=defect,
        bound=bound,
        source="round-off of two steps times the condition of one" + (DIRECTIONS_NOTE if subject.expensive else ""),
        reason=failed,
        evidence=evidence,
    )


def _bound(subject: Subject, x: Floats, h: float) -> float:
    """Return the round-off of two steps, amplified by the condition of the step back."""
    size = float(subject.norm(x))
    run = subject.run(x, h, 1)
    noise = min(8 * subject.noise, MAX_NOISE * size)
    return 2 * subject.condition(x, h) * (subject.rounding(h, run.stats.evaluations) * size + noise)


def _defect_order(subject: Subject, step_map: StepMap, largest: float) -> OrderFit | None:
    def measure(h: float) -> tuple[float, float]:
        moved = step_map(subject.states, h) - subject.states
        floor = subject.rounding(h) * float(subject.norm(subject.states)) + subject.noise
        return float(subject.norm(moved)), floor

    return order_of_defects(largest, SLOPE_STEPS, measure)
