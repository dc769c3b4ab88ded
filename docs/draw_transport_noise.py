"""Draw `docs/transport_noise.png`, a fluid with transport noise: ``python docs/draw_transport_noise.py``."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import coadjoint as co

PICTURE = Path(__file__).with_name("transport_noise.png")
N, PATHS = 32, 300


def draw() -> plt.Figure:
    """Return the start, one path, the mean of all, and their enstrophies by degree."""
    fluid = co.systems.sphere_euler(N)
    noise = co.forces.TransportNoise((8, 9, 10), 0.45, seed=3)
    start = fluid.random(seed=4, degrees=(2, 6))
    stirred = fluid.with_forces(noise)
    sol = co.integrate(stirred, [start] * PATHS, (0, 0.5), 1 / 32, co.IsospectralGauss(), save_every=16)
    paths = sol.x[-1]
    figure, panels = plt.subplots(1, 4, figsize=(14, 3.2), layout="constrained", width_ratios=(1, 1, 1, 0.9))
    limit = np.abs(fluid.to_grid(start)).max()
    shown = {"start": start, "one path, t = 0.5": paths[0], f"mean of {PATHS} paths": paths.mean(axis=0)}
    for panel, (title, W) in zip(panels[:3], shown.items(), strict=True):
        image = panel.imshow(
            fluid.to_grid(W, (91, 180)), extent=(0, 360, -90, 90), vmin=-limit, vmax=limit, cmap="RdBu_r"
        )
        panel.set(title=title, xlabel="longitude", xticks=(0, 180, 360), yticks=(-90, 0, 90))
    panels[0].set_ylabel("latitude")
    figure.colorbar(image, ax=panels[:3], label="vorticity", shrink=0.8)
    spectra = {
        "start": fluid.enstrophy_spectrum(start)[1],
        "paths, on average": fluid.enstrophy_spectrum(paths)[1].mean(axis=0),
        "mean": fluid.enstrophy_spectrum(paths.mean(axis=0))[1],
    }
    for (label, values), style in zip(spectra.items(), ("k-", "C0o-", "C3s-"), strict=True):
        panels[3].semilogy(np.arange(1, N), np.where(values > 1e-6, values, np.nan), style, ms=3, label=label)
    panels[3].set(xlabel="degree", title="enstrophy by degree")
    panels[3].legend()
    return figure


if __name__ == "__main__":
    draw().savefig(PICTURE, dpi=75)
