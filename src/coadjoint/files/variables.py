"""What is written of a solution? Variables by their names, each with dimensions, values and what is said of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.records import safe_name
from coadjoint.files.state_arrays import PARTS, in_parts, state_dimensions
from coadjoint.systems.batch import Batch

if TYPE_CHECKING:
    from coadjoint.runs.solution import Drift, Solution

Variables = dict[str, tuple[tuple[str, ...], Any, dict[str, Any]]]


class About(NamedTuple):
    """What else is written beside a solution: coordinates, and attributes."""

    coordinates: Variables
    attributes: Mapping[str, Any]


NOTHING = About({}, {})


def over_time(solution: Solution) -> Variables:
    """Return what a solution has at its saved points, but for the times."""
    over, x = ("time", *_member(solution)), solution.x
    found: Variables = {
        "x": ((*over, *state_dimensions(x, len(over))), in_parts(x), {"long_name": "momentum"}),
        "energy": (over, solution.energy, {"long_name": "energy"}),
    }
    named = [("casimir", solution.casimirs), ("observed", solution.observed)]
    for kind, series in named:
        for label, (name, values) in _labels(kind, series):
            found[label] = (over, values, {"long_name": name})
    if solution.work:
        done = [values for of_force in solution.work.values() for values in of_force.values()]
        about = "what a force has changed of an invariant since the start"
        found["work"] = ((*over, "account"), np.stack(done, axis=-1), {"long_name": about})
    if solution.attitude is not None:
        found["attitude"] = ((*over, "row", "column"), solution.attitude, {"long_name": "group element"})
    return found


def summaries_of(solution: Solution) -> Variables:
    """Return what a solution says of the whole run: how far invariants strayed, and which members failed."""
    member = _member(solution)
    over = "in each tenth of the run, over " + ("every step" if solution.watched else "the saved points")
    changes, about = solution.change(), f"largest absolute deviation from the start {over}"
    dims = (*member, "invariant", "tenth")
    found: Variables = {"change" if solution.work else "drift": (dims, _tenths(changes), {"long_name": about})}
    if solution.work:
        about = f"largest absolute deviation of an invariant, less the work of all forces, {over}"
        found["balance"] = (dims, _balanced(solution.balance(), changes), {"long_name": about})
    if solution.failed is not None:
        found["failed"] = (
            member,
            solution.failed,
            {"long_name": "whether the member failed; its later states are NaN"},
        )
    return found


def starts_of(solution: Solution) -> Variables:
    """Return where a run began."""
    member, x0 = _member(solution), solution.x0
    of_state = state_dimensions(x0, len(member))
    found: Variables = {"x0": ((*member, *of_state), in_parts(x0), {"long_name": "initial momentum"})}
    if solution.attitude0 is not None:
        found["attitude0"] = ((*member, "row", "column"), solution.attitude0, {"long_name": "initial group element"})
    return found


def coordinates_of(solution: Solution) -> dict[str, Any]:
    """Return the times, and the names of what stands along the other dimensions."""
    system, of_state = solution.system, state_dimensions(solution.x0, len(_member(solution)))
    found: dict[str, Any] = {"time": solution.t}
    if of_state == ("component",):
        algebra = system[0].algebra if isinstance(system, Batch) else system.algebra
        found["component"] = list(algebra.basis) if algebra else [f"x{i + 1}" for i in range(system.dim)]
    elif of_state[-1] == "part":
        found["part"] = list(PARTS)
    changes = solution.change()
    found |= {
        "invariant": list(changes),
        "tenth": np.arange(1, next(iter(changes.values())).tenths.shape[-1] + 1),
    }
    if solution.work:
        found["account"] = [f"{force}: {name}" for force, name in accounts_of(solution)]
    return found


def accounts_of(solution: Solution) -> list[tuple[str, str]]:
    """Return the forces and invariants of what is said of work."""
    return [(force, name) for force, of_force in solution.work.items() for name in of_force]


def _member(solution: Solution) -> tuple[str, ...]:
    return () if solution.failed is None else ("member",)


def _balanced(balance: Mapping[str, Drift], changes: Mapping[str, Drift]) -> NDArray[np.float64]:
    """Return the balance of every invariant that changes; NaN of those of which no account is kept."""
    unknown = np.full_like(next(iter(changes.values())).tenths, np.nan)
    return np.stack([balance[name].tenths if name in balance else unknown for name in changes], axis=-2)


def _tenths(found: Mapping[str, Drift]) -> NDArray[np.float64]:
    return np.stack([drift.tenths for drift in found.values()], axis=-2)


def _labels(kind: str, series: Mapping[str, Any]) -> Iterable[tuple[str, tuple[str, Any]]]:
    """Give each name a variable of its own, also where two names differ only in signs that a file does not allow."""
    taken: dict[str, tuple[str, Any]] = {}
    for name, values in series.items():
        label, number = f"{kind}_{safe_name(name)}", 2
        while label in taken:
            label, number = f"{kind}_{safe_name(name)}_{number}", number + 1
        taken[label] = (name, values)
    return taken.items()
