"""Draw `docs/droplet.png`, the droplet of `docs/rigid_molecules.md`: ``python docs/draw_droplet.py``."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

import coadjoint as co

PICTURE = Path(__file__).with_name("droplet.png")
COUNT, KT = 27, 0.0083145 * 300


def draw() -> plt.Figure:
    """Return the droplet at the end, and deviations of its energy for two steps."""
    water, rng = co.systems.rigid_molecules(count=COUNT), np.random.default_rng(1)
    grid = 0.31 * np.array(list(np.ndindex(3, 3, 3)))
    x = water.state(grid, attitudes=Rotation.random(COUNT, random_state=rng))
    prepared = co.prepare(water, co.Splitting(order=2), step=0.001)
    for _ in range(40):
        x = prepared.run(x, (0, 0.02)).x[-1]
        x = water.state(water.positions(x), attitudes=water.attitudes(x))
    v = rng.standard_normal((COUNT, 3)) * np.sqrt(KT / water.masses[:, None])
    omega = rng.standard_normal((COUNT, 3)) * np.sqrt(KT / np.diag(water.inertias[0].tensor))
    x0 = water.state(water.positions(x), v - v.mean(axis=0), water.attitudes(x), omega)
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), width_ratios=(2, 3), layout="constrained")
    for step in (0.002, 0.001):
        sol = co.integrate(water, x0, (0, 20), step, co.Splitting(order=2))
        right.plot(
            sol.t, (sol.energy - sol.energy[0]) / (COUNT * KT), linewidth=0.5, label=f"steps of {1000 * step:g} fs"
        )
    right.set(xlabel="t [ps]", title="deviation of the energy, over the kT of all molecules")
    right.legend()
    sol.plot(co.plotting.Picture("bodies", at=1.0), axes=left)
    return figure


if __name__ == "__main__":
    draw().savefig(PICTURE, dpi=75)
