"""Draw `docs/noise.png`, averages and paths of Hamiltonian noise: ``python docs/draw_noise.py``."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

import coadjoint as co

PICTURE = Path(__file__).with_name("noise.png")
Floats = NDArray[np.float64]
MEMBERS, PATHS = 20_000, 400
STRENGTHS, FIELD = np.array([0.7, 1.1, 0.4]), np.array([1.0, 0.5, -0.3])
START = np.array([0.48, 0.6, 0.64])


def mean_errors(steps: NDArray[np.int64]) -> dict[str, Floats]:
    """Return errors of the mean of x_i x_j of a precessing spin at t = 1, from the mean operators of a step."""
    turns = [np.cross(np.eye(3)[k], np.eye(3)) for k in range(3)]
    on_products = [np.kron(G, np.eye(3)) + np.kron(np.eye(3), G) for G in turns]
    drift = sum(b * G for b, G in zip(FIELD, on_products, strict=True))
    noise = [s**2 / 2 * G @ G for s, G in zip(STRENGTHS, on_products, strict=True)]
    start = np.outer(START, START).ravel()
    exact = expm(drift + sum(noise)) @ start
    errors: dict[str, list[float]] = {"by the coin": [], "in a fixed order": []}
    for n in steps:
        one, two, three = (expm(A / n) for A in noise)
        D, half = expm(drift / n), expm(drift / (2 * n))
        means = {
            "by the coin": 0.5 * (one @ two @ three @ D + D @ three @ two @ one),
            "in a fixed order": half @ one @ two @ three @ half,
        }
        for name, step in means.items():
            errors[name].append(float(np.linalg.norm(np.linalg.matrix_power(step, n) @ start - exact)))
    return {name: np.array(found) for name, found in errors.items()}


def distances(noise: co.forces.HamiltonianNoise, steps: list[int]) -> Floats:
    """Return root mean squares of the distances between paths of a rigid body with a step and with its half."""
    body, ends = co.systems.rigid_body((1, 2, 3)), []
    for count in [*steps, 2 * steps[-1]]:
        noisy = body.with_forces(replace(noise, levels=int(np.log2(2 * steps[-1] // count))))
        ends.append(co.integrate(noisy, [(0.3, 1.0, 0.2)] * PATHS, (0, 1), 1 / count, save_every=count).x[-1])
    return np.array([np.sqrt(np.mean(np.sum((a - b) ** 2, axis=1))) for a, b in pairwise(ends)])


def draw() -> plt.Figure:
    """Return averages over spins beside the closed form, errors of averages, and distances between paths."""
    figure, panels = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    spins = co.systems.spin_lattice("ring", 4, exchange=0.0).with_forces(co.forces.RandomField(0.7, seed=1))
    sol = co.integrate(spins, [np.tile((0.0, 0.0, 1.0), 4)] * (MEMBERS // 4), (0, 2), 1 / 16)
    z = sol.x[:, :, 2::3].reshape(len(sol.t), -1)
    for degree, values in enumerate((z, (3 * z**2 - 1) / 2, (5 * z**3 - 3 * z) / 2), 1):
        panels[0].plot(sol.t[::2], values.mean(axis=1)[::2], f"C{degree - 1}o", ms=3, label=f"$P_{degree}$")
        panels[0].plot(sol.t, np.exp(-(0.7**2) * degree * (degree + 1) * sol.t / 2), f"C{degree - 1}")
    panels[0].set(xlabel="t", title="averages, and closed forms as lines")
    steps = np.array([2, 4, 8, 16, 32])
    for (name, errors), style in zip(mean_errors(steps).items(), ("C0o-", "C3s-"), strict=True):
        panels[1].loglog(1 / steps, errors, style, label=name)
    panels[1].loglog(1 / steps, 0.05 / steps**2, "k:", label="$h^2$")
    panels[1].loglog(1 / steps, 0.2 / steps, "k--", label="$h$")
    panels[1].set(xlabel="step h", title="errors of averages")
    counts = [4, 8, 16, 32, 64]
    for rows, name, style in ((np.eye(3)[:1], "one noise", "C0o-"), (np.eye(3), "three noises", "C3s-")):
        found = distances(co.forces.HamiltonianNoise(rows, 0.5, seed=3), counts)
        panels[2].loglog(1 / np.array(counts), found, style, label=name)
    panels[2].loglog(1 / np.array(counts), 0.2 / np.array(counts), "k--", label="$h$")
    panels[2].loglog(1 / np.array(counts), 0.4 / np.sqrt(counts), "k-.", label=r"$\sqrt{h}$")
    panels[2].set(xlabel="step h", title="distances between paths")
    for panel, lengths in zip(panels[1:], (steps, np.array(counts)), strict=True):
        panel.set_xticks(1 / lengths, [f"1/{count}" for count in lengths])
        panel.minorticks_off()
    for panel in panels:
        panel.legend()
    return figure


if __name__ == "__main__":
    draw().savefig(PICTURE, dpi=75)
