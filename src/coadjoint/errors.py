"""Exceptions of the library and message helpers shared by several of them."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Callable, Iterable
from typing import Any

from coadjoint.short_repr import short


class IntegrationError(RuntimeError):
    """A run failed: an iteration did not converge, a number overflowed, or a flow was too long.

    Parameters
    ----------
    message : str
        What failed, where, and a remedy.
    step : int
        Number of the step that failed (the first step is 1).
    time : float
        Time at the start of that step.
    residual : float
        Size of the last correction of an iteration that did not converge; NaN for an overflow.
    partial : Solution, optional
        The solution up to the last saved point before the failure.
    derivatives : Tangents or Gradient, optional
        If derivatives of a run overflow: those of all members, of which others are not affected.

    Examples
    --------
    >>> import coadjoint as co
    >>> error = co.IntegrationError("no convergence", step=3, time=0.2, residual=1e-3)
    >>> error.step, error.time
    (3, 0.2)
    """

    def __init__(
        self, message: str, *, step: int, time: float, residual: float, partial: Any = None, derivatives: Any = None
    ) -> None:
        super().__init__(message)
        self.step = step
        self.time = time
        self.residual = residual
        self.partial, self.derivatives = partial, derivatives

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the error by its arguments."""
        return _restored, (str(self), self.step, self.time, self.residual, self.partial, self.derivatives)


def _restored(
    message: str, step: int, time: float, residual: float, partial: Any, derivatives: Any
) -> IntegrationError:
    return IntegrationError(message, step=step, time=time, residual=residual, partial=partial, derivatives=derivatives)


class LargeStepWarning(UserWarning):
    """Warning that the step of a run is so large that the scheme does not follow the motion; see `Solution.step_error`.

    The error over the run, or the deviation of an invariant from its start or from the work of forces, is more than 5
    per cent. Kept invariants do not show the contrary, since a scheme that preserves them does so at any step.

    Examples
    --------
    Make it an error:

    >>> import warnings
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", LargeStepWarning)
    """


class RoundingWarning(UserWarning):
    """Warning that rounding changes a group of coordinates by about 2 per cent of its size, or more, in a run.

    It comes of larger numbers that nearly cancel in each step, such as the torque of a central force, or of steps that
    turn the group by so many radians that float64 has no digits of the angle. Shorter steps do not help. See
    `Solution.error_estimate` with ``by_group=True``.

    Examples
    --------
    Make it an error:

    >>> import warnings
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", RoundingWarning)
    """


class OneLineError(ValueError):
    """Base class of errors whose message is one line of bounded length."""

    def __init__(self, message: str) -> None:
        super().__init__(in_one_line(message, MAX_MESSAGE_LENGTH))


class ConfigurationError(OneLineError):
    """A configuration file is invalid; the message has the file, the key, and the correction."""

    error_lines: tuple[str, ...] = ()
    """One line for each error, if there are several."""


MAX_MESSAGE_LENGTH = 900  # characters: some lines of a terminal, whatever the value that is named
MAX_LISTED_NAMES = 50
"""Maximum number of names listed in a message."""


def unknown_name(kind: str, name: Any, known: Iterable[str]) -> ValueError:
    """Return the ValueError for an unknown name of a `kind`, with the nearest known one if the name is a string."""
    names = sorted(known)
    few = len(names) <= MAX_LISTED_NAMES
    if not isinstance(name, str):
        listing = f"give one of the names: {', '.join(names)}" if few else f"give a name, such as {names[0]!r}"
        return ValueError(f"unknown {kind} {short(name)}; {listing}")
    longer = [one for one in names if one.startswith(f"{name} ")][:MAX_LISTED_NAMES]
    if longer:
        return ValueError(f"unknown {kind} {short(name)}; there are: {', '.join(longer)}")
    near = nearest(name, names)
    if near is None and few:
        return ValueError(f"unknown {kind} {short(name)}; there are: {', '.join(names)}")
    near = near or nearest(name, names, min_similarity=0.0)
    return ValueError(f"unknown {kind} {short(name)}; did you mean {near!r}?")


def check_name_is_free(what: str, name: str, new: Any, known: Any) -> None:
    """Raise ValueError if a name is that of another function or class; the same one may be defined again."""
    places = [(getattr(one, "__module__", None), getattr(one, "__qualname__", None)) for one in (new, known)]
    if known is not None and places[0] != places[1]:
        raise ValueError(f"{name!r} is the name of a {what} already, of {places[1][0]}; take another name")


def nearest(name: str, known: Iterable[str], min_similarity: float = 0.5) -> str | None:
    """Return the known name most similar to a given one; None below `min_similarity`, from 0 (any) to 1 (equal)."""
    names = sorted(known)
    # Names much longer than any known one are truncated, since the time is quadratic in the length.
    beginning = name[: 2 * max(map(len, names), default=0)]
    names = [one for one in names if _words_agree(beginning, one, min_similarity)]
    equal = [known for known in names if known.casefold() == beginning.casefold()]
    if equal:
        return equal[0]
    stem = beginning.casefold().rstrip("s")
    containing = [known for known in names if len(stem) > 3 and stem in known.casefold()]
    if containing and not difflib.get_close_matches(beginning, names, n=1, cutoff=0.75):
        return min(containing, key=len)
    return next(iter(difflib.get_close_matches(beginning, names, n=1, cutoff=min_similarity)), None)


def _words_agree(name: str, known: str, min_similarity: float) -> bool:
    """Test whether each of several words is similar to that of a known name; True for other numbers of words."""
    pairs = list(zip(name.split(), known.split(), strict=False))
    if len(pairs) < 2 or len(name.split()) != len(known.split()):
        return True
    return all(difflib.SequenceMatcher(None, *pair).ratio() >= min_similarity for pair in pairs)


def unknown_attribute(module: str, name: str, known: Iterable[str]) -> AttributeError:
    """Return the AttributeError for a missing name of a module, with the nearest one and the list of public names.

    >>> print(unknown_attribute("co.systems", "heavi_top", ["heavy_top", "toda"]))
    co.systems has no attribute 'heavi_top'; did you mean 'heavy_top'? It has: heavy_top, toda
    """
    text = f"{module} has no attribute {name!r}"
    if name.startswith("_"):  # protocol probes by Python and other libraries
        return AttributeError(text)
    if module != "coadjoint" and name in dir(sys.modules.get("coadjoint")):
        return AttributeError(f"{text}; it is co.{name}")
    names = sorted(known)
    near = nearest(name, names)
    listing = f"It has: {', '.join(names)}" if len(names) <= MAX_LISTED_NAMES else f"dir({module}) lists what it has"
    return AttributeError(text + (f"; did you mean {near!r}? {listing}" if near else f". {listing}"))


def refuse_others(module: str, names: list[str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a module that has these public names, for its `unknown_attribute`."""

    def __getattr__(name: str) -> Any:
        raise unknown_attribute(module, name, names)

    return __getattr__, lambda: names


def in_one_line(message: str, limit: int = 400) -> str:
    """Return a message as one line of at most `limit` printable characters, with the middle elided if it is long."""
    ends = message if len(message) <= 8 * limit else f"{message[: 4 * limit]} ... {message[-4 * limit :]}"
    line = "".join(letter if letter.isprintable() else "?" for letter in " ".join(ends.split()))
    head, tail = limit // 2 - 2, limit - limit // 2 - 3
    return line if len(line) <= limit else f"{line[:head].rstrip()} ... {line[-tail:].lstrip()}"
