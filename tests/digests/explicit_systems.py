"""Systems with explicit equations, and an extrapolation method in many digits, independent of the library.

The fields take arrays of any number type, so that the same lines serve floats and mpmath.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import mpmath
import numpy as np

import coadjoint as co


class Written(NamedTuple):
    """A system of the library, its field written by hand, initial states, and a time of some tens of turns."""

    system: co.LiePoissonSystem
    field: Callable[[Any], Any]
    starts: np.ndarray
    time: float


def cross(a: Any, b: Any) -> Any:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def body(x: Any) -> Any:
    return cross(x, np.array([1.0, 0.5, 0.25]) * x)


def top(x: Any) -> Any:
    """Momentum and direction of gravity: pi' = pi x omega + gamma x chi, gamma' = gamma x omega."""
    omega, chi = np.array([1.0, 0.75, 0.5]) * x[:3], np.array([0.0, 0.0, 1.0])
    return np.concatenate([cross(x[:3], omega) + cross(x[3:], chi), cross(x[3:], omega)])


FULL = 0.125 * np.array(
    [
        [8, 1, 0, 1, 0, 0],
        [1, 6, 1, 0, 0, 0],
        [0, 1, 5, 0, 1, 0],
        [1, 0, 0, 4, 0, 1],
        [0, 0, 1, 0, 7, 0],
        [0, 0, 0, 1, 0, 3],
    ]
)
PAIRS = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]


def skew(x: Any) -> Any:
    matrix = np.zeros((4, 4), dtype=x.dtype)
    for value, (i, j) in zip(x, PAIRS, strict=True):
        matrix[i, j], matrix[j, i] = value, -value
    return matrix


def four_dimensional_body(x: Any) -> Any:
    X, U = skew(x), skew(FULL @ x)
    return np.array([(X @ U - U @ X)[pair] for pair in PAIRS])


def spiral(x: Any) -> Any:
    """A3,7 with a = 1/2."""
    u, first, second = np.array([1.0, 1.5, 0.25]) * x, 0.5 * x[0] - x[1], x[0] + 0.5 * x[1]
    return np.array([first * u[2], second * u[2], -first * u[0] - second * u[1]])


def toda(x: Any) -> Any:
    """Three particles on a ring, in Flaschka's variables: a' = a (b_next - b), b' = 2 (a^2 - a_before^2)."""
    a, b = x[:3], x[3:]
    return np.concatenate([a * (np.roll(b, -1) - b), 2.0 * (a * a - np.roll(a * a, 1))])


def toda_algebra() -> co.LieAlgebra:
    brackets: dict = {}
    for i in range(3):
        brackets[i, 3 + i], brackets[i, 3 + (i + 1) % 3] = {i: -1.0}, {i: 1.0}
    return co.LieAlgebra.from_brackets(6, brackets, name="periodic Toda")


def ring(x: Any) -> Any:
    """Four spins, each turning about the sum of its neighbours, with a larger weight of z."""
    spins = x.reshape(4, 3)
    around = (np.roll(spins, 1, axis=0) + np.roll(spins, -1, axis=0)) * np.array([1.0, 1.0, 1.25])
    return np.concatenate([cross(u, s) for u, s in zip(around, spins, strict=True)])


def ring_matrix() -> np.ndarray:
    neighbours = np.roll(np.eye(4), 1, axis=0) + np.roll(np.eye(4), -1, axis=0)
    return np.kron(neighbours, np.diag([1.0, 1.0, 1.25]))


@cache
def written_out() -> dict[str, Written]:
    """Return the systems, by name."""
    system, algebras = co.LiePoissonSystem, co.algebras
    states = np.random.default_rng(7).uniform(-1.0, 1.0, (3, 12))
    states = np.round(states, 3)
    high = np.array([0.0, 0.0, 1.5, 0.6, 0.0, 0.8])
    particles = np.array([1.0, 0.8, 0.6, 0.0, 0.0, 0.0])
    found = {
        "so(3)": Written(
            system(algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]), sign=-1), body, 2 * states[:, :3], 30.0
        ),
        "e(3)": Written(
            system(algebras.e(3), co.Quadratic([1.0, 0.75, 0.5, 0, 0, 0], linear=[0, 0, 0, 0, 0, 1.0]), sign=-1),
            top,
            high + 0.5 * states[:, :6],
            20.0,
        ),
        "so(4), full M": Written(
            system(algebras.so(4), co.Quadratic(FULL), sign=-1), four_dimensional_body, 2 * states[:, :6], 20.0
        ),
        "A3,7": Written(
            system(algebras.A3_7(0.5), co.Quadratic([1.0, 1.5, 0.25])), spiral, np.abs(states[:, :3]) + 0.1, 6.0
        ),
        "Toda": Written(
            system(toda_algebra(), co.Quadratic([2.0, 2, 2, 1, 1, 1])), toda, particles + 0.3 * states[:, :6], 20.0
        ),
        "spin ring": Written(
            system(algebras.copies(algebras.so(3), 4), co.Quadratic(ring_matrix())), ring, states, 15.0
        ),
    }
    for case in found.values():
        for x in case.starts:
            assert np.allclose(case.field(x), case.system.vector_field(x), rtol=1e-14, atol=1e-14)
    return found


STAGES = 9
ENOUGH = 1e-16
DIGITS = 30
# Extended precision where available, a hundred times faster; its rounding, 5e-20 a hundredfold in each of some hundred
# steps, stays far below `ENOUGH`.
LONG: Any = np.longdouble if np.finfo(np.longdouble).nmant >= 63 else mpmath.mpf


def many_digits(field: Callable[[Any], Any], x0: np.ndarray, time: float) -> tuple[np.ndarray, float]:
    """Return the state at `time` and the largest momentum on the way, by Gragg's extrapolated midpoint rule.

    Of order 18; the number of steps is doubled until the estimated errors of all steps add up to `ENOUGH` at most.
    """
    start = np.array([LONG(float(value)) for value in x0])
    with mpmath.workdps(DIGITS):
        for steps in (int(np.ceil(abs(time))) * 2**k for k in range(8)):
            x, missing, largest = start, 0.0, float(np.linalg.norm(x0))
            for _ in range(steps):
                x, estimate = extrapolated(field, x, LONG(time) / steps)
                missing, largest = missing + estimate, max(largest, float(np.linalg.norm(x.astype(float))))
                if not missing <= ENOUGH * largest:
                    break
            else:
                return x.astype(float), largest
    raise AssertionError("the extrapolation does not settle")


def extrapolated(field: Callable[[Any], Any], x: Any, h: Any) -> tuple[Any, float]:
    """Return one step, and the change by its last extrapolation."""
    rows: list[list[Any]] = []
    slope = field(x)
    for stage in range(1, STAGES + 1):
        count, d = 2 * stage, h / (2 * stage)
        before, now = x, x + d * slope
        for _ in range(count - 1):
            before, now = now, before + 2 * d * field(now)
        row = [(before + now + d * field(now)) / 2]
        for j in range(stage - 1):
            ratio = type(h)(stage) / (stage - 1 - j)
            row.append(row[j] + (row[j] - rows[-1][j]) / (ratio * ratio - 1))
        rows.append(row)
    return rows[-1][-1], float(max(abs(rows[-1][-1] - rows[-1][-2])))
