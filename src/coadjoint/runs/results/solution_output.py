"""Conversions of solutions: tables, rotations, figures and movies, and HTML summaries for notebooks."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.runs.results.body_motion import BodyMotion
from coadjoint.runs.results.solution_attributes import Statistics
from coadjoint.short_repr import distinct, html_table
from coadjoint.shortcuts import shortcut

if TYPE_CHECKING:
    import pandas as pd
    import xarray
    from matplotlib.figure import Figure

    from coadjoint.runs.results.solution import Solution

MAX_CASIMIRS_SHOWN = 4
"""Number of Casimirs shown, largest drift first."""


class SolutionOutput(BodyMotion):
    """Base class of `Solution` with its conversions, figures and movies."""

    @suggest_keywords
    def to_xarray(self, grid: Any = None) -> xarray.Dataset:
        """Return the run as an xarray dataset, with everything needed to repeat it.

        Parameters
        ----------
        grid : (int, int) or bool, optional
            Of a fluid: the numbers of latitudes and longitudes (on the torus, of points along both sides) at which the
            dataset has the vorticity; False for none, nor the motion of bodies, True for those of ``system.grid()``. By
            default True for fields of at most 128 MB, where the package that evaluates spherical harmonics is
            installed.

        Returns
        -------
        xarray.Dataset
            Variables over ``time`` (and ``member``), to be written as NetCDF or Zarr. Runs of fluids have also
            ``vorticity`` over ``latitude`` and ``longitude`` in degrees, or ``eastward`` and ``northward``, relative to
            the rotating sphere; runs of two fields ``carried`` as well. Runs of bodies in memory have their
            ``angular_velocity`` and ``angular_momentum`` in the body frame over ``axis``, of several also ``body``.

        Raises
        ------
        TypeError
            `grid` is a shape, and the system has no vorticity.

        Examples
        --------
        >>> import coadjoint as co
        >>> fluid = co.systems.sphere_euler(N=8)
        >>> sol = co.integrate(fluid, fluid.random(seed=1, degrees=(1, 3)), (0, 1), 0.1)
        >>> sol.to_xarray(grid=(19, 36)).vorticity.sel(latitude=10, longitude=90).sizes
        Frozen({'time': 11})
        """
        return shortcut("dataset_of")(self, grid)

    @suggest_keywords
    def to_pandas(self) -> pd.DataFrame:
        """Return the run as a table: coordinates, energy, Casimirs, and observed numbers over time.

        Returns
        -------
        pandas.DataFrame
            One row for each saved time, with the index ``time``; for an ensemble one for each member and time, with the
            indices ``member`` and ``time``. Columns are the names of the coordinates, ``energy``, and the names of the
            Casimirs and of the observed numbers; a name that occurs twice begins with ``invariant`` or ``observed``.
            Complex entries of matrices remain complex.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
        >>> co.integrate(body, (1.0, 0.2, 0.1), t_span=(0, 1), step=0.5).to_pandas().columns.tolist()
        ['x1', 'x2', 'x3', 'energy', '|x|^2']
        """
        return shortcut("table_of")(self)

    @suggest_keywords
    def plot(
        self,
        panels: Any = None,
        components: Any = None,
        axes: Any = None,
        members: Any = None,
        width: float | None = None,
        style: Any = None,
    ) -> Figure:
        """Plot drift, components, and the pictures that the system declares.

        Lines are drawn only where the motion between the points is known. If the saved points are too far apart, `at`
        computes states between them, at most 10 000 and for about 1.5 s. If that is not enough, dots are drawn. If
        there are more oscillations than a printed line can show, an envelope is drawn.

        Parameters
        ----------
        panels : sequence of str or Picture, optional
            Kinds of pictures, such as ``["drift", "body axis"]``; ``co.plotting.kinds()`` lists them, and
            ``help(co.plotting.kinds()["body axis"])`` explains the options of one, which `Picture` sets. They are drawn
            in this order, column by column; consecutive ones over time are stacked, and share their axis. By default
            the drift, the components, the observed quantities, and the pictures that the system declares. Kinds that
            show a single time, such as ``"spins"``, are shown at the start and at the end.
        components : sequence of int or str, optional
            Coordinates plotted over time, by number from 0 or by name.
        axes : Axes or sequence of Axes, optional
            Existing axes to draw into, one for each panel.
        members : sequence of int, optional
            Members of an ensemble to draw, from 0; at most 20. Their colours are their energies at the start, if these
            differ.
        width : float, optional
            Width of the figure in inches, such as 3.4 for a column of a journal: panels are arranged in as many columns
            as fit, and text is smaller below 5 inches. By default the figure is as wide as its panels need.
        style : str, mapping, or list of these, optional
            Style of Matplotlib for this figure, such as ``"grayscale"`` or ``{"font.family": "serif"}``. Settings in
            Matplotlib's ``rcParams`` that differ from its defaults are used as well.

        Returns
        -------
        matplotlib.figure.Figure
            The figure, neither shown nor saved; ``figure.savefig("figure.pdf")`` writes vector graphics. Its layout is
            computed when it is drawn, also after a change of its size.

        Raises
        ------
        TypeError, ValueError
            Unknown panel or coordinate, with the nearest name; or a panel that this run cannot show, with the reason.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
        >>> sol = co.integrate(body, (0.01, 1.0, 0.01), (0, 40), 0.05, attitude=True)
        >>> [axes.get_title() for axes in sol.plot(["body axis"]).axes]
        ['body axis 2 in space']
        """
        return shortcut("draw_solution")(self, panels, components, axes, members, width, style)

    @suggest_keywords
    def movie(
        self,
        path: str | Path,
        picture: Any = None,
        frames: int = 240,
        fps: float = 24.0,
        size: tuple[int, int] = (960, 540),
    ) -> Path:
        """Write the run as a movie: one picture at the saved times, such as the body in space.

        Parameters
        ----------
        path : str or Path
            ``.gif``, or ``.mp4``, which needs the program ffmpeg.
        picture : str or Picture, optional
            The picture to show, such as ``"phase portrait"`` or ``Picture("vorticity", part="large")``. By default that
            of a single time that the system declares; the body in space for runs with ``attitude=True``; otherwise a
            declared picture, whose paths grow with time, or the components.
        frames : int
            Largest number of frames, from 2 to 5000. They show saved times, evenly spread, and are drawn one by one.
        fps : float
            Frames per second; at most 50 for a GIF.
        size : (int, int)
            Width and height in pixels, even numbers.

        Returns
        -------
        Path

        Raises
        ------
        TypeError, ValueError
            The run cannot show the picture, ffmpeg is missing, or an argument is invalid.

        Examples
        --------
        >>> import coadjoint as co
        >>> import tempfile
        >>> sol = co.integrate(co.systems.rigid_body((1, 2, 3)), (1, 0.2, 0.1), (0, 1), 0.1, attitude=True)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     sol.movie(f"{folder}/body.gif", frames=3, size=(160, 120)).name
        'body.gif'
        """
        target = shortcut("check_movie")(path)
        rate = shortcut("check_speed")(fps, target)
        shortcut("write_movie")(shortcut("frames_of")(self, picture, frames, size), target, rate)
        return target


def is_driven(system: Any) -> bool:
    """Whether the Hamiltonian depends on time; a change of the energy is then not a drift."""
    return bool(getattr(system.of_member(0).hamiltonian, "timed", False))


def extent_text(solution: Solution) -> str:
    """Return the number of saved points and their times, and what cut a run that has not reached its end."""
    t = solution.t
    if not solution.incomplete or not len(t):
        first, reached = distinct(*solution.t_span)
    else:
        first, last, reached = distinct(*solution.t_span, t[-1])
        reached = f"{reached} of {last}"
    text = f"{len(t)} points from t = {first} to {reached}"
    return f"{text}, {solution.incomplete}" if solution.incomplete else text


def _seconds_text(stats: Statistics) -> str:
    """Return the time of the call, and that in the loop, as text."""
    loop = f"{stats.seconds:.3g} s in the loop"
    return loop if math.isnan(stats.elapsed) else f"{stats.elapsed:.3g} s, {loop}"


def table_of_run(solution: Solution) -> str:
    """Return a summary table of a run in HTML."""
    rows: dict[str, Any] = {
        "saved": extent_text(solution),
        "step": f"{solution.step:g}, {solution.stats.steps} of them; {_seconds_text(solution.stats)}",
    }
    if solution.failed is not None:
        count = int(solution.failed.sum())
        rows["members"] = f"{len(solution.failed)}" + (f", of which {count} have failed" if count else "")
    changes = solution.change()
    energy = changes.pop("energy")
    driven = is_driven(solution.system) or bool(solution.work)
    rows[f"{'change' if driven else 'drift'} of energy"] = f"{energy:.2g}"
    worst = sorted(changes, key=lambda name: -float(changes[name]))
    for name in worst[:MAX_CASIMIRS_SHOWN]:
        rows[f"{'change' if solution.work else 'drift'} of {name}"] = f"{changes[name]:.2g}"
    if len(worst) > MAX_CASIMIRS_SHOWN:
        rows["other Casimirs"] = (
            f"{len(worst) - MAX_CASIMIRS_SHOWN}, none beyond {changes[worst[MAX_CASIMIRS_SHOWN]]:.2g}"
        )
    return html_table(f"{solution.system.name} by {solution.method}", rows)
