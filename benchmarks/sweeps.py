"""Sweeps of one parameter: as many systems as values, beside as many states of one system, over the registries.

python benchmarks/sweeps.py [--members M] [--steps N] [--rounds R] [WORD ...]

Each number by which a ready-made system or a force can be differentiated is swept by a tenth. Processor times in one
thread, in turns, of a run that is prepared, and of `batch`, `prepare` and the run together; the least of each counts.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import numpy as np

import coadjoint as co

FITTING: tuple[Callable[[], Any], ...] = (
    lambda: co.systems.rigid_body((1.0, 2.0, 2.5)),
    lambda: co.systems.body((1.0, 2.0, 2.5), wheels=0.1 * np.eye(3), gyros=np.eye(3)[[(0, 1), (1, 2), (2, 0)]]),
)
GIVEN: dict[str, dict[str, Any]] = {
    "Torque": {"torque": 0.1},
    "OwnForce": {"function": lambda x, t, tau: x * np.exp(-0.1 * tau)},
}


def scaled(value: Any, factor: float) -> Any:
    """Return a number, or numbers of which the first that is not zero is multiplied."""
    array = np.array(value, dtype=float)
    first = np.flatnonzero(array)[:1]
    array.flat[first] *= factor
    return array if array.ndim else float(array)


def of_systems() -> Iterator[tuple[str, Callable[[float], Any]]]:
    """Yield a name and a function of the factor for each parameter of each ready-made system."""
    for name in co.systems.names():
        make = getattr(co.systems, name)
        with suppress(TypeError, ValueError):
            system = make()
            for parameter in () if system.has_matrices else co.prepare(system, None, 0.125).parameters:
                if parameter in (system.parameters or {}):
                    value = system.parameters[parameter]
                    yield (
                        f"{name}({parameter})",
                        lambda factor, make=make, parameter=parameter, value=value: make(
                            **{parameter: scaled(value, factor)}
                        ),
                    )


def of_forces() -> Iterator[tuple[str, Callable[[float], Any]]]:
    """Yield the same for each parameter of each force, on the first system that takes it."""
    for name in co.forces.names():
        for plain in FITTING:
            with suppress(TypeError, ValueError):
                given = {"torque": 0.1 * np.ones(plain().dim)} if name == "Torque" else GIVEN.get(name, {})
                force = getattr(co.forces, name)(**{**getattr(co.forces, name).example, **given})
                system = plain().with_forces(force)
                for parameter in co.prepare(system, None, 0.125).parameters:
                    force_name, _, field = parameter.partition(".")
                    if field and "." not in field and force_name == name:
                        value = getattr(force, field)
                        yield (
                            f"{name}({field})",
                            lambda factor, plain=plain, force=force, field=field, value=value: plain().with_forces(
                                dataclasses.replace(force, **{field: scaled(value, factor)})
                            ),
                        )
                break


def seconds(system: Any, states: np.ndarray, span: tuple[float, float], h: float) -> tuple[float, float]:
    """Return the processor times of a prepared run, and of preparation and run."""
    began = time.process_time()
    prepared = co.prepare(co.batch(system) if isinstance(system, list) else system, None, h, threads=1, watch=False)
    prepared.run(states, span, save_every=1000)
    whole = time.process_time() - began
    began = time.process_time()
    prepared.run(states, span, save_every=1000)
    return time.process_time() - began, whole


def main() -> None:
    parser = argparse.ArgumentParser(description="sweeps of each parameter beside ensembles")
    parser.add_argument("words", nargs="*")
    parser.add_argument("--members", type=int, default=200)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    factors, h = np.linspace(0.95, 1.05, given.members), 2.0**-7
    span, found = (0.0, h * given.steps), {}
    for label, make in (*of_systems(), *of_forces()):
        if given.words and not any(word in label for word in given.words):
            continue
        one = make(1.0)
        state = np.linspace(0.2, 0.9, one.dim)
        if one.name in ("bodies", "gravitating_bodies", "decorated_particles"):  # of systems with positions
            state[4 if one.name == "decorated_particles" else -1] = 1.0
        with suppress(AttributeError, TypeError, ValueError):
            state = np.ravel(one.state(angular_velocity=(0.1, 0.2, 0.3)))
        states = np.tile(state, (given.members, 1))
        try:
            pairs = [  # of systems made for each round, of which nothing is known from those before
                (
                    seconds([make(float(factor)) for factor in factors], states, span, h),
                    seconds(make(1.0), states, span, h),
                )
                for _ in range(given.rounds)
            ]
        except (co.IntegrationError, ValueError, TypeError) as reason:
            print(f"{label}: {str(reason)[:100]}")
            continue
        ratios = [min(a[k] for a, _ in pairs) / min(b[k] for _, b in pairs) for k in (0, 1)]
        found[label] = ratios
        print(f"{label}: run {ratios[0]:.2f}, with preparation {ratios[1]:.2f}", flush=True)
    print("with preparation, worst first:")
    for label, ratios in sorted(found.items(), key=lambda pair: -pair[1][1])[:12]:
        print(f"  {label}: {ratios[1]:.2f}, run {ratios[0]:.2f}")
    runs, wholes = (sorted(ratio[k] for ratio in found.values()) for k in (0, 1))
    print(f"{len(found)} sweeps of {given.members} values, {given.steps} steps: run {runs[len(runs) // 2]:.2f} at the")
    print(f"median and {runs[-1]:.2f} at most; with preparation {wholes[len(wholes) // 2]:.2f} and {wholes[-1]:.2f}")


if __name__ == "__main__":
    main()
