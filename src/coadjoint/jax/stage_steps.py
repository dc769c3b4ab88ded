"""Implicit Runge-Kutta steps with a fixed number of iterations, and the fields in them, with functions of the user."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, wraps
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from numpy.lib.mixins import NDArrayOperatorsMixin

from coadjoint.errors import in_one_line
from coadjoint.methods.numerics.solvers import Coefficients
from coadjoint.systems.hamiltonians.terms import FunctionTerm, PolynomialTerm
from coadjoint.systems.hamiltonians.user_hamiltonian import JaxFunction

MOST_BRANCHES = 64
"""Largest number of combinations of branches of a function, which are all computed."""


class Numbers(NDArrayOperatorsMixin):
    """An array of JAX with the interface of NumPy, whose conditions are decided by a function. Slices are views."""

    def __init__(self, value: Any, decide: Callable[[Any], bool], place: tuple[Numbers, Any] | None = None) -> None:
        self._value, self._decide, self._place = value, decide, place

    @property
    def value(self) -> Any:
        """The array of JAX; that of a view follows the whole."""
        if self._place is None:
            return self._value
        whole, index = self._place
        return whole.value[index]

    def __jax_array__(self) -> Any:
        return self.value

    def _set(self, value: Any) -> None:
        if self._place is None:
            self._value = value
        else:
            whole, index = self._place
            whole._set(whole.value.at[index].set(value))

    def __getitem__(self, index: Any) -> Numbers:
        index = plain(index)
        parts = index if isinstance(index, tuple) else (index,)
        is_view = any(isinstance(part, slice) or part is Ellipsis for part in parts) or len(parts) < self.ndim
        return Numbers(self.value[index], self._decide, (self, index) if is_view else None)

    def __setitem__(self, index: Any, value: Any) -> None:
        self._set(self.value.at[plain(index)].set(plain(value)))

    def __array_ufunc__(self, function: np.ufunc, method: str, *inputs: Any, out: Any = (), **options: Any) -> Any:
        if method != "__call__" or options or any(not isinstance(one, Numbers) for one in out):
            raise TypeError(f"it writes numbers of JAX into an array of NumPy, or calls {function.__name__}.{method}")
        found = getattr(jnp, function.__name__)(*map(plain, inputs))
        if not out:
            return Numbers(found, self._decide)
        out[0]._set(found)
        return out[0]

    def __array_function__(self, function: Any, types: Any, arguments: Any, options: Any) -> Any:
        found = getattr(jnp, function.__name__)(*map(plain, arguments), **{k: plain(v) for k, v in options.items()})
        return jax.tree.map(lambda one: Numbers(one, self._decide), found)

    def __bool__(self) -> bool:
        return self._decide(self.value)

    def __len__(self) -> int:
        return int(self.value.shape[0])

    def __iter__(self) -> Any:
        return (self[i] for i in range(len(self)))

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        # NumPy calls functions of arrays of objects as methods of their entries.
        found = getattr(self.value, name, None)
        function = partial(getattr(jnp, name), self.value) if found is None else found
        if not callable(function):
            return function if isinstance(function, tuple | int | np.dtype) else Numbers(function, self._decide)

        def method(*arguments: Any, **options: Any) -> Numbers:
            return Numbers(function(*map(plain, arguments), **options), self._decide)

        return method


def plain(value: Any) -> Any:
    """Return what a function returned, or was given, as arrays of JAX."""
    if isinstance(value, Numbers):
        return value.value
    if isinstance(value, tuple | list):
        return type(value)(map(plain, value))
    if isinstance(value, np.ndarray) and value.dtype == object:
        return jnp.stack([jnp.asarray(plain(one)) for one in value.ravel()]).reshape(value.shape)
    return value


def on_jax(function: Callable[..., Any], what: str) -> Callable[..., Any]:
    """Return a function for arrays of JAX, of one that is written with JAX, or with NumPy for Numba."""
    function = getattr(function, "py_func", function)

    @wraps(function, updated=())
    def traced(*arguments: Any) -> Any:
        return evaluated(arguments, ())

    def evaluated(arguments: Any, given: tuple[bool, ...]) -> Any:
        # Decisions that are not given are first taken as true.
        taken: list[bool] = list(given)
        conditions: list[Any] = []

        def decide(condition: Any) -> bool:
            if len(conditions) == len(taken):
                taken.append(True)
            conditions.append(condition)
            return taken[len(conditions) - 1]

        numbers = [Numbers(jnp.asarray(one), decide) for one in arguments]
        try:
            found = jnp.asarray(plain(function(*numbers)), dtype=jnp.float64)
        except Exception as reason:
            raise TypeError(
                f"JAX cannot trace {what} ({type(reason).__name__}: {in_one_line(str(reason), 160)}); write it with "
                'jax.numpy, or take backend="compiled"'
            ) from reason
        for k in range(len(taken) - 1, len(given) - 1, -1):
            if 2 ** (k + 1) > MOST_BRANCHES:
                raise TypeError(f'{what} has more than {MOST_BRANCHES} branches; take backend="compiled"')
            other = evaluated(arguments, (*taken[:k], False))
            found = jnp.where(conditions[k], found, other)
        return found

    return traced


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
        """Multiply a vector."""
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
    """Steps of a scheme. A state is a momentum and the rows of a group element, None in runs without an attitude.

    Between steps a state may be unfinished: `begin(constants, start, t, h)` returns the one of which a state is the
    finished one, with the unit element; `finish(constants, state, t, h, start, elapsed)` returns the finished state,
    with the attitude from the start of a run. `constants(energy)` are those for coefficients of the energy.
    """

    constants: Callable[[Any], Any]
    step: Callable[..., Any]
    """A step of an unfinished state: of constants, state, t, h and the number of the member."""
    whole: Callable[..., Any]
    """A step of a finished state to a finished state."""
    begin: Callable[..., Any] = _unchanged
    finish: Callable[..., Any] = _unchanged


class StageField:
    """The field of a Hamiltonian of polynomials and functions, and exponentials of the algebra."""

    # `monomials` have coefficients, the energy in the arguments of the methods.

    def __init__(self, system: Any, monomials: Any) -> None:
        self.sign, n = system.sign, system.dim
        degree = max((len(key) for key in monomials), default=0)
        self.monomials = np.array([[*key, *[n] * (degree - len(key))] for key in monomials], dtype=np.int64)
        others = [term for term in system.hamiltonian.terms() if term.form is None]
        self.functions = [term for term in others if not isinstance(term, PolynomialTerm)]
        # Stored for i < j.
        i, j, k, c = system.algebra.triples
        self.products = np.append(j, i), np.append(k, k)
        self.rows = sparse(np.append(i, j), np.arange(2 * len(c)), np.append(c, -c), (n, 2 * len(c)))

    def at(self, energy: Any, x: Any, t: Any) -> Any:
        """Return sign J(x) grad H(x, t)."""
        padded = jnp.append(x, 1.0)
        slopes = jnp.zeros_like(x)
        if len(self.monomials):
            slopes = jax.grad(lambda x: energy @ jnp.append(x, 1.0)[self.monomials].prod(axis=1))(x)
        for term in self.functions:
            slopes = slopes.at[term.coordinates].add(gradient_of(term)(padded[term.coordinates], t))
        return self.product(x, slopes)

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


def gradient_of(term: FunctionTerm) -> Any:
    """Return the gradient of a function in its own coordinates, of (y, t), by its derivative or by that of JAX."""
    what = "a function of the Hamiltonian"
    function: Any = term.value
    if isinstance(function, JaxFunction):
        of_jax = jax.grad(function.function)

        def gradient(y: Any, t: Any) -> Any:
            z = y[0] if term.scalar else y
            return jnp.reshape(of_jax(z, t) if term.timed else of_jax(z), y.shape)

        return gradient
    traced = on_jax(term.gradient, what)

    def given(y: Any, t: Any) -> Any:
        z = y[0] if term.scalar else y
        return jnp.reshape(traced(z, t) if term.timed else traced(z), y.shape)

    return given


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

    return Steps(jnp.asarray, step, step)
