"""Dimensions of datasets by their names and labels; named axes of members, stored over ``member``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.files.records.entries import parsed
from coadjoint.files.records.reconstruction import Axes, axes_of_record
from coadjoint.files.records.records import axes_record
from coadjoint.labels import COMPLEX_PARTS, positions
from coadjoint.short_repr import short
from coadjoint.systems.batch import SUFFIX, Axis

if TYPE_CHECKING:
    import xarray

AXES = "axes"
"""Attribute with the axes: a list of [name, length, coordinates or null]."""
MEMBER = "member"
BEFORE_MEMBERS = ("time", "crossing")
AFTER_MEMBERS = ("layer", "row", "column", "component", "account", "invariant", "tenth", "body", "axis")
"""Dimensions in the order of the arrays of a run, before others: fields over their grids, and parts of numbers."""


def axes_of_system(system: Any) -> Axes:
    """Return the named axes of the members of a system; empty unless it is a batch with axes."""
    return system.axes if system.is_batch else {}


def stored_axes(attributes: Mapping[str, Any], members: int) -> Axes:
    """Return the axes in the attributes of a dataset or an archive."""
    return axes_of_record(parsed(attributes[AXES], AXES), members) if AXES in attributes else {}


def axes_attribute(axes: Mapping[str, Axis]) -> dict[str, str]:
    """Return the attribute with the axes; empty without axes."""
    return {AXES: json.dumps(axes_record(axes))} if axes else {}


def unstacked(dataset: xarray.Dataset) -> xarray.Dataset:
    """Return a dataset over ``member`` with the axes of its attributes as dimensions; unchanged if there are none."""
    axes = stored_axes(dataset.attrs, dataset.sizes.get(MEMBER, 1))
    if not axes:
        return dataset
    import xarray

    lengths = tuple(axis.length for axis in axes.values())
    variables: dict[str, Any] = {}
    for name, variable in dataset.variables.items():
        dims = tuple(map(str, variable.dims))
        if MEMBER not in dims:
            variables[label_of(str(name), axes)] = variable
            continue
        k = dims.index(MEMBER)
        values = variable.values
        values = values.reshape(values.shape[:k] + lengths + values.shape[k + 1 :])
        if len(dims) == 1 and name in dataset.coords:
            dims, values = _reduced(tuple(axes), values)
        else:
            dims = (*dims[:k], *axes, *dims[k + 1 :])
        variables[label_of(str(name), axes)] = dims, values, variable.attrs
    variables |= coordinate_variables(axes)
    coordinates = [label_of(str(name), axes) for name in dataset.coords]
    return xarray.Dataset(variables, attrs=dataset.attrs).set_coords([*coordinates, *coordinate_variables(axes)])


def label_of(name: str, axes: Mapping[str, Axis]) -> str:
    """Return the name of a variable in a dataset with these axes."""
    return f"{name}{SUFFIX}" if name in axes else name


def coordinate_variables(axes: Mapping[str, Axis]) -> dict[str, Any]:
    """Return the coordinates of the axes as variables."""
    return {name: ((name,), axis.values, {"long_name": name}) for name, axis in axes.items() if axis.values is not None}


def _reduced(dims: tuple[str, ...], values: Any) -> tuple[tuple[str, ...], Any]:
    """Drop the axes along which values are constant."""
    for k in reversed(range(values.ndim)):
        first = np.take(values, [0], axis=k)
        if values.shape[k] > 1 and (values == first).all():
            dims, values = (*dims[:k], *dims[k + 1 :]), np.take(values, 0, axis=k)
    return dims, values


def in_order(dataset: xarray.Dataset, dim: str, labels: Sequence[Any]) -> xarray.Dataset:
    """Return a dataset with the labels of a dimension in a given order, each of which occurs once."""
    found = dataset[dim].values.tolist() if dim in dataset.coords else list(labels)
    if found == list(labels):
        return dataset
    order = positions(labels, found)
    if order is None:
        raise ValueError(f"the coordinate {dim} is {short(found)}; the run has {short(list(labels))}")
    return dataset.isel({dim: order})


def _by_names(dataset: xarray.Dataset, axes: Sequence[str]) -> xarray.Dataset:
    """Return a dataset whose arrays have dimensions and labels in the order of a run, whatever their own order."""
    # An axis may be called member.
    order = dict.fromkeys((*BEFORE_MEMBERS, *axes, MEMBER, *AFTER_MEMBERS, ..., "part"))
    dataset = dataset.transpose(*order, missing_dims="ignore")
    dataset = in_order(dataset, "part", COMPLEX_PARTS)
    dataset = in_order(dataset, "tenth", range(1, 11))
    if "invariant" in dataset.coords:
        names = [str(name) for name in dataset["invariant"].values]
        if len(set(names)) < len(names) or "energy" not in names:
            raise ValueError(f"the invariants are {short(names)}; they must be the energy and others, each once")
        dataset = in_order(dataset, "invariant", ["energy", *(name for name in names if name != "energy")])
    return dataset


def stacked(dataset: xarray.Dataset) -> xarray.Dataset:
    """Return a dataset over ``member`` from one with axes as dimensions: the inverse of `unstacked`."""
    names = []
    if AXES in dataset.attrs:
        names = [name.entries(3)[0].text() for name in parsed(dataset.attrs[AXES], AXES).entries()]
    dataset = _by_names(dataset, names)
    if not names:
        return dataset
    attributes = {name: value for name, value in dataset.attrs.items() if name != AXES}
    dims = dataset["x0"].dims if "x0" in dataset else ()
    if MEMBER in dims and dims[: len(names)] != tuple(names):  # an archive, read by other means
        return dataset.drop_attrs(deep=False).assign_attrs(attributes)
    missing = [name for name in names if name not in dataset.sizes]
    if missing:
        raise ValueError(f"the dataset has no dimension {missing[0]!r}, an axis of its attributes")
    axes = stored_axes(dataset.attrs, prod(dataset.sizes[name] for name in names))
    for name, axis in axes.items():
        if axis.values is not None:
            dataset = in_order(dataset, name, axis.values.tolist())
    import xarray

    lengths = tuple(axis.length for axis in axes.values())
    variables: dict[str, Any] = {}
    for label, variable in dataset.variables.items():
        name = str(label).removesuffix(SUFFIX) if str(label).removesuffix(SUFFIX) in axes else str(label)
        if label in axes:
            continue
        along = [dim for dim in variable.dims if dim in axes]
        if not along:
            variables[name] = variable
            continue
        k = variable.dims.index(along[0])
        others = [dim for dim in variable.dims if dim not in axes]
        # Other dimensions keep their places around the axes.
        values = variable.transpose(*others[:k], *along, *others[k:]).values
        expanded = tuple(axis.length if dim in along else 1 for dim, axis in axes.items())
        before, after = values.shape[:k], values.shape[k + len(along) :]
        if [dim for dim in axes if dim in along] != along:
            raise ValueError(f"{label} is over {variable.dims}; its axes must be in the order {tuple(axes)}")
        values = np.broadcast_to(values.reshape(*before, *expanded, *after), (*before, *lengths, *after))
        dims = (*others[:k], MEMBER, *others[k:])
        variables[name] = (dims, values.reshape(*before, prod(lengths), *after), variable.attrs)
    coordinates = [str(name) for name in dataset.coords if name in variables and name not in axes]
    return xarray.Dataset(variables, attrs=attributes).set_coords(coordinates)
