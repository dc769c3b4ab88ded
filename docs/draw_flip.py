"""Draw `docs/intermediate_axis_flip.png`, the first picture of the README: ``python docs/draw_flip.py``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import coadjoint as co

PICTURE = Path(__file__).with_name("intermediate_axis_flip.png")


def draw() -> Any:
    """Return the figure, by the lines that the README has."""
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    sol = co.integrate(body, (0.01, 1.0, 0.01), (0, 90), 0.05, co.Splitting(order=4), attitude=True)
    return sol.plot()


if __name__ == "__main__":
    draw().savefig(PICTURE, dpi=75)
