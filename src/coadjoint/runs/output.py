"""Where do results go? Files written whole or not at all, and refused before a run rather than after it."""

from __future__ import annotations

import importlib.util
import os
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


class OutputError(ValueError):
    """A result cannot be written where it should go."""


DATASETS = (".nc", ".zarr")
FIGURES = (".png", ".pdf", ".svg")


def check_target(path: str | Path, suffixes: Iterable[str] = DATASETS) -> Path:
    """Return the path of a result if it can be written; nothing is left behind.

    Parameters
    ----------
    path : str or Path
        The file to be written, or replaced.
    suffixes : iterable of str
        Those allowed; by default ``.nc`` and ``.zarr``.

    Returns
    -------
    Path

    Raises
    ------
    OutputError
        In one sentence: the suffix is unknown, the folder is missing or cannot be written to, the target is no result,
        or a package is missing.

    Examples
    --------
    >>> check_target("run.csv")
    Traceback (most recent call last):
    ...
    coadjoint.runs.output.OutputError: run.csv: the suffix says the format; it must be .nc or .zarr
    """
    target, allowed = Path(path), tuple(suffixes)
    if target.suffix not in allowed:
        raise OutputError(f"{path}: the suffix says the format; it must be {', '.join(allowed[:-1])} or {allowed[-1]}")
    if not target.parent.is_dir():
        raise OutputError(f"{path}: the folder {target.parent} does not exist; make it first")
    if target.suffix == ".zarr":
        if target.exists() and not any((target / name).exists() for name in (".zgroup", "zarr.json")):
            raise OutputError(f"{path}: exists and is not a Zarr store, so it is not replaced; give another name")
    elif target.is_dir():
        raise OutputError(f"{path}: is a folder; give the name of a file")
    # xarray's engine for NetCDF leaves the choice of its own HDF5 library to who installs it.
    if target.suffix == ".nc" and importlib.util.find_spec("h5py") is None:
        raise OutputError(f"{path}: NetCDF needs the package h5py, which is not installed; install it, or write .zarr")
    try:
        with tempfile.TemporaryFile(dir=target.parent):
            pass
    except OSError as reason:
        raise OutputError(f"{path}: cannot be written ({reason.strerror}); give another folder") from None
    return target


def write_dataset(dataset: xarray.Dataset, path: str | Path) -> None:
    """Write a dataset as NetCDF (``.nc``) or Zarr (``.zarr``); whoever looks sees the old one or the whole new one.

    Parameters
    ----------
    dataset : xarray.Dataset
        From `coadjoint.runs.export.dataset_of`.
    path : str or Path
        The target, replaced if it exists.

    Raises
    ------
    OutputError
        As `check_target`.
    OSError
        If the disk is full, for instance; the target is then as it was.

    Examples
    --------
    >>> import tempfile, xarray
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_dataset(xarray.Dataset({"x": ("time", [1.0, 2.0])}), f"{folder}/run.zarr")
    ...     xarray.open_zarr(f"{folder}/run.zarr")["x"].values
    array([1., 2.])
    """
    target = check_target(path)

    def write(temporary: Path) -> None:
        if target.suffix == ".nc":
            dataset.to_netcdf(temporary, engine="h5netcdf")
        else:
            # Format 2: format 3 has no agreed encoding of text, which the names of components are.
            dataset.to_zarr(temporary, mode="w", zarr_format=2, consolidated=True)

    _replace(target, write)


def write_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, PDF or SVG, whole or not at all.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        From `Solution.plot`, for instance.
    path : str or Path
        The target, replaced if it exists.

    Raises
    ------
    OutputError
        As `check_target`.

    Examples
    --------
    >>> import tempfile
    >>> from matplotlib.figure import Figure
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_figure(Figure(), f"{folder}/empty.png")
    """
    _replace(check_target(path, FIGURES), lambda temporary: figure.savefig(temporary))


def _replace(target: Path, write: Callable[[Path], object]) -> None:
    """Write beside the target, on the same disk, and rename."""
    with tempfile.TemporaryDirectory(prefix=f".{target.stem}-", dir=target.parent) as folder:
        temporary = Path(folder) / target.name
        write(temporary)
        if target.is_dir():
            # A folder cannot be renamed over one that is not empty: the old store steps aside, and is deleted with it.
            os.replace(target, Path(folder) / "replaced")
        os.replace(temporary, target)
