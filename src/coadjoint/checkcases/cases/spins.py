"""Classical spins: in a rotating field, with damping, and coupled in a chain."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from coadjoint.checkcases.attitudes import stacked
from coadjoint.checkcases.check_case import CheckCase, Columns, DerivedQuantity, Quantity, sample_times
from coadjoint.checkcases.integration import IntegratedMotion
from coadjoint.checkcases.registry import checkcase
from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.systems.closed_forms.closed_form import rotate_about
from coadjoint.systems.lattices.spin_lattice import spin_lattice
from coadjoint.validation import read_number, read_positive

Floats = npt.NDArray[np.float64]

SPIN = Quantity("spin", ("sx", "sy", "sz"), "1", "vector", "direction of the spin in space, a unit vector")
PROTON, ELECTRON = 2.6752218744e8, 1.76085963023e11  # gyromagnetic ratios, rad/(s T), CODATA 2018
LENGTH = DerivedQuantity(
    "length of the spin", "1", lambda columns: np.linalg.norm(stacked(columns, SPIN.columns), axis=1), ("spin",)
)


@checkcase
def spin_in_rotating_field(
    static: float = 1e-3, rotating: float = 1e-4, detuning: float = 0.05, end: float = 3e-4, samples: int = 301
) -> CheckCase:
    """Return a spin in a static field and a rotating one: nutation, or Rabi oscillation.

    Parameters
    ----------
    static, rotating : float
        Field along the third axis, and the field that rotates about it, T.
    detuning : float
        Relative deviation of the rotation of the field from resonance.
    end, samples
        As of `free_body`.
    """
    B0, B1 = read_positive(static, "static"), read_positive(rotating, "rotating")
    off, last = read_number(detuning, "detuning"), read_positive(end, "end")
    rate = -PROTON * B0 * (1.0 + off)
    start = np.array([0.0, 0.0, 1.0])

    def motion(t: Floats) -> Columns:
        # In axes that turn with the field it is constant, (B1, 0, B0 + rate/gamma).
        axis = np.array([PROTON * B1, 0.0, PROTON * B0 + rate])
        turned = rotate_about(np.tile(start, (len(t), 1)), np.tile(axis, (len(t), 1)), t)
        c, s = np.cos(rate * t), np.sin(rate * t)
        x, y, z = turned.T
        return {"sx": c * x - s * y, "sy": s * x + c * y, "sz": z}

    return CheckCase(
        name="spin_in_rotating_field",
        title="a spin in a static and a rotating field",
        statement=(
            "s' = gamma s x B with B = (rotating cos(rate t), rotating sin(rate t), static): the Bloch equation of "
            "protons without relaxation. At t = 0 s = (0, 0, 1). At resonance rate = -gamma static."
        ),
        parameters={
            "gamma": (PROTON, "rad/(s T)"),
            "static": (B0, "T"),
            "rotating": (B1, "T"),
            "rate": (rate, "rad/s"),
            "end": (last, "s"),
        },
        quantities=(SPIN,),
        motion=motion,
        times=sample_times(last, samples),
        accuracy=1e-11,
        basis="closed form, a rotation in axes that turn with the field",
        source="I. I. Rabi, Space quantization in a gyrating magnetic field, Phys. Rev. 51, 652 (1937)",
        invariants=(LENGTH,),
    )


@checkcase
def damped_spin(
    field: float = 1.0, damping: float = 0.05, tilt: float = 3.0, end: float = 5e-10, samples: int = 501
) -> CheckCase:
    """Return a magnetic moment that relaxes to a field, the Landau-Lifshitz-Gilbert equation.

    Parameters
    ----------
    field : float
        Along the third axis, T.
    damping : float
        Gilbert's alpha, dimensionless.
    tilt : float
        Angle of the moment from the field at the start, rad.
    end, samples
        As of `free_body`.
    """
    B, alpha, angle = read_positive(field, "field"), read_positive(damping, "damping"), read_positive(tilt, "tilt")
    last = read_positive(end, "end")
    if not angle < math.pi:
        raise ValueError(f"tilt is {angle:g}; give an angle of less than half a turn")
    rate = ELECTRON * B / (1.0 + alpha**2)

    def motion(t: Floats) -> Columns:
        # tan(tilt/2) decays exponentially, and the azimuth grows at the same rate.
        tangent = math.tan(angle / 2.0) * np.exp(-alpha * rate * t)
        across, along = 2.0 * tangent / (1.0 + tangent**2), (1.0 - tangent**2) / (1.0 + tangent**2)
        return {"sx": across * np.cos(rate * t), "sy": across * np.sin(rate * t), "sz": along}

    return CheckCase(
        name="damped_spin",
        title="a magnetic moment that relaxes to a field",
        statement=(
            "m' = -gamma/(1 + alpha^2) (m x B + alpha m x (m x B)), the Landau-Lifshitz-Gilbert equation, with B = "
            "(0, 0, field). The columns sx, sy, sz are those of the direction m. At t = 0 m = (sin tilt, 0, cos "
            "tilt)."
        ),
        parameters={
            "gamma": (ELECTRON, "rad/(s T)"),
            "field": (B, "T"),
            "alpha": (alpha, "1"),
            "tilt": (angle, "rad"),
            "end": (last, "s"),
        },
        quantities=(SPIN,),
        motion=motion,
        times=sample_times(last, samples),
        accuracy=1e-11,
        basis="closed form",
        source=(
            "T. L. Gilbert, A phenomenological theory of damping in ferromagnetic materials, IEEE Trans. Magn. 40, "
            "3443 (2004)"
        ),
        invariants=(LENGTH,),
    )


SITES = 8
EXCHANGE, ASYMMETRIC, EASY, FIELD = 1.0, 0.3, 0.2, 0.4  # in units of the exchange
UNIT, END = 1e12, 20.0  # rad/s; end in units of its inverse
METHODS = (GaussLegendre(8), GaussLegendre(6))


def chain_start() -> Floats:
    """Return the directions of the spins at the start, (SITES, 3), from formulas."""
    k = np.arange(1, SITES + 1)
    polar, azimuth = 0.3 + 0.35 * k, 0.9 * k
    return np.column_stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])


@checkcase
def spin_chain() -> CheckCase:
    """Return eight classical spins in a chain with exchange, Dzyaloshinskii-Moriya coupling, easy axis and field."""
    system = spin_lattice(
        "chain",
        SITES,
        exchange=EXCHANGE,
        dm=(0.0, 0.0, ASYMMETRIC),
        field=(0.0, 0.0, FIELD),
        on_site=(0.0, 0.0, EASY),
    )
    names = tuple(f"s{axis}_{k}" for k in range(1, SITES + 1) for axis in "xyz")
    spins = Quantity(
        "spins", names, "1", "vector", "directions of the spins in space, three numbers each, in their order"
    )
    motion = IntegratedMotion(
        system, chain_start().ravel(), 0.05, METHODS, lambda x, t: dict(zip(names, x.T, strict=True)), 1.0 / UNIT
    )
    times = np.linspace(0.0, END / UNIT, 201)

    def energy(columns: Mapping[str, Floats]) -> Floats:
        s = stacked(columns, names).reshape(-1, SITES, 3)
        bonds = -EXCHANGE * np.sum(s[:, :-1] * s[:, 1:], axis=(1, 2))
        bonds += ASYMMETRIC * np.sum(np.cross(s[:, :-1], s[:, 1:])[..., 2], axis=1)
        return UNIT * (bonds - np.sum(EASY * s[:, :, 2] ** 2 + FIELD * s[:, :, 2], axis=1))

    def total(columns: Mapping[str, Floats]) -> Floats:
        return np.asarray(stacked(columns, names)[:, 2::3].sum(axis=1))

    return CheckCase(
        name="spin_chain",
        title="an open chain of eight classical spins",
        statement=(
            "s_i' = s_i x b_i with b_i = -dH/ds_i and H = sum over bonds (i, i + 1) of -exchange s_i . s_j + "
            "asymmetric (s_i x s_j)_z - sum over sites of easy (s_iz)^2 + field s_iz, for unit vectors s_i, with "
            "energies divided by hbar S, so that a spin turns clockwise about its field. At t = 0 s_k has the "
            "polar angle 0.3 + 0.35 k and the azimuth 0.9 k, in rad, k = 1, ..., 8. For moments m = -s reverse the "
            "field."
        ),
        parameters={
            "exchange": (EXCHANGE * UNIT, "rad/s"),
            "asymmetric": (ASYMMETRIC * UNIT, "rad/s"),
            "easy": (EASY * UNIT, "rad/s"),
            "field": (FIELD * UNIT, "rad/s"),
            "end": (END / UNIT, "s"),
        },
        quantities=(spins,),
        motion=motion,
        times=times,
        accuracy=1e-11,
        basis="this library, Gauss-Legendre methods of orders 16 and 12, and DOP853 agree",
        source=(
            "J. Frank, W. Huang, B. Leimkuhler, Geometric integrators for classical spin systems, J. Comput. Phys. "
            "133, 160 (1997)"
        ),
        invariants=(
            DerivedQuantity("energy", "rad/s", energy, ("spins",)),
            DerivedQuantity("total sz", "1", total, ("spins",)),
        ),
    )
