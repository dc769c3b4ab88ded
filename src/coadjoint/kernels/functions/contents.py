"""Digests of functions and everything they read: equal digests imply equal machine code and equal runs."""

from __future__ import annotations

import dis
import functools
import hashlib
import inspect
import linecache
import sys
import sysconfig
import types
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, is_dataclass
from fractions import Fraction
from typing import Any, cast

import numpy as np

from coadjoint.algebra.polynomials.polynomial import Polynomial

KNOWN_PACKAGES = frozenset({"numpy", "scipy", "numba", "llvmlite", "jax", "jaxlib"})
"""Packages whose functions and classes are identified by name, like those of the standard library."""
PLAIN_TYPES = (bool, int, float, complex, str, bytes, type(None), type(Ellipsis), type(NotImplemented), Fraction, range)
MAX_OBJECTS = 10**6
"""Largest number of objects in one digest."""
DYNAMIC_BUILTINS = frozenset({"globals", "locals", "vars", "eval", "exec", "__import__", "open", "input"})
"""Builtins with which a function can read values that its code does not name."""
DATA: tuple[Any, ...] = (bool, int, float, complex, str, bytes, tuple, list, set, frozenset, dict)
IGNORED_ATTRIBUTES = frozenset(
    "__dict__ __weakref__ __doc__ __module__ __qualname__ __annotations__ __annotate__ __annotate_func__ "
    "__annotations_cache__ __firstlineno__ __static_attributes__ __abstractmethods__ _abc_impl __parameters__ "
    "__orig_bases__ __dataclass_fields__ __dataclass_params__ __match_args__ __slots__ __wrapped__".split()
)


def contents_of(value: Any, written: bool = False) -> tuple[str, tuple[str, ...]]:
    """Return the digest of a value and of all that functions in it read, if `written` of their source text, equal in
    all processes of one version of Python; and the names of parts without one. The digest is empty if objects are
    nested too deep.
    """
    try:
        return _contents_of(value, written)
    except RecursionError:
        return "", ("objects in objects, too deep to be followed",)


def _contents_of(value: Any, written: bool) -> tuple[str, tuple[str, ...]]:
    walk = _Digester(written)
    walk.add(value)
    return walk.digest.hexdigest(), tuple(dict.fromkeys(walk.unknown))


class _Digester:
    """One traversal: objects with an identity are numbered in order of first visit, data are added by content."""

    def __init__(self, written: bool) -> None:
        self.digest, self.unknown = hashlib.blake2b(digest_size=32), list[str]()
        self._written, self._remaining = written, MAX_OBJECTS
        self._visited: dict[Any, int] = {}
        self._arrays: dict[int, bytes] = {}
        self._open: list[Any] = []
        self._references: list[Any] = []  # keeps visited objects alive, so that ids are not reused

    def _update(self, *words: Any) -> None:
        self.digest.update("".join(f"{len(text)}:{text};" for text in map(str, words)).encode("utf-8", "surrogatepass"))

    def _give_up(self, what: str) -> None:
        self.unknown.append(what)
        self._update("unknown", what)

    def _is_new(self, value: Any, *more: Any) -> bool:
        """Return whether an object is visited for the first time; otherwise add its number."""
        key = (id(value), *more)
        if key in self._visited:
            self._update("again", self._visited[key])
            return False
        self._visited[key] = len(self._visited)
        self._references.append(value)
        return True

    def add(self, value: Any) -> None:
        """Add a value according to its type."""
        self._remaining -= 1
        if self._remaining < 0:
            if self._remaining == -1:
                self._give_up(f"more than {MAX_OBJECTS} objects")
        elif (write_value := VALUES.get(type(value))) is not None:
            write_value(self, value)
        elif isinstance(value, np.ndarray | np.generic):
            self._add_array(value)
        elif self._is_new(value):
            base = next((base for base in type(value).__mro__ if base in OBJECTS), object)
            OBJECTS[base](self, value)

    def _add_plain(self, value: Any) -> None:
        self._update(type(value).__name__, repr(value))

    def _add_polynomial(self, value: Polynomial) -> None:
        self._update("polynomial")
        self._add_unordered(value.monomials.items())

    def _add_array(self, value: Any) -> None:
        array = np.asarray(value)
        kind = array.dtype.str if array.dtype.names is None else array.dtype.descr
        self._update(
            "array", type(value).__name__, kind, array.shape, array.flags.c_contiguous, array.flags.f_contiguous
        )
        if array.dtype.hasobject:
            self.add(array.ravel().tolist())
        else:
            if id(value) not in self._arrays:
                self._arrays[id(value)] = hashlib.sha256(np.ascontiguousarray(array).data).digest()
                self._references.append(value)
            self.digest.update(self._arrays[id(value)])
        if isinstance(value, np.ndarray) and type(value) is not np.ndarray:
            self.add(dict(sorted(getattr(value, "__dict__", {}).items())))

    def _add_container(self, value: Any) -> None:
        if any(value is open_container for open_container in self._open):
            self._update("inside of itself")
        elif len(value) > self._remaining:
            self._give_up(f"a {type(value).__name__} of {len(value)} entries")
        else:
            self._open.append(value)
            self._update(type(value).__name__, len(value))
            if isinstance(value, set | frozenset):
                self._add_unordered(value)
            else:
                for entry in value.items() if isinstance(value, Mapping) else value:
                    self.add(entry)
            self._open.pop()

    def _add_unordered(self, values: Iterable[Any]) -> None:
        contents = [_contents_of(value, self._written) for value in values]
        self._update(*sorted(digest for digest, _ in contents))
        self.unknown += [what for _, unknown in contents for what in unknown]

    def _add_other(self, value: Any) -> None:
        """Add an object that Numba made from a function, a named object, or an instance of any class."""
        kind = type(value)
        numba = kind.__module__.partition(".")[0] == "numba"
        if numba and isinstance(getattr(value, "py_func", None), types.FunctionType):  # a dispatcher
            self._update("compiled")
            options = getattr(value, "targetoptions", {})
            locals_types = _types_of_locals(value)
            self.add(
                [value.py_func, dict(sorted(options.items())), getattr(value, "_can_compile", True), *locals_types]
            )
            if not getattr(value, "_can_compile", True):
                self._update(*map(str, value.nopython_signatures))
        elif numba and isinstance(getattr(value, "_pyfunc", None), types.FunctionType):  # a callback
            compiler = getattr(value, "_compiler", None)
            options = sorted(getattr(compiler, "targetoptions", {}).items())
            locals_types = [*options, *_types_of_locals(compiler)]
            self.add(["callback", value._pyfunc, str(getattr(value, "_sig", "")), *locals_types])
        elif isinstance(getattr(value, "__qualname__", None), str) and (callable(value) or hasattr(kind, "__get__")):
            self._add_named(value)
        elif isinstance(value, np.ufunc) and not hasattr(value, "_dispatcher"):
            self._update("ufunc", value.__name__)
        else:
            self._add_instance(value)

    def _add_builtin(self, value: types.BuiltinFunctionType) -> None:
        """Add a C function by its name, or a method of an object with the object."""
        if isinstance(value.__self__, types.ModuleType | None):
            self._add_named(value)
        else:
            self.add(["builtin method", value.__name__, value.__self__])

    def _add_module(self, value: types.ModuleType) -> None:
        self._update("module", value.__name__)

    def _add_named(self, value: Any) -> None:
        """Add a C function or a descriptor by its name, which identifies it only in known packages."""
        owner = getattr(value, "__objclass__", None)
        module = getattr(value, "__module__", None) or getattr(owner, "__module__", None) or "builtins"
        self._update("named", module, value.__qualname__)
        if not is_known(module) and owner is None:
            self._give_up(f"{module}.{value.__qualname__}")

    def _add_class(self, kind: type) -> None:
        self._update("class", kind.__module__, kind.__qualname__)
        if not is_known(kind.__module__) and not is_own(kind.__module__):
            self.add(kind.__bases__)
            self.add({name: member for name, member in sorted(vars(kind).items()) if name not in IGNORED_ATTRIBUTES})

    def _add_instance(self, value: Any) -> None:
        kind = type(value)
        self.add(kind)
        if any(base.__module__ in ("_ctypes", "ctypes") for base in kind.__mro__):
            return self._give_up(f"a C object, {kind.__qualname__}")
        data = next((base for base in DATA if isinstance(value, base)), None)
        if data is not None:
            self.add(data(value))
        if is_dataclass(value) and is_own(kind.__module__):
            return self.add({field.name: getattr(value, field.name) for field in fields(value)})
        slots = [name for base in kind.__mro__ for name in _slots(base) if hasattr(value, name)]
        if not slots and not hasattr(value, "__dict__"):
            return None if data is not None else self._reduce(value)
        attributes = {**{name: getattr(value, name) for name in slots}, **getattr(value, "__dict__", {})}
        cached = functools.cached_property
        self.add(
            {name: attributes[name] for name in sorted(attributes) if not isinstance(getattr(kind, name, None), cached)}
        )

    def _reduce(self, value: Any) -> None:
        """Add an object of a C type by its pickled state."""
        try:
            reduced = value.__reduce_ex__(4)
            parts = (
                reduced
                if isinstance(reduced, str)
                else [reduced[0], *reduced[1:3], *map(list, filter(None, reduced[3:5]))]
            )
        except Exception:
            return self._give_up(f"an object of {type(value).__qualname__}")
        self.add(parts)

    def _add_function(self, function: types.FunctionType) -> None:
        module = function.__module__ or ""
        self._update("function")
        if is_known(module):
            self._update(module, function.__qualname__)
        elif self._written:
            text = source_of(function)
            if text is None:
                self._give_up(f"the source of {function.__qualname__}")
            self._update(text)
        else:
            self._add_code(function.__code__)
        names, attributes, imports = global_reads(function.__code__)
        self.add(function.__defaults__)
        self.add(dict(sorted((function.__kwdefaults__ or {}).items())))
        self.add({name: value for name, value in sorted(vars(function).items()) if name != "__wrapped__"})
        for name, cell in sorted(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)):
            self._update("closed over", name)
            for value in cell_value(cell):
                self._add_read(value, attributes)
        if is_known(module) or is_own(module):
            return
        builtins: dict[str, Any] = cast(Any, function).__builtins__
        for name in names:
            if name in function.__globals__:
                self._update("global", name)
                self._add_read(function.__globals__[name], attributes)
            elif name in builtins:
                value = builtins[name]
                self._update("builtin", name)
                if name in DYNAMIC_BUILTINS:
                    self._give_up(f"what {function.__qualname__} reads by {name}()")
                elif not is_known(getattr(value, "__module__", None) or "builtins"):
                    self.add(value)
        for name in imports:
            if not is_known(name) and not is_own(name):
                if name in sys.modules:
                    self._add_read(sys.modules[name], attributes)
                else:
                    self._give_up(f"the module {name}")

    def _add_read(self, value: Any, attributes: frozenset[str]) -> None:
        """Add a value that a function reads; of a module only the attributes that the function names."""
        if not isinstance(value, types.ModuleType):
            return self.add(value)
        self._update("module", value.__name__)
        known = is_known(value.__name__) or is_own(value.__name__)
        for name in sorted(attributes & vars(value).keys()):
            member = vars(value)[name]
            is_replaced = isinstance(member, types.FunctionType) and not is_known(member.__module__ or "")
            if (not known or (is_replaced and not is_own(member.__module__ or ""))) and self._is_new(value, name):
                self._update("attribute", name)
                self._add_read(member, attributes)

    def _add_code(self, code: types.CodeType) -> None:
        counts = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags
        names = code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
        self._update("code", *counts, *names, len(code.co_code))
        self.digest.update(code.co_code + getattr(code, "co_exceptiontable", b""))
        self.add(code.co_consts)


def _consists_of(parts: Callable[[Any], list[Any]]) -> Writer:
    """Return what adds the values that an object consists of."""
    return lambda digester, value: digester.add(parts(value))


Writer = Callable[[_Digester, Any], None]
# Type -> what adds a value of this very type, by its content.
VALUES: Mapping[type, Writer] = {
    **dict.fromkeys(PLAIN_TYPES, _Digester._add_plain),
    **dict.fromkeys((tuple, list, dict, set, frozenset, types.MappingProxyType), _Digester._add_container),
    types.CodeType: _Digester._add_code,
    Polynomial: _Digester._add_polynomial,
}
# Type -> what adds an object of this type or of a derived one, which has an identity.
OBJECTS: Mapping[type, Writer] = {
    types.FunctionType: _Digester._add_function,
    types.BuiltinFunctionType: _Digester._add_builtin,
    types.ModuleType: _Digester._add_module,
    type: _Digester._add_class,
    functools.partial: _consists_of(lambda value: ["partial", value.func, value.args, value.keywords]),
    types.MethodType: _consists_of(lambda value: ["method", value.__func__, value.__self__]),
    staticmethod: _consists_of(lambda value: [type(value).__name__, value.__func__]),
    classmethod: _consists_of(lambda value: [type(value).__name__, value.__func__]),
    property: _consists_of(lambda value: ["property", value.fget, value.fset, value.fdel]),
    functools.cached_property: _consists_of(lambda value: ["cached property", value.func]),
    types.CellType: _consists_of(lambda value: ["cell", *cell_value(value)]),
    type(functools.cache(str)): _consists_of(lambda value: ["cached", value.__wrapped__]),
    object: _Digester._add_other,
}


def compilation_key(function: Any) -> Any:
    """Return a key that is equal for functions that compile to the same code; a unique object if that is unknown."""
    digest, unknown = contents_of(function)
    return object() if unknown else digest


def _types_of_locals(compiler: Any) -> list[tuple[str, str]]:
    """Return the declared types of local variables of a function that Numba compiles."""
    return sorted((name, str(kind)) for name, kind in (getattr(compiler, "locals", None) or {}).items())


def _slots(kind: type) -> tuple[str, ...]:
    slots = vars(kind).get("__slots__", ())
    return (slots,) if isinstance(slots, str) else tuple(slots)


@functools.lru_cache(maxsize=4096)
def global_reads(code: types.CodeType) -> tuple[tuple[str, ...], frozenset[str], tuple[str, ...]]:
    """Return the global names that a function reads, the attributes it names, and the modules it imports."""
    names, attributes, imports = set[str](), set[str](code.co_names), set[str]()
    for instruction in dis.get_instructions(code):
        if instruction.opname in ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS"):
            names.add(instruction.argval)
        elif instruction.opname == "IMPORT_NAME":
            imports.add(instruction.argval)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            inner = global_reads(constant)
            names |= set(inner[0])
            attributes |= inner[1]
            imports |= set(inner[2])
        elif isinstance(constant, str):
            attributes.add(constant)  # possibly an argument of getattr
    return tuple(sorted(names)), frozenset(attributes), tuple(sorted(imports))


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
