"""HTML summary of a run for notebooks."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from coadjoint.short_repr import distinct, html_table
from coadjoint.systems.protocol import member_of

if TYPE_CHECKING:
    from coadjoint.runs.results.solution import Solution
    from coadjoint.runs.results.solution_attributes import Statistics

MAX_CASIMIRS_SHOWN = 4
"""Number of Casimirs shown, largest drift first."""


def is_driven(system: Any) -> bool:
    """Whether the Hamiltonian depends on time; a change of the energy is then not a drift."""
    return bool(getattr(member_of(system).hamiltonian, "timed", False))


def extent_text(solution: Solution) -> str:
    """Return the number of saved points and their times, and what cut a run that has not reached its end.

    Examples
    --------
    >>> import coadjoint as co
    >>> extent_text(co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 1), step=0.1))
    '11 points from t = 0 to 1'
    """
    t = solution.t
    if not solution.incomplete or not len(t):
        first, reached = distinct(*solution.t_span)
    else:
        first, last, reached = distinct(*solution.t_span, t[-1])
        reached = f"{reached} of {last}"
    text = f"{len(t)} points from t = {first} to {reached}"
    return f"{text}, {solution.incomplete}" if solution.incomplete else text


def seconds_text(stats: Statistics) -> str:
    """Return the time of the call, and that in the loop, as text."""
    loop = f"{stats.seconds:.3g} s in the loop"
    return loop if math.isnan(stats.elapsed) else f"{stats.elapsed:.3g} s, {loop}"


def table_of_run(solution: Solution) -> str:
    """Return a summary table of a run in HTML.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 1), step=0.1)
    >>> "<th>drift of energy</th>" in table_of_run(sol), "<th>drift of |x|^2</th>" in table_of_run(sol)
    (True, True)
    """
    rows: dict[str, Any] = {
        "saved": extent_text(solution),
        "step": f"{solution.step:g}, {solution.stats.steps} of them; {seconds_text(solution.stats)}",
    }
    if solution.failed is not None:
        count = int(solution.failed.sum())
        rows["members"] = f"{len(solution.failed)}" + (f", of which {count} have failed" if count else "")
    changes = solution.change()
    energy = changes.pop("energy")
    driven = is_driven(solution.system) or bool(solution.work)
    rows[f"{'change' if driven else 'drift'} of energy"] = f"{energy:.2g}"
    worst = sorted(changes, key=lambda name: -float(changes[name]))
    for name in worst[:MAX_CASIMIRS_SHOWN]:
        rows[f"{'change' if solution.work else 'drift'} of {name}"] = f"{changes[name]:.2g}"
    if len(worst) > MAX_CASIMIRS_SHOWN:
        rows["other Casimirs"] = (
            f"{len(worst) - MAX_CASIMIRS_SHOWN}, none beyond {changes[worst[MAX_CASIMIRS_SHOWN]]:.2g}"
        )
    return html_table(f"{solution.system.name} by {solution.method}", rows)
