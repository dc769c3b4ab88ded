"""Poincare sections of ensembles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.events import MAX_CROSSINGS, Event, RecordedEvents
from coadjoint.runs.integrate import integrate
from coadjoint.runs.results.solution_attributes import member_count
from coadjoint.runs.short_runs import ENDS_ONLY
from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch
from coadjoint.systems.system import System
from coadjoint.validation import read_integer

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Section:
    """Crossings of a surface by the members of an ensemble, c at most for each.

    Attributes
    ----------
    events : RecordedEvents
        All crossings, member after member.
    counts : ndarray of int, shape (members,)
        Number of crossings of each member.
    t : ndarray, shape (members, c)
        Times, padded with NaN for members with fewer crossings.
    x : ndarray, shape (members, c, n)
        States, padded with NaN.

    Notes
    -----
    Returned by `poincare_section`. The arrays t and x are computed on each access.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> found = co.poincare_section(body, [(0.1, 1.0, 0.1), (0.2, 1.0, 0.1)], co.Event("x2", 1), (0, 100), 0.1)
    >>> found.counts, found.x.shape
    (array([2, 3]), (2, 3, 3))
    """

    def __init__(self, events: RecordedEvents, members: int) -> None:
        self.events = events
        self.counts: NDArray[np.int64] = np.bincount(events.member, minlength=members)

    def __repr__(self) -> str:
        return f"<section: {len(self.events)} crossings of {self.events.names[0]} by {len(self.counts)} members>"

    @property
    def t(self) -> NDArray[np.float64]:
        """Times of the crossings, (members, c), padded with NaN."""
        return self._padded(self.events.t)

    @property
    def x(self) -> NDArray[Any]:
        """States at the crossings, (members, c, n), padded with NaN."""
        return self._padded(self.events.x)

    def _padded(self, values: NDArray[Any]) -> NDArray[Any]:
        counts, member = self.counts, self.events.member
        padded = np.full((len(counts), counts.max(initial=0), *values.shape[1:]), np.nan, dtype=values.dtype)
        padded[member, np.arange(len(member)) - (np.cumsum(counts) - counts)[member]] = values
        return padded

    def plot(self, components: Any = None, axes: Any = None) -> Figure:
        """Plot two components of the states at the crossings, with one colour for each member.

        Parameters
        ----------
        components : (int or str, int or str), optional
            Components on the horizontal and the vertical axis; by default the two that vary most.
        axes : Axes, optional
            Existing axes to draw into.

        Returns
        -------
        matplotlib.figure.Figure
            The figure, neither shown nor saved.
        """
        return self.events.plot(components, axes)


@suggest_keywords
def poincare_section(
    system: System | Batch,
    x0s: Any,
    event: Event,
    t_span: tuple[float, float],
    step: float | None = None,
    method: Method | str | Mapping[str, Any] | None = None,
    *,
    crossings: int | None = None,
    accuracy: float | None = None,
    threads: int | None = None,
    progress: bool = False,
) -> Section:
    """Return the points where motions cross a surface: a Poincare section of an ensemble.

    Nothing but the crossings is saved or watched, so that millions of crossings take seconds.

    Parameters
    ----------
    system : System or Batch
        The system.
    x0s : array_like, shape (members, n) or (n,)
        Initial momenta. A start on the surface is no crossing.
    event : Event
        The surface g = 0, and the direction in which it is crossed.
    t_span : (float, float)
        Start and end of the search for crossings, a whole number of steps apart.
    step, method, accuracy
        As for `integrate`.
    crossings : int, optional
        Number of crossings at which a member ends; None finds all crossings within `t_span`.
    threads : int, optional
        Number of threads for the members. The default is one for each core.
    progress : bool
        Show a progress bar.

    Returns
    -------
    Section

    Raises
    ------
    ValueError, TypeError
        For wrong input, before the first step.
    IntegrationError
        As in `integrate`.

    Examples
    --------
    >>> import coadjoint as co
    >>> import numpy as np
    >>> top = co.systems.kovalevskaya_top()
    >>> starts = np.array([[x, 0.3, 0.5, 0.0, 0.6, 0.8] for x in (0.2, 0.4, 0.6)])
    >>> upward, method = co.Event(1, direction=1), co.Splitting(order=4)
    >>> found = co.poincare_section(top, starts, upward, (0, 1000), 0.1, method, crossings=20)
    >>> found.x.shape, bool(abs(found.x[..., 1]).max() < 1e-15)
    ((3, 20, 6), True)
    """
    if not isinstance(event, Event):
        raise TypeError(f"event is {short(event)}; give an Event, such as co.Event('x1', direction=1)")
    if crossings is not None:
        event = replace(event, count=read_integer(crossings, "crossings", 1, MAX_CROSSINGS), terminal=True)
    options: Any = {"accuracy": accuracy, "threads": threads, "progress": progress, "events": event}
    sol = integrate(system, x0s, t_span, step, method, save_every=ENDS_ONLY, watch=False, **options)
    assert sol.events is not None
    return Section(sol.events, member_count(sol))
