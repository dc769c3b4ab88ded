"""Tables of matrix steps."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from coadjoint.kernels.functions.matrix_functions import MatrixFunction
from coadjoint.kernels.interface import codes
from coadjoint.kernels.tables.compiled import CompiledTables
from coadjoint.kernels.tables.steps import numeric_step_tables
from coadjoint.systems.matrices.streams import FunctionStream

ROUTINES: dict[int, str] = {}
"""Addresses -> names of the BLAS routines in tables of this process."""


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
    ROUTINES[address] = name
    return address


def stream_tables(system: Any) -> tuple[list[int], list[float], tuple[Any, ...]]:
    """Return the integers (size, layers, the kinds of both streams, -1 for none, whether there is a constant `linear`,
    address of a function) and the numbers (the constant, the tables of the maps) of a stream, and the owners of its
    functions.
    """
    kinds = codes("StreamKind")
    stream, second, linear, function = system.stream, system.second_stream, system.linear, None
    if isinstance(stream, FunctionStream):
        function = MatrixFunction(stream, system.algebra.shape, system.complex)
    numbers = [] if linear is None else [system.to_vector(linear)]
    numbers += [stream_map.table for stream_map in (stream, second) if stream_map is not None]
    layers = 2 if len(system.matrix_shape) == 3 else 1
    integers = [
        system.algebra.N,
        layers,
        kinds[stream.kind],
        -1 if second is None else kinds[second.kind],
        int(linear is not None),
        function.address if function else 0,
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
