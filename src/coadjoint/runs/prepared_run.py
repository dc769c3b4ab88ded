"""Prepared runs: arguments that are read once, compiled loops and plans, for many calls."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.loop import concurrent_members, cores, matrix_rows
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import read_progress
from coadjoint.memory import UNCHECKED_BYTES
from coadjoint.methods.forced import check_steps, effective_scheme
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.methods.registry import default_scheme, read_method
from coadjoint.rounding import in_standard_mode
from coadjoint.runs.events import Event, read_events
from coadjoint.runs.loops.loops import Loops, loops_of_batch, loops_of_system
from coadjoint.runs.plan_and_state import Plan, State, bytes_of_run
from coadjoint.runs.results.quantities import Observed, check_observe, observed_quantities
from coadjoint.runs.results.solution import Solution, set_elapsed
from coadjoint.runs.run import Run, in_pieces
from coadjoint.runs.short_runs import ENDS_ONLY, FinalStateRun, solution_of_short_run
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
from coadjoint.validation import FLOAT64, Immutable, read_bool, read_integer

if TYPE_CHECKING:
    from coadjoint.runs.crossings import WatchedEvents
    from coadjoint.runs.derivatives.backward import Pullback
    from coadjoint.runs.derivatives.forward import Tangents

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
        self.in_columns: dict[frozenset[str], list[tuple[NDArray[np.int64], Any]]] = {}
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


class PreparedRun(Immutable):
    """A system, a scheme and a step with everything that does not depend on the initial state; see `prepare`.

    It is immutable: its attributes cannot be set. Several threads may run it concurrently, since each run has its own
    arrays.

    Attributes
    ----------
    system, method, step, observe
        The arguments of `prepare`. With inputs, the parts that the method chose for the system are fixed.
    """

    most_evaluations: float = math.inf
    """Runs with more evaluations are passed from `end` to `run`."""

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
        self.given_method = scheme  # whose parts may depend on the system
        if inputs is None or inputs is False:
            self.inputs: Any = None
        else:
            from coadjoint.runs.inputs import inputs_of

            self.inputs = inputs_of(system, inputs)
            scheme = self.inputs.settled(scheme)
        self.system: Any = system
        self.method, self.step = scheme, read_step(step)
        self.scheme = effective_scheme(system, scheme)
        self._watching = watching and not system.has_matrices  # whose invariants loops do not track
        self._representations = representations_of(cast(Any, system), self.scheme, attitude)
        self.initial_attitude = read_attitude(attitude, self.system)
        self.observe = check_observe({} if observe is None else observe, self.system)
        self._threads = workers  # None: all cores
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
        if self.inputs is not None and part is not system:
            fields["inputs"] = self.inputs.of(part)
        return self._copy(loops if unchanged else {}, **fields)

    def _copy(self, loops: dict[float, Loops], **fields: Any) -> Self:
        copied = object.__new__(type(self))
        copied.__dict__.update(vars(self), **fields, cache=_Cache(self.step, loops))
        return copied

    def threads_for(self, members: int) -> tuple[int, int]:
        """Return the threads of a run of so many members, and those that share a member."""
        workers = min(members, self._threads or concurrent_members(matrix_rows(self.system)))
        return workers, min((self._threads or cores()) // workers, MAX_THREADS_INSIDE)

    def in_one_thread(self) -> Self:
        """Return a copy that uses one thread, and whose further loops are its own."""
        return self._copy(dict(self.cache.loops), _threads=1)

    def at_fixed_steps(self, scheme: Method) -> PreparedRun:
        """Return the same run by another scheme; this run itself if it is its own."""
        if scheme is self.scheme:
            return self
        return PreparedRun(self.system, scheme, self.step, attitude=self.initial_attitude, watch=False, threads=1)

    def times_of(self, t_span: Any, save_every: Any = 1, t_eval: Any = None) -> tuple[Times, OutputTimes | None]:
        """Validate span, `save_every` and `t_eval`; return the steps of a run, and the output times or None."""
        times = self.cache.times_of(t_span, save_every)
        check_steps(self.system, self.scheme, times.t0, times.h, times.steps)
        if t_eval is None:
            return times, None
        noisy = any(force.random for force in self.system.forces)
        moments = output_times_of(t_eval, times, save_every, whole_steps=noisy)
        if self.method.own_steps:
            # Saved points do not alter adaptive steps; many of them keep partial steps short.
            times = times.refined_times(len(moments.t))
            moments = output_times_of(t_eval, times)
        return times, moments

    @property
    def representation(self) -> Representation:
        """Matrices of the group element, (n, d, d), "coadjoint", or None; for a batch those of its first member."""
        return self._representations[0]

    def values_of(self, inputs: Mapping[str, Any], x0: Any = None) -> NDArray[np.float64] | None:
        """Validate the inputs of a run and return their values, (m,) or (members, m); None if none were prepared."""
        if self.inputs is not None:
            values = self.inputs.read(inputs)
            if values.ndim > 1 and np.ndim(x0) == 1 and not self.system.is_batch:
                self.inputs.check_not_square(inputs)
            return values
        if inputs:
            raise TypeError(
                f"the run was given {next(iter(inputs))!r}, and it was prepared without inputs; give `prepare` the "
                "coefficients or torques that may change, such as inputs=True"
            )
        return None

    def system_at(self, values: NDArray[np.float64] | None) -> Any:
        return self.system if values is None else self.inputs.system_of(values)

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

    def watched(self, events: tuple[Event, ...], x0: NDArray[np.float64], t0: float) -> WatchedEvents:
        """Return the compiled events; those of the last run are cached."""
        with self.cache.lock:
            if self.cache.events is None or self.cache.events.events != events:
                from coadjoint.runs.crossings import WatchedEvents

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
        representations: Any = self._representations if self.system.is_batch else self._representations[0]
        if self.inputs is not None:
            return self.inputs.loops(self.scheme, h, representations)
        for known in self.cache.loops.values():
            if (loops := known.at_step(h)) is not None:
                return loops
        build: Any = loops_of_batch if self.system.is_batch else partial(loops_of_system, compact=True)
        return cast(Loops, build(self.system, self.scheme, h, representations))

    def observed(self, start: Start) -> Observed | None:
        """Return the quantities to observe during a run, or None."""
        if not self.observe:
            return None
        with self.cache.lock:
            if self.cache.observed is None:
                self.cache.observed = observed_quantities(self.system.of_member(0), self.observe, start.momenta[0])
        return self.cache.observed

    @suggest_keywords
    def run(
        self,
        x0: Any,
        t_span: tuple[float, float],
        save_every: int = 1,
        *,
        t_eval: Any = None,
        attitude: Any = None,
        progress: bool = False,
        events: Any = None,
        **inputs: Any,
    ) -> Solution:
        """Integrate from an initial state; bitwise equal to `integrate`.

        Parameters
        ----------
        x0 : array_like, shape (n,) or (members, n)
            Initial momentum, as in `integrate`.
        t_span : (float, float)
            Start and end, a whole number of steps apart; the run goes backward if the end is the smaller one.
        save_every : int
            Save every k-th step, and always the start and the end.
        t_eval : array_like, shape (k,), optional
            Save the states at these times instead, as in `integrate`.
        attitude : array_like, shape (d, d) or (members, d, d), optional
            Initial group element of this run, instead of the prepared one; also a rotation, as in `integrate`.
        progress : bool
            Show a progress bar.
        events : Event or sequence of Event, optional
            Events to locate, as in `integrate`.
        **inputs : array_like
            Inputs of this run, by their prepared names: coefficients of the linear term of H, in the shape of their
            coordinates, or torques, (n,); optionally with a leading axis of members. Inputs that are not given default
            to the values of the system, in a batch of each member.

        Returns
        -------
        Solution
            Its `system` has the linear term and the torques of this run, and its `method` the prepared parts.

        Raises
        ------
        ValueError, TypeError
            For wrong input, before the first step.
        IntegrationError
            As in `integrate`.
        """
        began = time.perf_counter()
        if (
            type(x0) is np.ndarray
            and x0.dtype is FLOAT64
            and x0.shape == self._plain_shape
            and not (t_eval is not None or attitude is not None or progress is not False or events is not None)
            and not inputs
        ):
            # The short way of the most frequent case, once the plan is cached.
            cache = self.cache
            plan, times = cache.plan, cache.times_of(t_span, save_every)
            if plan is not None and plan.is_short and plan.groups == ONE_VECTOR:
                if plan.times is not times:
                    check_steps(self.system, self.scheme, times.t0, times.h, times.steps)
                    plan = cache.plan = plan.at_times(times) or plan
                solution = solution_of_short_run(plan, x0.copy(), began) if plan.times is times else None
                if solution is not None:
                    self.check_first_step(solution)
                    return solution
        progress = progress is not False and read_progress(progress)
        times, moments = self.times_of(t_span, save_every, t_eval)
        values = self.values_of(inputs, x0)
        event_list = () if events is None else read_events(events)
        solution = self.follow(times, self.start(x0, attitude, values), progress, values, event_list, moments)
        set_elapsed(solution, time.perf_counter() - began)
        self.check_first_step(solution)
        return solution

    def check_first_step(self, solution: Solution) -> None:
        """Warn if the step is too large for the first run; loops of half a step are those of a copy, and not kept."""
        if self.cache.checks_step:
            self.cache.checks_step = False
            from coadjoint.runs.error_estimates import warn_of_large_step

            warn_of_large_step(solution, self.in_one_thread())

    @property
    def parameters(self) -> Mapping[str, NDArray[np.float64]]:
        """Parameters of the system by which runs can be differentiated; see `jvp` and `vjp`.

        Those of a ready-made system are its arguments that enter coefficients of the Hamiltonian, such as ``inertia``,
        ``lever`` or ``exchange``; of other systems ``M`` and ``linear`` of a `Quadratic`, or the ``coefficients`` of a
        `Polynomial`, in the order of its monomials. Those of forces follow, such as ``LinearDamping.rate``. Those of a
        batch have a first axis of members. ``M`` has the shape (n,) if it is diagonal, and (n, n) otherwise, above 128
        coordinates that of its nonzero entries.

        Examples
        --------
        >>> import coadjoint as co
        >>> co.prepare(co.systems.heavy_top(), co.Splitting(), step=0.1).parameters
        {'inertia': array([...]), 'lever': array([...])}
        """
        from coadjoint.systems.parameters import parameters_of_members

        return {name: parameter.value.copy() for name, parameter in parameters_of_members(self.system).items()}

    @suggest_keywords
    def jvp(
        self,
        x0: Any,
        t_span: tuple[float, float],
        directions: Mapping[str, Any],
        save_every: int = 1,
        *,
        t_eval: Any = None,
        attitude: Any = None,
        events: Any = None,
        fixed: str = "momentum",
        **inputs: Any,
    ) -> tuple[Solution, Tangents]:
        """Integrate, with the derivatives of the run along directions (forward mode), by parameters at fixed x0.

        Use it for few directions, for instance for the Jacobian of a fit with few parameters; for the gradient of one
        number by many parameters use `vjp`. The derivatives are those of the computed steps, exact to round-off.

        Parameters
        ----------
        x0, t_span, save_every, t_eval, attitude, events
            As in `run`.
        directions : mapping
            Directions by name: of the initial state ("x0"), of the initial attitude ("attitude0"), or of a name in
            `parameters`; and "inputs", a mapping from names of inputs to their directions. Each has the shape of what
            it changes, or all of them have one more axis of k directions.
        fixed : {"momentum", "velocity"}
            What a change of parameters such as masses leaves as it is in the initial state of bodies: its momenta, that
            is x0, or the velocities, as of ``system.state(velocities)``. Then ``tangents.x[0]`` is the derivative of
            that state.
        **inputs : array_like
            Inputs of this run, as in `run`.

        Returns
        -------
        sol : Solution
            The run, with the same bits as without derivatives.
        tangents : Tangents
            Derivatives of ``sol.x``, ``sol.attitude`` and ``sol.energy``.

        Raises
        ------
        ValueError
            For directions of other names or shapes.
        TypeError
            For a system or a scheme whose runs are not differentiable, by name.
        IntegrationError
            As in `integrate`, and for derivatives that overflow.

        Notes
        -----
        The derivative by a parameter is that of the computed map, `tangents.rule` "exact", if the parts of the
        splitting are functions of coordinates. If the forms of the parts depend on the parameter, the change of the
        energy is one more part of the splitting of size zero, "added part": the derivative of a scheme of the same
        order, which agrees with that of the motion to this order. Runge-Kutta methods are always "exact". The steps of
        others are differentiated in Python, one by one: by the state through `Method.tangent`, by parameters through
        their stages ("exact"; `SphericalMidpoint`, `CommutatorFree` without attitudes), or else by central differences
        of order 8, with about twelve digits, "differences". So are flows of forces without formulas, by their
        parameters, with the noise of the run; these have names such as "Torque.arguments.gain". At a parameter where
        two orders of the parts are equally good, such as the moments (1, 2, 3, 4) of ``so_n_body``, the computed map
        has no derivative: "differences" mix those of both orders, which differ by the error of the scheme. Lengths of
        steps that a scheme chooses are fixed. Crossings of events are differentiated with their times,
        in `tangents.events`; the point at which an event ends a run moves with its crossing.

        Examples
        --------
        >>> import numpy as np
        >>> import coadjoint as co
        >>> body = co.prepare(co.systems.rigid_body(inertia=(1, 2, 2.5)), co.Splitting(order=4), step=0.05)
        >>> sol, tangents = body.jvp((1.0, 0.2, 0.5), (0, 10), {"inertia": np.eye(3)}, save_every=50)
        >>> sol.x.shape, tangents.x.shape, tangents.rule
        ((5, 3), (5, 3, 3), {'inertia': 'exact'})
        """
        given: dict[str, Any] = {"x0": x0, "t_span": t_span, "save_every": save_every, "t_eval": t_eval}
        given |= {"attitude": attitude, "events": read_events(events), "inputs": inputs, "fixed": fixed}
        from coadjoint.runs.derivatives.of_prepared_runs import jvp

        return jvp(self, directions, **given)

    @suggest_keywords
    def vjp(
        self,
        x0: Any,
        t_span: tuple[float, float],
        save_every: int = 1,
        *,
        t_eval: Any = None,
        attitude: Any = None,
        reverse: str = "exact",
        events: Any = None,
        fixed: str = "momentum",
        **inputs: Any,
    ) -> tuple[Solution, Pullback]:
        """Integrate, and return a function for gradients by x0 and, at fixed x0, all parameters (reverse mode).

        The steps are differentiated backward, from checkpoints between which they are repeated. A gradient costs a few
        times as much as the run, for any number of parameters, and little memory for any number of steps. The notes of
        `jvp` say what the derivative by a parameter is.

        Parameters
        ----------
        x0, t_span, save_every, t_eval, attitude, events
            As in `run`.
        reverse : str
            "exact": the steps are repeated from stored states, so that the derivatives are exact to round-off.
            "reversible": the steps are undone from the last state, in constant memory and less time. The states then
            differ by the round-off that has grown on the way back; for splittings and other schemes of exact flows.
        fixed : {"momentum", "velocity"}
            As in `jvp`: what a change of parameters leaves as it is in x0.
        **inputs : array_like
            Inputs of this run, as in `run`.

        Returns
        -------
        sol : Solution
            The run, with the same bits as without derivatives.
        pullback : Pullback
            A function ``pullback(x=None, *, attitude=None, energy=None, observed=None, events=None)``. Its arguments
            are the derivatives of a number by ``sol.x``, ``sol.attitude``, ``sol.energy``, quantities of
            ``sol.observed``, and ``{"t": ..., "x": ...}`` of ``sol.events``, in their shapes. It returns a `Gradient`:
            a mapping with the derivatives by "x0", by each of `parameters`, with an attitude "attitude0", and with
            inputs "inputs": a mapping from their names to derivatives.

        Raises
        ------
        ValueError
            For wrong input.
        TypeError
            For a system or a scheme whose runs are not differentiable, by name.
        IntegrationError
            As in `integrate`, and by the pullback for derivatives that overflow.

        Examples
        --------
        >>> import numpy as np
        >>> import coadjoint as co
        >>> body = co.prepare(co.systems.rigid_body(inertia=(1, 2, 2.5)), co.Splitting(order=4), step=0.05)
        >>> sol, pullback = body.vjp((1.0, 0.2, 0.5), (0, 10), save_every=200)
        >>> gradient = pullback(x=[[0, 0, 0], [0, 1, 0]])  # of the second component at the end
        >>> gradient["x0"].shape, gradient["inertia"].shape
        ((3,), (3,))
        """
        given: dict[str, Any] = {"x0": x0, "t_span": t_span, "save_every": save_every, "t_eval": t_eval}
        given |= {"attitude": attitude, "events": read_events(events), "inputs": inputs, "fixed": fixed}
        from coadjoint.runs.derivatives.of_prepared_runs import vjp

        return vjp(self, reverse, **given)

    @suggest_keywords
    def end(self, x0: Any, t_span: tuple[float, float], **inputs: Any) -> NDArray[np.float64]:
        """Return only the final state of a run, with less than half of the overhead of `run`.

        For shooting methods, maps and control loops of few steps: no solution object is created. The result is bitwise
        equal to ``run(x0, t_span, **inputs).x[-1]``, with the same errors. Ensembles, batches, matrices, and runs
        prepared with an attitude fall back to `run`.

        Parameters
        ----------
        x0 : array_like, shape (n,) or (members, n)
            Initial momentum, as in `run`; fastest for an array of float64.
        t_span : (float, float)
            Start and end, a whole number of steps apart; the run goes backward if the end is the smaller one. An
            unchanged tuple is not validated again.
        **inputs : array_like
            Inputs of this run, as in `run`.

        Returns
        -------
        ndarray
            Final state, in the shape of x0; (members, n) if inputs have values for members.

        Raises
        ------
        ValueError, TypeError
            For wrong input, before the first step.
        IntegrationError
            As in `integrate`.

        Examples
        --------
        >>> import coadjoint as co
        >>> prepared = co.prepare(co.systems.rigid_body(inertia=(1, 2, 3)), co.Splitting(order=4), step=0.05)
        >>> x, span = prepared.end((0.1, 1.0, 0.1), (0.0, 5.0)), (0.0, 0.1)
        >>> bool((x == prepared.run((0.1, 1.0, 0.1), (0.0, 5.0)).x[-1]).all())
        True
        >>> steered = co.prepare(co.systems.rigid_body((1, 2, 3)), None, step=0.05, inputs={"rotors": (0, 1, 2)})
        >>> for _ in range(1000):
        ...     x = steered.end(x, span, rotors=-0.1 * x)
        """
        ends = self.cache.ends
        try:
            final_run = ends.pop()
        except IndexError:
            final_run = FinalStateRun(self)
        state = final_run.end(x0, t_span, inputs)
        ends.append(final_run)
        return self.run(x0, t_span, ENDS_ONLY, **inputs).x[-1] if state is None else state

    def of_system(self, system: System, member: int | None = None, threads: int | None = None) -> PreparedRun:
        """Return the run of another system, prepared in the same way without inputs, or of that of a member."""
        attitude = self.initial_attitude
        options: dict[str, Any] = {"attitude": attitude, "watch": self._watching, "observe": self.observe}
        if member is not None:
            options["attitude"] = attitude[member] if np.ndim(attitude) > 2 else attitude
            options["inputs"] = None if self.inputs is None else self.inputs.specification
        prepared = PreparedRun(system, self.method, self.step, threads=threads or self._threads, **options)
        return prepared if prepared.inputs is None else prepared._copy({}, given_method=self.given_method)

    def of_member(self, member: int) -> PreparedRun:
        """Return the run of one member alone; of a system that members share this run itself."""
        if not self.system.is_batch:
            return self
        known = self.cache.of_members
        if member not in known:
            known[member] = self.of_system(self.system.among(member, member + 1).of_member(0), member, threads=1)
        return cast(PreparedRun, known[member])

    def follow(
        self,
        times: Times,
        start: Start,
        progress: bool = False,
        values: NDArray[np.float64] | None = None,
        events: tuple[Event, ...] = (),
        moments: OutputTimes | None = None,
    ) -> Solution:
        """Take the steps of `times` from a validated state; `moments`, if given, replace the saved points."""
        if moments is not None:
            from coadjoint.runs.partial_steps import check_partial_steps, resample

            check_partial_steps(self.system, moments)
            times = times.with_saved_steps(moments.marks)
        plan = self._plan_of(times, start, values)
        if plan.is_short and not (progress or events or self.observe or moments is not None):
            given = None if start.single and self._vector_size is not None else start
            solution = solution_of_short_run(plan, start.momenta.ravel(), time.perf_counter(), given)
            if solution is not None:
                return solution
        run = Run(plan, start)
        observed = self.observed(start)
        try:
            if events:
                from coadjoint.runs.crossings import FIRST_PIECE, EventRun

                located = EventRun(run, self.watched(events, start.momenta[0], times.t0))
                deque(in_pieces(run, located.advance, times.steps, FIRST_PIECE, progress, progress), 0)
                located.close()
            else:
                deque(in_pieces(run, run.advance, times.steps, 1 if progress else times.steps, progress, progress), 0)
        except KeyboardInterrupt as stopped:
            run.describe_interrupt(stopped, observed)
            raise
        if moments is not None:
            resample(run, moments)
        return run.solution(observed)
