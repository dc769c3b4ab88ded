"""Base class of solutions read from archives and datasets."""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.forced import effective_scheme
from coadjoint.runs.solution import Solution
from coadjoint.runs.start import Start, start_of
from coadjoint.runs.times import Times, times_of
from coadjoint.systems.batch import Batch
from coadjoint.systems.system_checks import System


class ReadSolution(Solution):
    """A solution whose parts are arrays by name; `attributes` are those of its dataset."""

    _arrays: Mapping[str, Any]
    attributes: dict[str, Any]

    @abstractmethod
    def inputs(self, events: Any = ()) -> dict[str, Any]:
        """Return the arguments of `integrate` that repeat the run."""

    @abstractmethod
    def _read_entire(self, name: str) -> NDArray[Any]:
        """Read an entire array."""

    @cached_property
    def _inputs(self) -> dict[str, Any]:
        return self.inputs()

    def _read(self, name: str) -> NDArray[Any]:
        """Read an entire array; combine real and imaginary parts."""
        values = self._read_entire(name)
        return values[..., 0] + 1j * values[..., 1] if self._arrays[name].dims[-1] == "part" else values

    @cached_property
    def system(self) -> Any:
        """The system of the run, which must be given on opening if it contains functions."""
        return self._inputs["system"]

    @cached_property
    def method(self) -> Any:  # type: ignore[override]
        return self._inputs["method"]

    @cached_property
    def watched(self) -> bool:  # type: ignore[override]
        return bool(self.attributes["watch"])

    @cached_property
    def _times(self) -> Times:  # type: ignore[override]
        attributes = self.attributes
        return times_of(json.loads(attributes["t_span"]), float(attributes["step"]), int(attributes["save_every"]))

    @cached_property
    def _start(self) -> Start:  # type: ignore[override]
        inputs = self._inputs
        system, method = inputs["system"], inputs["method"]
        return start_of(system, effective_scheme(system, method), inputs["x0"], inputs["attitude"])

    @cached_property
    def _system(self) -> System | Batch:  # type: ignore[override]
        return self.system

    @cached_property
    def t(self) -> NDArray[np.float64]:
        return self._read("time")

    @cached_property
    def x(self) -> NDArray[Any]:
        return self._read("x")

    @cached_property
    def x0(self) -> NDArray[Any]:
        return self._read("x0")

    @cached_property
    def attitude0(self) -> NDArray[np.float64] | None:
        return self._read("attitude0") if "attitude0" in self._arrays else None

    @cached_property
    def attitude(self) -> NDArray[np.float64] | None:
        return self._read("attitude") if "attitude" in self._arrays else None

    @cached_property
    def t_eval(self) -> NDArray[np.float64] | None:
        return self.t if self.attributes["between_steps"] else None

    @cached_property
    def _names(self) -> list[str]:  # type: ignore[override]
        return [str(name) for name in self._read_entire("invariant")]

    @cached_property
    def energy(self) -> NDArray[np.float64]:
        return self._read("energy")

    @cached_property
    def casimirs(self) -> Mapping[str, NDArray[np.float64]]:
        series = self._series("casimir_")
        # Zarr lists arrays alphabetically; restore the order of the invariants.
        ordered = {name: series.labels[name] for name in self._names[1:] if name in series.labels}
        return LazyArrays({**ordered, **series.labels}, self._read)

    @cached_property
    def observed(self) -> Mapping[str, NDArray[np.float64]]:  # type: ignore[override]
        return self._series("observed_")

    def _series(self, kind: str) -> Any:
        labels = {
            str(array.attributes["long_name"]): label for label, array in self._arrays.items() if label.startswith(kind)
        }
        return LazyArrays(labels, self._read)

    @cached_property
    def work(self) -> Mapping[str, Mapping[str, NDArray[np.float64]]]:
        work: dict[str, dict[str, NDArray[np.float64]]] = {}
        for index, (force, invariant) in enumerate(self._accounts):
            work.setdefault(force, {})[invariant] = self._read("work")[..., index]
        return work

    @cached_property
    def failed(self) -> NDArray[np.bool_] | None:
        return self._read("failed") if "failed" in self._arrays else None

    @cached_property
    def carried(self) -> str | None:
        carried_name = str(self.attributes["attitude_carried"])
        return None if carried_name == "none" else carried_name


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
