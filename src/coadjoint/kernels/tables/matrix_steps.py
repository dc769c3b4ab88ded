"""Tables of matrix steps, and streams given as Python functions, called by address: compiled by Numba if possible."""

from __future__ import annotations

import ctypes
import warnings
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from coadjoint.kernels.functions.compiled_functions import CALLBACK, CalledInPython, warn_once
from coadjoint.kernels.interface import codes
from coadjoint.kernels.tables.compiled import LIBRARY_ADDRESSES, CompiledTables
from coadjoint.kernels.tables.steps import numeric_step_tables
from coadjoint.optional_packages import MissingPackageError, require_packages
from coadjoint.systems.matrices.streams import FunctionStream


@cache
def blas_address(name: str) -> int:
    """Return the address of a routine of SciPy's BLAS, such as "zgemm"."""
    from scipy.linalg import cython_blas

    capsules: dict[str, Any] = dict(cython_blas.__pyx_capi__)
    capsule = capsules[name]
    api = ctypes.pythonapi
    api.PyCapsule_GetName.restype, api.PyCapsule_GetName.argtypes = ctypes.c_char_p, [ctypes.py_object]
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    address = int(api.PyCapsule_GetPointer(capsule, api.PyCapsule_GetName(capsule)))
    LIBRARY_ADDRESSES[address] = blas_address, name
    return address


def stream_tables(system: Any) -> tuple[list[int], list[float], tuple[Any, ...]]:
    """Return the integers (size, layers, the kinds of both streams, -1 for none, whether there is a constant `linear`,
    address of a function) and the numbers (the constant, the tables of the maps) of a stream, and the owners of its
    functions.
    """
    kinds = codes("StreamKind")
    stream, second, linear, function = system.stream, system.second_stream, system.linear, None
    if isinstance(stream, FunctionStream):
        function = stream_function(stream, system.algebra.shape, system.complex)
    numbers = [] if linear is None else [system.to_vector(linear)]
    numbers += [stream_map.table for stream_map in (stream, second) if stream_map is not None]
    layers = 2 if len(system.matrix_shape) == 3 else 1
    integers = [
        system.algebra.N,
        layers,
        kinds[stream.kind],
        -1 if second is None else kinds[second.kind],
        int(linear is not None),
        int(function.address) if function else 0,
    ]
    return integers, np.concatenate(numbers).tolist(), (function,) if function else ()


def matrix_tables(
    system: Any, step: str, stages: int, coefficients: Sequence[float], fractions: Sequence[float]
) -> CompiledTables:
    """Return the tables, a `Stepping`, of a named step of a matrix system with substeps of these fractions."""
    integers, numbers, keepalive = stream_tables(system)
    precisions = "zc" if system.complex else "ds"
    integers += [blas_address(f"{precision}gemm") for precision in precisions]
    integers += [stages, int(system.complex), int(not system.algebra.skew)]
    step_tables = numeric_step_tables(system, step, integers, [*coefficients, *numbers], fractions)
    return CompiledTables(step_tables.tables, (*step_tables.keepalive, *keepalive))


def stream_function(stream: FunctionStream, shape: tuple[int, int], complex_entries: bool) -> Any:
    """Return a stream function with the address of ``void(const double* W, double t, double* P)``, on matrices of this
    `shape`, complex128 if `complex_entries`, else float64. A function that Numba cannot compile is called in Python, by
    one thread at a time.
    """
    try:
        require_packages("a compiled stream", "numba")
        return _compiled(stream.function, shape[0], complex_entries, stream.timed, stream.traceless)
    except MissingPackageError as error:
        reason = str(error)
    except Exception as error:  # Numba raises exceptions of many types
        from coadjoint.kernels.functions.compilation import numba_error_text

        reason = numba_error_text(error)
    name = getattr(stream.function, "__name__", type(stream.function).__name__)
    warn_once(
        stream.function,
        f"the stream {name} is called in Python, at about ten microseconds per call and in one thread, since Numba "
        f"cannot compile it ({reason})",
    )
    dtype, numbers = np.dtype("c16" if complex_entries else "f8"), 1 + complex_entries
    block = ctypes.c_double * (numbers * shape[0] * shape[1])

    def call(W: int, t: float, P: int) -> None:
        out = np.frombuffer(memoryview(block.from_address(P)), dtype=dtype).reshape(shape)
        out[:] = np.nan  # stops the member
        callback.check()
        matrix = np.frombuffer(memoryview(block.from_address(W)), dtype=dtype)
        out[:] = stream(matrix.reshape(shape).copy(), t)

    callback: CalledInPython = CalledInPython(CALLBACK, call)
    return callback


def _compiled(
    function: Callable[..., Any], N: int, complex_entries: bool, timed: bool, traceless: tuple[tuple[int, int], ...]
) -> Any:
    from coadjoint.kernels.functions.compilation import compile_cached

    options = "stream", N, complex_entries, timed, tuple(map(tuple, traceless))
    name = f"the stream {getattr(function, '__name__', type(function).__name__)}"
    return compile_cached(function, options, name, lambda: _adapted(function, N, complex_entries, timed, traceless))


def _adapted(
    function: Callable[..., Any], N: int, complex_entries: bool, timed: bool, traceless: tuple[tuple[int, int], ...]
) -> Any:
    import numba
    from numba import carray

    from coadjoint.kernels.functions.compilation import SIGNATURE, called_in_machine_code

    inner: Any = called_in_machine_code(function)
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
