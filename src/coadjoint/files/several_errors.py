"""What is all wrong with a file? Its mistakes are told together, as far as they can be found."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from coadjoint.errors import in_one_line
from coadjoint.files.configuration_parts import ConfigurationError

MOST_TOLD = 4
MOST_LINES = 20
LETTERS = 360  # of one line, beside the name of the file and what stands between


class SeveralErrors:
    """Collects what is refused in the sections of a file.

    Parameters
    ----------
    name : str
        The file's name, with which each message begins.

    Examples
    --------
    >>> wrong = SeveralErrors("run.toml")
    >>> with wrong.caught():
    ...     raise ConfigurationError("run.toml: run.step: step is 0")
    >>> with wrong.caught():
    ...     raise ConfigurationError("run.toml: initial.x: has 2 components")
    >>> wrong.tell()
    Traceback (most recent call last):
    ...
    coadjoint.files.configuration_parts.ConfigurationError: run.toml: run.step: step is 0; and initial.x: has 2 ...
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._found: list[ConfigurationError] = []

    @contextmanager
    def caught(self) -> Iterator[None]:
        """Keep what is refused inside, and go on."""
        try:
            yield
        except ConfigurationError as error:
            self._found.append(error)

    def add(self, said: str) -> None:
        """Keep what was found to be wrong: a key and the reason."""
        self._found.append(ConfigurationError(f"{self._name}: {said}"))

    @property
    def none(self) -> bool:
        """Whether nothing was refused so far."""
        return not self._found

    def tell(self) -> None:
        """Raise what was refused: one error as it is, several in one line; `mistakes` has each in a line of its own."""
        if not self._found:
            return
        said = list(dict.fromkeys(one for error in self._found for one in error.mistakes or (str(error),)))
        if len(said) == 1:
            raise self._found[0]
        together = told_together([one.removeprefix(f"{self._name}: ") for one in said])
        error = ConfigurationError(f"{self._name}: {together}")
        rest = len(said) - MOST_LINES
        error.mistakes = (*said[:MOST_LINES], *([f"{self._name}: {rest} more"] if rest > 0 else []))
        raise error from self._found[0].__cause__


def told_together(said: Sequence[str]) -> str:
    """Return messages as one line, each cut so that all are seen; beyond four only their number.

    Examples
    --------
    >>> told_together(["run.step: is missing; give it", "initial.x[1]: must be a number, not 'a'"])
    "run.step: is missing; give it; and initial.x[1]: must be a number, not 'a'"
    """
    told = list(dict.fromkeys(said))
    if len(told) == 1:
        return told[0]
    shown, rest = told[:MOST_TOLD], len(told) - MOST_TOLD
    lines = [in_one_line(one, LETTERS // len(shown)) for one in shown]
    return "; and ".join([*lines, *([f"{rest} more"] if rest > 0 else [])])
