"""Long example runs, which the gallery draws only by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from coadjoint.systems.gallery_entry import Picture

if TYPE_CHECKING:
    from coadjoint.runs.solution import Solution


@dataclass(frozen=True)
class Scene:
    """A run, as a function that returns its solution, with its pictures, summary and caption `says`."""

    run: Callable[[], Solution]
    pictures: tuple[Picture, ...]
    summary: str
    caption: str


def decaying_turbulence(N: int = 128, seed: int = 1, end: float = 100.0, step: float = 0.0125) -> Solution:
    """Integrate a random vorticity on the sphere, of the degrees 3 to 8, until few vortices are left.

    Its root mean square is 1, and the fluid rotates about itself once in 4 pi. The solution has a state per unit of
    time; `step` is that of the isospectral midpoint rule.
    """
    from coadjoint.runs.integrate import integrate
    from coadjoint.systems.fluids.sphere_euler import sphere_euler

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
        caption="Vortices of like sign merge, and two of each sign are left, which keep moving. Above, the vorticity, "
        "which is stretched into filaments and fine structure. Below, its large-scale part, which is constant along "
        "streamlines.",
    )
}
"""Scenes by name."""
