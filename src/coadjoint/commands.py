"""The command ``coadjoint``: its commands, messages and exit statuses, which `coadjoint.cli` documents."""

from __future__ import annotations

import contextlib
import importlib
import inspect
import json
import math
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from coadjoint import __version__, interruption
from coadjoint.errors import ConfigurationError, IntegrationError, OneLineError, in_one_line
from coadjoint.long_operations import LongWait
from coadjoint.optional_packages import require_packages
from coadjoint.short_repr import short
from coadjoint.validation import read_choice

if TYPE_CHECKING:
    import xarray

    from coadjoint.runs.results.solution import Solution

FOLDER = click.Path(file_okay=False, path_type=Path)
BROKEN_PIPE_STATUS = 141  # broken pipe: 128 + SIGPIPE
MAX_NUMBER_LENGTH = 60  # characters of a parameter, which is read as an exact fraction


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
    from coadjoint.files.configuration.models import section
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
    if json_target is not None:
        with reporting_write_errors(run.path, json_target):
            write_text(certificate.to_json(), json_target)
    if figure_target is not None:
        with reporting_write_errors(run.path, figure_target):
            write_figure(certificate.plot(), figure_target)
    for target in filter(None, (json_target, figure_target)):
        click.echo(f"written: {target}")
    if not certificate.passed:
        raise click.exceptions.Exit(1)


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


@click.command("systems")
@click.argument("name", required=False)
@click.option("--json", "json_path", metavar="PATH", help="Path of a file of the description of NAME: .json.")
def list_systems(name: str | None, json_path: str | None) -> None:
    """List the ready-made systems with their parameters, or describe one, NAME, with a first run.

    The description has parameters with units, algebra, Casimirs, integrals, whether a closed form and an attitude
    exist, and a suggested scheme and step.
    """
    from coadjoint.files.output.output_files import TEXTS, check_target, write_text
    from coadjoint.summaries import summarize_system, system_text
    from coadjoint.systems.registry import ready_made_systems

    known = ready_made_systems()
    if name is None:
        if json_path is not None:
            raise click.UsageError("--json writes the description of one system; give its name")
        for system_name, builder in sorted(known.items()):
            signature = inspect.signature(builder).parameters
            _describe(system_name, {key: p.default for key, p in signature.items()}, inspect.getdoc(builder) or "")
        return
    read_choice(name, "system", known)
    target = None if json_path is None else check_target(json_path, TEXTS)
    summary = summarize_system(name)
    click.echo(system_text(summary))
    if target is not None:
        write_text(json.dumps(summary, indent=1), target)
        click.echo(f"written: {target}")


@click.command("algebras")
@click.argument("name", required=False)
@click.argument("parameters", nargs=-1, metavar="[KEY=NUMBER]...")
def list_algebras(name: str | None, parameters: tuple[str, ...]) -> None:
    """List the algebras of the catalogue, or show dimension, brackets and Casimirs of one, NAME.

    Parameters of an algebra follow its name, such as A4,9 b=0.5.
    """
    from coadjoint.summaries import algebra_of, algebra_text, listed_algebras

    if name is None:
        for line in listed_algebras():
            click.echo(line)
        return
    click.echo(algebra_text(algebra_of(name, dict(map(_read_parameter, parameters)))))


def _read_parameter(text: str) -> tuple[str, Fraction]:
    key, _, number = text.partition("=")
    try:
        if len(text) > MAX_NUMBER_LENGTH:
            raise ValueError
        # An exponent can denote a number of any size.
        return key, Fraction(float(number) if "e" in number.lower() else number)
    except (ValueError, ArithmeticError):
        raise ValueError(f"{short(text)} is not a parameter; give name and number, such as b=0.5 or b=1/3") from None


@click.command("methods")
@click.argument("name", required=False)
def list_methods(name: str | None) -> None:
    """List the schemes with their parameters, or describe one, NAME."""
    from coadjoint.methods import registry

    if name is not None:
        text = registry.documentation_of(name)
        _describe(name, registry.parameters_of(name), text)
        click.echo("".join(f"    {line}".rstrip() + "\n" for line in text.splitlines()[1:]), nl=False)
        return
    for name in registry.names():
        _describe(name, registry.parameters_of(name), registry.documentation_of(name))


def _describe(name: str, parameters: Mapping[str, Any], documentation: str) -> None:
    empty = inspect.Parameter.empty
    arguments = ", ".join(key if default is empty else f"{key}={default!r}" for key, default in parameters.items())
    click.echo(f"{name}({arguments})\n    {documentation.partition(chr(10))[0]}")


@click.command("selftest")
@click.option("--quiet", is_flag=True, help="Print only the checks that fail.")
def check_installation(quiet: bool) -> None:
    """Check the installed package on this machine, in under a minute; print each measurement and its bound.

    The exit status is 0 if every check passes. A check skipped because of a missing package does not fail.
    """
    from coadjoint.experiments.selftest import selftest

    started, failed, skipped, count = time.monotonic(), 0, 0, 0
    for check in selftest():
        count, failed, skipped = count + 1, failed + (not check.passed), skipped + bool(check.skipped)
        if not (quiet and check.passed):
            click.echo(str(check))
    if not quiet:
        seconds = time.monotonic() - started
        click.echo(f"coadjoint {__version__}: {count} checks, {failed} failed, {skipped} skipped, {seconds:.1f} s")
    if failed:
        raise click.exceptions.Exit(1)


@click.command("checkcase")
@click.argument("name", required=False)
@click.argument("parameters", nargs=-1, metavar="[KEY=NUMBERS]...")
@click.option("--list", "show_list", is_flag=True, help="List the check-cases with their parameters.")
@click.option(
    "--out",
    metavar="PATH",
    help="Path of the reference: .csv or .json; with --compare that of the errors over time: .csv.",
)
@click.option(
    "--compare",
    "files",
    multiple=True,
    metavar="FILE",
    help="Samples of a simulator: .csv, .parquet or .nc (NetCDF). Several, of different steps, give the order.",
)
@click.option(
    "--columns",
    metavar="NAMES",
    help="Columns of FILE: 't=time,wx=p[deg/s],...', or all names in their order for a file without a header. By "
    "default they are found by name.",
)
@click.option(
    "--tolerance",
    type=float,
    metavar="E",
    help="Largest error that passes, relative, or in radians for attitudes; by default 1e-6.",
)
@click.option(
    "--step",
    "steps",
    type=float,
    multiple=True,
    metavar="H",
    help="Step of the simulator, in seconds, for a diagnosis of its scheme; once for each FILE.",
)
@click.option("--plot", "figure_path", metavar="PATH", help="Path of a figure of the errors: .png, .pdf or .svg.")
def check_simulator(
    name: str | None,
    parameters: tuple[str, ...],
    show_list: bool,
    out: str | None,
    files: tuple[str, ...],
    columns: str | None,
    tolerance: float | None,
    steps: tuple[float, ...],
    figure_path: str | None,
) -> None:
    """Describe the check-case NAME, write its certain answer, or compare the output of a simulator with it.

    Parameters of a case follow its name in SI units, such as free_body inertia=1,2,2.5 rates=0.1,2,0.1. The exit status
    of --compare is 0 within the tolerance, and 1 beyond it.
    """
    from coadjoint.checkcases.comparison import Comparison, observed_orders
    from coadjoint.checkcases.reference_files import FORMATS, write_errors
    from coadjoint.checkcases.registry import get
    from coadjoint.checkcases.report import described_case, listed_cases, read_case_parameter
    from coadjoint.files.output.output_files import FIGURES, check_target, write_figure

    given = {"--columns": columns, "--tolerance": tolerance, "--step": steps or None, "--plot": figure_path}
    if name is None or show_list:
        return click.echo(listed_cases())
    if not files and (unused := [key for key, value in given.items() if value is not None]):
        raise click.UsageError(f"{unused[0]} is for a comparison; give --compare FILE")
    if steps and len(steps) != len(files):
        raise click.UsageError(f"--step was given {len(steps)} times, for {len(files)} files; give it once for each")
    if len(files) > 1 and (out or figure_path):
        raise click.UsageError("--out and --plot are of one comparison; give --compare once")
    case = get(name, **dict(map(read_case_parameter, parameters)))
    target = None if out is None else check_target(out, (".csv",) if files else FORMATS)
    figure_target = None if figure_path is None else check_target(figure_path, FIGURES)
    if not files:
        click.echo(described_case(case)) if target is None else case.write(target)
    comparisons: list[Comparison] = []
    bound = {} if tolerance is None else {"tolerance": tolerance}
    for k, file in enumerate(files):
        found = case.compare(file, columns=columns, step=steps[k] if steps else None, **bound)
        comparisons.append(found)
        click.echo(f"{file}\n{found}" if len(files) > 1 else str(found))
    if len(files) > 1 and steps:
        for what, order in observed_orders(comparisons, steps).items():
            click.echo(f"observed order of the {what}: {order:.2f}")
    if comparisons and target is not None:
        write_errors(comparisons[0], target)
    if comparisons and figure_target is not None:
        write_figure(comparisons[0].plot(), figure_target)
    for path in filter(None, (target, figure_target)):
        click.echo(f"written: {path}")
    if not all(found.passed for found in comparisons):
        raise click.exceptions.Exit(1)


@click.command("schema")
def print_schema() -> None:
    """Print the JSON Schema of configuration files, for editors."""
    from coadjoint.files.configuration.schema import schema

    click.echo(json.dumps(schema(), indent=1, ensure_ascii=False))


@click.command("reproduce")
@click.option("--out", type=FOLDER, metavar="DIR", default="figures", show_default=True, help="Folder for the figures.")
def reproduce(out: Path) -> None:
    """Repeat the experiments of Reich (1993), print a table of them and draw their figures."""
    experiments = importlib.import_module("coadjoint.experiments.reich1993")
    experiments.check_packages()
    out.mkdir(parents=True, exist_ok=True)
    table, figures = experiments.reproduce(out, click.echo)
    for row in table:
        click.echo(f"{row.verdict:18}  {row.place}: {row.statement}\n{'':20}{row.measured}")
    for figure in figures:
        click.echo(f"written: {figure}")


@click.command("gallery")
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--out", type=FOLDER, metavar="DIR", default="gallery", show_default=True, help="Folder for pictures.")
def draw_gallery(names: tuple[str, ...], out: Path) -> None:
    """Run the ready-made systems, or those with a NAME; plot each, and write a page of the plots.

    The page is index.html, in the same folder. The NAME decaying_turbulence is a run of minutes.
    """
    from coadjoint.files.output.output_files import PAGES, write_figure, write_text
    from coadjoint.systems.registry import gallery_systems

    require_packages("a gallery", "matplotlib")
    from coadjoint.pictures.gallery import PAGE, SCENES, gallery

    known = gallery_systems()
    selected = [read_choice(name, "system", (*known, *SCENES)) for name in dict.fromkeys(names)] or known
    if not names:
        require_packages("a gallery of all systems", "numba", "ducc0")
    out.mkdir(parents=True, exist_ok=True)
    page = gallery(selected, lambda figure, name: write_figure(figure, out / name), click.echo)
    write_text(page, out / PAGE, PAGES)
    click.echo(f"written: {out / PAGE}")


@click.command("export")
@click.argument("file", required=False, type=click.Path())
@click.option("--free-body", is_flag=True, help="The exact step of a free rigid body: one header, C99 and C++11.")
@click.option("--library", is_flag=True, help="The compiled library and its header; --out is a folder.")
@click.option(
    "-o", "--out", "path", metavar="PATH", help="Path: .h or .hpp for C, .json for a table; default: standard output."
)
@click.option("--name", metavar="NAME", help="What the functions of FILE begin with; default: the name of the header.")
@click.option("--tangent", is_flag=True, help="Also the derivative of a step of FILE.")
def export(file: str | None, free_body: bool, library: bool, path: str | None, name: str | None, tangent: bool) -> None:
    """Write code and tables for programs in other languages.

    With the configuration FILE (TOML), it is the step of this run in C99, with the bits of the library, or its table
    for the compiled library. With --free-body, it is a header with functions for double and float. Both headers
    allocate nothing and need only sqrt. --library copies the compiled library, which runs tables by functions of C.
    """
    from coadjoint.files.configuration.loading import load
    from coadjoint.files.configuration.models import section
    from coadjoint.files.exports.c_export import c_header
    from coadjoint.files.exports.c_statements import free_body_header
    from coadjoint.files.exports.table_export import table_text, write_interface
    from coadjoint.files.output.output_files import HEADERS, TEXTS, check_target, write_text

    given = {"--free-body": free_body, "--library": library, "a configuration FILE": file is not None}
    chosen = [what for what, is_given in given.items() if is_given]
    if len(chosen) != 1:
        raise click.UsageError(f"export was given {' and '.join(chosen) or 'nothing'}; give one of {', '.join(given)}")
    is_table = file is not None and path is not None and Path(path).suffix == ".json"
    if (file is None or is_table) and (name is not None or tangent):
        what = "a table" if is_table else chosen[0]
        raise click.UsageError(f"{what} has no --name and no --tangent; omit them")
    if library:
        if path is None:
            raise click.UsageError("--library needs the folder --out")
        for copy in write_interface(path):
            click.echo(f"written: {copy}")
        return
    suffixes = TEXTS if is_table else HEADERS
    target = None if path is None else check_target(path, suffixes)
    if file is None:
        text = free_body_header()
    else:
        prepared = load(file).prepared
        with section(file, "export"):
            text = table_text(prepared) if is_table else c_header(prepared, name or Path(path or file).stem, tangent)
    if target is None:
        return click.echo(text, nl=False)
    write_text(text, target, suffixes)
    click.echo(f"written: {path}")


ALL_COMMANDS = [
    run_file,
    check_file,
    resume_archive,
    certify_file,
    list_systems,
    list_algebras,
    list_methods,
    check_installation,
    check_simulator,
    print_schema,
    reproduce,
    draw_gallery,
    export,
]


@click.group(commands=ALL_COMMANDS, invoke_without_command=True)
@click.version_option(__version__, prog_name="coadjoint", message="%(prog)s %(version)s")
@click.pass_context
def commands(context: click.Context) -> None:
    """Integrate Lie-Poisson systems x' = J(x) grad H(x) and preserve their invariants."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


def _wrong_usage(error: click.UsageError) -> str:
    """Return the message about wrong usage, with where to read about it if it does not say what to do."""
    message = in_one_line(error.format_message())
    is_clear = "; " in message or message.endswith("?")
    usage = "" if is_clear or error.ctx is None else f" (see '{error.ctx.command_path} --help')"
    return f"coadjoint: {message[:1].lower()}{message[1:].rstrip('.')}{usage}"


def perform(arguments: Sequence[str] | None, began: float | None = None) -> tuple[int, str]:
    """Run a command; return its exit status and the text for standard error: one line per error, or else per warning.

    >>> perform(["run", "no_such_file.toml"])
    (2, 'no_such_file.toml: cannot be read (No such file or directory: no_such_file.toml)')
    """
    recorded: list[str] = []

    def show(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
        text = in_one_line(f"coadjoint: warning: {message}")
        if not issubclass(category, LongWait):
            recorded.append(text)
            return
        # Warnings about long operations are printed immediately.
        with contextlib.suppress(OSError, ValueError, AttributeError):
            print(text, file=sys.stderr, flush=True)

    with warnings.catch_warnings():
        warnings.showwarning = show
        began = time.monotonic() if began is None else began
        status, message = _invoke(list(sys.argv[1:] if arguments is None else arguments), began)
    return status, "\n".join(dict.fromkeys(recorded)) if status == 0 else message


def _invoke(arguments: list[str], began: float) -> tuple[int, str]:
    try:
        # Replaces click's own `main`, which prints an empty line at an interrupt.
        with commands.make_context("coadjoint", arguments, obj=began) as context:
            commands.invoke(context)
    except click.exceptions.Exit as done:
        return done.exit_code, ""
    except click.UsageError as error:
        return error.exit_code, _wrong_usage(error)
    except click.ClickException as error:
        return error.exit_code, in_one_line(error.format_message())
    except OneLineError as error:
        return 2, "\n".join(map(in_one_line, getattr(error, "error_lines", ()) or (str(error),)))
    except (ImportError, ValueError, TypeError) as error:
        # An argument is invalid, or a package is missing or incompatible; the message names it.
        return 2, in_one_line(f"coadjoint: {error}")
    except (ArithmeticError, RecursionError, MemoryError) as error:
        return 2, in_one_line(f"coadjoint: {type(error).__name__}: {error}")
    except BrokenPipeError:
        return BROKEN_PIPE_STATUS, ""
    except OSError as error:
        # Errors of output files carry their names, or are an OutputError.
        is_stdout = type(error) is OSError and error.filename is None
        message = f"the standard output cannot be written ({error.strerror})" if is_stdout else str(error)
        return 1, in_one_line(f"coadjoint: {message}")
    return 0, ""
