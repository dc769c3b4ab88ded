"""Projection of any scheme to the level set of the energy and of the Casimirs after every step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.loop import CompiledLoop, loop_over
from coadjoint.kernels.tables.steps import INNER_LOOP_INDEX, STEP_LOOP, wrapped_step_tables
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.explicit_runge_kutta import ExplicitRungeKutta
from coadjoint.methods.numerics.projection import (
    casimirs_restored,
    polynomial_casimirs,
    project,
    project_with_tangent,
    restored_invariants,
)
from coadjoint.methods.protocol.composed import Wrapper, check_base
from coadjoint.methods.protocol.cost_model import Work, work_of_projection
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.splitting import Splitting
from coadjoint.program.numbers import Number
from coadjoint.systems.system import System


@suggest_keywords
@dataclass(frozen=True)
class Projected(Wrapper):
    """A scheme with a projection: after each step, energy and polynomial Casimirs get their initial values again.

    A step z of the base becomes ``y = z + sum_a lambda_a grad C_a(z)``, where every C_a has the value that it had at
    the start of the run: energy and polynomial Casimirs do not drift, however long the run and whatever the base.
    Choose it to keep a prescribed scheme on its level set. It is not a Poisson map, even if the base is one: for
    long runs of a `Splitting` the base alone is better, and for accuracy `Taylor` has its own projection. Casimirs that
    are not polynomials are not preserved, even by a base that preserves them.

    The order is that of the base. A step is not symmetric, and therefore cannot be composed; project the `Composition`
    instead. Each step of the base starts afresh: `GaussLegendre` does not extrapolate from the previous step.

    Parameters
    ----------
    base : Method
        Any scheme.

    Raises
    ------
    TypeError
        The base is not a scheme.

    References
    ----------
    E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, IV.4.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> method = co.Projected(co.ExplicitRungeKutta("rk4"))
    >>> sol = co.integrate(body, (0.1, 1.0, 0.1), t_span=(0, 1000), step=0.1, method=method)
    >>> bool(sol.drift()["energy"] < 1e-14), bool(sol.drift()["|x|^2"] < 1e-14)
    (True, True)
    """

    base: Method

    explicit = False
    symmetric = False
    compensates = False

    def __post_init__(self) -> None:
        check_base(self.base, "Projected", "ExplicitRungeKutta('rk4')")

    @classmethod
    def examples(cls) -> Sequence[Projected]:
        """Return projections of flows and of stages."""
        return [cls(Splitting(order=2)), cls(ExplicitRungeKutta("rk4"))]

    def properties(self, system: System) -> Properties:
        """Return the properties: the energy, and the Casimirs that are polynomials, are preserved."""
        self.base.properties(system)
        if any(term.degree is None for term in system.hamiltonian.terms()):
            raise ValueError(
                f"Projected restores energies that are polynomials, but the Hamiltonian of {system.name} has a "
                f"function in it; give a polynomial, or take {type(self.base).__name__} alone"
            )
        return Properties(poisson=False, energy=True, casimirs=casimirs_restored(system), attitude="none")

    def restored(self, system: System) -> Mapping[str, Any]:
        return polynomial_casimirs(system)

    def compiled(self, system: System, h: float, representation: Representation) -> CompiledLoop:
        inner = self.base.loop(system, h)
        tables = wrapped_step_tables(system, "projected", inner, self.restored(system))
        return loop_over(STEP_LOOP, tables, referenced={INNER_LOOP_INDEX: inner})

    def step(self, system: System, x: Any, t: Any, h: Any) -> NDArray[Any]:
        """Return one step, computed in NumPy for any number type; the invariants keep their values at x."""
        self.properties(system)
        point = np.asarray(x)
        number: Number = float if point.dtype != object else type(point[0])
        end = np.asarray(self.base.step(system, point.copy(), t, h))  # a step of the user may write into its state
        return project(restored_invariants(system), point, end, number, float(t))[0]

    def tangent(self, system: System, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any]]:
        self.properties(system)
        start = np.asarray(x, dtype=np.float64)
        return project_with_tangent(system, start, *self.base.tangent(system, start, t, h), float(t))

    def work(self, system: System, group: Representation = None) -> Work:
        """Return the work of the base, and of a projection."""
        return work_of_projection(self.base.work(system), 1 + len(self.restored(system)))
