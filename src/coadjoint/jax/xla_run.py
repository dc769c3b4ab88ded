"""Runs as operations of JAX: steps of a table, or of Gauss stages, in loops of XLA."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from coadjoint.jax.energy_coefficients import CoefficientsAtParameters
from coadjoint.jax.feature_flows import feature_steps
from coadjoint.jax.forces import steps_between_forces
from coadjoint.jax.isospectral_steps import isospectral_steps, project
from coadjoint.jax.library import LIBRARY, FeatureEnergy
from coadjoint.jax.primitives import doubles
from coadjoint.jax.stage_steps import SAVED, CoadjointAction, StageField, Steps, stage_steps
from coadjoint.jax.table_steps import DEPENDENT, table_steps
from coadjoint.jax.traced_functions import compare_with_compiled, gradient_of, sample_states
from coadjoint.memory import check_available_memory
from coadjoint.methods.force_flows import EnergyNumbers
from coadjoint.methods.forced import Forced
from coadjoint.methods.isospectral_gauss import IsospectralGauss
from coadjoint.methods.protocol.composed import Substeps
from coadjoint.methods.protocol.flow_method import FlowMethod
from coadjoint.methods.protocol.runge_kutta import RungeKuttaMethod
from coadjoint.program.generators import given_matrices, group_side
from coadjoint.program.group_correction import unshift_tables
from coadjoint.program.public_table import energy_and_parameters
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.derivatives.parametrized_run import ParametrizedRun
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.start import with_group
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.systems.fluids.carried_fields import TwoLayerSystem
from coadjoint.systems.hamiltonians.parametrized_functions import (
    NAME,
    ParametrizedEnergy,
    features_of,
    function_of,
    function_with_params,
)
from coadjoint.systems.hamiltonians.user_hamiltonian import JaxFunction
from coadjoint.systems.registry import UNIT_TOLERANCE, unit_coordinate

CALLER = 'co.jax.solution with backend="xla"'

# Loops with fewer numbers in all states of a trajectory are not divided into segments, which are computed twice.
MOST_STORED = 2**12
# Segments may be longer than the root of the number of steps by this factor, so that they are of equal length.
LONGEST = 8
# Largest difference of a state that is reached by undone steps from the stored one, relative to the size of its group
# of coordinates, beside rounding: half of the digits. Beyond it gradients are NaN.
LARGEST_DIFFERENCE, ROUNDING = 1e-8, 2.0**10 * UNIT_ROUNDOFF
REMEDY = 'take reverse="exact"'
# A part of the span after which functions are compared with the compiled ones, besides its start.
SAMPLED_PART = 0.37


class XlaRun:
    """A prepared run over a time span as operations of JAX, for values by name: x0, inputs and parameters."""

    def __init__(self, prepared: PreparedRun, t_span: Any, save_every: Any, t_eval: Any, undoes: bool = False) -> None:
        # Where it `undoes`, reverse mode takes the steps back from the saved states, without storing others.
        self._prepared = prepared
        self._run = ParametrizedRun(prepared, t_span, save_every, t_eval, CALLER, compiled=False)
        inputs, self._function = prepared.inputs, function_with_params(prepared.system, JaxFunction, LIBRARY)
        self._system = prepared.system if inputs is None else inputs.system_at(inputs.generic)
        self._constants: Any = None
        first = self._system.of_member(0).unforced
        self._is_complex = first.has_matrices and first.complex
        method, group = prepared.method, prepared.representation
        if self._system.is_batch:
            self._steps, self._table = self._describe_members(method, group)
        elif self._system.forces:
            forced = cast(Forced, prepared.scheme)
            if group is not None and any(force.around_steps for force in self._system.forces):
                raise TypeError(
                    f"{CALLER} takes no attitude= beside noise that turns the group element too, as of "
                    f'{self._system.name}; prepare the run without, or take backend="compiled"'
                )
            steps, self._table = _steps_and_table(self._system.unforced, forced.inner, group)
            field = None if self._system.has_matrices else _field(self._system.unforced, self._table)
            self._steps = steps_between_forces(steps, self._system, field, forced)
        else:
            self._steps, self._table = _steps_and_table(self._system.unforced, method, group)
        if undoes and self._steps.undo is None:
            raise TypeError(f"{self._system.name} by {prepared.scheme} has no steps that {CALLER} undoes; {REMEDY}")
        self._undoes, self._groups = undoes, CoordinateGroups(first).labels if undoes else None
        self._energy = CoefficientsAtParameters(self._system, self._table, prepared.inputs, CALLER)
        self._attitude = self._initial_attitude(prepared)
        times, moments = self._run.times, self._run.moments
        self._t0, self._h = times.t0, times.h
        marks = times.saved if moments is None else moments.number
        self._every = times.save_every if moments is None else math.gcd(*marks.tolist())
        # Intervals between states that are computed, and the steps after them.
        self._intervals, self._rest = divmod(int(marks[-1]), max(1, self._every))
        self._chosen = None if moments is None else marks // max(1, self._every)
        self._starts = times.at(marks)
        self._lengths = np.zeros(len(marks)) if moments is None else moments.length
        self._moments = times.at(np.arange(times.steps + 1)) if self._system.has_noise else None
        self.solve = jax.jit(self._solve)
        pairs = [(function_of(term, JaxFunction)[0], term) for term in first.hamiltonian.terms()]
        learned = [(function, term) for function, term in pairs if isinstance(function, ParametrizedEnergy)]
        self._learned = learned[0][0] if learned else None
        scheme = (method if not self._system.forces else cast(Forced, prepared.scheme).inner).expanded
        self._by_features = type(self._learned) is FeatureEnergy and isinstance(scheme, FlowMethod)
        self._derivatives = jax.jit(partial(_derivatives_at, [gradient_of(term) for _, term in learned], self._t0))
        self._compared = {True: False, False: False}  # whether functions were, at a known start and at sample points

    def __call__(self, x0: Any, attitude0: Any, parameters: Mapping[str, Any]) -> Any:
        """Return the states (points, n) or (points, members, n)."""
        function, rest = self._function, dict(parameters)
        params = None if function is None else function.checked(rest.pop(NAME, function.params))
        given = self._run.arguments(x0, attitude0, rest)
        values = doubles(given, np.complex128 if self._is_complex else np.float64)
        self._run.check({name: value.shape for name, value in values.items()})
        if parameters and len(self._system.shape) > 1:
            raise ValueError(
                f"{next(iter(parameters))} of {self._system.name} has the value of the prepared run with "
                'backend="xla"; prepare a run of a system with another one'
            )
        states = (self._intervals + 2) * values["x0"].size
        check_available_memory(
            values["x0"].dtype.itemsize * states, f"the {self._intervals + 2} states of the run, with {CALLER},"
        )
        known = {name: _known_numbers(value) for name, value in given.items()}
        start, attitude = known["x0"], known.get("attitude0")
        if start is not None:
            self._prepared.start(start)
            self._check_differentiable(start, params)
        if attitude is not None:
            check_attitude(self._prepared, attitude)
        elif "attitude0" in values:
            values["attitude0"] = self._checked_attitude(values["attitude0"])
        if self._steps.functions and not self._compared[start is not None]:
            times = self._t0, self._t0 + SAMPLED_PART * self._h * self._run.times.steps
            compare_with_compiled(self._steps.functions, sample_states(self._system, start), times, 0.5 * self._h)
            self._compared[start is not None] = True
        found = self.solve(values, params)
        if self._run.is_checked and not any(value is None for value in known.values()) and self._is_compiled(params):
            self._run.check_first_step(known)
        self._run.warn_of_nan(_known_numbers(found[0] if type(found) is tuple else found))
        return found

    def _is_compiled(self, params: Any) -> bool:
        """Return whether compiled loops have the run at these params: if they are those of the system, as numbers."""
        own = self._function is None or LIBRARY.are_same(self._function.params, jax.tree.map(_known_numbers, params))
        return own and not self._by_features

    def _check_differentiable(self, start: Any, params: Any) -> None:
        """Raise ValueError if an energy with params has no first or second derivatives at an initial state."""
        params = jax.tree.map(lax.stop_gradient, params)
        if self._learned is None or any(isinstance(one, jax.core.Tracer) for one in jax.tree.leaves(params)):
            return
        rows = start.reshape(-1, start.shape[-1])
        with jax.ensure_compile_time_eval():
            derivatives = [np.asarray(one) for one in self._derivatives(rows, params)]
        self._learned.check_differentiable(start, derivatives)

    def _checked_attitude(self, attitude: Any) -> Any:
        """Return an attitude that is checked on the host when the traced program runs."""

        def check(own: Any) -> Any:
            check_attitude(self._prepared, np.asarray(own))
            return np.zeros(())

        nothing = jax.ShapeDtypeStruct((), np.float64)
        return attitude + jax.pure_callback(check, nothing, lax.stop_gradient(attitude), vmap_method="sequential")

    def _describe_members(self, method: Any, group: Any) -> tuple[Any, Mapping[str, Any]]:
        """Return the steps and the table of the first member of a batch; set the constants of all members."""
        batch = self._system
        each = [_steps_and_table(system, method, group) for system in batch.distinct]
        constants = [steps.constants(EnergyNumbers(table["energy"]["coefficients"])) for steps, table in each]
        shapes = [jax.tree.map(jnp.shape, one) for one in constants]
        if any(
            shape != shapes[0] or _structure_differs(system, table, batch.distinct[0], each[0][1])
            for system, (_, table), shape in zip(batch.distinct, each, shapes, strict=True)
        ):
            raise TypeError(
                f"{CALLER} takes batches whose members have the same parts and structure constants, and no functions, "
                f'not {batch.name}; take parts="coordinates", or backend="compiled"'
            )
        self._constants = jax.tree.map(lambda *own: jnp.stack(own)[batch.owners], *constants)
        return each[0]

    def _initial_attitude(self, prepared: PreparedRun) -> Any:
        """Return the initial attitude unless another one is given; None for runs without."""
        group, initial = prepared.representation, prepared.initial_attitude
        if group is None:
            return None
        if isinstance(initial, np.ndarray):
            check_attitude(prepared, initial)
        return initial if isinstance(initial, np.ndarray) else np.eye(group_side(prepared.system.dim, group))

    # The steps.

    def _solve(self, values: Mapping[str, Any], params: Any) -> Any:
        x0, attitude = usable_or_nan(self._system, values["x0"]), values.get("attitude0", self._attitude)
        parameters = {name: value for name, value in values.items() if name not in ("x0", "attitude0")}
        energy, of_batch = EnergyNumbers(self._energy(parameters), params), self._constants is not None
        constants = self._constants if of_batch else self._steps.constants(energy)
        numbers = (x0, *parameters.values(), *jax.tree.leaves(params))
        members = member_numbers(*map(lax.stop_gradient, numbers)) if self._system.has_noise else 0
        if x0.ndim == len(self._system.shape):
            x, A = self._trajectory(constants, x0, attitude, members)
        else:
            of_members = None if attitude is None or attitude.ndim == 2 else 0
            axes = (0 if of_batch else None, 0, of_members, 0 if self._system.has_noise else None)
            x, A = jax.vmap(self._trajectory, axes, 1)(constants, x0, attitude, members)
        return x if attitude is None else (x, A)

    def _time(self, k: Any) -> Any:
        """Return the time of a step; noise depends on every bit of it."""
        return self._t0 + k * self._h if self._moments is None else jnp.asarray(self._moments)[k]

    def _trajectory(self, constants: Any, x0: Any, attitude: Any, member: Any) -> Any:
        steps, h, every, start = self._steps, self._h, self._every, (x0, attitude)

        def step(state: Any, k: Any) -> Any:
            return steps.step(constants, state, self._time(k), h, member), None

        def finished(state: Any, k: Any) -> Any:
            return steps.finish(constants, state, self._time(k - 1), h, start, k * h)

        def advanced(state: Any, first: Any, count: int) -> Any:
            if self._undoes:
                return self._undone_later(count)(constants, state, first)
            return scan_in_segments(step, state, first + jnp.arange(count))[0]

        def interval(state: Any, first: Any) -> Any:
            state = advanced(state, first, every)
            return state, finished(state, first + every)

        state, saved = steps.begin(constants, start, self._t0, h), [jax.tree.map(lambda one: one[None], start)]
        if self._intervals:
            firsts = every * jnp.arange(self._intervals)
            if self._undoes:
                state, found = lax.scan(interval, state, firsts)
            else:
                state, found = scan_in_segments(interval, state, firsts, every)
            saved.append(found)
        if self._rest:
            last = every * self._intervals
            state = advanced(state, last, self._rest)
            saved.append(jax.tree.map(lambda one: one[None], finished(state, last + self._rest)))
        states = jax.tree.map(lambda *pieces: jnp.concatenate(pieces), *saved)
        if self._chosen is None:
            return states
        return self._partial_steps(constants, jax.tree.map(lambda one: one[self._chosen], states), member)

    def _undone_later(self, count: int) -> Callable[..., Any]:
        """Return `count` steps that reverse mode undoes from the last one, with no state stored between."""
        steps, h = self._steps, self._h
        undo = cast(Callable[..., Any], steps.undo)

        def step(constants: Any, state: Any, k: Any) -> Any:
            return steps.step(constants, state, self._time(k), h, 0)

        @jax.custom_vjp
        def advance(constants: Any, state: Any, first: Any) -> Any:
            return lax.fori_loop(0, count, lambda k, state: step(constants, state, first + k), state)

        def forward(constants: Any, start: Any, first: Any) -> Any:
            end = advance(constants, start, first)
            return end, (constants, start, end, first)

        def backward(residuals: Any, of_end: Any) -> Any:
            constants, start, end, first = residuals
            leaves, structure = jax.tree.flatten(constants)
            numbers = [one for one in leaves if jnp.issubdtype(one.dtype, jnp.inexact)]

            def joined(numbers: Any, indices: Any) -> Any:
                rest = iter(numbers)
                return [next(rest) if jnp.issubdtype(one.dtype, jnp.inexact) else indices(one) for one in leaves]

            def at(numbers: Any) -> Any:
                return jax.tree.unflatten(structure, joined(numbers, lambda one: one))

            def undone(k: Any, carry: Any) -> Any:
                state, of_state, of_numbers = carry
                number = first + count - 1 - k
                before = undo(constants, state, self._time(number), h, 0)
                pullback = jax.vjp(lambda numbers, state: step(at(numbers), state, number), numbers, before)[1]
                added, of_state = pullback(of_state)
                return before, of_state, jax.tree.map(jnp.add, of_numbers, added)

            carry = end, of_end, jax.tree.map(jnp.zeros_like, numbers)
            reached, of_start, of_numbers = lax.fori_loop(0, count, undone, carry)
            known = jnp.where(self._returned(reached, start, end), 1.0, jnp.nan)
            of_start, of_numbers = jax.tree.map(lambda one: known * one, (of_start, of_numbers))
            of_constants = joined(of_numbers, lambda one: np.zeros(one.shape, jax.dtypes.float0))
            return jax.tree.unflatten(structure, of_constants), of_start, None

        advance.defvjp(forward, backward)
        return advance

    def _returned(self, reached: Any, start: Any, end: Any) -> Any:
        """Return whether undone steps reached the state where they started, except for errors of no importance."""

        def is_near(own: Any, known: Any, last: Any, groups: Any) -> Any:
            sizes = jnp.maximum(jnp.abs(known), jnp.abs(last))
            of_group = jnp.zeros(int(np.max(groups)) + 1).at[groups].max(sizes)[groups]
            return jnp.all(jnp.abs(own - known) <= LARGEST_DIFFERENCE * of_group + ROUNDING * jnp.max(sizes))

        (x, element), (x0, element0), (x1, element1) = reached, start, end
        near = is_near(x, x0, x1, self._groups)
        if element is None:
            return near
        own, known, last = (one.ravel() for one in (element, element0, element1))
        return near & is_near(own, known, last, np.zeros(element.size, dtype=np.int64))

    def _partial_steps(self, constants: Any, states: Any, member: Any) -> Any:
        """Return the states after the steps of output times, each with a step of what remains of its time."""
        partial = np.flatnonzero(self._lengths)
        if not len(partial):
            return states
        times, lengths = jnp.asarray(self._starts[partial]), jnp.asarray(self._lengths[partial])
        before = jax.tree.map(lambda one: one[partial], states)
        ends = jax.vmap(self._steps.whole, (None, 0, 0, 0, None))(constants, before, times, lengths, member)
        return jax.tree.map(lambda one, end: one.at[partial].set(end), states, ends)


def _derivatives_at(gradients: Any, t: Any, rows: Any, params: Any) -> tuple[Any, Any]:
    """Return the derivatives of terms at states, and those along one direction, for each row."""

    def at(x: Any) -> Any:
        along, pairs = jnp.cos(jnp.arange(1.0, len(x) + 1.0)), []
        for one in gradients:
            own = one.coordinates
            pairs.append(jax.jvp(lambda y, one=one: one.at(y, t, params), (x[own],), (along[own],)))
        return tuple(jnp.concatenate(each) for each in zip(*pairs, strict=True))

    return cast("tuple[Any, Any]", jax.vmap(at)(rows))


def check_attitude(prepared: PreparedRun, attitude: Any) -> None:
    """Raise ValueError for an initial attitude, or several, that a run refuses."""
    momenta = np.zeros((len(attitude) if attitude.ndim > 2 else 1, prepared.system.dim))
    with_group(prepared.system, momenta, True, prepared.representation, attitude)


def _known_numbers(value: Any) -> Any:
    """Return the numbers of an argument, also where it is differentiated; None inside of `jit` and `vmap`."""

    def known(leaf: Any) -> Any:
        return lax.stop_gradient(leaf) if isinstance(leaf, jax.core.Tracer) else leaf

    try:
        numbers = np.array(jax.tree.map(known, value), subok=True)
        return numbers if numbers.dtype.kind == "c" else numbers.astype(np.float64)
    except jax.errors.TracerArrayConversionError:
        return None


def usable_or_nan(system: Any, x0: Any) -> Any:
    """Return initial states, NaN where a coordinate that must be 1 is not, or a matrix is not of the algebra.

    Traced states raise no errors.
    """
    first = system.of_member(0).unforced
    if first.has_matrices:
        return project(first, x0)
    unit, *others = {unit_coordinate(one.unforced) for one in system.distinct}
    if unit is None or others:
        return x0
    return jnp.where(jnp.abs(x0[..., unit : unit + 1] - 1.0) <= UNIT_TOLERANCE, x0, jnp.nan)


@jax.custom_batching.custom_vmap
def member_numbers(x0: Any, *parameters: Any) -> Any:
    """Return the numbers of the members of x0, from which their noise follows; `vmap` over x0 makes one ensemble."""
    return jnp.arange(len(x0)) if x0.ndim > 1 else jnp.asarray(0)


@member_numbers.def_vmap
def _member_numbers_of_batch(size: int, batched: Any, x0: Any, *parameters: Any) -> tuple[Any, bool]:
    if batched[0] and not any(batched[1:]):
        return member_numbers(x0.reshape(-1, x0.shape[-1]), *parameters).reshape(x0.shape[:-1]), True
    # Other parameters are other ensembles, as in the compiled runs.
    firsts = [one[0] if has_axis else one for one, has_axis in zip((x0, *parameters), batched, strict=True)]
    return member_numbers(*firsts), False


def _field(system: Any, table: Mapping[str, Any]) -> StageField:
    """Return the field of a system without forces, with the coefficients of the energy in its table."""
    return StageField(system, table["energy"]["monomials"])


def _steps_and_table(system: Any, method: Any, group: Any) -> tuple[Steps, Mapping[str, Any]]:
    """Return the steps of a scheme for a system without forces, and a table with at least the energy and parameters."""
    scheme = method.expanded
    if system.has_matrices:
        return _matrix_steps(system, method), {
            "fixed": [],
            "parameters": {},
            "energy": {"monomials": [], "coefficients": ()},
        }
    if not system.has_structure_constants:
        raise TypeError(f'{CALLER} takes systems on a Lie algebra, not {system.name}; take backend="compiled"')
    table: Mapping[str, Any] = {"fixed": [], **energy_and_parameters(system)}
    features, factor = features_of(system, JaxFunction)
    if isinstance(scheme, FlowMethod) and scheme.compensates:
        raise TypeError(f"{CALLER} has no compensated sums, as {method} wants; take compensated=False")
    if features is not None and isinstance(scheme, FlowMethod):
        if group is not None:
            raise TypeError(f"{CALLER} computes no attitudes beside energies of co.jax.features; prepare without")
        return feature_steps(CoadjointAction(system.algebra, system.sign), scheme, features, factor), table
    if isinstance(scheme, RungeKuttaMethod) and scheme.solver == "implicit":
        if group is not None:
            raise TypeError(f'{CALLER} computes attitudes by splittings only, not by {method}; take backend="compiled"')
        return stage_steps(_field(system, table), scheme.coefficients()), table
    if not isinstance(scheme, FlowMethod):
        raise TypeError(
            f'{CALLER} takes splittings and implicit Runge-Kutta methods, not {method}; take backend="compiled"'
        )
    flow_table = scheme.flow_table(system, group=group)
    table = flow_table.to_mapping()
    return table_steps(table, flow_table.functions, *_of_group(flow_table, group)), table


def _matrix_steps(system: Any, method: Any) -> Steps:
    """Return the steps of an isospectral scheme for a system of matrices without forces."""
    scheme = method.expanded
    base = scheme.base if isinstance(scheme, Substeps) else scheme
    if not isinstance(base, IsospectralGauss):
        raise TypeError(f"{CALLER} takes IsospectralGauss and its compositions for matrices, not {method}")
    if system.shape != system.matrix_shape:
        raise TypeError(f"{CALLER} takes states that are matrices; give {system.name} without in_numbers")
    if system.matrix_shape != system.algebra.shape and not isinstance(system, TwoLayerSystem):
        raise TypeError(f"{CALLER} takes states of one matrix or two layers, not those of {system.name}")
    if not system.algebra.skew or system.algebra.blocks:
        raise TypeError(
            f"{CALLER} takes skew-Hermitian matrices of one block, not those of {system.algebra}; take prepared.run"
        )
    return isospectral_steps(system, base, scheme.fractions)


def _structure_differs(
    system: Any, table: Mapping[str, Any], first_system: Any, first_table: Mapping[str, Any]
) -> bool:
    """Return whether a member of a batch has more than other numbers than the first one, or functions."""
    keys = [key for key in first_table if key not in (*DEPENDENT, "energy", "parameters", "provenance", "fixed")]
    pairs = [(table[key], first_table[key]) for key in keys if key != "shift"]
    pairs += zip(system.algebra.triples, first_system.algebra.triples, strict=True)
    # As lists: monomials of several degrees are no array.
    monomials = [[*map(tuple, each["energy"]["monomials"])] for each in (table, first_table)]
    casimirs = [[shift["exponents"] for shift in each.get("shift", ())] for each in (table, first_table)]
    differ = monomials[0] != monomials[1] or casimirs[0] != casimirs[1]
    has_functions = any(term.called for term in system.hamiltonian.terms())
    return has_functions or differ or not all(np.array_equal(*pair) for pair in pairs)


def _of_group(flow_table: Any, group: Any) -> tuple[int | None, list[Any]]:
    """Return the size of a group element, and the tables of the generators of subtracted Casimirs."""
    if group is None:
        return None, []
    system, rho, side = flow_table.system, given_matrices(group), group_side(flow_table.system.dim, group)
    return side, [
        unshift_tables(system.algebra, rho, system.sign, ((casimir, 1.0),)) for casimir, _ in flow_table.shift
    ]


def scan_in_segments(body: Callable[..., Any], carry: Any, xs: Any, steps: int = 1) -> Any:
    """Return `lax.scan` of a body, of some steps, over numbers, with states stored for reverse mode at segments."""
    # The steps of a segment are computed again from its first state, and each step from its own and its fixed points.
    count = len(xs)
    short = count * steps * sum(np.size(one) for one in jax.tree.leaves(carry)) <= MOST_STORED
    policy = jax.checkpoint_policies.save_only_these_names(SAVED) if short or steps == 1 else None
    body = jax.checkpoint(body, prevent_cse=False, policy=policy)
    root = math.isqrt(count)
    if short:
        return lax.scan(body, carry, xs)
    length = next((d for d in range(root, LONGEST * root) if count % d == 0), root)
    whole = count - count % length
    segment = jax.checkpoint(lambda carry, own: lax.scan(body, carry, own), prevent_cse=False)
    carry, ys = lax.scan(segment, carry, xs[:whole].reshape(-1, length))
    ys = jax.tree.map(lambda y: y.reshape(whole, *y.shape[2:]), ys)
    if whole < count:
        carry, rest = lax.scan(body, carry, xs[whole:])
        ys = jax.tree.map(lambda *both: jnp.concatenate(both), ys, rest)
    return carry, ys
