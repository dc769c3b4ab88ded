"""Draw `docs/steady_flows.png`, which takes a minute: ``python docs/draw_steady_flows.py``."""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import coadjoint as co

PICTURE = Path(__file__).with_name("steady_flows.png")

if __name__ == "__main__":
    mpl.use("agg")
    s = co.systems.sphere_euler(N=32)
    W = s.random(seed=3, degrees=(2, 6))
    decaying = s.with_forces(co.forces.SelectiveDecay(2.0))
    sol = co.integrate(decaying, W, t_span=(0, 200), step=0.05, method=co.IsospectralGauss(), save_every=400)
    steady = co.equilibrium(s, W, relax="up")
    panels = [("start", W), ("selective decay: the energy of the start", sol.x[-1])]
    panels += [("the largest energy: the levels of the start", steady.x)]
    figure = Figure(figsize=(13.0, 2.6), layout="constrained")
    latitudes, longitudes = s.grid((91, 181))
    for number, (title, state) in enumerate(panels, 1):
        axes = figure.add_subplot(1, 3, number, projection="mollweide")
        values = s.to_grid(state, (91, 181))
        drawn = axes.pcolormesh(
            longitudes - np.pi, latitudes, values, vmin=-3.0, vmax=3.0, cmap="RdBu_r", shading="gouraud"
        )
        energy, enstrophy = s.energy(state), s.enstrophy_spectrum(state)[1].sum()
        axes.set_title(f"{title}\nenergy {energy:.3f}, enstrophy {enstrophy:.3f}", fontsize=10)
        axes.set_xticks([])
        axes.set_yticks([])
    figure.colorbar(drawn, ax=figure.axes, label="vorticity", shrink=0.8)
    stored = io.BytesIO()
    figure.savefig(stored, format="png", dpi=75)
    Image.open(stored).convert("RGB").quantize(256).save(PICTURE, optimize=True)
    P = s.stream_of(sol.x[-1])
    print(steady, sol.work["SelectiveDecay"]["energy"][-1], np.abs(P @ sol.x[-1] - sol.x[-1] @ P).max())
