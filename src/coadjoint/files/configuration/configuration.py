"""Configurations: runs as described by configuration files, and their results as datasets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.files.configuration.construction import ConfigurationError, section
from coadjoint.files.datasets.content_checksum import CHECKSUM
from coadjoint.files.datasets.variables import ExtraMetadata, Variables, over_members
from coadjoint.memory import available, format_bytes
from coadjoint.methods.forced import effective_scheme
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.events import Event
from coadjoint.runs.integrate import integrate
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution, with_choice
from coadjoint.runs.start import start_of
from coadjoint.runs.times import times_of

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
        metadata = ExtraMetadata(self.swept_coordinates(), {CONFIGURATION: self.text})
        if self.workers is not None:
            from coadjoint.files.archives.ensemble import read_worker_pool, run_in_blocks

            pool = read_worker_pool(None, self.workers, self.threads)
            arguments = prepared, self.x0, self.t_span, self.save_every, archive, pool
            return with_choice(run_in_blocks(*arguments, progress=progress, about=metadata), self.choice)
        assert archive is not None
        arguments_of_run = prepared, self.x0, self.t_span, self.save_every, archive
        return with_choice(archive_run(*arguments_of_run, progress=progress, about=metadata), self.choice)

    def check_memory(self) -> None:
        """Raise ConfigurationError if the saved states do not fit in memory."""
        points_saved = times_of(self.t_span, self.step, self.save_every).points
        points = points_saved if self.t_eval is None else 2 * len(self.t_eval)
        start = start_of(self.system, effective_scheme(self.system, self.method), self.x0, self.attitude)
        first = self.system.of_member(0)
        numbers = first.dim + start.groups.shape[1] ** 2 + 1 + len(first.casimirs) + len(self.observe)
        needed, free = 8 * points * len(start.momenta) * numbers, available()
        if needed > free:
            raise ConfigurationError(
                f"{self.path}: run.save_every: the saved states do not fit into memory: they need "
                f"{format_bytes(needed)}, and this machine has {format_bytes(free)} free; save fewer of the steps"
            )

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
