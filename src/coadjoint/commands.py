"""The command ``coadjoint``: its subcommands, messages and exit statuses, which are documented in `coadjoint.cli`."""

from __future__ import annotations

import contextlib
import sys
import time
import warnings
from collections.abc import Sequence
from typing import TextIO

import click

from coadjoint import __version__, library_commands, run_commands
from coadjoint.errors import in_one_line, unknown_name
from coadjoint.long_operations import LongWait

BROKEN_PIPE_STATUS = 141  # broken pipe: 128 + SIGPIPE


class _Commands(click.Group):
    """Command group that suggests the nearest name for an unknown command."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and not args[0].startswith("-") and self.get_command(ctx, args[0]) is None:
            raise click.UsageError(str(unknown_name("command", args[0], self.list_commands(ctx))), ctx)
        return super().resolve_command(ctx, args)


@click.group(cls=_Commands, commands=[*run_commands.COMMANDS, *library_commands.COMMANDS], invoke_without_command=True)
@click.version_option(__version__, prog_name="coadjoint", message="%(prog)s %(version)s")
@click.pass_context
def commands(context: click.Context) -> None:
    """Integrate Lie-Poisson systems x' = J(x) grad H(x) and preserve their invariants."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


def _one_line_message(error: click.ClickException) -> str:
    """Return the error message in one line."""
    if isinstance(error, click.NoSuchOption) and error.ctx is not None:
        known = [
            name for parameter in error.ctx.command.get_params(error.ctx) for name in parameter.opts if name[0] == "-"
        ]
        return f"coadjoint: {unknown_name('option', error.option_name, known)}"
    message = in_one_line(error.format_message())
    if isinstance(error, click.UsageError):
        usage = f" (see '{error.ctx.command_path} --help')" if error.ctx is not None and "; " not in message else ""
        return f"coadjoint: {message[:1].lower()}{message[1:].rstrip('.')}{usage}"
    return message


def perform(arguments: Sequence[str] | None, began: float | None = None) -> tuple[int, str]:
    """Run a command; return its exit status and the text for standard error: one line per error, or else per warning.

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
        began = time.monotonic() if began is None else began
        status, message = _invoke(list(sys.argv[1:] if arguments is None else arguments), began)
    if status == 0:
        message = "\n".join(dict.fromkeys(recorded))
    return status, message


def _invoke(arguments: list[str], began: float) -> tuple[int, str]:
    from coadjoint.errors import ConfigurationError
    from coadjoint.files.archives.archive import ArchiveError
    from coadjoint.files.output.output_files import OutputError

    try:
        # Replaces click's own `main`, which prints an empty line at an interrupt.
        with commands.make_context("coadjoint", arguments, obj=began) as context:
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
