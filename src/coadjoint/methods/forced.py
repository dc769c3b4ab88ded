"""Any scheme on a system with forces: a step of the scheme between half flows of the forces."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import accumulate
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.loop import CompiledLoop
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.protocol.composed import Wrapper, check_base, composition_order
from coadjoint.methods.protocol.method import Method, Representation, declared_properties
from coadjoint.methods.protocol.properties import Properties
from coadjoint.systems.forces.base import Force
from coadjoint.systems.step_derivatives import LinearizedStep, dense_step, derivative_of
from coadjoint.systems.time_spans import check_span

if TYPE_CHECKING:
    from coadjoint.methods.protocol.cost_model import Work
    from coadjoint.systems.system_stacks import SystemStack

ORDER_OF_FLOWS = 10  # of quadrature with five points
TANGENT_METHODS = ("formula", "complex step", "differences")


def effective_scheme(system: Any, method: Method) -> Method:
    """Return the scheme of a run: `Forced` around the given scheme if the system has forces."""
    if isinstance(method, Forced):
        raise TypeError(f"{method} is applied by runs to systems with forces automatically; give {method.base}")
    if not system.forces:
        return method
    forced = Forced(method)
    for one in system.distinct:
        forced.check_backward(one)
    return forced


def check_supports(system: Any, method: Method) -> None:
    """Raise the error of a scheme for a system that it does not support, with forces or without."""
    effective_scheme(system, method).properties(system)


def check_steps(system: Any, scheme: Any, t0: float, h: float, steps: int = 0) -> None:
    """Raise ValueError if a force cannot act in steps from t0: backward, with samples within steps, or, of a number of
    steps, at times at which its functions are not known.
    """
    if not system.forces:
        return
    # Substeps of schemes of higher order reach beyond the ends of a step.
    ends = [0.0, *accumulate(scheme.fractions)] if isinstance(scheme, Forced) else [0.0, 1.0]
    begin, end = t0 + min(0.0, *ends) * h, t0 + (steps - 1 + max(1.0, *ends)) * h
    for one in system.distinct:
        for label, force in zip(one.labels, one.forces, strict=True):
            force.check_steps(t0, h)
            if steps:
                check_span(label, force, begin, end)


def substeps_of(fractions: Sequence[float], t: Any, h: Any) -> list[tuple[Any, Any]]:
    """Return the times at which substeps of these fractions begin, and their lengths, as the kernels compute them."""
    begins = [0.0, *accumulate(fractions)]
    return [(t + begin * h, c * h) for begin, c in zip(begins, fractions, strict=False)]


def halves_of_step(
    flows: Sequence[tuple[int, Any]], fractions: Sequence[float], t: Any, h: Any
) -> Iterator[tuple[Any, Any, tuple[list[tuple[int, Any, Any]], list[tuple[int, Any, Any]]]]]:
    """Yield begin and length of each substep, and the flows before and after it: number, begin and duration."""
    substeps = substeps_of(fractions, t, h)
    for k, (begin, length) in enumerate(substeps):
        ends, half = (k == 0, k == len(substeps) - 1), 0.5 * length
        halves = [
            [
                (j, t, h) if flow.around_steps else (j, begin + half if side else begin, half)
                for j, (_, flow) in enumerate(flows)
                if ends[side] or not flow.around_steps
            ]
            for side in range(2)
        ]
        yield begin, length, (halves[0], halves[1][::-1])


def on_side(flow: Force, side: int) -> Any:
    """Return a flow as it acts before (0) or after (1) a substep."""
    return flow.on_side(side) if flow.around_steps else flow


@cache
def _order_of_composition(fractions: tuple[float, ...]) -> int:
    """Return the order of a composition of the symmetric splitting, up to that to which flows of forces are known."""
    return 2 if len(fractions) == 1 else min(composition_order(fractions, 2), ORDER_OF_FLOWS)


def flow_of_force(
    force: Force, system: Any, x: NDArray[np.float64], t: float, tau: float, order: int
) -> LinearizedStep:
    """Return the flow of a force on the Hamiltonian part with its derivative, in schemes of an order."""
    known = force.tangent(system, x, t, tau)
    if isinstance(known, LinearizedStep):
        return known
    if known is not None:
        end = np.asarray(force.flow_of_order(system, x, t, tau, order), dtype=np.float64)
        return dense_step(end, np.asarray(known, dtype=np.float64))
    end, derivative, by = derivative_of(lambda z: force.flow_of_order(system, z, t, tau, order), x)
    if system.has_matrices:
        derivative = system.to_vector(system.algebra.projected(system.from_vector(derivative)))
    return dense_step(end, np.asarray(derivative), by)


@suggest_keywords
@dataclass(frozen=True)
class Forced(Wrapper):
    """A scheme for a system with forces, as a symmetric splitting: order two, or one if the scheme has order one.

    Splittings of order 4, 6, 8 and 10, and a `Composition`, compose it at fractions of the step, some of them negative,
    and keep their order, up to 10. Forces that do not run backward, such as heat baths and what is sampled or held over
    a step, are then refused.

    A step consists of the half flows of the forces in their order, a step of the base for the Hamiltonian part, and the
    half flows in reverse order. A `HamiltonianNoise` acts before or after the whole step, in its place among them.
    Sampled laws are evaluated on the state at the start of the step, so that the first of their forces is before all
    others. Each step of the base starts afresh, except for the initial guesses of schemes for matrices. `integrate`,
    `prepare` and `stepper` apply it automatically if a system has forces; use it directly for `properties`, which names
    what is preserved and what breaks the rest.

    Parameters
    ----------
    base : Method
        Any scheme that supports the Hamiltonian part.

    Raises
    ------
    TypeError
        The base is not a scheme.
    ValueError
        The base is a splitting of order above two, or another composition, but not one of steps of order two.

    Examples
    --------
    >>> import coadjoint as co
    >>> spin = co.LiePoissonSystem(co.algebras.so(3), co.Polynomial({(0, 0, 1): -1.0}))
    >>> damped = spin.with_forces(co.forces.DoubleBracketDamping(0.1))
    >>> found = co.methods.Forced(co.Splitting()).properties(damped)
    >>> found.casimirs, found.poisson, found.broken_by
    ('all', False, ('Poisson map: DoubleBracketDamping',))
    """

    base: Method

    offered = False
    compensates = False

    def __post_init__(self) -> None:
        check_base(self.base, "Forced", "Splitting()")
        _ = self._substeps  # raises the error of a base of higher order

    @cached_property
    def _substeps(self) -> tuple[Method, tuple[float, ...]]:
        inner, fractions = self.base.steps_between_forces()
        if _order_of_composition(fractions) > 2:
            return inner, fractions
        if self.base.order > max(2, inner.order):
            raise ValueError(
                f"{self.base} raises the order of {inner}, {inner.order}, and with forces that of any step is two; "
                f"compose a scheme of order two, as co.methods.even_order does with GaussLegendre(1)"
            )
        return self.base, (1.0,)

    @property
    def inner(self) -> Method:
        return self._substeps[0]

    @property
    def fractions(self) -> tuple[float, ...]:
        return self._substeps[1]

    @property
    def stored_states(self) -> int:
        """For one force those before its flows and the step, with midpoints, in each substep, and those of its step."""
        return (6 + self.inner.stored_states) * len(self.fractions)

    @property
    def order(self) -> int:
        """At most two, the order of the symmetric splitting, or that of its composition."""
        return min(self.base.order, _order_of_composition(self.fractions))

    def check_backward(self, system: Any) -> None:
        """Raise ValueError if there are substeps backward in time and a force that does not run backward."""
        if len(self.fractions) == 1:
            return
        for label, force in zip(system.labels, system.forces, strict=True):
            if not (force.reversible or force.around_steps):
                raise ValueError(
                    f"{label} does not run backward, and {self.base} takes steps backward in time, as every scheme of "
                    f"order above two with forces; take {self.inner}"
                )

    def properties(self, system: Any) -> Properties:
        """Return the properties of the base on the Hamiltonian part, without those that the forces break."""
        if not system.forces:
            raise TypeError(f"{system.name} has no forces; take {type(self.base).__name__} alone")
        self.check_backward(system)
        inner = declared_properties(self.base, system.unforced)
        labelled = list(zip(system.labels, system.forces, strict=True))
        breaking = [label for label, force in labelled if not force.casimirs]
        moving = [label for label, force in labelled if not force.preserves_poisson(system.unforced)]
        working = [label for label, force in labelled if not force.preserves_energy(system.unforced)]
        broken = [("Poisson map", inner.poisson, moving), ("energy", inner.energy, working)]
        broken += [("Casimirs", inner.casimirs != "none", breaking)]
        broken_by = tuple(f"{name}: {', '.join(labels)}" for name, preserved, labels in broken if preserved and labels)
        return Properties(
            inner.poisson and not moving,
            inner.energy and not working,
            "none" if breaking else inner.casimirs,
            inner.attitude,
            broken_by,
        )

    def check_attitude(self, system: Any, representation: Any) -> None:
        self.base.check_attitude(system.unforced, representation)

    def split_jointly(self, systems: Sequence[Any]) -> list[SystemStack]:
        """Return systems with forces of the same classes that the base splits jointly, by the structure of tables."""
        from coadjoint.kernels.tables.forces import with_forces

        groups: dict[Any, list[int]] = {}
        for m, system in enumerate(systems):
            groups.setdefault(tuple(map(type, system.forces)), []).append(m)
        found: list[SystemStack] = []
        for members in groups.values():
            for stack in self.base.split_jointly([systems[m].unforced for m in members]):
                numbers = np.array(members)[stack.numbers]
                found += with_forces(stack._replace(systems=systems, numbers=numbers), self.order)
        return found

    def compiled(self, system: Any, h: float, representation: Representation) -> CompiledLoop:
        from coadjoint.kernels.tables.forces import forced_loop

        check_steps(system, self, 0.0, h)
        inner = {c: self.inner.loop(system.unforced, c * h, representation) for c in dict.fromkeys(self.fractions)}
        return forced_loop(system, inner, self.fractions, self.order, representation)

    def step(self, system: Any, x: Any, t: Any, h: Any) -> NDArray[Any]:
        """Return one step in NumPy; noise is that of the first member."""
        self.properties(system)
        if np.ndim(x) > 1 and system.unforced.has_matrices:
            return np.asarray(system.unforced.from_vector(self.step(system, system.unforced.to_vector(x), t, h)))
        y = np.array(x)  # steps and flows of the user may write into their states
        for position, part, begin, length in self.parts_of_step(system, t, h):
            if position is None:
                y = np.asarray(part.step(system.unforced, y, begin, length))
            else:
                y = part.flow_of_order(system.unforced, y, begin, length, self.order)
        return y

    def parts_of_step(self, system: Any, t: Any, h: Any) -> Iterator[tuple[int | None, Any, Any, Any]]:
        """Yield the position of a force (None: the Hamiltonian part), its flow or scheme, when it begins, how long."""
        flows = system.flows
        for begin, length, halves in halves_of_step(flows, self.fractions, t, h):
            yield from ((flows[j][0], on_side(flows[j][1], 0), *when) for j, *when in halves[0])
            yield None, self.inner, begin, length
            yield from ((flows[j][0], on_side(flows[j][1], 1), *when) for j, *when in halves[1])

    def tangent(self, system: Any, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return one step and its derivative: the product of those of the flows and of the base."""
        return self._with_tangent(system, x, t, h)[:2]

    def tangent_by(self, system: Any, x: Any, t: float, h: float) -> str:
        """Return the least accurate way in which a factor of the derivative is computed."""
        return max(self._with_tangent(system, x, t, h)[2], key=TANGENT_METHODS.index)

    def _with_tangent(self, system: Any, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any], list[str]]:
        self.properties(system)
        plain, y, P, by = system.unforced, np.asarray(x, dtype=np.float64), np.eye(system.dim), []
        for position, part, begin, length in self.parts_of_step(system, t, h):
            if position is None:
                by.append(part.tangent_by(plain, y, begin, length))
                y, derivative = part.tangent(plain, y, begin, length)
                P = derivative @ P
            else:
                flow = flow_of_force(part, plain, y, begin, length, self.order)
                y, P = flow.end, flow.tangents(P.T).T
                by.append(flow.by)
        return y, P, by

    def work(self, system: Any, group: Representation = None) -> Work:
        """Return the work of the base; forces are not counted."""
        return self.base.work(system.unforced, group)
