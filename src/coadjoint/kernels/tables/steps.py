"""Tables of the loop for schemes with one compiled step of their own, of vectors and of matrices."""

from __future__ import annotations

import ctypes
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.functions.compiled_functions import CALLBACK, CalledInPython, CompiledFunction, warn_once
from coadjoint.kernels.interface import codes
from coadjoint.kernels.library import kernels
from coadjoint.kernels.loop import CompiledLoop
from coadjoint.kernels.tables.compiled import LIBRARY_ADDRESSES, CompiledTables, addresses_of, as_structure
from coadjoint.kernels.tables.field import (
    Field,
    GroupField,
    field_of,
    group_of,
    sources_of_field,
    substeps,
    terms_of_field,
)
from coadjoint.kernels.tables.invariants import invariants_table, watch_tables
from coadjoint.kernels.tables.recording import Watch
from coadjoint.optional_packages import MissingPackageError, require_packages
from coadjoint.program.generators import given_matrices
from coadjoint.program.group_correction import unshift_tables
from coadjoint.program.sources import CoefficientNumbers, Multiples, Sources
from coadjoint.systems.matrices.conjugation import blocks_of_rows
from coadjoint.systems.matrices.streams import FunctionStream
from coadjoint.systems.parameter_differences import WEIGHTS, NearbySystems
from coadjoint.systems.system import System


class StepTables(NamedTuple):
    """Tables that a step reads: field, values of the terms of H, group equation, invariants, and numbers."""

    field: Field
    values: NDArray[np.int64]
    group: GroupField
    restored: Watch
    whole: NDArray[np.int64]
    coefficients: NDArray[np.float64]


class Stepping(NamedTuple):
    """A compiled step by address, and its tables; `substeps` of it, of lengths `fraction` at `moment`, make a step.

    `serial` is the number that the loop assigns to the tables when it first reads them.
    """

    step: NDArray[np.int64]
    substeps: int
    fraction: NDArray[np.float64]
    moment: NDArray[np.float64]
    tables: StepTables
    serial: int = 0

    def at_step(self, h: float) -> Stepping:
        """Return the tables of another step: they do not depend on it, except for those of an inner loop."""
        return self


def step_address(step: Any) -> int:
    """Return the address of a step: an object with an ``address``, or a name (`STEP_SCHEME` in its C++ file)."""
    if isinstance(step, str):
        try:
            function = getattr(kernels(), f"{step}_step")
        except AttributeError as error:
            raise ValueError(
                f"the kernels have no step {step!r}; put its C++ file into the folder of the scheme, and build them by "
                "make kernels"
            ) from error
        address = ctypes.cast(function, ctypes.c_void_p).value or 0
    else:
        address = int(step.address)
    LIBRARY_ADDRESSES[address] = step_address, step
    return address


STEP_LOOP = "stepping_advance"
"""Name of the loop for all schemes whose tables contain their step."""


INNER_LOOP_INDEX = 1
"""Index, among the integers, of the address of the tables of an inner loop."""


def step_tables(
    system: System, method: Any, representation: Any = None, fractions: Sequence[float] = (1.0,)
) -> CompiledTables:
    """Return the tables, a `Stepping` independent of the step, of a `CompiledStepMethod` with these substeps."""
    restored = method.restored(system)
    watched = invariants_table([], system.dim) if restored is None else watch_tables(system, restored)
    tables = _tables(system, group_of(system, representation), watched, *method.constants())
    return _stepping(step_address(method.compiled_step), fractions, tables)


def function_tables(
    system: System, function: int, fractions: Sequence[float] = (1.0,), compiled: bool = False
) -> CompiledTables:
    """Return the `Stepping` of a step at an address; if `compiled`, it reads the system from the tables."""
    constant = sum(term.constant for term in system.hamiltonian.terms())
    no_invariants = invariants_table([], system.dim)
    tables = _tables(
        system, group_of(system, None), no_invariants, [function], [constant], not system.has_compiled_bracket
    )

    def of_function() -> Sources:
        numbers = np.arange(CoefficientNumbers.of(system.hamiltonian.terms()).size)
        if not compiled:
            return Sources(computed={"whole": numbers})
        return Sources({"coefficients": Multiples(np.array([0]), numbers[-1:], np.ones(1))})

    return _stepping(step_address("step_function"), fractions, tables, of_function)


def numeric_step_tables(
    system: System,
    step: str,
    integers: Sequence[int],
    coefficients: Sequence[float],
    fractions: Sequence[float] = (1.0,),
) -> CompiledTables:
    """Return the tables, a `Stepping`, of a named step that reads only integers, coefficients and the dimension."""
    tables = _tables(system, group_of(system, None), invariants_table([], system.dim), integers, coefficients, True)
    return _stepping(step_address(step), fractions, tables)


def wrapped_step_tables(system: System, step: str, inner: CompiledLoop, restored: Mapping[str, Any]) -> CompiledTables:
    """Return the `Stepping` of a named step: one of `inner`, for one member, then a correction of `restored`."""
    integers, keepalive = inner_loop_integers(inner, system, None)
    return named_step_tables(system, step, watch_tables(system, restored), integers, None, keepalive)


def inner_loop_integers(inner: CompiledLoop, system: System, representation: Any) -> tuple[list[int], tuple[Any, ...]]:
    """Return integers by which a step calls `inner`, a loop for one member, and the objects to keep alive.

    These are addresses of the loop, its tables and an empty watch, the size of its memory, and the address of tables
    that rotate the group element by the shift of H, or 0.
    """
    loop = ctypes.cast(getattr(kernels(), f"{inner.name}_inside"), ctypes.c_void_p).value
    no_invariants = invariants_table([], system.dim)
    structure, watch = as_structure(inner.tables), as_structure(no_invariants.tables)
    keepalive, shift_address = (*no_invariants.keepalive, *inner.keepalive, inner, structure, watch), 0
    if inner.shift and representation is not None and system.algebra is not None:
        rho = given_matrices(representation)
        shift_tables = as_structure(unshift_tables(system.algebra, rho, system.sign, inner.shift))
        keepalive, shift_address = (*keepalive, shift_tables), ctypes.addressof(shift_tables)
    return [loop or 0, ctypes.addressof(structure), ctypes.addressof(watch), inner.memory, shift_address], keepalive


def named_step_tables(
    system: System,
    step: str,
    invariants: CompiledTables,
    integers: Sequence[int],
    representation: Any,
    keepalive: tuple[Any, ...],
    coefficients: Sequence[float] = (),
) -> CompiledTables:
    """Return the tables, a `Stepping`, of a named step that reads integers, coefficients and `invariants`."""
    tables = _tables(
        system,
        group_of(system, representation),
        replace(invariants, keepalive=(*invariants.keepalive, *keepalive)),
        integers,
        coefficients,
        not system.has_compiled_bracket,
    )

    def of_shift() -> Sources:
        return Sources(
            computed={"whole": CoefficientNumbers.of(system.hamiltonian.terms()).others} if integers[4] else {}
        )

    return _stepping(step_address(step), (1.0,), tables, of_shift)


def _tables(
    system: System,
    group: GroupField,
    invariants: CompiledTables,
    integers: Sequence[int],
    numbers: Sequence[float],
    called: bool = False,
) -> CompiledTables:
    field, keepalive = field_of(system, called)
    table = terms_of_field(system)
    values, values_keepalive = addresses_of(table.functions, len(table), "value", "the Hamiltonian")
    integer_array, coefficient_array = np.array(integers, dtype=np.int64), np.array(numbers, dtype=np.float64)
    tables = StepTables(field, values, group, invariants.tables, integer_array, coefficient_array)
    return CompiledTables(
        tables,
        (*keepalive, *values_keepalive, *invariants.keepalive),
        lambda: sources_of_field(system, field).and_of(invariants.sources().within("restored.")),
    )


def _stepping(
    step: int, fractions: Sequence[float], tables: CompiledTables, more: Callable[[], Sources] = Sources
) -> CompiledTables:
    lengths, moments = substeps(fractions)
    stepping = Stepping(np.array([step], dtype=np.int64), len(lengths), lengths, moments, tables.tables)
    return CompiledTables(stepping, tables.keepalive, lambda: tables.sources().and_of(more()).within("tables."))


@cache
def blas_address(name: str) -> int:
    """Return the address of a routine of SciPy's BLAS, such as "dgemm"."""
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
    """Return integers (size, layers, kinds of both streams or -1, whether `linear` exists, address of a function),
    numbers (the constant, the tables of the maps) and owners of functions of a stream.
    """
    # The second kind of a `LayeredStream` is that of its vertical modes.
    kinds = codes("StreamKind")
    stream, second, linear, function = system.stream, system.second_stream, system.linear, None
    inner = stream.of_modes[0] if system.independent_layers else second
    if isinstance(stream, FunctionStream):
        function = stream_function(stream, system.algebra.shape, system.complex)
    numbers = [] if linear is None else [system.to_vector(linear)]
    numbers += [stream_map.table for stream_map in (stream, second) if stream_map is not None]
    layers = system.matrix_shape[0] if len(system.matrix_shape) == 3 else 1
    integers = [
        system.algebra.N,
        layers,
        kinds[stream.kind],
        -1 if inner is None else kinds[inner.kind],
        int(linear is not None),
        int(function.address) if function else 0,
    ]
    return integers, np.concatenate(numbers).tolist(), (function,) if function else ()


def matrix_tables(
    system: Any, step: str, stages: int, coefficients: Sequence[float], fractions: Sequence[float]
) -> CompiledTables:
    """Return the tables, a `Stepping`, of a named step of a matrix system with substeps of these fractions."""
    integers, numbers, keepalive = stream_tables(system)
    integers += [blas_address(name) for name in ("zgemm" if system.complex else "dgemm", "dgemm", "sgemm")]
    integers += [stages, int(system.complex), int(not system.algebra.skew)]
    step_tables = numeric_step_tables(system, step, integers, [*coefficients, *numbers], fractions)
    return CompiledTables(step_tables.tables, (*step_tables.keepalive, *keepalive))


class StreamSlope(NamedTuple):
    """A factor and the numbers of a stream with a constant, a summand of the derivative by a coefficient."""

    coefficient: int
    factor: float
    numbers: NDArray[np.float64]


def stream_slopes(system: Any, nearby: Sequence[NearbySystems]) -> list[StreamSlope]:
    """Return derivatives of the stream by entries of parameters, coefficients by number, as sums of streams."""
    here, constants, found = stream_numbers(system), system.dim, list[StreamSlope]()
    for coefficient, one in enumerate(nearby):
        distance, plus, minus = one.samples(stream_numbers, here)
        weights, numbers = np.concatenate([WEIGHTS, -WEIGHTS]) / distance, np.concatenate([plus, minus])
        if (numbers[:, constants:] == numbers[0, constants:]).all():
            only_constant = np.zeros(numbers.shape[1])
            only_constant[:constants] = weights @ numbers[:, :constants]
            weights, numbers = np.ones(1), only_constant[None]
        found += [StreamSlope(coefficient, *part) for part in zip(weights.tolist(), numbers, strict=True)]
    return found


def stream_numbers(system: Any) -> NDArray[np.float64]:
    """Return the numbers of the stream of a system with a constant, which may be zero."""
    numbers = np.array(stream_tables(system)[1])
    return numbers if system.linear is not None else np.concatenate([np.zeros(system.dim), numbers])


def with_slopes(
    tables: CompiledTables, system: Any, slopes: Sequence[StreamSlope], coefficients: int
) -> CompiledTables:
    """Return the tables of a step of skew-Hermitian matrices with what its derivatives read."""
    step = tables.tables.tables
    numbers = [np.concatenate([[one.factor], one.numbers]) for one in slopes]
    integers = [coefficients, len(slopes), len(step.coefficients), len(numbers[0]) if numbers else 0]
    integers += [*(one.coefficient for one in slopes), *blocks_of_rows(system.algebra)]
    with_slopes = step._replace(
        whole=np.concatenate([step.whole, np.array(integers, dtype=np.int64)]),
        coefficients=np.concatenate([step.coefficients, *numbers]),
    )
    return replace(tables, tables=tables.tables._replace(tables=with_slopes))


def stream_function(stream: FunctionStream, shape: tuple[int, int], complex_entries: bool) -> Any:
    """Return a stream function with the address of ``void(const double* W, double t, double* P)``.

    A function that Numba cannot compile is called in Python, by one thread at a time.
    """
    try:
        require_packages("a compiled stream", "numba")
        return _compiled_stream(stream.function, shape[0], complex_entries, stream.timed, stream.traceless)
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


def _compiled_stream(
    function: Callable[..., Any], N: int, complex_entries: bool, timed: bool, traceless: tuple[tuple[int, int], ...]
) -> Any:
    from coadjoint.kernels.functions.compilation import callback_with_constants

    name = f"the stream {getattr(function, '__name__', type(function).__name__)}"
    make = partial(_adapted_stream, N, complex_entries, traceless)
    return CompiledFunction(*callback_with_constants(function, timed, name, make))


def _adapted_stream(
    N: int, complex_entries: bool, traceless: tuple[tuple[int, int], ...], inner: Any, attempt: Any
) -> Any:
    import numba
    from numba import carray

    from coadjoint.kernels.functions.compilation import SIGNATURE

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

    def of_complex(W: Any, t: float, P: Any, constants: Any) -> None:
        out = carray(P, (2 * N * N,))
        out[:] = np.nan
        matrix = carray(W, (2 * N * N,)).copy().view(np.complex128).reshape((N, N))
        centre(matrix)
        succeeded, result = attempt(inner, matrix, t, constants)
        for i in range(N if succeeded else 0):
            for j in range(N):
                value = complex(result[i, j])
                out[2 * (i * N + j)] = value.real
                out[2 * (i * N + j) + 1] = value.imag

    def of_real(W: Any, t: float, P: Any, constants: Any) -> None:
        out = carray(P, (N * N,))
        out[:] = np.nan
        matrix = carray(W, (N * N,)).copy().reshape((N, N))
        centre(matrix)
        succeeded, result = attempt(inner, matrix, t, constants)
        for i in range(N if succeeded else 0):
            for j in range(N):
                out[i * N + j] = result[i, j]

    with warnings.catch_warnings():
        # Suppress Numba's warning that products of transposed matrices are slower.
        warnings.simplefilter("ignore", numba.NumbaPerformanceWarning)
        return numba.cfunc(SIGNATURE, nopython=True, error_model="numpy")(of_complex if complex_entries else of_real)
