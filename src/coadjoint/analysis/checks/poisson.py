"""Check of the Poisson map property, P J(x) P^T = J(step(x)), with the most accurate tangent P available."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.certificates.certificate import INAPPLICABLE, Row, verdict
from coadjoint.analysis.checks.norm import worst_group
from coadjoint.analysis.checks.study import order_of_defects
from coadjoint.analysis.checks.subject import DIRECTIONS, MAX_DENSE_DIM, Subject, directions
from coadjoint.analysis.poisson_defect import defect_of_tangent
from coadjoint.analysis.powers import OrderFit
from coadjoint.errors import IntegrationError
from coadjoint.long_operations import note_progress
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.protocol.step_derivatives import AGREEMENT, derivative_of
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.derivatives.input_derivatives import compiled_tangents
from coadjoint.systems.coordinates import CoordinateGroups

SLOPE_STEPS = 4  # lengths of steps for the order of a defect, over a factor of 2.8
MAX_DIRECTIONAL_DIM = 1100
"""Largest dimension for derivatives along directions on a Lie algebra, for which flows are evaluated in Python."""
MAX_UNDECLARED_DIM = 48
"""Largest dimension in which an undeclared bracket is measured."""
# The operations of a step of the user are not counted; at least this many evaluations of the field are assumed.
MIN_OPERATIONS = 64
DIFFERENCE_FLOOR = 1e-9  # relative error of tangents by differences
DIGITS = 40  # of differences in multiprecision


def poisson_row(subject: Subject, coarse_step: float) -> Row:
    """Return the row on the Poisson bracket; a larger `coarse_step` shows defects of high order."""
    properties = subject.claims.properties
    claimed = properties is not None and properties.poisson
    declared = "nothing" if properties is None else "kept" if claimed else "not kept"
    key, what, n = "poisson", "Poisson bracket", subject.system.dim
    if not subject.system.has_structure_matrix:
        return Row(key, what, declared, "-", INAPPLICABLE, claimed=claimed, reason="no structure matrix is known")
    if subject.expensive and n <= (MAX_DENSE_DIM if subject.system.algebra is None else MAX_DIRECTIONAL_DIM):
        return _directional_row(
            subject, coarse_step, Row(key, what, declared, "-", verdict(claimed, None), claimed=claimed)
        )
    if n > MAX_UNDECLARED_DIM and not claimed:
        reason = f"nothing is declared, and derivatives of dimension {n} may take long"
        return Row(key, what, declared, "-", verdict(claimed, None), claimed=claimed, reason=reason)
    if n > MAX_DENSE_DIM:
        reason = f"it needs dense matrices of dimension {n}"
        return Row(key, what, declared, "-", verdict(claimed, None), claimed=claimed, reason=reason)
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
        fitted = _defect_order(subject, coarse_step)
        if fitted is not None:
            measured += f", of order {fitted}"
            evidence |= {"steps": fitted.steps, "defects": fitted.errors, "slope": fitted.order}
    elif by == "differences":
        reason = reason or "differences do not resolve smaller defects; a step in complex or mpmath numbers would"
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
    """Return the row for expensive steps, from derivatives of a step and of the step back along some directions."""
    # P J(x) P^T = J(y) is equivalent to P J(x) = J(y) Q^T, where y is the step and Q the derivative of the step back at
    # y. For covectors a and b, the difference is measured by b.P J(x) a and -a.Q J(y) b.
    if not subject.claims.symmetric:
        reason = f"a step takes about {subject.seconds:.1g} s, and all of P is needed since no step back inverts it"
        return replace(row, reason=reason)
    worst: tuple[float, float, bool, float] | None = None
    reason = ""
    for h in dict.fromkeys((subject.h, coarse_step) if row.claimed else (coarse_step,)):
        try:
            measured = _directional_defect(subject, subject.states[0], h)
        except (IntegrationError, TypeError, ValueError) as error:
            reason = reason or f"at the step {h:.3g}: {error}"
            continue
        if worst is None or measured[0] * worst[1] > worst[0] * measured[1]:
            worst = (*measured, h)
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
    note_progress(f"derivatives of a step along {DIRECTIONS} directions")
    forward = _carried(method, system, x, 0.0, h, _apply_structure(system, x, a))
    back = _carried(method, system, y, h, -h, _apply_structure(system, y, b))
    exact = method.tangent_by(system, x, 0.0, h) != "differences"
    defect = n * float(np.sqrt(np.mean((b.T @ forward + (a.T @ back).T) ** 2)))
    operations = (max(after.stats.evaluations, MIN_OPERATIONS) + 4) * n
    relative = 64 * UNIT_ROUNDOFF * operations if exact else DIFFERENCE_FLOOR
    return defect, relative * (_mean_size(forward, n) + _mean_size(back, n)), exact


def _carried(
    method: Method, system: Any, x: NDArray[np.float64], t: float, h: float, vectors: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return tangent vectors (n, k) after a step; compiled loops and flows carry them without the whole derivative."""
    compiled = compiled_tangents(method, system, h, np.ascontiguousarray(vectors.T))
    found = None if compiled is None else compiled(x, t, None)
    if found is not None:
        return found
    return method.tangent_on(system, x, t, h, vectors)


def _apply_structure(system: Any, x: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return J(x) applied to vectors in columns."""
    if system.has_structure_constants:
        return np.asarray(system.algebra.structure_operator(x) @ vectors)
    return np.asarray(system.structure_matrix(x) @ vectors)


def _mean_size(columns: NDArray[np.float64], n: int) -> float:
    return float(np.sqrt(n * np.mean(np.sum(columns**2, axis=0))))


def _defect(subject: Subject, x: NDArray[np.float64], h: float) -> tuple[float, float, str]:
    system = subject.system
    after = subject.run(x, h, 1)
    P, by = tangent(subject, x, h)
    counted = after.stats.evaluations if by == "formula" else max(after.stats.evaluations, MIN_OPERATIONS)
    operations = (counted + 4) * system.dim
    J = system.structure_matrix(x)
    image = system.structure_matrix(after.x[-1])
    groups = CoordinateGroups(system)
    if groups.count == 1:
        measured = defect_of_tangent(P, J, image, operations=operations)
        floor = DIFFERENCE_FLOOR * float(np.linalg.norm(P) ** 2 * np.linalg.norm(J)) if by == "differences" else 0.0
        return measured.defect, max(measured.bound, floor), by
    # Each block of J is compared with its own round-off, in any units of the groups.
    defects, sizes = groups.matrix_norms(P @ J @ P.T - image), groups.matrix_norms(P)
    relative = max(64 * UNIT_ROUNDOFF * operations, DIFFERENCE_FLOOR if by == "differences" else 0.0)
    bounds = relative * (sizes @ groups.matrix_norms(J) @ sizes.T)
    return *worst_group(defects, bounds), by


def _defect_order(subject: Subject, largest: float) -> OrderFit | None:
    """Return the power of the step with which the defect at the first state scales."""

    def measure(h: float) -> tuple[float, float]:
        defect, bound, _ = _defect(subject, subject.states[0], h)
        return defect, bound / 64

    return order_of_defects(largest, SLOPE_STEPS, measure)


class Tangent(NamedTuple):
    """The derivative P (n, n) of a step, and how it was computed; all but "differences" are accurate to round-off."""

    P: NDArray[np.float64]
    by: str


def tangent(subject: Subject, x: NDArray[np.float64], h: float) -> Tangent:
    """Return the derivative of a step of length h at x, from time 0, in the most accurate way available."""
    method, system = subject.method, subject.system
    try:
        by = method.tangent_by(system, x, 0.0, h)
        P = _formula(subject, x, h) if by == "formula" else None
        if P is None:
            P = np.asarray(method.tangent(system, x, 0.0, h)[1], dtype=np.float64)
    except TypeError:
        # The system lacks a derivative; differentiate the step itself.
        by, P = _differences(subject, x, h)
    if by == "differences" and not subject.norm.plain:
        # Differences over the size of the state are too long for small groups.
        by, P = _differences(subject, x, h)
    if by == "differences":
        # A step that rounds to float64 internally is detected by the disagreement of both derivatives.
        precise = _multiprecision_differences(subject, x, h)
        size = 1.0 + float(np.linalg.norm(subject.norm.matrix(P)))
        if precise is not None and np.max(np.abs(subject.norm.matrix(precise - P))) <= AGREEMENT * size:
            return Tangent(precise, "multiprecision")
    return Tangent(P, by)


def _formula(subject: Subject, x: NDArray[np.float64], h: float) -> NDArray[np.float64] | None:
    """Return the derivative by the compiled loop; None if there is no such loop, or the result is not finite."""
    compiled = subject.tangents(h)
    return None if compiled is None else compiled(x, 0.0, None)


def _differences(subject: Subject, x: NDArray[np.float64], h: float) -> tuple[str, NDArray[np.float64]]:
    def step(y: Any) -> Any:
        if np.iscomplexobj(y):
            return subject.method.step(subject.system, y, 0.0, h)
        return subject.run(np.asarray(y, dtype=np.float64), h, 1).x[-1]

    norm = subject.norm
    result = derivative_of(norm.function(step), norm.scaled(x))
    return result.by, norm.unscaled_matrix(result.derivative)


def _multiprecision_differences(subject: Subject, x: NDArray[np.float64], h: float) -> NDArray[np.float64] | None:
    """Return central differences in 40 digits, or None if the step does not accept mpmath numbers."""
    try:
        import mpmath
    except ImportError:
        return None
    with mpmath.workdps(DIGITS):
        point = np.array([mpmath.mpf(float(v)) for v in x])
        length, size = mpmath.mpf(h), float(np.max(np.abs(subject.norm.scaled(x)))) or 1.0
        units = np.broadcast_to(subject.norm.units, len(x))
        # The truncation error is 1e-26, the cancellation error 1e-27.
        columns = []
        try:
            for j in range(len(x)):
                small = mpmath.mpf(10) ** -13 * (size * float(units[j]))
                sides = []
                for side in (1, -1):
                    moved = point.copy()
                    moved[j] += side * small
                    after = np.asarray(subject.method.step(subject.system, moved, mpmath.mpf(0), length))
                    if not all(isinstance(value, mpmath.mpf) for value in after.ravel()):
                        return None
                    sides.append(after)
                columns.append([float(value) for value in (sides[0] - sides[1]) / (2 * small)])
        except (TypeError, ValueError, AttributeError, ArithmeticError, IntegrationError):
            return None
        return np.array(columns).T
