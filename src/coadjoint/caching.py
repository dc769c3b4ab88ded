"""Caches that take little memory: of small arrays, and of immutable objects as long as they are in use."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, Generic, ParamSpec, TypeVar
from weakref import WeakValueDictionary

MAX_CACHED_SIZE = 2**16  # entries: half a megabyte of an array is kept, larger ones are computed again

Arrays = TypeVar("Arrays")
Arguments = ParamSpec("Arguments")
Built = TypeVar("Built")


class cached_if_small(Generic[Arrays]):
    """A cached property of one array, or a tuple of arrays, that is computed again each time if it is large."""

    def __init__(self, build: Callable[[Any], Arrays]) -> None:
        self.build, self.__doc__ = build, build.__doc__

    def __get__(self, instance: Any, owner: type) -> Arrays:
        if instance is None:
            return self  # type: ignore[return-value]
        value = self.build(instance)
        if _count(value) <= MAX_CACHED_SIZE:
            instance.__dict__[self.build.__name__] = value
        return value


def shared(build: Callable[Arguments, Built]) -> Callable[Arguments, Built]:
    """Return a function that builds an immutable object, one for the same arguments as long as it is in use."""
    in_use: WeakValueDictionary[Any, Built] = WeakValueDictionary()

    @wraps(build)
    def shared_or_built(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Built:
        # Types belong to the key, since 3.0 and True are equal to integers and are refused.
        try:
            key = tuple((type(v), v) for v in args), frozenset((k, type(v), v) for k, v in kwargs.items())
            built = in_use.get(key)
        except TypeError:  # arguments without a hash
            return build(*args, **kwargs)
        return in_use.setdefault(key, build(*args, **kwargs)) if built is None else built

    return shared_or_built


def _count(arrays: Any) -> int:
    return sum(map(_count, arrays)) if isinstance(arrays, tuple) else int(arrays.size)
