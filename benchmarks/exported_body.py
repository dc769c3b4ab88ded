"""The exported C header of free bodies beside the usual integrators: time of a step, and errors after 100 turns.

python benchmarks/exported_body.py [--steps N] [--rounds R]
"""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from c_programs import build, run

import coadjoint as co
from coadjoint.files.exports.c_statements import FREE_BODY

METHODS = {
    "exact": 0,
    "exact, float": 1,
    "exact, with a matrix": 2,
    "exact, with derivatives": 3,
    "semi-implicit Euler, explicit gyroscopic term": 5,
    "semi-implicit Euler, implicit gyroscopic term": 6,
    "Runge-Kutta of order 4": 7,
    "Buss, order 2": 8,
    "NO_SQUISH": 9,
}
MUJOCO = ("Euler", "implicitfast", "implicit", "discrete", "RK4")
WITHOUT_ERROR = ("exact, with a matrix", "exact, with derivatives")
Contender = Callable[[int, float], tuple[float, np.ndarray]]
"""Takes steps of a length; returns nanoseconds a step, and the momentum and the quaternion at the end."""

INERTIA, START = (1.0, 1.5, 2.5), (0.6, 1.4, 0.5)
TURNS, STEPS_PER_TURN = 100, (60, 10)


class Row(NamedTuple):
    """Nanoseconds of a step; for each step the error of the momentum over its length, and radians of the attitude."""

    title: str
    nanoseconds: float
    errors: list[tuple[float, float]]


def measure(steps: int, rounds: int) -> list[Row]:
    """Return the rows; the programs take turns, and the least time of all rounds counts."""
    program = build("exported_body", f"-I{FREE_BODY.parent}", "-ffp-contract=off")
    m, x0 = 1.0 / np.array(INERTIA), np.array(START)
    turn = float(2.0 * np.pi / np.linalg.norm(m * x0))
    numbers = [repr(float(v)) for v in (*m, *x0)]

    def by_program(code: int) -> Contender:
        return lambda steps, h: run(program, [str(code), str(steps), repr(h), *numbers])

    contenders = {name: by_program(code) for name, code in METHODS.items()} | of_mujoco()
    best = dict.fromkeys(contenders, np.inf)
    for _ in range(rounds):
        for name, contender in contenders.items():
            best[name] = min(best[name], contender(steps, turn / STEPS_PER_TURN[0])[0])
    rows = []
    for name, contender in contenders.items():
        errors = []
        for count in STEPS_PER_TURN if name not in WITHOUT_ERROR else ():
            step = float(np.float32(turn / count))
            _, state = contender(TURNS * count, step)
            errors.append(_errors(state, TURNS * count * step))
        rows.append(Row(name, best[name], errors))
    return rows


def of_mujoco() -> dict[str, Contender]:
    """Return the integrators of MuJoCo, for a free joint, if it is installed (`pip install mujoco`)."""
    try:
        mujoco = importlib.import_module("mujoco")
    except ImportError:
        return {}
    mujoco.set_mju_user_warning(lambda text: None)  # it would write a file
    moments = " ".join(map(str, INERTIA))
    body = f'<body><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="{moments}"/></body>'

    def by_integrator(integrator: str) -> Contender:
        def steps_of(steps: int, h: float) -> tuple[float, np.ndarray]:
            # A run that diverges must not begin anew.
            flag = '<flag autoreset="disable"/>'
            options = f'<option timestep="{h!r}" gravity="0 0 0" integrator="{integrator}">{flag}</option>'
            model = mujoco.MjModel.from_xml_string(f"<mujoco>{options}<worldbody>{body}</worldbody></mujoco>")
            data = mujoco.MjData(model)
            data.qvel[3:] = np.array(START) / INERTIA
            begun = time.process_time()
            mujoco.mj_step(model, data, nstep=steps)
            nanoseconds = 1e9 * (time.process_time() - begun) / steps
            return nanoseconds, np.concatenate([data.qvel[3:] * INERTIA, data.qpos[3:]])

        return steps_of

    return {f"MuJoCo {mujoco.__version__}, {name}": by_integrator(name) for name in MUJOCO}


def _errors(state: np.ndarray, t: float) -> tuple[float, float]:
    """Return the relative error of the momentum, and the angle by which the attitude is off."""
    x, A = co.systems.rigid_body(INERTIA).exact(np.array(START), t, attitude=True)
    half = np.linalg.norm(A - _matrix(state[3:])) / (2.0 * np.sqrt(2.0))  # sin(angle/2)
    return float(np.linalg.norm(state[:3] - x) / np.linalg.norm(x)), 2.0 * float(np.arcsin(min(1.0, half)))


def _matrix(q: np.ndarray) -> np.ndarray:
    w, x, y, z = q / np.linalg.norm(q)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * w * K + 2.0 * K @ K


def table(rows: list[Row]) -> str:
    """Return the rows as a table in Markdown."""
    heads = [f"errors after {TURNS} turns, {count} steps a turn: momentum, attitude" for count in STEPS_PER_TURN]
    lines = [f"| | ns a step | {' | '.join(heads)} |", "|---|---|---|---|"]
    for row in rows:
        errors = [
            f"{momentum:.1e}, {attitude:.1e} rad" if momentum < np.inf else "overflows"
            for momentum, attitude in row.errors
        ] or [""] * len(heads)
        lines.append(f"| {row.title} | {row.nanoseconds:.0f} | {' | '.join(errors)} |")
    return "\n".join(lines)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--rounds", type=int, default=100)
    given = parser.parse_args()
    print(table(measure(given.steps, given.rounds)))


if __name__ == "__main__":
    main()
