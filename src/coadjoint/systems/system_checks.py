"""Validation of systems, and of their arguments: name, sign, parameters, layout, closed form, structure function."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from coadjoint.short_repr import short
from coadjoint.systems.user_functions import check_skew
from coadjoint.validation import is_integer, is_real, read_integer, read_list, read_title, set_fields


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


def check_structure(system: Any) -> None:
    """Raise an error unless `structure_function` is a function whose values at sample points are skew (n, n)."""
    function = system.structure_function
    if function is None or function is system._checked_function:
        return
    if getattr(function, "__self__", function) is system:
        raise TypeError(
            f"structure_function of {system.name} is its method, which is not compiled; make it a function of x, "
            "by @staticmethod or in __init__"
        )
    check_skew(function, "structure_matrix", system.dim)
    set_fields(system, _checked_function=function)


def check_system(system: Any) -> None:
    """Raise TypeError unless given a complete `System`, or a `Batch`."""
    if isinstance(system, type) or not hasattr(system, "is_batch"):
        raise TypeError(
            f"system is {short(system)}; it must be a LiePoissonSystem or another System, such as "
            "co.systems.rigid_body()"
        )
    if not system.is_batch:
        missing = [field for field in ("name", "sign", "dim", "hamiltonian") if not hasattr(system, field)]
        if missing:
            kind = type(system).__name__
            raise TypeError(f"the system, a {kind}, has no {', no '.join(missing)}; set each in its class")


def check_one_system(system: Any, forces: bool = False) -> None:
    """Raise TypeError for a batch, an object that is not a system, and a system with forces unless they are allowed."""
    check_system(system)
    if system.is_batch:
        raise TypeError(f"system is {short(system)}; it must be one system, such as a member of the batch, batch[0]")
    if system.forces and not forces:
        raise TypeError(
            f"{system.name} has forces, which only runs and steppers support; take its Hamiltonian part, .unforced"
        )


def check_vector_states(system: Any, advice: str = "use IsospectralGauss") -> None:
    """Raise an error unless given a single system with vector states; `advice` ends the message for matrix systems."""
    check_one_system(system)
    if system.has_matrices:
        raise ValueError(f"{system.name} has matrix states, in {system.algebra}; {advice}")
