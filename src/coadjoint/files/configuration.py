"""What does a configuration file ask for? Read, checked and turned into a run; nothing in it is executed."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from coadjoint.algebra.polynomial import Polynomial
from coadjoint.errors import in_one_line
from coadjoint.extras import need
from coadjoint.files.configuration_parts import ConfigurationError, method_of_file, section, system_of_file
from coadjoint.files.initial_states import initial_state
from coadjoint.files.polynomials import read_polynomial
from coadjoint.files.states_by_name import check_named, state_by_name
from coadjoint.files.written_events import event_of_file
from coadjoint.memory import available, in_words
from coadjoint.methods.base import Method
from coadjoint.methods.forced import check_serves, serving
from coadjoint.methods.splitting import Splitting
from coadjoint.methods.suggested import suggested_scheme
from coadjoint.runs.any_time import moments_of
from coadjoint.runs.events import Event
from coadjoint.runs.start import start_of
from coadjoint.runs.times import times_of
from coadjoint.systems.matrices.matrix_system import MatrixSystem

MOST_BYTES = 2**28
MOST_NESTED = 64
_STRING = r"""\"{3}(?:[^\\]|\\.)*?\"{3}|'{3}.*?'{3}|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'"""
_NESTING = re.compile(rf"{_STRING}|\#[^\n]*|[\[{{\]}}]", re.DOTALL)
# The time of the TOML reader grows like the third power of the number of parts.
_LONG_KEY = re.compile(rf"(?<![\w.])(?:(?:[\w-]+|\"[^\"\n]*\"|'[^'\n]*')[ \t]*\.[ \t]*){{{MOST_NESTED}}}")
_LONG_NUMBER = re.compile(r"\d[\d_]{3999,}")

__all__ = ["Configuration", "ConfigurationError", "load"]

if TYPE_CHECKING:
    import xarray

    from coadjoint.files.configuration_models import File
    from coadjoint.runs.solution import Solution


@dataclass(frozen=True)
class Configuration:
    """A run as a configuration file describes it, checked.

    Parameters
    ----------
    path : str
        The file, for messages.
    system, x0, t_span, step, method, save_every, t_eval, attitude, watch, observe, events, threads
        As for `coadjoint.integrate`.
    output, figure, movie : str or None
        Where the file wants the results; relative to the current directory.
    text : str
        The file itself, kept with the results.

    Examples
    --------
    >>> import tempfile
    >>> lines = '''
    ... system = {name = "rigid_body", parameters = {inertia = [1, 2, 3]}}
    ... initial = {x = [1.0, 0.1, 0.5]}
    ... method = {name = "Splitting", order = 4}
    ... run = {t_span = [0, 10], step = 0.1}
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "body.toml").write_text(lines)
    ...     configuration = load(f"{folder}/body.toml")
    >>> configuration.integrate().x.shape
    (101, 3)
    """

    path: str
    system: Any
    x0: Any
    t_span: tuple[float, float]
    step: float
    method: Method
    save_every: int = 1
    t_eval: Any = None
    attitude: Any = False
    watch: bool = True
    observe: Mapping[str, Polynomial] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    threads: int | None = None
    output: str | None = None
    figure: str | None = None
    movie: str | None = None
    text: str = field(default="", repr=False)

    def integrate(self, progress: bool = False) -> Solution:
        """Run it.

        Parameters
        ----------
        progress : bool
            Show a progress bar.

        Returns
        -------
        Solution

        Raises
        ------
        ConfigurationError
            The scheme refuses the system, or the saved states do not fit into memory.
        IntegrationError
            The run fails while running.
        """
        from coadjoint.runs.integrate import integrate

        self._check_memory()
        # `load` checked everything else. What is still refused here was found when the scheme was made ready.
        with section(self.path, "method"):
            return integrate(
                self.system,
                self.x0,
                self.t_span,
                self.step,
                self.method,
                save_every=self.save_every,
                t_eval=self.t_eval,
                attitude=self.attitude,
                watch=self.watch,
                observe=self.observe,
                events=self.events,
                threads=self.threads,
                progress=progress,
            )

    def _check_memory(self) -> None:
        """Refuse more saved states than there is memory for, before the first of them."""
        every = times_of(self.t_span, self.step, self.save_every).points
        points = every if self.t_eval is None else 2 * len(self.t_eval)
        start = start_of(self.system, serving(self.system, self.method), self.x0, self.attitude)
        numbers = self.system.dim + start.groups.shape[1] ** 2 + 1 + len(self.system.casimirs) + len(self.observe)
        needed, free = 8 * points * len(start.momenta) * numbers, available()
        if needed > free:
            raise ConfigurationError(
                f"{self.path}: run.save_every: the saved states do not fit into memory: they need {in_words(needed)}, "
                f"and this machine has {in_words(free)} free; save fewer of the steps"
            )

    def dataset(self, solution: Solution) -> xarray.Dataset:
        """Return a solution of this configuration as a dataset, the text of the file among its attributes.

        Parameters
        ----------
        solution : Solution
            From `integrate`, or the partial one of its failure.

        Returns
        -------
        xarray.Dataset
        """
        return solution.to_xarray().assign_attrs(configuration=self.text)


def load(path: str | Path) -> Configuration:
    """Read a configuration file and check all of it.

    Parameters
    ----------
    path : str or Path
        A TOML file.

    Returns
    -------
    Configuration

    Raises
    ------
    ConfigurationError
        In one sentence: file, key or line, what is wrong, and what would be right.

    Examples
    --------
    >>> load("none.toml")
    Traceback (most recent call last):
    ...
    coadjoint.files.configuration_parts.ConfigurationError: none.toml: cannot be read (No such file or directory)
    """
    need("reading a configuration file", "pydantic")
    from pydantic import ValidationError

    from coadjoint.files.configuration_models import File, first_error

    name, text = str(path), _text(path)
    try:
        file = File.model_validate(_parsed(name, text))
    except ValidationError as error:
        raise ConfigurationError(f"{name}: {': '.join(first_error(error))}") from None
    return _configuration(name, text, file)


def _text(path: str | Path) -> str:
    try:
        with open(path, "rb") as file:
            # A device may have no end, and a dataset that is taken for a configuration may be huge.
            given = file.read(MOST_BYTES + 1)
    except (OSError, ValueError) as reason:
        raise ConfigurationError(f"{path}: cannot be read ({getattr(reason, 'strerror', None) or reason})") from None
    if len(given) > MOST_BYTES:
        raise ConfigurationError(f"{path}: is longer than {MOST_BYTES} bytes; give long ensembles in Python")
    try:
        return given.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as reason:
        raise ConfigurationError(f"{path}: is not text in UTF-8 (byte {reason.start}); save it as such") from None


def _parsed(name: str, text: str) -> dict[str, Any]:
    found = _LONG_KEY.search(text)
    if found is not None:
        raise _wrong_at(name, text, found.start(), f"a key has more than {MOST_NESTED} parts")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as reason:
        said = str(reason)
    except RecursionError:
        raise _wrong_at(
            name, text, _deepest(text), f"lists and tables are nested deeper than {MOST_NESTED}; nest less"
        ) from None
    except ValueError as reason:
        # Python does not convert whole numbers of so many digits.
        digits = _LONG_NUMBER.search(text)
        place = len(text) if digits is None else digits.start()
        raise _wrong_at(name, text, place, "a whole number has too many digits" if digits else str(reason)) from None
    at = re.search(r" \(at line (\d+), column (\d+)\)$", said)
    line, column = (int(at[1]), int(at[2])) if at else _line_and_column(text, len(text))
    said = re.sub(r" \(at [^()]*\)$", "", said)
    raise ConfigurationError(f"{name}: line {line}, column {column}: {said[:1].lower()}{in_one_line(said[1:], 300)}")


def _wrong_at(name: str, text: str, place: int, said: str) -> ConfigurationError:
    line, column = _line_and_column(text, place)
    key = re.match(r"\s*([\w.-]{1,60})\s*=", text[: place + 1].rpartition("\n")[2])
    return ConfigurationError(f"{name}: line {line}, column {column}: {key[1] + ': ' if key else ''}{said}")


def _line_and_column(text: str, place: int) -> tuple[int, int]:
    return text.count("\n", 0, place) + 1, place - text.rfind("\n", 0, place)


def _deepest(text: str) -> int:
    """Return the place of the first bracket that is nested too deeply."""
    depth = 0
    for found in _NESTING.finditer(text):
        depth += {"[": 1, "{": 1, "]": -1, "}": -1}.get(found[0], 0)
        if depth > MOST_NESTED:
            return found.start()
    return len(text)


def _method(name: str, file: File, system: Any) -> Method:
    """Return the scheme of a file; where it says none, as `integrate` takes it."""
    if file.method is not None:
        return method_of_file(name, file.method)
    return suggested_scheme(cast(Any, system)) if isinstance(system, MatrixSystem) else Splitting()


def _configuration(name: str, text: str, file: File) -> Configuration:
    check_named(name, file)
    system: Any = system_of_file(name, file)
    method = _method(name, file, system)
    with section(name, "method"):
        check_serves(system, method)
    with section(name, "run"):
        times = times_of(file.run.t_span, file.run.step, file.run.save_every)
        if file.run.t_eval is not None:
            moments_of(file.run.t_eval, times, file.run.save_every)
    x0 = state_by_name(name, file.initial, system)
    with section(name, "initial.x"):
        x0 = initial_state(system, file.initial.x, Path(name).parent) if x0 is None else x0
        start_of(system, serving(system, method), x0, False)
    with section(name, "initial.attitude"):
        start_of(system, serving(system, method), x0, file.initial.attitude)
    observe = {}
    for key, written in file.observe.items():
        with section(name, f"observe.{key}"):
            if isinstance(system, MatrixSystem):
                raise ValueError(f"a polynomial is one of coordinates; the states of {system.name} are matrices")
            observe[key] = read_polynomial(written, system.dim)
    events = []
    for key, table in file.events.items():
        with section(name, f"events.{key}"):
            events.append(event_of_file(key, table.model_dump(), system))
    return Configuration(
        path=name,
        system=system,
        x0=x0,
        t_span=(float(file.run.t_span[0]), float(file.run.t_span[1])),
        step=file.run.step,
        method=method,
        save_every=file.run.save_every,
        t_eval=file.run.t_eval,
        attitude=file.initial.attitude,
        watch=file.run.watch,
        observe=observe,
        events=tuple(events),
        threads=file.run.threads,
        output=file.output.file,
        figure=file.output.figure,
        movie=file.output.movie,
        text=text,
    )
