"""Commands that run, check, resume and certify a configuration file or an archive; failed and interrupted runs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from coadjoint import interruption
from coadjoint.errors import ConfigurationError, IntegrationError, in_one_line

if TYPE_CHECKING:
    import xarray

    from coadjoint.runs.results.solution import Solution


class KeyOption(click.Option):
    """Option in place of a key of a configuration file, whose description is its help."""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Return the option and its help; only this needs the models of files."""
        from coadjoint.files.configuration.models import OutputTable, RunTable

        self.help = (RunTable.model_fields | OutputTable.model_fields)[str(self.name)].description
        return super().get_help_record(ctx)


OUT = click.option("--out", "file", cls=KeyOption, metavar="PATH")
ARCHIVE = click.option("--archive", cls=KeyOption, metavar="PATH")
FIGURE = click.option("--figure", cls=KeyOption, metavar="PATH")
MOVIE = click.option("--movie", cls=KeyOption, metavar="PATH")
THREADS = click.option("--threads", cls=KeyOption, type=int, metavar="N")
WORKERS = click.option("--workers", cls=KeyOption, type=int, metavar="N")
PROGRESS = click.option("--progress", is_flag=True, help="Show a progress bar.")
QUIET = click.option("--quiet", is_flag=True, help="Print nothing.")


@click.command("run")
@click.argument("path", metavar="FILE", type=click.Path())
@OUT
@ARCHIVE
@FIGURE
@MOVIE
@PROGRESS
@QUIET
def run_file(path: str, progress: bool, quiet: bool, **options: str | None) -> None:
    """Run the configuration FILE (TOML).

    Paths of results are those in FILE, unless options give others. A run that fails writes the solution so far, marked
    as failed, and ends with exit status 1. One that is interrupted writes the solution so far, marked as incomplete;
    `coadjoint resume` continues an archive.
    """
    from coadjoint.files.configuration.loading import load

    configuration = load(path)
    paths = _output_paths(configuration.path, configuration.outputs | _given(options))
    with saving_partial_run(configuration.path, paths.get("archive"), paths.get("file"), configuration.dataset):
        solution = configuration.integrate(progress=progress, archive=paths.get("archive"))
    _write_results(configuration.path, solution, configuration.dataset, paths)
    if not quiet:
        _summarize(solution, paths.values())


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


def _given(options: Mapping[str, str | None]) -> dict[str, str | None]:
    return {key: path for key, path in options.items() if path is not None}


def _output_paths(name: str, declared: Mapping[str, str | None]) -> dict[str, Path]:
    """Validate the paths of archive, dataset, figure and movie of a file or of options."""
    from coadjoint.files.archives.archived_run import check_new
    from coadjoint.files.configuration.parsing import section
    from coadjoint.files.output.output_files import DATASETS, FIGURES, check_movie, check_target

    checks: dict[str, Callable[[str], object]] = {
        "archive": check_new,
        "file": lambda path: check_target(path, DATASETS),
        "figure": lambda path: check_target(path, FIGURES),
        "movie": check_movie,
    }
    given = {key: path for key in checks if (path := declared.get(key)) is not None}
    for key, path in given.items():
        with section(name, f"output.{key}"):
            checks[key](path)
    return {key: Path(path) for key, path in given.items()}  # as they were given, for messages


def _summarize(solution: Solution, written: Iterable[Path]) -> None:
    from coadjoint.runs.results.solution_output import is_driven

    stats, context, change = solution.stats, click.get_current_context(silent=True), solution.change()
    seconds = stats.elapsed if context is None else time.monotonic() - context.find_root().obj
    click.echo(
        in_one_line(f"{solution.system.name}, {solution.method}")
        + f": {stats.steps} steps of {solution.step:g}; {seconds:.3g} s, {stats.seconds:.3g} s in the loop"
    )
    balance = solution.balance() if solution.work else None
    what = "largest deviation from the start" if balance is None else "change, and change minus the work of the forces"
    extent = "every step" if solution.watched else "the saved points"
    click.echo(f"{what}{'' if balance is None else ' (balance)'}, over {extent}:")
    labels = {name: in_one_line(name, 60) for name in change}
    if is_driven(solution.system):
        labels["energy"] = "energy (driven, so that it changes)"
    width = max(map(len, labels.values()))
    for name, label in labels.items():
        second = "" if balance is None else f"  {balance.get(name, math.nan):.3g}"
        click.echo(f"  {label:{width}}  {change[name]:.3g}{second}")
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
    _output_paths(configuration.path, configuration.outputs)
    text, failed = describe_run(configuration)
    click.echo(text)
    if failed:
        raise click.exceptions.Exit(1)


@click.command("resume")
@click.argument("path", type=click.Path())
@click.option("--t-end", type=float, metavar="T", help="A later end of the run (time).")
@OUT
@FIGURE
@MOVIE
@THREADS
@WORKERS
@PROGRESS
@QUIET
def resume_archive(
    path: str,
    t_end: float | None,
    threads: int | None,
    workers: int | None,
    progress: bool,
    quiet: bool,
    **options: str | None,
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
    from coadjoint.files.output.output_files import OutputError

    system, declared, given = None, {}, _given(options)
    attributes = open_archive(read_archive_path(path)).attributes
    if (text := attributes.get(CONFIGURATION)) is not None:
        # Catalogue algebras may have Casimirs that are functions, which only the configuration file can restore.
        system = system_of_text(text) if requires_argument(attributes, "system") else None
        declared = {**outputs_of_text(text), "archive": None}
    for key, target in declared.items():
        # The archive may come from others.
        if key not in given and target is not None and not Path(target).resolve().is_relative_to(Path.cwd().resolve()):
            option = "out" if key == "file" else key
            raise OutputError(f"{path}: output.{key}: {target} is outside of the current folder; give --{option}")
    results = _output_paths(path, declared | given)
    with saving_partial_run(path, Path(path), None, None):
        solution = resume(path, t_end, system=system, threads=threads, workers=workers, progress=progress)
    _write_results(path, solution, lambda resumed: resumed.to_xarray().drop_encoding(), results)
    if not quiet:
        _summarize(solution, [Path(path), *results.values()])


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
    from coadjoint.files.configuration.loading import load
    from coadjoint.files.output.output_files import FIGURES, TEXTS, check_target, write_figure, write_text

    run = load(file)
    if run.prepared.system.is_batch:
        problem = "sweep.over: a certificate is of one system; sweep over the initial state alone"
        raise ConfigurationError(f"{run.path}: {problem}")
    json_target = None if json_path is None else check_target(json_path, TEXTS)
    figure_target = None if figure_path is None else check_target(figure_path, FIGURES)
    first, last = run.file.run.span
    step = math.copysign(run.prepared.step, last - first)
    certificate = certify(run.prepared.system, run.prepared.method, run.x0, step, steps=steps)
    click.echo(str(certificate))
    writers: dict[Path | None, Callable[[Path], object]] = {
        json_target: lambda path: write_text(certificate.to_json(), path),
        figure_target: lambda path: write_figure(certificate.plot(), path),
    }
    for target, write in writers.items():
        if target is not None:
            with reporting_write_errors(run.path, target):
                write(target)
            click.echo(f"written: {target}")
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
        kept = "" if archive is None else f"; the archive {archive} holds the solution so far"
        if target is not None and dataset is not None and error.partial is not None:
            kept = _write_partial(dataset(error.partial), error, target)
        raise _run_ended(f"{name}: the run failed: {error}{kept}") from error
    except interruption.Interrupted as interrupt:
        partial: Any = interrupt.partial if archive is None else _open_partial_run(archive)
        kept = ""
        if archive is not None and partial is not None:
            kept = f"; {archive} holds {partial.progress_text}: coadjoint resume {archive} continues it"
        elif target is not None and dataset is not None and partial is not None and len(partial.t):
            kept = _write_partial(dataset(partial), interrupt, target)
        message = f"{name if kept else 'coadjoint'}: {interrupt.description}{kept}"
        raise _run_ended(message, 128 + interrupt.number) from interrupt


def _write_partial(dataset: xarray.Dataset, error: IntegrationError | interruption.Interrupted, target: Path) -> str:
    """Write the solution so far, marked as failed or incomplete; return the part of the message about it."""
    from coadjoint.files.datasets.export import failure_attributes, incomplete_attributes
    from coadjoint.files.output.output_files import write_dataset

    if isinstance(error, IntegrationError):
        attributes, mark = failure_attributes(error), ""
    else:
        attributes = incomplete_attributes(error.description, float(dataset["time"][-1]))
        mark = ", marked as incomplete"
    try:
        with reporting_write_errors("the solution so far is lost", target):
            write_dataset(dataset.assign_attrs(attributes), target)
    except click.ClickException as reason:
        return f"; {reason.message}"
    return f"; the solution so far is in {target}{mark}"


@contextmanager
def reporting_write_errors(name: str, target: Path) -> Iterator[None]:
    """Context that reports in one line if the result of a run cannot be written."""
    from coadjoint.files.output.output_files import OutputError

    try:
        yield
    except (OSError, OutputError, MemoryError) as reason:
        detail = getattr(reason, "strerror", None) or str(reason) or "it does not fit into memory"
        raise _run_ended(f"{name}: {target} could not be written ({detail}); nothing was replaced") from reason


def _open_partial_run(archive: Path) -> Any:
    """Open the partial run in an archive; None if the archive was not created yet."""
    from coadjoint.files.archives.archived_solution import open_archive

    try:
        return open_archive(archive)
    except ValueError:
        return None
