"""Handling of failed and interrupted runs in the command-line interface: partial results and messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from coadjoint import interruption

if TYPE_CHECKING:
    import xarray

    from coadjoint.errors import IntegrationError


class RunFailed(click.ClickException):
    """A run failed, or its result could not be written: exit status 1."""

    exit_code = 1


class RunStopped(click.ClickException):
    """A run was interrupted: exit status 128 + number of the signal."""

    def __init__(self, message: str, number: int) -> None:
        super().__init__(message)
        self.__dict__["exit_code"] = 128 + number


@contextmanager
def saving_partial_run(
    name: str, archive: Path | None, target: Path | None, dataset: Callable[[Any], xarray.Dataset] | None
) -> Iterator[None]:
    """Context that saves the solution so far of a run that fails or is interrupted, and reports it in one line.

    `archive` is written during the run, `target` from the result converted by `dataset`.
    """
    from coadjoint.errors import IntegrationError

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
        raise RunFailed(f"{name}: {_write_error(target, reason)}") from reason


def _write_error(target: Path, reason: BaseException) -> str:
    detail = getattr(reason, "strerror", None) or str(reason) or "it does not fit into memory"
    return f"{target} could not be written ({detail}); nothing was replaced"


def _failure_error(
    name: str, error: IntegrationError, archive: Path | None, target: Path | None, dataset: Any
) -> RunFailed:
    """Write the solution so far and return the error to raise."""
    from coadjoint.files.datasets.export import failure_attributes

    written = "" if archive is None else f"; the archive {archive} holds the solution so far"
    if target is not None and error.partial is not None:
        written = _write(dataset(error.partial).assign_attrs(failure_attributes(error)), target)
    return RunFailed(f"{name}: the run failed: {error}{written}")


def _interruption_error(
    name: str, interrupt: interruption.Interrupted, archive: Path | None, target: Path | None, dataset: Any
) -> RunStopped:
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
    return RunStopped(message, interrupt.number)


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
