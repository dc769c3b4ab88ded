"""Labelled arrays of xarray and pandas: axes by name and entries by label."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from coadjoint.short_repr import short

STATE_DIMENSIONS = (("component",), ("row", "column"), ("layer", "row", "column"))
"""Dimensions of a state: a vector, a matrix, or matrices in layers."""
COMPLEX_PARTS = ("real", "imaginary")
"""Parts of complex numbers along a last dimension ``part``, since NetCDF has no complex numbers."""
MEMBERS = {"member": None}
"""Order of the members of an ensemble, for `by_labels`: that of their numbers."""


class Labelled(NamedTuple):
    """Names of the axes (None of unnamed ones of pandas), the array, and labels along axes other than 0, 1, ..."""

    dims: tuple[str | None, ...]
    data: Any
    labels: dict[int, list[Any]]


def is_xarray(values: Any) -> bool:
    """Return whether a value is an array of xarray, detected without importing it."""
    return hasattr(values, "dims") and hasattr(values, "coords") and not hasattr(values, "data_vars")


def labelled(values: Any) -> Labelled | None:
    """Return the axes of an array of xarray or pandas; None for anything else."""
    if isinstance(values, np.ndarray | list | tuple):
        return None
    if hasattr(values, "iloc") and hasattr(values, "axes"):
        named = [(axis.name, list(axis)) for axis in values.axes]
        dims, data = tuple(None if name is None else str(name) for name, _ in named), values.to_numpy()
        labels = dict(enumerate(entries for _, entries in named))
    elif hasattr(values, "dims") and hasattr(values, "data"):
        coordinates = getattr(values, "coords", {})
        dims, data = tuple(map(str, values.dims)), values.data
        labels = {k: coordinates[dim].to_numpy().tolist() for k, dim in enumerate(values.dims) if dim in coordinates}
    else:
        return None
    return Labelled(dims, data, {k: found for k, found in labels.items() if found != list(range(len(found)))})


def lost_labels(values: Any) -> str | None:
    """Return a description of names and labels that the conversion to a plain array loses; None if it loses nothing."""
    found = labelled(values)
    if found is None or not found.dims:
        return None
    kind, (dims, data, labels) = type(values).__name__, found
    if hasattr(data, "units"):
        return f"a {kind} with units, and they"
    if labels:
        # The coordinate of an axis itself, such as the times of a dataset, has its values as labels.
        is_own = len(dims) == 1 and hasattr(data, "tolist") and data.tolist() == labels[0]
        return None if is_own else f"a {kind} with labels other than 0, 1, 2, ..., and they"
    by_default = (None, None), ("dim_0", "dim_1", "dim_2", "dim_3")[: len(dims)]
    return None if len(dims) == 1 or dims in by_default else f"a {kind} with the dimensions {short(dims)}, and these"


def by_labels(
    values: Any, what: str, axes: Sequence[str], order: Mapping[str, Sequence[Any] | None] | None = None
) -> Any:
    """Return labelled values as an array with `axes` last and entries in `order`; anything else unchanged.

    `order` has the labels of axes by name, None for 0, 1, ...; other leading axes are kept in theirs. A last dimension
    ``part`` is that of complex numbers.
    """
    found = labelled(values)
    if found is None or (not found.labels and not any(found.dims)) or hasattr(found.data, "units"):
        return values
    dims, data, labels = found
    if hasattr(values, "iloc"):  # axes of pandas have their names only by chance
        lead = ["member" if name in (None, *axes) else str(name) for name in dims[: -len(axes)]]
        dims = (*lead, *axes[-len(dims) :])
    elif "part" in dims:
        axes, order = (*axes, "part"), {**(order or {}), "part": COMPLEX_PARTS}
    wrong = [axis for axis in (*axes, *dims) if dims.count(axis) != 1]
    if wrong:
        raise ValueError(
            f"{what} has the dimensions {short(dims)}; give it one dimension {wrong[0]!r}, or its to_numpy() if its "
            "order is right"
        )
    array = np.asarray(data)
    known = dict.fromkeys(axes) | dict(order or {})
    for k, along in labels.items():
        if dims[k] in known:
            array = np.take(array, _order(along, dims[k], known[dims[k]], what), axis=k)
    rest = [k for k, dim in enumerate(dims) if dim not in axes]
    # In the layout of other arrays, which sums in BLAS depend on.
    array = np.ascontiguousarray(array.transpose(*rest, *(dims.index(axis) for axis in axes)))
    return array[..., 0] + 1j * array[..., 1] if axes[-1] == "part" else array


def _order(given: list[Any], dim: Any, known: Sequence[Any] | None, what: str) -> list[int]:
    """Return the positions of the known labels of an axis, None for 0, 1, ..., among the given ones."""
    found = positions(range(len(given)) if known is None else known, given)
    if found is None:
        expected = "0, 1, 2, ..." if known is None else short(list(known))
        raise ValueError(
            f"{what} has the labels {short(given)} of {dim}; they must be {expected} in any order, or give its "
            "to_numpy() if its order is right"
        )
    return found


def positions(labels: Sequence[Any], given: Sequence[Any]) -> list[int] | None:
    """Return the positions of labels among the given ones; None unless each of both is among the others, once."""
    places = {label: k for k, label in enumerate(given)}
    is_order = len(places) == len(given) == len(labels) and places.keys() == set(labels)
    return [places[label] for label in labels] if is_order else None
