"""Fluids on the torus: modes of a reference to 40 digits, and random states of long waves."""

import json
from pathlib import Path

import numpy as np

import coadjoint as co

REFERENCE = json.loads(next(Path(__file__).parents[2].rglob("torus_reference.json")).read_text())["modes"]


def first_modes(N):
    """Return the modes of the reference at t = 0: 1/(k + 2) + i (-1)^k/(k + 3), in lexicographic order."""
    above = sorted((m1, m2) for m1, m2, _, _ in REFERENCE[str(N)])
    return {mode: complex(1 / (k + 2), (-1) ** k / (k + 3)) for k, mode in enumerate(above)}


def last_modes(N):
    """Return the modes of the reference at t = 1."""
    return {(m1, m2): complex(float(re), float(im)) for m1, m2, re, im in REFERENCE[str(N)]}


def smooth(system, seed, width=2.0):
    """Return a random state of long waves, with vorticity of size one."""
    N, rng = system.algebra.N, np.random.default_rng(seed)
    n = np.fft.fftfreq(N, 1 / N)
    w = rng.standard_normal((N, N)) + 1j * rng.standard_normal((N, N))
    w *= np.exp(-(n[:, None] ** 2 + n[None, :] ** 2) / (2 * width**2))
    w[0, 0] = 0.0
    back = -np.arange(N) % N
    w = w + np.conj(w[back][:, back])
    return system.algebra.projected(co.systems.torus_euler(N=N).from_modes(w / np.linalg.norm(w)))
