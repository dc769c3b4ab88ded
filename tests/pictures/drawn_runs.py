"""Data of runs without integration, and the axes of one picture, for tests that read artists back."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import kinds


def made(t: np.ndarray, x: np.ndarray, system: Any, **series: Any) -> Any:
    """Return the data of a run, of members if x is (k, members, n)."""
    failed = np.zeros(x.shape[1], dtype=bool) if x.ndim > 2 else None
    empty = {"casimirs": {}, "work": {}, "observed": {}, "events": None, "carried": None, "attitude": None}
    return SimpleNamespace(t=t, x=x, system=system, failed=failed, **{**empty, **series})


def axes_of(run: Any, name: str, members: Any = None, **options: Any) -> Any:
    """Return the axes of one picture of a run."""
    axes = Figure().add_subplot(projection=kinds()[name].projection)
    kinds()[name].prepare(PlottedRun(run, members), **options)(axes)
    return axes
