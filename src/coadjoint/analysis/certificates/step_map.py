"""Checks of the map of a step: symmetry, reversibility under reflections, and the Poisson bracket."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.certificates.certificate import INAPPLICABLE, Row, checked, declaration
from coadjoint.analysis.certificates.convergence import order_of_defects
from coadjoint.analysis.certificates.reference import worst_group
from coadjoint.analysis.certificates.subject import DIRECTIONS, MAX_DENSE_DIM, Subject, directions
from coadjoint.analysis.structure_defects import defect_of_tangent
from coadjoint.errors import IntegrationError
from coadjoint.long_operations import note_progress
from coadjoint.methods.protocol.method import Method
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.derivatives.run_tables import compiled_tangents
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.systems.step_derivatives import AGREEMENT, derivative_of
from coadjoint.systems.system import System

Floats = NDArray[np.float64]
StepMap = Callable[[Floats, float], Floats]

MAX_COORDINATES = 10
"""Largest dimension in which all reflections of coordinates are tested; above it, only x -> -x."""
SLOPE_STEPS, POISSON_SLOPE_STEPS = 6, 4  # lengths of steps for the order of a defect, over factors of 5.7 and 2.8
DIRECTIONS_NOTE = f", seen along {DIRECTIONS} directions"
# Largest relative noise allowed for the iteration error of a step given as a function.
MAX_NOISE = 1e-6
MAX_DIRECTIONAL_DIM = 1100
"""Largest dimension for derivatives along directions on a Lie algebra, for which flows are evaluated in Python."""
MAX_UNDECLARED_DIM = 48
"""Largest dimension in which an undeclared bracket is measured."""
# The operations of a step of the user are not counted; at least this many evaluations of the field are assumed.
MIN_OPERATIONS = 64
DIFFERENCE_FLOOR = 1e-9  # relative error of tangents by differences
DIGITS = 40  # of differences in multiprecision


def _worst(
    cases: Iterable[tuple[Any, ...]], measure: Callable[..., Iterable[tuple[Any, ...]]]
) -> tuple[tuple[Any, ...] | None, str]:
    """Return the (defect, bound, ...) of all cases (h, ...) that is largest relative to its bound, and a failure."""
    worst: tuple[Any, ...] | None = None
    failed = ""
    for case in cases:
        try:
            for found in measure(*case):
                if worst is None or found[0] * worst[1] > worst[0] * found[1]:
                    worst = found
        except (IntegrationError, TypeError, ValueError) as error:
            failed = failed or f"at the step {case[0]:.3g}: {error}"
    return worst, failed


def symmetry_row(subject: Subject, coarse_step: float) -> Row:
    """Return the row on psi_(-h) psi_h = 1; `coarse_step` is the larger step that is tested."""
    claim = subject.symmetric

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
    return replace(row, reason=f"under the reflection ({text})")


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
    row = checked(key, what, declaration(claim), bool(claim), None)
    if subject.system.dim > MAX_DENSE_DIM and not subject.expensive:
        return replace(row, reason=f"its bound needs a dense matrix of dimension {subject.system.dim}")

    def moves(h: float) -> Iterable[tuple[float, float, float]]:
        for x, moved in zip(subject.states, step_map(subject.states, h) - subject.states, strict=True):
            yield float(subject.norm(moved)), _bound(subject, x, h), h

    def move(h: float) -> tuple[float, float]:
        moved = step_map(subject.states, h) - subject.states
        return float(subject.norm(moved)), subject.rounding(h) * float(subject.norm(subject.states)) + subject.noise

    worst, failed = _worst([(h,) for h in dict.fromkeys((subject.h, coarse_step))], moves)
    if worst is None:
        return replace(row, reason=failed)
    defect, bound, h = worst
    fitted = None if subject.expensive and defect <= bound else order_of_defects(coarse_step, SLOPE_STEPS, move)
    measured = f"defect {defect:.2g} at the step {h:.3g}"
    if defect > bound and fitted is not None:
        measured += f", of order {fitted}"
    return row.bounded(
        defect,
        bound,
        measured,
        source="round-off of two steps times the condition of one" + (DIRECTIONS_NOTE if subject.expensive else ""),
        reason=failed,
        evidence={} if fitted is None else {"steps": fitted.steps, "defects": fitted.errors, "slope": fitted.order},
    )


def _bound(subject: Subject, x: Floats, h: float) -> float:
    """Return the round-off of two steps, amplified by the condition of the step back."""
    size = float(subject.norm(x))
    run = subject.run(x, h, 1)
    noise = min(8 * subject.noise, MAX_NOISE * size)
    return 2 * subject.condition(x, h) * (subject.rounding(h, run.stats.evaluations) * size + noise)


def poisson_row(subject: Subject, coarse_step: float) -> Row:
    """Return the row on P J(x) P^T = J(step(x)), with the most accurate tangent P available."""
    # A larger step shows defects of high order.
    properties, n = subject.properties, subject.system.dim
    claimed = properties is not None and properties.poisson
    declared = declaration(None if properties is None else claimed)
    row = checked("poisson", "Poisson bracket", declared, claimed, None)
    # If nothing is declared, one state and one step suffice.
    steps = list(dict.fromkeys((subject.h, coarse_step) if claimed else (coarse_step,)))
    if not _knows_structure_matrix(subject.system):
        return replace(row, verdict=INAPPLICABLE, reason="no structure matrix is known")
    if subject.expensive and n <= (MAX_DENSE_DIM if subject.system.algebra is None else MAX_DIRECTIONAL_DIM):
        return _directional_row(subject, steps, row)
    if n > MAX_UNDECLARED_DIM and not claimed:
        return replace(row, reason=f"nothing is declared, and derivatives of dimension {n} may take long")
    if n > MAX_DENSE_DIM:
        return replace(row, reason=f"it needs dense matrices of dimension {n}")

    def defects(h: float, x: Floats) -> Iterable[tuple[float, float, float, str]]:
        defect, bound, by = _defect(subject, x, h)
        yield defect, bound, h, by

    def defect_of_first(h: float) -> tuple[float, float]:
        defect, bound, _ = _defect(subject, subject.states[0], h)
        return defect, bound / 64

    worst, reason = _worst(itertools.product(steps, subject.states if claimed else subject.states[:1]), defects)
    if worst is None:
        return replace(row, reason=reason)
    defect, bound, h, by = worst
    measured = f"defect {defect:.2g} at the step {h:.3g}, tangent by {by}"
    evidence: dict[str, Any] = {"tangent by": by}
    if defect > bound:
        fitted = order_of_defects(coarse_step, POISSON_SLOPE_STEPS, defect_of_first)
        if fitted is not None:
            measured += f", of order {fitted}"
            evidence |= {"steps": fitted.steps, "defects": fitted.errors, "slope": fitted.order}
    elif by == "differences":
        reason = reason or "differences do not resolve smaller defects; a step in complex or mpmath numbers would"
    return row.bounded(
        defect,
        bound,
        measured,
        source="64 u |P|^2 |J| times the operations" if by != "differences" else "floor of differences, 1e-9 |P|^2 |J|",
        reason=reason,
        evidence=evidence,
    )


def _directional_row(subject: Subject, steps: list[float], row: Row) -> Row:
    """Return the row for expensive steps, from derivatives of a step and of the step back along some directions."""
    # P J(x) P^T = J(y) is equivalent to P J(x) = J(y) Q^T, where y is the step and Q the derivative of the step back at
    # y. For covectors a and b, the difference is measured by b.P J(x) a and -a.Q J(y) b.
    if not subject.symmetric:
        reason = f"a step takes about {subject.seconds:.1g} s, and all of P is needed since no step back inverts it"
        return replace(row, reason=reason)

    def defects(h: float) -> Iterable[tuple[float, float, bool, float]]:
        yield *_directional_defect(subject, subject.states[0], h), h

    worst, reason = _worst([(h,) for h in steps], defects)
    if worst is None:
        return replace(row, reason=reason)
    defect, bound, exact, h = worst
    return row.bounded(
        defect,
        bound,
        f"defect {defect:.2g} at the step {h:.3g}, by tangents along {DIRECTIONS} directions there and back",
        source="64 u (|P J| + |Q J|) times the operations" if exact else "floor of differences, 1e-9 (|P J| + |Q J|)",
        reason=reason,
    )


def _directional_defect(subject: Subject, x: Floats, h: float) -> tuple[float, float, bool]:
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


def _carried(method: Method, system: Any, x: Floats, t: float, h: float, vectors: Floats) -> Floats:
    """Return tangent vectors (n, k) after a step; compiled loops and flows carry them without the whole derivative."""
    compiled = compiled_tangents(method, system, h, np.ascontiguousarray(vectors.T))
    found = None if compiled is None else compiled(x, t, None)
    if found is not None:
        return found
    return method.tangent_on(system, x, t, h, vectors)


def _apply_structure(system: Any, x: Floats, vectors: Floats) -> Floats:
    if system.has_structure_constants:
        return np.asarray(system.algebra.structure_operator(x) @ vectors)
    return np.asarray(system.structure_matrix(x) @ vectors)


def _mean_size(columns: Floats, n: int) -> float:
    return float(np.sqrt(n * np.mean(np.sum(columns**2, axis=0))))


def _knows_structure_matrix(system: System) -> bool:
    """Return whether J(x) is known: by structure constants or a function, or because a class defines it."""
    defined = type(system).structure_matrix is not System.structure_matrix
    return defined or system.structure_function is not None or system.has_structure_constants


def _defect(subject: Subject, x: Floats, h: float) -> tuple[float, float, str]:
    system = subject.system
    after = subject.run(x, h, 1)
    P, by = _tangent(subject, x, h)
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


def _tangent(subject: Subject, x: Floats, h: float) -> tuple[Floats, str]:
    """Return the derivative P (n, n) of a step from time 0, in the most accurate way available, and that way."""
    # All but "differences" are accurate to round-off.
    method, system = subject.method, subject.system
    try:
        by = method.tangent_by(system, x, 0.0, h)
        compiled = subject.tangents(h) if by == "formula" else None
        # None if there is no such loop, or the result is not finite.
        P = None if compiled is None else compiled(x, 0.0, None)
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
            return precise, "multiprecision"
    return P, by


def _differences(subject: Subject, x: Floats, h: float) -> tuple[str, Floats]:
    def step(y: Any) -> Any:
        if np.iscomplexobj(y):
            return subject.method.step(subject.system, y, 0.0, h)
        return subject.run(np.asarray(y, dtype=np.float64), h, 1).x[-1]

    norm = subject.norm
    _, derivative, by = derivative_of(norm.function(step), norm.scaled(x))
    return by, norm.unscaled_matrix(derivative)


def _multiprecision_differences(subject: Subject, x: Floats, h: float) -> Floats | None:
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
