"""How is a solution kept outside of this library? As an xarray dataset that says how to repeat the run."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint import __version__
from coadjoint.errors import IntegrationError
from coadjoint.extras import need
from coadjoint.files.record_entries import Entry, made_of, parsed
from coadjoint.files.records import record_of, safe_name, system_of
from coadjoint.files.state_arrays import DIMENSIONS, PARTS, in_parts, state_dimensions, state_of
from coadjoint.files.written_events import events_of, variables_of, written_events
from coadjoint.methods import registry
from coadjoint.runs.times import times_of
from coadjoint.systems.batch import Batch
from coadjoint.systems.matrices.matrix_system import MatrixSystem

if TYPE_CHECKING:
    import xarray

    from coadjoint.runs.solution import Drift, Solution

NEEDED = ("system", "method", "step", "save_every", "watch", "attitude_carried", "t_span", "steps")


def dataset_of(solution: Solution) -> xarray.Dataset:
    """Return a solution as a dataset whose attributes make it repeatable.

    Variables over ``time`` (and ``member`` for an ensemble): ``x`` over ``component`` (of matrices over ``row`` and
    ``column``, and where they are complex over ``part``, real and imaginary), ``energy``, ``casimir_<name>``,
    ``observed_<name>``, ``attitude`` over ``row`` and ``column``; ``drift`` over ``invariant`` and ``tenth`` of the
    run, and in its place with forces ``change``, ``balance``, and ``work`` over ``account``; ``x0`` and ``attitude0``,
    XX Attributes: version, system and method (JSON), step, times, and what cannot be stored (functions).

    Parameters
    ----------
    solution : Solution
        From `integrate`, or the `partial` one of an `IntegrationError`.

    Returns
    -------
    xarray.Dataset

    See Also
    --------
    rebuild : The way back.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 1), step=0.1)
    >>> dict(dataset_of(sol).sizes)
    {'time': 11, 'component': 3, 'invariant': 2, 'tenth': 10}
    """
    need("a dataset of a solution", "xarray")
    import xarray

    system = solution.system
    member = () if solution.failed is None else ("member",)
    over_time = ("time", *member)
    of_state = state_dimensions(solution.x, len(over_time))
    variables: dict[str, Any] = {
        "x": ((*over_time, *of_state), in_parts(solution.x), {"long_name": "momentum"}),
        "energy": (over_time, solution.energy, {"long_name": "energy"}),
    }
    named = [("casimir", solution.casimirs), ("observed", solution.observed)]
    for kind, series in named:
        for label, (name, values) in _labels(kind, series):
            variables[label] = (over_time, values, {"long_name": name})
    over = "in each tenth of the run, over " + ("every step" if solution.watched else "the saved points")
    changes, about = solution.change(), f"largest absolute deviation from the start {over}"
    over_tenths = (*member, "invariant", "tenth")
    variables["change" if solution.work else "drift"] = (over_tenths, _tenths(changes), {"long_name": about})
    if solution.work:
        about = f"largest absolute deviation of an invariant, less the work of all forces, {over}"
        variables["balance"] = (over_tenths, _balanced(solution.balance(), changes), {"long_name": about})
        done = [values for of_force in solution.work.values() for values in of_force.values()]
        about = "what a force has changed of an invariant since the start"
        variables["work"] = ((*over_time, "account"), np.stack(done, axis=-1), {"long_name": about})
    variables["x0"] = ((*member, *of_state), in_parts(solution.x0), {"long_name": "initial momentum"})
    if solution.attitude is not None:
        square = ("row", "column")
        variables["attitude"] = ((*over_time, *square), solution.attitude, {"long_name": "group element"})
        variables["attitude0"] = ((*member, *square), solution.attitude0, {"long_name": "initial group element"})
    if solution.failed is not None:
        variables["failed"] = (
            member,
            solution.failed,
            {"long_name": "whether the member failed; its later states are NaN"},
        )
    if solution.events is not None:
        variables |= variables_of(solution.events)
    coordinates: dict[str, Any] = {"time": solution.t}
    if of_state == ("component",):
        algebra = system[0].algebra if isinstance(system, Batch) else system.algebra
        coordinates["component"] = list(algebra.basis) if algebra else [f"x{i + 1}" for i in range(system.dim)]
    elif of_state[-1] == "part":
        coordinates["part"] = list(PARTS)
    coordinates |= {
        "invariant": list(changes),
        "tenth": np.arange(1, next(iter(changes.values())).tenths.shape[-1] + 1),
    }
    if solution.work:
        pairs = [(force, name) for force, of_force in solution.work.items() for name in of_force]
        coordinates["account"] = [f"{force}: {name}" for force, name in pairs]
    return xarray.Dataset(variables, coordinates, _attributes(solution))


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


def _attributes(solution: Solution) -> dict[str, Any]:
    record = record_of(solution.system)
    missing = [*record.get("not_stored", []), *(f"observed: {name}" for name in solution.observed)]
    times = times_of(solution.asked_span, solution.step, 1)
    attributes: dict[str, Any] = {
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
    }
    if solution.events is not None:
        attributes["events"], functions = written_events(solution.events.asked, solution.events.names)
        missing += [f"event: {name}" for name in functions]
        if any(event.terminal for event in solution.events.asked) and functions:
            attributes["events_not_stored"] = ", ".join(functions)
    if missing:
        attributes["not_stored"] = "functions are not stored: " + ", ".join(missing)
    return attributes


def mark_failed(dataset: xarray.Dataset, error: IntegrationError) -> xarray.Dataset:
    """Return the dataset of a partial solution with attributes that say that the run failed, where, and why.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of ``error.partial``.
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
    return dataset.assign_attrs(
        run_failed=1,
        failed_step=error.step,
        failed_time=error.time,
        failed_residual=error.residual,
        failed_reason=str(error),
    )


def solution_inputs(dataset: xarray.Dataset) -> dict[str, Any]:
    """Return the arguments of `integrate` that repeat the run of a dataset.

    Parameters
    ----------
    dataset : xarray.Dataset
        From `dataset_of`, or read from a file.

    Returns
    -------
    dict
        ``integrate(**solution_inputs(dataset))``

    Raises
    ------
    ValueError
        Something that the motion depends on was not stored, or the dataset is damaged; what is wrong is named.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 1), step=0.1)
    >>> solution_inputs(sol.to_xarray())["t_span"]
    (0.0, 1.0)
    """
    attributes = dataset.attrs
    absent = [key for key in NEEDED if key not in attributes]
    if absent:
        raise ValueError(f"the dataset has no attribute {absent[0]!r}; it was not written by coadjoint")
    given = {key: Entry(attributes[key], key) for key in NEEDED}
    x0 = state_of(dataset, "x0", DIMENSIONS)
    described = parsed(attributes["method"], "method")
    description = {key: entry.plain() for key, entry in described.table().items()}
    with made_of(described):
        method = registry.from_description(description)
    start, end = (time.number() for time in parsed(attributes["t_span"], "t_span").entries(2))
    step, save_every = given["step"].number(), given["save_every"].whole(1)
    with made_of(given["step"]):
        times = times_of((start, end), step, save_every)
    if times.steps != given["steps"].whole():
        raise given["steps"].wrong(f"{times.steps}, the number of steps of {step!r} from {start!r} to {end!r}")
    carried = given["attitude_carried"].text()
    initial: dict[str, Any] = {"none": False, "coadjoint": "coadjoint"}
    if carried not in (*initial, "representation"):
        raise given["attitude_carried"].wrong("'none', 'coadjoint' or 'representation'")
    between = Entry(attributes.get("between_steps", 0), "between_steps").flag()
    if "events_not_stored" in attributes:
        raise ValueError(
            f"the run may have been ended by an event, and {attributes['events_not_stored']} is a function, which was "
            "not stored; run the script that made it"
        )
    system = _system(dataset, system_of(parsed(attributes["system"], "system"), _numbers(dataset["x0"])))
    return {
        "system": system,
        "x0": x0,
        "t_span": (start, end),
        "step": step,
        "method": method,
        "save_every": save_every,
        "t_eval": state_of(dataset, "time", (("time",),)) if between else None,
        "watch": given["watch"].flag(),
        "attitude": initial[carried] if carried in initial else state_of(dataset, "attitude0", DIMENSIONS[1:2]),
        "events": events_of(Entry(attributes["events"], "events"), system) if "events" in attributes else (),
    }


def _numbers(states: xarray.DataArray) -> int:
    """Return how many numbers a state has."""
    return int(np.prod([size for name, size in states.sizes.items() if name != "member"]))


def _system(dataset: xarray.Dataset, system: Any) -> Any:
    """Return a system whose states are as the dataset has them: those of matrices may be rows of numbers."""
    in_numbers = isinstance(system, MatrixSystem) and "component" in dataset["x0"].dims
    return system.in_numbers if in_numbers else system


def rebuild(dataset: xarray.Dataset) -> Solution:
    """Repeat the run of a dataset: the same bits, on any machine and number of threads.

    Parameters
    ----------
    dataset : xarray.Dataset
        From `dataset_of`, or read from a file.

    Returns
    -------
    Solution
        Without observed quantities, and without Casimirs and events that are functions.

    Raises
    ------
    ValueError
        Something that the motion depends on was not stored, or the dataset is damaged; what is wrong is named.
    IntegrationError
        The run fails, as it did.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 1), step=0.1)
    >>> bool((rebuild(sol.to_xarray()).x == sol.x).all())
    True
    """
    from coadjoint.runs.integrate import integrate

    inputs = solution_inputs(dataset)
    with made_of(Entry(None, "the run of this dataset")):
        return integrate(**inputs)
