"""Records of the named axes of a batch."""

from __future__ import annotations

from collections.abc import Mapping
from math import prod
from typing import Any

from coadjoint.files.records.entries import Entry, as_value_errors
from coadjoint.systems.batch import Axis, axis_coordinates, check_axis_name

Axes = dict[str, Axis]


def axes_record(axes: Mapping[str, Axis]) -> list[list[Any]]:
    """Return axes as plain lists for `json`."""
    return [[name, axis.length, None if axis.values is None else axis.values.tolist()] for name, axis in axes.items()]


def axes_of_record(record: Entry, members: int) -> Axes:
    """Return the axes of a record; ValueError unless they have as many combinations as members."""
    axes: Axes = {}
    for entry in record.entries():
        name, length, values = entry.entries(3)
        with as_value_errors(name):
            check_axis_name(name.text(), axes)
        count = length.integer(1)
        array = None if values.value is None else axis_coordinates([value.plain() for value in values.entries(count)])
        if values.value is not None and array is None:
            raise values.invalid_error("a list of numbers or text, or null")
        axes[name.text()] = Axis(count, array)
    if axes and prod(axis.length for axis in axes.values()) != members:
        raise record.invalid_error(f"axes with {members} combinations")
    return axes
