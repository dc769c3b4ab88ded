"""Commands that run, check, resume and certify a configuration file or an archive; failed and interrupted runs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from coadjoint import interruption
from coadjoint.errors import IntegrationError, in_one_line

if TYPE_CHECKING:
    import xarray

    from coadjoint.runs.results.solution import Solution


@click.command("run")
@click.argument("file", type=click.Path())
@click.option("--out", metavar="PATH", help="Path of the solution: .nc or .zarr; by default that in FILE.")
@click.option("--archive", metavar="PATH", help="New folder to which the run is written, so that it can be resumed.")
@click.option("--figure", metavar="PATH", help="Path of a figure: .png, .pdf or .svg; by default that in FILE.")
@click.option("--movie", metavar="PATH", help="Path of a movie: .mp4 or .gif; by default that in FILE.")
@click.option("--progress", is_flag=True, help="Show a progress bar.")
@click.option("--quiet", is_flag=True, help="Print nothing.")
def run_file(
    file: str,
    out: str | None,
    archive: str | None,
    figure: str | None,
    movie: str | None,
    progress: bool,
    quiet: bool,
) -> None:
    """Run the configuration FILE (TOML).

    A run that fails writes the solution so far, marked as failed, and ends with exit status 1. One that is interrupted
    writes the solution so far, marked as incomplete; `coadjoint resume` continues an archive.
    """
    from coadjoint.files.configuration.loading import load

    configuration = load(file)
    options = {"archive": archive, "file": out, "figure": figure, "movie": movie}
    paths = _output_paths(configuration.path, configuration.outputs, options)
    with saving_partial_run(configuration.path, paths.get("archive"), paths.get("file"), configuration.dataset):
        solution = configuration.integrate(progress=progress, archive=paths.get("archive"))
    _write_results(configuration.path, solution, configuration.dataset, paths)
    if not quiet:
        _summarize(solution, list(paths.values()))


def _write_results(
    name: str, solution: Solution, dataset: Callable[[Solution], xarray.Dataset], paths: Mapping[str, Path]
) -> None:
    """Write dataset, figure and movie of a run, as far as they have paths."""
    from coadjoint.files.output.output_files import write_dataset, write_figure

    writers: dict[str, Callable[[Path], object]] = {
        "file": lambda path: write_dataset(dataset(solution), path),
        "figure": lambda path: write_figure(solution.plot(), path),
        "movie": solution.movie,
    }
    for key, write in writers.items():
        if key in paths:
            with reporting_write_errors(name, paths[key]):
                write(paths[key])


def _output_paths(name: str, declared: Mapping[str, str | None], options: Mapping[str, str | None]) -> dict[str, Path]:
    """Validate the paths of archive, dataset, figure and movie, from the options or else those declared in a file."""
    from coadjoint.files.archives.new_archive import check_new
    from coadjoint.files.configuration.construction import section
    from coadjoint.files.output.output_files import DATASETS, FIGURES, check_movie, check_target

    def new_archive(path: str) -> Path:
        check_new(path)
        return Path(path)  # as it was given, for messages

    checks: dict[str, Callable[[str], Path]] = {
        "archive": new_archive,
        "file": lambda path: check_target(path, DATASETS),
        "figure": lambda path: check_target(path, FIGURES),
        "movie": check_movie,
    }
    paths = {}
    for key, check in checks.items():
        option, configured = options.get(key), declared.get(key)
        if option is not None:
            paths[key] = check(option)
        elif configured is not None:
            with section(name, f"output.{key}"):
                paths[key] = check(configured)
    return paths


def _check_inside(name: str, declared: Mapping[str, str | None]) -> None:
    """Raise OutputError if a result that an archive declares, which may come from others, is outside of this folder."""
    from coadjoint.files.output.output_files import OutputError

    for key, path in declared.items():
        if path is not None and not Path(path).resolve().is_relative_to(Path.cwd().resolve()):
            option = "out" if key == "file" else key
            raise OutputError(f"{name}: output.{key}: {path} is outside of the current folder; give --{option}")


def _summarize(solution: Solution, written: Sequence[Path]) -> None:
    stats, context = solution.stats, click.get_current_context(silent=True)
    seconds = stats.elapsed if context is None else time.monotonic() - context.find_root().obj
    click.echo(
        in_one_line(f"{solution.system.name}, {solution.method}")
        + f": {stats.steps} steps of {solution.step:g}; {seconds:.3g} s, {stats.seconds:.3g} s in the "
        + "loop"
    )
    extent = "every step" if solution.watched else "the saved points"
    columns: dict[str, Mapping[str, float]] = {"largest deviation from the start": solution.change()}
    if solution.work:
        columns = {"change, and change minus the work of the forces (balance)": solution.change()}
        balance = solution.balance()
        columns["balance"] = {name: balance[name] if name in balance else math.nan for name in solution.change()}
    click.echo(f"{next(iter(columns))}, over {extent}:")
    names = {name: in_one_line(name, 60) for name in solution.change()}
    from coadjoint.runs.results.solution_output import is_driven

    if is_driven(solution.system):
        names["energy"] = "energy (driven, so that it changes)"
    width = max(map(len, names.values()))
    for name, label in names.items():
        click.echo(f"  {label:{width}}  " + "  ".join(f"{column[name]:.3g}" for column in columns.values()))
    for path in written:
        click.echo(f"written: {path}")


@click.command("check")
@click.argument("file", type=click.Path())
def check_file(file: str) -> None:
    """Describe what the configuration FILE (TOML) would run and its cost; nothing is written.

    The time is estimated from a trial run of the first steps. Exit status 2, with one line, if the file is invalid; 1
    if the trial run fails, as the run would.
    """
    from coadjoint.files.configuration.dry_run import describe_run
    from coadjoint.files.configuration.loading import load

    configuration = load(file)
    _output_paths(configuration.path, configuration.outputs, {})
    text, failed = describe_run(configuration)
    click.echo(text)
    if failed:
        raise click.exceptions.Exit(1)


@click.command("resume")
@click.argument("path", type=click.Path())
@click.option("--t-end", type=float, metavar="T", help="A later end of the run (time).")
@click.option("--out", metavar="PATH", help="Path of the solution: .nc or .zarr; by default that in the run's file.")
@click.option("--figure", metavar="PATH", help="Path of a figure: .png, .pdf or .svg; by default that in the file.")
@click.option("--movie", metavar="PATH", help="Path of a movie: .mp4 or .gif; by default that in the run's file.")
@click.option(
    "--threads", type=int, metavar="N", help="Number of threads for the members of an ensemble; by default all cores."
)
@click.option("--workers", type=int, metavar="N", help="Number of processes that continue an ensemble in blocks.")
@click.option("--progress", is_flag=True, help="Show a progress bar.")
@click.option("--quiet", is_flag=True, help="Print nothing.")
def resume_archive(
    path: str,
    t_end: float | None,
    out: str | None,
    figure: str | None,
    movie: str | None,
    threads: int | None,
    workers: int | None,
    progress: bool,
    quiet: bool,
) -> None:
    """Continue the run of the archive PATH, with the same bits as an uninterrupted run.

    A finished run is left unchanged, unless a later end is given. At the end the results are written that the
    configuration file of the run declares: file, figure and movie, relative to the current directory.
    """
    from coadjoint.files.archives.archived_solution import open_archive
    from coadjoint.files.archives.folder import read_archive_path
    from coadjoint.files.archives.resume import resume
    from coadjoint.files.archives.run_checks import requires_argument
    from coadjoint.files.configuration.loading import CONFIGURATION, outputs_of_text, system_of_text

    archive, system = Path(path), None
    attributes = open_archive(read_archive_path(path)).attributes
    if CONFIGURATION in attributes and requires_argument(attributes, "system"):
        # Catalogue algebras may have Casimirs that are functions, which only the configuration file can restore.
        system = system_of_text(attributes[CONFIGURATION])
    declared = outputs_of_text(attributes[CONFIGURATION]) if CONFIGURATION in attributes else {}
    options = {"file": out, "figure": figure, "movie": movie}
    declared = {key: value for key, value in declared.items() if key in options and options[key] is None}
    _check_inside(path, declared)
    results = _output_paths(path, declared, options)
    with saving_partial_run(path, archive, None, None):
        solution = resume(archive, t_end, system=system, threads=threads, workers=workers, progress=progress)
    _write_results(path, solution, lambda resumed: resumed.to_xarray().drop_encoding(), results)
    if not quiet:
        _summarize(solution, [archive, *results.values()])


@click.command("certify")
@click.argument("file", type=click.Path())
@click.option("--json", "json_path", metavar="PATH", help="Path of a file of all measurements: .json.")
@click.option("--plot", "figure_path", metavar="PATH", help="Path of a figure of the measurements: .png, .pdf or .svg.")
@click.option(
    "--steps", type=int, metavar="N", help="Steps of the long run; by default 2000, or as many as take a few seconds."
)
def certify_file(file: str, json_path: str | None, figure_path: str | None, steps: int | None) -> None:
    """Measure the properties that the scheme of the configuration FILE (TOML) preserves or declares.

    The exit status is 0 if every declared property holds, and 1 if one fails or cannot be decided.
    """
    from coadjoint.analysis.certificates.certify import certify
    from coadjoint.errors import ConfigurationError
    from coadjoint.files.configuration.loading import load
    from coadjoint.files.output.output_files import FIGURES, TEXTS, check_target, write_figure, write_text

    configuration = load(file)
    if configuration.system.is_batch:
        problem = "sweep.over: a certificate is of one system; sweep over the initial state alone"
        raise ConfigurationError(f"{configuration.path}: {problem}")
    json_target = None if json_path is None else check_target(json_path, TEXTS)
    figure_target = None if figure_path is None else check_target(figure_path, FIGURES)
    certificate = certify(
        configuration.system,
        configuration.method,
        configuration.x0,
        math.copysign(configuration.step, configuration.t_span[1] - configuration.t_span[0]),
        steps=steps,
    )
    click.echo(str(certificate))
    if json_target is not None:
        with reporting_write_errors(configuration.path, json_target):
            write_text(certificate.to_json(), json_target)
    if figure_target is not None:
        with reporting_write_errors(configuration.path, figure_target):
            write_figure(certificate.plot(), figure_target)
    for written in (json_target, figure_target):
        if written is not None:
            click.echo(f"written: {written}")
    if not certificate.passed:
        raise click.exceptions.Exit(1)


COMMANDS = (run_file, check_file, resume_archive, certify_file)


def _run_ended(message: str, status: int = 1) -> click.ClickException:
    """Return the error for a run that failed or was not written (exit status 1), or was interrupted (128 + signal)."""
    error = click.ClickException(message)
    error.__dict__["exit_code"] = status
    return error


@contextmanager
def saving_partial_run(
    name: str, archive: Path | None, target: Path | None, dataset: Callable[[Any], xarray.Dataset] | None
) -> Iterator[None]:
    """Context that saves the solution so far of a run that fails or is interrupted, and reports it in one line."""
    try:
        with interruption.raise_on_interrupt():
            yield
    except IntegrationError as error:
        raise _failure_error(name, error, archive, target, dataset) from error
    except interruption.Interrupted as interrupt:
        raise _interruption_error(name, interrupt, archive, target, dataset) from interrupt


@contextmanager
def reporting_write_errors(name: str, target: Path) -> Iterator[None]:
    """Context that reports in one line if the result of a run cannot be written."""
    from coadjoint.files.output.output_files import OutputError

    try:
        yield
    except (OSError, OutputError, MemoryError) as reason:
        raise _run_ended(f"{name}: {_write_error(target, reason)}") from reason


def _write_error(target: Path, reason: BaseException) -> str:
    detail = getattr(reason, "strerror", None) or str(reason) or "it does not fit into memory"
    return f"{target} could not be written ({detail}); nothing was replaced"


def _failure_error(
    name: str, error: IntegrationError, archive: Path | None, target: Path | None, dataset: Any
) -> click.ClickException:
    """Write the solution so far and return the error to raise."""
    from coadjoint.files.datasets.export import failure_attributes

    written = "" if archive is None else f"; the archive {archive} holds the solution so far"
    if target is not None and error.partial is not None:
        written = _write(dataset(error.partial).assign_attrs(failure_attributes(error)), target)
    return _run_ended(f"{name}: the run failed: {error}{written}")


def _interruption_error(
    name: str, interrupt: interruption.Interrupted, archive: Path | None, target: Path | None, dataset: Any
) -> click.ClickException:
    from coadjoint.files.datasets.export import incomplete_attributes

    partial: Any = interrupt.partial if archive is None else _open_partial_run(archive)
    written = ""
    if archive is not None and partial is not None:
        written = f"; {archive} holds {partial.progress_text}: coadjoint resume {archive} continues it"
    elif target is not None and partial is not None and len(partial.t):
        time = float(partial.t[-1])
        reason = incomplete_attributes(interrupt.description, time)
        written = _write(dataset(partial).assign_attrs(reason), target, ", marked as incomplete")
    message = f"{name}: {interrupt.description}{written}" if written else f"coadjoint: {interrupt.description}"
    return _run_ended(message, 128 + interrupt.number)


def _open_partial_run(archive: Path) -> Any:
    """Open the partial run in an archive; None if the archive was not created yet."""
    from coadjoint.files.archives.archived_solution import open_archive

    try:
        return open_archive(archive)
    except ValueError:
        return None


def _write(dataset: xarray.Dataset, target: Path, marked: str = "") -> str:
    from coadjoint.files.output.output_files import OutputError, write_dataset

    try:
        write_dataset(dataset, target)
    except (OSError, OutputError, MemoryError) as reason:
        return f"; the solution so far is lost: {_write_error(target, reason)}"
    return f"; the solution so far is in {target}{marked}"
