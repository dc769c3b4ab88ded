"""Implicit Runge-Kutta steps with a fixed number of iterations, and the fields in them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from coadjoint.jax.traced_functions import TracedFunction, gradient_of
from coadjoint.methods.numerics.solvers import Coefficients
from coadjoint.systems.hamiltonians.terms import PolynomialTerm

ITERATIONS = 20
"""Function iterations of a step: an error that halves in each of them is then 1e-6 of that of the first guess."""
# Largest last correction of the stages, relative to them; those of a step that has not converged are NaN.
LARGEST_CORRECTION = 1e-10
# Terms of an exponential in a part of norm one, and the largest norm; beyond it the result is NaN.
TERMS, MOST_PARTS = 18, 4
# Entries of matrices that are stored with their zeros: products of small ones are faster than gathers.
MOST_DENSE = 2**12


class Sparse(NamedTuple):
    """A sparse matrix: dense if it is small, otherwise padded rows, with the column of each entry."""

    values: Any
    columns: Any

    def times(self, x: Any) -> Any:
        if self.columns is None:
            return (self.values * x).sum(-1)
        return (self.values * x[self.columns]).sum(-1)


def sparse(rows: Any, columns: Any, values: Any, shape: tuple[int, int]) -> Sparse:
    """Return the matrix with these entries, of which none is repeated; `values` may be traced."""
    rows, columns = np.asarray(rows, dtype=np.int64), np.asarray(columns, dtype=np.int64)
    if shape[0] * shape[1] <= MOST_DENSE:
        return Sparse(jnp.zeros(shape).at[rows, columns].add(values), None)
    order = np.argsort(rows, kind="stable")
    starts = np.searchsorted(rows[order], np.arange(shape[0] + 1))
    place = np.empty(len(rows), dtype=np.int64)
    place[order] = np.arange(len(rows)) - starts[rows[order]]
    width = int(np.max(np.diff(starts), initial=1))
    padded = np.zeros((shape[0], width), dtype=np.int64)
    padded[rows, place] = columns
    return Sparse(jnp.zeros((shape[0], width)).at[rows, place].add(values), padded)


def _unchanged(constants: Any, state: Any, *_: Any) -> Any:
    return state


class Steps(NamedTuple):
    """Steps of a scheme on (momentum, rows of a group element or None), unfinished between `begin` and `finish`.

    `begin` returns the unfinished state with the unit element; `finish` that with the attitude from the start of a run.
    `constants(energy)` are those for coefficients of the energy.
    """

    constants: Callable[[Any], Any]
    step: Callable[..., Any]
    """A step of an unfinished state: of constants, state, t, h and the number of the member."""
    whole: Callable[..., Any]
    """A step of a finished state to a finished state."""
    begin: Callable[..., Any] = _unchanged
    finish: Callable[..., Any] = _unchanged
    functions: tuple[TracedFunction, ...] = ()
    """The functions of the user in the steps."""


class StageField:
    """The field of a Hamiltonian of polynomials and functions, and exponentials of the algebra."""

    # `monomials` have coefficients, the energy in the arguments of the methods.

    def __init__(self, system: Any, monomials: Any) -> None:
        self.sign, n = system.sign, system.dim
        degree = max((len(key) for key in monomials), default=0)
        self.monomials = np.array([[*key, *[n] * (degree - len(key))] for key in monomials], dtype=np.int64)
        others = [term for term in system.hamiltonian.terms() if term.form is None]
        self._gradients = [
            (term.coordinates, gradient_of(term)) for term in others if not isinstance(term, PolynomialTerm)
        ]
        # Stored for i < j.
        i, j, k, c = system.algebra.triples
        self.products = np.append(j, i), np.append(k, k)
        self.rows = sparse(np.append(i, j), np.arange(2 * len(c)), np.append(c, -c), (n, 2 * len(c)))

    @property
    def functions(self) -> tuple[TracedFunction, ...]:
        return tuple(gradient for _, gradient in self._gradients)

    def at(self, energy: Any, x: Any, t: Any) -> Any:
        """Return sign J(x) grad H(x, t)."""
        return self.product(x, self.slopes(energy, x, t))

    def slopes(self, energy: Any, x: Any, t: Any) -> Any:
        """Return grad H(x, t)."""
        padded = jnp.append(x, 1.0)
        slopes = jnp.zeros_like(x)
        if len(self.monomials):
            slopes = jax.grad(lambda x: energy @ jnp.append(x, 1.0)[self.monomials].prod(axis=1))(x)
        for coordinates, gradient in self._gradients:
            slopes = slopes.at[coordinates].add(gradient.at(padded[coordinates], t))
        return slopes

    def product(self, x: Any, u: Any) -> Any:
        """Return sign J(x) u."""
        j, k = self.products
        return self.sign * self.rows.times(x[k] * u[j])

    def exponential(self, v: Any, x: Any) -> Any:
        """Return exp(D_v) x with D_v x = sign J(x) v; NaN if the norm of D_v is larger than `MOST_PARTS`."""

        def power(carry: Any, k: Any) -> Any:
            term, total = carry
            term = self.product(term, v) / (MOST_PARTS * k)
            return (term, total + term), None

        def part(x: Any, _: Any) -> Any:
            (_, total), _ = lax.scan(power, (x, jnp.zeros_like(x)), jnp.arange(1.0, TERMS + 1.0))
            return x + total, None

        norm = jnp.max(Sparse(jnp.abs(self.rows.values), self.rows.columns).times(jnp.abs(v[self.products[0]])))
        return jnp.where(norm <= MOST_PARTS, lax.scan(part, x, None, length=MOST_PARTS)[0], jnp.nan)


def stage_steps(field: StageField, tableau: Coefficients) -> Steps:
    """Return the steps of an implicit Runge-Kutta method; the constants are the coefficients of the energy."""

    def step(constants: Any, state: Any, t: Any, h: Any, member: Any) -> Any:
        x = state[0]
        lengths, times = (h * tableau.scale)[:, None], t + h * tableau.node
        fields = jax.vmap(field.at, (None, 0, 0))

        def improved(slopes: Any, _: Any) -> Any:
            found = lengths * fields(constants, x + tableau.mix @ slopes, times)
            return found, jnp.max(jnp.abs(found - slopes))

        first = jnp.zeros((len(times), len(x)))
        slopes, corrections = lax.scan(improved, first, None, length=ITERATIONS)
        converged = corrections[-1] <= LARGEST_CORRECTION * jnp.max(jnp.abs(slopes))
        return jnp.where(converged, x + slopes.sum(axis=0), jnp.nan), None  # NaN if the iteration has not converged

    return Steps(jnp.asarray, step, step, functions=field.functions)
