"""A run in one figure: drift of its invariants, its components, and in three dimensions its orbit."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from coadjoint.extras import need
from coadjoint.pictures.orbit import draw_orbit
from coadjoint.pictures.style import colour, key, plain_axes, symbol
from coadjoint.runs.solution import check_solution
from coadjoint.systems.batch import Batch

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from coadjoint.runs.solution import Solution

MOST_COMPONENTS = 8
MOST_MEMBERS = 20
MOST_POINTS = 20_000  # more than a printed line can show


def draw_solution(solution: Solution) -> Figure:
    """Return a figure of a run: drift, components, and for three coordinates the orbit on its coadjoint orbit.

    Parameters
    ----------
    solution : Solution
        One run or an ensemble. Of many members 20 are drawn, and of many coordinates 8, spread evenly; the figure says
        so.

    Returns
    -------
    matplotlib.figure.Figure
        Neither shown nor saved; ``figure.savefig("run.png")`` does that.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 10), step=0.1)
    >>> [axes.get_ylabel() for axes in draw_solution(sol).axes[:2]]
    ['absolute deviation from start', 'momentum $x_i$']
    """
    check_solution(solution)
    need("drawing a solution", "matplotlib")
    from matplotlib.figure import Figure

    drawn = _thinned(solution)
    spatial = drawn.x.shape[-1] == 3
    figure = Figure(figsize=(11.0, 5.6) if spatial else (7.2, 5.8), layout="constrained")
    grid = figure.add_gridspec(2, 2 if spatial else 1, width_ratios=[1.0, 1.0] if spatial else None)
    drift, components = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, 0])
    _draw_drift(drift, drawn)
    _draw_components(components, drawn)
    components.sharex(drift)
    drift.tick_params(labelbottom=False)
    if spatial:
        # The surface is that of the first member, which is always drawn.
        first = solution.system[0] if isinstance(solution.system, Batch) else solution.system
        draw_orbit(figure.add_subplot(grid[:, 1], projection="3d"), drawn.x, first.casimirs)
    figure.suptitle(_headline(solution, drawn), fontsize=10.5)
    return figure


class _thinned:
    """What is drawn: times (k,), states (members, k, n) and invariants (members, k), thinned to at most so many."""

    def __init__(self, solution: Solution) -> None:
        every = max(1, -(-len(solution.t) // MOST_POINTS))
        keep = np.unique(np.append(np.arange(0, len(solution.t), every), len(solution.t) - 1))
        x = solution.x[:, None] if solution.x.ndim == 2 else solution.x
        self.of_members, self.of_components = x.shape[1], x.shape[2]
        members = _spread(x.shape[1], MOST_MEMBERS)
        self.t, self.forced = solution.t[keep], bool(solution.work)
        self.x = np.swapaxes(x[np.ix_(keep, members)], 0, 1)

        def series(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
            return values.reshape(len(values), -1)[np.ix_(keep, members)].T

        self.invariants = {
            name: series(values) for name, values in {"energy": solution.energy, **solution.casimirs}.items()
        }


def _spread(count: int, most: int) -> npt.NDArray[np.int64]:
    """Return at most so many of 0 ... count - 1, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


def _draw_drift(axes: Any, drawn: _thinned) -> None:
    shown = False
    several = len(drawn.x) > 1
    for i, (name, members) in enumerate(drawn.invariants.items()):
        for m, values in enumerate(members):
            deviation = np.abs(values - values[0])
            shown |= bool(np.any(deviation > 0.0))
            # Zero has no logarithm: the line has gaps where nothing has changed in any bit.
            visible = np.where(deviation > 0.0, deviation, np.nan)
            label = symbol(name) if m == 0 else None
            width, strength = (0.5, 0.5) if several else (0.9, 1.0)
            axes.plot(drawn.t, visible, color=colour(i), linewidth=width, alpha=strength, label=label)
    axes.set(yscale="log", ylabel="absolute deviation from start")
    what = (
        "change of the energy $H$ and the Casimirs, with forces"
        if drawn.forced
        else "drift of the energy $H$ and the Casimirs"
    )
    axes.set_title(f"{what}, at the saved points")
    if not shown:
        axes.text(0.5, 0.5, "no deviation in any bit", transform=axes.transAxes, ha="center", fontsize=9)
    plain_axes(axes)
    key(axes, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _draw_components(axes: Any, drawn: _thinned) -> None:
    chosen = _spread(drawn.of_components, MOST_COMPONENTS)
    several = len(drawn.x) > 1
    for place, i in enumerate(chosen):
        for m, orbit in enumerate(drawn.x):
            label = f"$x_{{{i + 1}}}$" if m == 0 else None
            width, strength = (0.5, 0.5) if several else (0.9, 1.0)
            axes.plot(drawn.t, orbit[:, i], color=colour(place), linewidth=width, alpha=strength, label=label)
    title = "components of the momentum"
    if len(chosen) < drawn.of_components:
        title += f" ({len(chosen)} of {drawn.of_components})"
    axes.set(xlabel="time $t$", ylabel="momentum $x_i$", title=title)
    plain_axes(axes)
    key(axes, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _headline(solution: Solution, drawn: _thinned) -> str:
    parts = [solution.system.name, str(solution.method), f"step {solution.step:g}"]
    if len(drawn.x) < drawn.of_members:
        parts.append(f"{len(drawn.x)} of {drawn.of_members} members")
    elif drawn.of_members > 1:
        parts.append(f"{drawn.of_members} members")
    text = ",  ".join(parts).replace("$", r"\$")
    return "\n".join(textwrap.wrap(text, 110 if drawn.of_components == 3 else 75))
