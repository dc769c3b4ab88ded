"""Errors of the library and the wording that several of them share."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Iterable
from typing import Any

from coadjoint.wording import short


class IntegrationError(RuntimeError):
    """A run failed while running: a fixed point did not converge, or a number overflowed.

    Parameters
    ----------
    message : str
        What failed, where, and what would help.
    step : int
        Number of the step that failed (the first step is 1).
    time : float
        Time at the start of that step.
    residual : float
        Size of the last correction of an iteration that did not converge; NaN for an overflow.
    partial : Solution, optional
        The solution up to the last saved point before the failure.

    Examples
    --------
    >>> import coadjoint as co
    >>> error = co.IntegrationError("no convergence", step=3, time=0.2, residual=1e-3)
    >>> error.step, error.time
    (3, 0.2)
    """

    def __init__(self, message: str, *, step: int, time: float, residual: float, partial: Any = None) -> None:
        super().__init__(message)
        self.step = step
        self.time = time
        self.residual = residual
        self.partial = partial

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what another process makes the same error of."""
        return _restored, (str(self), self.step, self.time, self.residual, self.partial)


def _restored(message: str, step: int, time: float, residual: float, partial: Any) -> IntegrationError:
    return IntegrationError(message, step=step, time=time, residual=residual, partial=partial)


class OneLineError(ValueError):
    """An error whose message is one line of bounded length, whatever it names.

    Parameters
    ----------
    message : str
        What is wrong, where, and what would be right.

    Examples
    --------
    >>> len(str(OneLineError("a name of a file " * 1000))) <= LONGEST_SENTENCE
    True
    """

    def __init__(self, message: str) -> None:
        super().__init__(in_one_line(message, LONGEST_SENTENCE))


LONGEST_SENTENCE = 900
MOST_LISTED = 40
"""Names that a message lists; of more it says where they are found."""


def unknown_name(kind: str, name: Any, known: Iterable[str]) -> ValueError:
    """Return the error for an unknown name, with the nearest known one.

    Parameters
    ----------
    kind : str
        What is named, for instance ``"algebra"``.
    name : str
        The name that was given; what is no string is refused without a guess.
    known : iterable of str
        The names that exist.

    Returns
    -------
    ValueError
        To be raised by the caller.

    Examples
    --------
    >>> print(unknown_name("algebra", "so4", ["so(4)", "sl(2)"]))
    unknown algebra 'so4'; did you mean 'so(4)'?
    """
    names = sorted(known)
    if not isinstance(name, str):
        return ValueError(f"unknown {kind} {short(name)}; give a name, such as {names[0]!r}")
    near = nearest(name, names)
    if near is None and len(names) <= MOST_LISTED:
        return ValueError(f"unknown {kind} {short(name)}; there are: {', '.join(names)}")
    return ValueError(f"unknown {kind} {short(name)}; did you mean {near or nearest(name, names, least=0.0)!r}?")


def nearest(name: str, known: Iterable[str], least: float = 0.5) -> str | None:
    """Return the known name that is most like a given one, or None where none is near.

    Parameters
    ----------
    name : str
        The name that was given, of any length.
    known : iterable of str
        The names that exist.
    least : float, optional
        How much a name must be like the given one to be near: 0 takes any, 1 the same alone.

    Returns
    -------
    str or None

    Examples
    --------
    >>> nearest("stpe", ["t_span", "step"]), nearest("x", ["t_span", "step"])
    ('step', None)
    """
    names = sorted(known)
    # What is much longer than every name is compared by its beginning: the time grows like the square of it.
    beginning = name[: 2 * max(map(len, names), default=0)]
    alike = [known for known in names if known.casefold() == beginning.casefold()]
    if alike:
        return alike[0]
    stem = beginning.casefold().rstrip("s")
    around = [known for known in names if len(stem) > 3 and stem in known.casefold()]
    if around and not difflib.get_close_matches(beginning, names, n=1, cutoff=0.75):
        return min(around, key=len)
    return next(iter(difflib.get_close_matches(beginning, names, n=1, cutoff=least)), None)


def no_attribute(module: str, name: str, known: Iterable[str]) -> AttributeError:
    """Return the error for a name that a module does not have, with the nearest one and the list.

    Parameters
    ----------
    module : str
        As users write it, such as ``"co.systems"``.
    name : str
        What was asked for.
    known : iterable of str
        The public names.

    Returns
    -------
    AttributeError
        To be raised by the caller.

    Examples
    --------
    >>> print(no_attribute("co.systems", "heavi_top", ["heavy_top", "toda"]))
    co.systems has no attribute 'heavi_top'; did you mean 'heavy_top'? It has: heavy_top, toda
    """
    text = f"{module} has no attribute {name!r}"
    if name.startswith("_"):  # what Python and other libraries look for, to see what a module can do
        return AttributeError(text)
    if module != "coadjoint" and name in getattr(sys.modules.get("coadjoint"), "__all__", ()):
        return AttributeError(f"{text}; it is co.{name}")
    names = sorted(known)
    near = nearest(name, names)
    listed = f"It has: {', '.join(names)}" if len(names) <= MOST_LISTED else f"dir({module}) lists what it has"
    return AttributeError(text + (f"; did you mean {near!r}? {listed}" if near else f". {listed}"))


def in_one_line(message: str, limit: int = 400) -> str:
    """Return a message in one line of printable letters, its middle left out where it is long.

    Parameters
    ----------
    message : str
        Of any length; only its ends are read where it is long.
    limit : int
        Most letters of the line.

    Returns
    -------
    str

    Examples
    --------
    >>> in_one_line("two   words")
    'two words'
    >>> in_one_line("a" * 10**6, 12)
    'aaaa ... aaa'
    """
    ends = message if len(message) <= 8 * limit else f"{message[: 4 * limit]} ... {message[-4 * limit :]}"
    line = "".join(letter if letter.isprintable() else "?" for letter in " ".join(ends.split()))
    head, tail = limit // 2 - 2, limit - limit // 2 - 3
    return line if len(line) <= limit else f"{line[:head]} ... {line[-tail:]}"
