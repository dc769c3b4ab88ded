"""Names, attributes and modules that the code of a function reads, and its source text."""

from __future__ import annotations

import dis
import functools
import inspect
import linecache
import sys
import sysconfig
import types
from typing import Any, NamedTuple

KNOWN_PACKAGES = frozenset({"numpy", "scipy", "numba", "llvmlite", "jax", "jaxlib"})
"""Packages whose functions and classes are identified by name, like those of the standard library."""


class GlobalReads(NamedTuple):
    """The global names that a function reads, the attributes it names, and the modules it imports."""

    names: tuple[str, ...]
    attributes: frozenset[str]
    imports: tuple[str, ...]


@functools.lru_cache(maxsize=4096)
def global_reads(code: types.CodeType) -> GlobalReads:
    """Return what the code of a function and of the functions inside it reads."""
    names, attributes, imports = set[str](), set[str](code.co_names), set[str]()
    for instruction in dis.get_instructions(code):
        if instruction.opname in ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS"):
            names.add(instruction.argval)
        elif instruction.opname == "IMPORT_NAME":
            imports.add(instruction.argval)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            inner = global_reads(constant)
            names |= set(inner.names)
            attributes |= inner.attributes
            imports |= set(inner.imports)
        elif isinstance(constant, str):
            attributes.add(constant)  # possibly an argument of getattr
    return GlobalReads(tuple(sorted(names)), frozenset(attributes), tuple(sorted(imports)))


def cell_value(cell: types.CellType) -> list[Any]:
    """Return the value of a closure cell in a list; an empty list if the cell is empty."""
    try:
        return [cell.cell_contents]
    except ValueError:  # an empty cell
        return []


def is_own(module: str) -> bool:
    """Return whether a module belongs to this library."""
    return module.partition(".")[0] == "coadjoint"


@functools.lru_cache(maxsize=4096)
def is_known(module: str) -> bool:
    """Return whether a module belongs to the standard library or to `KNOWN_PACKAGES`, and is not shadowed by a file."""
    top = module.partition(".")[0]
    if top in KNOWN_PACKAGES:
        return True
    if top not in sys.stdlib_module_names:
        return False
    file = getattr(sys.modules.get(top), "__file__", None)
    return file is None or file.startswith((sysconfig.get_path("stdlib"), sysconfig.get_path("platstdlib")))


def source_of(function: types.FunctionType) -> str | None:
    """Return the source text of a function; None if its file is missing or no longer matches the code."""
    code = function.__code__
    try:
        linecache.checkcache(code.co_filename)
        lines = linecache.getlines(code.co_filename, function.__globals__)
        if code in _codes_in("".join(lines), code.co_filename):
            return inspect.getsource(function)
    except (OSError, TypeError, ValueError, SyntaxError):
        pass
    return None


@functools.lru_cache(maxsize=16)
def _codes_in(text: str, name: str) -> frozenset[types.CodeType]:
    codes, pending = set[types.CodeType](), [compile(text, name, "exec", dont_inherit=True)]
    while pending:
        code = pending.pop()
        codes.add(code)
        pending += [constant for constant in code.co_consts if isinstance(constant, types.CodeType)]
    return frozenset(codes)
