"""Check of the Poisson map property, P J(x) P^T = J(step(x)), with the most accurate tangent P available."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.certificates.certificate import INAPPLICABLE, Row, verdict
from coadjoint.analysis.checks.slope import Slope, slope_of_defects
from coadjoint.analysis.checks.subject import DIRECTIONS, MAX_DENSE_DIM, Subject, directions
from coadjoint.analysis.checks.tangents import DIFFERENCE_FLOOR, tangent
from coadjoint.analysis.poisson_defect import defect_of_tangent
from coadjoint.errors import IntegrationError
from coadjoint.long_operations import at
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.lie_poisson import LiePoissonSystem

SLOPE_STEPS = 4
MAX_DIRECTIONAL_DIM = 1100
"""Largest dimension for derivatives along directions on a Lie algebra, where each flow is evaluated in Python."""
MAX_UNDECLARED_DIM = 48
"""Largest dimension in which an undeclared bracket is measured."""
# Roundings of a step given as a function are not counted; this many evaluations of the field are assumed.
MIN_OPERATIONS = 64


def poisson_row(subject: Subject, coarse_step: float) -> Row:
    """Return the row on the Poisson bracket.

    `coarse_step` is a larger step at which the scheme still approximates the motion, so that defects of high order are
    visible.
    """
    properties = subject.claims.properties
    claimed = properties is not None and properties.poisson
    declared = "nothing" if properties is None else "kept" if claimed else "not kept"
    key, what, n = "poisson", "Poisson bracket", subject.system.dim
    if not hasattr(subject.system, "structure_matrix"):
        return Row(key, what, declared, "-", INAPPLICABLE, claimed=claimed, reason="no structure matrix is known")
    if subject.expensive and n <= (MAX_DENSE_DIM if subject.system.algebra is None else MAX_DIRECTIONAL_DIM):
        return _directional_row(
            subject, coarse_step, Row(key, what, declared, "-", verdict(claimed, None), claimed=claimed)
        )
    if n > MAX_UNDECLARED_DIM and not claimed:
        why = f"nothing is declared, and derivatives of dimension {n} may take long"
        return Row(key, what, declared, "-", verdict(claimed, None), claimed=claimed, reason=why)
    if n > MAX_DENSE_DIM:
        why = f"it needs dense matrices of dimension {n}"
        return Row(key, what, declared, "-", verdict(claimed, None), claimed=claimed, reason=why)
    worst: tuple[float, float, float, str] | None = None
    reason = ""
    # If nothing is declared, one state and one step suffice.
    states = subject.states if claimed else subject.states[:1]
    for h in dict.fromkeys((subject.h, coarse_step) if claimed else (coarse_step,)):
        for x in states:
            try:
                defect, bound, by = _defect(subject, x, h)
            except (IntegrationError, TypeError, ValueError) as error:
                reason = reason or f"at the step {h:.3g}: {error}"
                continue
            if worst is None or defect * worst[1] > worst[0] * bound:
                worst = (defect, bound, h, by)
    if worst is None:
        return Row(key, what, declared, "-", verdict(claimed, None), claimed=claimed, reason=reason)
    defect, bound, h, by = worst
    measured = f"defect {defect:.2g} at the step {h:.3g}, tangent by {by}"
    evidence: dict[str, Any] = {"tangent by": by}
    if defect > bound:
        found = _slopes(subject, coarse_step)
        if found is not None:
            measured += f", of order {found}"
            evidence |= {"steps": found.steps, "defects": found.errors, "slope": found.value}
    elif by == "differences":
        reason = reason or "differences see no smaller defect; complex numbers, or mpmath's, would"
    source = "64 u |P|^2 |J| times the operations" if by != "differences" else "floor of differences, 1e-9 |P|^2 |J|"
    return Row(
        key,
        what,
        declared,
        measured,
        verdict(claimed, defect <= bound),
        claimed=claimed,
        value=defect,
        bound=bound,
        source=source,
        reason=reason,
        evidence=evidence,
    )


def _directional_row(subject: Subject, coarse_step: float, row: Row) -> Row:
    """Return the row of a scheme with expensive steps, from derivatives of a step and of its inverse along some
    directions.

    P J(x) P^T = J(y) is equivalent to P J(x) = J(y) Q^T, where y is the step and Q the derivative of the step back at
    y. For covectors a and b, the difference is measured by b.P J(x) a and -a.Q J(y) b.
    """
    if not subject.claims.symmetric:
        why = f"a step takes about {subject.seconds:.1g} s; without a step back that undoes it, the whole P is needed"
        return replace(row, reason=why)
    worst: tuple[float, float, bool, float] | None = None
    reason = ""
    for h in dict.fromkeys((subject.h, coarse_step) if row.claimed else (coarse_step,)):
        try:
            seen = _directional_defect(subject, subject.states[0], h)
        except (IntegrationError, TypeError, ValueError) as error:
            reason = reason or f"at the step {h:.3g}: {error}"
            continue
        if worst is None or seen[0] * worst[1] > worst[0] * seen[1]:
            worst = (*seen, h)
    if worst is None:
        return replace(row, reason=reason)
    defect, bound, exact, h = worst
    return replace(
        row,
        measured=f"defect {defect:.2g} at the step {h:.3g}, by tangents along {DIRECTIONS} directions there and back",
        verdict=verdict(row.claimed, defect <= bound),
        value=defect,
        bound=bound,
        source="64 u (|P J| + |Q J|) times the operations" if exact else "floor of differences, 1e-9 (|P J| + |Q J|)",
        reason=reason,
    )


def _directional_defect(subject: Subject, x: NDArray[np.float64], h: float) -> tuple[float, float, bool]:
    """Return the norm of P J(x) - J(y) Q^T by its mean square over directions, its bound, and whether P is exact."""
    method, system, n = subject.method, subject.system, subject.system.dim
    a, b = directions(n, 1), directions(n, 2)
    after = subject.run(x, h, 1)
    y = after.x[-1]
    at(f"derivatives of a step along {DIRECTIONS} directions")
    forward = method.tangent_on(system, x, 0.0, h, _apply_structure(system, x, a))
    back = method.tangent_on(system, y, h, -h, _apply_structure(system, y, b))
    exact = method.tangent_by(system, x, 0.0, h) != "differences"
    defect = n * float(np.sqrt(np.mean((b.T @ forward + (a.T @ back).T) ** 2)))
    operations = (max(after.stats.evaluations, MIN_OPERATIONS) + 4) * n
    each = 64 * UNIT_ROUNDOFF * operations if exact else DIFFERENCE_FLOOR
    return defect, each * (_mean_size(forward, n) + _mean_size(back, n)), exact


def _apply_structure(system: Any, x: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return J(x) applied to vectors in columns."""
    if isinstance(system, LiePoissonSystem):
        return np.asarray(system.algebra.structure_operator(x) @ vectors)
    return np.asarray(system.structure_matrix(x) @ vectors)


def _mean_size(columns: NDArray[np.float64], n: int) -> float:
    return float(np.sqrt(n * np.mean(np.sum(columns**2, axis=0))))


def _defect(subject: Subject, x: NDArray[np.float64], h: float) -> tuple[float, float, str]:
    system = subject.system
    after = subject.run(x, h, 1)
    found = tangent(subject, x, h)
    counted = after.stats.evaluations if found.by == "formula" else max(after.stats.evaluations, MIN_OPERATIONS)
    operations = (counted + 4) * system.dim
    J = system.structure_matrix(x)
    seen = defect_of_tangent(found.P, J, system.structure_matrix(after.x[-1]), operations=operations)
    floor = 0.0 if found.exact else DIFFERENCE_FLOOR * float(np.linalg.norm(found.P) ** 2 * np.linalg.norm(J))
    return seen.defect, max(seen.bound, floor), found.by


def _slopes(subject: Subject, largest: float) -> Slope | None:
    """Return the power of the step with which the defect at the first state scales."""

    def measure(h: float) -> tuple[float, float]:
        defect, bound, _ = _defect(subject, subject.states[0], h)
        return defect, bound / 64

    return slope_of_defects(largest, SLOPE_STEPS, measure)
