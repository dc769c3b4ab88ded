"""Dry runs of configuration files: description and cost estimate, from a trial of the first steps."""

from __future__ import annotations

import time
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
from coadjoint.runs.plan_and_state import bytes_of_run
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.start import Start
from coadjoint.runs.times import Times
from coadjoint.short_repr import distinct

TRIAL_SECONDS = 0.2
"""Approximate duration of the last trial run, in seconds."""
TRIAL_POINTS = 2, 12
"""Saved points of two short runs, from which the size of the whole dataset is extrapolated."""
LABEL_WIDTH = 14  # characters of the first column


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


def describe_run(configuration: Configuration) -> tuple[str, bool]:
    """Describe the run of a configuration and its cost by a trial of the first steps; also whether the trial failed."""
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
    lines = _run_lines(configuration, start, times)
    lines["saved"] = f"{points} points" + ("" if len(start.momenta) == 1 else f" of {len(start.momenta)} members")
    lines["memory"] = f"{format_size(memory)}, {format_bytes(available())} are free"
    lines["output"], lines["time"], failed = "not known: the trial failed", "", False
    try:
        lines["time"] = _time_text(configuration, prepared, times, preparation_seconds)
        lines["output"] = _output_text(configuration, prepared, times)
    except IntegrationError as error:
        failed = True
        lines["time"] = lines["time"] or f"not known: the trial failed ({in_one_line(str(error), 200)})"
    return "\n".join(f"{name:{LABEL_WIDTH}}{text}" for name, text in lines.items()), failed


def _run_lines(run: Configuration, start: Start, times: Times) -> dict[str, str]:
    """Return the lines about system, scheme and steps, by their labels."""
    system = run.system.of_member(0)
    members, dim = start.momenta.shape[:2]
    batch_text = f"; {len(run.system)} systems, one for each member" if run.system.is_batch else ""
    lines = {"system": f"{system.name}, dimension {dim}{batch_text}", "members": f"{members}"}
    if run.swept:
        lines["swept"] = in_one_line(", ".join(run.swept), 200)
    choice_text = "" if run.choice is None else f"; chosen, expected error {run.choice.error:.1e}"
    scheme = effective_scheme(run.system, run.method)
    lines["scheme"] = f"{in_one_line(str(run.method), 100)}, of order {scheme.order}{choice_text}"
    lines["keeps"] = conserved_quantities(declared_properties(effective_scheme(system, run.method), system))
    first, last = distinct(*run.t_span)
    size = abs(run.t_span[1] - run.t_span[0]) / times.steps if times.steps else run.step
    return {**lines, "steps": f"{times.steps} of {size:g}, from t = {first} to {last}"}


def _trial_run(configuration: Configuration, prepared: PreparedRun, times: Times, steps: int, every: int) -> Solution:
    """Run the first steps."""
    # Not `run`, whose step is the prepared one: output times may shorten that of a scheme with its own steps.
    first = times._replace(steps=steps, save_every=min(every, max(1, steps)))
    return prepared.follow(first, prepared.start(configuration.x0), events=read_events(configuration.events))


def _time_text(configuration: Configuration, prepared: PreparedRun, times: Times, preparation_seconds: float) -> str:
    """Estimate the time of all steps from a trial of the first ones."""
    seconds, tried = _seconds(configuration, prepared, times)
    trial_text = "all its" if tried == times.steps else f"{tried} of its"
    workers_text = (
        "" if configuration.workers is None else f", in one process; {configuration.workers} workers share it"
    )
    return (
        f"about {format_duration(preparation_seconds + seconds)}{workers_text}; estimated from a trial of {trial_text} "
        f"steps, {format_duration(preparation_seconds)} of it for preparation"
    )


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


def _output_text(configuration: Configuration, prepared: PreparedRun, times: Times) -> str:
    """Estimate the size of the dataset by linear extrapolation from two short runs, and name the outputs."""
    if not installed("xarray"):
        return "xarray is not installed, so that nothing can be written"
    points = times.total_points if configuration.t_eval is None else len(configuration.t_eval)
    counts = [min(count, times.steps + 1) for count in TRIAL_POINTS]
    sizes = [configuration.dataset(_trial_run(configuration, prepared, times, n - 1, 1)).nbytes for n in counts]
    bytes_per_point = (sizes[1] - sizes[0]) / max(1, counts[1] - counts[0])
    size = round(sizes[0] + bytes_per_point * (points - counts[0]))
    paths = [path for key in ("archive", "file", "figure", "movie") if (path := configuration.outputs.get(key))]
    ending = f"to {', '.join(paths)}" if paths else "the file names no output"
    return f"{format_size(size)} before compression; {ending}"
