"""Collection of several errors of a file into one message."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from coadjoint.errors import in_one_line
from coadjoint.files.configuration.construction import ConfigurationError

MAX_REPORTED = 4
MAX_LINES = 20
MAX_LINE_LENGTH = 360  # of one line, without file name and separators


class ErrorCollector:
    """Collector of errors in the sections of the file `name`.

    Examples
    --------
    >>> wrong = ErrorCollector("run.toml")
    >>> with wrong.collect():
    ...     raise ConfigurationError("run.toml: run.step: step is 0")
    >>> with wrong.collect():
    ...     raise ConfigurationError("run.toml: initial.x: has 2 components")
    >>> wrong.raise_collected()
    Traceback (most recent call last):
    ...
    coadjoint.files.configuration.construction.ConfigurationError: run.toml: run.step: step is 0; and initial.x: has 2
    ...
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._found: list[ConfigurationError] = []

    @contextmanager
    def collect(self) -> Iterator[None]:
        """Collect an error raised inside, and continue."""
        try:
            yield
        except ConfigurationError as error:
            self._found.append(error)

    def add(self, said: str) -> None:
        """Add an error: key and reason."""
        self._found.append(ConfigurationError(f"{self._name}: {said}"))

    @property
    def none(self) -> bool:
        """Whether there are no errors."""
        return not self._found

    def raise_collected(self) -> None:
        """Raise the collected errors: a single one unchanged, several in one line; `error_lines` has one line for
        each.
        """
        if not self._found:
            return
        said = list(dict.fromkeys(one for error in self._found for one in error.error_lines or (str(error),)))
        if len(said) == 1:
            raise self._found[0]
        together = join_messages([one.removeprefix(f"{self._name}: ") for one in said])
        error = ConfigurationError(f"{self._name}: {together}")
        rest = len(said) - MAX_LINES
        error.error_lines = (*said[:MAX_LINES], *([f"{self._name}: {rest} more"] if rest > 0 else []))
        raise error from self._found[0].__cause__


def join_messages(said: Sequence[str]) -> str:
    """Join messages in one line, each truncated; beyond four, only their number.

    Examples
    --------
    >>> join_messages(["run.step: is missing; give it", "initial.x[1]: must be a number, not 'a'"])
    "run.step: is missing; give it; and initial.x[1]: must be a number, not 'a'"
    """
    told = list(dict.fromkeys(said))
    if len(told) == 1:
        return told[0]
    shown, rest = told[:MAX_REPORTED], len(told) - MAX_REPORTED
    lines = [in_one_line(one, MAX_LINE_LENGTH // len(shown)) for one in shown]
    return "; and ".join([*lines, *([f"{rest} more"] if rest > 0 else [])])
