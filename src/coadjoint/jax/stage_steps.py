"""Steps of implicit Runge-Kutta methods as operations of JAX, with a fixed number of iterations."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from coadjoint.jax.sparse import sparse
from coadjoint.methods.numerics.solvers import Coefficients
from coadjoint.systems.hamiltonians.terms import FunctionTerm, PolynomialTerm
from coadjoint.systems.hamiltonians.user_hamiltonian import JaxFunction

ITERATIONS = 20
"""Function iterations of a step: an error that halves in each of them is then 1e-6 of that of the first guess."""
# Largest last correction of the stages, relative to them; those of a step that has not converged are NaN.
LARGEST_CORRECTION = 1e-10


class StageSteps:
    """Steps of an implicit Runge-Kutta method for a Hamiltonian of polynomials and functions of JAX.

    `monomials` have coefficients, which are the constants of the steps. Raises TypeError for other functions.
    """

    def __init__(self, system: Any, tableau: Coefficients, monomials: Any) -> None:
        self.tableau, self.sign, n = tableau, system.sign, system.dim
        degree = max((len(key) for key in monomials), default=0)
        self.monomials = np.array([[*key, *[n] * (degree - len(key))] for key in monomials], dtype=np.int64)
        others = [term for term in system.hamiltonian.terms() if term.form is None]
        self.functions = [term for term in others if not isinstance(term, PolynomialTerm)]
        for term in self.functions:
            if not (isinstance(term, FunctionTerm) and isinstance(term.value, JaxFunction)):
                raise TypeError(
                    'co.jax.solution with backend="xla" takes polynomials and functions of JAX, and the Hamiltonian of '
                    f'{system.name} has another function; write it with jax.numpy, or take backend="compiled"'
                )
        # Stored for i < j.
        i, j, k, c = system.algebra.triples
        self.products = np.append(j, i), np.append(k, k)
        self.rows = sparse(np.append(i, j), np.arange(2 * len(c)), np.append(c, -c), (n, 2 * len(c)))

    def constants(self, energy: Any) -> Any:
        """Return the coefficients of the energy."""
        return jnp.asarray(energy)

    def begin(self, constants: Any, x: Any, h: Any) -> Any:
        """Return the state, which is finished between steps."""
        return x

    def step(self, constants: Any, x: Any, t: Any, h: Any) -> Any:
        """Take a step; NaN if its iteration has not converged."""
        tableau = self.tableau
        lengths, times = (h * tableau.scale)[:, None], t + h * tableau.node
        fields = jax.vmap(self._field, (None, 0, 0))

        def improved(slopes: Any, _: Any) -> Any:
            found = lengths * fields(constants, x + tableau.mix @ slopes, times)
            return found, jnp.max(jnp.abs(found - slopes))

        start = jnp.zeros((len(times), len(x)))
        slopes, corrections = lax.scan(improved, start, None, length=ITERATIONS)
        converged = corrections[-1] <= LARGEST_CORRECTION * jnp.max(jnp.abs(slopes))
        return jnp.where(converged, x + slopes.sum(axis=0), jnp.nan)

    def finish(self, constants: Any, x: Any, h: Any) -> Any:
        """Return the state."""
        return x

    whole = step

    def _energy(self, x: Any, constants: Any, t: Any) -> Any:
        total = constants @ jnp.append(x, 1.0)[self.monomials].prod(axis=1) if len(self.monomials) else 0.0
        for term in self.functions:
            y = x[term.coordinates]
            function: Any = term.value
            total = total + function.function(y[0] if term.scalar else y, *((t,) if term.timed else ()))
        return total

    def _field(self, constants: Any, x: Any, t: Any) -> Any:
        gradient = jax.grad(self._energy)(x, constants, t)
        j, k = self.products
        return self.sign * self.rows.times(x[k] * gradient[j])
