"""Example runs of ready-made systems, as declared for the gallery."""

from __future__ import annotations

import importlib

from coadjoint.methods.suggested_scheme import suggested_scheme
from coadjoint.runs.integrate import integrate
from coadjoint.runs.results.solution import Solution
from coadjoint.systems.registry import gallery_entry_of


def run_example(name: str) -> Solution:
    """Run a ready-made system over the span of its gallery entry, by the suggested scheme.

    Parameters
    ----------
    name : str
        One of ``co.systems.names()``.

    Returns
    -------
    Solution
        ``run_example(name).plot()`` is its figure in the gallery.

    Raises
    ------
    ValueError
        Unknown system (the message has the nearest name), or a system without a gallery entry.

    Examples
    --------
    >>> run_example("rigid_body").system.parameters
    {'inertia': (1.0, 2.0, 3.0)}
    """
    systems = importlib.import_module("coadjoint.systems")
    gallery_entry = gallery_entry_of(name)
    system = systems.get(name, **({} if gallery_entry is None else gallery_entry.parameters))
    if gallery_entry is None:
        raise ValueError(
            f"{name} declares no start, span and step of a run; give @ready_made a GalleryEntry, as docs/gallery.md "
            "shows"
        )
    return integrate(
        system,
        gallery_entry.start(),
        gallery_entry.t_span,
        gallery_entry.step,
        suggested_scheme(system),
        save_every=gallery_entry.save_every,
        attitude=gallery_entry.attitude,
    )
