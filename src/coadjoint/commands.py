"""The commands of ``coadjoint``, thin wrappers of the library. Exit statuses are documented in `coadjoint.cli`."""

from __future__ import annotations

import contextlib
import importlib
import inspect
import math
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import click

from coadjoint import __version__
from coadjoint.errors import in_one_line, nearest
from coadjoint.interrupted_runs import reporting_write_errors, saving_partial_run
from coadjoint.long_operations import LongWait
from coadjoint.optional_packages import require_packages
from coadjoint.short_repr import short

MAX_NUMBER_LENGTH = 60
BROKEN_PIPE_STATUS = 141  # 128 + SIGPIPE

if TYPE_CHECKING:
    from coadjoint.files.configuration.configuration import Configuration
    from coadjoint.runs.solution import Solution


class _Commands(click.Group):
    """Command group that suggests the nearest name for an unknown command."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and not args[0].startswith("-") and self.get_command(ctx, args[0]) is None:
            raise click.UsageError(
                f"unknown command {args[0]!r}; {_did_you_mean(args[0], self.list_commands(ctx))}", ctx
            )
        return super().resolve_command(ctx, args)


@click.group(cls=_Commands, invoke_without_command=True)
@click.version_option(__version__, prog_name="coadjoint", message="%(prog)s %(version)s")
@click.pass_context
def commands(context: click.Context) -> None:
    """Integrate Lie-Poisson systems x' = J(x) grad H(x) and preserve their invariants."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


@commands.command("run")
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
    from coadjoint.files.archives.resume import check_new
    from coadjoint.files.configuration.configuration import load
    from coadjoint.files.output.output_files import DATASETS, FIGURES, check_target, write_dataset, write_figure

    configuration = load(file)
    archive_path = _output_path(configuration, "archive", archive, check_new)
    dataset_path = _output_path(configuration, "file", out, lambda path: check_target(path, DATASETS))
    figure_path = _output_path(configuration, "figure", figure, lambda path: check_target(path, FIGURES))
    movie_path = _output_path(configuration, "movie", movie, lambda path: _movie_target(configuration, path))
    with saving_partial_run(configuration.path, archive_path, dataset_path, configuration.dataset):
        solution = configuration.integrate(progress=progress, archive=archive_path)
    if dataset_path is not None:
        with reporting_write_errors(configuration.path, dataset_path):
            write_dataset(configuration.dataset(solution), dataset_path)
    if figure_path is not None:
        with reporting_write_errors(configuration.path, figure_path):
            write_figure(solution.plot(), figure_path)
    if movie_path is not None:
        with reporting_write_errors(configuration.path, movie_path):
            solution.movie(movie_path)
    if not quiet:
        paths = (archive_path, dataset_path, figure_path, movie_path)
        _summarize(solution, [path for path in paths if path is not None])


def _output_path(
    configuration: Configuration, key: str, option: str | None, check: Callable[[str], Path]
) -> Path | None:
    """Return the path of a result from the option or else the key of the file, checked before the run."""
    from coadjoint.files.configuration.construction import section

    if option is not None:
        return check(option)
    configured = {
        "file": configuration.output,
        "archive": configuration.archive,
        "figure": configuration.figure,
        "movie": configuration.movie,
    }[key]
    if configured is None:
        return None
    with section(configuration.path, f"output.{key}"):
        return check(configured)


def _movie_target(configuration: Configuration, path: str) -> Path:
    from coadjoint.files.configuration.construction import section
    from coadjoint.files.output.movie_file import check_movie
    from coadjoint.systems.protocol import unforced

    target = check_movie(path)  # before the import, which needs Matplotlib
    from coadjoint.pictures.movie import declared_picture

    with section(configuration.path, "output.movie"):
        declared_picture(unforced(configuration.system).name)
    return target


def _summarize(solution: Solution, written: Sequence[Path]) -> None:
    stats = solution.stats
    click.echo(
        in_one_line(f"{solution.system.name}, {solution.method}")
        + f": {stats.steps} steps of {solution.step:g}, {stats.seconds:.3g} s"
    )
    extent = "every step" if solution.watched else "the saved points"
    title = "largest deviation from the start"
    columns: list[Mapping[str, float]] = [solution.change()]
    if solution.work:
        title, balance = "change, and change minus the work of the forces (balance)", solution.balance()
        columns.append({name: balance[name] if name in balance else math.nan for name in solution.change()})
    click.echo(f"{title}, over {extent}:")
    names = {name: in_one_line(name, 60) for name in solution.change()}
    from coadjoint.runs.summary import is_driven

    if is_driven(solution.system):
        names["energy"] = "energy (driven, so that it changes)"
    width = max(map(len, names.values()))
    for name, label in names.items():
        click.echo(f"  {label:{width}}  " + "  ".join(f"{column[name]:.3g}" for column in columns))
    for path in written:
        click.echo(f"written: {path}")


@commands.command("check")
@click.argument("file", type=click.Path())
def check_file(file: str) -> None:
    """Describe what the configuration FILE (TOML) would run and its cost; nothing is written.

    The time is estimated from a trial run of the first steps. Exit status 2, with one line, if the file is invalid; 1
    if the trial run fails, as the run would.
    """
    from coadjoint.files.archives.resume import check_new
    from coadjoint.files.configuration.configuration import load
    from coadjoint.files.configuration.dry_run import plan
    from coadjoint.files.output.output_files import DATASETS, FIGURES, check_target

    configuration = load(file)
    _output_path(configuration, "archive", None, check_new)
    _output_path(configuration, "file", None, lambda path: check_target(path, DATASETS))
    _output_path(configuration, "figure", None, lambda path: check_target(path, FIGURES))
    _output_path(configuration, "movie", None, lambda path: _movie_target(configuration, path))
    dry_run = plan(configuration)
    click.echo(str(dry_run))
    if dry_run.failed:
        raise click.exceptions.Exit(1)


@commands.command("resume")
@click.argument("path", type=click.Path())
@click.option("--t-end", type=float, metavar="T", help="A later end of the run (time).")
@click.option(
    "--threads", type=int, metavar="N", help="Number of threads for the members of an ensemble; by default all cores."
)
@click.option("--workers", type=int, metavar="N", help="Number of processes that continue an ensemble in blocks.")
@click.option("--progress", is_flag=True, help="Show a progress bar.")
@click.option("--quiet", is_flag=True, help="Print nothing.")
def resume_archive(
    path: str, t_end: float | None, threads: int | None, workers: int | None, progress: bool, quiet: bool
) -> None:
    """Continue the run of the archive PATH, with the same bits as an uninterrupted run.

    A finished run is left unchanged, unless a later end is given.
    """
    from coadjoint.files.archives.archived_solution import open_archive
    from coadjoint.files.archives.resume import resume
    from coadjoint.files.configuration.configuration import CONFIGURATION, system_of_text
    from coadjoint.files.records.required_functions import requires_argument

    archive, system = Path(path), None
    attributes = open_archive(archive).attributes
    if CONFIGURATION in attributes and requires_argument(attributes, "system"):
        # Catalogue algebras may have Casimirs that are functions, which only the configuration file can restore.
        system = system_of_text(attributes[CONFIGURATION])
    with saving_partial_run(path, archive, None, None):
        solution = resume(archive, t_end, system=system, threads=threads, workers=workers, progress=progress)
    if not quiet:
        _summarize(solution, [archive])


@commands.command("certify")
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
    from coadjoint.files.configuration.configuration import load
    from coadjoint.files.output.output_files import FIGURES, TEXTS, check_target, write_figure, write_text

    configuration = load(file)
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


@commands.command("systems")
@click.argument("name", required=False)
@click.option("--json", "json_path", metavar="PATH", help="Path of a file of the description of NAME: .json.")
def list_systems(name: str | None, json_path: str | None) -> None:
    """List the ready-made systems with their parameters, or describe one, NAME, with a first run.

    The description has parameters with units, algebra, Casimirs, integrals, whether a closed form and an attitude
    exist, and a suggested scheme and step.
    """
    from coadjoint.systems.registry import ready_made_systems

    known = ready_made_systems()
    if name is not None:
        return _show_system(_check_system_name(name, tuple(known)), json_path)
    if json_path is not None:
        raise click.UsageError("--json writes the description of one system; give its name")
    for system_name, builder in sorted(known.items()):
        signature = inspect.signature(builder).parameters
        _describe(system_name, {key: p.default for key, p in signature.items()}, inspect.getdoc(builder) or "")


def _check_system_name(name: str, known: Sequence[str]) -> str:
    if name not in known:
        raise click.UsageError(f"unknown system {short(name)}; {_did_you_mean(name, sorted(known))}")
    return name


def _show_system(name: str, json_path: str | None) -> None:
    import json

    from coadjoint.files.output.output_files import TEXTS, check_target, write_text
    from coadjoint.runs.system_summary import summarize_system, system_text

    target = None if json_path is None else check_target(json_path, TEXTS)
    summary = summarize_system(name)
    click.echo(system_text(summary))
    if target is not None:
        write_text(json.dumps(summary, indent=1), target)
        click.echo(f"written: {target}")


@commands.command("algebras")
@click.argument("name", required=False)
@click.argument("parameters", nargs=-1, metavar="[KEY=NUMBER]...")
def list_algebras(name: str | None, parameters: tuple[str, ...]) -> None:
    """List the algebras of the catalogue, or show dimension, brackets and Casimirs of one, NAME.

    Parameters of an algebra follow its name, such as A4,9 b=0.5.
    """
    from coadjoint.algebra.algebra_summary import algebra_of, algebra_text, listed_algebras

    if name is None:
        for line in listed_algebras():
            click.echo(line)
        return
    try:
        click.echo(algebra_text(algebra_of(name, dict(map(_read_parameter, parameters)))))
    except (ValueError, TypeError) as reason:
        raise click.UsageError(str(reason)) from None


def _read_parameter(text: str) -> tuple[str, Fraction]:
    key, _, number = text.partition("=")
    try:
        if len(text) > MAX_NUMBER_LENGTH:
            raise ValueError
        # An exponent can denote a number of any size.
        return key, Fraction(float(number) if "e" in number.lower() else number)
    except (ValueError, ArithmeticError):
        raise ValueError(f"{short(text)} is not a parameter; give name and number, such as b=0.5 or b=1/3") from None


@commands.command("methods")
@click.argument("name", required=False)
def list_methods(name: str | None) -> None:
    """List the schemes with their parameters, or describe one, NAME."""
    from coadjoint.methods import registry

    if name is not None:
        try:
            text = registry.documentation_of(name)
        except ValueError as error:
            raise click.UsageError(str(error)) from None
        _describe(name, registry.parameters_of(name), text)
        click.echo("".join(f"    {line}".rstrip() + "\n" for line in text.splitlines()[1:]), nl=False)
        return
    for name in registry.names():
        _describe(name, registry.parameters_of(name), registry.summary_of(name))


def _describe(name: str, parameters: Mapping[str, Any], documentation: str) -> None:
    empty = inspect.Parameter.empty
    arguments = ", ".join(key if default is empty else f"{key}={default!r}" for key, default in parameters.items())
    click.echo(f"{name}({arguments})\n    {documentation.partition(chr(10))[0]}")


@commands.command("selftest")
@click.option("--quiet", is_flag=True, help="Print only the checks that fail.")
def check_installation(quiet: bool) -> None:
    """Check the installed package on this machine, in under a minute; print each measurement and its bound.

    The exit status is 0 if every check passes. A check skipped because of a missing package does not fail.
    """
    from coadjoint.experiments.selftest.run import selftest

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


@commands.command("schema")
def print_schema() -> None:
    """Print the JSON Schema of configuration files, for editors."""
    import json

    from coadjoint.files.configuration.schema import schema

    click.echo(json.dumps(schema(), indent=1, ensure_ascii=False))


@commands.command("reproduce")
@click.option("--out", metavar="DIR", default="figures", show_default=True, help="Folder for the figures.")
def reproduce(out: str) -> None:
    """Repeat the experiments of Reich (1993), print a table of them and draw their figures."""
    experiments = importlib.import_module("coadjoint.experiments.reich1993")
    experiments.check_packages()
    result = experiments.reproduce(_folder(out), click.echo)
    for row in result.table:
        click.echo(f"{row.verdict:18}  {row.place}: {row.statement}\n{'':20}{row.measured}")
    for figure in result.figures:
        click.echo(f"written: {figure}")


def _folder(out: str) -> Path:
    """Return a folder, created if it does not exist."""
    folder = Path(out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as reason:
        raise click.UsageError(f"--out {out}: cannot be made a folder ({reason.strerror}); give another") from None
    return folder


@commands.command("gallery")
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--out", metavar="DIR", default="gallery", show_default=True, help="Folder for pictures and page.")
def draw_gallery(names: tuple[str, ...], out: str) -> None:
    """Run the ready-made systems, or those with a NAME; plot each, and write a page of the plots.

    The page is index.html, in the same folder. The NAME decaying_turbulence is a run of minutes.
    """
    from coadjoint.files.output.output_files import write_figure, write_page
    from coadjoint.systems.registry import gallery_systems

    require_packages("a gallery", "matplotlib")
    from coadjoint.pictures.gallery import PAGE, SCENES, gallery

    known = gallery_systems()
    selected = [_check_system_name(name, (*known, *SCENES)) for name in dict.fromkeys(names)] or known
    if not names:
        require_packages("a gallery of all systems", "numba", "ducc0")
    folder = _folder(out)
    page = gallery(selected, lambda figure, name: write_figure(figure, folder / name), click.echo)
    write_page(page, folder / PAGE)
    click.echo(f"written: {folder / PAGE}")


def _did_you_mean(name: str, known: Sequence[str]) -> str:
    near = nearest(name, known)
    return f"there are {', '.join(known)}" if near is None else f"did you mean {near!r}?"


def _one_line_message(error: click.ClickException) -> str:
    """Return the error message in one line."""
    if isinstance(error, click.NoSuchOption) and error.ctx is not None:
        known = [
            name for parameter in error.ctx.command.get_params(error.ctx) for name in parameter.opts if name[0] == "-"
        ]
        return f"coadjoint: unknown option {error.option_name!r}; {_did_you_mean(error.option_name, known)}"
    message = in_one_line(error.format_message())
    if isinstance(error, click.UsageError):
        usage = f" (see '{error.ctx.command_path} --help')" if error.ctx is not None and "; " not in message else ""
        return f"coadjoint: {message[:1].lower()}{message[1:].rstrip('.')}{usage}"
    return message


def perform(arguments: Sequence[str] | None) -> tuple[int, str]:
    """Run a command; return its exit status and the text for standard error: one line per error, or else per warning.

    Examples
    --------
    >>> perform(["run", "no_such_file.toml"])
    (2, 'no_such_file.toml: cannot be read (No such file or directory)')
    """
    recorded: list[str] = []

    def show_warning(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        text = in_one_line(f"coadjoint: warning: {message}")
        if not issubclass(category, LongWait):
            recorded.append(text)
            return
        # Warnings about long operations are printed immediately.
        with contextlib.suppress(OSError, ValueError, AttributeError):
            print(text, file=sys.stderr, flush=True)

    with warnings.catch_warnings():
        warnings.showwarning = show_warning
        status, message = _invoke(list(sys.argv[1:] if arguments is None else arguments))
    if status == 0:
        message = "\n".join(dict.fromkeys(recorded))
    return status, message


def _invoke(arguments: list[str]) -> tuple[int, str]:
    from coadjoint.files.archives.store import ArchiveError
    from coadjoint.files.configuration.configuration import ConfigurationError
    from coadjoint.files.output.output_files import OutputError

    try:
        # Replaces click's own `main`, which prints an empty line at an interrupt.
        with commands.make_context("coadjoint", arguments) as context:
            commands.invoke(context)
    except click.exceptions.Exit as done:
        return done.exit_code, ""
    except click.ClickException as error:
        return error.exit_code, in_one_line(_one_line_message(error))
    except (ArchiveError, ConfigurationError, OutputError) as error:
        return 2, "\n".join(map(in_one_line, getattr(error, "error_lines", ()) or (str(error),)))
    except ImportError as error:
        # A package is missing or incompatible; the message names it.
        return 2, in_one_line(f"coadjoint: {error}")
    except (ValueError, TypeError, ArithmeticError, RecursionError, MemoryError) as error:
        # Not caught by any validator, but still invalid input.
        return 2, in_one_line(f"coadjoint: {type(error).__name__}: {error}")
    except BrokenPipeError:
        return BROKEN_PIPE_STATUS, ""
    except OSError as error:
        # Errors of output files carry their names, or are an OutputError.
        is_stdout = type(error) is OSError and error.filename is None
        message = f"the standard output cannot be written ({error.strerror})" if is_stdout else str(error)
        return 1, in_one_line(f"coadjoint: {message}")
    return 0, ""
