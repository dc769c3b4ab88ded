"""State of a run between two steps: all arrays that its loops read and write, for all members."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.interface import kernel_interface, limit
from coadjoint.kernels.loop import ArrayOffsets, Extent, Layout, NamedArrays
from coadjoint.short_repr import short


class State:
    """The state of a run after some steps, compared bitwise; a run resumed from it has the bits of an unbroken one."""

    __slots__ = ("arrays", "number")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, arrays: NamedArrays, number: int = 0) -> None:
        self.arrays, self.number = arrays, number

    @classmethod
    def of_start(cls, layout: Layout, momenta: NDArray[np.float64], groups: Any) -> State:
        """Return the state before the first step, from momenta (members, n) and the group elements of the loops."""
        arrays = NamedArrays(layout.state)
        if layout.extent.size == momenta.shape[1]:
            arrays.numbers[arrays.offsets.slices["momenta"]] = momenta.ravel()
        else:
            # Accounts follow the coordinates, and start at zero.
            arrays["momenta"][:, : momenta.shape[1]] = momenta
        if layout.extent.square:
            arrays["groups"][:] = groups
        return cls(arrays)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.arrays[name]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, State):
            return NotImplemented
        arrays, other_arrays = self.arrays, other.arrays
        return (
            self.number == other.number
            and arrays.offsets.shapes == other_arrays.offsets.shapes
            and np.array_equal(arrays.numbers.view(np.int64), other_arrays.numbers.view(np.int64))
        )

    def __repr__(self) -> str:
        members = len(self["status"])
        return f"<state of {members} member{'s' if members > 1 else ''} after step {self.number}>"

    def copy(self) -> State:
        """Return a deep copy."""
        return State(self.arrays.copy(), self.number)

    def to_mapping(self) -> dict[str, Any]:
        """Return "version" and "number", and copies of the arrays, by name."""
        arrays = {name: self[name].copy() for name in self.arrays.offsets.shapes}
        return {"version": limit("STATE_VERSION"), "number": self.number, **arrays}

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any]) -> State:
        """Restore a state from the mapping of `to_mapping`; ValueError for another version or inconsistent arrays."""
        version, number = (_read_integer(mapping, name) for name in ("version", "number"))
        if version != limit("STATE_VERSION"):
            raise ValueError(
                f"the state of the run is of version {version}, and this library resumes from version "
                f"{limit('STATE_VERSION')}; resume with the library that wrote it"
            )
        if number < 0:
            raise ValueError(f"number of the state is {number}; it must be a whole number from 0 up")
        offsets = _offsets_of(mapping)
        arrays = NamedArrays(offsets)
        for name in offsets.shapes:
            arrays[name][:] = mapping[name]
        return cls(arrays, number)

    def check_fits(self, offsets: ArrayOffsets) -> None:
        """Raise ValueError unless the arrays have these shapes."""
        for name, shape in offsets.shapes.items():
            stored = self.arrays.offsets.shapes[name]
            if stored != shape:
                raise ValueError(
                    f"the state of the run has {name} of shape {stored}, and this run needs {shape}; resume with "
                    "the system, scheme, attitude and members of the original run"
                )


def _read_integer(mapping: Mapping[str, Any], name: str) -> int:
    if name not in mapping:
        raise ValueError(f"the state of a run has no {name}; it must be as to_mapping returns it")
    value = mapping[name]
    if isinstance(value, bool) or np.ndim(value) != 0 or np.asarray(value).dtype.kind not in "iu":
        raise ValueError(f"{name} of the state is {short(value)}; it must be a whole number")
    return int(value)


def _offsets_of(mapping: Mapping[str, Any]) -> ArrayOffsets:
    """Return the layout of the arrays in one block of memory, with sizes from their shapes."""
    described_arrays = kernel_interface().arrays["state"]
    names = set(mapping) - {"version", "number"}
    if names != set(described_arrays):
        missing, unknown = (
            sorted(names_left) for names_left in (set(described_arrays) - names, names - set(described_arrays))
        )
        raise ValueError(
            f"the state of a run must have the arrays {', '.join(described_arrays)}; "
            f"missing: {', '.join(missing) or 'none'}; unknown: {', '.join(map(short, unknown)) or 'none'}"
        )
    sizes: dict[str, int] = {}
    for name, (_, axes) in described_arrays.items():
        shape = np.shape(mapping[name])
        if len(shape) == len(axes):
            for axis, length in zip(axes, shape, strict=True):
                sizes.setdefault(axis, length)
    extent = Extent(*(sizes.get(axis, 0) for axis in Extent._fields))
    offsets = Layout(extent).state
    for name, shape in offsets.shapes.items():
        values = np.asarray(mapping[name])
        dtype = np.dtype(np.int64 if name in offsets.int64_names else np.float64)
        if values.shape != shape or values.dtype != dtype:
            raise ValueError(
                f"{name} of the state is {values.dtype} of shape {values.shape}; with the other arrays it must be "
                f"{dtype} of shape {shape}"
            )
    return offsets
