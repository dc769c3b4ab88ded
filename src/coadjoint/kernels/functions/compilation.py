"""Compilation of user functions and steps by Numba; machine code is reused only if all that they read is unchanged.

A step receives its scheme as a tuple of the parameters, and its system as a tuple whose methods call the compiled
kernels: ``dim``, ``sign``, ``vector_field(x, t)``, ``energy(x, t)``, ``structure_matrix(x)``, ``hamiltonian.value(x,
t)``, ``hamiltonian.gradient(x, t)``; if the system has no function of the user also ``jacobian(x, t)`` and
``hamiltonian.hessian(x, t)``.
"""

from __future__ import annotations

import ctypes
import re
import warnings
from collections import namedtuple
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import carray
from numba import types as numba_types
from numba.extending import intrinsic, overload, overload_method
from numpy.typing import NDArray

from coadjoint.interruption import deferred
from coadjoint.kernels.functions.contents import contents_of, lifted_contents
from coadjoint.kernels.functions.copies import POINTER, Places, called_in_machine_code, store
from coadjoint.kernels.functions.machine_code import MachineCode, stored_or_compiled, with_environments
from coadjoint.kernels.library import kernels
from coadjoint.long_operations import note_progress
from coadjoint.systems.time_spans import OUTSIDE, refuse_time
from coadjoint.systems.user_functions import MultipleOf

SIGNATURE = numba_types.void(POINTER, numba_types.float64, POINTER, POINTER)
NO_CONSTANTS = np.zeros(0)
_COMPILED: dict[Any, Any] = {}
OWN_FOLDER = Path(__file__).resolve().parents[2]
_CONSTANT: dict[str, bool] = {}
"""Digests of functions whose constants are compiled into their machine code."""
_warned: set[str] = set()


@overload(refuse_time)
def _compiled_refusal(t: Any, first: Any, last: Any) -> Callable[..., Any]:
    # Numba formats no floats.
    def refuse(t: Any, first: Any, last: Any) -> Any:
        raise ValueError("the time is " + OUTSIDE)

    return refuse


def compile_cached(value: Any, options: tuple[Any, ...], what: str, make: Callable[[], Any]) -> Any:
    """Return the cached result of `make`, valid while `value` and everything its functions read are unchanged. Values
    that cannot be compared are compiled again on each call, with a warning.
    """
    digest, unknown = contents_of(value)
    return _made_each_time(unknown, what, make) if unknown else _cached((digest, options), what, make)


def _made_each_time(unknown: tuple[str, ...], what: str, make: Callable[[], Any]) -> Any:
    if what not in _warned:
        _warned.add(what)
        warnings.warn(
            f"{what} is compiled again whenever it is prepared, since some values it reads cannot be compared: "
            f"{', '.join(unknown[:3])}",
            UserWarning,
            stacklevel=2,
        )
    return _made(what, make)


def _cached(key: Any, what: str, make: Callable[[], Any]) -> Any:
    if key not in _COMPILED:
        store(_COMPILED, key, _made(what, make))
    return _COMPILED[key]


def _made(what: str, make: Callable[[], Any]) -> Any:
    """Return the result of `make`. An interrupt waits for it, since it might end a generator of Numba's registries, and
    nothing more would be compiled in this process.
    """
    stage = f"the machine code of {what} by Numba"
    note_progress(stage)  # before and after, so that the time is that of this stage
    with deferred():
        result = make()
    note_progress(stage)
    return result


def callback_with_constants(
    function: Any, timed: bool, what: str, make: Callable[[Any, Any], Any]
) -> tuple[MachineCode, NDArray[np.float64]]:
    """Return a callback, and the constants that are its last argument. `make` compiles it from a function and an
    intrinsic that calls it with a state, a time and the constants; equal ones are compared by what they read.
    """
    function = without_multiples_of(function, timed)
    contents, options = lifted_contents(function), (timed, contents_of(make)[0])

    def compiled(places: Places, *passed: int) -> Any:
        return make(called_in_machine_code(function, places), attempting(*passed))

    constant = partial(compiled, {}, *((0, 1) if timed else (0,)))
    if contents.unknown:
        return _made_each_time(contents.unknown, what, lambda: MachineCode.of(constant())), NO_CONSTANTS
    digest = contents.digest
    if len(contents.constants):
        key = digest, options
        if digest not in _CONSTANT:
            lifted = partial(compiled, contents.places, *((0, 1, 2) if timed else (0, 2)))
            with suppress(Exception):  # of many types from Numba; those of the function are raised again below
                return _cached(key, what, partial(stored_or_compiled, key, lifted)), contents.constants
            store(_CONSTANT, digest, True)
        digest, _ = contents_of(function)
    key = digest, options
    return _cached(key, what, partial(stored_or_compiled, key, constant)), NO_CONSTANTS


def without_multiples_of(function: Any, timed: bool) -> Any:
    """Return a `MultipleOf` a function as a function, of which the factor is a constant."""
    if not isinstance(function, MultipleOf):
        return function
    inner, factor = without_multiples_of(function.function, timed), function.factor
    if function.scalar:
        return (lambda x, t: factor * inner(x, t)) if timed else (lambda x: factor * inner(x))
    return (lambda x, t: factor * np.asarray(inner(x, t))) if timed else (lambda x: factor * np.asarray(inner(x)))


def callback_of(
    function: Callable[..., Any], size: int, results: int, scalar: bool, flat: bool, timed: bool, what: str
) -> tuple[MachineCode, NDArray[np.float64]]:
    """Return a function as a C callback, and the constants that are its last argument; TypeError with the reason of
    Numba if it cannot be compiled.
    """
    make = partial(_compiled, size, results, scalar, flat)
    try:
        return callback_with_constants(function, timed, what, make)
    except Exception as error:  # Numba raises exceptions of many types
        raise TypeError(f"{what} cannot be compiled by Numba: {numba_error_text(error)}") from error


def _compiled(size: int, results: int, scalar: bool, flat: bool, inner: Any, attempt: Any) -> Any:
    is_array = flat and not scalar
    count = results if is_array else 1

    def call(y: Any, t: float, out: Any, constants: Any) -> None:  # Numba compiles only the branches of these arguments
        for k in range(count):
            out[k] = np.nan  # stops the run if the function raises
        x = y[0] if scalar else carray(y, (size,))
        succeeded, value = attempt(inner, x, t, constants)
        if succeeded:
            if is_array:
                values = np.asarray(value).ravel()
                for k in range(count):
                    out[k] = values[k]
            else:
                out[0] = value

    return numba.cfunc(SIGNATURE, nopython=True, error_model="numpy")(call)


@cache
def attempting(*chosen: int) -> Any:
    """Return an intrinsic that calls a compiled function with some arguments; it returns whether the function has not
    raised, and the result. Numba compiles a block of `try` in half as much time again as a callback without it.
    """

    @intrinsic  # type: ignore[untyped-decorator]
    def attempt(context: Any, function: Any, *arguments: Any) -> Any:
        passed = tuple(arguments[k] for k in chosen)
        signature = function.get_call_type(context, passed, {})
        result = numba_types.Tuple((numba_types.boolean, signature.return_type))

        def generate(target: Any, builder: Any, _: Any, values: Any) -> Any:
            compiled = function.dispatcher.get_compile_result(signature)
            target.active_code_library.add_linking_library(compiled.library)
            given = [builder.extract_value(values[1], k) for k in chosen]
            for k, wanted in enumerate(signature.args):
                if isinstance(wanted, numba_types.StarArgTuple | numba_types.StarArgUniTuple):
                    given[k:] = [target.make_tuple(builder, wanted, given[k:])]
                elif k < len(passed):
                    given[k] = target.cast(builder, given[k], passed[k], wanted)
                else:
                    given.append(None)  # a default
            status, value = target.call_internal_no_propagate(builder, compiled.fndesc, signature, given)
            return target.make_tuple(builder, result, (status.is_ok, value))

        return result(function, numba_types.StarArgTuple(arguments)), generate

    return attempt


PLACE = re.compile(r'File "([^"]*)", line (\d+):\n(.*?)\n[^\n]*\^', re.DOTALL)
"""A place in the text of a Numba error: file, line, and the source with the line above the mark."""


def numba_error_text(error: Exception) -> str:
    """Return what a Numba error says of a function in one line, with the line of its source that Numba refuses."""
    _, calls, text = str(error).partition("<intrinsic attempt>")
    text = text.partition("raised a specific error:")[2] if calls else str(error)
    text = re.sub("\x1b\\[[0-9;]*m", "", text)
    lines = [line.strip(" -").removeprefix("TypingError: ") for line in text.partition('File "')[0].splitlines()]
    informative = [line for line in lines if line and not line.startswith(("Failed in", "During:", "For more", "<"))]
    reason = " ".join(informative[:3])[:400].rstrip(".")
    for file, number, source in PLACE.findall(text):
        if OWN_FOLDER not in Path(file).resolve().parents:
            shown = source.splitlines()[-1].strip()
            return f"{reason}, in line {number} of {Path(file).name}" + (f": {shown}" if "<source" not in shown else "")
    return reason


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
    inner, attempt = called_in_machine_code(function), attempting(*range(5))

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

    return with_environments(numba.cfunc(STEP_SIGNATURE, nopython=True, error_model="numpy")(call))
