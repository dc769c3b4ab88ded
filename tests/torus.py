"""Fluids on the torus: random states, and a reference to 40 digits."""

import json
from pathlib import Path

import numpy as np

import coadjoint as co

REFERENCE = json.loads((Path(__file__).parent / "public" / "systems" / "torus_reference.json").read_text())["modes"]


def first_modes(N):
    """The modes at t = 0 of the reference: 1/(k + 2) + i (-1)^k/(k + 3), in lexicographic order."""
    above = sorted((m1, m2) for m1, m2, _, _ in REFERENCE[str(N)])
    return {mode: complex(1 / (k + 2), (-1) ** k / (k + 3)) for k, mode in enumerate(above)}


def last_modes(N):
    """Return the modes of the reference at t = 1."""
    return {(m1, m2): complex(float(re), float(im)) for m1, m2, re, im in REFERENCE[str(N)]}


def of_size(N):
    """Return |n|^2 of all modes, in the order of the discrete Fourier transform."""
    n = np.rint(np.fft.fftfreq(N, 1 / N)).astype(int)
    return n[:, None] ** 2 + n[None, :] ** 2


def smooth(system, seed, width=2.0):
    """Return a random state of long waves, with vorticity of size one."""
    N, rng = system.algebra.N, np.random.default_rng(seed)
    w = (rng.standard_normal((N, N)) + 1j * rng.standard_normal((N, N))) * np.exp(-of_size(N) / (2 * width**2))
    w[0, 0] = 0.0
    back = -np.arange(N) % N
    w = w + np.conj(w[back][:, back])
    field = co.systems.torus_euler(N=N).from_modes(w / np.linalg.norm(w))
    return system.algebra.projected(field)
