"""Configuration files as runs: parsed, validated together with system and scheme, and run; results as datasets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coadjoint.files.configuration.models import File
from coadjoint.files.configuration.parsing import (
    SYSTEM_KEYS,
    Problems,
    parse_tables,
    parse_toml,
    read_utf8,
    section,
    system_of_file,
)
from coadjoint.files.configuration.sweeps import SettingsSweep, read_sweep
from coadjoint.files.datasets.variables import over_members
from coadjoint.files.datasets.writers import CHECKSUM
from coadjoint.files.records.reconstruction import event_of_file, polynomial_of
from coadjoint.methods.forced import check_supports
from coadjoint.methods.registry import default_scheme, from_description
from coadjoint.optional_packages import require_packages
from coadjoint.runs.error_estimates import warn_of_large_step
from coadjoint.runs.events import Event
from coadjoint.runs.integrate import chosen_for
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution, with_choice
from coadjoint.runs.start import momenta_of
from coadjoint.systems.coordinates import coordinates_of
from coadjoint.validation import read_path

if TYPE_CHECKING:
    import xarray

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


def system_of_text(text: str) -> Any:
    """Return the system of a configuration from the text of its file, as stored with a result."""
    problems = Problems(STORED)
    file, _, sweep = _read_tables(text, problems)
    problems.check()
    return system_of_file(STORED, file) if sweep is None else sweep.system(file)


def outputs_of_text(text: str) -> dict[str, str | None]:
    """Return the declared paths of results of a configuration from the text of its file, as stored with a result."""
    problems = Problems(STORED)
    file = parse_tables(parse_toml(STORED, text), problems, ("output",))
    problems.check()
    return file.output.model_dump()


def load(path: str | Path) -> Configuration:
    """Read and validate a configuration file, in TOML; ConfigurationError has file, key, reason, and remedy."""
    require_packages("reading a configuration file", "pydantic")
    name, text = str(read_path(path, "path")), read_utf8(path)
    return _configuration(text, Problems(name))


def _read_tables(text: str, problems: Problems) -> tuple[File, set[str], SettingsSweep | None]:
    """Return the valid tables of a file (of a sweep, those of its first member), the keys of the others, the sweep."""
    raw, sweep = parse_toml(problems.name, text), None
    if "sweep" in raw:
        table = parse_tables(raw, problems, ("sweep",)).sweep
        raw_of_file = {key: value for key, value in raw.items() if key != "sweep"}
        with problems.at("sweep"):
            raw = raw_of_file
            found = None if table is None else read_sweep(problems.name, raw, table)
            raw, sweep = raw if found is None else found.tables(0), found
    file = parse_tables(raw, problems)
    return file, raw.keys() - file.model_fields_set, sweep


def _configuration(text: str, problems: Problems) -> Configuration:
    """Validate the tables of a file together, as far as they are valid."""
    name = problems.name
    file, invalid, sweep = _read_tables(text, problems)
    system: Any = None
    method: Any = None
    x0: Any = None
    if not invalid & SYSTEM_KEYS:
        with problems.at("system"):
            system = system_of_file(name, file) if sweep is None else sweep.system(file)
    with problems.at("method"):
        if file.method is not None:
            method = from_description(file.method)
        elif system is not None:
            method = default_scheme(system)
        if system is not None:
            check_supports(system.of_member(0), method)
    observe, events = {}, []
    if system is not None:
        if "initial" in file.model_fields_set:
            with problems.at("initial"):
                x0 = file.initial.state(system, Path(name).parent) if sweep is None else sweep.states(system)
                momenta_of(system, x0)
        for key, polynomial in file.observe.items():
            with problems.at(f"observe.{key}"):
                coordinates = coordinates_of(system)
                if not coordinates:
                    raise ValueError(f"a polynomial needs coordinates; the states of {system.name} are matrices")
                observe[key] = polynomial_of(polynomial, system.dim, coordinates)
        for key, table in file.events.items():
            with problems.at(f"events.{key}"):
                events.append(event_of_file(key, table.model_dump(), system))
    problems.check()
    run, attitude, choice = file.run, file.initial.attitude, None
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
        if (run.workers is not None or file.output.archive is not None) and (run.t_eval is not None or events):
            raise ValueError("saves every save_every-th step and has no events; omit it, or t_eval and events")
        if run.workers is not None:
            require_packages("workers", "distributed")
            if momenta_of(system, x0)[1]:
                raise ValueError("workers are for the members of an ensemble, and the file has one state; omit workers")
    swept = {} if sweep is None else sweep.values
    return Configuration(name, text, file, prepared, x0, tuple(events), choice, swept)
