"""Solutions as xarray datasets, with the attributes needed to repeat a run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from coadjoint import __version__
from coadjoint.errors import IntegrationError
from coadjoint.files.datasets.named_axes import axes_attribute, axes_of_system, unstacked
from coadjoint.files.datasets.variables import (
    CONVENTIONS,
    FORMULAS,
    OBSERVED_NAMES,
    angular_motion_variables,
    coordinates_of,
    event_variables,
    parameters_of,
    start_variables,
    summary_variables,
    time_variables,
    vorticity_variables,
)
from coadjoint.files.datasets.writers import with_checksum
from coadjoint.files.records.records import event_record, invariants_record, record_of
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods import registry
from coadjoint.optional_packages import require_packages
from coadjoint.runs.results.solution import Solution, check_solution
from coadjoint.runs.times import times_of
from coadjoint.short_repr import short

if TYPE_CHECKING:
    import xarray


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
    checked_attributes(dataset)
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


def checked_attributes(dataset: Any) -> Mapping[Any, Any]:
    """Return the attributes of a dataset; TypeError if it is something else."""
    attributes = getattr(dataset, "attrs", None)
    if not isinstance(attributes, Mapping):
        raise TypeError(f"{short(dataset)} is no xarray dataset; give one read by xarray")
    return attributes
