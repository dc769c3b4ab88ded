"""Configuration files as runs: parsed, validated together with system and scheme, and run; results as datasets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import BaseModel, ValidationError

from coadjoint import systems
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.errors import ConfigurationError
from coadjoint.files.configuration.construction import (
    ErrorCollector,
    check_named,
    initial_state,
    join_messages,
    method_of_file,
    parse_polynomial,
    section,
    state_by_name,
    system_of_file,
)
from coadjoint.files.configuration.models import File, OutputTable, SweepTable
from coadjoint.files.configuration.parsing import (
    SYSTEM_TABLES,
    all_errors,
    keys_by_table,
    named_in,
    parse_toml,
    read_utf8,
    valid_tables,
)
from coadjoint.files.configuration.sweeps import SettingsSweep, read_sweep, swept_states, swept_system
from coadjoint.files.datasets.variables import Variables, over_members
from coadjoint.files.datasets.writers import CHECKSUM
from coadjoint.files.records.reconstruction import event_of_file
from coadjoint.memory import check_available_memory
from coadjoint.methods.forced import check_steps, check_supports, effective_scheme
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.registry import default_scheme
from coadjoint.optional_packages import require_packages
from coadjoint.runs.events import Event
from coadjoint.runs.integrate import chosen_for, integrate
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution, with_choice
from coadjoint.runs.start import momenta_of, start_of
from coadjoint.runs.times import output_times_of, times_of
from coadjoint.systems.coordinates import coordinates_of
from coadjoint.validation import read_path

CONFIGURATION = "configuration"
"""Attribute with the text of the file."""

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True)
class Configuration:
    """A validated run described by a configuration file, with the arguments of `coadjoint.integrate`.

    The paths of results, `outputs`, are relative to the current directory. `choice` is that for an accuracy in the
    file; `swept` maps keys to values, one for each member.
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
    workers: int | None = None
    outputs: Mapping[str, str | None] = field(default_factory=dict)
    choice: Any = None
    swept: Mapping[str, list[Any]] = field(default_factory=dict, repr=False)
    text: str = field(default="", repr=False)

    def integrate(self, progress: bool = False, archive: str | Path | None = None) -> Solution:
        """Integrate the described run, into a new folder `archive` if it is given."""
        if archive is not None or self.workers is not None:
            return self._integrate_to_archive(archive, progress)
        self.check_memory()
        # `load` has validated the rest; errors here come from the preparation of the scheme.
        with section(self.path, "method"):
            solution = integrate(
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
        return with_choice(solution, self.choice)

    def ready(self) -> PreparedRun:
        """Return the prepared run."""
        with section(self.path, "method"):
            return PreparedRun(
                self.system,
                self.method,
                self.step,
                attitude=self.attitude,
                watch=self.watch,
                observe=self.observe,
                threads=self.threads,
            )

    def _integrate_to_archive(self, archive: str | Path | None, progress: bool) -> Solution:
        from coadjoint.files.archives.resume import archive_run

        if archive is not None:
            check_archived(self.path, self.t_eval, self.events)
        prepared = self.ready()
        stored: dict[str, Any] = {"coordinates": self.swept_coordinates(), "attributes": {CONFIGURATION: self.text}}
        if self.workers is not None:
            from coadjoint.files.archives.ensemble import read_worker_pool, run_in_blocks

            pool = read_worker_pool(None, self.workers, self.threads)
            arguments = prepared, self.x0, self.t_span, self.save_every, archive, pool
            return with_choice(run_in_blocks(*arguments, progress=progress, **stored), self.choice)
        assert archive is not None
        arguments_of_run = prepared, self.x0, self.t_span, self.save_every, archive
        return with_choice(archive_run(*arguments_of_run, progress=progress, **stored), self.choice)

    def check_memory(self) -> None:
        """Raise ConfigurationError if the saved states do not fit in memory."""
        points_saved = times_of(self.t_span, self.step, self.save_every).points
        points = points_saved if self.t_eval is None else 2 * len(self.t_eval)
        start = start_of(self.system, effective_scheme(self.system, self.method), self.x0, self.attitude)
        first = self.system.of_member(0)
        numbers = first.dim + start.groups.shape[1] ** 2 + 1 + len(first.casimirs) + len(self.observe)
        needed = 8 * points * len(start.momenta) * numbers
        with section(self.path, "run.save_every"):
            check_available_memory(needed, "the array of saved states", "save fewer of the steps")

    def dataset(self, solution: Solution) -> xarray.Dataset:
        """Return a solution, or a partial one, as a dataset with the text of the file and the settings of a sweep."""
        dataset = solution.to_xarray().drop_encoding().assign_attrs({CONFIGURATION: self.text})
        dataset.attrs.pop(CHECKSUM, None)  # it does not cover the additions
        return dataset.assign_coords(self.swept_coordinates())

    def swept_coordinates(self) -> Variables:
        """Return the settings of a sweep as variables over the members."""
        return over_members(self.swept)


def check_archived(name: str, t_eval: Any, events: Any) -> None:
    """Reject settings that an archive does not support; ConfigurationError with the key."""
    for key, value in (("run.t_eval", t_eval), ("events", events or None)):
        if value is not None:
            raise ConfigurationError(
                f"{name}: {key}: an archive saves every save_every-th step and has no events; omit it, or the archive"
            )


__all__ = ["ConfigurationError", "load"]

Model = TypeVar("Model", bound=BaseModel)


def system_of_text(text: str) -> Any:
    """Return the system of a configuration from the text of its file, as stored with a result."""
    name = "the configuration of this run"
    errors = ErrorCollector(name)
    file, _, sweep = _parse_tables(name, parse_toml(name, text), errors)
    errors.raise_collected()
    assert file is not None
    return _system(name, file, sweep)


def outputs_of_text(text: str) -> dict[str, str | None]:
    """Return the declared paths of results of a configuration from the text of its file, as stored with a result."""
    name = "the configuration of this run"
    return _checked(name, OutputTable, parse_toml(name, text).get("output", {}), "output").model_dump()


def load(path: str | Path) -> Configuration:
    """Read and validate a configuration file, in TOML; ConfigurationError has file, key or line, and remedy."""
    require_packages("reading a configuration file", "pydantic")
    name, text = str(read_path(path, "path")), read_utf8(path)
    errors = ErrorCollector(name)
    return _configuration(name, text, *_parse_tables(name, parse_toml(name, text), errors), errors)


def _parse_tables(
    name: str, raw: Mapping[str, Any], errors: ErrorCollector
) -> tuple[File | None, set[str], SettingsSweep | None]:
    """Parse a file as far as it is valid (of a sweep, that of the first member); return also its invalid tables."""
    sweep: SettingsSweep | None = None
    if "sweep" in raw:
        raw_with_sweep, raw = raw, {key: table for key, table in raw.items() if key != "sweep"}
        with errors.collect():
            table = _checked(name, SweepTable, raw_with_sweep["sweep"], "sweep")
            parsed_sweep = read_sweep(name, raw_with_sweep, table)
            sweep, raw = parsed_sweep, parsed_sweep.member_tables(0)
    file, invalid = valid_tables(raw, errors.add)
    for message in _unknown_system(raw) if "system" in invalid else ():
        errors.add(message)
    return file, invalid, sweep


def _system(name: str, file: File, sweep: SettingsSweep | None) -> Any:
    return system_of_file(name, file) if sweep is None else swept_system(sweep, file, partial(_checked, name, File))


def _checked(name: str, model: type[Model], raw: Any, *table: str) -> Model:
    """Validate a file, or its `table`, against a model; ConfigurationError with the key."""
    try:
        return model.model_validate(raw)
    except ValidationError as error:
        raise ConfigurationError(f"{name}: {join_messages(all_errors(error, keys_by_table(), table))}") from None


def _unknown_system(raw: Mapping[str, Any]) -> list[str]:
    """Return the error for an unknown ready-made system, to be reported together with errors of keys."""
    system_name = named_in(raw, "system")
    if not system_name or system_name in systems.names():
        return []
    try:
        systems.get(system_name)
    except ValueError as error:
        return [f"system: {error}"]
    return []


def _check_times(name: str, file: File, system: Any, step: float) -> None:
    """Validate the times against the step and the forces."""
    with section(name, "run"):
        times = times_of(file.run.t_span, step, file.run.save_every)
        if file.run.t_eval is not None:
            output_times_of(file.run.t_eval, times, file.run.save_every)
        if system is not None:
            check_steps(system, times.t0, times.h)


def _check_workers(name: str, file: File, system: Any, x0: Any) -> None:
    """Reject `workers` for runs that they do not support."""
    with section(name, "run.workers"):
        require_packages("workers", "distributed")
        if momenta_of(system, x0)[1]:
            raise ValueError("workers are for the members of an ensemble, and the file has one state; omit workers")
        if file.run.t_eval is not None or file.events:
            raise ValueError("workers save every save_every-th step and have no events; give neither t_eval nor events")


def _configuration(
    name: str, text: str, file: File | None, invalid: set[str], sweep: SettingsSweep | None, errors: ErrorCollector
) -> Configuration:
    if file is None:
        errors.raise_collected()
    assert file is not None
    system: Any = None
    method: Any = None
    x0: Any = None
    step, choice, check_tables = file.run.step, None, partial(_checked, name, File)
    if not invalid & SYSTEM_TABLES:
        with errors.collect():
            if "initial" not in invalid:
                check_named(name, file)
            system = _system(name, file, sweep)
    if file.output.archive is not None:
        with errors.collect():
            check_archived(name, file.run.t_eval, file.events)
    # Checks that need a system are skipped without one; scheme and times are independent.
    with errors.collect():
        if file.method is not None:
            method = method_of_file(name, file.method)
        elif system is not None:
            method = default_scheme(system)
        if system is not None:
            with section(name, "method"):
                check_supports(system.of_member(0), method)
    if step is not None and "run" not in invalid:
        with errors.collect():
            _check_times(name, file, system, step)
    if system is not None and "initial" not in invalid:
        with errors.collect():
            x0 = (
                state_by_name(name, file.initial, system)
                if sweep is None
                else swept_states(sweep, file, system, check_tables)
            )
            with section(name, "initial.x"):
                x0 = initial_state(system, file.initial.x, Path(name).parent) if x0 is None else x0
                momenta_of(system, x0)
    observe, events = {}, []
    for key, polynomial in file.observe.items() if system is not None else ():
        with errors.collect(), section(name, f"observe.{key}"):
            coordinates = coordinates_of(system)
            if not coordinates:
                raise ValueError(f"a polynomial needs coordinates; the states of {system.name} are matrices")
            observe[key] = parse_polynomial(polynomial, system.dim, coordinates)
    for key, table in file.events.items() if system is not None else ():
        with errors.collect(), section(name, f"events.{key}"):
            events.append(event_of_file(key, table.model_dump(), system))
    errors.raise_collected()
    with section(name, "initial.x"):
        start_of(system, effective_scheme(system, method), x0, False)
    with section(name, "initial.attitude"):
        start_of(system, effective_scheme(system, method), x0, file.initial.attitude)
    if file.run.accuracy is not None:
        with section(name, "run.accuracy"):
            fixed_method = None if file.method is None else method
            choice = chosen_for(file.run.accuracy, system, x0, file.run.t_span, file.initial.attitude, fixed_method)
        method, step = choice.method, choice.step
        _check_times(name, file, system, step)
    assert step is not None
    if file.run.workers is not None:
        _check_workers(name, file, system, x0)
    return Configuration(
        path=name,
        system=system,
        x0=x0,
        t_span=(float(file.run.t_span[0]), float(file.run.t_span[1])),
        step=step,
        method=method,
        save_every=file.run.save_every,
        t_eval=file.run.t_eval,
        attitude=file.initial.attitude,
        watch=file.run.watch,
        observe=observe,
        events=tuple(events),
        threads=file.run.threads,
        workers=file.run.workers,
        outputs=file.output.model_dump(),
        choice=choice,
        swept={} if sweep is None else sweep.values,
        text=text,
    )
