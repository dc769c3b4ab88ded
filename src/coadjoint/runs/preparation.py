"""What runs of one system, scheme and step have in common: arguments that are read once, loops and plans."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.loop import concurrent_members, matrix_rows
from coadjoint.memory import UNCHECKED_BYTES
from coadjoint.methods.forced import check_steps, effective_scheme
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.methods.registry import default_scheme, read_method
from coadjoint.rounding import in_standard_mode
from coadjoint.runs.crossings import WatchedEvents
from coadjoint.runs.events import Event
from coadjoint.runs.inputs import Inputs
from coadjoint.runs.loops.loops import Loops, loops_of_batch, loops_of_system
from coadjoint.runs.partial_steps import noises_of
from coadjoint.runs.plan_and_state import Plan, State, bytes_of_run
from coadjoint.runs.results.quantities import Observed, check_observe, observed_quantities
from coadjoint.runs.run import Run
from coadjoint.runs.start import (
    Start,
    any_momenta_of,
    is_attitude_kind,
    momenta_of,
    read_attitude,
    representations_of,
    start_without_groups,
    vector_size,
    vectors_of,
    with_group,
)
from coadjoint.runs.times import (
    OutputTimes,
    Times,
    is_same_span,
    is_unchangeable,
    output_times_of,
    read_step,
    span_of,
    times_between,
)
from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch, selected
from coadjoint.systems.coordinates import states_by_label
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_system
from coadjoint.validation import Immutable, read_bool, read_integer

ONE_VECTOR = 1, 0, 0  # shape of the group elements of a run of one vector without any
MAX_THREADS_INSIDE = 1024  # most threads that share one member


class _Cache:
    """Loops by their steps, and what the last calls have compiled; copies of a prepared run begin with an empty one."""

    # A call removes an entry of `ends` while it runs, so that concurrent calls never share one.

    def __init__(self, step: float, loops: dict[float, Loops] | None = None) -> None:
        self.lock = threading.RLock()
        self.loops: dict[float, Loops] = {} if loops is None else loops
        self._step = step
        self._last_times: tuple[tuple[float, float], int, Times] | None = None
        self.plan: Plan | None = None
        self.ends: list[Any] = []
        self.observed: Observed | None = None
        self.events: WatchedEvents | None = None
        self.derivatives: Any = None
        self.of_members: dict[int, Any] = {}
        self.in_columns: list[tuple[NDArray[np.int64], Any]] | None = None
        self.checks_step = False  # whether the next run warns of a step that is too large

    def times_of(self, t_span: Any, save_every: Any) -> Times:
        """Validate span and `save_every`; the times of an unchanged pair are the same object."""
        last = self._last_times  # read and replaced at once, so that threads may share it
        if (
            last is not None
            and (t_span is last[0] or is_same_span(t_span, last[0]))
            and (save_every is last[1] or (type(save_every) is int and save_every == last[1]))
        ):
            return last[2]
        times = times_between(span_of(t_span), self._step, save_every)
        if is_unchangeable(t_span) and type(save_every) is int:
            self._last_times = t_span, save_every, times
        return times


class Preparation(Immutable):
    """A system, a scheme and a step with everything that does not depend on the initial state; immutable."""

    @in_standard_mode
    def __init__(
        self,
        system: System | Batch,
        method: Method | str | Mapping[str, Any] | None,
        step: float,
        *,
        attitude: Any = False,
        watch: bool = True,
        observe: Mapping[str, Any] | None = None,
        threads: int | None = None,
        inputs: Any = None,
    ) -> None:
        check_system(system)
        scheme = default_scheme(system) if method is None else read_method(method)
        watching = read_bool(watch, "watch")
        workers = None if threads is None else read_integer(threads, "threads (None is all cores)", floats=True)
        self.inputs = None if inputs is None or inputs is False else Inputs(system, inputs)
        self.given_method = scheme  # whose parts may depend on the system
        if self.inputs is not None:
            scheme = self.inputs.settled(scheme)
        self.system: Any = system
        self.method, self.step = scheme, read_step(step)
        self.scheme = effective_scheme(system, scheme)
        # Loops do not track invariants of matrices.
        self._watching = watching and not system.has_matrices
        self._representations = representations_of(cast(Any, system), self.scheme, attitude)
        self.initial_attitude = read_attitude(attitude, self.system)
        self.observe = check_observe({} if observe is None else observe, self.system)
        self._threads = workers or concurrent_members(matrix_rows(system))
        self.cache = _Cache(self.step)
        self._vector_size = vector_size(self.system)
        one_vector = self.inputs is None and not self.observe and self._representations[0] is None
        self._plain_shape = (self._vector_size,) if one_vector and self._vector_size is not None else None

    def __repr__(self) -> str:
        return f"<prepared run of {self.system!r} by {self.method}, step {self.step:g}>"

    def __getstate__(self) -> dict[str, Any]:
        """Return everything prepared; loops that contain another loop are rebuilt in the receiving process."""
        loops = {h: loops for h, loops in self.cache.loops.items() if loops.is_picklable}
        fields = {name: value for name, value in vars(self).items() if name != "cache"}
        return {**fields, "loops": loops}

    def __setstate__(self, state: dict[str, Any]) -> None:
        loops = state.pop("loops")
        self.__dict__.update(state, cache=_Cache(state["step"], loops))

    def among(self, first: int, last: int, threads: int | None = None) -> Self:
        """Return the run of the members `first` to `last` - 1 alone, with the bits and the noise of the whole run."""
        return self._selected(self.system.among(first, last), np.arange(first, last), threads)

    def sampled(self, members: NDArray[np.int64]) -> Self:
        """Return the run of these members of a batch, from the tables already built; their noise differs."""
        return self._selected(selected(cast(Batch, self.system), members), members)

    def _selected(self, part: Any, members: NDArray[np.int64], threads: int | None = None) -> Self:
        system, loops = self.system, self.cache.loops
        # Tables hold the number of the noise, which a member keeps.
        unchanged = part is system
        fields: dict[str, Any] = {"system": part, "_threads": threads or self._threads}
        if system.is_batch:
            unchanged = {id(one) for one in part.distinct} <= {id(one) for one in system.distinct}
            fields["_representations"] = tuple(self._representations[m] for m in members.tolist())
            loops = {h: loop.selected(members) for h, loop in loops.items()} if unchanged else {}
        if np.ndim(self.initial_attitude) > 2:
            fields["initial_attitude"] = self.initial_attitude[members]
        return self._copy(loops if unchanged else {}, **fields)

    def _copy(self, loops: dict[float, Loops], **fields: Any) -> Self:
        copied = object.__new__(type(self))
        copied.__dict__.update(vars(self), **fields, cache=_Cache(self.step, loops))
        return copied

    def threads_for(self, members: int) -> tuple[int, int]:
        """Return the threads of a run of so many members, and those that share a member."""
        workers = min(members, self._threads)
        return workers, min(self._threads // workers, MAX_THREADS_INSIDE)

    def in_one_thread(self) -> Self:
        """Return a copy that uses one thread, and whose further loops are its own."""
        return self._copy(dict(self.cache.loops), _threads=1)

    def at_fixed_steps(self, scheme: Method) -> Preparation:
        """Return the same run by another scheme; this run itself if it is its own."""
        if scheme is self.scheme:
            return self
        options: dict[str, Any] = {"attitude": self.initial_attitude, "watch": False, "threads": 1}
        return Preparation(self.system, scheme, self.step, **options)

    def times_of(self, t_span: Any, save_every: Any = 1, t_eval: Any = None) -> tuple[Times, OutputTimes | None]:
        """Validate span, `save_every` and `t_eval`; return the steps of a run, and the output times or None."""
        times = self.cache.times_of(t_span, save_every)
        check_steps(self.system, times.t0, times.h)
        if t_eval is None:
            return times, None
        moments = output_times_of(t_eval, times, save_every, whole_steps=bool(noises_of(self.system)))
        if self.method.own_steps:
            # Saved points do not alter adaptive steps; save as often as states are wanted, so that partial steps are
            # short.
            times = times.refined_times(len(moments.t))
            moments = output_times_of(t_eval, times)
        return times, moments

    @property
    def representation(self) -> Representation:
        """Matrices of the group element, (n, d, d), "coadjoint", or None; for a batch those of its first member."""
        return self._representations[0]

    def check_differentiable(self) -> None:
        """Raise TypeError if runs have no derivatives."""

    @property
    def takes_inputs(self) -> bool:
        """Whether runs take inputs."""
        return self.inputs is not None

    def values_of(self, inputs: Mapping[str, Any], x0: Any = None) -> NDArray[np.float64] | None:
        """Validate the inputs of a run and return their values, (m,) or (members, m); None if none were prepared."""
        if self.inputs is not None:
            values = self.inputs.read(inputs)
            if values.ndim > 1 and np.ndim(x0) == 1:
                self.inputs.check_not_square(inputs)
            return values
        if inputs:
            raise TypeError(
                f"the run was given {next(iter(inputs))!r}, and it was prepared without inputs; give `prepare` the "
                "coefficients or torques that may change, such as inputs=True"
            )
        return None

    def system_at(self, values: NDArray[np.float64] | None) -> Any:
        """Return the system of a run with the values from `values_of`."""
        return self.system if values is None or self.inputs is None else self.inputs.system_of(values)

    def start(
        self, x0: Any, attitude: Any = None, values: NDArray[np.float64] | None = None, *, begins: bool = True
    ) -> Start:
        """Validate x0, any state unless it `begins` a motion, and attitude; return a start for `follow`."""
        representation = self._representations[0]
        if attitude is not None and (representation is None or is_attitude_kind(attitude)):
            raise ValueError(
                "attitude of a run is an initial group element, an array; the representation must be given "
                f"to `prepare`, as attitude=True or 'coadjoint' (here {short(self.initial_attitude)})"
            )
        read = momenta_of if begins else any_momenta_of
        if self._vector_size is None:
            momenta, single = read(self.system, x0)
        else:
            momenta, single = vectors_of(states_by_label(self.system, x0, "x0"), self.system)
        if values is not None and values.ndim > 1:
            if single:
                momenta, single = np.tile(momenta, (len(values), 1)), False
            elif len(momenta) != len(values):
                raise ValueError(f"x0 has {len(momenta)} members and the inputs have values for {len(values)}")
        if representation is None:
            return start_without_groups(self.system, momenta, single)
        initial = self.initial_attitude if attitude is None else attitude
        return with_group(self.system, momenta, single, representation, initial)

    def begun(
        self, times: Times, start: Start, values: NDArray[np.float64] | None = None, state: State | None = None
    ) -> Run:
        """Return the run of `follow` before its first step, or resumed at a state."""
        return Run(self._plan_of(times, start, values), start, state)

    def _plan_of(self, times: Times, start: Start, values: NDArray[np.float64] | None) -> Plan:
        """Return the plan of a run; the last one is cached."""
        plan, groups = self.cache.plan, start.groups.shape
        if plan is None or plan.groups != groups:
            plan = self._new_plan(times, groups)
        elif plan.times is not times:
            shifted = plan.at_times(times)
            if shifted is None:
                plan = self._new_plan(times, groups)
            else:
                plan = self.cache.plan = shifted
        if self.inputs is None:
            return plan
        assert values is not None
        loops = self.loops(times.h).with_values(values)
        return plan.with_loops(loops, partial(self.system_at, values))

    def _new_plan(self, times: Times, groups: tuple[int, ...]) -> Plan:
        threads = self.threads_for(groups[0])
        plan = Plan(self.system, self.method, self.loops(times.h), times, groups, self._watching, *threads)
        # The free memory is checked again for each large run.
        if bytes_of_run(plan.layout, times) <= UNCHECKED_BYTES:
            self.cache.plan = plan
        return plan

    def _watched(self, events: tuple[Event, ...], x0: NDArray[np.float64], t0: float) -> WatchedEvents:
        """Return the compiled events; those of the last run are cached."""
        with self.cache.lock:
            if self.cache.events is None or self.cache.events.events != events:
                self.cache.events = WatchedEvents(self.system, events, x0, t0)
            return self.cache.events

    def loops(self, h: float) -> Loops:
        """Return the loops of a step or of its negative, built lazily for each direction."""
        loops = self.cache.loops.get(h)
        if loops is None:
            with self.cache.lock:
                loops = self.cache.loops.get(h) or self._loops(h)
                self.cache.loops[h] = loops
        return loops

    def _loops(self, h: float) -> Loops:
        if self.inputs is not None:
            return self.inputs.loops(self.scheme, h, self._representations[0])
        for known in self.cache.loops.values():
            if (loops := known.at_step(h)) is not None:
                return loops
        if self.system.is_batch:
            return loops_of_batch(self.system, self.scheme, h, self._representations)
        return loops_of_system(self.system, self.scheme, h, self._representations[0], compact=True)

    def observed(self, start: Start) -> Observed | None:
        """Return the quantities to observe during a run, or None."""
        if not self.observe:
            return None
        with self.cache.lock:
            if self.cache.observed is None:
                self.cache.observed = observed_quantities(self.system.of_member(0), self.observe, start.momenta[0])
        return self.cache.observed


def trial_run(
    prepared: Preparation, times: Times, momenta: NDArray[np.float64], advance: Callable[[Run], None] = Run.advance
) -> Run:
    """Run from momenta (members, n) without group elements; failures are in `status` of its state."""
    run = prepared.begun(times, start_without_groups(prepared.system, momenta))
    advance(run)
    return run
