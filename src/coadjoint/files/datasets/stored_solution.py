"""Stored runs: their arguments, and their solutions, whose arrays are read by name on first use."""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import OneLineError, in_one_line
from coadjoint.files.datasets.export import ENDED_ATTRIBUTE, checked_attributes
from coadjoint.files.datasets.named_axes import in_order, stacked
from coadjoint.files.datasets.variables import OBSERVED_NAMES, SIZES, formulas_of, joined_complex, state_of
from coadjoint.files.records.entries import Entry, as_value_errors, parsed
from coadjoint.files.records.reconstruction import events_of, not_stored
from coadjoint.files.records.records import system_of
from coadjoint.labels import STATE_DIMENSIONS
from coadjoint.methods import registry
from coadjoint.methods.forced import effective_scheme
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.events import Event, TerminalEvent
from coadjoint.runs.results.quantities import NamedValues
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.start import Start, start_of
from coadjoint.runs.times import Times, times_of
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import coordinate_names
from coadjoint.systems.system_checks import check_system

if TYPE_CHECKING:
    import xarray

Floats = NDArray[np.float64]
REQUIRED_ATTRIBUTES = ("system", "method", "step", "save_every", "watch", "attitude_carried", "t_span", "steps")


class LazyArrays(Mapping[str, NDArray[Any]]):
    """Arrays by name, read lazily and cached."""

    def __init__(self, labels: Mapping[str, str], read: Callable[[str], NDArray[Any]]) -> None:
        self.labels, self._read, self._cache = dict(labels), read, dict[str, NDArray[Any]]()

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._cache:
            self._cache[name] = self._read(self.labels[name])
        return self._cache[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.labels)

    def __len__(self) -> int:
        return len(self.labels)


class StoredSolution(Solution):
    """The solution of a stored run, from its `path`, its attributes, and its arrays by name."""

    _arrays: Mapping[str, Any]

    @abstractmethod
    def _read_entire(self, name: str) -> NDArray[Any]:
        """Read an array as it is stored."""

    @abstractmethod
    def inputs(self) -> dict[str, Any]:
        """Return the arguments of `integrate` that repeat the run, without its events."""

    def _read(self, name: str) -> NDArray[Any]:
        """Read an entire array; combine real and imaginary parts."""
        return joined_complex(self._read_entire(name), self._arrays[name].dims)

    def _read_if_stored(self, name: str) -> NDArray[Any] | None:
        return self._read(name) if name in self._arrays else None

    def _series(self, prefix: str, names: Sequence[str]) -> LazyArrays:
        """Return the arrays whose labels begin with `prefix`, in the order of `names`: Zarr lists them by alphabet."""
        labels = {
            str(array.attributes["long_name"]): label
            for label, array in self._arrays.items()
            if label.startswith(prefix)
        }
        ordered = {name: labels[name] for name in names if name in labels}
        return LazyArrays({**ordered, **labels}, self._read)

    @cached_property
    def _arguments(self) -> dict[str, Any]:
        return self.inputs()

    @cached_property
    def system(self) -> Any:
        return self._arguments["system"]

    @cached_property
    def method(self) -> Method:
        return stored_method(self.attributes)

    @property
    def _title(self) -> str:
        # The system is not rebuilt, which functions prevent.
        name = parsed(self.attributes["system"], "system")["name"].text()
        return f"{in_one_line(name)} by {self.method}"

    @cached_property
    def _driven(self) -> bool:
        try:
            return super()._driven
        except ValueError:  # its Hamiltonian is a function, which was not stored, and may depend on time
            return True

    @property
    def _forces_keep_casimirs(self) -> bool:
        try:
            return super()._forces_keep_casimirs
        except ValueError:  # as above; balances that are missing are stored as NaN
            missing = np.isnan(self._worst[..., 1 + len(self.casimirs) :])
            return not missing.reshape(-1, missing.shape[-1]).all(axis=0).any()

    @cached_property
    def watched(self) -> bool:
        return bool(self.attributes["watch"])

    @cached_property
    def _times(self) -> Times:
        attributes = self.attributes
        return times_of(json.loads(attributes["t_span"]), float(attributes["step"]), int(attributes["save_every"]))

    @cached_property
    def _start(self) -> Start:
        arguments, system = self._arguments, self.system
        return start_of(system, effective_scheme(system, self.method), arguments["x0"], arguments["attitude"])

    @cached_property
    def t(self) -> Floats:
        return self._read("time")

    @cached_property
    def x(self) -> NDArray[Any]:
        return self._read("x")

    @cached_property
    def x0(self) -> NDArray[Any]:
        return self._read("x0")

    @cached_property
    def _ending(self) -> TerminalEvent | None:
        if ENDED_ATTRIBUTE not in self.attributes:
            return None
        values = np.array([self.energy[-1], *(series[-1] for series in self.casimirs.values())])
        attitude = None if self.attitude is None else self.attitude[-1]
        steps = int(self.attributes[ENDED_ATTRIBUTE])
        return TerminalEvent(len(self.t), steps, float(self.t[-1]), self.x[-1], values, attitude)

    @cached_property
    def t_eval(self) -> Floats | None:
        return self.t if self.attributes["between_steps"] else None

    @cached_property
    def _names(self) -> list[str]:
        """Names of the invariants, the energy first."""
        return [str(name) for name in self._read("invariant")]

    @cached_property
    def energy(self) -> Floats:
        return self._read("energy")

    @cached_property
    def casimirs(self) -> Mapping[str, Floats]:
        return self._series("casimir_", self._names[1:])

    @cached_property
    def initial(self) -> Mapping[str, Any]:
        """Invariants at the first saved time."""
        values = [self.energy, *self.casimirs.values()]
        return NamedValues({name: series[0] for name, series in zip(self._names, values, strict=True)})

    @cached_property
    def observed(self) -> Mapping[str, Floats]:
        names = parsed(self.attributes.get(OBSERVED_NAMES, "[]"), OBSERVED_NAMES)
        return self._series("observed_", names.texts())

    @cached_property
    def work(self) -> Mapping[str, Mapping[str, Floats]]:
        by_force: dict[str, dict[str, Floats]] = {}
        columns = self._read("work") if self._work_integrals else np.zeros(0)
        for index, (force, invariant) in enumerate(self._work_integrals):
            by_force.setdefault(force, {})[invariant] = columns[..., index]
        return NamedValues(by_force)

    @cached_property
    def _worst(self) -> Floats:
        names = ("change", "balance") if self._work_integrals else ("drift",)
        return np.concatenate([np.moveaxis(self._read(name), -2, -1) for name in names], axis=-1)

    @cached_property
    def _scales(self) -> dict[str, Any]:
        sizes = self._read_if_stored(SIZES)
        return super()._scales if sizes is None else {name: sizes[..., i][()] for i, name in enumerate(self._names)}

    @cached_property
    def attitude(self) -> Floats | None:
        return self._read_if_stored("attitude")

    @cached_property
    def attitude0(self) -> Floats | None:
        return self._read_if_stored("attitude0")

    @cached_property
    def carried(self) -> str | None:
        name = str(self.attributes["attitude_carried"])
        return None if name == "none" else name

    @cached_property
    def failed(self) -> NDArray[np.bool_] | None:
        return self._read_if_stored("failed")

    @cached_property
    def incomplete(self) -> str | None:
        """Why the run has not reached its end; members that failed do not cut the others."""
        attributes = self.attributes
        if attributes.get("run_incomplete"):
            return str(attributes.get("incomplete_reason", "interrupted"))
        if attributes.get("run_failed") and self.failed is None:
            return "failed"
        return None


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


def stored_method(attributes: Mapping[Any, Any]) -> Method:
    """Return the scheme of a stored run."""
    entry = parsed(attributes["method"], "method")
    description = entry.plain_table()
    _check_registered(description)
    with as_value_errors(entry):
        return registry.from_description(description)


def stored_inputs(dataset: xarray.Dataset, system: Any = None, events: Any = None) -> dict[str, Any]:
    """Return the arguments of `solution_inputs` but the method, without its check of the initial coadjoint matrix."""
    attributes = checked_attributes(dataset)
    missing = [key for key in REQUIRED_ATTRIBUTES if key not in attributes]
    if missing:
        raise ValueError(f"the dataset has no attribute {missing[0]!r}; it was not written by coadjoint")
    dataset = stacked(dataset)
    entries = {key: Entry(attributes[key], key) for key in REQUIRED_ATTRIBUTES}
    x0 = state_of(dataset, "x0", STATE_DIMENSIONS)
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
        "save_every": save_every,
        "t_eval": state_of(dataset, "time", (("time",),)) if between_steps else None,
        "watch": entries["watch"].flag(),
        "attitude": initial[carried] if carried in initial else state_of(dataset, "attitude0", STATE_DIMENSIONS[1:2]),
        "events": events,
    }
