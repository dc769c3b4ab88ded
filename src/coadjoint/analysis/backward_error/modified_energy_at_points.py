"""Modified Hamiltonians of non-polynomial Hamiltonians, evaluated pointwise."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials
from coadjoint.program.modified_energy.composition_logarithm import Coordinates
from coadjoint.program.modified_energy.modified_series import modified_terms
from coadjoint.program.parts.taylor_shares import parts_at
from coadjoint.program.table import Program
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.validation import check_power, read_finite, read_number


class ModifiedEnergyAtPoints:
    """The function H + h^2 H2 + ... of a Hamiltonian with Python functions, evaluated pointwise.

    At each point the parts are expanded in Taylor polynomials with exact brackets. Derivatives up to the second are
    those of the Hamiltonian, so H + h^2 H2 of a symmetric scheme has their accuracy. Higher derivatives come from
    values on circles in the complex plane, with about ten digits; fewer than six raise an error. A point takes
    milliseconds at order 4, and a second at order 6 in six dimensions. `modified_hamiltonian` creates it.

    Attributes
    ----------
    order : int
        The terms are those below h^order.

    Examples
    --------
    >>> import coadjoint as co
    >>> wave = (np.cos, lambda y: -np.sin(y), lambda y: -np.cos(y))
    >>> H = co.Separable({0: wave, 1: wave, 2: wave})
    >>> system = co.LiePoissonSystem(co.algebras.so(3), H)
    >>> modified = co.modified_hamiltonian(system, co.Splitting(), order=4)
    >>> y = co.stepper(system, co.Splitting(), 0.1)([1.0, 0.5, 0.2])
    >>> x = [1.0, 0.5, 0.2]
    >>> abs(modified(y, 0.1) - modified(x, 0.1)) < 0.05 * abs(system.energy(y) - system.energy(x))
    True
    """

    def __init__(self, system: LiePoissonSystem, program: Program, coordinates: Coordinates, order: int) -> None:
        self.order = order
        self._system, self._program, self._coordinates = system, program, coordinates
        self._weights = [w for w in range(2, order + 1) if coordinates.of_weight[w]]

    @property
    def dim(self) -> int:
        """Number of coordinates."""
        return self._system.dim

    def __call__(self, x: Any, h: Any) -> Any:
        """Return the values at states.

        Parameters
        ----------
        x : array_like, shape (n,), (k, n) or (k, members, n)
            States.
        h : float
            Step, negative for backward.

        Returns
        -------
        float or ndarray
            One value for each state.
        """
        states, step = read_finite(x, "x"), read_number(h, "h")
        if states.ndim == 0 or states.shape[-1] != self.dim:
            raise ValueError(f"x has the shape {states.shape}; it must be (..., {self.dim})")
        check_power(step, self.order, "h")
        check_power(float(np.max(np.abs(states), initial=0.0)), 2 * self.order, "the largest entry of x")
        values = np.array([self._at(point, step) for point in states.reshape(-1, self.dim)])
        return values.reshape(states.shape[:-1]) if states.ndim > 1 else float(values[0])

    def __repr__(self) -> str:
        return f"<modified Hamiltonian of {self._system.name}, of order {self.order}, evaluated point by point>"

    def _at(self, x: NDArray[np.float64], h: float) -> float:
        total = 0.0
        if self._weights:
            degree = self._weights[-1] - 1
            ring = ExactPolynomials(self._system.algebra, point=x.tolist(), degree=degree)
            program = replace(self._program, parts=parts_at(self._program.parts, x, degree))
            terms = modified_terms(ring, self._system, program, self._coordinates, self._weights).of_power
            for power in reversed(terms):
                total += h**power * float(terms[power].monomials.get((0,) * self.dim, 0))
        return total + float(self._system.energy(x))
