"""Draw `docs/checkcases.png`, the errors of semi-implicit Euler steps: ``python docs/draw_checkcase.py``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import coadjoint as co
from coadjoint.checkcases.emulated_schemes import emulated_runs

STEP = 0.001  # s
LABEL = "semi-implicit Euler steps, rotations by the new rates"


def draw() -> None:
    """Write the picture."""
    case = co.checkcases.get("free_body", end=10.0)
    assert case.body is not None
    times = np.linspace(0.0, case.end, 501)
    runs = {label: columns for label, _, _, columns in emulated_runs(case.body, STEP, times)}
    figure = case.compare({"t": times, **runs[LABEL]}).plot()
    figure.savefig(Path(__file__).with_name("checkcases.png"), dpi=110)


if __name__ == "__main__":
    draw()
