"""The spherical midpoint method for spins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.numerics.solvers import Coefficients, StageProblem, begin, iterate_to_stagnation
from coadjoint.methods.protocol.cost_model import Work, work_of_iterations
from coadjoint.methods.protocol.method import Representation
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.protocol.step_method import CompiledStepMethod
from coadjoint.program.numbers import Number
from coadjoint.systems.coordinates import spins_in
from coadjoint.systems.step_derivatives import LinearizedStep, dense_step
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_vector_states, schemes_for

if TYPE_CHECKING:
    from coadjoint.methods.numerics.formal_series import FormalNumber

Floats = NDArray[np.float64]


@suggest_keywords
@dataclass(frozen=True)
class SphericalMidpoint(CompiledStepMethod):
    """The spherical midpoint method for spins: a Poisson map on copies of so(3), for any H; implicit, of order 2.

    ``x_new = x + h f(y)``, where y is, spin by spin, the midpoint of x and x_new, projected to the sphere of both:
    ``y_i = |x_i| (x_i + x_new_i) / |x_i + x_new_i|``. The lengths of all spins are preserved, and therefore every
    Casimir; each step is a Poisson map, so that the energy error stays bounded for long times. Choose it for spins
    whose H does not split into exact flows, such as functions of several spins; otherwise `Splitting` has the same
    properties, is explicit, and mostly cheaper. The Hamiltonian may depend on time. `GaussLegendre` also preserves the
    lengths, but is not a Poisson map.

    It supports so(3) and direct sums of copies of it, in any order of the coordinates, with additional coordinates that
    commute with all others. The equation is solved by iteration, which converges if h times the frequencies of the
    spins is below about 2.

    References
    ----------
    R. McLachlan, K. Modin, O. Verdier, Symplectic integrators for spin systems, Phys. Rev. E 89 (2014) 061301; A
    minimal-variable symplectic integrator on spheres, Math. Comp. 86 (2017) 2325.

    Examples
    --------
    >>> import coadjoint as co
    >>> import numpy as np
    >>> spins = co.algebras.copies(co.algebras.so(3), 3)
    >>> M = np.kron(1 - np.eye(3), np.diag([1.0, 1.0, 0.5]))
    >>> system = co.LiePoissonSystem(spins, co.Quadratic(M, linear=np.tile([0.0, 0.1, 0.3], 3)))
    >>> x0 = (1, 0, 0, 0, 0.6, 0.8, 0, 1, 0)
    >>> sol = co.integrate(system, x0, t_span=(0, 100), step=0.1, method=co.SphericalMidpoint())
    >>> bool(sol.drift()["|x|^2 [1]"] < 1e-14), bool(sol.drift()["energy"] < 0.02)
    (True, True)
    """

    order = 2
    explicit = False
    symmetric = True
    by_stages = True  # type: ignore[assignment]

    def properties(self, system: System) -> Properties:
        """Return the properties: the bracket and every Casimir are preserved, and for some H the energy."""
        # y is a multiple of the midpoint: H is kept if linear, or homogeneous quadratic, in one spin, or a sum of such.
        check_vector_states(system)
        spins = spins_of(system)
        return Properties(poisson=True, energy=_keeps_energy(system, spins), casimirs="all", attitude="none")

    @property
    def compiled_step(self) -> str:
        return "spherical_midpoint"

    def step(self, system: System, x: Any, t: Any, h: Any) -> NDArray[Any]:
        """Return one step, computed in NumPy for any number type with square roots."""
        step, slope = self._solve(system, x, t, h)
        return np.asarray(step.x + slope)

    def tangent(self, system: System, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return one step and its exact derivative; TypeError if a spin has length 0."""
        end, P, _ = self._differentiated(system, x, t, h)
        return end, P

    def linearized(self, system: System, x: Any, t: float, h: float) -> LinearizedStep:
        end, P, (y, by_field) = self._differentiated(system, x, t, h)
        stage = y, by_field @ (system.sign * system.structure_matrix(y))
        return dense_step(end, P)._replace(stages=lambda: [stage])

    def _differentiated(
        self, system: System, x: Any, t: float, h: float
    ) -> tuple[Floats, Floats, tuple[NDArray[Any], NDArray[Any]]]:
        """Return one step, its derivative by the state, and its stage y with the derivative by the field there."""
        # With y = r m / s, m = x + L/2, s its length, L = h f(y): dy = (r (1 - m m^T/s^2) dm + m x^T dx/r) / s.
        step, slope = self._solve(system, np.asarray(x, dtype=np.float64), t, h)
        n, middle = len(step.x), step.x + slope / 2
        by_middle, by_start = np.eye(n), np.zeros((n, n))
        for spin in spins_of(system):
            old, m = step.x[spin], middle[spin]
            r, size = np.linalg.norm(old), np.linalg.norm(m)
            if r == 0:
                raise TypeError("a spin of length 0 has no direction, and there the step has no derivative")
            block = np.ix_(spin, spin)
            by_middle[block] = r / size * (np.eye(3) - np.outer(m, m) / size**2)
            by_start[block] = np.outer(m, old) / (size * r)
        y = on_spheres(spins_of(system), step.x, middle)
        F = h * system.jacobian(y, t + h / 2)
        by_field = np.linalg.inv(np.eye(n) - F @ by_middle / 2)
        return step.x + slope, np.eye(n) + by_field @ F @ (by_middle + by_start), (y, h * by_field)

    def formal_step(self, system: System, x: NDArray[Any], h: FormalNumber) -> NDArray[Any]:
        raise TypeError("a step of SphericalMidpoint has square roots, and is no series in exact numbers")

    def _solve(self, system: System, x: Any, t: Any, h: Any) -> tuple[StageProblem, NDArray[Any]]:
        self.properties(system)
        spins = spins_of(system)
        step = begin(_tableau, system, x, t, h)
        slopes = iterate_to_stagnation(step, lambda points: step.fields(on_spheres(spins, step.x, points[0])[None]))
        return step, slopes[0]

    def work_of_substeps(self, system: System, group: Representation, substeps: int) -> Work:
        return work_of_iterations(system, group)


def _tableau(number: Number) -> Coefficients:
    half, one = number(1) / 2, number(1)
    return Coefficients(np.array([half]), np.array([one]), np.array([[half]]), np.array([one]))


def _keeps_energy(system: System, spins: NDArray[np.int64]) -> bool:
    """Return whether H is a sum over spins of functions that are linear, or quadratic without a linear part."""
    spin_of = np.full(system.dim, -1)
    spin_of[spins] = np.arange(len(spins))[:, None]
    linear, quadratic = np.zeros(system.dim), np.zeros(system.dim, dtype=bool)
    for term in system.hamiltonian.terms():
        if term.form is None:
            return False
        rows, columns = term.form.rows, term.form.indices
        if np.any(spin_of[rows] != spin_of[columns]):
            return False
        linear += term.form.linear
        quadratic[rows] = True
    both = set(spin_of[linear != 0].tolist()) & set(spin_of[quadratic].tolist())
    return not both - {-1}


def on_spheres(spins: NDArray[np.int64], x: NDArray[Any], m: NDArray[Any]) -> NDArray[Any]:
    """Return m with each spin rescaled to its length in x."""
    y = m.copy()
    squares = ((v[spins] ** 2).sum(axis=1) for v in (x, m))
    for spin, old, new in zip(spins, *squares, strict=True):
        if old != 0:
            y[spin] = m[spin] * (old / new) ** 0.5
    return y


def spins_of(system: System) -> NDArray[np.int64]:
    """Return the coordinates of each spin, shape (spins, 3), ordered by their first; ValueError for other algebras."""
    algebra = system.algebra
    found = None if getattr(algebra, "triples", None) is None else spins_in(algebra)
    if found is None:
        raise ValueError(
            f"SphericalMidpoint integrates spins, but {system.name} does not live on copies of so(3) in the "
            f"coordinates of the spins; take {schemes_for(system, 'Splitting or GaussLegendre')}"
        )
    return found.coordinates
