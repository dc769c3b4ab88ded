"""The exported header of free bodies: functions of a library that is compiled from it, called by ctypes."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mpmath import mp, mpf

import coadjoint as co
from c_compilers import library
from exact_body import DIGITS, exact_motion

FUNCTIONS = {
    "step": "double h, double *x, double *q",
    "step_matrix": "double h, double *x, double *A",
    "step_velocity": "double h, double *w, double *q",
    "rotation": "double h, double *x, double *r",
    "jacobian": "double h, double *x, double *r, double *J, double *G",
}
UNITS = {np.float64: 2.0**-53, np.float32: 2.0**-24}


def export_header(folder: Path) -> Path:
    """Write the header as the command does, and a file with a function of external linkage for each of it."""
    environment = os.environ | {"PYTHONPATH": str(Path(co.__file__).parents[1])}
    command = [sys.executable, "-m", "coadjoint", "export", "--free-body", "-o", str(folder / "coadjoint.h")]
    subprocess.run(command, env=environment, check=True, capture_output=True)
    source = '#include "coadjoint.h"\n#ifdef __cplusplus\nextern "C" {\n#endif\n'
    for suffix, real in (("", "double"), ("f", "float")):
        for name, declared in FUNCTIONS.items():
            parameters = declared.replace("double", real)
            called = ", ".join(part.split()[-1].strip("*") for part in parameters.split(","))
            head = f"long {name}{suffix}(const {real} *m, {parameters})"
            source += f"{head};\n{head} {{ return coadjoint_body_{name}{suffix}(m, {called}); }}\n"
    target = folder / "functions.c"
    target.write_text(source + "#ifdef __cplusplus\n}\n#endif\n")
    return target


class Result(NamedTuple):
    """Pieces of time, or 0; the new momentum; and the other arrays of a function."""

    pieces: int
    x: Any
    others: list[Any]


class Body:
    """Functions of the header for one type of numbers."""

    def __init__(self, compiler: str, source: Path, target: Path, *flags: str, language: str = "c") -> None:
        self.library = library(compiler, source, target, *flags, language=language)

    def call(self, name: str, kind: Any, m: Any, h: Any, x: Any, *others: Any) -> Result:
        """Call a function with copies of arrays; missing ones are new."""
        sizes = {"step_matrix": (9,), "jacobian": (4, 9, 9)}.get(name, (4,))
        given = [np.array(v, kind).ravel() for v in others] + [np.empty(n, kind) for n in sizes[len(others) :]]
        m, x = np.array(m, kind), np.array(x, kind)
        function = getattr(self.library, name + ("f" if kind == np.float32 else ""))
        function.restype = ctypes.c_long
        time = (ctypes.c_float if kind == np.float32 else ctypes.c_double)(h)
        pieces = function(*(ctypes.c_void_p(v.ctypes.data) for v in [m]), time, *map(_address, [x, *given]))
        return Result(pieces, x, given)


def _address(array: Any) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def matrix_of(q: Any) -> Any:
    """Return the matrix of a quaternion that need not have unit length, in the precision of its type."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def exact(m: Any, h: Any, x: Any) -> tuple[Any, Any]:
    """Return the exact momentum and rotation as arrays of numbers of mpmath."""
    end, A = exact_motion([float(v) for v in m], [v if isinstance(v, mpf) else float(v) for v in x], float(h))
    return np.array(end), np.array(A.tolist())


def error(found: Any, wanted: Any) -> float:
    """Return the Frobenius norm of a difference."""
    with mp.workdps(DIGITS):
        return float(
            mp.sqrt(sum((mpf(float(a)) - b) ** 2 for a, b in zip(np.ravel(found), np.ravel(wanted), strict=True)))
        )


def exact_derivatives(m: Any, h: Any, x: Any) -> tuple[Any, Any]:
    """Return J and G by central differences in 60 digits."""
    with mp.workdps(DIGITS):
        start = [mpf(float(v)) for v in x]
        small = max(map(abs, start)) * mpf(10) ** -17
        _, A = exact(m, h, start)
        J, G = np.empty((3, 3), object), np.empty((3, 3), object)
        for k in range(3):
            (lower, before), (upper, after) = (
                exact(m, h, [v + sign * small * (i == k) for i, v in enumerate(start)]) for sign in (-1, 1)
            )
            turned = A.T @ (after - before) / (2 * small)
            J[:, k] = (upper - lower) / (2 * small)
            G[:, k] = [(turned[i - 1, i - 2] - turned[i - 2, i - 1]) / 2 for i in range(3)]
        return J, G
