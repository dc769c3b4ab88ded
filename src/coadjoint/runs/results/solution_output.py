"""What is computed from solutions: states between points, modified energies, tables, figures, HTML summaries."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.runs.results.quantities import table_of
from coadjoint.runs.results.solution_attributes import SolutionAttributes, Statistics
from coadjoint.short_repr import distinct, html_table
from coadjoint.shortcuts import shortcut

if TYPE_CHECKING:
    import pandas as pd
    import xarray
    from matplotlib.figure import Figure

    from coadjoint.runs.results.solution import Solution

MAX_CASIMIRS_SHOWN = 4
"""Number of Casimirs shown, largest drift first."""


class StateAt(NamedTuple):
    """States at given times, in the shapes of `Solution` at its saved points; without the first axis for a single time.

    Parameters
    ----------
    t : float or ndarray, shape (k,)
        Times.
    x : ndarray, shape (n,) or (k, n), or with an axis of members before the last
        Momentum.
    energy : float or ndarray
        The Hamiltonian.
    casimirs : mapping
        Name -> values.
    attitude : ndarray or None
        Group element, if it was computed.
    """

    t: Any
    x: Any
    energy: Any
    casimirs: Mapping[str, Any]
    attitude: Any

    def __repr__(self) -> str:
        times = f"t = {self.t:g}" if np.ndim(self.t) == 0 else f"{len(self.t)} times"
        parts = {"x": self.x, "energy": self.energy, "casimirs": dict(self.casimirs), "attitude": self.attitude}
        held = ", ".join(f"{name} {_shown(value)}" for name, value in parts.items() if value is not None)
        return f"<states at {times}: {held}>"


def _shown(value: Any) -> str:
    """Format a short value for one line; of a large array, its shape."""
    if isinstance(value, dict):
        return (
            "{"
            + ", ".join(f"{name}: {_shown(entry)}" for name, entry in list(value.items())[:4])
            + (f", and {len(value) - 4} more}}" if len(value) > 4 else "}")
        )
    numbers = np.asarray(value)
    if numbers.size > 8:
        return f"of shape {numbers.shape}"
    return " ".join(np.array2string(numbers, precision=6, separator=", ").split())


class SolutionOutput(SolutionAttributes):
    """Base class of `Solution` with results that other layers compute, conversions, figures and movies."""

    @suggest_keywords
    def at(self, t: Any) -> StateAt:
        """Return the states at any times within the run, as accurate as those at its steps.

        From the saved point before a time, whole steps are recomputed, followed by a partial step of the same scheme.
        So the state has the order and the conservation properties of the scheme, unlike an interpolating polynomial.
        For many times, ``integrate(..., t_eval=times)`` is faster. Members of an ensemble that were ended by events, or
        have not run so far, are NaN after their ends.

        Parameters
        ----------
        t : float or array_like, shape (k,)
            Times within the run, in any order; a time beyond its ends by rounding, as in `integrate`, is that end.

        Returns
        -------
        StateAt
            A named tuple of ``t, x, energy, casimirs, attitude``, with the same shapes as at the saved points; without
            the first axis if t is a single time.

        Raises
        ------
        ValueError
            A time outside the run or after the ends of all members; too many steps from the saved points; a member that
            has failed; a force that is a noise, which is defined for whole steps only.
        IntegrationError
            A step fails.

        Examples
        --------
        >>> import coadjoint as co
        >>> body, x0 = co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1)
        >>> sol = co.integrate(body, x0, (0, 10), 0.1, co.GaussLegendre(3), save_every=20)
        >>> bool(abs(sol.at(3.14159).x - body.exact(x0, 3.14159)).max() < 1e-10)
        True
        >>> sol.at([0.5, 9.99]).energy.shape
        (2,)
        """
        from coadjoint.runs.partial_steps import state_at

        return state_at(cast("Solution", self), t)

    @suggest_keywords
    def spectrum(self) -> NDArray[Any]:
        """Return the eigenvalues of the saved matrices of a `MatrixSystem`, invariants of isospectral schemes.

        Returns
        -------
        ndarray, shape (k, N) or (k, members, N)
            As returned by `MatrixSystem.spectrum`; NaN where a member has failed.

        Raises
        ------
        TypeError
            The states are not matrices.

        Examples
        --------
        >>> import coadjoint as co
        >>> import numpy as np
        >>> s = co.MatrixSystem(co.MatrixAlgebra("gl", 3), lambda W: W.T)
        >>> sol = co.integrate(s, np.diag([1.0, 2.0, 3.0]) + 0.1, t_span=(0, 1), step=0.1)
        >>> bool(abs(sol.spectrum() - sol.spectrum()[0]).max() < 1e-13)
        True
        """
        if not self.system.has_matrices:
            raise TypeError(f"the states of {self.system.name} are no matrices, and have no spectrum")
        axes = 1 if self.failed is None else 2  # of times and members
        finite = np.isfinite(self.x).all(axis=tuple(range(axes, self.x.ndim)))
        values = self.system.unforced.spectrum(self.x[finite])
        spectra = np.full((*finite.shape, values.shape[-1]), np.nan, dtype=values.dtype)
        spectra[finite] = values
        return spectra

    @suggest_keywords
    def modified_energy(self, order: int = 4) -> NDArray[np.float64]:
        """Return the modified Hamiltonian of the scheme and the step of the run, at the saved points.

        The steps are the exact motion of a slightly different system, and this is the energy of that system. It is
        constant up to O(step^order), while `energy` oscillates.

        Parameters
        ----------
        order : int
            Terms below step^order are included; see `coadjoint.modified_hamiltonian`. For a scheme of order 2, order=2
            gives `energy`.

        Returns
        -------
        ndarray, shape (k,) or (k, members)
            As `energy`.

        Raises
        ------
        TypeError, ValueError
            The scheme or the system has no modified Hamiltonian; see `coadjoint.modified_hamiltonian`.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
        >>> sol = co.integrate(body, (1.0, 0.2, 0.1), t_span=(0, 10), step=0.1)
        >>> modified = sol.modified_energy(order=6)
        >>> float(max(abs(modified - modified[0])) / max(abs(sol.energy - sol.energy[0]))) < 1e-4
        True
        """
        modified_hamiltonian = shortcut("modified_hamiltonian")
        h = self.step if self.t_span[1] > self.t_span[0] else -self.step
        if self.system.is_batch:
            hamiltonians = [modified_hamiltonian(member, self.method, order) for member in self.system]
            return np.stack([H(self.x[:, m], h) for m, H in enumerate(hamiltonians)], axis=1)
        return np.asarray(modified_hamiltonian(self.system, self.method, order)(self.x, h))

    @suggest_keywords
    def to_xarray(self, grid: Any = None) -> xarray.Dataset:
        """Return the run as an xarray dataset, with everything needed to repeat it.

        Parameters
        ----------
        grid : (int, int) or bool, optional
            Of a fluid: the numbers of latitudes and longitudes (on the torus, of points along both sides) at which the
            dataset has the vorticity and the velocity; False for none, nor the motion of bodies, True for those of
            ``system.grid()``. By default those of ``system.grid()`` without the velocity, for fields of at most 128 MB,
            where the package that evaluates spherical harmonics is installed.

        Returns
        -------
        xarray.Dataset
            Variables over ``time`` (and ``member``), to be written as NetCDF or Zarr. Runs of fluids have also
            ``vorticity`` over ``latitude`` and ``longitude`` in degrees, or ``eastward`` and ``northward``, relative to
            the rotating sphere, and with ``grid=`` the velocity, ``eastward_velocity`` and ``northward_velocity``; runs
            of two fields ``carried`` as well. Runs of bodies in memory have their
            ``angular_velocity`` and ``angular_momentum`` in the body frame over ``axis``, of several also ``body``, the
            ``quaternion`` (x, y, z, w) of a known attitude, ``wheel_speed`` and ``gimbal_angle``.

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
        return table_of(self)

    @suggest_keywords
    def to_ovf(
        self, path: str | Path, *, cell: Any = None, member: int | None = None, data: str = "binary 8"
    ) -> tuple[Path, ...]:
        """Write the saved states of spins on a rectangular mesh as OVF 2.0, for mumax3, OOMMF, Ubermag and viewers.

        Parameters
        ----------
        path : str or Path
            A folder, made if there is none, for files ``m000000.ovf``, ``m000001.ovf``, ..., one for each saved time;
            files of these names are replaced. Or a name that ends with ``.ovf`` or ``.omf``, for the last state.
        cell : (3,) array_like, optional
            Lengths of the edges of a cell along x, y, z in metres. Models in units of meV have their own.
        member : int, optional
            The member of an ensemble, from 0.
        data : {"binary 8", "binary 4", "text"}
            Numbers of 8 or 4 bytes, or text.

        Returns
        -------
        tuple of Path
            The files. They have directions of the moments: along the states of models with positive g, and opposite to
            other states; zero at vacancies; and the time in seconds, of models in units of meV.

        Raises
        ------
        ValueError, TypeError
            A system without a rectangular mesh of one spin in each cell, lengths given twice or not at all, or an
            ensemble without `member`.
        OutputError
            A file cannot be written.

        See Also
        --------
        coadjoint.spins.read_ovf : Read such a file.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> import coadjoint as co
        >>> film = co.spins.micromagnetic((2, 2, 1), (2e-9, 2e-9, 1e-9), Msat=8e5, Aex=1e-11).field((0, 0, 1.0))
        >>> sol = co.integrate(film, (1.0, 0, 0) * 4, (0, 1), 0.5)
        >>> [file.name for file in sol.to_ovf(pathlib.Path(tempfile.mkdtemp(), "run"))]
        ['m000000.ovf', 'm000001.ovf', 'm000002.ovf']
        """
        written: tuple[Path, ...] = shortcut("ovf_of_run")(self, path, cell, member, data)
        return written

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
        ['second body axis in space']
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
        written: Path = shortcut("save_movie")(path, fps, partial(shortcut("frames_of"), self, picture, frames, size))
        return written


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
    driven = solution._driven or bool(solution.work)
    rows[f"{'change' if driven else 'drift'} of energy"] = f"{energy:.2g}"
    worst = sorted(changes, key=lambda name: -float(changes[name]))
    for name in worst[:MAX_CASIMIRS_SHOWN]:
        rows[f"{'change' if solution.work else 'drift'} of {name}"] = f"{changes[name]:.2g}"
    if len(worst) > MAX_CASIMIRS_SHOWN:
        rows["other Casimirs"] = (
            f"{len(worst) - MAX_CASIMIRS_SHOWN}, none beyond {changes[worst[MAX_CASIMIRS_SHOWN]]:.2g}"
        )
    return html_table(solution._title, rows)
