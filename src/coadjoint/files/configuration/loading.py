"""Configuration files as runs: parsed, validated together with system and scheme, and run; results as datasets."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coadjoint.algebra.exact.numbers import parse_decimal
from coadjoint.files.configuration.models import MAX_SHOWN_LENGTH, File, section, system_of_file, validate
from coadjoint.files.configuration.sweeps import SettingsSweep, read_sweep
from coadjoint.files.datasets.variables import over_members
from coadjoint.files.datasets.writers import CHECKSUM
from coadjoint.files.records.reconstruction import event_of_file, polynomial_of
from coadjoint.methods.forced import check_supports
from coadjoint.methods.registry import default_scheme
from coadjoint.optional_packages import require_packages
from coadjoint.runs.error_estimates import warn_of_large_step
from coadjoint.runs.events import Event
from coadjoint.runs.integrate import chosen_for
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution, with_choice
from coadjoint.runs.start import momenta_of
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import coordinates_of
from coadjoint.validation import read_path

if TYPE_CHECKING:
    import xarray

MAX_LENGTH = 2**28  # characters of a file; longer ensembles are given in Python
MAX_PARTS = 64
# tomllib needs cubic time in the number of parts of a dotted key.
_LONG_KEY = re.compile(rf"(?<![\w.])(?:(?:[\w-]+|\"[^\"\n]*\"|'[^'\n]*')[ \t]*\.[ \t]*){{{MAX_PARTS}}}")
CONFIGURATION = "configuration"
"""Attribute with the text of the file."""
STORED = "the configuration of this run"


@dataclass(frozen=True)
class Configuration:
    """A validated run: the tables of a file, and the objects that they describe.

    Method and step are those of `choice`, if the file has an accuracy; `swept` has a value of each key for each member.
    """

    path: str
    text: str = field(repr=False)
    file: File
    prepared: PreparedRun
    x0: Any
    events: tuple[Event, ...] = ()
    choice: Any = None
    swept: Mapping[str, Sequence[Any]] = field(default_factory=dict, repr=False)

    @property
    def outputs(self) -> dict[str, str | None]:
        """Paths of the results, relative to the current directory."""
        return self.file.output.model_dump()

    def integrate(self, progress: bool = False, archive: str | Path | None = None) -> Solution:
        """Integrate the described run, into a new folder `archive` if it is given."""
        run, prepared = self.file.run, self.prepared
        options: Any = {"t_eval": run.t_eval, "events": self.events or None, "progress": progress}
        if archive is None and run.workers is None:
            with section(self.path, "run"):
                solution = prepared.run(self.x0, run.span, run.save_every, **options)
                if self.choice is None:
                    warn_of_large_step(solution, prepared)
            return with_choice(solution, self.choice)
        from coadjoint.files.archives.ensemble import read_worker_pool, run_in_blocks
        from coadjoint.files.archives.resume import archive_run

        stored: Any = {"coordinates": over_members(self.swept), "attributes": {CONFIGURATION: self.text}}
        asked = self.x0, run.span, run.save_every
        if run.workers is not None:
            pool = read_worker_pool(None, run.workers, run.threads)
            stored["events"] = self.events or None
            solution = run_in_blocks(prepared, *asked, archive, pool, progress=progress, **stored)
        else:
            assert archive is not None
            solution = archive_run(prepared, *asked, archive=archive, **{**options, **stored})
        return with_choice(solution, self.choice)

    def dataset(self, solution: Solution) -> xarray.Dataset:
        """Return a solution, or a partial one, as a dataset with the text of the file and the settings of a sweep."""
        dataset = solution.to_xarray().drop_encoding().assign_attrs({CONFIGURATION: self.text})
        dataset.attrs.pop(CHECKSUM, None)  # it does not cover the additions
        return dataset.assign_coords(over_members(self.swept))


def read_utf8(path: str | Path) -> str:
    """Read a file as UTF-8 with normalized line ends, without a byte-order mark."""
    with section(path, ""):
        with open(path, encoding="utf-8-sig") as file:
            # Devices may be endless, and a dataset given by mistake may be huge.
            text = file.read(MAX_LENGTH + 1)
        if len(text) > MAX_LENGTH:
            raise ValueError(f"is longer than {MAX_LENGTH} characters; give long ensembles in Python")
        return text


def parse_toml(name: str, text: str) -> dict[str, Any]:
    """Parse TOML, the file of this name, with decimal numbers that float64 can represent."""

    def number(literal: str) -> float:
        # Numbers that are not finite are refused by their keys.
        return parse_decimal(literal) if math.isfinite(float(literal)) else float(literal)

    with section(name, ""):
        if (long_key := _LONG_KEY.search(text)) is not None:
            raise ValueError(f"the key {short(long_key[0], MAX_SHOWN_LENGTH)} has more than {MAX_PARTS} parts")
        return tomllib.loads(text, parse_float=number)


def system_of_text(text: str) -> Any:
    """Return the system of a configuration from the text of its file, as stored with a result."""
    file, sweep = _read_tables(STORED, text)
    return system_of_file(STORED, file) if sweep is None else sweep.system(file)


def outputs_of_text(text: str) -> dict[str, str | None]:
    """Return the declared paths of results of a configuration from the text of its file, as stored with a result."""
    return validate(STORED, parse_toml(STORED, text), "output").output.model_dump()


def _read_tables(name: str, text: str) -> tuple[File, SettingsSweep | None]:
    """Return the tables of a file, those of the first member of a sweep, and the sweep."""
    raw = parse_toml(name, text)
    table = validate(name, raw, "sweep").sweep
    if table is None:
        return validate(name, raw), None
    sweep = read_sweep(name, {key: value for key, value in raw.items() if key != "sweep"}, table)
    return sweep.file(0), sweep


def load(path: str | Path) -> Configuration:
    """Read and validate a configuration file, in TOML; ConfigurationError has file, key, reason, and remedy."""
    require_packages("reading a configuration file", "pydantic")
    name, text = str(read_path(path, "path")), read_utf8(path)
    file, sweep = _read_tables(name, text)
    run, attitude, choice = file.run, file.initial.attitude, None
    system = system_of_file(name, file) if sweep is None else sweep.system(file)
    with section(name, "method"):
        method: Any = default_scheme(system) if file.method is None else file.method
        check_supports(system.of_member(0), method)
    with section(name, "initial"):
        x0 = file.initial.state(system, Path(name).parent) if sweep is None else sweep.states(system)
        momenta_of(system, x0)
    observe, events = {}, []
    for key, polynomial in file.observe.items():
        with section(name, f"observe.{key}"):
            coordinates = coordinates_of(system)
            if not coordinates:
                raise ValueError(f"a polynomial needs coordinates; the states of {system.name} are matrices")
            observe[key] = polynomial_of(polynomial, system.dim, coordinates)
    for key, event in file.events.items():
        with section(name, f"events.{key}"):
            events.append(event_of_file(key, event.model_dump(), system))
    if run.accuracy is not None:
        with section(name, "run.accuracy"):
            given = None if file.method is None else method
            choice = chosen_for(run.accuracy, system, x0, run.span, attitude, given)
    with section(name, "initial.attitude"):
        step: Any
        method, step = (method, run.step) if choice is None else (choice.method, choice.step)
        options: Any = {"attitude": attitude, "watch": run.watch, "observe": observe, "threads": run.threads}
        prepared = PreparedRun(system, method, step, **options)
        prepared.start(x0)
    with section(name, "run"):
        prepared.times_of(run.span, run.save_every, run.t_eval)
    key = "run.workers" if run.workers is not None else "output.archive"
    with section(name, key):
        if (run.workers is not None or file.output.archive is not None) and run.t_eval is not None:
            raise ValueError("saves every save_every-th step; omit it, or t_eval")
        if run.workers is not None:
            require_packages("workers", "distributed")
            if momenta_of(system, x0)[1]:
                raise ValueError("workers are for the members of an ensemble, and the file has one state; omit workers")
    swept = {} if sweep is None else sweep.values
    return Configuration(name, text, file, prepared, x0, tuple(events), choice, swept)
