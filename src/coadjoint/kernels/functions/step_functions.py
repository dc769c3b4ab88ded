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

# System, state, time, length, new state.
CALLBACK = ctypes.CFUNCTYPE(
    ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p
)


def step_function(method: Any, system: Any) -> tuple[Any, bool]:
    """Return the step of a scheme on a system as a function with a C address, and whether it is compiled. The scheme
    has ``step(system, x, t, h)``; if it is a dataclass of numbers, strings and arrays, Numba may compile the step.
    """
    if method.compiles:
        callback, reason = _compiled(method, system)
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

    return CalledInPython(CALLBACK, call), False


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
