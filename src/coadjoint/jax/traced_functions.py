"""Functions that users write for Numba as operations of JAX, compared with their compiled values."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial, wraps
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from coadjoint.algebra.invariants.sampled_checks import SEED, sample_points
from coadjoint.errors import in_one_line
from coadjoint.kernels.functions.compiled_functions import CompiledFunction
from coadjoint.kernels.tables.compiled import compiled_derivative
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.systems.forces.torque import sample_state
from coadjoint.systems.hamiltonians.created_arrays import with_new_arrays
from coadjoint.systems.hamiltonians.parametrized_functions import ParametrizedEnergy, function_of
from coadjoint.systems.hamiltonians.terms import FunctionTerm
from coadjoint.systems.hamiltonians.user_hamiltonian import JaxFunction
from coadjoint.systems.user_functions import first_difference

Floats = NDArray[np.float64]
Reference = Callable[[Floats, float], Floats]

MOST_BRANCHES = 64
"""Largest number of combinations of branches of a function, which are all computed."""
DISTANCES = 2.0**-10, 2.0**-4, 0.5, 1.0
"""Largest distances of sample points from an initial state, relative to the size of each group of coordinates."""
PROPERTIES = frozenset({"T", "mT"})
METHODS = frozenset({"reshape", "ravel", "transpose", "swapaxes", "squeeze", "diagonal"})
FUNCTIONS = METHODS | {"moveaxis", "rollaxis", "expand_dims", "atleast_1d", "atleast_2d", "atleast_3d", "rot90"}
FUNCTIONS |= {"split", "array_split", "hsplit", "vsplit", "dsplit", "flip", "fliplr", "flipud"}
"""Functions of NumPy that only rearrange the entries of their first argument, and return views where they can."""


class Numbers(NDArrayOperatorsMixin):
    """An array, or a number, of JAX with the interface of NumPy, whose conditions are decided by a function."""

    # A view shares the `_memory` of an array, a list of the one array of JAX, and has the `_places` of its entries.
    # Which results are views is found by NumPy, from the same operation on the places.

    def __init__(
        self, value: Any, decide: Callable[[Any], bool], memory: list[Any] | None = None, places: Any = None
    ) -> None:
        self._memory, self._places = [value] if memory is None else memory, places
        self._decide = decide

    @property
    def value(self) -> Any:
        whole = self._memory[0]
        return whole if self._places is None else _entries(whole, self._places)

    @property
    def _is_number(self) -> bool:
        return self._places is None and self._memory[0].ndim == 0

    def __jax_array__(self) -> Any:
        return self.value

    def _set(self, value: Any) -> None:
        whole = self._memory[0]
        if self._places is None:
            self._memory[0] = jnp.broadcast_to(jnp.asarray(value, whole.dtype), whole.shape)
        else:
            self._memory[0] = whole.ravel().at[self._places].set(value).reshape(whole.shape)

    def _rearranged(self, rearrange: Callable[[Any], Any]) -> Any:
        """Return the arrays that NumPy makes by a rearrangement of entries: views, or copies."""
        whole, places = self._memory[0], self._places
        if places is None:
            places = np.arange(whole.size).reshape(whole.shape)

        def of(found: Any) -> Any:
            if isinstance(found, tuple | list):
                return type(found)(map(of, found))
            if isinstance(found, np.ndarray) and np.may_share_memory(found, places) and not self._is_number:
                return Numbers(None, self._decide, self._memory, found)
            return Numbers(_entries(whole, found), self._decide)

        return of(rearrange(places))

    def __getitem__(self, index: Any) -> Any:
        index = plain(index)
        if has_tracers(index):
            return Numbers(self.value[index], self._decide)
        return self._rearranged(lambda places: places[index])

    def __setitem__(self, index: Any, value: Any) -> None:
        if self._is_number:
            raise TypeError("it assigns an entry of a number")
        self._set(self.value.at[plain(index)].set(plain(value)))

    def __array_ufunc__(self, function: np.ufunc, method: str, *inputs: Any, out: Any = (), **options: Any) -> Any:
        if method != "__call__" or options or any(not isinstance(one, Numbers) for one in out):
            raise TypeError(f"it writes numbers of JAX into an array of NumPy, or calls {function.__name__}.{method}")
        found = getattr(jnp, function.__name__)(*map(plain, inputs))
        if not out or out[0]._is_number:  # a number is replaced, not changed
            return Numbers(found, self._decide)
        out[0]._set(found)
        return out[0]

    def __array_function__(self, function: Any, types: Any, arguments: Any, options: Any) -> Any:
        first, *rest = map(plain, arguments)
        options = {key: plain(value) for key, value in options.items()}
        is_first = isinstance(arguments[0], Numbers)
        if function.__name__ in FUNCTIONS and is_first and not has_tracers((*rest, *options.values())):
            return arguments[0]._rearranged(lambda places: function(places, *rest, **options))
        module = jnp.linalg if function.__module__ == "numpy.linalg" else jnp
        found = getattr(module, function.__name__)(first, *rest, **options)
        return jax.tree.map(lambda one: Numbers(one, self._decide), found)

    def __bool__(self) -> bool:
        return self._decide(self.value)

    def __len__(self) -> int:
        return int(self.value.shape[0])

    def __iter__(self) -> Any:
        return (self[i] for i in range(len(self)))

    def sort(self, axis: int = -1) -> None:
        self._set(jnp.sort(self.value, axis))

    def fill(self, value: Any) -> None:
        self._set(plain(value))

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if name in PROPERTIES:
            return self._rearranged(lambda places: getattr(places, name))
        # NumPy calls functions of arrays of objects as methods of their entries.
        found = getattr(self.value, name, None)
        function = partial(getattr(jnp, name), self.value) if found is None else found
        if not callable(function):
            return function if isinstance(function, tuple | int | np.dtype) else Numbers(function, self._decide)

        def method(*arguments: Any, **options: Any) -> Any:
            if name in METHODS:
                return self._rearranged(lambda places: getattr(places, name)(*arguments, **options))
            return Numbers(function(*map(plain, arguments), **options), self._decide)

        return method


def _entries(whole: Any, places: Any) -> Any:
    """Return the entries of an array at places of its numbers in C order."""
    flat, first = whole.ravel(), int(places.flat[0]) if places.size else 0
    if np.ndim(places) == 0:
        return flat[first]
    if np.array_equal(places.ravel(), np.arange(first, first + places.size)):  # a slice is faster than a gather
        return flat[first : first + places.size].reshape(places.shape)
    return flat[places]


def has_tracers(value: Any) -> bool:
    """Return whether a value is, or contains, an array of JAX."""
    return any(map(has_tracers, value)) if isinstance(value, tuple | list) else isinstance(value, jax.Array)


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
    """Return a function for arrays of JAX, of one that is written with NumPy for Numba."""
    function = getattr(function, "py_func", function)

    @wraps(function, updated=())
    def traced(*arguments: Any) -> Any:
        try:
            return evaluated(arguments, (), in_place=False)
        except TypeError:  # arrays that the function creates are of JAX only where they must be: others are faster
            return evaluated(arguments, (), in_place=True)

    def evaluated(arguments: Any, given: tuple[bool, ...], in_place: bool) -> Any:
        # Decisions that are not given are first taken as true.
        taken: list[bool] = list(given)
        conditions: list[Any] = []

        def decide(condition: Any) -> bool:
            if len(conditions) == len(taken):
                taken.append(True)
            conditions.append(condition)
            return taken[len(conditions) - 1]

        numbers = [Numbers(jnp.asarray(one), decide) for one in arguments]
        called = with_new_arrays(function, lambda one: Numbers(jnp.asarray(one), decide)) if in_place else function
        try:
            found = jnp.asarray(plain(called(*numbers)), dtype=jnp.float64)
        except Exception as reason:
            raise TypeError(
                f"JAX cannot trace {what} ({type(reason).__name__}: {in_one_line(str(reason), 160)}); write it with "
                "arithmetic and functions of NumPy alone, assign entries of copies of its arguments and of arrays of "
                'np.zeros, np.empty and the like, or take backend="compiled"'
            ) from reason
        for k in range(len(taken) - 1, len(given) - 1, -1):
            if 2 ** (k + 1) > MOST_BRANCHES:
                raise TypeError(f'{what} has more than {MOST_BRANCHES} branches; take backend="compiled"')
            other = evaluated(arguments, (*taken[:k], False), in_place)
            found = jnp.where(conditions[k], found, other)
        return found

    return traced


class TracedFunction(NamedTuple):
    """A function of numbers y and the time as JAX operations; `reference`: as compiled, None for one of JAX.

    y are the numbers at `coordinates` of a state; for a flow, followed by others: the step length, and deviates.
    """

    at: Callable[..., Any]
    """The values, of y, the time, and the params of the energy."""
    reference: Callable[[], Reference] | None
    coordinates: Any
    what: str
    behind: int = 0


def gradient_of(term: FunctionTerm) -> TracedFunction:
    """Return the gradient of a function in its own coordinates, by its derivative or by that of JAX."""
    what, (function, factor) = "a function of the Hamiltonian", function_of(term, JaxFunction)
    gradient = on_jax(term.gradient, what) if function is None else None

    def given(y: Any, t: Any, params: Any = None) -> Any:
        z, time = y[0] if term.scalar else y, (t,) if term.timed else ()
        if gradient is not None:
            return jnp.reshape(gradient(z, *time), y.shape)
        if isinstance(function, ParametrizedEnergy):
            return factor * jax.grad(function.at, 1)(params, z, *time)
        return factor * jnp.reshape(jax.grad(function)(z, *time), y.shape)

    def reference() -> Reference:
        compiled = compiled_derivative(term, "gradient", what)
        if isinstance(compiled, CompiledFunction):
            return partial(compiled.values, results=len(term.coordinates))
        # A table, of a function of this library.
        return lambda y, t: np.ravel(term.gradient(y[0] if term.scalar else y, *((t,) if term.timed else ())))

    return TracedFunction(given, None if gradient is None else reference, term.coordinates, what)


def sample_states(system: Any, x0: Floats | None) -> Sequence[Floats]:
    """Return states near x0, (n,) or (members, n), and at distances up to its size; without x0 those of any system."""
    if x0 is None:
        return [sample_state(x, system) for x in sample_points(system.dim)]
    rows, groups = x0.reshape(-1, x0.shape[-1]), CoordinateGroups(system)
    rows = rows[np.linspace(0, len(rows) - 1, len(DISTANCES)).astype(np.int64)]
    sizes = groups.norms(rows)
    sizes = np.where(sizes > 0.0, sizes, np.linalg.norm(rows, axis=1, keepdims=True))[:, groups.labels]
    draws = np.random.default_rng(SEED).uniform(-1.0, 1.0, rows.shape)
    return list(rows + np.array(DISTANCES)[:, None] * sizes * draws)


def compare_with_compiled(
    functions: Iterable[TracedFunction], states: Sequence[Floats], times: Sequence[float], length: float
) -> None:
    """Raise TypeError if a traced function has other values than the compiled one at states and times."""
    compared = [one for one in functions if one.reference is not None]
    if not compared:
        return
    references = [one.reference() for one in compared if one.reference is not None]
    together = jax.jit(lambda numbers, t: [one.at(y, t) for one, y in zip(compared, numbers, strict=True)])
    for x in states:
        numbers = [np.append(x[one.coordinates], [length] * one.behind) for one in compared]
        for t in times:
            with jax.ensure_compile_time_eval():
                found = [np.asarray(values) for values in together(numbers, t)]
            for one, reference, y, values in zip(compared, references, numbers, found, strict=True):
                difference = first_difference(reference, values, y, t, one.behind)
                if difference is not None:
                    raise TypeError(
                        f"{one.what} is another function where JAX traces it, with {difference}; assign entries of new "
                        'arrays only, or take backend="compiled"'
                    )
