"""Automatic choices of schemes: fixed for a system, made jointly for many systems, or changed if left open."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from typing import Any

from coadjoint.methods.protocol.composed import Composed, FlowsOfBase
from coadjoint.methods.protocol.flow_method import FlowMethod
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.protocol.wrapper import Wrapper
from coadjoint.program.parts.chosen_parts import ChosenParts
from coadjoint.program.parts.decompose import BODY_FLOW_CHOICES, check_body_flow_inputs, decompose, decompose_all
from coadjoint.program.parts.split import NotSplittable
from coadjoint.systems.hamiltonians.linear_term import with_placeholders
from coadjoint.systems.protocol import has_structure_constants, unforced
from coadjoint.systems.system_checks import System


def settled(method: Method, system: System, coordinates: Sequence[int]) -> Method:
    """Return the same scheme with all automatic choices for a system fixed, such as its parts.

    Systems that differ only in the coefficients of the linear term of H at these coordinates then have tables of one
    structure. TypeError or ValueError: a choice cannot be fixed.
    """
    if isinstance(method, Wrapper):
        base = settled(method.base, system, coordinates)
        return method if base is method.base else _with_base(method, base)
    return _with_fixed_parts(method, system, coordinates) if isinstance(method, FlowMethod) else method


def _with_fixed_parts(method: FlowMethod, system: System, coordinates: Sequence[int]) -> Method:
    """Return a flow method with the automatic parts of a system fixed; it needs a field `parts`."""
    if isinstance(method.parts, str) and method.parts in BODY_FLOW_CHOICES:
        check_body_flow_inputs(system, method.parts, coordinates)
    automatic = isinstance(method.parts, ChosenParts) or (isinstance(method.parts, str) and method.parts == "auto")
    if not automatic or not has_structure_constants(system):
        return method
    if not is_dataclass(method) or all(field.name != "parts" for field in fields(method)):
        raise TypeError(f"{method} has no field `parts`, so that automatic parts cannot be fixed; give it this field")
    method.properties(system)
    try:
        choice = decompose(with_placeholders(system, coordinates), method.parts).choice
    except NotSplittable:
        return method  # the loop raises the error for a Hamiltonian that does not split
    return replace(method, parts=replace(choice, linear=tuple(coordinates)))


def split_jointly(method: Method, systems: Sequence[Any]) -> None:
    """Split the Hamiltonians of many systems together, which is faster than for each loop."""
    while isinstance(method, Wrapper):
        method = method.base
    if isinstance(method, FlowMethod) and method.parts == "auto":
        # Hamiltonians that do not split raise later, with the name of the member.
        with suppress(ValueError):
            plain = map(unforced, systems)
            decompose_all([system for system in plain if has_structure_constants(system)])


def with_compensation(method: Method) -> Method | None:
    """Return the same scheme with compensated sums, if that choice was left open; else None."""
    if isinstance(method, Composed | FlowsOfBase):
        base = with_compensation(method.base)
        return None if base is None else _with_base(method, base)
    return method.with_compensation() if isinstance(method, FlowMethod) else None


def _with_base(method: Any, base: Method) -> Method:
    changed: Method = replace(method, base=base)
    return changed
