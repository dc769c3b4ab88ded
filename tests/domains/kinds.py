"""Documented domains of parameters, each as values just inside and values just outside."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

NOT_FINITE = (math.nan, math.inf, -math.inf, 10**400)
NO_NUMBER = (None, True, "1", "", 1j, [], {}, [1.0, 2.0])
NO_OBJECT = (None, "", 1.0, True, 1j, [], {})
TINY = 5e-324
LARGE = 2**63


@dataclass(frozen=True)
class Domain:
    """Values inside, the first of which is the usual one, and values outside.

    `called` is a pattern of how messages call the parameter; by default they give its name.
    """

    inside: tuple[Any, ...]
    outside: tuple[Any, ...]
    called: str | None = None

    def plus(self, *inside: Any, outside: tuple[Any, ...] = (), without: tuple[Any, ...] = ()) -> Domain:
        """Add values; `without` are those no longer outside."""
        dropped = {repr(value) for value in without}
        kept = tuple(value for value in self.outside if repr(value) not in dropped)
        return replace(self, inside=(*self.inside, *inside), outside=(*kept, *outside))

    def but_called(self, called: str) -> Domain:
        return replace(self, called=called)

    def first(self, *inside: Any) -> Domain:
        """Take other values inside."""
        return replace(self, inside=inside)


@dataclass(frozen=True)
class Case:
    """A constructor with the domain of each parameter.

    `then` is applied to what it makes, where a value can be checked only on a system, before the first step; `usual`
    are values of the other parameters that differ from the first ones inside.
    """

    make: Callable[..., Any]
    domains: Mapping[str, Domain]
    then: Callable[[Any], Any] | None = None
    usual: Mapping[str, Any] | None = None

    def arguments(self) -> dict[str, Any]:
        return {name: domain.inside[0] for name, domain in self.domains.items()} | dict(self.usual or {})

    def __call__(self, **given: Any) -> Any:
        made = self.make(**given)
        return made if self.then is None else self.then(made)


def case_of(function: Callable[..., Any], known: Mapping[str, Domain], /, **own: Any) -> Case:
    """Return the case of a function: each parameter has a domain of its own, a known one, or that of its default."""
    named = inspect.signature(function).parameters
    names = [name for name, one in named.items() if one.kind is not one.VAR_KEYWORD]
    more = {key: own.pop(key) for key in ("then", "usual") if key in own}
    assert set(own) <= set(names), f"{function} has no parameter {set(own) - set(names)}"
    domains = {name: known[name] for name in names if name in known and fits(known[name], named[name].default)} | own
    domains |= {name: of_default(function, named[name]) for name in names if name not in domains}
    return Case(function, {name: domains[name] for name in names}, **more)


def fits(domain: Domain, default: Any) -> bool:
    """Return whether a known domain is one of values like this default: of a number, or of as many numbers."""
    return not is_numeric(default) or np.shape(default) == np.shape(domain.inside[0])


def is_numeric(value: Any) -> bool:
    """Return whether a default is a number, or a tuple of numbers, by which other shapes can be told."""
    return isinstance(value, int | float) or (isinstance(value, tuple) and np.asarray(value).dtype.kind in "iuf")


def of_default(function: Callable[..., Any], parameter: inspect.Parameter) -> Domain:
    """Return the domain of a parameter of which only the default is known: numbers or a truth value."""
    if isinstance(parameter.default, bool):
        return flag(usual=parameter.default)
    assert is_numeric(parameter.default), (
        f"{function.__name__} has the parameter {parameter.name}; list what it accepts and refuses in tests/domains"
    )
    if isinstance(parameter.default, tuple):
        return vector(parameter.default, Domain((), NOT_FINITE), any_length=True)
    return Domain((parameter.default,), (*NOT_FINITE, *NO_NUMBER))


def structured(inside: tuple[Any, ...], outside: tuple[Any, ...], called: str | None = None, keep: Any = ()) -> Domain:
    """Values with a structure of their own; `keep` are those of `NO_OBJECT` that are inside, or mean another thing."""
    return Domain(inside, NO_OBJECT, called).plus(outside=outside, without=keep)


def real(usual: float = 0.5) -> Domain:
    return Domain((usual, 0, -1e-3, np.float32(2.0), np.int64(3)), (*NOT_FINITE, *NO_NUMBER))


def positive(usual: float = 0.5, least: float = TINY, most: float | None = None) -> Domain:
    """Numbers above zero; `least` and `most` are the limits that are stated and belong to the domain."""
    inside = (usual, 1e-6 if least == TINY else least, 3 if most is None else most)
    below = () if least == TINY else (0.9 * least,)
    above = () if most is None else (math.nextafter(most, math.inf),)
    return Domain(inside, (0, 0.0, -TINY, -1, *below, *above, *NOT_FINITE, *NO_NUMBER))


def not_negative(usual: float = 0.5) -> Domain:
    return Domain((usual, 0, 0.0, 1e-6), (-TINY, -1, *NOT_FINITE, *NO_NUMBER))


def whole(least: int, most: int | None = None, usual: int | None = None, tried: int | None = None) -> Domain:
    """Whole numbers; `tried` is the largest that is constructed if the largest allowed one is expensive."""
    upper = tried if tried is not None else least + 1 if most is None else most
    above = () if most is None else (most + 1, LARGE, 2**64)
    usual = least if usual is None else usual
    # without a limit, 10^400 of a size is a question of memory
    wrong = (least - 1, -LARGE, least + 0.5, *above, *NOT_FINITE[:3], *NO_NUMBER)
    return Domain((usual, least, upper, np.int64(usual)), wrong)


def one_of(*values: int) -> Domain:
    """Whole numbers from a list."""
    between = tuple(k for k in range(min(values) - 1, max(values) + 2) if k not in values)
    return Domain(values, (*between, values[0] + 0.5, LARGE, *NOT_FINITE, *NO_NUMBER))


def choice(*names: str) -> Domain:
    wrong = tuple(wrong for name in names for wrong in (name + "x", name[:-1], name.swapcase(), [name]))
    return Domain(names, (*(w for w in wrong if w not in names), "", None, 1, True, 1j, math.nan, []))


def flag(usual: bool = False) -> Domain:
    return Domain((usual, not usual, np.True_), (0, 1, 1.0, None, "", "True", math.nan, 1j, [], [True]))


def title(usual: str) -> Domain:
    return Domain((usual, "x" * 200), ("", "x" * 201, "two\nlines", None, 3, True, b"x", [], ["x"], math.nan))


def instance(*objects: Any) -> Domain:
    """Objects of a class of the library, or functions."""
    return Domain(objects, (*NO_OBJECT, "sin", math.nan, LARGE))


def optional(domain: Domain) -> Domain:
    return domain.plus(None, without=(None,))


def vector(usual: Any, entry: Domain, *others: Any, any_length: bool = False, number: bool = False) -> Domain:
    """Numbers of a fixed shape, each of them from a domain; `number` allows one in place of all."""
    array, scalars = np.array(usual, dtype=float), [one for one in entry.outside if not isinstance(one, list | dict)]
    wrong: list[Any] = [with_entry(usual, place, value) for place in np.ndindex(array.shape) for value in scalars]
    wrong += [array.astype(complex) + 1j, array > 0, array.astype(str), [], None, "", "1", {}, True, 1j, math.nan]
    wrong += [array[None, None], np.zeros((0, 3))] + ([] if number else [1.0])
    wrong += [] if any_length else [array[:-1], np.concatenate([array, array[-1:]])]
    return Domain((usual, array.tolist(), array, *others), tuple(wrong))


def with_entry(values: Any, place: tuple[int, ...], value: Any) -> list[Any]:
    """Return nested lists with another entry, and with the other ones as they are."""
    nested = np.array(values, dtype=object)
    nested[place] = value
    return nested.tolist()
