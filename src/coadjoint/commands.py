"""The command ``coadjoint``: its commands on the library itself, messages and exit statuses.

What the library contains, its checks on this machine, the paper, the gallery, and exports are here; commands that run
files are in `coadjoint.run_commands`. Exit statuses are documented in `coadjoint.cli`.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
import sys
import time
import warnings
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import click

from coadjoint import __version__, run_commands
from coadjoint.errors import OneLineError, in_one_line
from coadjoint.long_operations import LongWait
from coadjoint.optional_packages import require_packages
from coadjoint.short_repr import short
from coadjoint.validation import read_choice

FOLDER = click.Path(file_okay=False, path_type=Path)
BROKEN_PIPE_STATUS = 141  # broken pipe: 128 + SIGPIPE
MAX_NUMBER_LENGTH = 60  # characters of a parameter, which is read as an exact fraction


@click.command("systems")
@click.argument("name", required=False)
@click.option("--json", "json_path", metavar="PATH", help="Path of a file of the description of NAME: .json.")
def list_systems(name: str | None, json_path: str | None) -> None:
    """List the ready-made systems with their parameters, or describe one, NAME, with a first run.

    The description has parameters with units, algebra, Casimirs, integrals, whether a closed form and an attitude
    exist, and a suggested scheme and step.
    """
    import json

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


@click.command("schema")
def print_schema() -> None:
    """Print the JSON Schema of configuration files, for editors."""
    import json

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
    from coadjoint.files.configuration.parsing import section
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
    *run_commands.COMMANDS,
    list_systems,
    list_algebras,
    list_methods,
    check_installation,
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
