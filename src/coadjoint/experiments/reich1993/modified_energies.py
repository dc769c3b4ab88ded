"""Section 6 of Reich (1993) as a figure: energy and modified energies along the runs of section 5."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from coadjoint.experiments.reich1993.figures import RESOLUTION
from coadjoint.experiments.reich1993.section5_spiral import spiral_run
from coadjoint.experiments.reich1993.systems import BODY_LATER, BODY_START, CALM_START, COORDINATES
from coadjoint.pictures.modified_energy import draw_deviations
from coadjoint.pictures.style import INK, key
from coadjoint.runs.integrate import integrate
from coadjoint.systems.examples.paper_examples import paper_rigid_body

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ORDERS = (4, 6, 8)
# At the paper's step of 0.1 the body turns by a radian or more per step, too much for the series in h.
STEP = 0.025


def write_modified_energies(folder: Path) -> Path:
    """Draw modified_energies.png in an existing folder and return its path."""
    path = folder / "modified_energies.png"
    modified_energy_figure().savefig(path, dpi=RESOLUTION)
    return path


def modified_energy_figure() -> Figure:
    """Plot the deviation of H and of the modified Hamiltonians of orders 4, 6 and 8 along three runs of the splitting.

    A3,7 as in figure 1; the rigid body near its separatrix at a quarter of the paper's step; the body far from it.
    """
    from matplotlib.figure import Figure

    body = paper_rigid_body()
    runs = {
        "$A_{3,7}^a$ as in figure 1, $h = 0.01$": spiral_run(COORDINATES),
        f"rigid body, $x(0) = (1, 10, 1)$, $h = {STEP:g}$": integrate(
            body, BODY_START, (0.0, BODY_LATER), STEP, COORDINATES
        ),
        f"rigid body, $x(0) = (1, 2, 1/2)$, $h = {STEP:g}$": integrate(
            body, CALM_START, (0.0, BODY_LATER), STEP, COORDINATES
        ),
    }
    figure = Figure(figsize=(12.0, 4.2), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    for axes, (title, run) in zip(panels, runs.items(), strict=True):
        draw_deviations(axes, run, ORDERS)
        axes.set_title(title, fontsize=9.5, color=INK)
        axes.set(ylim=(1e-18, 1e1))
        axes.label_outer()
    key(panels[0])
    figure.suptitle(
        "Section 6. The Lie-Poisson integrator solves a nearby system: energy $H$ and modified energies $\\tilde H$",
        fontsize=9.5,
        color=INK,
    )
    return figure
