"""Runs that take longer than a gallery of everything may: drawn when they are named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from coadjoint.systems.telling import Picture

if TYPE_CHECKING:
    from coadjoint.runs.solution import Solution


@dataclass(frozen=True)
class Scene:
    """A run and its pictures.

    Parameters
    ----------
    run : callable
        Returns the solution.
    pictures : tuple of Picture
        What of it is drawn.
    summary, says : str
        What is run, and what is to be seen.
    """

    run: Callable[[], Solution]
    pictures: tuple[Picture, ...]
    summary: str
    says: str


def decaying_turbulence(N: int = 128, seed: int = 1, end: float = 100.0, step: float = 0.0125) -> Solution:
    """Run a random vorticity on the sphere, of the degrees 3 to 8, until few vortices are left.

    It has a root mean square of 1.

    Parameters
    ----------
    N : int
        Size of the matrices.
    seed : int
        Of the random field.
    end : float
        The time at the end; a fluid of vorticity 1 turns about itself once in 4 pi.
    step : float
        Of the isospectral midpoint rule.

    Returns
    -------
    Solution
        With a state for each unit of time.

    Examples
    --------
    >>> decaying_turbulence(N=12, end=2.0, step=0.1).x.shape
    (3, 12, 12)
    """
    from coadjoint.runs.integrate import integrate
    from coadjoint.systems.sphere_euler import sphere_euler

    s = sphere_euler(N)
    return integrate(
        s,  # type: ignore[arg-type]
        s.random(seed, degrees=(3, 8)),
        (0.0, end),
        step,
        save_every=max(1, round(1.0 / step)),
    )


SCENES = {
    "decaying_turbulence": Scene(
        run=decaying_turbulence,
        pictures=tuple(
            Picture("vorticity", at=at, part=part, limit=3.0) for at in (0.0, 0.2, 1.0) for part in ("all", "large")
        ),
        summary="Decaying turbulence of an ideal fluid on the sphere, from random vorticity of the degrees 3 to 8, "
        "seed 1: one to three minutes.",
        says="Vortices of like sign merge, and two of each sign are left, which keep moving. Above, the vorticity, "
        "which is stretched into filaments and fine structure. Below, its large-scale part, which is constant along "
        "streamlines.",
    )
}
"""By name."""
