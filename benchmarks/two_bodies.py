"""Didymos and Dimorphos over ten orbits to an error of 1e-9: splittings and Runge-Kutta methods in quaternions.

python benchmarks/two_bodies.py [--error E] [--span T] [--rounds R]

Times are processor times of runs that store their end only, at the largest step or tolerance with this error of
positions and rotation matrices at the end. DOP853 and Fehlberg's RK7(8) are loops with adaptive steps, compiled by
Numba like their vector field: relative position and velocity, quaternions, and angular velocities in body frames.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.integrate._ivp import dop853_coefficients as dop853
from scipy.spatial.transform import Rotation

import coadjoint as co

Floats = NDArray[np.float64]

# Didymos and Dimorphos, as on docs/two_asteroids.md, on an ellipse, in units of the distance and the total mass.
SQUARES = (np.array([[851, 849, 620], [177, 174, 116]]) / 2 / 1206.0) ** 2
MASSES = np.sqrt(SQUARES.prod(axis=1)) / np.sqrt(SQUARES.prod(axis=1)).sum()
MOMENTS = MASSES[:, None] * (SQUARES.sum(axis=1, keepdims=True) - SQUARES) / 5
TURNED = Rotation.from_euler("zx", [[0, 1], [10, 2]], degrees=True)
SHARES = np.array([[-MASSES[1]], [MASSES[0]]])
PLACES, SPEEDS = SHARES * [1.0, 0.0, 0.0], SHARES * [0.0, 1.02, 0.0]
SPINS = np.array([[0.0, 0.0, 5.32], [0.0, 0.0, 1.009]])

# Fehlberg, NASA TR R-287 (1968): the coefficients of the stages in rows; the solution is that of order 8.
FEHLBERG = """0
2/27
1/36 1/12
1/24 0 1/8
5/12 0 -25/16 25/16
1/20 0 0 1/4 1/5
-25/108 0 0 125/108 -65/27 125/54
31/300 0 0 0 61/225 -2/9 13/900
2 0 0 -53/6 704/45 -107/9 67/90 3
-91/108 0 0 23/108 -976/135 311/54 -19/60 17/6 -1/12
2383/4100 0 0 -341/164 4496/1025 -301/82 2133/4100 45/82 45/164 18/41
3/205 0 0 0 0 -6/41 -3/205 -3/41 3/41 6/41 0
-1777/4100 0 0 -341/164 4496/1025 -289/82 2193/4100 51/82 33/164 12/41 0 1"""
OF_ORDER_8 = "0 0 0 0 0 34/105 9/35 9/35 9/280 9/280 0 41/840 41/840"


def tableau_of_fehlberg() -> tuple[Floats, Floats, Floats, Floats]:
    """Return the stages, the weights, and those of the error, twice."""
    rows = [[eval(number) for number in row.split()] for row in FEHLBERG.splitlines()]
    A = np.zeros((13, 13))
    for i, row in enumerate(rows):
        A[i, : len(row)] = row
    weights = np.array([eval(number) for number in OF_ORDER_8.split()])
    error = np.zeros(13)
    error[[0, 10]], error[[11, 12]] = -41 / 840, 41 / 840
    return A, weights, error, np.zeros(13)


def tableau_of_dop853() -> tuple[Floats, Floats, Floats, Floats]:
    """Return the stages, the weights, and those of the errors of orders five and three."""
    return dop853.A[:12, :12].copy(), dop853.B.copy(), dop853.E5[:12].copy(), dop853.E3[:12].copy()


@numba.njit(error_model="numpy", cache=False)
def field(y: Any, f: Any) -> None:
    """Fill f with the derivatives of relative position and velocity, quaternions and angular velocities."""
    square = y[0] * y[0] + y[1] * y[1] + y[2] * y[2]
    over = 1.0 / np.sqrt(square)
    ax, ay, az = 0.0, 0.0, 0.0
    fifth = over / (square * square)
    central = -MASSES[0] * MASSES[1] * over / square
    for k in range(2):
        i, x, z, w = 6 + 4 * k, y[6 + 4 * k], y[8 + 4 * k], y[9 + 4 * k]
        v = y[i + 1]
        p, q, r = y[14 + 3 * k], y[15 + 3 * k], y[16 + 3 * k]
        f[i] = 0.5 * (w * p + v * r - z * q)
        f[i + 1] = 0.5 * (w * q + z * p - x * r)
        f[i + 2] = 0.5 * (w * r + x * q - v * p)
        f[i + 3] = -0.5 * (x * p + v * q + z * r)
        a00, a01, a02 = 1 - 2 * (v * v + z * z), 2 * (x * v - z * w), 2 * (x * z + v * w)
        a10, a11, a12 = 2 * (x * v + z * w), 1 - 2 * (x * x + z * z), 2 * (v * z - x * w)
        a20, a21, a22 = 2 * (x * z - v * w), 2 * (v * z + x * w), 1 - 2 * (x * x + v * v)
        b0 = a00 * y[0] + a10 * y[1] + a20 * y[2]
        b1 = a01 * y[0] + a11 * y[1] + a21 * y[2]
        b2 = a02 * y[0] + a12 * y[1] + a22 * y[2]
        I0, I1, I2 = MOMENTS[k, 0], MOMENTS[k, 1], MOMENTS[k, 2]
        e0, e1, e2 = I0 * b0, I1 * b1, I2 * b2
        c = 3.0 * MASSES[1 - k] * fifth
        f[14 + 3 * k] = (c * (b1 * e2 - b2 * e1) + (I1 - I2) * q * r) / I0
        f[15 + 3 * k] = (c * (b2 * e0 - b0 * e2) + (I2 - I0) * r * p) / I1
        f[16 + 3 * k] = (c * (b0 * e1 - b1 * e0) + (I0 - I1) * p * q) / I2
        form = b0 * e0 + b1 * e1 + b2 * e2
        central -= 0.5 * c * (I0 + I1 + I2 - 5.0 * form / square)
        ax -= c * (a00 * e0 + a01 * e1 + a02 * e2)
        ay -= c * (a10 * e0 + a11 * e1 + a12 * e2)
        az -= c * (a20 * e0 + a21 * e1 + a22 * e2)
    over_mass = 1.0 / MASSES[0] + 1.0 / MASSES[1]
    f[0], f[1], f[2] = y[3], y[4], y[5]
    f[3] = over_mass * (central * y[0] + ax)
    f[4] = over_mass * (central * y[1] + ay)
    f[5] = over_mass * (central * y[2] + az)


@numba.njit(error_model="numpy", cache=False)
def adaptive(y: Any, span: float, tolerance: float, A: Any, b: Any, e5: Any, e3: Any) -> Any:
    """Return the state after a span, with the step control of SciPy: exponent 1/8, and both errors of DOP853."""
    n, s = len(y), len(b)
    K, point, y = np.zeros((s, n)), np.zeros(n), y.copy()
    t, h = 0.0, 0.01
    field(y, K[0])
    while t < span:
        h = min(h, span - t)
        for i in range(1, s):
            for m in range(n):
                total = 0.0
                for j in range(i):
                    total += A[i, j] * K[j, m]
                point[m] = y[m] + h * total
            field(point, K[i])
        fifth, third = 0.0, 0.0
        for m in range(n):
            total, one, other = 0.0, 0.0, 0.0
            for j in range(s):
                total += b[j] * K[j, m]
                one += e5[j] * K[j, m]
                other += e3[j] * K[j, m]
            point[m] = y[m] + h * total
            scale = tolerance * (1.0 + max(abs(y[m]), abs(point[m])))
            fifth += (one / scale) ** 2
            third += (other / scale) ** 2
        error = h * fifth / np.sqrt((fifth + 0.01 * third) * n) if fifth > 0.0 else 0.0
        if error < 1.0:
            t += h
            y[:] = point
            field(y, K[0])
        h *= min(10.0, max(0.2, 0.9 * error**-0.125)) if error > 0.0 else 10.0
    return y


def start() -> Floats:
    """Return the start in quaternions."""
    parts = PLACES[1] - PLACES[0], SPEEDS[1] - SPEEDS[0], TURNED.as_quat(), SPINS
    return np.concatenate([np.ravel(part) for part in parts])


def measured(y: Floats) -> Floats:
    """Return the relative position and the rotation matrices of a state in quaternions."""
    return np.concatenate([y[:3], Rotation.from_quat(y[6:14].reshape(2, 4)).as_matrix().ravel()])


def least_time(run: Callable[[], Any], rounds: int) -> float:
    """Return the least processor time of a call in milliseconds."""
    times = []
    for _ in range(rounds):
        begun = time.process_time()
        run()
        times.append(time.process_time() - begun)
    return 1e3 * min(times)


def main() -> None:
    parser = argparse.ArgumentParser(description="two bodies to an error")
    parser.add_argument("--error", type=float, default=1e-9)
    parser.add_argument("--span", type=float, default=62.0)
    parser.add_argument("--rounds", type=int, default=20)
    given = parser.parse_args()
    y0, dop, rkf = start(), tableau_of_dop853(), tableau_of_fehlberg()
    exact = measured(adaptive(y0, given.span, 1e-15, *dop))
    print(f"reference: {np.abs(measured(adaptive(y0, given.span, 1e-15, *rkf)) - exact).max():.0e} from RK7(8)")
    pair = co.systems.gravitating_bodies(MOMENTS, MASSES)
    x0 = pair.state(PLACES, SPEEDS, TURNED, SPINS)

    def by_splitting(method: co.Splitting, steps: int) -> Callable[[], Floats]:
        ready = co.prepare(pair, method, given.span / steps)

        def run() -> Floats:
            x = ready.run(x0, (0.0, given.span), steps).x[-1]
            r = pair.positions(x)
            return np.concatenate([r[1] - r[0], pair.attitudes(x).ravel()])

        return run

    def by_scipy(tolerance: float) -> Floats:
        f = np.zeros(20)

        def slope(t: float, y: Floats) -> Floats:
            field(y, f)
            return f.copy()

        return measured(solve_ivp(slope, (0.0, given.span), y0, "DOP853", rtol=tolerance, atol=tolerance).y[:, -1])

    tolerances, counts = (
        10.0 ** -np.arange(6.0, 15.0, 0.25),
        np.unique((200 * 2.0 ** np.arange(0, 8, 0.25)).astype(int)),
    )
    contenders: dict[str, list[Callable[[], Floats]]] = {
        "DOP853, compiled by Numba": [lambda e=e: measured(adaptive(y0, given.span, e, *dop)) for e in tolerances],
        "RK7(8), compiled by Numba": [lambda e=e: measured(adaptive(y0, given.span, e, *rkf)) for e in tolerances],
        "DOP853 of SciPy, field compiled": [lambda e=e: by_scipy(e) for e in tolerances],
    }
    for order in (4, 6, 8):
        for parts in ("auto", "free_body"):
            method = co.Splitting(order=order, parts=parts)
            contenders[f"{method}"] = [by_splitting(method, int(count)) for count in counts]
    times, base = {}, 0.0
    for name, runs in contenders.items():
        run = next((run for run in runs if np.abs(run() - exact).max() <= given.error), None)
        if run is None:
            print(f"{name}: not reached")
            continue
        times[name] = least_time(run, given.rounds)
        base = base or times[name]
        print(f"{name}: {times[name]:.2f} ms, {times[name] / base:.2f}", flush=True)


if __name__ == "__main__":
    main()
