"""Streams given as Python functions, callable by C address: compiled by Numba if possible."""

from __future__ import annotations

import ctypes
import inspect
import warnings
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from coadjoint.optional_packages import MissingPackageError, require_packages
from coadjoint.systems.matrices.streams import FunctionStream

# W, time, P; matrices in C order.
CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p)


class MatrixFunction:
    """A stream function for the loops, on matrices of this `shape`, complex128 if `complex_entries`, else float64.
    `address` is that of ``void(const double* W, double t, double* P)``. `compiled` is set if Numba compiled it;
    otherwise each call is a Python call, which only one thread at a time can make.
    """

    def __init__(self, stream: FunctionStream, shape: tuple[int, int], complex_entries: bool) -> None:
        self._raised: BaseException | None = None
        try:
            require_packages("a compiled stream", "numba")
            self._callback: Any = _compiled(stream.function, shape[0], complex_entries, stream.timed, stream.traceless)
            self.address, self.compiled = int(self._callback.address), True
        except MissingPackageError as reason:
            self._call_python(stream, shape, complex_entries, str(reason))
        except Exception as error:  # Numba raises exceptions of many types
            from coadjoint.kernels.functions.callbacks import numba_error_text

            self._call_python(stream, shape, complex_entries, numba_error_text(error))

    def raised(self) -> BaseException | None:
        """Return and clear the exception that the function raised, if any."""
        error, self._raised = self._raised, None
        return error

    def _call_python(self, stream: FunctionStream, shape: tuple[int, int], complex_entries: bool, reason: str) -> None:
        dtype, numbers = np.dtype("c16" if complex_entries else "f8"), 1 + complex_entries
        block = ctypes.c_double * (numbers * shape[0] * shape[1])

        def call(W: int, t: float, P: int) -> None:
            out = np.frombuffer(memoryview(block.from_address(P)), dtype=dtype).reshape(shape)
            try:
                if self._raised is not None:
                    raise self._raised
                matrix = np.frombuffer(memoryview(block.from_address(W)), dtype=dtype)
                out[:] = stream(matrix.reshape(shape).copy(), t)
            except BaseException as error:
                # NaN stops the member, and the exception is raised again in the thread of the run.
                self._raised = error
                out[:] = np.nan

        self._callback, self.compiled = CALLBACK(call), False
        self.address = ctypes.cast(self._callback, ctypes.c_void_p).value or 0
        _warn_once(_Key(stream.function), reason)


class _Key:
    """A function as a dictionary key, also if it is not hashable."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        try:
            self._hash = hash(function)
        except TypeError:
            self._hash = id(function)

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and (self.function is other.function or self.function == other.function)


@lru_cache(maxsize=256)
def _warn_once(key: _Key, reason: str) -> None:
    function = key.function
    name = getattr(function, "__name__", type(function).__name__)
    warnings.warn(
        f"the stream {name} is called in Python, at about ten microseconds per call and in one thread, since Numba "
        f"cannot compile it ({reason})",
        RuntimeWarning,
        stacklevel=2,
    )


def _compiled(
    function: Callable[..., Any], N: int, complex_entries: bool, timed: bool, traceless: tuple[tuple[int, int], ...]
) -> Any:
    from coadjoint.kernels.functions.fresh_code import compile_cached

    options = "stream", N, complex_entries, timed, tuple(map(tuple, traceless))
    name = f"the stream {getattr(function, '__name__', type(function).__name__)}"
    return compile_cached(function, options, name, lambda: _adapted(function, N, complex_entries, timed, traceless))


def _adapted(
    function: Callable[..., Any], N: int, complex_entries: bool, timed: bool, traceless: tuple[tuple[int, int], ...]
) -> Any:
    import numba
    from numba import carray

    from coadjoint.kernels.functions.callbacks import SIGNATURE
    from coadjoint.kernels.functions.fresh_code import fresh_dispatchers

    inner: Any = (
        numba.njit(error_model="numpy", boundscheck=True)(fresh_dispatchers(function))
        if inspect.isfunction(function)
        else fresh_dispatchers(function)
    )

    blocks = np.array(traceless, dtype=np.int64).reshape(-1, 2)

    @numba.njit(error_model="numpy")  # type: ignore[untyped-decorator]
    def centre(matrix: Any) -> None:
        for first, last in blocks:
            mean = 0.0 * matrix[0, 0]
            for i in range(first, last):
                mean += matrix[i, i]
            mean /= last - first
            for i in range(first, last):
                matrix[i, i] -= mean

    def of_complex(W: Any, t: float, P: Any) -> None:
        out = carray(P, (2 * N * N,))
        out[:] = np.nan
        matrix = carray(W, (2 * N * N,)).copy().view(np.complex128).reshape((N, N))
        centre(matrix)
        result = inner(matrix, t) if timed else inner(matrix)
        for i in range(N):
            for j in range(N):
                value = complex(result[i, j])
                out[2 * (i * N + j)] = value.real
                out[2 * (i * N + j) + 1] = value.imag

    def of_real(W: Any, t: float, P: Any) -> None:
        out = carray(P, (N * N,))
        out[:] = np.nan
        matrix = carray(W, (N * N,)).copy().reshape((N, N))
        centre(matrix)
        result = inner(matrix, t) if timed else inner(matrix)
        for i in range(N):
            for j in range(N):
                out[i * N + j] = result[i, j]

    with warnings.catch_warnings():
        # Suppress Numba's warning that products of transposed matrices are slower.
        warnings.simplefilter("ignore", numba.NumbaPerformanceWarning)
        return numba.cfunc(SIGNATURE, nopython=True, error_model="numpy")(of_complex if complex_entries else of_real)
