"""The interface of the kernels (`source/boundary`) as the library describes it, checked against this package.

`program` works without compiled code and defines some codes again; these are compared when it is first read.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any, NamedTuple

from coadjoint.algebra.invariants.invariant import ANGLE, COSH, HOLD, LOGARITHM, QUOTIENT, SINH, SINH_SQUARED
from coadjoint.kernels.library import kernels
from coadjoint.program.blocks import CUBIC_HEADER, MOST_SUBSTEPS, BlockKind, Turn
from coadjoint.program.term_table import FUNCTION, LINEAR, POLYNOMIAL

Fields = tuple[tuple[str, str], ...]

REBUILD_ADVICE = (
    "they were built for another version; build them again, for instance by `pip install --force-reinstall`"
)


class LibraryInterface(NamedTuple):
    """Fields (type, field) of `tables`, of `arrays` "saved" and "state" with their axes, `codes`, and "Limit"."""

    tables: Mapping[str, Fields]
    arrays: Mapping[str, Mapping[str, tuple[str, tuple[str, ...]]]]
    codes: Mapping[str, Mapping[str, int]]


PYTHON_CODES: Mapping[str, Mapping[str, int]] = {
    "Kind": {kind.name: int(kind) for kind in BlockKind},
    "TermKind": {"LINEAR": LINEAR, "POLYNOMIAL": POLYNOMIAL, "FUNCTION": FUNCTION},
    "Role": {
        "HOLD": HOLD,
        "QUOTIENT": QUOTIENT,
        "LOGARITHM": LOGARITHM,
        "ANGLE": ANGLE,
        "SINH": SINH,
        "SINH_SQUARED": SINH_SQUARED,
        "COSH": COSH,
    },
    "Turn": {turn.name: int(turn) for turn in Turn},
    "Limit": {"CUBIC_HEADER": CUBIC_HEADER, "MOST_SUBSTEPS": MOST_SUBSTEPS},
}
"""Codes that Python also defines: complete lists, except for the limits, of which `program` needs some."""

REQUIRED_CODES: Mapping[str, Iterable[str]] = {
    "Status": ("DONE", "NOT_CONVERGED", "OVERFLOWED", "UNDEFINED", "ENDED", "TOO_LONG"),
    "Crossing": ("RISING", "FALLING", "NEAR", "UNDEFINED", "BETWEEN"),
    "Outcome": ("INTERRUPTED", "NO_MEMORY", "UNSOLVED"),
    "StreamKind": ("TRIDIAGONAL", "CIRCULANT", "WEIGHTS", "MULTIPLIED", "BY_FUNCTION", "SYMMETRIC"),
    "Solver": ("EXPLICIT", "ITERATED", "IMPLICIT", "STRUCTURE", "GRADIENT"),
    "ForceKind": (
        "DAMPING",
        "CONSTANT",
        "OF_TIME",
        "OF_STATE",
        "ON_ORBIT",
        "BY_FLOW",
        "MODE_RATES",
        "MODE_NOISE",
        "HAMILTONIAN_NOISE",
        "KICKS",
        "ON_MATRIX_ORBIT",
        "MATRIX_NOISE",
        "MODE_TRANSPORT",
        "SELECTIVE_DECAY",
    ),
    "ModeKind": ("HARMONICS", "WAVES"),
    "Shape": ("MULTIPLE", "DIAGONAL", "FULL"),
    "Limit": (
        "TENTHS",
        "RATIONAL",
        "LARGEST_DENSE",
        "LARGEST_DIRECT",
        "WIDEST",
        "MOST_LANES",
        "STATE_VERSION",
        "PROJECTION_EXACT",
        "PROJECTION_STAGNANT",
        "PROJECTION_CORRECTIONS",
        "DEPENDENT_BITS",
        "GROWTH_BITS",
    ),
}
"""Codes whose values Python looks up by name."""

ARRAYS: Mapping[str, frozenset[str]] = {
    "saved": frozenset(("x", "group", "values")),
    "state": frozenset(
        (
            *("momenta", "errors", "groups", "group_errors", "memory", "first", "last", "worst"),
            *("residual", "status", "step", "evaluations", "iterations"),
        )
    ),
}
"""The arrays of a run that Python uses by name; their order, types and axes come from the library."""


TYPES = ("numbers", "integers")
"""Types of the arrays of a run: float64 and int64."""


def parse_description(text: str) -> LibraryInterface:
    """Parse a description: a line for each table, kind of arrays and list of codes, with its entries."""
    parsed: dict[str, dict[str, Any]] = {"table": {}, "arrays": {}, "codes": {}}
    for line in text.splitlines():
        head, _, rest = line.partition(":")
        section, name = head.split(" ")
        entries = [entry.split(" ") for entry in rest.split(";") if entry]
        if section == "table":
            parsed[section][name] = tuple((kind, field) for kind, field in entries)
        elif section == "arrays":
            parsed[section][name] = {label: (kind, tuple(axes[::2])) for kind, label, *axes in entries}
        else:
            parsed[section][name] = {label: int(value) for label, value in entries}
    return LibraryInterface(parsed["table"], parsed["arrays"], parsed["codes"])


def check(description: LibraryInterface) -> None:
    """Raise ImportError, with the first difference and the remedy, unless the kernels match this package."""
    codes, arrays = description.codes, description.arrays
    for list_name, values in PYTHON_CODES.items():
        for name, value in values.items():
            _check_equal(f"{list_name}.{name}", value, codes.get(list_name, {}).get(name))
        if list_name != "Limit":
            _check_names(f"{list_name}: names", values, codes[list_name])
    for list_name, names in REQUIRED_CODES.items():
        for name in names:
            if name not in codes.get(list_name, {}):
                _check_equal(f"{list_name}.{name}", "a number", None)
    axes = {name for _, name in description.tables.get("Extent", ())} | set(codes["Limit"])
    for kind, used in ARRAYS.items():
        _check_names(f"arrays of a run, {kind}", used, arrays.get(kind, {}))
        for name, (numbers, own_axes) in arrays[kind].items():
            unknown = sorted(set(own_axes) - axes)
            if unknown:
                _check_equal(f"axes of {kind}.{name}", "numbers of Extent and limits", unknown)
            if numbers not in TYPES:
                _check_equal(f"type of {kind}.{name}", " or ".join(TYPES), numbers)


def check_fields(name: str, fields: Iterable[str]) -> None:
    """Raise ImportError if the kernels have no table of this name, or one with other fields than in Python."""
    library_fields = kernel_interface().tables.get(name)
    if library_fields is None:
        raise ImportError(f"the compiled kernels have no table {name}: {REBUILD_ADVICE}")
    _check_names(f"table {name}: fields", fields, (field for _, field in library_fields))


def _check_equal(name: str, ours: Any, theirs: Any) -> None:
    if ours != theirs:
        shown = "missing" if theirs is None else theirs
        raise ImportError(f"{name} is {ours} in this package and {shown} in the compiled kernels: {REBUILD_ADVICE}")


def _check_names(what: str, ours: Iterable[str], theirs: Iterable[str]) -> None:
    in_package, in_kernels = set(ours), set(theirs)
    if in_package != in_kernels:
        raise ImportError(
            f"{what}: {_listed(sorted(in_package - in_kernels))} only in this package, "
            f"{_listed(sorted(in_kernels - in_package))} only in the compiled kernels: {REBUILD_ADVICE}"
        )


def _listed(names: list[str]) -> str:
    return ", ".join(names) or "nothing"


def interface_text() -> str:
    """Return the description as text from the loaded library."""
    describe = kernels().description
    describe.restype = ctypes.c_char_p
    return str(describe().decode())


@cache
def kernel_interface() -> LibraryInterface:
    """Return the description of the loaded kernels, checked once; ImportError if missing or of another version."""
    try:
        description = parse_description(interface_text())
    except AttributeError as error:
        raise ImportError(f"the compiled kernels do not describe themselves: {REBUILD_ADVICE}") from error
    check(description)
    return description


def codes(name: str) -> Mapping[str, int]:
    """Return the codes of a list, by name."""
    return kernel_interface().codes[name]


def limit(name: str) -> int:
    """Return a limit or a count of the kernels."""
    return kernel_interface().codes["Limit"][name]
