"""Dry runs of configuration files: description and cost estimate, from a trial of the first steps."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from coadjoint.errors import IntegrationError, in_one_line
from coadjoint.files.configuration.loading import Configuration
from coadjoint.kernels.loop import Layout
from coadjoint.memory import available, format_bytes
from coadjoint.methods.forced import effective_scheme
from coadjoint.methods.protocol.method import declared_properties
from coadjoint.methods.protocol.properties import Properties
from coadjoint.optional_packages import installed
from coadjoint.runs.events import read_events
from coadjoint.runs.plan import bytes_of_run
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.times import Times
from coadjoint.short_repr import distinct

TRIAL_SECONDS = 0.2
"""Approximate duration of the last trial run, in seconds."""
TRIAL_POINTS = 2, 12
"""Saved points of two short runs, from which the size of the whole dataset is extrapolated."""
LABEL_WIDTH = 14  # characters of the first column


@dataclass(frozen=True)
class DryRun:
    """Description and cost of the run of a configuration file: sizes in bytes; seconds from `tried` steps."""

    configuration: Configuration
    dim: int
    members: int
    properties: Properties
    steps: int
    points: int
    memory: int
    written: int | None
    preparation_seconds: float
    seconds: float | None
    tried: int
    failed: str = ""

    def __str__(self) -> str:
        return "\n".join(f"{name:{LABEL_WIDTH}}{text}" for name, text in self._lines())

    def _lines(self) -> Iterator[tuple[str, str]]:
        run = self.configuration
        system = run.system.of_member(0)
        batch_text = f"; {len(run.system)} systems, one for each member" if run.system.is_batch else ""
        yield "system", f"{system.name}, dimension {self.dim}{batch_text}"
        yield "members", f"{self.members}"
        if run.swept:
            yield "swept", in_one_line(", ".join(run.swept), 200)
        choice_text = "" if run.choice is None else f"; chosen, expected error {run.choice.error:.1e}"
        order = effective_scheme(run.system, run.method).order
        yield "scheme", f"{in_one_line(str(run.method), 100)}, of order {order}{choice_text}"
        yield "keeps", conserved_quantities(self.properties)
        start, end = run.t_span
        size = abs(end - start) / self.steps if self.steps else run.step
        first, last = distinct(start, end)
        yield "steps", f"{self.steps} of {size:g}, from t = {first} to {last}"
        yield "saved", f"{self.points} points" + ("" if self.members == 1 else f" of {self.members} members")
        yield "memory", f"{format_size(self.memory)}, {format_bytes(available())} are free"
        if self.written is None:
            no_package = "xarray is not installed, so that nothing can be written"
            yield "output", "not known: the trial failed" if self.failed else no_package
        else:
            yield "output", f"{format_size(self.written)} before compression{self._output_lines()}"
        if self.seconds is None:
            yield "time", f"not known: the trial failed ({in_one_line(self.failed, 200)})"
        else:
            trial_text = "all its" if self.tried == self.steps else f"{self.tried} of its"
            workers_text = "" if run.workers is None else f", in one process; {run.workers} workers share it"
            total, preparation = self.preparation_seconds + self.seconds, format_duration(self.preparation_seconds)
            yield (
                "time",
                f"about {format_duration(total)}{workers_text}; estimated from a trial of {trial_text} steps, "
                f"{preparation} of it for preparation",
            )

    def _output_lines(self) -> str:
        run = self.configuration
        keys = ("archive", "file", "figure", "movie")
        paths = [path for path in map(run.outputs.get, keys) if path is not None]
        return f"; to {', '.join(paths)}" if paths else "; the file names no output"


def conserved_quantities(properties: Properties) -> str:
    """Describe the conservation properties of a scheme, to round-off."""
    conserved = ["Poisson bracket"] if properties.poisson else []
    conserved += ["energy"] if properties.energy else []
    if properties.casimirs != "none":
        conserved.append("all Casimirs" if properties.casimirs == "all" else f"{properties.casimirs} Casimirs")
    not_conserved = [
        what
        for what, is_conserved in (("Poisson bracket", properties.poisson), ("energy", properties.energy))
        if not is_conserved
    ]
    not_conserved += [] if properties.casimirs != "none" else ["Casimirs"]
    not_conserved_text = f"not the {' and the '.join(not_conserved)}" if not_conserved else ""
    broken_text = f"broken by forces ({', '.join(properties.broken_by)})" if properties.broken_by else ""
    return "; ".join(part for part in (", ".join(conserved), not_conserved_text, broken_text) if part)


def format_size(count: int) -> str:
    """Format a number of bytes."""
    if count < 1000:
        return f"{count} bytes"
    return f"{count / 1000:.0f} kB" if count < 1e6 else format_bytes(count)


def format_duration(seconds: float) -> str:
    """Format a duration.

    Examples
    --------
    >>> format_duration(0.0123), format_duration(90.0), format_duration(7200.0), format_duration(1e6)
    ('0.012 s', '1.5 minutes', '2 hours', '12 days')
    """
    for unit, size in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 1.5 * size or (unit == "minutes" and seconds >= size):
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds:.2g} s"


def plan(configuration: Configuration) -> DryRun:
    """Describe the run of a configuration, and estimate its cost from a trial of the first steps."""
    if configuration.outputs.get("archive") is None and configuration.workers is None:
        configuration.check_memory()
    began = time.perf_counter()
    prepared = configuration.ready()
    times, output_times = prepared.times_of(configuration.t_span, configuration.save_every, configuration.t_eval)
    start = prepared.start(configuration.x0)
    loops: Any = prepared.loops(times.h)
    preparation_seconds = time.perf_counter() - began
    saved_times = times if output_times is None else times.with_saved_steps(output_times.marks)
    layout = loops.layout(len(start.momenta), saved_times.points, start.groups.shape[1] ** 2)
    memory, points = bytes_of_run(layout, saved_times), saved_times.points
    if output_times is not None:
        # Output times are filled in while the steps from which they are reached are still in memory.
        points = len(output_times.t)
        memory += bytes_of_run(Layout(layout.extent._replace(points=points)), times._replace(marks=output_times.ends))
    system = configuration.system.of_member(0)
    seconds, tried, failed, written = None, 0, "", None
    try:
        seconds, tried = _seconds(configuration, prepared, times)
        written = _written(configuration, prepared, times)
    except IntegrationError as error:
        failed = str(error)
    return DryRun(
        configuration,
        start.momenta.shape[1],
        len(start.momenta),
        declared_properties(effective_scheme(system, configuration.method), system),
        times.steps,
        points,
        memory,
        written,
        preparation_seconds,
        seconds,
        tried,
        failed,
    )


def _trial_run(configuration: Configuration, prepared: PreparedRun, times: Times, steps: int, every: int) -> Solution:
    """Run the first steps."""
    # Not `run`, whose step is the prepared one: output times may shorten that of a scheme with its own steps.
    first = times._replace(steps=steps, save_every=min(every, max(1, steps)))
    return prepared.follow(first, prepared.start(configuration.x0), events=read_events(configuration.events))


def _seconds(configuration: Configuration, prepared: PreparedRun, times: Times) -> tuple[float, int]:
    """Return the estimated seconds of all steps, and the number of steps of the trial."""
    count = 1
    while True:
        count = min(count, times.steps)
        began = time.perf_counter()
        if count:
            _trial_run(configuration, prepared, times, count, configuration.save_every)
        seconds = time.perf_counter() - began
        if count == times.steps or seconds >= TRIAL_SECONDS:
            return seconds * times.steps / max(count, 1), count
        # Overhead per call dominates the first trials.
        count *= 2 if seconds < TRIAL_SECONDS / 64 else max(2, min(64, int(TRIAL_SECONDS / seconds)))


def _written(configuration: Configuration, prepared: PreparedRun, times: Times) -> int | None:
    """Estimate the size of the dataset in bytes by linear extrapolation from two short runs."""
    if not installed("xarray"):
        return None
    points = times.total_points if configuration.t_eval is None else len(configuration.t_eval)
    counts = [min(count, times.steps + 1) for count in TRIAL_POINTS]
    sizes = [configuration.dataset(_trial_run(configuration, prepared, times, n - 1, 1)).nbytes for n in counts]
    bytes_per_point = (sizes[1] - sizes[0]) / max(1, counts[1] - counts[0])
    return round(sizes[0] + bytes_per_point * (points - counts[0]))
