"""Functions of users that the kernels call by address, compiled or called in Python."""

from __future__ import annotations

import ctypes
import dataclasses
import hashlib
import warnings
from collections.abc import Callable
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from coadjoint.optional_packages import MissingPackageError, require_packages
from coadjoint.systems.hamiltonians.traced_function import picklable_function, restored_function


class KernelFunction:
    """A function that the kernels call by its `address`, of a function of C or the negative one of a table; the object
    keeps what is there alive. `remade` returns the arguments of its pickle, if it has one.
    """

    def __init__(self, address: int, held: Any, remade: Callable[[], tuple[Any, ...]] | None = None) -> None:
        self.address, self._held, self.remade = address, held, remade

    def __reduce__(self) -> tuple[Any, ...]:
        """Return arguments that make the function again in another process."""
        if self.remade is None:
            raise TypeError("a function of this process, called in Python, cannot be pickled")
        return self.remade()


COMPILED = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p)
"""A function of (y, t) and of constants, whose values are written to the third address."""


class CodeAndConstants:
    """The addresses of machine code and of its constants, as the kernels read them, with what is there."""

    def __init__(self, code: Any, constants: Any) -> None:
        self.addresses, self.held = (ctypes.c_int64 * 2)(code.address, constants.ctypes.data), (code, constants)


_RECORDS: WeakValueDictionary[tuple[int, bytes], CodeAndConstants] = WeakValueDictionary()


class CompiledFunction(KernelFunction):
    """Machine code with constants; functions that are equal have the same address."""

    def __init__(self, code: Any, constants: Any, remade: Callable[[], tuple[Any, ...]] | None = None) -> None:
        key = code.address, hashlib.sha256(constants).digest()
        self._both = _RECORDS.get(key) or CodeAndConstants(code, constants)
        _RECORDS[key] = self._both
        super().__init__(-ctypes.addressof(self._both.addresses) - 2, self._both, remade)

    @property
    def constants(self) -> Any:
        return self._both.held[1]

    def with_constants(self, function: Any, constants: Any) -> CompiledFunction:
        """Return the machine code with other constants, by which it is another function."""
        remade = self.remade

        def again() -> tuple[Any, ...]:
            assert remade is not None
            call, (_, *others) = remade()
            return call, (picklable_function(function), *others)

        return CompiledFunction(self._both.held[0], constants, remade and again)

    def values(self, y: Any, t: float, results: int) -> Any:
        """Return so many values at numbers y and a time."""
        (code, constants), numbers, found = self._both.addresses, np.array(y, dtype=np.float64), np.empty(results)
        COMPILED(code)(numbers.ctypes.data, t, found.ctypes.data, constants)
        return found


def compiled_function(
    function: Callable[..., Any], size: int, results: int, *, scalar: bool, flat: bool, timed: bool, what: str
) -> CompiledFunction:
    """Compile a user function of `size` numbers y, or of one if `scalar`, and the time if `timed`; it returns a number,
    or if `flat` an array of `results` numbers.
    """
    require_packages(f"{what}, a Python function,", "numba")
    from coadjoint.kernels.functions.compilation import callback_of

    code, constants = callback_of(function, size, results, scalar, flat, timed, what)
    others = size, results, scalar, flat, timed, what
    return CompiledFunction(code, constants, lambda: (_recompiled, (picklable_function(function), *others)))


def _recompiled(function: Any, size: int, results: int, scalar: bool, flat: bool, timed: bool, what: str) -> Any:
    restored = restored_function(function)
    return compiled_function(restored, size, results, scalar=scalar, flat=flat, timed=timed, what=what)


CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p)
"""A function of (y, t), whose values are written to the last address; matrices are in C order."""


class CalledInPython(KernelFunction):
    """A function called in Python by its C address, of a ctypes `prototype`: `call` with its arguments, whose exception
    is raised again in the thread of the run. If the prototype has a result, it is 1 after an exception and else 0.
    """

    def __init__(
        self, prototype: Any, call: Callable[..., None], remade: Callable[[], tuple[Any, ...]] | None = None
    ) -> None:
        self._raised: BaseException | None = None

        def guarded(*arguments: Any) -> int:
            try:
                call(*arguments)
            except BaseException as error:
                self._raised = error
                return 1
            return 0

        callback = prototype(guarded)
        super().__init__(ctypes.cast(callback, ctypes.c_void_p).value or 0, callback, remade)

    def check(self) -> None:
        """Raise the exception of an earlier call, if there was one."""
        if self._raised is not None:
            raise self._raised

    def raised(self) -> BaseException | None:
        """Return and clear the exception that the function raised, if any."""
        error, self._raised = self._raised, None
        return error


MAX_WARNED = 256
_WARNED: dict[Any, Any] = {}


def warn_once(function: Any, message: str) -> None:
    """Warn that a function, or the step of a class, is called in Python, once for each value that can be hashed."""
    try:
        hash(function)
        key = function
    except TypeError:
        key = id(function)
    if key in _WARNED:
        return
    if len(_WARNED) == MAX_WARNED:
        _WARNED.clear()
    _WARNED[key] = function  # which keeps its id from being used again
    warnings.warn(message, RuntimeWarning, stacklevel=2)


def python_callback(function: Callable[..., Any], size: int, results: int) -> CalledInPython:
    """Return a function of (y, t), y an array of `size` numbers, called in Python; it returns `results` numbers."""
    block, result_block = ctypes.c_double * size, ctypes.c_double * results

    def call(y: int, t: float, out: int) -> None:
        values = result_block.from_address(out)
        values[0] = float("nan")  # stops the loop
        callback.check()
        result = function(np.frombuffer(memoryview(block.from_address(y))).copy(), t)
        values[:] = np.ravel(result).tolist()

    callback: CalledInPython = CalledInPython(CALLBACK, call, lambda: (python_callback, (function, size, results)))
    return callback


# System, state, time, length, new state.
STEP_CALLBACK = ctypes.CFUNCTYPE(
    ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p
)


def step_function(method: Any, system: Any) -> tuple[Any, bool]:
    """Return the step of a scheme on a system as a function with a C address, and whether it is compiled. The scheme
    has ``step(system, x, t, h)``; if it is a dataclass of numbers, strings and arrays, Numba may compile the step.
    """
    if method.compiles:
        callback, reason = _compiled_step(method, system)
        if callback is not None:
            return callback, True
        warn_once(
            type(method),
            f"the steps of {type(method).__name__} are Python calls, about a hundred times slower than compiled ones: "
            f"{reason}",
        )
    n, name, number = system.dim, system.name, ctypes.c_double

    def call(_: int, x: int, t: float, h: float, out: int) -> None:
        try:
            state = np.array((number * n).from_address(x))
            (number * n).from_address(out)[:] = read_step_result(method.step(system, state, t, h), n, method)
        except AttributeError as error:
            if error.obj is not system:
                raise
            raise TypeError(
                f"the step of {type(method).__name__} reads system.{error.name}, which {name} does not have; "
                "the scheme must refuse such systems, for example matrices, in `properties`"
            ) from None

    return CalledInPython(STEP_CALLBACK, call), False


def read_step_result(result: Any, n: int, method: Any) -> Any:
    """Return the result of a step as float64; raise TypeError if it is not `n` real numbers."""
    state = np.asarray(result)
    if state.shape != (n,) or state.dtype.kind not in "fiu":
        kind = "complex numbers" if state.dtype.kind == "c" else f"an array of {state.dtype} and shape {state.shape}"
        raise TypeError(f"the step of {type(method).__name__} returned {kind}; it must return {n} real numbers")
    return state.astype(np.float64)


def _compiled_step(method: Any, system: Any) -> tuple[Any, str]:
    """Return the step compiled by Numba and "", or None and the reason."""
    if not system.has_compiled_bracket:
        return None, f"{system.name} has no structure constants or structure_function, which compiled steps read"
    try:
        require_packages("a compiled step", "numba")
    except MissingPackageError as error:
        return None, str(error)
    from coadjoint.kernels.functions.compilation import compiled_step

    names, values = _parameters(method)
    try:
        hash(values)
    except TypeError:
        return None, f"{type(method).__name__} has parameters that cannot be compiled into its step"
    return compiled_step(type(method).step, names, values, with_derivatives(system))


def _parameters(method: Any) -> tuple[tuple[str, ...], tuple[Any, ...]]:
    """Return names and values that a step may read of its scheme: dataclass fields and plain class attributes."""
    parameters: dict[str, Any] = {}
    for kind in reversed(type(method).__mro__[:-1]):
        plain = {key: value for key, value in vars(kind).items() if isinstance(value, int | float | str | tuple)}
        parameters |= {key: value for key, value in plain.items() if not key.startswith("_")}
    if dataclasses.is_dataclass(method):
        parameters |= {field.name: getattr(method, field.name) for field in dataclasses.fields(method)}
    return tuple(parameters), tuple(parameters.values())


def with_derivatives(system: Any) -> bool:
    """Return whether the kernels have exact derivatives of a field, which then has no user functions."""
    return system.algebra is not None and not any(term.called for term in system.hamiltonian.terms())
