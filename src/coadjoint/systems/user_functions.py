"""Validation of user functions: arguments, values at sample points, and consistency of derivatives."""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.invariants.invariant import Forms
from coadjoint.algebra.invariants.sampled_checks import SEED, difference_along, evaluate, sample_points
from coadjoint.algebra.polynomials.monomials import Coefficient
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.validation import read_numbers

LEAST_SHARED_BODIES, BODIES_OF_A_SHARE, MAX_SHARES = 57, 16, 32
"""Bodies from which on threads share a member of 18 coordinates each; what is done once for each share is small."""
MOVED = 2.0**-30  # part of its arguments by which those of a function may be moved for the same values
AUTOMATIC_DIRECTIONS = 4  # along all of which an automatic gradient is wrong before it is refused
KNOWN_NAMES = {
    "x": ("x", "x0", "y", "z", "X", "Y", "Z", "L", "M", "S", "W", "state", "momentum"),
    "t": ("t", "time"),
    "tau": ("tau", "h", "dt"),
    "A": ("A", "attitude", "rotation", "orientation", "dcm", "quaternion"),
    "r": ("r", "position"),
}
"""Names of the state, the time, a duration, an attitude and a position, by which arguments are recognized."""


@dataclass(frozen=True)
class MultipleOf:
    """A multiple of a user function of (x) or (x, t), compiled if the function is; `scalar` if it returns a number."""

    function: Callable[..., Any]
    factor: int | float
    scalar: bool

    def __call__(self, *arguments: Any) -> Any:
        """Return the multiple of the value at x, or at x and t."""
        value = self.function(*arguments)
        return self.factor * (value if self.scalar else np.asarray(value))

    @property
    def kernel_forms(self) -> Forms | None:
        forms = forms_of(self.function)
        return None if forms is None else forms._replace(weight=self.factor * forms.weight)

    @property
    def called_in_python(self) -> bool:
        return is_called_in_python(self.function)


def without_multiples(function: Any) -> tuple[Any, list[MultipleOf]]:
    """Return the function of which another one is a multiple, of multiples, and these, the innermost first."""
    multiples: list[MultipleOf] = []
    while isinstance(function, MultipleOf):
        multiples.insert(0, function)
        function = function.function
    return function, multiples


def with_multiples(function: Any, multiples: Sequence[MultipleOf]) -> Any:
    """Return a function multiplied as `without_multiples` found it."""
    for one in multiples:
        function = replace(one, function=function)
    return function


@dataclass(frozen=True)
class SumOfShares:
    """A function of x as a sum: ``share(x, k)`` for each k below `shares`, which threads compute side by side."""

    # The sum has a fixed order, so that its bits depend on the number of shares and not on that of threads.

    share: Callable[..., Any]
    shares: int

    def __call__(self, x: Any) -> Any:
        total = self.share(x, 0.0)
        for k in range(1, self.shares):
            total = total + self.share(x, float(k))
        return total


def shared(function: Callable[..., Any], shares: int) -> Any:
    """Return a function of (x, number of the share) as a `SumOfShares`, or as it is if there is one share."""
    return SumOfShares(function, shares) if shares > 1 else function


def number_of_shares(bodies: int) -> int:
    """Return into how many shares the pairs of so many bodies are divided, every so many bodies with their partners."""
    return min(bodies // BODIES_OF_A_SHARE, MAX_SHARES) if bodies >= LEAST_SHARED_BODIES else 1


ALL_SHARES = -1  # a whole number, since floats of functions are data, which calls that give an argument cannot pass on


def bodies_of_shares(bodies: int) -> Callable[[Any], tuple[int, int]]:
    """Return a function, for compiled ones, from a share to the first of its bodies and the step to the next."""
    shares = number_of_shares(bodies)
    return lambda share: (int(share), shares) if share >= 0.0 else (0, 1)


class OfConstants(NamedTuple):
    """How a function of y follows from constants (k,): `make` returns that of other ones, `key` is what they share."""

    make: Callable[[npt.NDArray[np.float64]], Any]
    constants: npt.NDArray[np.float64]
    key: Any

    @property
    def pattern(self) -> bytes:
        """Which constants vanish, and which are equal: of each, -1 or the first that it is equal to."""
        _, first, inverse = np.unique(self.constants, return_index=True, return_inverse=True)
        return np.where(self.constants == 0.0, -1, first[inverse]).astype(np.int64).tobytes()


def at_constants(function: Callable[..., Any], constants: npt.NDArray[np.float64]) -> Callable[..., Any]:
    """Return a function of (y, constants) as one of y, for which `of_constants` finds both."""

    def of_y(y: Any) -> Any:
        return function(y, constants)

    of_y.of_constants = OfConstants(partial(at_constants, function), constants, function)  # type: ignore[attr-defined]
    return of_y


def of_constants(function: Any) -> OfConstants | None:
    """Return how a function follows from constants, if it is known."""
    return getattr(function, "of_constants", None)


def forms_of(function: Any) -> Forms | None:
    """Return the tables of a function that has them, which the kernels evaluate without compiling it, or None."""
    return getattr(function, "kernel_forms", None)


def is_called_in_python(function: Any) -> bool:
    """Return whether a function of (x, t), or a multiple of one, is called in Python by the loops, not compiled."""
    return getattr(function, "called_in_python", False)


def multiple_of(function: Any, factor: Coefficient, scalar: bool) -> Any:
    """Return the `MultipleOf` a function, or None for None; a fraction is rounded, since functions return floats."""
    factor = factor if isinstance(factor, int) else float(factor)
    if isinstance(function, SumOfShares):
        return SumOfShares(MultipleOf(function.share, factor, scalar), function.shares)
    return None if function is None else MultipleOf(function, factor, scalar)


def kind_of_name(name: str) -> str | None:
    """Return which argument has a name, a key of `KNOWN_NAMES`, or None for a name that is not known."""
    return next((kind for kind, names in KNOWN_NAMES.items() if name in names), None)


def parameters_of_function(function: Callable[..., Any]) -> list[inspect.Parameter]:
    """Return the parameters of a function; none of a built-in one without a signature."""
    function = getattr(function, "py_func", function)
    # Systems of an ensemble have partial functions of the same one.
    if type(function) is partial and type(function.func) is types.FunctionType and not function.keywords:
        return list(_parameters_of_code(function.func))[len(function.args) :]
    try:
        return list(inspect.signature(function).parameters.values())
    except (TypeError, ValueError):
        return []


@lru_cache(maxsize=64)
def _parameters_of_code(function: types.FunctionType) -> tuple[inspect.Parameter, ...]:
    return tuple(inspect.signature(function).parameters.values())


def check_places(function: Callable[..., Any], name: str, arguments: str) -> None:
    """Raise TypeError if a known name stands at the place of another argument, such as (t, x) for (x, t)."""
    expected = arguments.split(", ")
    kinds = [kind_of_name(one) for one in expected]
    parameters = parameters_of_function(function)
    for parameter, kind in zip(parameters, kinds, strict=False):
        found = kind_of_name(parameter.name)
        # A time is nothing else. Other names have other meanings elsewhere: x may be a position, tau a time.
        wrong = found in kinds or found == "t" or (kind == "t" and found in ("x", "A", "r"))
        if found not in (None, kind) and wrong and (parameter.default is parameter.empty or found == "t"):
            raise TypeError(
                f"{name} is a function of {names_of(parameters)}, and is called with ({arguments}); give the arguments "
                "this order and these names"
            )


def names_of(parameters: Sequence[inspect.Parameter]) -> str:
    """Return the names of parameters as in a call."""
    return f"({', '.join(one.name for one in parameters)})"


def takes_time(function: Callable[..., Any], name: str) -> bool:
    """Return whether `function` takes ``(x, t)`` rather than ``(x)``; raise TypeError otherwise."""
    # A second argument counts as the time if it has no default, or if its name is ``t``.
    function, _ = without_multiples(function)
    if not callable(function):
        raise TypeError(f"{name} is {short(function)}; give a function of (x) or (x, t)")
    if isinstance(function, np.ufunc):
        count = function.nin
    elif isinstance(function, types.BuiltinFunctionType):
        count = 1  # functions of the math module: some have no signature, and none takes the time
    else:
        try:
            signature = inspect.signature(getattr(function, "py_func", function))
        except (TypeError, ValueError):
            raise TypeError(f"{name} has no signature; give a function of (x) or (x, t)") from None
        positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
        parameters = [p for p in signature.parameters.values() if p.kind in positional]
        required = [p for p in parameters if p.default is inspect.Parameter.empty]
        count = 2 if len(parameters) > 1 and len(required) < 2 and parameters[1].name == "t" else len(required)
        if any(
            p.kind is inspect.Parameter.KEYWORD_ONLY and p.default is p.empty for p in signature.parameters.values()
        ):
            count = 0
    if count not in (1, 2):
        raise TypeError(f"{name} takes {count} positional arguments; give a function of (x) or (x, t)")
    check_places(function, name, "x, t" if count == 2 else "x")
    return count == 2


def with_time(function: Callable[..., Any], name: str) -> Callable[..., Any]:
    """Return a function of (x) or (x, t) as one of (x, t)."""
    return function if takes_time(function, name) else lambda x, t: function(x)


def check_arguments(function: Callable[..., Any], name: str, arguments: str) -> None:
    """Raise TypeError if a function cannot be called with arguments such as ``"x, h"``; no signature passes."""
    try:
        if isinstance(function, type) or not callable(function):
            raise TypeError
        inspect.signature(function).bind(*arguments.split(", "))
    except TypeError:
        raise TypeError(f"{name} is {short(function)}; it must be a function of ({arguments})") from None
    except ValueError:
        pass
    check_places(function, name, arguments)


def all_take_time(functions: dict[str, Callable[..., Any] | None]) -> bool:
    """Return whether all named functions (ignoring None) take the time; raise TypeError for a mixture."""
    timed = {name: takes_time(function, name) for name, function in functions.items() if function is not None}
    if len(set(timed.values())) > 1:
        with_time = next(name for name, flag in timed.items() if flag)
        without = next(name for name, flag in timed.items() if not flag)
        raise TypeError(f"{with_time} takes (x, t) but {without} takes (x); give both the same arguments")
    return any(timed.values())


def numbers_at_samples(function: Callable[..., Any], n: int, timed: bool) -> list[Any]:
    """Return the values of a Hamiltonian at sample points; raise TypeError if one is there, and no single number."""
    found, failures = [], list[Exception]()
    for x in sample_points(n):
        found.append(evaluate(function, x, timed, convert=False, failures=failures))
        returned = str(failures[0]) if failures and str(failures[0]).startswith("it returns") else ""
        if np.ndim(found[-1]):
            returned = f"it returns an array of the shape {np.shape(found[-1])}"
        if returned:
            raise TypeError(f"the Hamiltonian is {short(function)}, and {returned}; let it return one number")
    return found


def first_difference(
    reference: Callable[[Any, Any], Any], found: Any, y: npt.NDArray[np.float64], t: float, behind: int = 0
) -> str | None:
    """Return how values differ from those of a function at numbers y and a time beyond rounding; None if not."""
    # Of a flow, a function of a state with other numbers behind it, the changes of the state are compared.
    # Values differ by rounding if they are those at arguments that are moved by this part of themselves. One that is
    # not finite, as that of a compiled function that raises, may be finite if it is so there.
    states = y[: len(y) - behind] if behind else np.zeros(np.shape(found))
    with np.errstate(all="ignore"):
        wanted = np.asarray(reference(y, t), dtype=np.float64)
        known, finite = np.isfinite(wanted), np.isfinite(found)
        off = np.where(known & finite, np.abs(found - wanted), np.where(known == finite, 0.0, np.inf))
        tolerance = 16.0 * UNIT_ROUNDOFF * (np.abs(wanted) + np.abs(states)) + MOVED * np.abs(wanted - states)
        tolerance = np.where(known, tolerance, 0.0)
        if np.all(off <= tolerance):
            return None
        for signs in np.random.default_rng(SEED).choice([-1.0, 1.0], (4, len(y) + 1)):
            moved = y * (1.0 + MOVED * signs[:-1])
            there = np.asarray(reference(moved, t * (1.0 + MOVED * signs[-1])), dtype=np.float64)
            change = there - wanted - (moved[: len(states)] - y[: len(states)] if behind else 0.0)
            tolerance = np.where(known == np.isfinite(there), np.fmax(tolerance, 4.0 * np.abs(change)), np.inf)
    wrong = ~(off <= tolerance)
    if not wrong.any():
        return None
    k = np.unravel_index(int(np.argmax(wrong)), wrong.shape)
    return f"{float(found[k]):.6g} in place of {float(wanted[k]):.6g} at a sample point"


def check_derivative(
    function: Callable[..., Any],
    derivative: Callable[..., Any],
    *,
    names: tuple[str, str],
    shapes: tuple[tuple[int, ...], tuple[int, ...]],
    n: int | None,
    timed: bool,
) -> None:
    """Raise an error if `derivative` has the wrong shape, or disagrees with the central difference of `function`.

    Of automatic derivatives only gradients are compared, by several directions at several points: where large terms
    cancel, the round-off of a difference is not known.
    """
    evaluated, failure, contradictions = False, "", list[str]()
    failures: list[Exception] = []
    is_automatic = getattr(without_multiples(derivative)[0], "automatic", False)
    draws = np.random.default_rng(SEED + 2).standard_normal((AUTOMATIC_DIRECTIONS if is_automatic else 1, n or 1))
    points = sample_points(n or 1)
    for x in points:
        argument = x if n is not None else float(x[0])
        value, slope = (evaluate(one, argument, timed, failures=failures) for one in (function, derivative))
        if value is None or slope is None:
            failure = f"{names[0] if value is None else names[1]}: {failures[0]}"
            failures.clear()
            continue
        evaluated = True
        for name, result, shape in zip(names, (value, slope), shapes, strict=True):
            if result.shape != shape:
                raise ValueError(f"{name} returns shape {result.shape} at a sample point; it must return {shape}")
        if not (np.all(np.isfinite(value)) and np.all(np.isfinite(slope))) or (is_automatic and shapes[0]):
            continue
        if is_automatic:
            _check_repeatable(function, value, argument, names[0], timed)
            if not np.any(value):  # slopes may be what is left of terms that cancel
                continue
        told = (_contradiction(function, value, slope, x, draw, names, n, timed) for draw in draws)
        first = next(told)
        if first is not None and all(one is not None for one in told):
            contradictions.append(first)
    if not evaluated:
        raise ValueError(f"{names[0]} or {names[1]} fails at every sample point ({failure}); correct the function")
    if is_automatic and len(contradictions) >= min(2, len(points)):
        raise ValueError(
            f"{contradictions[0]}; the automatic {names[1]} is incomplete: the function hides a part of itself by "
            "detach, no_grad, stop_gradient or the like, or computes in a lower precision"
        )
    if contradictions and not is_automatic:
        raise ValueError(f"{contradictions[0]}; correct the one that is wrong")


def _check_repeatable(function: Callable[..., Any], value: Any, argument: Any, name: str, timed: bool) -> None:
    again = evaluate(function, argument, timed)
    if again is None or np.any(np.abs(again - value) > MOVED * np.abs(value)):
        raise ValueError(
            f"{name} is random: it is {short(value.tolist())} and then {short(np.asarray(again).tolist())} at one "
            "sample point; give a function of its arguments alone, such as a module after eval() without its dropout"
        )


def _contradiction(
    function: Callable[..., Any],
    value: npt.NDArray[np.float64],
    slope: npt.NDArray[np.float64],
    x: npt.NDArray[np.float64],
    draw: npt.NDArray[np.float64],
    names: tuple[str, str],
    n: int | None,
    timed: bool,
) -> str | None:
    """Return how a derivative contradicts the central difference of a function along a direction; None if not."""
    direction = draw / np.linalg.norm(draw)
    found = difference_along(function, value, x, direction, timed, vector=n is not None)
    if found is None:
        return None
    fine, tolerance = found
    declared = slope @ direction if n is not None else slope * direction[0]
    if np.abs(fine - declared).max(initial=0.0) <= tolerance:
        return None
    index = np.unravel_index(np.argmax(np.abs(fine - declared)), np.shape(fine)) if np.ndim(fine) else ()
    return (
        f"{names[1]} contradicts {names[0]}: along a sample direction it gives {float(declared[index]):.9g}, but the "
        f"central difference of {names[0]} is {float(fine[index]):.9g}"
    )


def check_skew(function: Callable[..., Any], n: int) -> None:
    """Raise ValueError unless a function of x returns skew (n, n) arrays at sample points."""
    for x in sample_points(n):
        with np.errstate(all="ignore"):
            J = read_numbers(function(x), "the value of structure_matrix")
            if J.shape != (n, n):
                raise ValueError(f"structure_matrix returns shape {J.shape}; it must return ({n}, {n})")
            size, excess = np.abs(J).max(initial=0.0), np.abs(J + J.T)
        # A point where J is not finite is skipped: it may lie outside the domain.
        if np.isfinite(size) and excess.max(initial=0.0) > 64 * UNIT_ROUNDOFF * size:
            i, j = (int(q) for q in np.unravel_index(np.argmax(excess), J.shape))
            raise ValueError(
                f"structure_matrix is not skew at a sample point: J[{i}, {j}] = {J[i, j]:g} and J[{j}, {i}] = "
                f"{J[j, i]:g}; their sum must be zero"
            )
