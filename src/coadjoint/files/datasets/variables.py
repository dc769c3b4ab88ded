"""Variables of the dataset of a solution: name -> dimensions, values and attributes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.configuration.swept_settings import as_coordinates
from coadjoint.files.datasets.state_arrays import COMPLEX_PARTS, split_complex, state_dimensions
from coadjoint.files.records.records import safe_name
from coadjoint.systems.batch import Batch
from coadjoint.systems.system_checks import unforced

if TYPE_CHECKING:
    from coadjoint.runs.solution import Drift, Solution

Variables = dict[str, tuple[tuple[str, ...], Any, dict[str, Any]]]


class ExtraMetadata(NamedTuple):
    """Additional coordinates and attributes written with a solution."""

    coordinates: Variables
    attributes: Mapping[str, Any]

    def with_batch_parameters(self, system: Any) -> ExtraMetadata:
        """Add the numbers in which the systems of a batch differ."""
        return self._replace(coordinates={**parameters_of(system), **self.coordinates})


NO_METADATA = ExtraMetadata({}, {})
CONVENTIONS = "CF-1.11"
TIME = "time"


def cf_attributes(long_name: str) -> dict[str, Any]:
    """Return CF attributes of a quantity, in the units of the system.

    Examples
    --------
    >>> cf_attributes("energy")
    {'long_name': 'energy', 'units': '1'}
    """
    return {"long_name": long_name, "units": "1"}


def time_coordinate(times: NDArray[np.float64]) -> Variables:
    """Return the time coordinate of the saved points."""
    return {TIME: ((TIME,), times, cf_attributes("time"))}


def time_variables(solution: Solution) -> Variables:
    """Return the variables at the saved points, except the times."""
    over, x = ("time", *_member(solution)), solution.x
    found: Variables = {
        "x": ((*over, *state_dimensions(x, len(over))), split_complex(x), cf_attributes("momentum")),
        "energy": (over, solution.energy, cf_attributes("energy")),
    }
    series_of = [("casimir", solution.casimirs), ("observed", solution.observed)]
    for kind, series in series_of:
        for label, (name, values) in _labels(kind, series):
            found[label] = (over, values, cf_attributes(name))
    if solution.work:
        done = [values for of_force in solution.work.values() for values in of_force.values()]
        about = "what a force has changed of an invariant since the start"
        found["work"] = ((*over, "account"), np.stack(done, axis=-1), cf_attributes(about))
    if solution.attitude is not None:
        found["attitude"] = ((*over, "row", "column"), solution.attitude, cf_attributes("group element"))
    return found


def summary_variables(solution: Solution) -> Variables:
    """Return the variables of the whole run: deviations of invariants, and failures of members."""
    member = _member(solution)
    over = "in each tenth of the run, over " + ("every step" if solution.watched else "the saved points")
    changes, about = solution.change(), f"largest absolute deviation from the start {over}"
    dims = (*member, "invariant", "tenth")
    found: Variables = {"change" if solution.work else "drift": (dims, _tenth_array(changes), cf_attributes(about))}
    if solution.work:
        about = f"largest absolute deviation of an invariant, less the work of all forces, {over}"
        found["balance"] = (dims, _balance_array(solution.balance(), changes), cf_attributes(about))
    if solution.failed is not None:
        found["failed"] = (
            member,
            solution.failed,
            {"long_name": "whether the member failed; its later states are NaN"},
        )
    return found


def start_variables(solution: Solution) -> Variables:
    """Return the initial states and group elements."""
    member, x0 = _member(solution), solution.x0
    of_state = state_dimensions(x0, len(member))
    found: Variables = {"x0": ((*member, *of_state), split_complex(x0), cf_attributes("initial momentum"))}
    if solution.attitude0 is not None:
        found["attitude0"] = ((*member, "row", "column"), solution.attitude0, cf_attributes("initial group element"))
    return found


def coordinates_of(solution: Solution) -> Variables:
    """Return the times, and the labels of the other dimensions."""
    system, of_state = solution.system, state_dimensions(solution.x0, len(_member(solution)))
    found = time_coordinate(solution.t)

    def put(name: str, values: Any, about: str) -> None:
        found[name] = ((name,), np.asarray(values), {"long_name": about})

    if of_state == ("component",):
        algebra = system[0].algebra if isinstance(system, Batch) else system.algebra
        names = list(algebra.basis) if algebra else [f"x{i + 1}" for i in range(system.dim)]
        put("component", names, "element of the basis")
    elif of_state[-1] == "part":
        put("part", list(COMPLEX_PARTS), "part of a complex number")
    changes = solution.change()
    put("invariant", list(changes), "what the motion keeps")
    tenths = next(iter(changes.values())).tenths.shape[-1]
    put("tenth", np.arange(1, tenths + 1), "number of a tenth of the run")
    if solution.work:
        put("account", [f"{force}: {name}" for force, name in accounts_of(solution)], "force, and what it changes")
    return found


def parameters_of(system: Any) -> Variables:
    """Return the numbers in which the systems of a batch differ, over the members, named like those of a sweep.

    Examples
    --------
    >>> import coadjoint as co
    >>> bodies = co.batch([co.systems.rigid_body(inertia=(1, 2, c)) for c in (2.5, 3.0)])
    >>> parameters_of(bodies)
    {'swept_inertia_2': (('member',), array([2.5, 3. ]), {'long_name': 'system.parameters.inertia[2]'})}
    """
    if not isinstance(system, Batch):
        return {}
    given = [unforced(member).parameters or {} for member in system]
    differing = dict[str, list[Any]]()
    for name in given[0]:
        each = [parameters.get(name) for parameters in given]
        shapes = {_shape_of_numbers(value) for value in each}
        if len(shapes) == 1 and None not in shapes:
            differing[f"system.parameters.{name}"] = each
    found = over_members(differing)
    return {name: entry for name, entry in found.items() if np.any(entry[1] != entry[1][0])}


def over_members(values: Mapping[str, list[Any]]) -> Variables:
    """Return the settings of a sweep, key -> values, as coordinates over the members."""
    return {
        name: (("member",), numbers, {"long_name": place}) for name, (place, numbers) in as_coordinates(values).items()
    }


def _shape_of_numbers(value: Any) -> tuple[int, ...] | None:
    """Return the shape of a number or of an array of numbers; None for anything else."""
    try:
        array = np.asarray(value)
    except ValueError:  # ragged lists
        return None
    return array.shape if array.dtype.kind in "iuf" else None


def accounts_of(solution: Solution) -> list[tuple[str, str]]:
    """Return the pairs of force and invariant for which work is recorded."""
    return [(force, name) for force, of_force in solution.work.items() for name in of_force]


def _member(solution: Solution) -> tuple[str, ...]:
    return () if solution.failed is None else ("member",)


def _balance_array(balance: Mapping[str, Drift], changes: Mapping[str, Drift]) -> NDArray[np.float64]:
    """Return the balance of every invariant; NaN for those without account."""
    unknown = np.full_like(next(iter(changes.values())).tenths, np.nan)
    return np.stack([balance[name].tenths if name in balance else unknown for name in changes], axis=-2)


def _tenth_array(found: Mapping[str, Drift]) -> NDArray[np.float64]:
    return np.stack([drift.tenths for drift in found.values()], axis=-2)


def _labels(kind: str, series: Mapping[str, Any]) -> Iterable[tuple[str, tuple[str, Any]]]:
    """Assign unique variable names, also to names that differ only in characters not allowed in files."""
    taken: dict[str, tuple[str, Any]] = {}
    for name, values in series.items():
        label, number = f"{kind}_{safe_name(name)}", 2
        while label in taken:
            label, number = f"{kind}_{safe_name(name)}_{number}", number + 1
        taken[label] = (name, values)
    return taken.items()
