"""Any scheme on a system with forces: a step of the scheme between half flows of the forces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.protocol.method import Method, Representation, declared_properties
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.protocol.wrapper import Wrapper, check_base
from coadjoint.systems.forces.base import Force
from coadjoint.systems.forces.rates import has_matrix_state

if TYPE_CHECKING:
    from coadjoint.kernels.loop import CompiledLoop
    from coadjoint.methods.protocol.cost_model import Work
    from coadjoint.systems.system_stacks import SystemStack

TANGENT_METHODS = ("formula", "complex step", "differences")


def effective_scheme(system: Any, method: Method) -> Method:
    """Return the scheme of a run: `Forced` around the given scheme if the system has forces.

    TypeError: the given scheme is already `Forced`.
    """
    if isinstance(method, Forced):
        raise TypeError(f"{method} is applied by runs to systems with forces automatically; give {method.base}")
    return Forced(method) if system.forces else method


def check_supports(system: Any, method: Method) -> None:
    """Raise the error of a scheme for a system that it does not support, with forces or without."""
    effective_scheme(system, method).properties(system)


def check_steps(system: Any, t0: float, h: float) -> None:
    """Raise ValueError if a force cannot act in steps from t0: backward, or if samples are not at starts of steps.

    Examples
    --------
    >>> import coadjoint as co
    >>> check_steps(co.systems.rigid_body(), 0.0, -0.1)
    """
    if not system.forces:
        return
    for one in system.distinct:
        for force in one.forces:
            force.check_steps(t0, h)


class FlowOfForce(NamedTuple):
    """The flow of a force with its derivative: a number, a diagonal (n,), or a matrix (n, n); `by` says how."""

    end: NDArray[np.float64]
    derivative: NDArray[np.float64]
    by: str

    def tangents(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the tangents (k, n) after the flow for those before it."""
        return np.asarray((self.derivative @ rows.T).T if self.derivative.ndim == 2 else self.derivative * rows)

    def cotangent(self, row: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the cotangent (n,) before the flow for that after it."""
        return np.asarray(row @ self.derivative if self.derivative.ndim == 2 else self.derivative * row)


def flow_of_force(force: Force, system: Any, x: NDArray[np.float64], t: float, tau: float) -> FlowOfForce:
    """Return the flow of a force on the Hamiltonian part with its derivative.

    That of a function on matrices is taken after a projection on the algebra, so that gradients lie in it.
    """
    from coadjoint.methods.protocol.step_derivatives import derivative_of

    known = force.tangent(system, x, t, tau)
    if known is not None:
        end = np.asarray(force.flow(system, x, t, tau), dtype=np.float64)
        return FlowOfForce(end, np.asarray(known, dtype=np.float64), "formula")
    found = derivative_of(lambda z: force.flow(system, z, t, tau), x)
    derivative = found.derivative
    if has_matrix_state(system):
        derivative = system.to_vector(system.algebra.projected(system.from_vector(derivative)))
    return FlowOfForce(found.value, np.asarray(derivative), found.by)


@dataclass(frozen=True)
class Forced(Wrapper):
    """A scheme for a system with forces, as a symmetric splitting: order two, or one if the scheme has order one.

    A step consists of the half flows of the forces in their order, a step of the base for the Hamiltonian part, and the
    half flows in reverse order. Each step of the base starts afresh, except for the initial guesses of schemes for
    matrices. `integrate`, `prepare` and `stepper` apply it automatically if a system has forces; use it directly for
    `properties`, which names what is preserved and what breaks the rest.

    Parameters
    ----------
    base : Method
        Any scheme that supports the Hamiltonian part.

    Raises
    ------
    TypeError
        The base is not a scheme.

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

    @property
    def order(self) -> int:
        """At most two, the order of the symmetric splitting."""
        return min(2, self.base.order)

    def properties(self, system: Any) -> Properties:
        """Return the properties of the base on the Hamiltonian part, without those that the forces break."""
        if not system.forces:
            raise TypeError(f"{system.name} has no forces; take {type(self.base).__name__} alone")
        inner = declared_properties(self.base, system.unforced)
        breaking = [label for label, force in system.labelled_forces if not force.casimirs]
        every = list(system.labels)
        broken = [("Poisson map", inner.poisson, every), ("energy", inner.energy, every)]
        broken += [("Casimirs", inner.casimirs != "none", breaking)]
        broken_by = tuple(f"{name}: {', '.join(labels)}" for name, preserved, labels in broken if preserved and labels)
        return Properties(False, False, "none" if breaking else inner.casimirs, inner.attitude, broken_by)

    def check_attitude(self, system: Any, representation: Any) -> None:
        """Raise the error of the base, which moves the group element, for the Hamiltonian part."""
        self.base.check_attitude(system.unforced, representation)

    def split_jointly(self, systems: Sequence[Any]) -> list[SystemStack]:
        """Return systems with equal forces, except for constant torques, that the base splits jointly."""
        from coadjoint.systems.system_stacks import stacks_with_forces

        return stacks_with_forces(systems, self.base.split_jointly)

    def compiled(self, system: Any, h: float, representation: Representation) -> CompiledLoop:
        """Return a loop with a step of the loop of the base in each step."""
        from coadjoint.kernels.tables.forces import forced_loop

        check_steps(system, 0.0, h)
        return forced_loop(system, self.base.loop(system.unforced, h, representation), representation)

    def step(self, system: Any, x: Any, t: Any, h: Any) -> NDArray[Any]:
        """Return one step in NumPy; noise is that of the first member."""
        self.properties(system)
        if np.ndim(x) > 1 and hasattr(system.unforced, "from_vector"):
            return np.asarray(system.unforced.from_vector(self.step(system, system.unforced.to_vector(x), t, h)))
        half, y = 0.5 * h, np.asarray(x)
        for force in system.forces:
            y = force.flow(system.unforced, y, t, half)
        y = np.asarray(self.base.step(system.unforced, y, t, h))
        for force in reversed(system.forces):
            y = force.flow(system.unforced, y, t + half, half)
        return y

    def tangent(self, system: Any, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return one step and its derivative: the product of those of the flows and of the base."""
        return self._with_tangent(system, x, t, h)[:2]

    def tangent_by(self, system: Any, x: Any, t: float, h: float) -> str:
        """Return the least accurate way in which a factor of the derivative is computed."""
        return max(self._with_tangent(system, x, t, h)[2], key=TANGENT_METHODS.index)

    def _with_tangent(self, system: Any, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any], list[str]]:
        self.properties(system)
        plain, half, y, P, by = system.unforced, 0.5 * h, np.asarray(x, dtype=np.float64), np.eye(system.dim), []

        def chain_tangent(force: Force, time: float) -> None:
            nonlocal y, P
            flow = flow_of_force(force, plain, y, time, half)
            y, P = flow.end, flow.tangents(P.T).T
            by.append(flow.by)

        for force in system.forces:
            chain_tangent(force, t)
        by.append(self.base.tangent_by(plain, y, t, h))
        y, derivative = self.base.tangent(plain, y, t, h)
        P = derivative @ P
        for force in reversed(system.forces):
            chain_tangent(force, t + half)
        return y, P, by

    def work(self, system: Any, group: Representation = None) -> Work:
        """Return the work of the base; forces are not counted."""
        return self.base.work(system.unforced, group)
