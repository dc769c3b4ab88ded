"""Dry runs of configuration files: description and cost estimate, from a trial of the first steps."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import timedelta
from typing import Any

from coadjoint.errors import IntegrationError, in_one_line
from coadjoint.files.configuration.loading import Configuration
from coadjoint.files.configuration.models import section
from coadjoint.kernels.loop import Layout
from coadjoint.memory import available, format_bytes
from coadjoint.methods.forced import effective_scheme
from coadjoint.methods.protocol.method import declared_properties
from coadjoint.methods.protocol.properties import Properties
from coadjoint.optional_packages import installed
from coadjoint.runs.events import read_events
from coadjoint.runs.plan_and_state import bytes_of_run, check_run_memory
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.times import Times
from coadjoint.short_repr import distinct

TRIAL_SECONDS = 0.2
"""Approximate duration of the last trial run, in seconds."""
TRIAL_POINTS = 2, 12
"""Saved points of two short runs, from which the size of the whole dataset is extrapolated."""
LABEL_WIDTH = 14  # characters of the first column
Trial = Callable[[int, int], Solution]


def conserved_quantities(properties: Properties) -> str:
    """Describe the conservation properties of a scheme, to round-off."""
    casimirs = "" if properties.casimirs == "none" else f"{properties.casimirs} "
    kept = {"Poisson bracket": properties.poisson, "energy": properties.energy, f"{casimirs}Casimirs": bool(casimirs)}
    lost = " and the ".join(name for name in kept if not kept[name])
    broken = ", ".join(properties.broken_by)
    parts = [", ".join(name for name in kept if kept[name]), f"not the {lost}" if lost else ""]
    return "; ".join(filter(None, [*parts, f"broken by forces ({broken})" if broken else ""]))


def format_size(count: int) -> str:
    """Format a number of bytes."""
    if count < 1e6:
        return f"{count} bytes" if count < 1000 else f"{count / 1000:.0f} kB"
    return format_bytes(count)


def format_duration(seconds: float) -> str:
    """Format a duration, such as '0.012 s' or '2 days, 3:00:00'."""
    return f"{seconds:.2g} s" if seconds < 100.0 else str(timedelta(seconds=round(seconds)))


def describe_run(run: Configuration) -> tuple[str, bool]:
    """Describe the run of a configuration and its cost by a trial of the first steps; also whether the trial failed."""
    began, table, prepared = time.perf_counter(), run.file.run, run.prepared
    system, method = prepared.system.of_member(0), prepared.method
    times, output_times = prepared.times_of(table.span, table.save_every, table.t_eval)
    start = prepared.start(run.x0)
    loops: Any = prepared.loops(times.h)
    preparation_seconds = time.perf_counter() - began
    members, dim = start.momenta.shape[:2]
    saved_times = times if output_times is None else times.with_saved_steps(output_times.marks)
    layout = loops.layout(members, saved_times.points, start.groups.shape[1] ** 2)
    if run.outputs["archive"] is None and table.workers is None:
        with section(run.path, "run"):
            check_run_memory(layout, saved_times, members)
    memory, points = bytes_of_run(layout, saved_times), saved_times.points
    if output_times is not None:
        # Output times are filled in while the steps from which they are reached are still in memory.
        points = len(output_times.t)
        memory += bytes_of_run(Layout(layout.extent._replace(points=points)), times._replace(marks=output_times.ends))
    batch = f"; {len(prepared.system)} systems, one for each member" if prepared.system.is_batch else ""
    lines = {"system": f"{system.name}, dimension {dim}{batch}", "members": f"{members}"}
    if run.swept:
        lines["swept"] = in_one_line(", ".join(run.swept), 200)
    chosen = "" if run.choice is None else f"; chosen, expected error {run.choice.error:.1e}"
    lines["scheme"] = f"{in_one_line(str(method), 100)}, of order {prepared.scheme.order}{chosen}"
    lines["keeps"] = conserved_quantities(declared_properties(effective_scheme(system, method), system))
    first, last = distinct(*table.span)
    size = abs(table.span[1] - table.span[0]) / times.steps if times.steps else prepared.step
    lines["steps"] = f"{times.steps} of {size:g}, from t = {first} to {last}"
    lines["saved"] = f"{points} points" + ("" if members == 1 else f" of {members} members")
    lines["memory"] = f"{format_size(memory)}, {format_bytes(available())} are free"
    lines["output"], lines["time"], failed = "not known: the trial failed", "", False

    def trial(steps: int, every: int) -> Solution:
        # Not `run`, whose step is the prepared one: output times may shorten that of a scheme with its own steps.
        part = times._replace(steps=steps, save_every=min(every, max(1, steps)))
        return prepared.follow(part, prepared.start(run.x0), events=read_events(run.events))

    try:
        seconds, tried = _seconds(times, lambda steps: trial(steps, table.save_every))
        shared = "" if table.workers is None else f", in one process; {table.workers} workers share it"
        lines["time"] = (
            f"about {format_duration(preparation_seconds + seconds)}{shared}; estimated from a trial of "
            f"{'all' if tried == times.steps else f'{tried} of'} its steps, {format_duration(preparation_seconds)} of "
            "it for preparation"
        )
        lines["output"] = _output_text(run, times, trial)
    except IntegrationError as error:
        failed = True
        lines["time"] = lines["time"] or f"not known: the trial failed ({in_one_line(str(error), 200)})"
    return "\n".join(f"{name:{LABEL_WIDTH}}{text}" for name, text in lines.items()), failed


def _seconds(times: Times, trial: Callable[[int], object]) -> tuple[float, int]:
    """Return the estimated seconds of all steps, and the number of steps of the trial."""
    count = 1
    while True:
        count = min(count, times.steps)
        began = time.perf_counter()
        if count:
            trial(count)
        seconds = time.perf_counter() - began
        if count == times.steps or seconds >= TRIAL_SECONDS:
            return seconds * times.steps / max(count, 1), count
        # Overhead per call dominates the first trials.
        count *= 2 if seconds < TRIAL_SECONDS / 64 else max(2, min(64, int(TRIAL_SECONDS / seconds)))


def _output_text(run: Configuration, times: Times, trial: Trial) -> str:
    """Estimate the size of the dataset by linear extrapolation from two short runs, and name the outputs."""
    if not installed("xarray"):
        return "xarray is not installed, so that nothing can be written"
    t_eval = run.file.run.t_eval
    points = times.total_points if t_eval is None else len(t_eval)
    counts = [min(count, times.steps + 1) for count in TRIAL_POINTS]
    sizes = [run.dataset(trial(count - 1, 1)).nbytes for count in counts]
    size = round(sizes[0] + (sizes[1] - sizes[0]) / max(1, counts[1] - counts[0]) * (points - counts[0]))
    paths = [path for key in ("archive", "file", "figure", "movie") if (path := run.outputs[key])]
    ending = f"to {', '.join(paths)}" if paths else "the file names no output"
    return f"{format_size(size)} before compression; {ending}"
