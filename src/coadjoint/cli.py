"""The command ``coadjoint``: a thin skin over the library.

Exit status: 0, all is well; 1, a run failed while running (what it had is written, and says so); 2, wrong input, one
line on the standard error says what would be right; 130, interrupted.
"""

from __future__ import annotations

import difflib
import importlib
import inspect
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from coadjoint import __version__

if TYPE_CHECKING:
    from coadjoint.errors import IntegrationError
    from coadjoint.runs.configuration import Configuration
    from coadjoint.runs.solution import Solution


class _Commands(click.Group):
    """Commands, with the nearest name for one that does not exist."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and not args[0].startswith("-") and self.get_command(ctx, args[0]) is None:
            raise click.UsageError(f"unknown command {args[0]!r}; {_nearest(args[0], self.list_commands(ctx))}", ctx)
        return super().resolve_command(ctx, args)


@click.group(cls=_Commands, invoke_without_command=True)
@click.version_option(__version__, prog_name="coadjoint", message="%(prog)s %(version)s")
@click.pass_context
def commands(context: click.Context) -> None:
    """Integrate generalized Euler equations x' = J(x) grad H(x) with their structure kept."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


@commands.command("run")
@click.argument("file", type=click.Path())
@click.option("--out", metavar="PATH", help="Where to write the solution: .nc or .zarr; otherwise what the file says.")
@click.option("--figure", metavar="PATH", help="Where to draw it: .png, .pdf or .svg; otherwise what the file says.")
@click.option("--progress", is_flag=True, help="Show a progress bar.")
@click.option("--quiet", is_flag=True, help="Print nothing.")
def run_file(file: str, out: str | None, figure: str | None, progress: bool, quiet: bool) -> None:
    """Run the configuration FILE (TOML).

    A run that fails while running writes what it had, marked as failed, and ends with exit status 1.
    """
    from coadjoint.errors import IntegrationError
    from coadjoint.runs.configuration import load
    from coadjoint.runs.output import FIGURES, check_target, write_figure

    configuration = load(file)
    target = _place(out, configuration.output, lambda path: check_target(path))
    drawing = _place(figure, configuration.figure, lambda path: check_target(path, FIGURES))
    try:
        solution = configuration.integrate(progress=progress)
    except IntegrationError as error:
        raise _failed(configuration, error, target) from error
    if target is not None:
        from coadjoint.runs.output import write_dataset

        write_dataset(configuration.dataset(solution), target)
    if drawing is not None:
        write_figure(solution.plot(), drawing)
    if not quiet:
        _summarize(solution, [place for place in (target, drawing) if place is not None])


def _place(option: str | None, configured: str | None, check: Any) -> Path | None:
    chosen = option if option is not None else configured
    return None if chosen is None else check(chosen)


class _RunFailed(click.ClickException):
    """A run that failed while running: exit status 1."""

    exit_code = 1


def _failed(configuration: Configuration, error: IntegrationError, target: Path | None) -> _RunFailed:
    """Write what there is, and return what is to be said."""
    written = ""
    if target is not None and error.partial is not None:
        from coadjoint.runs.export import mark_failed
        from coadjoint.runs.output import write_dataset

        write_dataset(mark_failed(configuration.dataset(error.partial), error), target)
        written = f"; the solution so far is in {target}"
    return _RunFailed(f"{configuration.path}: the run failed: {error}{written}")


def _summarize(solution: Solution, written: Sequence[Path]) -> None:
    stats = solution.stats
    click.echo(
        f"{solution.system.name}, {solution.method}: {stats.steps} steps of {solution.step:g}, {stats.seconds:.3g} s"
    )
    over = "every step" if solution.watched else "the saved points"
    click.echo(f"largest deviation from the start, over {over}:")
    drifts = solution.drift()
    width = max(map(len, drifts))
    for name, drift in drifts.items():
        click.echo(f"  {name:{width}}  {drift:.3g}")
    for place in written:
        click.echo(f"written: {place}")


@commands.command("systems")
def list_systems() -> None:
    """List the ready-made systems with their parameters."""
    from coadjoint.systems.ready_made import ready_made_systems

    for name, builder in sorted(ready_made_systems().items()):
        signature = inspect.signature(builder).parameters
        _describe(name, {key: p.default for key, p in signature.items()}, inspect.getdoc(builder) or "")


@commands.command("methods")
def list_methods() -> None:
    """List the schemes with their parameters."""
    from coadjoint.methods import registry

    for name in registry.names():
        _describe(name, registry.parameters_of(name), registry.summary_of(name))


def _describe(name: str, parameters: Mapping[str, Any], documentation: str) -> None:
    empty = inspect.Parameter.empty
    shown = ", ".join(key if default is empty else f"{key}={default!r}" for key, default in parameters.items())
    click.echo(f"{name}({shown})\n    {documentation.partition(chr(10))[0]}")


@commands.command("reproduce")
@click.option("--out", metavar="DIR", default="figures", show_default=True, help="Folder for the figures.")
def reproduce(out: str) -> None:
    """Repeat the experiments of Reich (1993), print a table of them and draw their figures."""
    folder = Path(out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as reason:
        raise click.UsageError(f"--out {out}: cannot be made a folder ({reason.strerror}); give another") from None
    experiments = importlib.import_module("coadjoint.experiments.reich1993")
    result = experiments.reproduce(folder, click.echo)
    for row in result.table:
        click.echo(f"{row.verdict:18}  {row.place}: {row.statement}\n{'':20}{row.measured}")
    for figure in result.figures:
        click.echo(f"written: {figure}")


def _nearest(name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"did you mean {near[0]!r}?" if near else f"there are {', '.join(known)}"


def _said(error: click.ClickException) -> str:
    """Return what is wrong in one line."""
    if isinstance(error, click.NoSuchOption) and error.ctx is not None:
        known = [
            name for parameter in error.ctx.command.get_params(error.ctx) for name in parameter.opts if name[0] == "-"
        ]
        return f"coadjoint: unknown option {error.option_name!r}; {_nearest(error.option_name, known)}"
    message = " ".join(error.format_message().split())
    if isinstance(error, click.UsageError):
        usage = f" (see '{error.ctx.command_path} --help')" if error.ctx is not None and "; " not in message else ""
        return f"coadjoint: {message[:1].lower()}{message[1:].rstrip('.')}{usage}"
    return message


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit status.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the command line by default.

    Returns
    -------
    int
        0, 1, 2 or 130, as the module says.

    Examples
    --------
    >>> main(["--version"])
    coadjoint 0.1.0
    0
    """
    from coadjoint.runs.configuration import ConfigurationError
    from coadjoint.runs.output import OutputError

    try:
        commands.main(args=None if arguments is None else list(arguments), prog_name="coadjoint", standalone_mode=False)
    except click.ClickException as error:
        click.echo(_said(error), err=True)
        return error.exit_code
    except (ConfigurationError, OutputError) as error:
        click.echo(str(error), err=True)
        return 2
    except (click.Abort, KeyboardInterrupt):
        click.echo("coadjoint: interrupted", err=True)
        return 130
    except (ValueError, OverflowError, RecursionError, MemoryError) as error:
        # Numbers and nestings that no reader foresaw: bad input all the same, on one line.
        click.echo(f"coadjoint: {type(error).__name__}: {' '.join(str(error).split())[:300]}", err=True)
        return 2
    except OSError as error:
        # A disk that fills up, for instance; whatever could be known before the run was refused before it.
        click.echo(f"coadjoint: {error}", err=True)
        return 1
    return 0


def run() -> None:
    """Run the command and leave the interpreter with its exit status."""
    sys.exit(main())
