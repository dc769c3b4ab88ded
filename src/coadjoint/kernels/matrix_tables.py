"""From a matrix system to the tables of a step that multiplies matrices."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from typing import Any

from coadjoint.kernels.description import codes
from coadjoint.kernels.step_tables import step_numbers
from coadjoint.kernels.tables import Compiled


@cache
def product_address(complex_entries: bool) -> int:
    """Return the address of BLAS's product of general matrices, that of SciPy.

    Parameters
    ----------
    complex_entries : bool
        Of complex128 rather than float64.

    Returns
    -------
    int
    """
    from scipy.linalg import cython_blas

    capsule = cython_blas.__pyx_capi__["zgemm" if complex_entries else "dgemm"]
    api = ctypes.pythonapi
    api.PyCapsule_GetName.restype, api.PyCapsule_GetName.argtypes = ctypes.c_char_p, [ctypes.py_object]
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    return int(api.PyCapsule_GetPointer(capsule, api.PyCapsule_GetName(capsule)))


def matrix_tables(
    system: Any, step: str, stages: int, coefficients: Sequence[float], fractions: Sequence[float]
) -> Compiled:
    """Return the tables of a step of a matrix system.

    Parameters
    ----------
    system : MatrixSystem
        The system.
    step : str
        The name of the step.
    stages : int
        Of the scheme.
    coefficients : sequence of float
        Of the scheme.
    fractions : sequence of float
        Lengths of the substeps of a step.

    Returns
    -------
    Compiled
        With a `Stepping`.
    """
    stream = system.stream
    kind = codes("StreamKind")[stream.kind]
    whole = [kind, system.algebra.N, product_address(system.complex), stages, int(system.complex)]
    return step_numbers(system, step, whole, [1.0, *coefficients, *stream.table.tolist()], fractions)
