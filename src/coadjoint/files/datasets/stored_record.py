"""Records of runs in datasets and archives, whose arrays are read by name on first use."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.datasets.variables import OBSERVED_NAMES
from coadjoint.files.records.entries import parsed
from coadjoint.methods.forced import effective_scheme
from coadjoint.runs.results.run_record import FROM_TIMES, RunRecord
from coadjoint.runs.start import Start, start_of
from coadjoint.runs.times import Times, times_of


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


def stored_record(
    arrays: Mapping[str, Any],
    attributes: dict[str, Any],
    read_entire: Callable[[str], NDArray[Any]],
    functions: Mapping[str, Callable[[RunRecord], Any]],
    **values: Any,
) -> RunRecord:
    """Return the record of a run from its stored arrays and attributes; `functions` and `values` add its own fields."""

    def read(name: str) -> NDArray[Any]:
        """Read an entire array; combine real and imaginary parts."""
        entries = read_entire(name)
        return entries[..., 0] + 1j * entries[..., 1] if arrays[name].dims[-1] == "part" else entries

    return RunRecord(
        {**STORED, **functions},
        {
            "arrays": arrays,
            "attributes": attributes,
            "read": read,
            "choice": None,
            "error": None,
            "starts": None,
            **values,
        },
    )


def initial_values(record: RunRecord) -> dict[str, Any]:
    """Return the invariants at the first saved time."""
    values = [record.energy, *record.casimirs.values()]
    return {name: series[0] for name, series in zip(record.names, values, strict=True)}


def _times(record: RunRecord) -> Times:
    attributes = record.attributes
    return times_of(json.loads(attributes["t_span"]), float(attributes["step"]), int(attributes["save_every"]))


def _start(record: RunRecord) -> Start:
    arguments = record.arguments
    system, method = arguments["system"], arguments["method"]
    return start_of(system, effective_scheme(system, method), arguments["x0"], arguments["attitude"])


def _series(record: RunRecord, prefix: str, names: Sequence[str]) -> LazyArrays:
    """Return the arrays whose labels begin with `prefix`, in the order of `names`: Zarr lists arrays alphabetically."""
    labels = {
        str(array.attributes["long_name"]): label for label, array in record.arrays.items() if label.startswith(prefix)
    }
    ordered = {name: labels[name] for name in names if name in labels}
    return LazyArrays({**ordered, **labels}, record.read)


def _observed(record: RunRecord) -> LazyArrays:
    names = parsed(record.attributes.get(OBSERVED_NAMES, "[]"), OBSERVED_NAMES)
    return _series(record, "observed_", [name.text() for name in names.entries()])


def _work(record: RunRecord) -> Mapping[str, Mapping[str, NDArray[np.float64]]]:
    by_force: dict[str, dict[str, NDArray[np.float64]]] = {}
    columns = record.read("work") if record.accounts else np.zeros(0)
    for index, (force, invariant) in enumerate(record.accounts):
        by_force.setdefault(force, {})[invariant] = columns[..., index]
    return by_force


def _carried(record: RunRecord) -> str | None:
    carried_name = str(record.attributes["attitude_carried"])
    return None if carried_name == "none" else carried_name


def _optional(name: str) -> Callable[[RunRecord], NDArray[Any] | None]:
    """Return the function of a field that is None if its array is not stored."""
    return lambda record: record.read(name) if name in record.arrays else None


def _incomplete(record: RunRecord) -> str | None:
    """Return why the run has not reached its end; members that failed do not cut the others."""
    attributes = record.attributes
    if attributes.get("run_incomplete"):
        return str(attributes.get("incomplete_reason", "interrupted"))
    if attributes.get("run_failed") and record.failed is None:
        return "failed"
    return "unfinished" if "finished" in record and not record.finished else None


STORED: Mapping[str, Callable[[RunRecord], Any]] = {
    **FROM_TIMES,
    "arguments": lambda record: record.inputs(),
    "system": lambda record: record.arguments["system"],
    "method": lambda record: record.arguments["method"],
    "watched": lambda record: bool(record.attributes["watch"]),
    "times": _times,
    "start": _start,
    "t": lambda record: record.read("time"),
    "x": lambda record: record.read("x"),
    "x0": lambda record: record.read("x0"),
    "t_eval": lambda record: record.t if record.attributes["between_steps"] else None,
    "names": lambda record: [str(name) for name in record.read("invariant")],
    "energy": lambda record: record.read("energy"),
    "casimirs": lambda record: _series(record, "casimir_", record.names[1:]),
    "work": _work,
    "observed": _observed,
    "attitude": _optional("attitude"),
    "attitude0": _optional("attitude0"),
    "carried": _carried,
    "incomplete": _incomplete,
    "failed": _optional("failed"),
}
