"""Runs of every kind, and every way to store and read one."""

from __future__ import annotations

import itertools
import os
import pickle
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

import coadjoint as co

BODY, X = co.systems.rigid_body(inertia=(1, 2, 3)), (0.3, -1.0, 0.7)
STEP, T0 = 0.125, 7.25
Arguments = dict[str, Any]

STARTS = np.array([[1.0, 0.2, 0.5], [0.4, 0.1, 1.1], [1.3, -0.3, 0.2]])
INERTIAS = ((1.0, 2.0, 3.0), (1.0, 2.0, 2.5), (1.5, 2.0, 3.25))
FLUID, SPIRAL = co.systems.torus_euler(N=3), co.systems.paper_a37()
PRODUCT, SQUARE = co.Polynomial({(1, 1, 0): 2.0}), co.Polynomial({(0, 0, 2): 1.0, (0, 0, 0): -0.5})
FORCES = (co.forces.LinearDamping((0.1, 0.2, 0.3)), co.forces.Torque((0.0, 0.05, 0.1)))


# A table of other parts: such members of a batch are run after the others.
PLATE = co.systems.rigid_body(inertia=(1, 1, 2))


def third(x: Any) -> Any:
    return x[..., 2]


def bodies(*forces: Any) -> Any:
    """Return a batch of bodies that differ."""
    plain = [co.systems.rigid_body(inertia) for inertia in INERTIAS]
    return co.batch([body.with_forces(*forces) for body in plain] if forces else plain)


def arguments(system: Any, x0: Any, sense: int, method: Any = None, **options: Any) -> Arguments:
    """Return arguments of `integrate` for 31 steps from T0, forward or backward."""
    span = (T0, T0 + 31 * sense * STEP)
    return {"system": system, "x0": x0, "t_span": span, "step": STEP, "method": method, "save_every": 3, **options}


STIRRED = bodies(co.forces.HeatBath(0.3, temperature=0.5, seed=4))
RUNS: dict[str, Arguments] = {
    "one body": arguments(BODY.with_forces(*FORCES), STARTS[1], 1, co.GaussLegendre(2), observe={"q": PRODUCT}),
    "top": arguments(co.systems.heavy_top(), np.array([0.1, 0.3, 2.0, 0.6, 0.0, 0.8]), -1, attitude=True),
    "one matrix": arguments(FLUID, FLUID.random(seed=1, degrees=(1, 1)), 1, co.IsospectralGauss(1), watch=False),
    "members": arguments(BODY, STARTS, -1, co.Splitting(order=4), attitude=True, observe={"x3": third, "q": PRODUCT}),
    "batch": arguments(bodies(), STARTS, -1, attitude="coadjoint"),
    "interleaved batch": arguments(
        co.batch([(BODY, PLATE)[m % 2] for m in range(5)]), np.array([*STARTS, *(2.0 * STARTS[:2])]), 1, co.Splitting()
    ),
    "batch of one state": arguments(bodies(), STARTS[0], 1, co.Taylor(order=8), watch=False),
    "batch with forces": arguments(bodies(*FORCES), STARTS, 1, co.GaussLegendre(1)),
    "batch with forces at substeps": arguments(bodies(*FORCES), STARTS, -1, co.Splitting(order=4), attitude=True),
    "batch with noise": arguments(STIRRED, STARTS, 1, save_every=1),
    "spirals": arguments(SPIRAL, abs(STARTS) + 0.1, 1, co.GaussLegendre(2), attitude="coadjoint"),
    "matrices": arguments(FLUID, np.array([FLUID.random(seed=k, degrees=(1, 1)) for k in range(3)]), -1),
    "own steps": arguments(BODY, STARTS, 1, co.Taylor(order=8, tolerance=1e-9)),
    "one body with events": arguments(
        BODY.with_forces(*FORCES),
        STARTS[1],
        -1,
        co.GaussLegendre(2),
        attitude=True,
        events=[co.Event("x2"), co.Event("x1", terminal=True)],
    ),
    "members with events": arguments(
        BODY,
        2.0 * STARTS,
        -1,
        co.Splitting(order=4),
        attitude=True,
        events=[co.Event(PRODUCT), co.Event("x3", terminal=True, direction=-1), co.Event("x2", count=1)],
    ),
    "interleaved batch with events": arguments(
        co.batch([(BODY, PLATE)[m % 2] for m in range(5)]),
        np.array([*STARTS, *(2.0 * STARTS[:2])]),
        1,
        co.Splitting(),
        events=[co.Event("x1", terminal=True), co.Event("x2"), co.Event(SQUARE)],
    ),
    "start left out": arguments(bodies(), STARTS, 1, save_every=1, t_eval=T0 + np.array([1.01, 2.5, 3.875])),
}
FUNCTIONS = {"members": {"observe": RUNS["members"]["observe"]}}
"""What is not stored, and must be given to `resume`."""
SINGLE = ("one body", "top", "one matrix", "one body with events")


@cache
def run(name: str) -> co.Solution:
    """Return a run in memory."""
    return co.integrate(**RUNS[name])


def by_netcdf(name: str, folder: Path) -> co.Solution:
    run(name).to_xarray().to_netcdf(folder / "run.nc", engine="h5netcdf")
    return co.load(folder / "run.nc")


def by_zarr(name: str, folder: Path) -> co.Solution:
    run(name).to_xarray().to_zarr(folder / "run.zarr", consolidated=True)
    return co.load(folder / "run.zarr")


def by_archive(name: str, folder: Path) -> co.Solution:
    co.integrate(**RUNS[name], archive=folder / "run.zarr")
    shutil.move(folder / "run.zarr", folder / "moved.zarr")
    return co.open_archive(folder / "moved.zarr")


def by_copy_of_archive(name: str, folder: Path) -> co.Solution:
    co.integrate(**RUNS[name], archive=folder / "run.zarr")
    with xarray.open_zarr(folder / "run.zarr", chunks=None) as opened:
        opened.to_zarr(folder / "copy.zarr")
    return co.load(folder / "copy.zarr")


def by_pieces(name: str, folder: Path) -> co.Solution:
    """Extend a run of few steps, interrupted twice, to its end; steps 5 to 14 lie in several tenths of 31."""
    (t0, end), path, given = RUNS[name]["t_span"], folder / "run.zarr", FUNCTIONS.get(name, {})
    sense = np.sign(end - t0)
    co.integrate(**{**RUNS[name], "t_span": (t0, t0 + 2 * sense * STEP)}, archive=path)
    for steps, until in ((17, 4), (None, 5), (None, None), (31, 22), (None, None)):
        t_end = None if steps is None else t0 + steps * sense * STEP
        found = co.resume(path, t_end, until=until, **given)
    return found


def by_ensemble(name: str, folder: Path) -> co.Solution:
    co.integrate_ensemble(**RUNS[name], archive=folder / "run.zarr", members_per_block=2)
    return co.open_archive(folder / "run.zarr")


def by_workers(name: str, folder: Path) -> co.Solution:
    """On workers in threads of this process."""
    from distributed import Client

    with Client(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=":0") as client:
        return co.integrate_ensemble(**RUNS[name], archive=folder / "run.zarr", members_per_block=1, client=client)


STORES: dict[str, Callable[[str, Path], co.Solution]] = {
    "netcdf": by_netcdf,
    "zarr": by_zarr,
    "archive": by_archive,
    "copy of an archive": by_copy_of_archive,
    "pieces": by_pieces,
    "ensemble": by_ensemble,
    "workers": by_workers,
    "pickle": lambda name, folder: pickle.loads(pickle.dumps(run(name))),
    "rebuilt": lambda name, folder: co.results.rebuild(run(name).to_xarray()),
}
NO_OUTPUT_TIMES = ("archive", "copy of an archive", "pieces", "ensemble", "workers")
MEMBERS_ONLY = ("ensemble", "workers")
PAIRS = [
    (store, name)
    for store in STORES
    for name in RUNS
    if not ((name == "start left out" and store in NO_OUTPUT_TIMES) or (name in SINGLE and store in MEMBERS_ONLY))
    and not ("events" in RUNS[name] and store == "copy of an archive")
]


def cut(path: Path, system: Any = BODY, x0: Any = X, until: int = 5, steps: int = 16, **options: Any) -> co.Solution:
    """Return an archive whose run has taken 5 of 16 steps from zero."""
    given = {"method": co.GaussLegendre(2), "save_every": 2, **options}
    again = {} if "observe" not in given else {"observe": given["observe"]}
    co.integrate(system, x0, (0.0, 2 * STEP), STEP, archive=path, **given)
    return co.resume(path, steps * STEP, system=system, until=until, **again)


def whole(system: Any = BODY, x0: Any = X, steps: int = 16, **options: Any) -> co.Solution:
    """Return the run of `cut` to its end, in memory."""
    given = {"method": co.GaussLegendre(2), "save_every": 2, **options}
    return co.integrate(system, x0, (0.0, steps * STEP), STEP, **given)


@contextmanager
def at_write(
    wanted: Callable[[str], bool], count: int, act: Callable[[], Any], *, after: bool = False
) -> Iterator[list[str]]:
    """Do something before or after the `count`-th write of a wanted file; yield the names of all that were written."""
    numbers, written = itertools.count(1), list[str]()

    def watched(move: Callable[..., None]) -> Callable[..., None]:
        def moved(source: Any, target: Any, **folders: Any) -> None:
            name = os.path.basename(target)
            now = wanted(name) and next(numbers) == count
            if now and not after:
                act()
            move(source, target, **folders)
            written.append(name)
            if now and after:
                act()

        return moved

    with pytest.MonkeyPatch.context() as patched:
        for function in ("replace", "rename"):
            patched.setattr(os, function, watched(getattr(os, function)))
        yield written


def raising(error: BaseException | type[BaseException]) -> Callable[[], None]:
    def act() -> None:
        raise error

    return act


def contents(folder: Path) -> dict[Path, bytes]:
    """Return the content of every file in a folder."""
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
