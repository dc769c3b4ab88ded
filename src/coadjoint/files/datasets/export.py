"""Solutions as xarray datasets, with the attributes needed to repeat a run, and as tables of pandas."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint import __version__
from coadjoint.errors import IntegrationError, OneLineError
from coadjoint.files.datasets.named_axes import axes_attribute, axes_of_system, in_order, stacked, unstacked
from coadjoint.files.datasets.variables import (
    CONVENTIONS,
    FORMULAS,
    OBSERVED_NAMES,
    angular_motion_variables,
    coordinates_of,
    event_variables,
    formulas_of,
    parameters_of,
    start_variables,
    state_of,
    summary_variables,
    time_variables,
    vorticity_variables,
)
from coadjoint.files.datasets.writers import with_checksum
from coadjoint.files.records.entries import Entry, as_value_errors, parsed
from coadjoint.files.records.reconstruction import events_of, not_stored
from coadjoint.files.records.records import event_record, invariants_record, record_of, system_of
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.labels import STATE_DIMENSIONS
from coadjoint.methods import registry
from coadjoint.methods.protocol.method import Method
from coadjoint.optional_packages import require_packages
from coadjoint.runs.events import Event
from coadjoint.runs.integrate import integrate
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution, check_solution
from coadjoint.runs.times import times_of
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import coordinate_names
from coadjoint.systems.system_checks import check_system

if TYPE_CHECKING:
    import pandas as pd
    import xarray


REQUIRED_ATTRIBUTES = ("system", "method", "step", "save_every", "watch", "attitude_carried", "t_span", "steps")
ENDED_ATTRIBUTE, TAKEN_ATTRIBUTE = "ended_after", "steps_taken"
"""Attribute with the number of steps after which an event ended the run."""


@suggest_keywords
def dataset_of(solution: Solution, grid: Any = None) -> xarray.Dataset:
    """Return a solution as a dataset whose attributes make it repeatable.

    Variables over ``time`` (and ``member`` for an ensemble): ``x`` over ``component`` (matrices over ``row`` and
    ``column``, complex ones also over ``part``, real and imaginary), ``energy``, ``casimir_<name>``,
    ``observed_<name>``, ``attitude`` over ``row`` and ``column``; of fluids ``vorticity`` on a grid; of bodies
    ``angular_velocity`` and ``angular_momentum`` in the body frame over ``axis``, of several also over ``body``, with
    attitudes as ``quaternion`` (x, y, z, w), and ``wheel_speed`` and ``gimbal_angle`` of rotors;
    ``drift`` over ``invariant`` and ``tenth`` of the run, replaced for systems with forces by ``change``, ``balance``,
    and ``work`` over ``account``; ``x0``, ``attitude0``, and ``event_...`` of crossings. Numbers in which the systems
    of a batch differ are coordinates, such as ``swept_inertia_2``; a batch with named axes has these as dimensions in
    place of ``member``. Names, units and dimensions follow the CF conventions. Attributes: version, system and method
    (JSON), step, times, and the names of functions that cannot be stored.

    Parameters
    ----------
    solution : Solution
        From `integrate`, or the `partial` solution of an `IntegrationError`.
    grid
        As for `Solution.to_xarray`.

    Returns
    -------
    xarray.Dataset

    See Also
    --------
    rebuild : The inverse.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 1), step=0.1)
    >>> dict(dataset_of(sol).sizes)
    {'time': 11, 'component': 3, 'invariant': 2, 'tenth': 10, 'axis': 3}
    """
    require_packages("a dataset of a solution", "xarray")
    import xarray

    check_solution(solution)
    variables = {**time_variables(solution), **summary_variables(solution), **start_variables(solution)}
    if solution.events is not None:
        variables |= event_variables(solution.events)
    fields, of_grid = vorticity_variables(solution, grid)
    variables |= fields | ({} if grid is False else angular_motion_variables(solution))
    coordinates = {**parameters_of(solution.system), **coordinates_of(solution), **of_grid}
    return with_checksum(unstacked(xarray.Dataset(variables, coordinates, attributes_of(solution))))


def attributes_of(solution: Solution) -> dict[str, Any]:
    """Return the attributes of the dataset of a solution."""
    record = record_of(solution.system)
    formulas = invariants_record(getattr(solution.observed, "formulas", {}))
    missing = record.get("not_stored", []) + [f"observed: {name}" for name in solution.observed if name not in formulas]
    times = times_of(solution.asked_span, solution.step, 1)
    attributes: dict[str, Any] = {
        "Conventions": CONVENTIONS,
        "coadjoint_version": __version__,
        "system": json.dumps(record),
        "system_repr": repr(solution.system),
        "sign": solution.system.sign,
        "method": json.dumps(registry.description_of(solution.method)),
        "method_repr": repr(solution.method),
        "step": solution.step,
        "save_every": solution.save_every,
        "between_steps": int(solution.t_eval is not None),
        "watch": int(solution.watched),
        "attitude_carried": solution.carried or "none",
        "t_span": json.dumps(solution.asked_span),
        "steps": times.steps,
        "evaluations": solution.stats.evaluations,
        "iterations": solution.stats.iterations,
        "seconds": solution.stats.seconds,
        "elapsed": solution.stats.elapsed,
    }
    if solution.stats.steps != times.steps:
        attributes[TAKEN_ATTRIBUTE] = solution.stats.steps
    if solution.incomplete and len(solution.t):
        attributes |= incomplete_attributes(solution.incomplete, float(solution.t[-1]))
    if solution.t_span != solution.asked_span:
        attributes[ENDED_ATTRIBUTE] = solution.stats.steps
    attributes |= axes_attribute(axes_of_system(solution.system))
    if solution.observed:
        attributes |= {OBSERVED_NAMES: json.dumps(list(solution.observed)), FORMULAS: json.dumps(formulas)}
    if solution.events is not None:
        asked, dim = solution.events.asked, solution.system.dim
        attributes["events"], functions = event_record(asked, solution.events.names, dim)
        missing += [f"event: {name}" for name in functions]
        if any(event.terminal for event in asked) and functions:
            attributes["events_not_stored"] = ", ".join(functions)
    if missing:
        attributes["not_stored"] = "functions are not stored: " + ", ".join(missing)
    return attributes


def incomplete_attributes(reason: str, time: float) -> dict[str, Any]:
    """Return the attributes of a run that was cut after a time."""
    return {"run_incomplete": 1, "incomplete_reason": reason, "incomplete_time": time}


@suggest_keywords
def mark_failed(dataset: xarray.Dataset, error: IntegrationError) -> xarray.Dataset:
    """Add attributes of the failure to the dataset of a partial solution.

    Parameters
    ----------
    dataset : xarray.Dataset
        Dataset of ``error.partial``.
    error : IntegrationError
        The failure.

    Returns
    -------
    xarray.Dataset
        With ``run_failed`` = 1, ``failed_step``, ``failed_time``, ``failed_residual`` (NaN for an overflow) and
        ``failed_reason``.

    Examples
    --------
    >>> import coadjoint as co, xarray
    >>> error = co.IntegrationError("overflow", step=3, time=0.2, residual=0.0)
    >>> mark_failed(xarray.Dataset(), error).attrs["failed_step"]
    3
    """
    _attributes(dataset)
    return with_checksum(dataset.assign_attrs(**failure_attributes(error)))


def failure_attributes(error: IntegrationError) -> dict[str, Any]:
    """Return the attributes that describe the failure of a run."""
    return {
        "run_failed": 1,
        "failed_step": error.step,
        "failed_time": error.time,
        "failed_residual": error.residual,
        "failed_reason": str(error),
    }


@suggest_keywords
def solution_inputs(dataset: xarray.Dataset, system: Any = None, events: Any = None) -> dict[str, Any]:
    """Return the arguments of `integrate` that repeat the run of a dataset.

    Parameters
    ----------
    dataset : xarray.Dataset
        From `dataset_of`, or read from a file.
    system, events : optional
        Those of the run, if they contain Python functions, which are not stored.

    Returns
    -------
    dict
        ``integrate(**solution_inputs(dataset))``

    Raises
    ------
    TypeError
        The argument is not a dataset.
    ValueError
        Data that determine the motion were not stored, or the dataset is damaged; the message names the entry.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 1), step=0.1)
    >>> solution_inputs(sol.to_xarray())["t_span"]
    (0.0, 1.0)
    """
    inputs = stored_inputs(dataset, system, events)
    if _coadjoint_start(stacked(dataset)) is not None:
        raise ValueError("the run began with its own coadjoint matrix, which `integrate` does not take; use `rebuild`")
    return inputs


def events_of_dataset(dataset: xarray.Dataset, system: Any) -> tuple[Event, ...]:
    """Return the events of a stored run, with `not_stored` for functions."""
    return events_of(dataset.attrs["events"], "events", system) if "events" in dataset.attrs else ()


def _check_registered(description: Any) -> None:
    """Raise OneLineError if a stored scheme, or its base, is not registered in this process."""
    while isinstance(description, Mapping):
        name = description.get("name")
        if isinstance(name, str) and name not in registry.names():
            raise OneLineError(
                f"the method of the run is {name!r}, which is not registered; import the module that registers it first"
            )
        description = description.get("base")


def _attributes(dataset: Any) -> Mapping[Any, Any]:
    """Return the attributes of a dataset; TypeError if it is something else."""
    attributes = getattr(dataset, "attrs", None)
    if not isinstance(attributes, Mapping):
        raise TypeError(f"{short(dataset)} is no xarray dataset; give one read by xarray")
    return attributes


def stored_method(attributes: Mapping[Any, Any]) -> Method:
    """Return the scheme of a stored run."""
    entry = parsed(attributes["method"], "method")
    description = entry.plain_table()
    _check_registered(description)
    with as_value_errors(entry):
        return registry.from_description(description)


def stored_inputs(dataset: xarray.Dataset, system: Any = None, events: Any = None) -> dict[str, Any]:
    """Return the arguments of `solution_inputs`, without its check of the initial coadjoint matrix."""
    attributes = _attributes(dataset)
    missing = [key for key in REQUIRED_ATTRIBUTES if key not in attributes]
    if missing:
        raise ValueError(f"the dataset has no attribute {missing[0]!r}; it was not written by coadjoint")
    dataset = stacked(dataset)
    entries = {key: Entry(attributes[key], key) for key in REQUIRED_ATTRIBUTES}
    x0 = state_of(dataset, "x0", STATE_DIMENSIONS)
    method = stored_method(attributes)
    start, end = (time.number() for time in parsed(attributes["t_span"], "t_span").entries(2))
    step, save_every = entries["step"].number(), entries["save_every"].integer(1)
    with as_value_errors(entries["step"]):
        times = times_of((start, end), step, save_every)
    if times.steps != entries["steps"].integer():
        raise entries["steps"].invalid_error(
            f"{times.steps}, the number of steps of {step!r} from {start!r} to {end!r}"
        )
    carried = entries["attitude_carried"].text()
    initial: dict[str, Any] = {"none": False, "coadjoint": "coadjoint"}
    if carried not in (*initial, "representation"):
        raise entries["attitude_carried"].invalid_error("'none', 'coadjoint' or 'representation'")
    between_steps = Entry(attributes.get("between_steps", 0), "between_steps").flag()
    if "events_not_stored" in attributes and events is None:
        raise ValueError(
            f"the run may have been ended by an event, and {attributes['events_not_stored']} is a function, which was "
            "not stored; run the script that wrote the dataset"
        )
    sizes = dict(dataset["x0"].sizes)
    members = sizes.pop("member", None)
    if given := system is not None:
        check_system(system)
    else:
        system = system_of(parsed(attributes["system"], "system"), int(np.prod(list(sizes.values()))))
    if "component" in sizes:
        system = system.in_numbers  # states of matrices may be rows of numbers
    shape = x0.shape if members is None else x0.shape[1:]
    if given and (system.shape != shape or (system.is_batch and len(system) != members)):
        count = f"{len(system)} members with " if system.is_batch else ""
        raise ValueError(
            f"the given system, {short(system.name, 60)}, has {count}states of shape {system.shape}, but x0 of the run "
            f"has the shape {x0.shape}; give the system of the run, as its solution had it, `sol.system`"
        )
    if "component" in sizes:
        x0 = state_of(in_order(dataset, "component", coordinate_names(system)), "x0", STATE_DIMENSIONS)
    if events is None:
        events = tuple(event for event in events_of_dataset(dataset, system) if event.g is not not_stored)
    return {
        "observe": formulas_of(attributes, system),
        "system": system,
        "x0": x0,
        "t_span": (start, end),
        "step": step,
        "method": method,
        "save_every": save_every,
        "t_eval": state_of(dataset, "time", (("time",),)) if between_steps else None,
        "watch": entries["watch"].flag(),
        "attitude": initial[carried] if carried in initial else state_of(dataset, "attitude0", STATE_DIMENSIONS[1:2]),
        "events": events,
    }


@suggest_keywords
def rebuild(dataset: xarray.Dataset) -> Solution:
    """Repeat the run of a dataset, bitwise, with any number of threads.

    Parameters
    ----------
    dataset : xarray.Dataset
        From `dataset_of`, or read from a file.

    Returns
    -------
    Solution
        The solution, without observed quantities, Casimirs and events that are functions.

    Raises
    ------
    ValueError
        Data that determine the motion were not stored, or the dataset is damaged; the message names the entry.
    IntegrationError
        The run fails, as it did before.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 1), step=0.1)
    >>> bool((rebuild(sol.to_xarray()).x == sol.x).all())
    True
    """
    inputs = stored_inputs(dataset)
    element = _coadjoint_start(stacked(dataset))
    with as_value_errors(Entry(None, "the run of this dataset")):
        if element is None:
            return integrate(**inputs)
        prepared = {name: inputs.pop(name) for name in ("system", "method", "step", "attitude", "watch", "observe")}
        return PreparedRun(**prepared).run(**inputs, attitude=element)


def _coadjoint_start(dataset: xarray.Dataset) -> NDArray[np.float64] | None:
    """Return the initial coadjoint matrix, which `integrate` does not take; None for a unit matrix or none at all."""
    if dataset.attrs["attitude_carried"] != "coadjoint":
        return None
    element = state_of(dataset, "attitude0", STATE_DIMENSIONS[1:2])
    return None if np.array_equal(element, np.broadcast_to(np.eye(element.shape[-1]), element.shape)) else element


def table_of(solution: Solution) -> pd.DataFrame:
    """Return a solution as a table; see `Solution.to_pandas`."""
    require_packages("a table of a solution", "pandas")
    import pandas as pd

    system: Any = solution.system.of_member(0).unforced
    k, members = len(solution.t), None if solution.failed is None else len(solution.failed)
    shape = system.shape
    count = int(np.prod(shape))
    states = solution.x.reshape(k, -1, count)
    if system.has_matrices:
        names: Sequence[str] = ["W" + ",".join(str(i + 1) for i in entry) for entry in np.ndindex(*shape)]
    else:
        names = coordinate_names(system, count)
    columns: dict[str, Any] = {name: states[..., i] for i, name in enumerate(names)}
    observed = {name: np.asarray(values) for name, values in solution.observed.items()}
    numbers = {name: values for name, values in observed.items() if values.ndim == (1 if members is None else 2)}
    invariants = {"energy": solution.energy, **solution.casimirs}
    for what, series in (("invariant", invariants), ("observed", numbers)):
        for name, values in series.items():
            # Names of coordinates, invariants and observed quantities may be equal.
            columns[f"{what} {name}" if name in columns else name] = values.reshape(k, -1)
    if members is None:
        times = pd.Index(solution.t, name="time")
        return pd.DataFrame({name: values[:, 0] for name, values in columns.items()}, index=times)
    index = pd.MultiIndex.from_product([range(members), solution.t], names=["member", "time"])
    return pd.DataFrame({name: values.T.ravel() for name, values in columns.items()}, index=index)
