"""The systems of the explorer and their parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import coadjoint as co

Values = Mapping[str, float]


@dataclass(frozen=True)
class Slider:
    """A number that the reader changes: its range, its first value, and the distance of two values."""

    name: str
    label: str
    low: float
    high: float
    value: float
    step: float


@dataclass(frozen=True)
class Shown:
    """A system of the explorer.

    `code` builds it, with the sliders as fields of a format string. `view` is how the page draws it. `parts` are parts
    of splittings that do not depend on the sliders; those that the library chooses may. If brackets depend on the
    sliders, all are multiples of the formula `brackets`, and `energy` is M of the energy as a formula. A flow on a
    sphere begins with the modes of `start`, code for the initial state, in place of `x0`.
    """

    name: str
    title: str
    text: str
    code: str
    sliders: tuple[Slider, ...]
    x0: tuple[float, ...]
    coordinates: tuple[str, ...]
    view: Mapping[str, Any]
    step: float
    parts: str = ""
    brackets: str = ""
    energy: str = ""
    start: str = ""

    @property
    def attitude(self) -> Any:
        """The argument `attitude` of runs; the first block of the coadjoint matrix is the rotation."""
        return "coadjoint" if self.view.get("body") in ("inertia", "top") else False

    def build(self, values: Values) -> Any:
        """Return the system with these values of the sliders."""
        return eval(self.code.format(**{name: repr(float(value)) for name, value in values.items()}), {"co": co})

    def initial(self, system: Any) -> Any:
        """Return the first initial state of a system that was built."""
        return eval(self.start, {"system": system}) if self.start else self.x0


# Of every body within these ranges one axis is the middle one, and no moment exceeds the sum of the others.
INERTIA = (
    Slider("I1", "inertia I₁", 1.0, 1.5, 1.0, 0.05),
    Slider("I2", "inertia I₂", 1.6, 2.0, 1.8, 0.05),
    Slider("I3", "inertia I₃", 2.1, 2.6, 2.5, 0.05),
)
SPINS = 8

SHOWN = (
    Shown(
        "rigid_body",
        "Rigid body",
        "A free body seen from its own axes. Its angular momentum stays on a sphere; near the middle axis it tumbles.",
        "co.systems.rigid_body(inertia=({I1}, {I2}, {I3}))",
        INERTIA,
        (0.05, 1.0, 0.05),
        ("x1", "x2", "x3"),
        {"kind": "sphere", "balls": [[0, 1, 2]], "body": "inertia", "click": 0},
        1.8,
        '"coordinates"',
    ),
    Shown(
        "heavy_top",
        "Heavy top",
        "A body on a fixed point under gravity. The vertical, seen from the body, stays on the unit sphere.",
        "co.systems.heavy_top(inertia=({I1}, {I2}, {I3}), lever=({l1}, {l2}, {l3}))",
        (
            *INERTIA,
            Slider("l1", "lever l₁", 0.05, 1.0, 0.05, 0.05),
            Slider("l2", "lever l₂", 0.05, 1.0, 0.1, 0.05),
            Slider("l3", "lever l₃", 0.1, 1.5, 1.0, 0.05),
        ),
        (0.2, 0.1, 2.6, 0.6, 0.0, 0.8),
        ("m1", "m2", "m3", "gamma1", "gamma2", "gamma3"),
        {
            "kind": "sphere",
            "balls": [[3, 4, 5]],
            "body": "top",
            "click": 0,
            "section": {"level": 1, "across": 3, "up": 5, "labels": ["γ₁", "γ₃"], "name": "m₂ = 0, rising"},
        },
        0.2,
        "((0,), (1,), (2,), (3, 4, 5))",
    ),
    Shown(
        "spin_pair",
        "Two spins",
        "Two classical spins, coupled and in a field along z. Each keeps its own length.",
        "co.systems.spin_lattice(shape=2, exchange={J}, tensor=(1.0, 1.0, {Delta}), field=(0.0, 0.0, {B}))",
        (
            Slider("J", "exchange J", 0.1, 2.0, 1.0, 0.05),
            Slider("Delta", "anisotropy Δ", 0.05, 2.0, 0.4, 0.05),
            Slider("B", "field B", -1.0, 1.0, 0.3, 0.05),
        ),
        (0.9, 0.1, 0.3, -0.3, 0.8, 0.2),
        ("S1x", "S1y", "S1z", "S2x", "S2y", "S2z"),
        {
            "kind": "sphere",
            "balls": [[0, 1, 2], [3, 4, 5]],
            "body": "arrows",
            "click": 0,
            "section": {"level": 1, "across": 3, "up": 5, "labels": ["S₂x", "S₂z"], "name": "S₁y = 0, rising"},
        },
        0.3,
        "((0, 3), (1, 4), (2, 5))",
    ),
    Shown(
        "spin_chain",
        "Spin chain",
        "Eight classical spins in a row, coupled to their neighbours: a chaotic system on eight spheres.",
        f"co.systems.spin_lattice(shape={SPINS}, "
        "exchange={J}, tensor=(1.0, 1.0, {Delta}), field=(0.0, 0.0, {B}))",
        (
            Slider("J", "exchange J", 0.1, 2.0, 1.0, 0.05),
            Slider("Delta", "anisotropy Δ", 0.05, 2.0, 0.6, 0.05),
            Slider("B", "field B", -1.0, 1.0, 0.2, 0.05),
        ),
        (
            0.96,
            0.0,
            0.28,
            0.6,
            0.8,
            0.0,
            0.0,
            0.96,
            -0.28,
            -0.6,
            0.64,
            0.48,
            -0.96,
            0.0,
            -0.28,
            -0.48,
            -0.8,
            0.36,
            0.0,
            -0.8,
            0.6,
            0.8,
            -0.6,
            0.0,
        ),
        tuple(f"S{k + 1}{axis}" for k in range(SPINS) for axis in "xyz"),
        {
            "kind": "sphere",
            "balls": [[3 * k, 3 * k + 1, 3 * k + 2] for k in range(SPINS)],
            "body": "arrows",
            "click": 0,
        },
        0.2,
        str(tuple(tuple(range(axis, 3 * SPINS, 3)) for axis in range(3))),
    ),
    Shown(
        "toda_ring",
        "Toda ring",
        "Four particles on a ring that repel each other exponentially, in Flaschka's variables: integrable.",
        "co.systems.toda_ring(sites=4)",
        (),
        (0.6, -0.2, 0.1, -0.5, 0.5, 0.3, 0.45, 0.35),
        ("b1", "b2", "b3", "b4", "a1", "a2", "a3", "a4"),
        {
            "kind": "path",
            "axes": [0, 1, 4],
            "labels": ["b₁", "b₂", "a₁"],
            "section": {"level": 0, "across": 1, "up": 4, "labels": ["b₂", "a₁"], "name": "b₁ = 0, rising"},
        },
        0.2,
    ),
    Shown(
        "maxwell_bloch",
        "Maxwell-Bloch",
        "Light in two-level atoms, a pendulum in disguise: polarization, inversion and field on a cylinder.",
        "co.systems.maxwell_bloch(coupling={g})",
        (Slider("g", "coupling", 0.2, 3.0, 1.0, 0.05),),
        (1.9, 0.1, -1.0),
        ("E", "P", "D"),
        {"kind": "cylinder", "axes": [1, 2, 0], "labels": ["P", "D", "E"]},
        0.3,
        '"coordinates"',
    ),
    Shown(
        "fluid_triad",
        "Fluid: three waves",
        "Three waves of an ideal fluid in two dimensions; the one of middle length is unstable.",
        "co.systems.fluid_triad(first=(1.0, 0.0), second=({kx}, {ky}))",
        (
            Slider("kx", "second wave k_x", 0.25, 0.75, 0.5, 0.0625),
            Slider("ky", "second wave k_y", 1.25, 2.0, 1.5, 0.0625),
        ),
        (0.1, 1.0, 0.1),
        ("x1", "x2", "x3"),
        {"kind": "sphere", "balls": [[0, 1, 2]], "body": "vorticity", "click": 0},
        1.8,
        '"coordinates"',
        "ky",
        "[0.5, 0.5 / (kx * kx + ky * ky), 0.5 / ((1 + kx) * (1 + kx) + ky * ky)]",
    ),
    Shown(
        "planet",
        "Fluid: jets of a planet",
        "Turbulence on a rotating planet, whose deformation radius is 1/sqrt(lamb) at the poles: jets form, and for a "
        "large lamb those far from the equator stay weak. Left the relative vorticity, right the mean eastward speed "
        "by latitude. It keeps all traces of powers of an N by N matrix, the potential vorticity.",
        "co.systems.sphere_qg(N=int({N}), lamb={lamb}, rotation={rotation})",
        (
            Slider("N", "size N", 16.0, 48.0, 32.0, 16.0),
            Slider("lamb", "Lamb's parameter", 0.0, 2000.0, 500.0, 50.0),
            Slider("rotation", "rotation", 0.0, 200.0, 100.0, 5.0),
        ),
        (),
        (),
        {"kind": "planet"},
        0.02,
        start="system.random(seed=1, degrees=(4, 10), energy=1.0)",
    ),
)
