"""Prepared runs: tables and compiled functions are built once for many short calls."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import read_progress
from coadjoint.methods.forced import check_steps
from coadjoint.runs.event_run import EventRun
from coadjoint.runs.events import Event, read_events
from coadjoint.runs.partial_steps import PartialSteps, check_partial_steps, resample
from coadjoint.runs.preparation import ONE_VECTOR, Preparation
from coadjoint.runs.results.solution import Solution, set_elapsed
from coadjoint.runs.run import Run
from coadjoint.runs.short_runs import ENDS_ONLY, FinalStateRun, solution_of_short_run
from coadjoint.runs.start import Start
from coadjoint.runs.times import OutputTimes, Times
from coadjoint.systems.system import System
from coadjoint.validation import FLOAT64

if TYPE_CHECKING:
    from coadjoint.runs.derivatives.backward import Pullback
    from coadjoint.runs.derivatives.forward import Tangents


class PreparedRun(Preparation):
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
            to the values of the system.

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
                    check_steps(self.system, times.t0, times.h)
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
        other schemes are differentiated in Python, one by one: by the state through `Method.tangent`, and by parameters
        through central differences of order 8, with about twelve digits, "differences". So are the flows of forces,
        with the noise of the run; their parameters have names such as "LinearDamping.rate". At a parameter where two
        orders of the parts are equally good, such as the moments (1, 2, 3, 4) of ``so_n_body``, the computed map has no
        derivative: "differences" mix those of both orders, which differ by the error of the scheme.

        The lengths of steps that a scheme chooses are fixed. Crossings of events are differentiated with their times,
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
        times as much as the run, for any number of parameters, and little memory for any number of steps.

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

        See Also
        --------
        jvp : Derivatives along given directions; its notes say what the derivative by a parameter is.

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
    def end(self, x0: Any, t_span: tuple[float, float]) -> NDArray[np.float64]:
        """Return only the final state of a run, with less than half of the overhead of `run`.

        For shooting methods, maps and control loops of few steps: no solution object is created. The result is bitwise
        equal to ``run(x0, t_span).x[-1]``, with the same errors. Ensembles, batches, matrices, and runs prepared with
        an attitude or with inputs fall back to `run`.

        Parameters
        ----------
        x0 : array_like, shape (n,) or (members, n)
            Initial momentum, as in `run`; fastest for an array of float64.
        t_span : (float, float)
            Start and end, a whole number of steps apart; the run goes backward if the end is the smaller one. An
            unchanged tuple is not validated again.

        Returns
        -------
        ndarray
            Final state, in the shape of x0.

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
        >>> for _ in range(1000):
        ...     x = prepared.end(x, span)
        """
        ends = self.cache.ends
        try:
            final_run = ends.pop()
        except IndexError:
            final_run = FinalStateRun(self)
        state = final_run.end(x0, t_span)
        ends.append(final_run)
        return self.run(x0, t_span, ENDS_ONLY).x[-1] if state is None else state

    def of_system(self, system: System, member: int | None = None, threads: int | None = None) -> PreparedRun:
        """Return the run of another system, or of the system of a member, prepared in the same way without inputs."""
        attitude = self.initial_attitude
        if member is not None and np.ndim(attitude) > 2:
            attitude = attitude[member]
        options: dict[str, Any] = {"attitude": attitude, "watch": self._watching, "observe": self.observe}
        return PreparedRun(system, self.method, self.step, threads=threads or self._threads, **options)

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
                parts = PartialSteps(self.system, self.method, run.loops, run.plan.workers)
                EventRun(run, self._watched(events, start.momenta[0], times.t0), parts).advance(progress)
            else:
                run.advance(progress)
        except KeyboardInterrupt as stopped:
            run.describe_interrupt(stopped, observed)
            raise
        if moments is not None:
            resample(run, moments)
        return run.solution(observed)
