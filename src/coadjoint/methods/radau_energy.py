"""Radau IIA on the energy surface, as a differential-algebraic equation of index two (Remark 3.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.gauss_legendre import read_stages
from coadjoint.methods.numerics.gauss_coefficients import radau
from coadjoint.methods.numerics.solvers import Coefficients, StageProblem, begin, iterate_to_stagnation, linear_solve
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.protocol.step_method import CompiledStepMethod
from coadjoint.program.numbers import Number
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_vector_states, schemes_for

NO_MULTIPLIER = (
    "x . grad H(x) vanishes or changes its sign, and there the multiplier of the energy constraint is undefined; "
    "take another scheme"
)


@suggest_keywords
@dataclass(frozen=True)
class RadauEnergy(CompiledStepMethod):
    """Radau IIA for ``x' = f(x) + lambda x``, ``0 = H(x) - H(x_k)``: preserves the energy and nothing else.

    With s stages of order 2 s - 1: ``X_i = x + h sum_j a_ij (f(X_j) + lambda_j X_j)``, ``H(X_i) = H(x)``, ``x_new =
    X_s``. It supports any Hamiltonian that does not depend on time, where x . grad H is not zero. In the paper it is a
    counterexample: exact energy does not keep the motion on the level sets of Casimirs (``|x|^2`` of the rigid body
    drifts). For other purposes choose `Splitting`, `Taylor` or `GaussLegendre`.

    Parameters
    ----------
    stages : int
        Number of stages s, from 1 (the implicit Euler method on the energy surface).

    Raises
    ------
    ValueError
        `stages` is not a positive integer.

    References
    ----------
    S. Reich 1993, Remark 3.1; E. Hairer, C. Lubich, M. Roche, The Numerical Solution of Differential-Algebraic Systems
    by Runge-Kutta Methods (1989).

    Examples
    --------
    >>> import coadjoint as co
    >>> co.RadauEnergy(stages=2).order
    3
    """

    stages: int = 2

    explicit = False
    symmetric = False
    failures: ClassVar[Mapping[str, str]] = {"UNDEFINED": NO_MULTIPLIER}

    def __post_init__(self) -> None:
        object.__setattr__(self, "stages", read_stages(self.stages, "stages of RadauEnergy"))

    @property
    def order(self) -> int:
        """2 s - 1."""
        return 2 * self.stages - 1

    def properties(self, system: System) -> Properties:
        """Return the properties: the energy is preserved, quadratic or not."""
        check_vector_states(system)
        if system.hamiltonian.timed:
            raise ValueError(
                f"RadauEnergy keeps the energy, but that of {system.name} depends on time; "
                f"take {schemes_for(system, 'GaussLegendre or Splitting')}"
            )
        return Properties(poisson=False, energy=True, casimirs="none", attitude="none")

    @property
    def compiled_step(self) -> str:
        return "radau_energy"

    def constants(self) -> tuple[Sequence[int], Sequence[float]]:
        """Return s; and the weights b followed by mu."""
        _, weights, mu = radau(self.stages)
        return [self.stages], [*weights, *mu.ravel()]

    def step(self, system: System, x: Any, t: Any, h: Any) -> NDArray[Any]:
        """Return one step, computed in NumPy for any number type; IntegrationError if x . grad H vanishes."""
        step, slopes, _ = self._solve(system, x, t, h)
        return step.end(slopes)

    def tangent(self, system: System, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return one step and its exact derivative, by the implicit function theorem."""
        # nu_j = h b_j lambda_j, grad H(X_i) dX_i = grad H(x), dX_i = 1 + sum mu_ij ((h b_j f' + nu_j) dX_j + X_j dnu_j)
        step, slopes, multipliers = self._solve(system, np.asarray(x, dtype=np.float64), t, h)
        s, n, mu = self.stages, step.x.size, step.coefficients.mix
        points = step.points(slopes)
        blocks = step.jacobians(points) + multipliers[:, None, None] * np.eye(n)
        gradients = step.gradients(points)
        matrix = np.zeros((s * (n + 1), s * (n + 1)))
        rhs = np.zeros((s * (n + 1), n))
        for i in range(s):
            rows, constraint = slice(i * n, (i + 1) * n), s * n + i
            matrix[rows, rows] = rhs[rows] = np.eye(n)
            for j in range(s):
                matrix[rows, j * n : (j + 1) * n] -= mu[i, j] * blocks[j]
                matrix[rows, s * n + j] = -mu[i, j] * points[j]
            matrix[constraint, rows] = gradients[i]
            rhs[constraint] = system.hamiltonian.gradient(step.x, t)
        derivatives = np.linalg.solve(matrix, rhs)
        return step.end(slopes), derivatives[(s - 1) * n : s * n]

    def _solve(self, system: System, x: Any, t: Any, h: Any) -> tuple[StageProblem, NDArray[Any], NDArray[Any]]:
        """Return the step, its slopes L_j = h b_j f(X_j) + nu_j X_j, shape (s, n), and the multipliers nu_j."""
        self.properties(system)
        step = begin(self._tableau, system, x, t, h)
        mu = step.coefficients.mix
        initial_energy = system.energy(step.x, t)
        undefined = IntegrationError(NO_MULTIPLIER, step=1, time=float(t), residual=float("nan"))
        multipliers = step.x[:1].repeat(self.stages) * 0

        def slopes_at(points: NDArray[Any]) -> NDArray[Any]:
            slopes = step.fields(points) + multipliers[:, None] * points
            excess = np.array([[initial_energy - system.energy(X, t)] for X in step.points(slopes)])
            # One Newton iteration for the multipliers: dX_i/dnu_j = mu_ij X_j.
            matrix = mu * (step.gradients(points) @ points.T)
            if any(matrix[i, i] == 0 for i in range(self.stages)):
                raise undefined
            change = linear_solve(matrix, excess)[:, 0]
            multipliers[:] = multipliers + change
            return slopes + change[:, None] * points

        slopes = iterate_to_stagnation(step, slopes_at)
        points = np.concatenate([step.x[None], step.points(slopes)])
        projections = [X @ system.hamiltonian.gradient(X, t) for X in points]
        if any(projection * projections[0] <= 0 for projection in projections):
            raise undefined
        return step, slopes, multipliers

    def _tableau(self, number: Number = float) -> Coefficients:
        nodes, weights, mu = radau(self.stages, number)
        return Coefficients(nodes, weights, mu, np.array([number(1)] * self.stages))
