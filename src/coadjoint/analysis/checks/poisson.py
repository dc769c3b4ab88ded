"""Is a step a Poisson map? P J(x) P^T - J(step(x)), with the tangent P as exact as the scheme allows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.certificate import INAPPLICABLE, Row, verdict
from coadjoint.analysis.checks.slope import Slope, slope_of_defects
from coadjoint.analysis.checks.subject import LARGEST_DENSE, Subject
from coadjoint.analysis.checks.tangents import FLOOR_OF_DIFFERENCES, tangent
from coadjoint.analysis.poisson_defect import defect_of_tangent
from coadjoint.errors import IntegrationError

SLOPES = 4
# The roundings of a step that is a function are not counted. They are taken as those of so many evaluations of the
# field.
UNCOUNTED = 64


def poisson_row(subject: Subject, telling: float) -> Row:
    """Return the row on the Poisson bracket.

    Parameters
    ----------
    subject : Subject
        What is looked at.
    telling : float
        A larger step, at which the scheme is still near the motion: defects of high order are seen there.

    Returns
    -------
    Row
    """
    properties = subject.claims.properties
    claimed = properties is not None and properties.poisson
    declared = "nothing" if properties is None else "kept" if claimed else "not kept"
    key, what, n = "poisson", "Poisson bracket", subject.system.dim
    if not hasattr(subject.system, "structure_matrix"):
        return Row(key, what, declared, "-", INAPPLICABLE, claimed=claimed, reason="no structure matrix is known")
    if n > LARGEST_DENSE:
        why = f"it needs dense matrices of dimension {n}"
        return Row(key, what, declared, "-", verdict(claimed, None), claimed=claimed, reason=why)
    worst: tuple[float, float, float, str] | None = None
    reason = ""
    # Where nothing is declared, one state and one step are enough.
    states = subject.states if claimed else subject.states[:1]
    for h in dict.fromkeys((subject.h, telling) if claimed else (telling,)):
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
        found = _slopes(subject, telling)
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


def _defect(subject: Subject, x: NDArray[np.float64], h: float) -> tuple[float, float, str]:
    system = subject.system
    after = subject.run(x, h, 1)
    found = tangent(subject, x, h)
    counted = after.stats.evaluations if found.by == "formula" else max(after.stats.evaluations, UNCOUNTED)
    operations = (counted + 4) * system.dim
    J = system.structure_matrix(x)
    seen = defect_of_tangent(found.P, J, system.structure_matrix(after.x[-1]), operations=operations)
    floor = 0.0 if found.exact else FLOOR_OF_DIFFERENCES * float(np.linalg.norm(found.P) ** 2 * np.linalg.norm(J))
    return seen.defect, max(seen.bound, floor), found.by


def _slopes(subject: Subject, largest: float) -> Slope | None:
    """Return the power of the step that the defect at the first state follows."""

    def look(h: float) -> tuple[float, float]:
        defect, bound, _ = _defect(subject, subject.states[0], h)
        return defect, bound / 64

    return slope_of_defects(largest, SLOPES, look)
