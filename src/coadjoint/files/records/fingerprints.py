"""Fingerprints of functions, by which archives identify them."""

from __future__ import annotations

import functools
import hashlib
import inspect
import platform
import types
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from fractions import Fraction
from typing import Any, cast

import numpy as np

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.files.records.entries import EXACT, INTEGRAL
from coadjoint.files.records.records import record_of
from coadjoint.kernels.functions.contents import contents_of
from coadjoint.systems.batch import Batch
from coadjoint.systems.forced import ForcedSystem
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.matrices.matrix_system import MatrixSystem

PLAIN_TYPES = (type(None), bool, int, float, complex, str, bytes, Fraction, range)


class Fingerprint:
    """Digest of archives written before `contents_of` existed; it covers only part of what functions read.

    With `written`, source text replaces bytecode, which depends on the version of Python.
    """

    def __init__(self, written: bool) -> None:
        self._digest, self._written = hashlib.sha256(), written
        self._seen: dict[int, int] = {}
        self._references: list[Any] = []  # keeps objects alive, so that their ids stay unique
        self.unknown = False

    def hexdigest(self) -> str:
        """Return the digest of all added values."""
        return self._digest.hexdigest()

    def _feed(self, *words: Any) -> None:
        self._digest.update("".join(f"{len(str(word))}:{word};" for word in words).encode())

    def add(self, value: Any) -> None:
        """Add a value."""
        if isinstance(value, PLAIN_TYPES):
            return self._feed(type(value).__name__, repr(value))
        if id(value) in self._seen:
            return self._feed("again", self._seen[id(value)])
        self._seen[id(value)] = len(self._seen)
        self._references.append(value)
        if isinstance(value, np.ndarray | np.generic):
            self._feed("array", np.asarray(value).dtype.str, np.shape(value))
            self._digest.update(np.ascontiguousarray(value).tobytes())
        elif isinstance(value, Mapping):
            self._feed("mapping", len(value))
            for key in sorted(value, key=repr):
                self.add(key)
                self.add(value[key])
        elif isinstance(value, set | frozenset):
            self._feed("set", sorted(map(repr, value)))
        elif isinstance(value, Sequence):
            self._feed("sequence", len(value))
            for entry in value:
                self.add(entry)
        elif isinstance(value, Polynomial):
            self.add(dict(value.monomials))
        else:
            self._add_callable(value)

    def _add_callable(self, value: Any) -> None:
        if hasattr(value, "py_func"):
            self.add(value.py_func)  # compiled by Numba
        elif isinstance(value, types.FunctionType):
            self._add_function(value)
        elif isinstance(value, functools.partial):
            self.add(["partial", value.func, value.args, value.keywords])
        elif isinstance(value, types.MethodType):
            self.add(["method", value.__func__, value.__self__])
        elif isinstance(value, types.CodeType):
            self._add_code(value)
        elif isinstance(value, types.ModuleType | type | types.BuiltinFunctionType | np.ufunc):
            self._feed("named", getattr(value, "__module__", ""), getattr(value, "__qualname__", value.__name__))
        elif is_dataclass(value):
            self._feed("object", type(value).__qualname__)
            self.add({field.name: getattr(value, field.name) for field in fields(value)})
        else:
            kind = type(value)
            attributes = {
                name: item for name, item in getattr(value, "__dict__", {}).items() if not _is_cache(kind, name)
            }
            functions = {name: item for name, item in vars(kind).items() if isinstance(item, types.FunctionType)}
            self._feed("object", kind.__qualname__)
            self.add([attributes, functions if _package(kind) != "coadjoint" else {}])

    def _add_function(self, function: types.FunctionType) -> None:
        self._feed("function", function.__name__)
        if self._written:
            try:
                self._feed(inspect.getsource(function))
            except (OSError, TypeError):
                self.unknown = True
        else:
            self._add_code(function.__code__)
        closed = [cell.cell_contents for cell in function.__closure__ or () if _is_filled(cell)]
        self.add([function.__defaults__, function.__kwdefaults__, closed])
        package = _package(function)
        for name in sorted(_names(function.__code__)):
            value = function.__globals__.get(name, self)
            if isinstance(value, (*PLAIN_TYPES, np.ndarray, np.generic, tuple)) or (
                isinstance(value, types.FunctionType) and _package(value) == package
            ):
                self.add([name, value])

    def _add_code(self, code: types.CodeType) -> None:
        self._feed("code", code.co_argcount, code.co_kwonlyargcount, code.co_names, code.co_varnames)
        self._digest.update(code.co_code)
        self.add(list(code.co_consts))


def _is_filled(cell: Any) -> bool:
    try:
        return cell.cell_contents is not cell
    except ValueError:
        return False


def _names(code: types.CodeType) -> set[str]:
    """Return the global names read by a function and its nested functions."""
    inside = [constant for constant in code.co_consts if isinstance(constant, types.CodeType)]
    return set(code.co_names).union(*map(_names, inside))


def _package(value: Any) -> str:
    return str(getattr(value, "__module__", "") or "").partition(".")[0]


def _is_cache(kind: type, name: str) -> bool:
    return isinstance(getattr(kind, name, None), functools.cached_property)


def fingerprint_of(value: Any) -> dict[str, Any]:
    """Return a fingerprint of a value and of everything its functions read, for `same_fingerprint`.

    Examples
    --------
    >>> def times(a):
    ...     return lambda x: a * x
    >>> first, second, third = (fingerprint_of(times(a)) for a in (1.0, 2.0, 1.0))
    >>> same_fingerprint(first, second), same_fingerprint(first, third)
    (False, True)
    """
    code, text = Fingerprint(False), Fingerprint(True)
    code.add(value)
    text.add(value)
    contents, written = contents_of(value), contents_of(value, written=True)
    return {
        "python": ".".join(platform.python_version_tuple()[:2]),
        "code": code.hexdigest(),
        "text": None if text.unknown else text.hexdigest(),
        "contents": contents.digest,
        "unknown": list(contents.unknown),
        "written": written.digest if written.unknown == contents.unknown else None,
    }


def same_fingerprint(first: Mapping[str, Any], second: Mapping[str, Any]) -> bool:
    """Whether two values, including everything their functions read, are equal.

    Bytecode is compared if the version of Python is the same, otherwise source text; functions without text are
    unequal.
    """
    if "contents" in first and "contents" in second:
        if first["python"] == second["python"]:
            return bool(first["contents"] == second["contents"])
        return first["written"] is not None and first["written"] == second["written"]
    if first["python"] == second["python"]:
        return bool(first["code"] == second["code"])
    return first["text"] is not None and first["text"] == second["text"]


def functions_in(system: Any) -> list[str]:
    """Return the names of a system's functions that are required to resume its runs."""
    missing = record_of(system).get("not_stored", [])
    return [name for name in missing if not name.startswith((EXACT, INTEGRAL))]


def system_contents(system: Any) -> Any:
    """Return everything that defines a system, for `fingerprint_of`."""
    if isinstance(system, Batch):
        return [system_contents(member) for member in system.distinct]
    if isinstance(system, ForcedSystem):
        forces = [[type(force).__name__, force, dict(force.parameters())] for force in system.forces]
        return [system_contents(system.system), forces]
    if getattr(system, "parameters", None) is not None:
        return [system.name, dict(system.parameters)]
    if isinstance(system, MatrixSystem):
        streams = (system.stream, getattr(system, "second_stream", None))
        functions = [getattr(stream, "function", stream) for stream in streams]
        return [record_of(cast(Any, system)), functions, system.energy_function]
    contents = [system.name, system.sign, list(system.hamiltonian.terms()), dict(system.casimirs)]
    if isinstance(system, LiePoissonSystem):
        return [record_of(system), *contents]
    return [*contents, getattr(system, "structure_function", system)]
