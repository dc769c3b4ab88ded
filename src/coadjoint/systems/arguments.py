"""Validation of the arguments of systems: name, sign, parameters, layout and closed form."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from coadjoint.short_repr import short
from coadjoint.validation import is_integer, is_real, read_integer, read_list, read_title


def read_name(name: Any, default: str) -> str:
    """Return the validated name, or `default` if it is None."""
    return default if name is None else read_title(name, "name of a system")


def read_sign(sign: int, what: str = "sign") -> int:
    """Validate a sign, +1 or -1; `what` is its name in messages."""
    if not is_real(sign) or sign not in (1, -1):
        rule = "+1 (x' = J(x) grad H) or -1 (body systems)" if what == "sign" else "+1 or -1"
        raise ValueError(f"{what} is {short(sign)}; give {rule}")
    return int(sign)


def read_parameters(parameters: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Validate the parameters of a system and return a copy."""
    if not isinstance(parameters, Mapping | None):
        raise TypeError(f"parameters is {short(parameters)}; give a mapping from names to values, or None")
    return None if parameters is None else dict(parameters)


def read_layout(layout: Mapping[str, Any] | None) -> dict[str, Any]:
    """Validate the layout (lattice and shape of sites) and return a copy."""
    if layout is None:
        return {}
    rule = 'give a mapping such as {"lattice": "square", "shape": (10, 10)}, or None'
    if not isinstance(layout, Mapping) or not layout.keys() <= {"lattice", "shape"}:
        raise TypeError(f"layout is {short(layout)}; {rule}")
    result = dict(layout)
    if not isinstance(result.get("lattice"), str):
        raise TypeError(f"the lattice of layout is {short(result.get('lattice'))}; {rule}")
    if result.get("shape") is not None:
        shape = result["shape"]
        cells = (shape,) if is_integer(shape) else read_list(shape, "the shape of layout", rule)
        result["shape"] = tuple(read_integer(count, "the shape of layout") for count in cells)
    return result


def read_closed_form(exact: Callable[..., Any] | None) -> Callable[..., Any] | None:
    """Validate the closed form of a system: a function of (x0, t, attitude), or None."""
    if exact is not None and not callable(exact):
        raise TypeError(f"exact is {short(exact)}; give a function of (x0, t, attitude), or None")
    return exact
