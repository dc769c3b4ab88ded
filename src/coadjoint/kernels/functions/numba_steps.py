"""Steps compiled by Numba to C functions, and the methods that their systems have in compiled code.

A step receives its scheme as a tuple of the parameters, and its system as a tuple whose methods call the compiled
kernels: ``dim``, ``sign``, ``vector_field(x, t)``, ``energy(x, t)``, ``structure_matrix(x)``, ``hamiltonian.value(x,
t)``, ``hamiltonian.gradient(x, t)``; if the system has no function of the user also ``jacobian(x, t)`` and
``hamiltonian.hessian(x, t)``.
"""

from __future__ import annotations

import ctypes
import inspect
from collections import namedtuple
from collections.abc import Callable
from functools import partial
from typing import Any

import numba
import numpy as np
from numba import carray, types
from numba.extending import overload_method

from coadjoint.kernels.functions.compilation import called_in_machine_code, compile_cached, numba_error_text
from coadjoint.kernels.library import kernels

NUMBERS = types.CPointer(types.float64)
SIGNATURE = types.int64(types.CPointer(types.int64), NUMBERS, types.float64, types.float64, NUMBERS)

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


def _array(kernel: Any, adapt: Any, matrix: bool) -> Callable[..., Any]:
    """Return a method whose result is a vector, or a `matrix`; Numba compiles only one branch."""

    def method(self: Any, x: Any, t: float = 0.0) -> Any:
        y, out = adapt(x), np.empty((self.dim, self.dim) if matrix else self.dim)
        kernel(self.address, y.ctypes.data, t, out.ctypes.data)
        return out

    return method


def _structure(kernel: Any, adapt: Any) -> Callable[..., Any]:
    def method(self: Any, x: Any) -> Any:
        y, out = adapt(x), np.empty((self.dim, self.dim))
        kernel(self.address, y.ctypes.data, out.ctypes.data)
        return out

    return method


def _number(kernel: Any, adapt: Any) -> Callable[..., Any]:
    def method(self: Any, x: Any, t: float = 0.0) -> Any:
        y = adapt(x)
        return kernel(self.address, y.ctypes.data, t)

    return method


@numba.njit(inline="always")
def _identity(x: Any) -> Any:
    return x


@numba.njit
def _copied(x: Any) -> Any:
    return np.ascontiguousarray(x).astype(np.float64)


def _add_method(kinds: tuple[Any, ...], name: str, make: Callable[..., Any], kernel: Any) -> None:
    """Add a method to tuples of these kinds in compiled code."""
    direct, copying = make(kernel, _identity), make(kernel, _copied)

    def select(self: Any, x: Any) -> Any:
        if getattr(self, "instance_class", None) not in kinds:
            return None
        is_plain_vector = getattr(x, "layout", "") == "C" and x.ndim == 1 and x.dtype == types.float64
        return direct if is_plain_vector else copying

    def select_timed(self: Any, x: Any, t: float = 0.0) -> Any:
        return select(self, x)

    for kind in (types.NamedTuple, types.NamedUniTuple):
        overload_method(kind, name)(select_timed if "t" in inspect.signature(direct).parameters else select)


_add_method(SYSTEMS, "vector_field", partial(_array, matrix=False), FIELD)
_add_method(SYSTEMS, "structure_matrix", _structure, STRUCTURE)
_add_method(SYSTEMS, "energy", _number, ENERGY)
_add_method(SYSTEMS[1:], "jacobian", partial(_array, matrix=True), JACOBIAN)
_add_method(HAMILTONIANS, "gradient", partial(_array, matrix=False), GRADIENT)
_add_method(HAMILTONIANS, "value", _number, ENERGY)
_add_method(HAMILTONIANS[1:], "hessian", partial(_array, matrix=True), HESSIAN)


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
            lambda: _compiled(function, names, values, derivatives),
        ), ""
    except Exception as error:  # Numba raises exceptions of many types
        return None, f"Numba cannot compile them ({numba_error_text(error)})"


def _compiled(function: Callable[..., Any], names: tuple[str, ...], values: tuple[Any, ...], derivatives: bool) -> Any:
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

    return numba.cfunc(SIGNATURE, nopython=True, error_model="numpy")(call)
