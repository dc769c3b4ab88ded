"""Subject of a certificate: system, scheme with its declarations, step, and states along the motion."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.certificates.reference import Norm, motion, natural_time
from coadjoint.errors import IntegrationError
from coadjoint.long_operations import note_progress
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.protocol.properties import Properties
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.derivatives.run_tables import StepTangents, compiled_tangents
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.start import any_momenta_of, is_attitude_kind, with_group
from coadjoint.systems.system import System

Floats = NDArray[np.float64]

MIN_STATES = 4  # to which fewer given ones are extended along the motion
MAX_STATES = 8  # of a sample that are looked at
# Time between states along the motion, as a fraction of the natural time: distinct states, few steps apart.
STATE_SPACING = 0.7
MAX_DENSE_DIM = 256
"""Largest dimension in which dense matrices of a step are computed."""
SECONDS_PER_COST = 1.1e-8
"""Seconds on one core for a unit of the cost model."""
EXPENSIVE_SECONDS = 2.5e-4
"""Seconds per step above which derivatives are computed along a few directions only, at fewer states."""
STATES_OF_EXPENSIVE_STEPS = 2  # instead of `MIN_STATES`
DIRECTIONS = 4  # of tangents and of noise, for an estimate to a factor of two
SEED = 1993  # of directions; fixed, so that a certificate is repeated to the bit


@dataclass(frozen=True)
class Subject:
    """A system, a scheme, a signed step h, the given states (k, n), and what the scheme declares (None: nothing)."""

    system: System
    method: Method
    h: float
    given: Floats
    steps: int | None
    compiled: bool = True
    order: int | None = None
    properties: Properties | None = None
    symmetric: bool | None = None
    _prepared: dict[Any, PreparedRun] = field(default_factory=dict, init=False)
    _conditions: dict[Any, float] = field(default_factory=dict, init=False)
    _tangents: dict[float, StepTangents | None] = field(default_factory=dict, init=False)

    @cached_property
    def states(self) -> Floats:
        """States (k, n): those given, extended along the motion of the first if they are few."""
        fewest, most = (STATES_OF_EXPENSIVE_STEPS,) * 2 if self.expensive else (MIN_STATES, MAX_STATES)
        if len(self.given) >= fewest:
            return self.given[:most]
        states, x = list(self.given), self.given[0]
        spacing = np.copysign(STATE_SPACING * self.time, self.h)
        while len(states) < fewest:
            moved = motion(self.system, x[None], float(spacing))
            if moved is None:
                break
            x = moved.states[0]
            states.append(x)
        return np.array(states)

    @cached_property
    def norm(self) -> Norm:
        """The norm of errors and defects, with units for the groups of coordinates from their sizes in the states."""
        return Norm.of(self.system, self.states)

    @cached_property
    def seconds(self) -> float:
        """Estimated seconds on one core for a step of one state, by the cost model; 0 if unknown."""
        return self.seconds_with(None)

    def seconds_with(self, representation: Any) -> float:
        if not self.compiled:
            return 0.0
        try:
            stats = self.run(self.given[0], self.h, 1).stats
        except IntegrationError:
            return 0.0
        work = self.method.work(self.system, representation)
        return SECONDS_PER_COST * float(work.cost(stats.iterations, stats.evaluations))

    @property
    def expensive(self) -> bool:
        return self.seconds > EXPENSIVE_SECONDS

    def affordable(self, seconds: float) -> int:
        """Return the number of steps of all states that fit into some seconds; 2^53 if steps are cheap."""
        step = self.seconds * len(self.states)
        return max(1, int(seconds / step)) if self.expensive else 2**53

    @cached_property
    def time(self) -> float:
        times = [natural_time(self.system, x) for x in self.given]
        return min((time for time in times if time > 0.0), default=abs(self.h))

    @cached_property
    def at_equilibrium(self) -> bool:
        return all(natural_time(self.system, x) == 0.0 for x in self.given)

    @cached_property
    def span_time(self) -> float:
        times = [natural_time(self.system, x) for x in self.states]
        return min([self.time, *(time for time in times if time > 0.0)])

    @cached_property
    def evaluations(self) -> float:
        """Flows or evaluations of the field in a step of one member; 1 if the step fails."""
        try:
            run = self.run(self.states, self.h, 1)
        except IntegrationError:
            return 1.0
        return max(1.0, run.stats.evaluations / len(self.states))

    @cached_property
    def noise(self) -> float:
        """Noise of a step by rounding or truncated iterations: second differences at distances 2^-40, over sqrt(6)."""
        worst = 0.0
        for x in self.states[:2]:
            size = float(self.norm(x))
            direction = self.norm.unscaled(np.cos(1.0 + np.arange(len(x))) * size / np.sqrt(len(x)))
            line = np.array([x + 2.0**-40 * k * direction for k in range(10)])
            try:
                after = self.step(line, self.h)
            except IntegrationError:
                continue
            worst = max(worst, float(np.max(self.norm(np.diff(after, 2, axis=0), axis=1))) / np.sqrt(6.0))
        return worst

    def rounding(self, h: float, evaluations: float | None = None) -> float:
        """Return the bound on the round-off of a step relative to the state: 4 n u for each evaluation."""
        count = self.evaluations if evaluations is None else evaluations
        return 4 * self.system.dim * UNIT_ROUNDOFF * (count + 1)

    def condition(self, x: Floats, h: float) -> float:
        """Return the condition number |P| |P^-1| of a step of length h in the norm, by differences."""
        # For expensive steps the norms are estimated along some directions, and the inverse is the step back.
        key = x.tobytes(), h
        if key not in self._conditions:
            self._conditions[key] = self._estimated_condition(x, h) if self.expensive else self._condition(x, h)
        return self._conditions[key]

    def _estimated_condition(self, x: Floats, h: float) -> float:
        end = self.step(x[None], h)[0]
        return self.tangent_norm(x, h) * self.tangent_norm(end, -h)

    def tangent_norm(self, x: Floats, h: float) -> float:
        moved = self._differences(x, h, directions(len(x)).T)
        return float(np.sqrt(len(x) * np.mean(np.sum(moved**2, axis=1))))

    def _condition(self, x: Floats, h: float) -> float:
        P = self._differences(x, h, np.eye(len(x)))
        if self.system.has_matrices:
            # The singular values of directions outside the algebra are zero.
            values = np.linalg.svd(P, compute_uv=False)[: self.system.algebra.dim]
            return float(np.linalg.norm(values) * np.linalg.norm(1.0 / values))
        return float(np.linalg.norm(P) * np.linalg.norm(np.linalg.inv(P)))

    def _differences(self, x: Floats, h: float, vectors: Floats) -> Floats:
        """Return tangent vectors (k, n) after a step by central differences; in the units of the norm, as `vectors`."""
        small = 2.0**-17 * (float(np.max(np.abs(self.norm.scaled(x)))) or 1.0)
        moves = self.norm.unscaled(small * vectors)
        return self.norm.scaled(self.step(x + moves, h) - self.step(x - moves, h)) / (2 * small)

    def tangents(self, h: float) -> StepTangents | None:
        if h not in self._tangents:
            self._tangents[h] = compiled_tangents(self.method, self.system, h)
        return self._tangents[h]

    def step(self, x: Floats, h: float, t: float = 0.0) -> Floats:
        return np.asarray(self.run(x, h, 1, t=t).x[-1])

    def run(
        self,
        x: Any,
        h: float,
        count: int,
        save_every: int | None = None,
        attitude: Any = False,
        watch: bool = False,
        t: float = 0.0,
    ) -> Solution:
        note_progress("a run of one step" if count == 1 else f"a run of {count} steps")
        key = (abs(h), attitude if is_attitude_kind(attitude) else "given", watch)
        if key not in self._prepared:
            self._prepared[key] = PreparedRun(
                self.system, self.method, abs(h), attitude=attitude, watch=watch, threads=1
            )
        prepared = self._prepared[key]
        times, _ = prepared.times_of((t, t + count * h), count if save_every is None else save_every)
        # States beside the given ones differ in every coordinate.
        momenta, single = any_momenta_of(self.system, x)
        start = with_group(self.system, momenta, single, prepared.representation, prepared.initial_attitude)
        return prepared.follow(times, start)


def directions(size: int, number: int = 0) -> Floats:
    """Return `DIRECTIONS` unit vectors in columns, the same in every run; `number` selects an independent set."""
    vectors = np.random.default_rng([SEED, number]).standard_normal((size, DIRECTIONS))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=0))
