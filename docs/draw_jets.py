"""Draw `docs/jets.png`, jets of a planet, from runs of twenty minutes in all: ``python docs/draw_jets.py FOLDER``.

The folder has an archive of each run, from which a run that was interrupted continues.
"""

from __future__ import annotations

import io
import runpy
import sys
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

HERE = Path(__file__).parent
PICTURE = HERE / "jets.png"
EXAMPLE = runpy.run_path(str(HERE.parent / "examples" / "planetary_jets.py"))
RUNS = {"decaying": (256, 96), "forced": (256, 64)}
"""N with a deformation radius, and without, where waves are faster and need short steps."""


def run(folder: Path, kind: str, N: int, lamb: float | None = None) -> Any:
    """Return a run of the example, by its archive in a folder."""
    name = f"{kind}_{N}.zarr" if lamb is None else f"{kind}_{N}_{lamb:g}.zarr"
    return EXAMPLE["simulate"](N, kind == "forced", lamb, archive=folder / name)


def draw(folder: Path) -> plt.Figure:
    """Return the last relative vorticities, and mean eastward speeds by latitude, also without a deformation radius."""
    figure, panels = plt.subplots(2, 2, figsize=(12, 7), layout="constrained", width_ratios=(2.1, 1))
    for (kind, (N, of_others)), (map_panel, profile) in zip(RUNS.items(), panels, strict=True):
        sol, others = run(folder, kind, N), run(folder, kind, of_others, 0.0)
        s = sol.system
        field = s.to_grid(sol.x[-1], (361, 720))
        limit = 3.0 * field.std()
        image = map_panel.imshow(field, extent=(0, 360, -90, 90), vmin=-limit, vmax=limit, cmap="RdBu_r", aspect="auto")
        figure.colorbar(image, ax=map_panel, label="relative vorticity", shrink=0.9)
        map_panel.set(title=f"{kind}, N = {N}, t = {sol.t[-1]:g}", xticks=range(0, 361, 60), yticks=range(-90, 91, 30))
        map_panel.set(xlabel="longitude", ylabel="latitude")
        for one, style, label in ((others, "0.65", "$\\lambda = 0$"), (sol, "C0", f"$\\lambda = {s.lamb:g}$")):
            latitude, speed = EXAMPLE["zonal_speed"](one)
            profile.plot(speed, np.degrees(latitude), color=style, label=label, lw=1.4)
            print(kind, label, np.round(EXAMPLE["by_band"](latitude, speed), 3), one.method, one.step)
        profile.axvline(0.0, color="k", lw=0.6)
        profile.set(
            title="mean eastward speed", ylim=(-90, 90), yticks=range(-90, 91, 30), xlabel="radii per unit of time"
        )
        profile.legend(loc="upper right")
    return figure


if __name__ == "__main__":
    drawn = io.BytesIO()
    draw(Path(sys.argv[1])).savefig(drawn, format="png", dpi=80)
    Image.open(drawn).convert("RGB").quantize(256).save(PICTURE, optimize=True)
