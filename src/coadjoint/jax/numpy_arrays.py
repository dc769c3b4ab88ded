"""Arrays of JAX in functions that are written for NumPy and Numba: assignments to entries, comparisons and branches."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, wraps
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from coadjoint.errors import in_one_line

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
