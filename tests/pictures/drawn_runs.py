"""Data of runs without integration, and the axes of one picture, for tests that read artists back."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import coadjoint as co
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import kinds
from coadjoint.runs.results.drift import scales_of_invariants

T0 = 7.3
SENSES = [1.0, -1.0]
BODY = co.systems.rigid_body((1.0, 2.0, 3.0))
SPIN = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0, linear=[0, 0, 1.0]))
BARE = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.7]), casimirs={})


def made(t: np.ndarray, x: np.ndarray, system: Any = BODY, **series: Any) -> Any:
    """Return the data of a run, of members if x is (k, members, n)."""
    failed = np.zeros(x.shape[1], dtype=bool) if x.ndim > 2 else None
    empty = {
        "energy": np.zeros(x.shape[: x.ndim - 1]),
        "failed": failed,
        "casimirs": {},
        "work": {},
        "observed": {},
        "events": None,
        "carried": None,
        "attitude": None,
    }
    fields = {**empty, **series}
    invariants = {"energy": fields["energy"], **fields["casimirs"]}
    start = {"x0": x[0], "t_span": (t[0], t[-1]), "initial": {name: values[0] for name, values in invariants.items()}}
    return SimpleNamespace(t=t, x=x, system=system, incomplete=None, **{**start, **fields})


def sizes_of(run: Any) -> dict[str, np.ndarray]:
    """Return the sizes of the invariants at the first point, to which deviations are relative, by member."""
    series = {"energy": run.energy, **run.casimirs}
    sizes = scales_of_invariants(run.system, run.x[0], {name: values[0] for name, values in series.items()})
    return {name: np.atleast_1d(size) for name, size in sizes.items()}


def axes_of(run: Any, name: str, members: Any = None, **options: Any) -> Any:
    """Return the axes of one picture of a run."""
    axes = Figure().add_subplot(projection=kinds()[name].projection)
    kinds()[name].prepare(PlottedRun(run, members), **options)(axes)
    return axes


def shown(run: Any, picture: Any, members: Any = None) -> Any:
    """Return the axes of one picture as `plot` draws it, without the time of a layout."""
    kind = kinds()[picture if isinstance(picture, str) else picture.kind]
    axes = Figure().add_subplot(projection=kind.projection)
    run.plot([picture], axes=axes, members=members)
    return axes


def data(line: Any) -> np.ndarray:
    return np.asarray(line.get_data(), dtype=np.float64)
