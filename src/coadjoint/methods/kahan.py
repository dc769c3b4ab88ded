"""Kahan's linearly implicit method for quadratic fields."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.numerics.solvers import linear_solve
from coadjoint.methods.protocol.cost_model import Work, work_of_evaluations
from coadjoint.methods.protocol.method import Representation
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.protocol.step_method import CompiledStepMethod
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_vector_states, schemes_for

if TYPE_CHECKING:
    from collections.abc import Mapping

TYPICAL_COLUMNS = 24  # typical number of products with f' in a step of many dimensions


@suggest_keywords
@dataclass(frozen=True)
class Kahan(CompiledStepMethod):
    """Kahan's method for quadratic fields: symmetric, order 2, one linear system per step; preserves nothing exactly.

    ``(1 - h/2 f'(x)) (x_new - x) = h f(x)``, a rational map whose inverse is the same map with -h. It supports every
    Lie algebra with a quadratic H, including linear terms, and a `PoissonSystem` with quadratic H and J affine in x.
    Choose it to study integrable maps (the rigid body becomes the Hirota-Kimura top, which has invariants of its own),
    or as the base of a `Composition` without iterations. For long runs choose `Splitting`, which is mostly cheaper and
    preserves bracket and Casimirs: the errors of energy and Casimirs are O(h^2), without drift on regular motions of
    symmetric systems, and unbounded otherwise.

    Where the determinant of the linear system changes its sign between the steps by 0 and by h, the state jumps through
    infinity and comes back, with finite numbers that belong to another motion.

    The linear system is factorized in up to 200 dimensions, and solved by GMRES in more.

    References
    ----------
    W. Kahan, Unconventional numerical methods for trajectory calculations (1993); R. Hirota, K. Kimura, J. Phys. Soc.
    Jpn. 69 (2000) 627; E. Celledoni, R. McLachlan, B. Owren, G. Quispel, J. Phys. A 46 (2013) 025201.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> sol = co.integrate(body, (0.1, 1.0, 0.1), t_span=(0, 1000), step=0.1, method=co.Kahan())
    >>> bool(1e-6 < sol.drift()["energy"] < 1e-2)
    True
    """

    order = 2
    explicit = False
    symmetric = True
    failures: ClassVar[Mapping[str, str]] = {"UNDEFINED": "1 - h/2 f'(x) is singular: there is no next state"}

    def properties(self, system: System) -> Properties:
        """Return the properties: nothing is preserved; ValueError for a field that is not quadratic."""
        check_vector_states(system)
        if not system.has_quadratic_energy:
            raise ValueError(
                f"Kahan needs a quadratic vector field, but the Hamiltonian of {system.name} is not quadratic or "
                f"depends on time; take {schemes_for(system, 'Splitting or GaussLegendre')}"
            )
        if system.algebra is None and not _has_linear_structure(system):
            raise ValueError(
                f"Kahan needs a quadratic vector field, but J of {system.name} is not linear in x; take GaussLegendre"
            )
        return Properties(poisson=False, energy=False, casimirs="none", attitude="none")

    @property
    def compiled_step(self) -> str:
        return "kahan"

    def step(self, system: System, x: Any, t: Any, h: Any) -> NDArray[Any]:
        """Return one step, computed in NumPy for any number type."""
        self.properties(system)
        point = np.asarray(x)
        matrix = np.eye(len(point), dtype=np.int64) - h / 2 * _derivative(system, point, t)
        return point + linear_solve(matrix, (h * system.vector_field(point, t))[:, None])[:, 0]

    def tangent(self, system: System, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return one step and its exact derivative, ``(1 - h/2 f'(x))^-1 (1 + h/2 f'(x_new))``: f' is linear in x."""
        start = np.asarray(x, dtype=np.float64)
        end, identity = self.step(system, start, t, h), np.eye(len(start))
        before, after = (h / 2 * _derivative(system, point, t) for point in (start, end))
        return end, linear_solve(identity - before, identity + after)

    def work_of_substeps(self, system: System, group: Representation, substeps: int) -> Work:
        return work_of_evaluations(system, 1 + min(system.dim, TYPICAL_COLUMNS), self.explicit, substeps)


def _derivative(system: System, x: NDArray[Any], t: Any) -> NDArray[Any]:
    """Return f'(x) of a quadratic field; if J is a function, by differences, which are then exact."""
    if system.algebra is not None:
        return np.asarray(system.jacobian(x, t))
    size = max(abs(x)) or 1
    offsets = size * np.eye(len(x), dtype=np.int64)
    pairs = [system.vector_field(x + offset, t) - system.vector_field(x - offset, t) for offset in offsets]
    return np.stack(pairs, axis=1) / (2 * size)


@lru_cache(maxsize=64)
def _has_linear_structure(system: System) -> bool:
    """Return whether J(a + b) + J(0) = J(a) + J(b), up to rounding, at random states."""
    random = np.random.default_rng(1993)
    J = system.structure_matrix
    for size in (1.0, 1.0, 32.0):
        a, b = size * random.standard_normal((2, system.dim))
        with np.errstate(all="ignore"):
            try:
                matrices = [np.asarray(J(point), dtype=np.float64) for point in (a + b, 0 * a, a, b)]
            except (ArithmeticError, ValueError):  # a linear function is defined everywhere
                return False
        deviation = np.abs(matrices[0] + matrices[1] - matrices[2] - matrices[3])
        largest = max(np.max(np.abs(matrix)) for matrix in matrices)
        if not np.all(deviation <= 64 * system.dim * UNIT_ROUNDOFF * largest):
            return False
    return True
