"""Runs prepared for an accuracy: one choice for a sample of states, checked in each run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from operator import mul, sub
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.choosing.accuracy import Choice, choose, chosen
from coadjoint.choosing.candidates import sample_of
from coadjoint.errors import IntegrationError
from coadjoint.methods.protocol.method import Method
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.memory_solution import most_evaluations
from coadjoint.runs.results.solution import Solution, with_choice
from coadjoint.runs.short_runs import ENDS_ONLY
from coadjoint.runs.start import momenta_of, read_attitude
from coadjoint.runs.times import accumulated_rounding, span_of
from coadjoint.short_repr import distinct
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.systems.system_checks import check_system

# Allowed ratio of the error of the first step to the worst one of the sample; for variable steps, of the number of
# evaluations to the largest one of the sample.
ALLOWED_RATIO = 2.0
# Number of steps checked along the motion of each state of the sample.
CHECKED_STEPS = 64
# Difference between a step and two half steps by rounding alone.
ROUNDING_DIFFERENCE = 32 * UNIT_ROUNDOFF
# Range of squared norms in which they are compared.
MIN_SQUARE, MAX_SQUARE = 2.0**-900, 2.0**900


class SampledRun(PreparedRun):
    """A prepared run whose scheme and step serve a sample of states; see `prepare` with ``accuracy=``.

    It is immutable, and each run is independent of earlier ones. A run is checked by its first step: its difference
    from two half steps, relative to the state, may be at most twice the largest one along the motions of the sample.
    Schemes with variable steps control the error of each step, and these errors add up: such a run may take up to twice
    as many evaluations as those of the sample. For a run that fails the check a choice of its own is made, as in
    `integrate`.

    Attributes
    ----------
    choice : Choice
        The choice for the sample.
    signed_step : float
        The step, negative if prepared backward.
    """

    def __init__(
        self,
        system: Any,
        sample: Any,
        t_span: Any,
        accuracy: float,
        method: Method | None,
        attitude: Any,
        watch: bool,
        observe: Mapping[str, Any] | None,
        threads: int | None,
    ) -> None:
        check_system(system)
        t0, t1 = span_of(t_span)
        if t0 == t1:
            raise ValueError(f"t_span is {[t0, t1]}; a prepared run needs a time longer than 0")
        momenta, _ = momenta_of(system, sample)
        # Runs of a batch have all its members.
        states = momenta if system.is_batch else sample_of(system, momenta, t0, t1 - t0)[1]
        attitude = read_attitude(attitude, system)
        # Runs may have another number of members than the sample, so stacked initial group elements are not passed on.
        self._attitude_option = True if np.ndim(attitude) == 3 else attitude
        self.choice: Choice = chosen(
            system, states, (t0, t1), accuracy, self._attitude_option, method, share=1.0 / ALLOWED_RATIO
        )
        step = self.choice.step
        super().__init__(
            system, self.choice.method, step, attitude=attitude, watch=watch, observe=observe, threads=threads
        )
        self._options = {"attitude": self.initial_attitude, "watch": watch, "observe": observe, "threads": threads}
        self._methods, self._time, self.signed_step = method, t1 - t0, math.copysign(step, t1 - t0)
        self._full_step_run = PreparedRun(system, self.choice.method, step, watch=False, threads=1)
        self._half_step_run = PreparedRun(system, self.choice.method, 0.5 * step, watch=False, threads=1)
        self._time_dependent = any(one.hamiltonian.timed for one in system.distinct)
        self._one_step_span = 0.0, self.signed_step
        self._last_span: tuple[Any, float] = None, t0
        self._variable_steps, self._allowed = self.choice.method.own_steps, math.inf
        self._weights: NDArray[np.float64] | None = None
        if self._variable_steps:
            self.most_evaluations = ALLOWED_RATIO * self._evaluations(states, t0)
        else:
            self._allowed = max(ROUNDING_DIFFERENCE, ALLOWED_RATIO * self._worst_along(states, t0))

    def __repr__(self) -> str:
        return f"<run of {self.system!r} prepared for the accuracy {self.choice.accuracy:g}: {self.method}>"

    def run(
        self,
        x0: Any,
        t_span: tuple[float, float],
        save_every: int = 1,
        *,
        t_eval: Any = None,
        attitude: Any = None,
        progress: bool = False,
        events: Any = (),
        **inputs: Any,
    ) -> Solution:
        """Integrate from an initial state to the prepared accuracy; see `PreparedRun.run`.

        Parameters
        ----------
        x0, save_every, t_eval, attitude, progress, events
            As in `PreparedRun.run`; for a run with a choice of its own `save_every` counts the steps of that choice.
        t_span : (float, float)
            Start and end, in the direction and at most the length prepared; a whole number of steps.
        **inputs : array_like
            Not supported.

        Returns
        -------
        Solution
            Its `choice` is the choice used.

        Raises
        ------
        ValueError, TypeError
            For wrong input, before the first step; for an accuracy that is not reached from x0.
        IntegrationError
            As in `integrate`.
        """
        t0 = self._start_of(t_span)
        options: dict[str, Any] = {"t_eval": t_eval, "attitude": attitude, "progress": progress, "events": events}
        options |= inputs
        if self._variable_steps or self.serves(x0, t0):
            solution = super().run(x0, t_span, save_every, **options)
            if most_evaluations(solution) <= self.most_evaluations:
                return with_choice(solution, self.choice)
        own_run, choice = self._run_with_own_choice(x0, t_span)
        return with_choice(own_run.run(x0, t_span, save_every, **options), choice)

    def end(self, x0: Any, t_span: tuple[float, float], **inputs: Any) -> NDArray[np.float64]:
        """Return only the state at the end, as `PreparedRun.end`; times as in `run`. The check takes 5 us."""
        t0 = self._start_of(t_span)
        if self._variable_steps or self.serves(x0, t0):
            return super().end(x0, t_span, **inputs)
        return self._run_with_own_choice(x0, t_span)[0].run(x0, t_span, ENDS_ONLY, **inputs).x[-1]

    def check_differentiable(self) -> None:
        """Raise TypeError: the step may change."""
        raise TypeError(
            f"runs prepared with accuracy have no derivatives, since their step may change: prepare with {self.method} "
            f"and step={self.step:g}"
        )

    def serves(self, x0: Any, t0: float = 0.0) -> bool:
        """Return whether the choice for the sample serves a run from a state, or from all of several.

        Parameters
        ----------
        x0 : array_like, shape (n,) or (members, n)
            Initial momentum.
        t0 : float
            Initial time.

        Returns
        -------
        bool
        """
        if self._variable_steps:
            return self._evaluations(x0, t0) <= self.most_evaluations
        span = (t0, t0 + self.signed_step) if self._time_dependent else self._one_step_span
        try:
            full, halved = self._full_step_run.end(x0, span), self._half_step_run.end(x0, span)
        except IntegrationError:
            return False
        if full.ndim > 1:
            distance, size = self._squared_distance_and_size(full, halved)
            in_range = (size > MIN_SQUARE) & (size < MAX_SQUARE)
            similar, at_zero = in_range & (distance <= self._allowed**2 * size), ~np.any([full, halved], axis=(0, 2))
            return bool(np.all(similar | at_zero))
        if self._weights is not None:
            full, halved = self._weights * full, self._weights * halved
        full_values, halved_values = full.tolist(), halved.tolist()
        size = sum(map(mul, full_values, full_values))
        if MIN_SQUARE < size < MAX_SQUARE:
            difference = list(map(sub, full_values, halved_values))
            return bool(sum(map(mul, difference, difference)) <= self._allowed**2 * size)
        # A zero state passes; if squares overflow or underflow, a choice of its own is made.
        return not (any(full_values) or any(halved_values))

    def _evaluations(self, x0: Any, t0: float) -> float:
        """Return the largest number of evaluations among runs from states over the prepared time."""
        return most_evaluations(self._full_step_run.run(x0, (t0, t0 + self._time), ENDS_ONLY))

    def _worst_along(self, sample: NDArray[np.float64], t0: float) -> float:
        """Return the largest difference along the motions from a sample, relative to the state."""
        steps = max(1, round(self._time / self.signed_step))
        solution = self._full_step_run.run(sample, (t0, t0 + self._time), max(1, steps // CHECKED_STEPS))
        groups = CoordinateGroups(self.system)
        if groups.count > 1:
            # Groups of coordinates count alike, in units of the sample.
            sizes = groups.sizes(solution.x.reshape(len(solution.t), -1, self.system.dim)).max(axis=0)
            self._weights = (1.0 / np.where(sizes > 0.0, sizes, 1.0))[groups.labels]
        if self._time_dependent or self.system.is_batch:
            starts = zip(solution.x, solution.t.tolist(), strict=True)
            pairs = [(x, (t, t + self.signed_step)) for x, t in starts]
        else:
            pairs = [(solution.x.reshape(-1, solution.x.shape[-1]), self._one_step_span)]
        worst = 0.0
        for states, span in pairs:
            distance, size = self._squared_distance_and_size(
                self._full_step_run.end(states, span), self._half_step_run.end(states, span)
            )
            # Avoids division by zero for states at rest, which stay there.
            worst = max(worst, float(np.max(distance / np.where(size > 0.0, size, 1.0))))
        return math.sqrt(worst)

    def _squared_distance_and_size(
        self, first: NDArray[np.float64], second: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the squared norms of the differences of states (members, n), and of the first ones."""
        weights = 1.0 if self._weights is None else self._weights
        with np.errstate(over="ignore"):
            return np.sum((weights * (first - second)) ** 2, axis=-1), np.sum((weights * first) ** 2, axis=-1)

    def _start_of(self, t_span: Any) -> float:
        """Return the initial time; raise ValueError outside the direction and time prepared."""
        if t_span is self._last_span[0]:
            return self._last_span[1]
        t0, t1 = span_of(t_span)
        rounding = accumulated_rounding((t1 - t0) / self.signed_step, t0, t1, self.step)
        if not 0.0 <= (t1 - t0) / self._time <= 1.0 + rounding / abs(self._time):
            longest = distinct(self._time, t1 - t0)[0]
            raise ValueError(
                f"t_span is {[t0, t1]}; the run was prepared for at most the time {longest}, in its direction; "
                "prepare another run"
            )
        if type(t_span) is tuple and all(type(end) in (float, int) for end in t_span):
            self._last_span = t_span, t0
        return t0

    def _run_with_own_choice(self, x0: Any, t_span: tuple[float, float]) -> tuple[PreparedRun, Choice]:
        """Return a run, with a choice of its own, for a state that the sample does not represent."""
        options: Any = {"attitude": self._attitude_option, "methods": self._methods}
        choice = choose(self.system, x0, t_span, self.choice.accuracy, **options)
        return PreparedRun(self.system, choice.method, choice.step, **cast(Any, self._options)), choice
