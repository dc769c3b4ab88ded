"""Compilation of user functions and steps by Numba; machine code is reused only if all that they read is unchanged.

A step receives its scheme as a tuple of the parameters, and its system as a tuple whose methods call the compiled
kernels: ``dim``, ``sign``, ``vector_field(x, t)``, ``energy(x, t)``, ``structure_matrix(x)``, ``hamiltonian.value(x,
t)``, ``hamiltonian.gradient(x, t)``; if the system has no function of the user also ``jacobian(x, t)`` and
``hamiltonian.hessian(x, t)``.
"""

from __future__ import annotations

import ctypes
import re
import types
import warnings
from collections import namedtuple
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba import carray
from numba import types as numba_types
from numba.extending import intrinsic, overload_method

from coadjoint.interruption import deferred
from coadjoint.kernels.functions.contents import cells_of, contents_of, global_reads, is_known, is_own
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
    key = digest, options
    if not unknown and key in _COMPILED:
        return _COMPILED[key]
    stage = f"the machine code of {what} by Numba"
    note_progress(stage)  # before and after, so that the time is that of this stage
    with deferred():
        result = make()
    note_progress(stage)
    if not unknown:
        _cache(_COMPILED, key, result)
    elif what not in _warned:
        _warned.add(what)
        warnings.warn(
            f"{what} is compiled again whenever it is prepared, since some values it reads cannot be compared: "
            f"{', '.join(unknown[:3])}",
            UserWarning,
            stacklevel=2,
        )
    return result


def _cache(cache: dict[Any, Any], key: Any, value: Any) -> None:
    while len(cache) >= MAX_CACHED:
        del cache[next(iter(cache))]
    cache[key] = value


def _fresh(value: Any, made: dict[int, Any], attributes: frozenset[str] = frozenset(), compiles: bool = False) -> Any:
    """Return a value whose dispatchers have no machine code, which may be older than what they read; if `compiles`,
    plain functions become dispatchers.
    """
    if id(value) in made:
        return made[id(value)][1]
    if type(value) is tuple:
        return tuple(_fresh(entry, made, attributes, compiles) for entry in value)
    if isinstance(value, types.ModuleType) and not is_known(value.__name__):
        module = types.ModuleType(value.__name__)
        made[id(value)] = value, module
        held = vars(value)
        vars(module).update(
            {**held, **{name: _fresh(held[name], made, attributes) for name in attributes & held.keys()}}
        )
        return module
    if isinstance(value, types.FunctionType) and compiles:
        value = numba.njit(value, error_model="numpy")
    if not isinstance(value, numba.core.dispatcher.Dispatcher):
        return value
    digest, unknown = contents_of(value)
    if unknown or digest not in _FRESH:
        copy = _unfilled_copy(value.py_func)
        new: Any = type(value)(copy, value.locals, value.targetoptions)
        made[id(value)] = value, new  # before it is filled, since it may call itself
        _fill(copy, value.py_func, made)
        if not value._can_compile:
            for signature in value.nopython_signatures:
                new.compile(signature)
            new.disable_compile()
        if unknown:
            return new
        _cache(_FRESH, digest, new)
    return _FRESH[digest]


def _unfilled_copy(function: types.FunctionType) -> types.FunctionType:
    cells = tuple(types.CellType() for _ in function.__closure__ or ()) or None
    names = dict(function.__globals__)
    copy = types.FunctionType(function.__code__, names, function.__name__, function.__defaults__, cells)
    copy.__kwdefaults__, copy.__qualname__ = function.__kwdefaults__, function.__qualname__
    return copy


def _fill(copy: types.FunctionType, function: types.FunctionType, made: dict[int, Any]) -> types.FunctionType:
    """Set the globals and cells of a copy to those of a function, with fresh dispatchers."""
    names, attributes = global_reads(function.__code__)
    for name in function.__globals__.keys() & {*names}:
        copy.__globals__[name] = _fresh(function.__globals__[name], made, attributes)
    held = cells_of(function)
    for name, cell in zip(function.__code__.co_freevars, copy.__closure__ or (), strict=True):
        if name in held:
            cell.cell_contents = _fresh(held[name], made, attributes, is_own(function.__module__ or ""))
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


def _compiled(function: Callable[..., Any], size: int, results: int, scalar: bool, flat: bool, timed: bool) -> Any:
    inner, is_array = called_in_machine_code(function), flat and not scalar
    count = results if is_array else 1

    def call(y: Any, t: float, out: Any) -> None:  # Numba compiles only the branches of these arguments
        for k in range(count):
            out[k] = np.nan  # stops the run if the function raises
        x = y[0] if scalar else carray(y, (size,))
        succeeded, value = attempt(inner, x, t) if timed else attempt(inner, x)
        if succeeded:
            if is_array:
                values = np.asarray(value).ravel()
                for k in range(count):
                    out[k] = values[k]
            else:
                out[0] = value

    return numba.cfunc(SIGNATURE, nopython=True, error_model="numpy")(call)


@intrinsic  # type: ignore[untyped-decorator]
def attempt(context: Any, function: Any, *arguments: Any) -> Any:
    """Call a compiled function; return whether it has not raised, and its result. Numba compiles a block of `try` in
    half as much time again as the whole callback without it.
    """
    signature = function.get_call_type(context, arguments, {})
    result = numba_types.Tuple((numba_types.boolean, signature.return_type))

    def generate(target: Any, builder: Any, _: Any, values: Any) -> Any:
        compiled = function.dispatcher.get_compile_result(signature)
        target.active_code_library.add_linking_library(compiled.library)
        given = [builder.extract_value(values[1], k) for k in range(len(arguments))]
        for k, wanted in enumerate(signature.args):
            if isinstance(wanted, numba_types.StarArgTuple | numba_types.StarArgUniTuple):
                given[k:] = [target.make_tuple(builder, wanted, given[k:])]
            elif k < len(arguments):
                given[k] = target.cast(builder, given[k], arguments[k], wanted)
            else:
                given.append(None)  # a default
        status, value = target.call_internal_no_propagate(builder, compiled.fndesc, signature, given)
        return target.make_tuple(builder, result, (status.is_ok, value))

    return result(function, numba_types.StarArgTuple(arguments)), generate


def called_in_machine_code(function: Any) -> Any:
    """Return a function in the form that compiled code calls, in which no dispatcher has machine code yet."""
    if isinstance(function, MultipleOf):
        return _multiple(called_in_machine_code(function.function), function.factor, function.scalar)
    if isinstance(function, types.FunctionType):
        copy = _fill(_unfilled_copy(function), function, {})
        return numba.njit(boundscheck=True, **_INTERNAL_OPTIONS)(copy)
    inner = _fresh(function, {})
    is_dispatcher = isinstance(inner, numba.core.dispatcher.Dispatcher)
    return inner if is_dispatcher else numba.njit(**_INTERNAL_OPTIONS)(lambda *arguments: inner(*arguments))


# Called by compiled code only, so that no Python wrappers are compiled.
_INTERNAL_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def _multiple(inner: Any, factor: float, scalar: bool) -> Any:
    if scalar:
        return numba.njit(**_INTERNAL_OPTIONS)(lambda *arguments: factor * inner(*arguments))
    return numba.njit(**_INTERNAL_OPTIONS)(lambda *arguments: factor * np.asarray(inner(*arguments)))


def numba_error_text(error: Exception) -> str:
    """Return the informative lines of a Numba error, joined to one line; of a call of a Python function, its name."""
    _, calls, text = str(error).partition("<intrinsic attempt>")
    text = text.partition("raised a specific error:")[2] if calls else str(error)
    if helper := re.search(r"Untyped global name '(\w+)'[^\n]*\s*[^\n]*<class 'function'>", text):
        return f"it calls the Python function {helper[1]}; compile that one too, by the decorator @numba.njit"
    lines = [line.strip(" -\x1b[0123456789;m").removeprefix("TypingError: ") for line in text.splitlines()]
    informative = [
        line for line in lines if line and not line.startswith(("Failed in", "During:", "File ", "For more", "<"))
    ]
    return " ".join(informative[:3])[:400]


STEP_SIGNATURE = numba_types.int64(
    numba_types.CPointer(numba_types.int64), POINTER, numba_types.float64, numba_types.float64, POINTER
)

SystemView = namedtuple("SystemView", ("dim", "sign", "address", "hamiltonian"))
HamiltonianView = namedtuple("HamiltonianView", ("dim", "address"))
DifferentiableSystem = namedtuple("DifferentiableSystem", ("dim", "sign", "address", "hamiltonian"))
DifferentiableHamiltonian = namedtuple("DifferentiableHamiltonian", ("dim", "address"))
SYSTEMS = (SystemView, DifferentiableSystem)
HAMILTONIANS = (HamiltonianView, DifferentiableHamiltonian)


@numba.njit(inline="always")
def _unchanged(x: Any) -> Any:
    return x


@numba.njit
def _contiguous(x: Any) -> Any:
    return np.ascontiguousarray(x).astype(np.float64)


def _method(kernel: Any, adapt: Any, result: str, timed: bool) -> Callable[..., Any]:
    """Return a method that calls a compiled kernel; Numba compiles only one branch of the second one."""
    matrix = result == "matrix"

    def number(self: Any, x: Any, t: float = 0.0) -> Any:
        y = adapt(x)
        return kernel(self.address, y.ctypes.data, t)

    def array(self: Any, x: Any, t: float = 0.0) -> Any:
        y, out = adapt(x), np.empty((self.dim, self.dim) if matrix else self.dim)
        kernel(self.address, y.ctypes.data, t, out.ctypes.data)
        return out

    def constant(self: Any, x: Any) -> Any:
        y, out = adapt(x), np.empty((self.dim, self.dim))
        kernel(self.address, y.ctypes.data, out.ctypes.data)
        return out

    return number if result == "number" else array if timed else constant


def _add_method(kinds: tuple[Any, ...], name: str, kernel_name: str, result: str, timed: bool = True) -> None:
    """Add a method to tuples of these kinds in compiled code."""
    kernel, is_number = getattr(kernels(), kernel_name), result == "number"
    integer, real = ctypes.c_int64, ctypes.c_double
    kernel.argtypes = [integer, integer, *([real] if timed else []), *([] if is_number else [integer])]
    kernel.restype = real if is_number else None
    direct, copying = (_method(kernel, adapt, result, timed) for adapt in (_unchanged, _contiguous))

    def select(self: Any, x: Any) -> Any:
        if getattr(self, "instance_class", None) not in kinds:
            return None
        is_plain_vector = getattr(x, "layout", "") == "C" and x.ndim == 1 and x.dtype == numba_types.float64
        return direct if is_plain_vector else copying

    def select_timed(self: Any, x: Any, t: float = 0.0) -> Any:
        return select(self, x)

    for kind in (numba_types.NamedTuple, numba_types.NamedUniTuple):
        overload_method(kind, name)(select_timed if timed else select)


_add_method(SYSTEMS, "vector_field", "field_at", "vector")
_add_method(SYSTEMS, "structure_matrix", "structure_at", "matrix", timed=False)
_add_method(SYSTEMS, "energy", "energy_at", "number")
_add_method(SYSTEMS[1:], "jacobian", "jacobian_at", "matrix")
_add_method(HAMILTONIANS, "gradient", "gradient_at", "vector")
_add_method(HAMILTONIANS, "value", "energy_at", "number")
_add_method(HAMILTONIANS[1:], "hessian", "hessian_at", "matrix")


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
        succeeded, new_state = attempt(inner, scheme, system, state, t, h)
        out[0] = np.nan
        if succeeded and new_state.size == n:
            for k in range(n):
                out[k] = new_state[k]
        return 0

    return numba.cfunc(STEP_SIGNATURE, nopython=True, error_model="numpy")(call)
