"""Draw the first movie and the first picture of the README: ``python docs/draw_flip.py``."""

from __future__ import annotations

from pathlib import Path

import coadjoint as co

PICTURE = Path(__file__).with_name("intermediate_axis_flip.png")
MOVIE = PICTURE.with_suffix(".gif")


def run() -> co.Solution:
    """Return the run of the lines that the README has."""
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    return co.integrate(body, (0.01, 1.0, 0.01), (0, 90), 0.05, co.Splitting(order=4), attitude=True)


if __name__ == "__main__":
    sol = run()
    sol.plot().savefig(PICTURE, dpi=75)
    sol.movie(MOVIE, frames=300, fps=25, size=(480, 360))
