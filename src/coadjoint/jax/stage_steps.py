"""Implicit Runge-Kutta steps with a fixed number of iterations, and the fields in them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.ad_checkpoint import checkpoint_name

from coadjoint.jax.traced_functions import TracedFunction, gradient_of
from coadjoint.methods.force_flows import EnergyNumbers
from coadjoint.methods.numerics.fixed_point import (
    allowed_change,
    corrections,
    is_undecided,
    is_unfinished,
    sampled,
)
from coadjoint.methods.numerics.solvers import MOST_ITERATIONS, Coefficients
from coadjoint.program.coadjoint_exponential import common_square, exponential
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.hamiltonians.terms import PolynomialTerm

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


SAVED = "fixed point"
"""Name of the fixed points that reverse mode stores in place of solving for them again."""


def _iterated(function: Callable[[Any], Any], first: Any, size: Any, most: int) -> Any:
    """Return the limit of iterations from a first guess, NaN without one; entries have the round-off of `size` too."""

    def unfinished(carry: Any) -> Any:
        _, _, correction, _, stalled, k = carry
        return is_unfinished(correction, stalled) & (k < most)

    def improved(carry: Any) -> Any:
        z, _, _, least, stalled, k = carry
        found = function(z)
        correction = jnp.max(corrections(jnp, z, found, size))
        stalled = jnp.where(correction < least, 0, stalled + 1)
        return found, jnp.max(jnp.abs(found - z)), correction, jnp.minimum(least, correction), stalled, k + 1

    z, change, *_ = lax.while_loop(unfinished, improved, (first, jnp.inf, jnp.inf, jnp.inf, 0, 0))
    extent, own = jnp.max(jnp.abs(z)), jnp.max(size)
    entries = jnp.arange(1.0, z.size + 1.0).reshape(z.shape)

    def undecided(carry: Any) -> Any:
        (_, change, allowed), sample = carry
        return is_undecided(change, allowed, extent, own, sample)

    def next_sample(carry: Any) -> Any:
        known, sample = carry
        return sampled(jnp, jnp.max, function, entries, size, sample, *known), sample + 1

    (z, change, allowed), _ = lax.while_loop(undecided, next_sample, ((z, change, allowed_change(extent, own)), 1))
    return jnp.where(change <= allowed, z, jnp.nan)


def fixed_point(function: Callable[[Any], Any], first: Any, size: Any = 0.0, most: int = MOST_ITERATIONS) -> Any:
    """Return z = function(z) by iterations from a first guess, differentiated as the solution of this equation."""

    def residual(z: Any) -> Any:
        return function(z) - z

    def solve(_: Any, z: Any) -> Any:
        return _iterated(function, z, lax.stop_gradient(size), most)

    def solve_linear(matrix: Callable[[Any], Any], b: Any) -> Any:
        return _iterated(lambda z: matrix(z) + z - b, jnp.zeros_like(b), jnp.max(jnp.abs(b)), most)

    def solve_tangent(matrix: Callable[[Any], Any], b: Any) -> Any:
        return lax.custom_linear_solve(matrix, b, solve_linear, solve_linear)

    return checkpoint_name(lax.custom_root(residual, first, solve, solve_tangent), SAVED)


def _unchanged(constants: Any, state: Any, *_: Any) -> Any:
    return state


class Steps(NamedTuple):
    """Steps of a scheme on (momentum, rows of a group element or None), unfinished between `begin` and `finish`.

    `begin` returns the unfinished state with the unit element; `finish` that with the attitude from the start of a run.
    `constants(energy)` are those for `EnergyNumbers`.
    """

    constants: Callable[[EnergyNumbers], Any]
    step: Callable[..., Any]
    """A step of an unfinished state: of constants, state, t, h and the number of the member."""
    whole: Callable[..., Any]
    """A step of a finished state to a finished state."""
    begin: Callable[..., Any] = _unchanged
    finish: Callable[..., Any] = _unchanged
    functions: tuple[TracedFunction, ...] = ()
    """The functions of the user in the steps."""
    undo: Callable[..., Any] | None = None
    """The inverse of `step`, of the same arguments; None if it has none."""


class CoadjointAction:
    """The products sign J(x) u of a Lie algebra, and the coadjoint action, its exponentials."""

    def __init__(self, algebra: Any, sign: int) -> None:
        self.sign = sign
        # Stored for i < j.
        i, j, k, c = algebra.triples
        self.products = np.append(j, i), np.append(k, k)
        self.rows = sparse(np.append(i, j), np.arange(2 * len(c)), np.append(c, -c), (algebra.dim, 2 * len(c)))
        self._square = common_square(algebra)

    def product(self, x: Any, u: Any) -> Any:
        """Return sign J(x) u."""
        j, k = self.products
        return self.sign * self.rows.times(x[k] * u[j])

    def exponential(self, v: Any, x: Any) -> Any:
        """Return exp(D_v) x with D_v x = sign J(x) v; NaN by the series if the norm is larger than `MOST_PARTS`."""
        if self._square is None:
            return self._by_series(v, x)
        return exponential(jnp, jax.grad, self.product, self._square, v, x)

    def _by_series(self, v: Any, x: Any) -> Any:
        def power(carry: Any, k: Any) -> Any:
            term, total = carry
            term = self.product(term, v) / (MOST_PARTS * k)
            return (term, total + term), None

        def part(x: Any, _: Any) -> Any:
            (_, total), _ = lax.scan(power, (x, jnp.zeros_like(x)), jnp.arange(1.0, TERMS + 1.0))
            return x + total, None

        norm = jnp.max(Sparse(jnp.abs(self.rows.values), self.rows.columns).times(jnp.abs(v[self.products[0]])))
        return jnp.where(norm <= MOST_PARTS, lax.scan(part, x, None, length=MOST_PARTS)[0], jnp.nan)


class StageField(CoadjointAction):
    """The field of a Hamiltonian of polynomials and functions, whose numbers are arguments of the methods."""

    def __init__(self, system: Any, monomials: Any) -> None:
        super().__init__(system.algebra, system.sign)
        n = system.dim
        degree = max((len(key) for key in monomials), default=0)
        self.monomials = np.array([[*key, *[n] * (degree - len(key))] for key in monomials], dtype=np.int64)
        others = [term for term in system.hamiltonian.terms() if term.form is None]
        self._gradients = [
            (term.coordinates, gradient_of(term)) for term in others if not isinstance(term, PolynomialTerm)
        ]

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
            slopes = jax.grad(lambda x: energy.coefficients @ jnp.append(x, 1.0)[self.monomials].prod(axis=1))(x)
        for coordinates, gradient in self._gradients:
            slopes = slopes.at[coordinates].add(gradient.at(padded[coordinates], t, energy.params))
        return slopes


def stage_steps(field: StageField, tableau: Coefficients) -> Steps:
    """Return the steps of an implicit Runge-Kutta method; the constants are the numbers of the energy."""

    def step(constants: Any, state: Any, t: Any, h: Any, member: Any) -> Any:
        x = state[0]
        lengths, times = (h * tableau.scale)[:, None], t + h * tableau.node
        fields = jax.vmap(field.at, (None, 0, 0))

        def improved(slopes: Any) -> Any:
            return lengths * fields(constants, x + tableau.mix @ slopes, times)

        slopes = fixed_point(improved, jnp.zeros((len(times), len(x))), jnp.abs(x))
        return x + slopes.sum(axis=0), None

    def undo(constants: Any, state: Any, t: Any, h: Any, member: Any) -> Any:
        return step(constants, state, t + h, -h, member)

    is_symmetric = np.allclose(tableau.mix + tableau.mix[::-1, ::-1], 1.0, rtol=0.0, atol=2.0 * UNIT_ROUNDOFF)
    return Steps(lambda energy: energy, step, step, functions=field.functions, undo=undo if is_symmetric else None)
