"""Compilation of user functions and steps by Numba; machine code is reused only if all that they read is unchanged.

A step receives its scheme as a tuple of the parameters, and its system as a tuple whose methods call the compiled
kernels: ``dim``, ``sign``, ``vector_field(x, t)``, ``energy(x, t)``, ``structure_matrix(x)``, ``hamiltonian.value(x,
t)``, ``hamiltonian.gradient(x, t)``; if the system has no function of the user also ``jacobian(x, t)`` and
``hamiltonian.hessian(x, t)``.
"""

from __future__ import annotations

import ctypes
import inspect
import re
import types
import warnings
from collections import namedtuple
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numba
import numpy as np
from numba import carray
from numba import types as numba_types
from numba.extending import overload_method

from coadjoint.interruption import deferred
from coadjoint.kernels.functions.contents import cell_value, compilation_key, contents_of, global_reads, is_own
from coadjoint.kernels.library import kernels
from coadjoint.long_operations import note_progress
from coadjoint.systems.user_functions import MultipleOf

POINTER = numba_types.CPointer(numba_types.float64)
SIGNATURE = numba_types.void(POINTER, numba_types.float64, POINTER)
# Number of compiled functions that are kept; the oldest one is dropped for the next.
MAX_CACHED = 4096
_COMPILED: dict[Any, Any] = {}
_FRESH: dict[str, Any] = {}
_warned: set[str] = set()


def compile_cached(value: Any, options: tuple[Any, ...], what: str, make: Callable[[], Any]) -> Any:
    """Return the cached result of `make`, valid while `value` and everything its functions read are unchanged. Values
    that cannot be compared are compiled again on each call, with a warning. An interrupt waits for `make`: if it ended
    a generator of Numba's registries, Numba would compile nothing more in this process.
    """
    digest, unknown = contents_of(value)
    if unknown:
        result = _made(what, make)
        if what not in _warned:
            _warned.add(what)
            warnings.warn(
                f"{what} is compiled again whenever it is prepared, since some values it reads cannot be compared: "
                f"{', '.join(unknown[:3])}",
                UserWarning,
                stacklevel=2,
            )
        return result
    key = digest, options
    if key not in _COMPILED:
        _cache(_COMPILED, key, _made(what, make))
    return _COMPILED[key]


def _made(what: str, make: Callable[[], Any]) -> Any:
    """Return the result of `make`, with its time as a stage of a long operation, before and after."""
    stage = f"the machine code of {what} by Numba"
    note_progress(stage)
    with deferred():
        result = make()
    note_progress(stage)
    return result


def compiled_digests() -> set[str]:
    """Return the digests of all compiled functions."""
    return {digest for digest, _ in _COMPILED}


def _cache(cache: dict[Any, Any], key: Any, value: Any) -> None:
    while len(cache) >= MAX_CACHED:
        del cache[next(iter(cache))]
    cache[key] = value


def _with_fresh_dispatchers(value: Any, fresh: dict[int, tuple[Any, Any]], compiles: bool) -> Any:
    """Return a value with fresh dispatchers; if `compiles`, plain functions are compiled too."""
    if id(value) in fresh:
        return fresh[id(value)][1]
    if isinstance(value, tuple) and type(value) is tuple:
        return tuple(_with_fresh_dispatchers(entry, fresh, compiles) for entry in value)
    if isinstance(value, types.FunctionType) and compiles:
        return _with_fresh_dispatchers(numba.njit(value, error_model="numpy"), fresh, compiles)
    if not isinstance(value, numba.core.dispatcher.Dispatcher):
        return value
    digest, unknown = contents_of(value)
    if unknown or digest not in _FRESH:
        new: Any = None

        def register_copy(copy: types.FunctionType) -> None:
            nonlocal new
            new = type(value)(copy, value.locals, value.targetoptions)
            fresh[id(value)] = value, new

        _copied(value.py_func, fresh, register_copy)
        if not value._can_compile:
            for signature in value.nopython_signatures:
                new.compile(signature)
            new.disable_compile()
        if unknown:
            return new
        _cache(_FRESH, digest, new)
    return _FRESH[digest]


def _copied(
    function: types.FunctionType,
    fresh: dict[int, tuple[Any, Any]],
    register_copy: Callable[[types.FunctionType], None] | None = None,
) -> types.FunctionType:
    """Return a copy of a function that reads fresh dispatchers, or if recursive what `register_copy` registers."""
    cells = tuple(types.CellType() for _ in function.__closure__ or ())
    names = dict(function.__globals__)
    copy = types.FunctionType(function.__code__, names, function.__name__, function.__defaults__, cells or None)
    copy.__kwdefaults__, copy.__qualname__ = function.__kwdefaults__, function.__qualname__
    copy.__module__ = function.__module__
    vars(copy).update(vars(function))
    if register_copy is not None:
        register_copy(copy)
    compiles = is_own(function.__module__ or "")
    for new, old in zip(cells, function.__closure__ or (), strict=True):
        for value in cell_value(old):
            new.cell_contents = _with_fresh_dispatchers(value, fresh, compiles)
    _, attributes, _ = global_reads(function.__code__)
    for name in attributes & names.keys():
        names[name] = _with_fresh_dispatchers(_module(names[name], attributes, fresh), fresh, False)
    return copy


def _module(value: Any, attributes: frozenset[str], fresh: dict[int, tuple[Any, Any]]) -> Any:
    """Return a copy of a module with fresh dispatchers if it has any that are read; return other values unchanged."""
    if not isinstance(value, types.ModuleType):
        return value
    replaced = {
        name: _with_fresh_dispatchers(vars(value)[name], fresh, False) for name in attributes & vars(value).keys()
    }
    if all(vars(value)[name] is value_of_name for name, value_of_name in replaced.items()):
        return value
    copy = types.ModuleType(value.__name__)
    vars(copy).update({**vars(value), **replaced})
    return copy


def callback_of(
    function: Callable[..., Any], size: int, results: int, scalar: bool, flat: bool, timed: bool, what: str
) -> Any:
    """Return a function as a C callback; TypeError with the reason of Numba if it cannot be compiled."""

    def make() -> Any:
        try:
            return _compiled(function, size, results, scalar, flat, timed)
        except Exception as error:  # Numba raises exceptions of many types
            raise TypeError(f"{what} cannot be compiled by Numba: {numba_error_text(error)}") from error

    return compile_cached(function, (size, results, scalar, flat, timed), what, make)


# Functions from which on a warning is given, after some seconds of compilation, and the time (s) that one takes.
WARNING_COUNT = 48
SECONDS_PER_FUNCTION = 0.05


def warn_many_functions(functions: Sequence[Callable[..., Any]]) -> None:
    """Warn before compiling so many functions of a Hamiltonian that it takes seconds."""
    if len(functions) < WARNING_COUNT:
        return
    count = len({compilation_key(function) for function in functions} - compiled_digests())
    if count >= WARNING_COUNT:
        warnings.warn(
            f"{count} different Python functions are compiled one by one, about {SECONDS_PER_FUNCTION * count:.0f} s "
            "in all; it is faster to write one function of many commuting coordinates, with an array of constants: "
            "SplitHamiltonian([((0, 3, 6), Hamiltonian(value, gradient))])",
            UserWarning,
            stacklevel=2,
        )


def _compiled(function: Callable[..., Any], size: int, results: int, scalar: bool, flat: bool, timed: bool) -> Any:
    # The result is NaN until the function returns: if it raises, the NaN remains and stops the run.
    inner = called_in_machine_code(function)
    body = _array(inner, size, results, timed) if flat and not scalar else _value(inner, size, scalar, timed)
    return numba.cfunc(SIGNATURE, nopython=True, error_model="numpy")(body)


def called_in_machine_code(function: Any) -> Any:
    """Return a function in the form that compiled code calls, in which no dispatcher has machine code yet."""
    if isinstance(function, MultipleOf):
        return _multiple(called_in_machine_code(function.function), function.factor, function.scalar)
    if isinstance(function, types.FunctionType):
        return numba.njit(boundscheck=True, **_INTERNAL_OPTIONS)(_copied(function, {}))
    return _with_fresh_dispatchers(function, {}, False)


# Called by compiled code only, so that no Python wrappers are compiled.
_INTERNAL_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def _multiple(inner: Any, factor: float, scalar: bool) -> Any:
    if scalar:
        return numba.njit(**_INTERNAL_OPTIONS)(lambda *arguments: factor * inner(*arguments))
    return numba.njit(**_INTERNAL_OPTIONS)(lambda *arguments: factor * np.asarray(inner(*arguments)))


def numba_error_text(error: Exception) -> str:
    """Return the informative lines of a Numba error, joined to one line; of a call of a Python function, its name."""
    if helper := re.search(r"Untyped global name '(\w+)'[^\n]*\s*[^\n]*<class 'function'>", str(error)):
        return f"it calls the Python function {helper[1]}; compile that one too, by the decorator @numba.njit"
    lines = [line.strip(" -\x1b[0123456789;m") for line in str(error).splitlines()]
    informative = [
        line for line in lines if line and not line.startswith(("Failed in", "During:", "File ", "For more", "<"))
    ]
    return " ".join(informative[:3])[:400]


def _value(inner: Any, size: int, scalar: bool, timed: bool) -> Callable[..., None]:
    """Return a callback for one number; Numba compiles only the branches of these arguments."""

    def call(y: Any, t: float, out: Any) -> None:
        out[0] = np.nan
        x = y[0] if scalar else carray(y, (size,))
        try:
            out[0] = inner(x, t) if timed else inner(x)
        except Exception:
            out[0] = np.nan

    return call


def _array(inner: Any, size: int, results: int, timed: bool) -> Callable[..., None]:
    def fill(y: Any, t: float, out: Any) -> None:
        for k in range(results):
            out[k] = np.nan
        x = carray(y, (size,))
        values = np.asarray(inner(x, t) if timed else inner(x)).ravel()
        for k in range(results):
            out[k] = values[k]

    return not_a_number_after_errors(fill)


def not_a_number_after_errors(fill: Callable[..., None]) -> Callable[..., None]:
    """Return a function that fills numbers, the first of them by NaN if it raises.

    A block of `try` takes Numba much longer than the same statements outside it: this one has a single call.
    """
    filled = numba.njit(**_INTERNAL_OPTIONS)(fill)

    def call(y: Any, t: float, out: Any) -> None:
        try:
            filled(y, t, out)
        except Exception:
            out[0] = np.nan

    return call


STEP_SIGNATURE = numba_types.int64(
    numba_types.CPointer(numba_types.int64), POINTER, numba_types.float64, numba_types.float64, POINTER
)

SystemView = namedtuple("SystemView", ("dim", "sign", "address", "hamiltonian"))
HamiltonianView = namedtuple("HamiltonianView", ("dim", "address"))
DifferentiableSystem = namedtuple("DifferentiableSystem", ("dim", "sign", "address", "hamiltonian"))
DifferentiableHamiltonian = namedtuple("DifferentiableHamiltonian", ("dim", "address"))
SYSTEMS = (SystemView, DifferentiableSystem)
HAMILTONIANS = (HamiltonianView, DifferentiableHamiltonian)


def _kernel(name: str, *arguments: Any, result: Any = None) -> Any:
    function = getattr(kernels(), name)
    function.argtypes, function.restype = [ctypes.c_int64, ctypes.c_int64, *arguments], result
    return function


FIELD = _kernel("field_at", ctypes.c_double, ctypes.c_int64)
GRADIENT = _kernel("gradient_at", ctypes.c_double, ctypes.c_int64)
HESSIAN = _kernel("hessian_at", ctypes.c_double, ctypes.c_int64)
JACOBIAN = _kernel("jacobian_at", ctypes.c_double, ctypes.c_int64)
STRUCTURE = _kernel("structure_at", ctypes.c_int64)
ENERGY = _kernel("energy_at", ctypes.c_double, result=ctypes.c_double)


def _array_method(kernel: Any, adapt: Any, matrix: bool) -> Callable[..., Any]:
    """Return a method whose result is a vector, or a `matrix`; Numba compiles only one branch."""

    def method(self: Any, x: Any, t: float = 0.0) -> Any:
        y, out = adapt(x), np.empty((self.dim, self.dim) if matrix else self.dim)
        kernel(self.address, y.ctypes.data, t, out.ctypes.data)
        return out

    return method


def _structure_method(kernel: Any, adapt: Any) -> Callable[..., Any]:
    def method(self: Any, x: Any) -> Any:
        y, out = adapt(x), np.empty((self.dim, self.dim))
        kernel(self.address, y.ctypes.data, out.ctypes.data)
        return out

    return method


def _number_method(kernel: Any, adapt: Any) -> Callable[..., Any]:
    def method(self: Any, x: Any, t: float = 0.0) -> Any:
        y = adapt(x)
        return kernel(self.address, y.ctypes.data, t)

    return method


@numba.njit(inline="always")
def _unchanged(x: Any) -> Any:
    return x


@numba.njit
def _contiguous(x: Any) -> Any:
    return np.ascontiguousarray(x).astype(np.float64)


def _add_method(kinds: tuple[Any, ...], name: str, make: Callable[..., Any], kernel: Any) -> None:
    """Add a method to tuples of these kinds in compiled code."""
    direct, copying = make(kernel, _unchanged), make(kernel, _contiguous)

    def select(self: Any, x: Any) -> Any:
        if getattr(self, "instance_class", None) not in kinds:
            return None
        is_plain_vector = getattr(x, "layout", "") == "C" and x.ndim == 1 and x.dtype == numba_types.float64
        return direct if is_plain_vector else copying

    def select_timed(self: Any, x: Any, t: float = 0.0) -> Any:
        return select(self, x)

    for kind in (numba_types.NamedTuple, numba_types.NamedUniTuple):
        overload_method(kind, name)(select_timed if "t" in inspect.signature(direct).parameters else select)


_add_method(SYSTEMS, "vector_field", partial(_array_method, matrix=False), FIELD)
_add_method(SYSTEMS, "structure_matrix", _structure_method, STRUCTURE)
_add_method(SYSTEMS, "energy", _number_method, ENERGY)
_add_method(SYSTEMS[1:], "jacobian", partial(_array_method, matrix=True), JACOBIAN)
_add_method(HAMILTONIANS, "gradient", partial(_array_method, matrix=False), GRADIENT)
_add_method(HAMILTONIANS, "value", _number_method, ENERGY)
_add_method(HAMILTONIANS[1:], "hessian", partial(_array_method, matrix=True), HESSIAN)


def compiled_step(
    function: Callable[..., Any], names: tuple[str, ...], values: tuple[Any, ...], derivatives: bool
) -> tuple[Any, str]:
    """Compile ``step(self, system, x, t, h)`` with these scheme parameters, for systems with or without exact
    derivatives.

    Return the callback, with its ``address``, or None and the reason why Numba cannot compile the step.
    """
    try:
        return compile_cached(
            (function, names, values),
            ("step", derivatives),
            function.__qualname__,
            lambda: _compiled_function(function, names, values, derivatives),
        ), ""
    except Exception as error:  # Numba raises exceptions of many types
        return None, f"Numba cannot compile them ({numba_error_text(error)})"


def _compiled_function(
    function: Callable[..., Any], names: tuple[str, ...], values: tuple[Any, ...], derivatives: bool
) -> Any:
    scheme: Any = namedtuple("Scheme", names or ("nothing",))(*(values or (0,)))
    system_kind, hamiltonian_kind = SYSTEMS[derivatives], HAMILTONIANS[derivatives]
    inner = called_in_machine_code(function)

    def call(system_numbers: Any, x: Any, t: float, h: float, out: Any) -> int:
        numbers = carray(system_numbers, (2,))
        n, sign = numbers[0], numbers[1:2].view(np.float64)[0]
        address = numbers.ctypes.data
        system = system_kind(n, sign, address, hamiltonian_kind(n, address))
        state = carray(x, (n,)).copy()
        try:
            new_state = inner(scheme, system, state, t, h)
            if new_state.size == n:
                for k in range(n):
                    out[k] = new_state[k]
        except Exception:
            out[0] = np.nan
        return 0

    return numba.cfunc(STEP_SIGNATURE, nopython=True, error_model="numpy")(call)
