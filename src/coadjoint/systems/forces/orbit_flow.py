"""Exponentials exp(D_v) x on coadjoint orbits: by dense matrices, and by sparse ones with transposed derivatives."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.energy_derivatives import EnergyDerivative

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

MAX_TERMS = 60  # of a power series, whose arguments are scaled to norm one: 1/60! is below 2^-270
NEGLIGIBLE = 2.0**-60  # of the result: bound of a term that no longer changes it
# Iterations of the transposed midpoint rule, of whose number a convergent one takes a few.
MAX_ITERATIONS = 1000
MAX_SUBSTEPS = 4096  # of an exponential, as in the kernels
SETTLED = 2.0**-48
MAX_MIDPOINTS = 192  # iterations of the midpoint rule; convergent ones take some ten
SERIES_TOLERANCE = 2.0**-40  # of |x|: below it a correction that stagnates is round-off


class Bracket(NamedTuple):
    """D_v x = sign J(x) v from padded columns of structure constants: by output, and by input x for the transpose."""

    j: Integers
    k: Integers
    c: Floats
    j_of_input: Integers
    i_of_input: Integers
    c_of_input: Floats

    def generator(self, v: Floats) -> Floats:
        """Return the entries of D_v, padded."""
        return self.c * v[self.j]

    def transposed(self, v: Floats) -> Floats:
        """Return the entries of the transpose of D_v, padded."""
        return self.c_of_input * v[self.j_of_input]

    def times(self, D: Floats, x: Floats) -> Floats:
        """Return D_v x."""
        return np.asarray((D * x[self.k]).sum(axis=0))

    def transposed_times(self, D: Floats, row: Floats) -> Floats:
        """Return D_v^T row."""
        return np.asarray((D * row[self.i_of_input]).sum(axis=0))

    def product(self, x: Floats, v: Floats) -> Floats:
        """Return sign J(x) v, antisymmetric as a matrix that acts on v."""
        return np.asarray((self.c * x[self.k] * v[self.j]).sum(axis=0))

    def products(self, x: Floats, v: Floats) -> Floats:
        """Return the sum of sign J(x) v over rows x, v (m, n)."""
        total = np.zeros(self.c.shape)
        for one, other in zip(x, v, strict=True):
            total += one[self.k] * other[self.j]
        return np.asarray((self.c * total).sum(axis=0))


class Exponential(NamedTuple):
    """A step y = exp(D_v) x, as of a noise: the substeps of its series, and the terms of each."""

    bracket: Bracket
    v: Floats
    substeps: int
    terms: tuple[Floats, ...]
    end: Floats
    of_damping: bool = False

    @classmethod
    def of(cls, bracket: Bracket, v: Floats, x: Floats) -> Exponential:
        D = bracket.generator(v)
        norm = float(np.abs(D).sum(axis=0).max(initial=0.0))
        substeps = max(1, math.ceil(norm))
        series = []
        for _ in range(substeps):
            terms, bound = [x], 1.0
            for k in range(1, MAX_TERMS):
                terms.append(bracket.times(D, terms[-1]) / (k * substeps))
                bound *= norm / (k * substeps)
                if bound <= NEGLIGIBLE:
                    break
            series.append(np.array(terms))
            x = x + series[-1][1:].sum(axis=0)
        return cls(bracket, v, substeps, tuple(series), x)

    def pull(self, row: Floats) -> tuple[Floats, Floats]:
        """Return the cotangents of x and v for that of the end."""
        D, of_v = self.bracket.transposed(self.v), np.zeros_like(row)
        for terms in reversed(self.terms):
            rows = [row]
            for k in range(len(terms) - 1, 0, -1):
                rows.append(row + self.bracket.transposed_times(D, rows[-1]) / (k * self.substeps))
            # Cotangents of the terms 1, 2, ..., each divided by the divisor of its term.
            of_terms = np.array(rows[-2::-1]) / (self.substeps * np.arange(1, len(terms)))[:, None]
            of_v -= self.bracket.products(terms[:-1], of_terms)
            row = rows[-1]
        return row, of_v

    def along(self, energy: EnergyDerivative, of_v: Floats) -> Any:
        """Return zero: v does not depend on the energy."""
        return 0.0

    def by_parameter(self, field: str, factor: Any, of_v: Floats) -> Any:
        """Return the derivative by a parameter of the force along the cotangent of v; v by it is v times `factor`."""
        each = of_v * self.v * factor
        return each if np.ndim(factor) else each.sum()


class Midpoint(NamedTuple):
    """The midpoint rule of a damping, y = exp(D_v) x with v = scale P sign J(m) grad H(m) at m = exp(D_v/2) x.

    If `added` is given, v has also this multiple of grad H(m), (n,).
    """

    whole: Exponential
    half: Exponential
    scale: float
    metric: Callable[[Floats], Floats]
    gradient: Floats
    hessian: Any
    added: Any = 0.0
    of_damping: bool = True

    @property
    def end(self) -> Floats:
        """State after the flow."""
        return self.whole.end

    @property
    def v(self) -> Floats:
        """Direction of the exponential."""
        return self.whole.v

    def pull(self, row: Floats) -> tuple[Floats, Floats]:
        """Return the cotangents of x and of what is added to v."""
        of_x, first = self.whole.pull(row)
        of_v, last_change = first, np.inf
        for _ in range(MAX_ITERATIONS):
            of_middle = self._of_middle(of_v)
            through, by_half = self.half.pull(of_middle)
            before, of_v = of_v, first + 0.5 * by_half
            change = float(np.abs(of_v - before).max(initial=0.0))
            if change <= SETTLED * float(np.abs(of_v).max(initial=0.0)) or not change < last_change:
                break
            last_change = change
        return of_x + through, of_v

    def along(self, energy: EnergyDerivative, of_v: Floats) -> Floats:
        """Return the derivatives of the energy, in grad H(m), along the cotangent of v."""
        of_gradient = -self.half.bracket.product(self.half.end, self.scale * self.metric(of_v)) + self.added * of_v
        return energy.along(self.half.end, of_gradient)

    def by_parameter(self, field: str, factor: Any, of_v: Floats) -> Any:
        """Return the derivative by a parameter of the force along the cotangent of v; v by it is v times `factor`."""
        return self.whole.by_parameter(field, factor, of_v)

    def _of_middle(self, of_v: Floats) -> Floats:
        bracket = self.half.bracket
        row = self.scale * self.metric(of_v)
        through_gradient = self.hessian @ (self.added * of_v - bracket.product(self.half.end, row))
        return bracket.transposed_times(bracket.transposed(self.gradient), row) + through_gradient


class OfSpins(NamedTuple):
    """A step from a state x whose v depends on the lengths of spins: `along` is the derivative of v by the length of
    its spin, over this length. `changes` are the derivatives of v by parameters, those of the spins or of all.
    """

    step: Exponential | Midpoint
    x: Floats
    spins: Integers
    along_length: Floats
    changes: Mapping[str, tuple[Floats, bool]]

    @property
    def end(self) -> Floats:
        """State after the flow."""
        return self.step.end

    def pull(self, row: Floats) -> tuple[Floats, Floats]:
        """Return the cotangents of x and of what is added to v."""
        of_x, of_v = self.step.pull(row)
        of_x[self.spins] += (of_v * self.along_length)[self.spins].sum(axis=1, keepdims=True) * self.x[self.spins]
        return of_x, of_v

    def along(self, energy: EnergyDerivative, of_v: Floats) -> Any:
        """Return the derivatives of the energy along the cotangent of v."""
        return self.step.along(energy, of_v)

    def by_parameter(self, field: str, factor: Any, of_v: Floats) -> Any:
        """Return the derivative by a parameter of the force along the cotangent of v."""
        change, each = self.changes[field]
        by_spin = (of_v * change)[self.spins].sum(axis=1)
        return by_spin if each else by_spin.sum()

    @property
    def of_damping(self) -> bool:
        """Whether it is the damping, not a noise."""
        return self.step.of_damping


def pull_through(
    steps: Sequence[Exponential | Midpoint | OfSpins],
    scalings: Mapping[str, tuple[Any, Any]],
    row: Floats,
    fields: Mapping[str, str],
    energies: Mapping[str, EnergyDerivative],
) -> tuple[Floats, dict[str, Floats]]:
    """Return the cotangents of the state and of parameters: fields of the force, and those of the energy."""
    # `scalings` by field: v of the noise, and of the damping, by p is v times the first, second factor.
    found: dict[str, Floats] = {name: np.zeros(1) for name in (*fields, *energies)}
    for step in reversed(steps):
        row, of_v = step.pull(row)
        for name, energy in energies.items():
            found[name] = found[name] + step.along(energy, of_v)
        for name, field in fields.items():
            found[name] = found[name] + step.by_parameter(field, scalings[field][step.of_damping], of_v)
    return row, found


def _padded(rows: Integers, columns: Sequence[Integers], values: Floats, n: int) -> tuple[Any, ...]:
    """Return columns and values as arrays (width, n), padded with zeros: those of row i are at [:, i]."""
    order = np.argsort(rows, kind="stable")
    starts = np.searchsorted(rows[order], np.arange(n + 1))
    place = np.arange(len(rows)) - starts[rows[order]]
    width = int(np.max(np.diff(starts), initial=1))
    found: list[Any] = []
    for column in (*columns, values):
        padded = np.zeros((width, n), dtype=column.dtype)
        padded[place, rows[order]] = column[order]
        found.append(padded)
    return tuple(found)


def exponential(system: Any, v: NDArray[Any], x: NDArray[Any]) -> NDArray[Any]:
    """Return exp(D_v) x, D_v x = sign J(x) v, by its power series in substeps."""
    D, substeps = _generator(system, v)
    for _ in range(substeps):
        term, total, negligible = x, np.zeros_like(x), NEGLIGIBLE * np.abs(x).max(initial=0.0)
        for k in range(1, MAX_TERMS):
            term = D @ term / (k * substeps)
            total = total + term
            if not np.abs(term).max(initial=0.0) > negligible:
                break
        x = x + total
    return np.asarray(x)


class FoundMidpoint(NamedTuple):
    """The midpoint of a flow and the direction of its exponential, or None with the last correction."""

    middle: NDArray[Any]
    direction: NDArray[Any] | None
    residual: float


def midpoint(system: Any, direction: Callable[..., Any], x: NDArray[Any]) -> FoundMidpoint:
    """Solve y = exp(D_v / 2) x with v = direction(y), by iteration."""
    middle, last_change = x, np.inf
    for _ in range(MAX_MIDPOINTS):
        before, v = middle, direction(middle)
        middle = exponential(system, 0.5 * v, x)
        change = float(np.sum(np.abs(middle - before)))
        if is_settled(change, last_change, x):
            return FoundMidpoint(before, v, change)
        last_change = change
    return FoundMidpoint(middle, None, last_change)


def is_settled(change: float, last_change: float, x: NDArray[Any]) -> bool:
    """Test whether an iteration ends: its changes are those of rounding, and no longer halve."""
    return change == 0.0 or (change >= 0.5 * last_change and change <= SERIES_TOLERANCE * float(np.sum(np.abs(x))))


def exponential_with_tangent(
    system: Any, v: NDArray[Any], x: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return exp(D_v) x and its derivatives (n, n) by x and by v, of the same series."""
    D, substeps = _generator(system, v)
    # Columns: the state, its derivatives by x, and those by v, for which D_w x = sign J(x) w is a source.
    n, J = len(x), system.algebra.structure_matrix
    columns = np.concatenate([x[:, None], np.eye(n), np.zeros((n, n))], axis=1)
    for _ in range(substeps):
        term, total, negligible = columns, np.zeros_like(columns), NEGLIGIBLE * np.abs(columns).max()
        for k in range(1, MAX_TERMS):
            image = D @ term
            image[:, n + 1 :] += system.sign * np.asarray(J(term[:, 0]), dtype=np.float64)
            term = image / (k * substeps)
            total += term
            if not np.abs(term).max() > negligible:
                break
        columns = columns + total
    return columns[:, 0], columns[:, 1 : n + 1], columns[:, n + 1 :]


def _generator(system: Any, v: NDArray[Any]) -> tuple[NDArray[np.float64], int]:
    """Return the matrix of D_v, and the number of substeps of its exponential, each of norm at most one."""
    D = system.sign * np.asarray(system.algebra.coadjoint(v), dtype=np.float64)
    norm = np.max(np.sum(np.abs(D), axis=1), initial=0.0)
    if not norm <= MAX_SUBSTEPS:
        raise OverflowError(f"the exponential of a matrix of norm {norm:.3g} needs more than {MAX_SUBSTEPS} substeps")
    return D, max(1, int(np.ceil(norm)))


@lru_cache(maxsize=16)
def bracket_of(algebra: Any, sign: int) -> Bracket:
    """Return the bracket of an algebra, which is cached."""
    i, j, k, c = algebra.triples
    c = sign * np.asarray(c, dtype=np.float64)
    i, j, k, c = np.append(i, j), np.append(j, i), np.append(k, k), np.append(c, -c)
    return Bracket(*_padded(i, (j, k), c, algebra.dim), *_padded(k, (j, i), c, algebra.dim))


@lru_cache(maxsize=16)
def constant_hessian(hamiltonian: Any, n: int) -> Any:
    """Return the sparse Hessian and the linear part of a quadratic Hamiltonian; None for other ones."""
    from scipy.sparse import csr_array

    terms = hamiltonian.terms() if hasattr(hamiltonian, "terms") else []
    if not terms or any(term.form is None for term in terms):
        return None
    total, linear = csr_array((n, n)), np.zeros(n)
    for term in terms:
        total = total + csr_array((term.form.values, term.form.indices, term.form.indptr), shape=(n, n))
        linear = linear + term.form.linear
    return total.tocsr(), linear


def metric_root(metric: Any, what: str) -> NDArray[np.float64]:
    """Return L with L L^T = P: square roots of a number or diagonal, or a Cholesky factor, summed in a fixed order."""
    P = np.array(metric, dtype=np.float64)
    size = np.max(np.abs(P))
    if P.ndim < 2:
        if np.any(P < 0.0):
            raise ValueError(f"{what} has the negative entry {P.min():g}; damping needs a positive semidefinite one")
        return np.sqrt(P)
    if not np.array_equal(P, P.T):
        raise ValueError(f"{what} is not symmetric; damping needs a symmetric positive semidefinite one")
    n = len(P)
    L, remainder, tolerance = np.zeros((n, n)), P.copy(), 64 * n * UNIT_ROUNDOFF * size
    for k in range(n):
        if remainder[k, k] > tolerance:
            L[k:, k] = remainder[k:, k] / np.sqrt(remainder[k, k])
            remainder[k:, k:] -= np.multiply.outer(L[k:, k], L[k:, k])
        elif remainder[k, k] < -tolerance or np.max(np.abs(remainder[k:, k])) > np.sqrt(tolerance * size):
            raise ValueError(f"{what} is not positive semidefinite; damping would feed energy in")
    return L
