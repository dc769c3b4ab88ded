"""Example runs of ready-made systems, as declared for the gallery."""

from __future__ import annotations

import importlib

from coadjoint.methods.suggested_scheme import suggested_scheme
from coadjoint.runs.integrate import integrate
from coadjoint.runs.solution import Solution
from coadjoint.systems.registry import telling_of


def telling_run(name: str) -> Solution:
    """Run a ready-made system over the span of its gallery entry, by the suggested scheme.

    Parameters
    ----------
    name : str
        One of ``co.systems.names()``.

    Returns
    -------
    Solution
        ``telling_run(name).plot()`` is its figure in the gallery.

    Raises
    ------
    ValueError
        Unknown system (the message has the nearest name), or a system without a gallery entry.

    Examples
    --------
    >>> telling_run("rigid_body").system.parameters
    {'inertia': (1.0, 2.0, 3.0)}
    """
    systems = importlib.import_module("coadjoint.systems")
    telling = telling_of(name)
    system = systems.get(name, **({} if telling is None else telling.parameters))
    if telling is None:
        raise ValueError(
            f"{name} declares no start, span and step of a run; give @ready_made a Telling, as docs/gallery.md shows"
        )
    return integrate(
        system,
        telling.start(),
        telling.t_span,
        telling.step,
        suggested_scheme(system),
        save_every=telling.save_every,
        attitude=telling.attitude,
    )
