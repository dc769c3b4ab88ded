"""Selective decay: a force that lowers the enstrophy, or another quadratic Casimir, at constant energy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.forces.base import Force, ForceReader
from coadjoint.systems.forces.orbit_flow import bracket_of
from coadjoint.systems.matrices.matrix_invariants import applied
from coadjoint.validation import read_nonnegative

Floats = NDArray[np.float64]

# As in ``forces/selective_decay.hpp``, of Newton's method and of GMRES.
MAX_CORRECTIONS = 24
LAST_DIGIT, NEAR, ROUGH, REDUCTION = 2.0**-53, 2.0**-26, 2.0**-6, 2.0**-26
RESTART, CYCLES = 24, 16
DIFFERENCE_STEP = 2.0**-17  # of central differences, relative to the state
ANTISYMMETRIC = 1e-12  # of J(x) x, relative to its terms: below it the sum of squares is a Casimir


class _Brackets(NamedTuple):
    """The part of a state that decays, and [v, y], grad H and its derivative along d in the numbers of this part."""

    part: slice
    product: Callable[[Any, Any], NDArray[Any]]
    gradient: Callable[[Any, Any], NDArray[Any]]
    change: Callable[[Any, Any, Any], NDArray[Any]]


@suggest_keywords
@dataclass(frozen=True)
class SelectiveDecay(Force):
    """Selective decay, ``W' = rate [P, [P, W]]``: lowers the enstrophy and preserves the energy, for fluids and spins.

    Choose it as a model of unresolved scales of a fluid in two dimensions, which lose enstrophy, but hardly any energy,
    or to reach steady flows; it is the method of the anticipated vorticity, with the Casimir dissipation of
    Gay-Balmaz and Holm. P is the stream matrix, the gradient of the energy H, of the motion ``W' = [P, W]``. Since
    ``[P, .]`` is antisymmetric, ``dH/dt = 0``, and the enstrophy never grows:
    ``d/dt |W|^2/2 = -rate |[P, W]|^2``. Its steady states are all steady flows, ``[P, W] = 0``. Those of least
    enstrophy at their energy, ``W = lambda P`` in the gravest modes, are among them, but in general a run ends at
    another one: the flow along streamlines is averaged, and zonal flows, for instance, do not decay.

    On vectors it is ``x' = rate D_u D_u x`` with ``u = grad H`` and ``J(x) u = D_u x``, for algebras in whose basis the
    sum of squares is a Casimir, such as so(n) and spins; then ``|x|^2`` decays. A rigid body ends in a rotation about a
    principal axis, ``grad H = lambda x``, that of the smallest moment of inertia unless it starts at another one.

    It acts on the absolute vorticity of a rotating sphere, and preserves the energy of the relative motion. Of a fluid
    with a passive scalar it acts on the vorticity alone. Angular momentum is not preserved.

    Its flow is the implicit midpoint rule, of order 2, symmetric, solved to round-off by Newton's method: quadratic
    energies, such as those of fluids and bodies, are preserved to round-off (others to order 2), and the enstrophy
    decreases, for every step that can be solved. This is so if ``rate h |P|^2`` is below about one, with ``|P|`` the
    largest eigenvalue, and for larger ones near a steady flow. Backward in time it is an anti-diffusion, which is
    refused.

    Parameters
    ----------
    rate : float
        Rate theta, not negative. [P, .] is an inverse time, so its unit is that of the time: rate times the square of
        a frequency of the flow is the rate at which the vorticity is averaged along streamlines.

    Raises
    ------
    ValueError, TypeError
        The rate is negative or no finite number; or, from ``with_forces``, the sum of squares is no Casimir, or the
        carried field acts on the flow (`reduced_mhd`), where no quadratic Casimir decays.
    IntegrationError
        From a run: the equation of a step has no solution that is found. Take a smaller step.

    References
    ----------
    F. Gay-Balmaz, D. D. Holm, Selective decay by Casimir dissipation in inviscid fluids, Nonlinearity 26 (2013) 495;
    R. Sadourny, C. Basdevant, Parameterization of subgrid scale barotropic and baroclinic eddies in quasi-geostrophic
    models: anticipated potential vorticity method, J. Atmos. Sci. 42 (1985) 1353.

    Examples
    --------
    >>> import coadjoint as co
    >>> import numpy as np
    >>> s = co.systems.sphere_euler(N=12)
    >>> W0 = s.random(seed=1, degrees=(1, 5), energy=1.0)
    >>> decaying = s.with_forces(co.forces.SelectiveDecay(0.5))
    >>> sol = co.integrate(decaying, W0, t_span=(0, 20), step=0.05, method=co.IsospectralGauss(), save_every=40)
    >>> enstrophy = sol.casimirs["tr W^2"]
    >>> bool(np.all(np.diff(enstrophy) < 0)), bool(abs(sol.work["SelectiveDecay"]["energy"][-1]) < 1e-12)
    (True, True)
    """

    rate: float

    example: ClassVar = {"rate": 0.05}
    reversible: ClassVar[bool] = False

    def __post_init__(self) -> None:
        self._read(rate=read_nonnegative)

    def preserves_energy(self, system: Any) -> bool:
        """Whether the energy is quadratic, which the midpoint rule preserves."""
        return bool(system.linear_stream if system.has_matrices else system.has_quadratic_energy)

    def check(self, system: Any) -> None:
        name = self.label
        if system.has_matrices:
            if not system.algebra.skew:
                raise ValueError(f"{name} acts on skew-Hermitian matrices; those of {system.algebra} are not")
            if system.independent_layers:
                raise ValueError(f"{name} acts on a fluid of one layer; {system.name} has layers; take Viscosity")
            if system.second_stream is not None:
                raise ValueError(
                    f"{name} lowers tr W^2, no Casimir of {system.name}, whose carried field acts on the flow; take "
                    "passive_scalar, or Viscosity"
                )
            return
        if not system.has_structure_constants:
            raise ValueError(f"{name} needs structure constants, which {system.name} does not have; take LinearDamping")
        x = np.cos(1.0 + np.arange(system.dim))  # all coordinates differ
        bracket = bracket_of(system.algebra, system.sign)
        terms = np.abs(bracket.c * x[bracket.k] * x[bracket.j]).sum(axis=0).max(initial=0.0)
        if not np.max(np.abs(bracket.product(x, x)), initial=0.0) <= ANTISYMMETRIC * terms:
            raise ValueError(
                f"{name} lowers the sum of squares, which is no Casimir of {system.name} in these coordinates; take a "
                "system on so(n), spins, or a fluid"
            )

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        part, product, gradient, _ = _brackets(system)
        y, result = x[part], np.zeros_like(x)
        u = gradient(y, t)
        result[part] = self.rate * product(u, product(u, y))
        return result

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        if tau < 0.0:
            raise ValueError(f"{self.label} does not run backward, in which it would be an anti-diffusion")
        brackets, end = _brackets(system), np.array(x, dtype=np.float64)
        y = end[brackets.part]
        end[brackets.part] = y + 2.0 * (self._midpoint(brackets, y, t, tau) - y)
        return end

    def _midpoint(self, brackets: _Brackets, y: Floats, t: Any, tau: Any) -> Floats:
        """Return the solution of m = y + (rate tau/2) [u, [u, m]], u = grad H(m)."""
        from scipy.sparse.linalg import LinearOperator, gmres

        c, moment, m, residual = 0.5 * self.rate * tau, t + 0.5 * tau, y, np.inf
        for _ in range(MAX_CORRECTIONS):
            u = brackets.gradient(m, moment)
            inner = brackets.product(u, m)
            rest = c * brackets.product(u, inner) + (y - m)
            residual, size = float(np.max(np.abs(rest))), float(np.max(np.abs(m)))
            if residual <= LAST_DIGIT * size or not np.isfinite(residual):
                break
            last = residual <= NEAR * size

            def operate(d: Floats, m: Floats = m, u: Floats = u, inner: Floats = inner) -> Floats:
                return d - c * _derivative(brackets, m, u, inner, d, moment)

            operator, unit = LinearOperator((len(y), len(y)), operate, dtype=np.float64), 1.0 / residual
            left = max(LAST_DIGIT * size / residual if last else min(ROUGH, residual / size), REDUCTION)
            change, unsolved = gmres(operator, unit * rest, rtol=left, atol=0.0, restart=RESTART, maxiter=CYCLES)
            if unsolved:
                break
            m = m + residual * change
            if last:
                return m
        if np.isfinite(residual) and residual <= LAST_DIGIT * float(np.max(np.abs(m))):
            return m
        raise IntegrationError(
            f"the midpoint rule of {self.label} did not converge; take a smaller step",
            step=1,
            time=float(t),
            residual=residual,
        )

    def tangent(self, system: Any, x: NDArray[Any], t: float, tau: float) -> NDArray[np.float64] | None:
        """Return the derivative of the midpoint rule, 2 (1 - c A)^-1 - 1 with the derivative A of the field."""
        brackets, c, moment = _brackets(system), 0.5 * self.rate * tau, t + 0.5 * tau
        whole = np.eye(len(x))
        if system.has_matrices:
            # Units are projected: gradients then lie in the algebra.
            whole = system.to_vector(system.algebra.projected(system.from_vector(whole)))
        m = self._midpoint(brackets, np.asarray(x[brackets.part], dtype=np.float64), t, tau)
        u = brackets.gradient(m, moment)
        inner, units = brackets.product(u, m), whole[brackets.part, brackets.part]
        A = np.stack([_derivative(brackets, m, u, inner, unit, moment) for unit in units], axis=1)
        whole[brackets.part, brackets.part] = 2.0 * np.linalg.solve(np.eye(len(m)) - c * A, units) - units
        return np.asarray(whole)

    def scalings(self, system: Any) -> dict[str, tuple[Any, ...]]:
        return {"rate": (1.0,)}

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        return reader.selective_decay(self.rate, system)


def _derivative(brackets: _Brackets, m: Any, u: Any, inner: Any, d: Any, t: Any) -> NDArray[Any]:
    """Return the derivative of [u, [u, m]] along d; `inner` is [u, m]."""
    product, slope = brackets.product, brackets.change(m, d, t)
    return np.asarray(product(u, product(u, d) + product(slope, m)) + product(slope, inner))


def _brackets(system: Any) -> _Brackets:
    if not system.has_matrices:
        bracket, hamiltonian = bracket_of(system.algebra, system.sign), system.hamiltonian

        def change(y: Any, d: Any, t: Any) -> NDArray[Any]:
            wide = float(np.max(np.abs(d), initial=0.0))
            if wide == 0.0:
                return np.zeros_like(d)
            step = DIFFERENCE_STEP * (float(np.max(np.abs(y))) or 1.0) / wide
            ahead, behind = (hamiltonian.gradient(y + side * step * d, t) for side in (1.0, -1.0))
            return np.asarray((ahead - behind) / (2.0 * step))

        return _Brackets(slice(None), lambda v, y: bracket.product(y, v), hamiltonian.gradient, change)
    algebra, stream, linear = system.algebra, system.stream, system.linear
    linear = linear[0] if np.ndim(linear) == 3 else linear  # that of the vorticity
    shape, kind = algebra.shape, np.complex128 if system.complex else np.float64
    size = (1 + system.complex) * algebra.N**2

    def matrix(y: Any) -> NDArray[Any]:
        return np.ascontiguousarray(y, dtype=np.float64).view(kind).reshape(shape)

    def numbers(W: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(W, dtype=kind).reshape(-1).view(np.float64)

    def slope(y: Any, t: Any) -> NDArray[Any]:
        return applied(stream, matrix(y), t)

    return _Brackets(
        slice(system.dim - size, None),  # the vorticity is the last layer
        lambda v, y: numbers(algebra.bracket(matrix(v), matrix(y))),
        lambda y, t: numbers(slope(y, t) if linear is None else slope(y, t) + linear),
        lambda y, d, t: numbers(slope(d, t)),
    )
