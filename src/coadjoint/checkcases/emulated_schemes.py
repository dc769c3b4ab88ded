"""Common schemes of low order for one body, with which the samples of simulators are compared."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.checkcases.altered_motions import Field, law_of, motion_field, quaternion_product, velocity_field
from coadjoint.checkcases.check_case import BodyModel, Columns

Floats = npt.NDArray[np.float64]

MAX_STEPS = 10_000  # of each scheme, some seconds; later samples are left out
ON_STEP = 1e-6  # of a step, the deviation of a sample from it
LEAST_ROWS = 2


def emulated_runs(body: BodyModel, step: float, times: Floats) -> Iterator[tuple[str, int, Any, Columns]]:
    """Yield name, order, rows of the times that are steps, and the columns there, of each scheme."""
    if body.period is not None:
        return
    counts = np.round(times / step)
    rows = np.flatnonzero((np.abs(times / step - counts) < ON_STEP * np.maximum(counts, 1.0)) & (counts <= MAX_STEPS))
    if len(rows) < LEAST_ROWS:
        return
    wanted, field, velocity = (
        counts[rows].astype(int),
        motion_field(body, law_of(body)),
        velocity_field(body, law_of(body)),
    )
    start = np.concatenate([body.rates, body.attitude])
    for label, order, scheme in SCHEMES:
        y, values, saved = start, [], set(wanted.tolist())
        memory: dict[str, Floats] = {}
        with np.errstate(all="ignore"):
            for k in range(wanted[-1] + 1):
                if k in saved:
                    values.append(y)
                y = scheme(field, velocity, k * step, step, y, memory)
                norm = np.linalg.norm(y[3:])
                y = np.concatenate([y[:3], y[3:] / norm])
        if np.isfinite(values).all():
            yield (
                label,
                order,
                rows,
                dict(zip(("wx", "wy", "wz", "qw", "qx", "qy", "qz"), np.array(values).T, strict=True)),
            )


def _turned(q: Floats, w: Floats, h: float) -> Floats:
    """Return q after a rotation at the constant rate w of the body, for a time h."""
    rate = float(np.linalg.norm(w))
    if not rate:
        return q
    return np.asarray(np.cos(0.5 * rate * h) * q + np.sin(0.5 * rate * h) / rate * quaternion_product(q, w))


def _explicit_euler(field: Field, velocity: Field, t: float, h: float, y: Floats, memory: Any) -> Floats:
    return y + h * field(t, y)


def _euler_exponential(field: Field, velocity: Field, t: float, h: float, y: Floats, memory: Any) -> Floats:
    return np.concatenate([y[:3] + h * velocity(t, y), _turned(y[3:], y[:3], h)])


def _semi_implicit(field: Field, velocity: Field, t: float, h: float, y: Floats, memory: Any) -> Floats:
    w = y[:3] + h * velocity(t, y)
    return np.concatenate([w, y[3:] + 0.5 * h * quaternion_product(y[3:], w)])


def _semi_implicit_exponential(field: Field, velocity: Field, t: float, h: float, y: Floats, memory: Any) -> Floats:
    w = y[:3] + h * velocity(t, y)
    return np.concatenate([w, _turned(y[3:], w, h)])


def _linearly_implicit(field: Field, velocity: Field, t: float, h: float, y: Floats, memory: Any) -> Floats:
    # The derivative of the acceleration by the rates is exact by central differences, since it is quadratic in them.
    size = float(np.linalg.norm(y[:3])) or 1.0
    changes = [velocity(t, y + size * unit) - velocity(t, y - size * unit) for unit in np.eye(7)[:3]]
    J = np.column_stack(changes) / (2.0 * size)
    w = y[:3] + h * np.linalg.solve(np.eye(3) - h * J, velocity(t, y))
    return np.concatenate([w, _turned(y[3:], w, h)])


def _adams_bashforth(field: Field, velocity: Field, t: float, h: float, y: Floats, memory: Any) -> Floats:
    slope = field(t, y)
    before = memory.get("slope", slope)
    memory["slope"] = slope
    return y + h * (1.5 * slope - 0.5 * before)


def _midpoint(field: Field, velocity: Field, t: float, h: float, y: Floats, memory: Any) -> Floats:
    return y + h * field(t + 0.5 * h, y + 0.5 * h * field(t, y))


def _heun(field: Field, velocity: Field, t: float, h: float, y: Floats, memory: Any) -> Floats:
    slope = field(t, y)
    return y + 0.5 * h * (slope + field(t + h, y + h * slope))


def _runge_kutta_4(field: Field, velocity: Field, t: float, h: float, y: Floats, memory: Any) -> Floats:
    a = field(t, y)
    b = field(t + 0.5 * h, y + 0.5 * h * a)
    c = field(t + 0.5 * h, y + 0.5 * h * b)
    d = field(t + h, y + h * c)
    return y + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)


Scheme = Callable[[Field, Field, float, float, Floats, Any], Floats]

SCHEMES: tuple[tuple[str, int, Scheme], ...] = (
    ("explicit Euler steps of rates and quaternion", 1, _explicit_euler),
    ("explicit Euler steps of the rates, and rotations by the old rates", 1, _euler_exponential),
    ("semi-implicit Euler steps, the quaternion by the derivative at the new rates", 1, _semi_implicit),
    ("semi-implicit Euler steps, rotations by the new rates", 1, _semi_implicit_exponential),
    ("linearly implicit Euler steps, rotations by the new rates", 1, _linearly_implicit),
    ("Adams-Bashforth steps of two values", 2, _adams_bashforth),
    ("explicit midpoint steps", 2, _midpoint),
    ("Heun's steps", 2, _heun),
    ("classical Runge-Kutta steps", 4, _runge_kutta_4),
)
"""Name, order and step from (w, q) of each scheme; quaternions are normalized after every step."""
