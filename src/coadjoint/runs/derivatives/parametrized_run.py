"""A prepared run as a function of initial states, initial attitudes and parameters, for JAX and PyTorch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError, LargeStepWarning
from coadjoint.long_operations import warn_caller
from coadjoint.program.generators import group_side
from coadjoint.runs.derivatives.backward import gradient_of, read_cotangents
from coadjoint.runs.derivatives.differentiable_run import Arguments, DifferentiableRun, Trajectory
from coadjoint.runs.derivatives.forward import tangents_of_outputs
from coadjoint.runs.error_estimates import warn_of_large_step
from coadjoint.runs.partial_steps import check_partial_steps
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch
from coadjoint.systems.parameters import unknown_parameter, with_parameters_of_members
from coadjoint.systems.system import System
from coadjoint.systems.user_functions import is_called_in_python

Floats = NDArray[np.float64]
Shape = tuple[int, ...]

# Largest number of members of the run in which the step of a first run is checked, and if it calls Python; of steps if
# it calls Python or is of matrices, and of rows of these.
CHECKED_MEMBERS, CHECKED_CALLERS, CHECKED_CALLS, CHECKED_ROWS = 64, 8, 100, 128


def prepared_of(ready: Any, method: Any, step: Any, caller: str) -> PreparedRun:
    """Return a prepared run, or that of a system or batch with a method and a step; `caller` takes them."""
    if isinstance(ready, System | Batch):
        if step is None:
            raise TypeError(f"{caller} was given {short(ready)} without a step; give step=, and method=")
        prepared = PreparedRun(ready, method, step)
        prepared.cache.checks_step = True
        return prepared
    if method is not None or step is not None:
        raise TypeError(f"{caller} was given a step or a method for a prepared run, which has its own; omit them")
    return ready  # type: ignore[no-any-return]


class ParametrizedRun:
    """A prepared run over a time span, for values given by name: "x0", "attitude0" and parameters."""

    def __init__(
        self,
        prepared: PreparedRun,
        t_span: Any,
        save_every: Any,
        t_eval: Any,
        caller: str,
        *,
        compiled: bool = True,
        reverse: str = "exact",
    ) -> None:
        # If it is not `compiled`, the caller has its own derivatives and takes inputs and matrices.
        if type(prepared) is not PreparedRun:
            raise TypeError(f"{caller} was given {short(prepared)}; give co.prepare(system, method, step)")
        if prepared.inputs is not None and (prepared.system.is_batch or compiled):
            of_batch = "" if compiled else " of a batch"
            raise TypeError(f"{caller} was given a run{of_batch} prepared with inputs; prepare without inputs=")
        if len(prepared.system.shape) > 1 and compiled:
            raise TypeError(
                f"{caller} takes states that are vectors, and those of {prepared.system.name} are matrices; use "
                'prepared.jvp and prepared.vjp, or co.jax.solution with backend="xla"'
            )
        if prepared.system.is_batch and prepared.system.forces and not compiled:
            raise TypeError(
                f"{caller} takes batches without forces, not {prepared.system.name}; use prepared.jvp and prepared.vjp"
            )
        if prepared.method.own_steps:
            raise TypeError(f"{caller} takes schemes with a given step, and {prepared.method} chooses its own steps")
        self._prepared = prepared
        self._run = DifferentiableRun(prepared)
        self.times, self.moments = times, moments = prepared.times_of(t_span, save_every, t_eval)
        if moments is not None:
            check_partial_steps(prepared.system, moments, differentiated=True)
        if compiled:
            self._run.tables(times.h, ())  # raises TypeError for a scheme without derivatives
            self._run.check_reverse(reverse, times.h)
        self._reverse = reverse
        self._times: tuple[Any, Any, Any] = (t_span, save_every, t_eval)
        self.saved_times: Floats = times.saved_times if moments is None else moments.t
        self._points = len(self.saved_times)
        self._side = group_side(prepared.system.dim, prepared.representation)
        self._shapes = {name: parameter.value.shape for name, parameter in self._run.parameters.items()}
        inputs = prepared.inputs
        self._shapes |= {} if inputs is None else {name: one.shape for name, one in inputs.indices.items()}
        # One for each member: it must follow the members of an ensemble that vmap makes.
        initial = prepared.initial_attitude
        self._attitudes = initial if np.ndim(initial) == 3 else None
        self._last_run: tuple[Any, DifferentiableRun] = None, self._run
        self._last_trajectory: tuple[Any, Trajectory] | None = None

    def arguments(self, x0: Any, attitude0: Any, parameters: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of a call by name, in the order of the names."""
        attitude = self._attitudes if attitude0 is None else attitude0
        given = {} if attitude is None else {"attitude0": attitude}
        return {"x0": x0} | given | dict(sorted(parameters.items()))

    def check(self, shapes: Mapping[str, Shape]) -> None:
        """Raise ValueError for unknown names and wrong shapes of values."""
        system, d, x0 = self._prepared.system, self._side, shapes["x0"]
        shape, members = tuple(system.shape), len(system) if system.is_batch else "members"
        of_members = f"({members}, {', '.join(map(str, shape))})"
        known: dict[str, tuple[Shape, ...]] = {"x0": (shape, (*x0[:1], *shape))}
        if system.is_batch:
            known["x0"] = ((len(system), *shape),)
        if d:
            known["attitude0"] = (d, d), (*x0[:-1], d, d)
        known |= {name: (expected,) for name, expected in self._shapes.items()}
        for name, given in shapes.items():
            if name not in known:
                system = self._prepared.system
                raise unknown_parameter(system, f"parameter of {system.name}", name, known)
            if given not in known[name] or 0 in given:
                if name == "x0" and system.is_batch and given == shape:
                    raise ValueError(
                        f"x0 has the shape {given}; the {members} members of {system.name} are one run: call the "
                        f"function with {of_members}, also in place of jax.vmap over the members"
                    )
                single = "" if system.is_batch else f"{shape} or "
                texts = {"x0": f"{single}{of_members}", "attitude0": f"({d}, {d}) or ({members}, {d}, {d})"}
                raise ValueError(
                    f"{name} has the shape {given}; it must be {texts.get(name, known[name][0])}, as prepared"
                )

    def output_shapes(self, x0: Shape) -> list[Shape]:
        leading = (self._points, *x0[:-1])
        return [(*leading, x0[-1]), *([(*leading, self._side, self._side)] if self._side else [])]

    @property
    def is_checked(self) -> bool:
        """Whether the step of the next run is compared with shorter ones."""
        return self._prepared.cache.checks_step

    def check_first_step(self, given: Mapping[str, Floats]) -> None:
        """Warn if the step of a first run elsewhere is too large, by a run of the compiled loops of some members."""
        prepared, times = self._prepared, self.times
        if not self.is_checked:
            return
        prepared.cache.checks_step = False
        system = prepared.system
        if system.has_noise:
            return
        run: PreparedRun = prepared if prepared.inputs is not None else self._run_at(given).prepared
        x0, attitude = given["x0"], given.get("attitude0")
        called = [term.gradient for one in system.distinct for term in one.hamiltonian.terms() if term.called]
        called += [force for one in system.distinct for force in one.forces]
        in_python = any(map(is_called_in_python, called))
        members = CHECKED_CALLERS if in_python else CHECKED_MEMBERS
        if x0.ndim > 1 and len(x0) > members:
            run, x0 = run.among(0, members), x0[:members]
            attitude = attitude if attitude is None or attitude.ndim < 3 else attitude[:members]
        arguments: dict[str, Any] = dict(zip(("t_span", "save_every", "t_eval"), self._times, strict=True))
        if prepared.inputs is not None:
            arguments |= {name: given[name] for name in given if name in self._shapes}
        if system.shape[-1] > CHECKED_ROWS and len(system.shape) > 1:
            return
        if times.steps > CHECKED_CALLS and (len(system.shape) > 1 or in_python):
            arguments |= {"t_span": (times.t0, times.t0 + CHECKED_CALLS * times.h), "save_every": 1, "t_eval": None}
        try:
            solution = run.run(x0, attitude=attitude, **arguments)
        except IntegrationError:
            return
        warn_of_large_step(solution, run.in_one_thread())

    def warn_of_nan(self, x: Floats | None) -> None:
        """Warn of the first state of a run elsewhere that is NaN; None is a run that is traced."""
        if x is None or not np.isnan(x).any():
            return
        single = x.ndim == 1 + len(self._prepared.system.shape)
        wrong = np.isnan(x).reshape(len(x), 1 if single else x.shape[1], -1).any(axis=-1)
        k, m = np.argwhere(wrong)[0].tolist()
        count = int(wrong.any(axis=0).sum())
        of_members = "" if single else f" of member {m}" if count == 1 else f" of {count} members, first of member {m},"
        warn_caller(
            f"states{of_members} are NaN from t = {self.saved_times[k]:g} on: iterations or a series of a step before "
            "it do not converge, or a function is not finite; take a smaller step (co.integrate iterates longer)",
            LargeStepWarning,
        )

    @property
    def has_batch(self) -> bool:
        """Whether members have systems of their own, so that ensembles cannot be joined."""
        return bool(self._prepared.system.is_batch)

    def is_parameter(self, name: str) -> bool:
        return name in self._shapes

    def solve(self, values: Mapping[str, Floats], for_gradient: bool) -> list[Floats]:
        """Integrate; `for_gradient` caches the trajectory for `gradients`."""
        run = self._run_at(values).prepared.run
        solution = self._trajectory(values).solution if for_gradient else run(**self._at(values).keywords)
        return [one for one in (solution.x, solution.attitude) if one is not None]

    def tangents(self, values: Mapping[str, Floats], directions: Mapping[str, Floats]) -> list[Floats]:
        """Return the tangents of the outputs; directions and tangents have a first axis for several of them."""
        run = self._run_at(values)
        trajectory = Trajectory(run, self._at(values), None)
        given = {name: np.moveaxis(direction, 0, -1) for name, direction in directions.items()}
        _, of_x, of_attitudes = tangents_of_outputs(run, trajectory, given)
        series = [of_x] if of_attitudes is None else [of_x, of_attitudes]
        first = [np.moveaxis(one, 2, 0) for one in series]
        return [one[:, :, 0] for one in first] if trajectory.start.single else first

    def gradients(
        self, values: Mapping[str, Floats], cotangents: list[Floats], names: Iterable[str], by_member: bool = False
    ) -> list[Floats]:
        """Return the cotangents of values for several of the outputs, of parameters also `by_member`."""
        wanted = list(names)
        run, trajectory = self._run_at(values), self._trajectory(values)
        parameters = [name for name in wanted if name in self._shapes]
        found = []
        for of_x, *of_attitude in zip(*cotangents, strict=True):
            given = read_cotangents(trajectory.solution, of_x, next(iter(of_attitude), None))
            gradient = gradient_of(run, trajectory, given, parameters, by_member)
            found.append([gradient[name] for name in wanted])
        return [np.array(one) for one in zip(*found, strict=True)]

    def prepared_at(self, values: Mapping[str, Floats]) -> PreparedRun:
        return self._run_at(values).prepared

    def _at(self, values: Mapping[str, Floats]) -> Arguments:
        return Arguments(values["x0"], *self._times, values.get("attitude0"))

    def _run_at(self, values: Mapping[str, Floats]) -> DifferentiableRun:
        # Copies: a cached run may not share memory with arrays that change.
        given = {name: np.array(value) for name, value in values.items() if name in self._shapes}
        own = self._run.parameters
        changed = {name: value for name, value in given.items() if not np.array_equal(value, own[name].value)}
        if not changed:
            return self._run
        key, (last, run) = _key(given), self._last_run
        if key != last:
            system = self._run.system
            run = DifferentiableRun(
                self._prepared.of_system(with_parameters_of_members(system, changed)), (system, given)
            )
            self._last_run = key, run
        return run

    def _trajectory(self, values: Mapping[str, Floats]) -> Trajectory:
        key, last = _key(values), self._last_trajectory
        if last is not None and last[0] == key:
            return last[1]
        trajectory = Trajectory(self._run_at(values), self._at(values), self._reverse)
        self._last_trajectory = key, trajectory
        return trajectory


def _key(values: Mapping[str, Floats]) -> tuple[Any, ...]:
    return tuple((name, value.shape, value.tobytes()) for name, value in sorted(values.items()))
