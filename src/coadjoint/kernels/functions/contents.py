"""Digests of functions and everything they read: equal digests imply equal machine code and equal runs.

Functions are followed through their code, defaults, closures, and the globals and attributes of modules that they name,
and objects of this library through their attributes. Classes and objects of others are not followed, but named.
"""

from __future__ import annotations

import contextlib
import dis
import functools
import hashlib
import inspect
import sys
import sysconfig
import types
from dataclasses import fields, is_dataclass
from datetime import date, timedelta
from decimal import Decimal
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.caching import cached_if_small

KNOWN_PACKAGES = frozenset({"numpy", "scipy", "numba", "llvmlite", "jax", "jaxlib"})
"""Packages whose functions and classes are identified by name, as those of the standard library."""
STANDARD_LIBRARY = sysconfig.get_path("stdlib"), sysconfig.get_path("platstdlib")
DYNAMIC_BUILTINS = frozenset({"globals", "locals", "vars", "eval", "exec", "__import__", "open", "input"})
"""Builtins with which a function can read values that its code does not name."""
READING = frozenset({"LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS", "IMPORT_NAME"})


class Place(NamedTuple):
    """Where numbers of a function stand among the constants: at `offset`, as "float", "tuple" or "array" of a shape."""

    offset: int
    kind: str
    shape: tuple[int, ...]


PLAIN = frozenset(
    {bool, int, float, complex, str, bytes, type(None), type(...), Fraction, Decimal, range, date, timedelta, Place}
)
CONTAINERS = frozenset({tuple, list, set, frozenset, dict, types.MappingProxyType})
DATA: tuple[Any, ...] = dict, tuple, list, float, str
"""Types of which one of this library has the value, beside its attributes."""
CODE = (
    *("co_argcount", "co_posonlyargcount", "co_kwonlyargcount", "co_flags", "co_names", "co_varnames"),
    *("co_freevars", "co_cellvars", "co_code", "co_exceptiontable", "co_consts"),
)


def contents_of(value: Any, written: bool = False) -> tuple[str, tuple[str, ...]]:
    """Return the digest of a value and of all that functions in it read, if `written` of their source text, equal under
    all versions of Python; and the names of parts without one. The digest is empty if objects are nested too deep.
    """
    walk = _Digester(written)
    try:
        walk.add(value)
    except RecursionError:
        return "", ("objects in objects, too deep to be followed",)
    return walk.digest.hexdigest(), tuple(dict.fromkeys(walk.unknown))


class LiftedContents(NamedTuple):
    """The digest of functions for any values of the floats that they close over or have as defaults, and the values;
    `places` are those of each function, by its id and by names; `unknown` names the parts without a digest.
    """

    digest: str
    unknown: tuple[str, ...]
    constants: NDArray[np.float64]
    places: dict[int, dict[str, Place]]


def lifted_contents(value: Any) -> LiftedContents:
    """Return the digest of a value apart from the floats that functions in it close over or have as defaults."""
    walk = _Structure()
    try:
        structure = walk.of(value)
    except (LookupError, RecursionError):
        return _lifted_contents(value)
    if structure not in _DIGESTS:
        found = _lifted_contents(value)
        if found.unknown:
            return found
        if len(_DIGESTS) == MAX_DIGESTS:
            _DIGESTS.clear()
        _DIGESTS[structure] = found.digest
    return LiftedContents(_DIGESTS[structure], (), walk.all_constants(), walk.places)


def _lifted_contents(value: Any) -> LiftedContents:
    walk = _Digester(False, lifts=True)
    try:
        walk.add(value)
    except RecursionError:
        walk.give_up("objects in objects, too deep to be followed")
    return LiftedContents(
        walk.digest.hexdigest(), tuple(dict.fromkeys(walk.unknown)), walk.all_constants(), walk.places
    )


_DIGESTS: dict[Any, str] = {}
"""Digests of functions of this library by their structure, of which there are as many as kinds of these functions."""
MAX_DIGESTS = 4096


class _Lifting:
    """A traversal of functions in which floats are constants."""

    def __init__(self) -> None:
        self.constants: list[NDArray[np.float64]] = []
        self.places: dict[int, dict[str, Place]] = {}
        self._count = 0

    def all_constants(self) -> NDArray[np.float64]:
        return np.concatenate([np.zeros(0), *self.constants])

    def lifted(self, function: types.FunctionType, name: str, value: Any) -> Any:
        """Return a value that a function reads, or the place of one that is a constant, which no function can read."""
        kind = _kind_of_constant(value)
        if kind is None:
            return value
        numbers = np.array(value, dtype=np.complex128 if kind.startswith("complex") else np.float64)
        place = self.places.setdefault(id(function), {})[name] = Place(self._count, kind, numbers.shape)
        self.constants.append(numbers.ravel().view(np.float64))
        self._count += self.constants[-1].size
        return place


class _Structure(_Lifting):
    """What determines the digest of functions of this library, which are not followed into globals, as a key.

    It is found in a fraction of the time of the digest. LookupError for anything else.
    """

    def __init__(self) -> None:
        super().__init__()
        self._visited: dict[int, int] = {}

    def of(self, value: Any) -> Any:
        kind = type(value)
        if kind in PLAIN:
            return kind, repr(value)
        if kind is tuple:
            return kind, *map(self.of, value)
        if (number := self._visited.get(id(value))) is not None:
            return number
        if kind is not types.FunctionType or not is_own(value.__module__ or ""):
            raise LookupError
        self._visited[id(value)] = len(self._visited)
        held: list[Any] = [value.__code__]
        defaults, cells = (
            {name: self.lifted(value, name, one) for name, one in of.items()}
            for of in (defaults_of(value), cells_of(value))
        )
        for of in (cells, defaults, value.__kwdefaults__ or {}):
            held += [(name, self.of(one)) for name, one in of.items()]
            held.append(None)
        return tuple(held)


def compilation_key(function: Any) -> Any:
    """Return a key that is equal for functions that compile to the same code; a unique object if that is unknown."""
    digest, unknown = contents_of(function)
    return object() if unknown else digest


class _Digester(_Lifting):
    """One traversal: functions and objects are numbered in order of first visit, data are added by content."""

    def __init__(self, written: bool, lifts: bool = False) -> None:
        super().__init__()
        self.digest, self.unknown, self.written = hashlib.blake2b(digest_size=32), list[str](), written
        self._lifts = lifts
        self._visited: dict[int, tuple[int, Any]] = {}  # with the objects, so that no id is used again

    def update(self, *words: Any) -> None:
        """Add words, each with its length."""
        self.digest.update("".join(f"{len(text)}:{text};" for text in map(str, words)).encode("utf-8", "surrogatepass"))

    def give_up(self, what: str) -> list[Any]:
        """Name a part that cannot be followed; it has no parts."""
        self.unknown.append(what)
        return ["unknown", what]

    def lifted(self, function: types.FunctionType, name: str, value: Any) -> Any:
        return super().lifted(function, name, value) if self._lifts else value

    def add(self, value: Any) -> None:
        """Add a value by its content."""
        kind = type(value)
        self.update(kind.__name__)
        if kind in PLAIN:
            self.update(repr(value))
        elif isinstance(value, np.ndarray | np.generic) and not np.asarray(value).dtype.hasobject:
            array = np.asarray(value)
            self.update(array.dtype.descr, array.shape, array.flags.c_contiguous, array.flags.f_contiguous)
            self.digest.update(hashlib.sha256(np.ascontiguousarray(array).data).digest())
        elif kind not in CONTAINERS and (number := self._visited.get(id(value))) is not None:
            self.update("again", number[0])
        else:
            self._visited[id(value)] = len(self._visited), value
            parts = _parts(value, self)
            self.update(len(parts))
            for part in parts:
                self.add(part)


def _parts(value: Any, walk: _Digester) -> list[Any]:
    """Return the parts of an object from which its digest is computed."""
    kind = type(value)
    match value:
        case dict() | types.MappingProxyType() if kind in CONTAINERS:
            return list(value.items())
        case set() | frozenset() if kind in CONTAINERS:
            return sorted(value, key=repr)
        case list() | tuple() if kind in CONTAINERS or (hasattr(kind, "_fields") and not is_own(kind.__module__)):
            return list(value)
        case types.FunctionType():
            return _parts_of_function(value, walk)
        case types.CodeType():
            return [_digest_of_code(value)]
        case types.ModuleType():
            return [value.__name__]
        case types.MethodType():
            return [value.__func__, value.__self__]
        case functools.partial():
            return [value.func, value.args, value.keywords]
        case type():
            is_named = is_known(value.__module__) or is_own(value.__module__)
            return (
                [value.__module__, value.__qualname__] if is_named else walk.give_up(f"the class {value.__qualname__}")
            )
        case np.dtype():
            return [str(value)]
        case np.ufunc():
            return [value.__name__] if value.__name__.isidentifier() else walk.give_up(f"the function {value.__name__}")
        case Polynomial():
            return sorted(value.monomials.items())
    if isinstance(getattr(value, "py_func", None), types.FunctionType):  # a dispatcher of Numba
        signatures = () if value._can_compile else value.nopython_signatures
        options = sorted(value.targetoptions.items()), sorted(value.locals.items())
        return [str(options), *map(str, signatures), value.py_func]
    if kind.__module__.startswith("numba."):
        return [str(value)] if ".types" in kind.__module__ else walk.give_up(f"an object of {kind.__qualname__}")
    if callable(value) and isinstance(getattr(value, "__qualname__", None), str):  # of C, in known packages
        owner = getattr(value, "__objclass__", getattr(value, "__self__", None))
        module = getattr(value, "__module__", None) or "builtins"
        return [module, value.__name__, owner] if is_known(module) else walk.give_up(f"{module}.{value.__qualname__}")
    if not is_own(kind.__module__):
        return walk.give_up(f"an object of {kind.__qualname__}")
    if is_dataclass(value):
        return [kind, *(getattr(value, field.name) for field in fields(value))]
    data = next((base(value) for base in DATA if isinstance(value, base)), None)
    state: Any = object.__getstate__(value)  # type: ignore[attr-defined]
    held = {**(state[0] or {}), **state[1]} if isinstance(state, tuple) else state or {}
    cached = functools.cached_property, cached_if_small
    return [kind, data, *((k, v) for k, v in sorted(held.items()) if not isinstance(getattr(kind, k, None), cached))]


@functools.lru_cache(maxsize=4096)
def _digest_of_code(code: types.CodeType) -> str:
    walk = _Digester(False)
    for name in CODE:
        walk.add(getattr(code, name))
    return walk.digest.hexdigest()


def _parts_of_function(function: types.FunctionType, walk: _Digester) -> list[Any]:
    """Return the code of a function, its defaults, what is closed over, and the globals that it names."""
    module, code, held = function.__module__ or "", function.__code__, function.__globals__
    text: Any = _digest_of_code(code)
    if walk.written and not is_known(module):
        try:
            text = inspect.getsource(function)
        except (OSError, TypeError):
            text = ""
            walk.give_up(f"the source of {function.__qualname__}")
    names, attributes = global_reads(code)
    defaults, cells = defaults_of(function), cells_of(function)
    if not is_known(module):
        defaults, cells = ({k: walk.lifted(function, k, v) for k, v in of.items()} for of in (defaults, cells))
    named = {}
    if not is_known(module) and not is_own(module):
        named = {name: held[name] if name in held else sys.modules.get(name) for name in names}
        if dynamic := DYNAMIC_BUILTINS.intersection(names) - held.keys():
            walk.give_up(f"what {function.__qualname__} reads by {min(dynamic)}()")
    read = [("cell", cells), ("default", defaults), ("keyword", function.__kwdefaults__ or {}), ("global", named)]
    read += [(f"of {name}", _attributes_read(value, attributes)) for name, value in {**cells, **named}.items()]
    identity = f"{module}.{function.__qualname__}" if is_known(module) else text
    walk.update(identity, *(f"{kind} {name}" for kind, values in read for name in values))
    return [value for _, values in read for value in values.values()]


def _attributes_read(value: Any, attributes: frozenset[str]) -> dict[str, Any]:
    """Return the attributes that are read of a module of the user, and of modules in it, by name."""
    if not isinstance(value, types.ModuleType) or is_known(value.__name__) or is_own(value.__name__):
        return {}
    found = {name: vars(value)[name] for name in sorted(attributes & vars(value).keys())}
    within = {name: _attributes_read(member, attributes - {name}) for name, member in found.items()}
    return found | {f"{name}.{other}": one for name, members in within.items() for other, one in members.items()}


@functools.lru_cache(maxsize=4096)
def global_reads(code: types.CodeType) -> tuple[tuple[str, ...], frozenset[str]]:
    """Return the global names and modules that a function reads, and the attributes that it names."""
    names = {str(one.argval) for one in dis.get_instructions(code) if one.opname in READING}
    attributes = {*code.co_names, *(text for text in code.co_consts if isinstance(text, str))}  # those of getattr
    for inner in (global_reads(value) for value in code.co_consts if isinstance(value, types.CodeType)):
        names, attributes = names.union(inner[0]), attributes | inner[1]
    return tuple(sorted(names)), frozenset(attributes)


def cells_of(function: types.FunctionType) -> dict[str, Any]:
    """Return the values that a function has closed over by name, without those of empty cells."""
    found = {}
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        with contextlib.suppress(ValueError):
            found[name] = cell.cell_contents
    return found


def defaults_of(function: types.FunctionType) -> dict[str, Any]:
    """Return the values of arguments that may be omitted, by name."""
    values, code = function.__defaults__ or (), function.__code__
    return dict(zip(code.co_varnames[code.co_argcount - len(values) : code.co_argcount], values, strict=True))


def _kind_of_constant(value: Any) -> str | None:
    """Return the kind of a float, of a tuple or an array of floats, and of complex ones; None for other values."""
    if type(value) in (float, np.float64):
        return "float"
    if type(value) is complex:
        return "complex"
    if type(value) is tuple and value and all(type(one) is float for one in value):
        return "tuple"
    if type(value) is not np.ndarray or not value.ndim or not value.size or not value.flags.c_contiguous:
        return None
    return {"d": "array", "D": "complex array"}.get(value.dtype.char if value.dtype.isnative else "")


def is_own(module: str) -> bool:
    """Return whether a module belongs to this library."""
    return module.partition(".")[0] == "coadjoint"


@functools.cache
def is_known(module: str) -> bool:
    """Return whether a module belongs to `KNOWN_PACKAGES` or to the standard library, and is not shadowed by a file."""
    top = module.partition(".")[0]
    file = getattr(sys.modules.get(top), "__file__", None) or STANDARD_LIBRARY[0]
    return top in KNOWN_PACKAGES or (top in sys.stdlib_module_names and file.startswith(STANDARD_LIBRARY))
