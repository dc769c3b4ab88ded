"""Steps written in Python, callable by C address: compiled by Numba if possible."""

from __future__ import annotations

import ctypes
import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from coadjoint.kernels.functions.compiled_functions import CalledInPython, warn_once
from coadjoint.optional_packages import MissingPackageError, require_packages

Step = Callable[[Any, Any, Any, Any], Any]

# System, state, time, length, new state; returns 0, or 1 if an exception was raised.
CALLBACK = ctypes.CFUNCTYPE(
    ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p
)


class StepFunction(CalledInPython):
    """The step of a scheme on a system as a C function for the loops. The scheme has ``step(system, x, t, h)``; if it
    is a dataclass of numbers, strings and arrays, the step may be compiled by Numba. `compiled` is set if it was;
    otherwise each step is a Python call.
    """

    def __init__(self, method: Any, system: Any) -> None:
        callback, reason = _compiled(method, system) if method.compiles else (None, "")
        self.compiled = callback is not None
        if callback is None:
            if method.compiles:
                warn_once(
                    type(method),
                    f"the steps of {type(method).__name__} are Python calls, about a hundred times slower than "
                    f"compiled ones: {reason}",
                )
            self._callback = CALLBACK(self._python_step(method, system))
            self.address = ctypes.cast(self._callback, ctypes.c_void_p).value or 0
        else:
            self._callback = callback
            self.address = callback.address

    def _python_step(self, method: Any, system: Any) -> Callable[..., int]:
        n, number = system.dim, ctypes.c_double

        def call(_: int, x: int, t: float, h: float, out: int) -> int:
            try:
                state = np.array((number * n).from_address(x))
                (number * n).from_address(out)[:] = read_step_result(method.step(system, state, t, h), n, method)
            except BaseException as error:
                self._raised = _explained(error, method, system)
                return 1
            return 0

        return call


def _explained(error: BaseException, method: Any, system: Any) -> BaseException:
    """Return the error of a step; for an attribute that the system does not have, a TypeError with advice."""
    name = system.name
    if not (isinstance(error, AttributeError) and error.obj is system):
        return error
    return TypeError(
        f"the step of {type(method).__name__} reads system.{error.name}, which {name} does not have; "
        "the scheme must refuse such systems, for example matrices, in `properties`"
    )


def read_step_result(result: Any, n: int, method: Any) -> Any:
    """Return the result of a step as float64; raise TypeError if it is not `n` real numbers."""
    state = np.asarray(result)
    if state.shape != (n,) or state.dtype.kind not in "fiu":
        kind = "complex numbers" if state.dtype.kind == "c" else f"an array of {state.dtype} and shape {state.shape}"
        raise TypeError(f"the step of {type(method).__name__} returned {kind}; it must return {n} real numbers")
    return state.astype(np.float64)


def _compiled(method: Any, system: Any) -> tuple[Any, str]:
    """Return the step compiled by Numba and "", or None and the reason."""
    if not system.has_compiled_bracket:
        return None, f"{system.name} has no structure constants or structure_function, which compiled steps read"
    try:
        require_packages("a compiled step", "numba")
    except MissingPackageError as error:
        return None, str(error)
    from coadjoint.kernels.functions.numba_steps import compiled_step

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
