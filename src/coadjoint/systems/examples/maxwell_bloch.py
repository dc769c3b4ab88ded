"""The real Maxwell-Bloch equations, equivalent to a pendulum."""

from __future__ import annotations

import math
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.closed_forms.closed_form import move_state
from coadjoint.systems.closed_forms.free_rigid_body import amplitude, first_kind
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_positive

Floats = npt.NDArray[np.float64]


def _portrait(count: int) -> Floats:
    """Return initial states in the ground state of the atoms, with fields of both signs and increasing magnitude."""
    field = np.concatenate([np.linspace(0.4, 2.8, count), [-2.2, -2.5, -2.8]])
    return np.stack([field, 0.0 * field, -1.0 + 0.0 * field], axis=-1)


def _tipping(x: Any) -> Any:
    """Return the angle of the Bloch vector from the ground state."""
    return np.arctan2(-x[..., 1], -x[..., 2])


def _energy(coupling: Any) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    return np.array([1.0, 0.0, 0.0]), np.append(np.zeros(2), coupling)


@ready_made(
    energy=_energy,
    gallery_entry=GalleryEntry(
        x0=partial(_portrait, 9),
        t_span=(0.0, 14.0),
        step=0.05,
        caption="A system equivalent to the pendulum: oscillations about the ground state of the atoms, the separatrix "
        "on which one pulse of light excites all atoms and is emitted again, and beyond it periodic pulses. Right, "
        "the same motions on the cylinder of constant Bloch vector.",
        pictures=(
            Picture(
                "phase portrait",
                across=_tipping,
                up=0,
                labels=("tipping angle from the ground state [rad]", "field $E$"),
                cyclic=2.0 * math.pi,
            ),
            Picture("coadjoint orbit"),
        ),
        components=Picture("components", chosen=(0,)),
        coordinates=("E", "P", "D"),
        quantity="field",
    ),
)
def maxwell_bloch(coupling: float = 1.0) -> LiePoissonSystem:
    """Return the Maxwell-Bloch equations of light in two-level atoms: resonant, real and lossless.

    ``E' = coupling P``, ``P' = E D``, ``D' = -E P``: the dual of se(2) with sign +1 and ``H = E^2 / 2 + coupling D``.
    With ``P = R sin(theta)``, ``D = R cos(theta)`` it is ``theta' = E``, ``E' = coupling R sin(theta)``: a pendulum,
    upright at theta = 0, with all atoms excited.

    Parameters
    ----------
    coupling : float
        Coupling of the atoms to the field, positive (1/time^2).

    Returns
    -------
    LiePoissonSystem
        State (E, P, D): the field as Rabi frequency (1/time), polarization and inversion of the atoms (numbers).
        Casimir: the squared length of the Bloch vector, ``P^2 + D^2``. ``exact(x0, t)`` in closed form. The group
        element, 3 x 3, rotates by theta, the area of the pulse, in its first two coordinates; its translation has no
        meaning.

    Raises
    ------
    TypeError, ValueError
        `coupling` is not a positive number.

    Notes
    -----
    David and Holm, "Multiple Lie-Poisson structures, reductions, and geometric phases for the Maxwell-Bloch travelling
    wave equations", J. Nonlinear Sci. 2, 241 (1992).

    Examples
    --------
    >>> system = maxwell_bloch(coupling=2.0)
    >>> system.vector_field([0.5, 0.6, 0.8])
    array([ 1.2,  0.4, -0.3])
    >>> np.abs(system.exact([4.0, 0.0, -2.0], 100.0)).round(12)  # the separatrix: all of the field excites atoms
    array([0., 0., 2.])
    """
    coupling = read_positive(coupling, "coupling")
    return LiePoissonSystem(
        catalogue.get("se(2)"),
        Quadratic(*_energy(coupling)),
        casimirs={"P^2 + D^2": Polynomial({(0, 2, 0): 1, (0, 0, 2): 1})},
        name="maxwell_bloch",
        parameters={"coupling": coupling},
        exact=partial(move_state, "maxwell_bloch", 3, partial(_motion, coupling)),
    )


def _motion(coupling: float, start: Floats, times: Floats) -> Floats:
    """Return the states at times (k,) in terms of those of a pendulum."""
    field, polarization, inversion = start.tolist()
    radius = _length(polarization, inversion)
    if radius == 0:
        return np.tile(start, (len(times), 1))
    push = Fraction(coupling) * radius
    velocity = Fraction(field) ** 2 / (4 * push)
    small = Fraction(polarization) ** 2 / (2 * radius * (radius + abs(Fraction(inversion))))
    cosine2 = small if inversion > 0.0 else 1 - small  # squared cosine of half the angle from the stable equilibrium
    try:
        pace, k = math.sqrt(push), math.sqrt(velocity + 1 - cosine2)
    except OverflowError:
        pace, k = math.inf, math.inf
    gap = velocity - cosine2
    complement = float(gap / (velocity + 1 - cosine2) if gap >= 0 else -gap)
    s0, c0 = math.copysign(math.sqrt(1 - cosine2), -polarization), math.sqrt(cosine2)
    s, c, v = pendulum((s0, c0, 0.5 * field / pace), k, (gap >= 0, complement), pace * times)
    x = np.stack([2.0 * pace * v, -2.0 * float(radius) * s * c, float(radius) * (s - c) * (s + c)], axis=-1)
    x[times == 0.0] = start
    return x


def _length(p: float, d: float) -> Fraction:
    """Return the length of (p, d) to 200 bits, as needed near the separatrix."""
    square = Fraction(p) ** 2 + Fraction(d) ** 2
    scale = square.denominator << 200
    return Fraction(math.isqrt(square.numerator * square.denominator << 400), scale)


def pendulum(
    start: tuple[float, float, float], k: float, regime: tuple[bool, float], t: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return the solution, three (k,) arrays, of ``s' = c v``, ``c' = -s v``, ``v' = -s c``.

    For a pendulum ``phi'' = -sin(phi)``: s = sin(phi/2), c = cos(phi/2) >= 0, v = phi'/2; k = sqrt(s^2 + v^2). `regime`
    is whether it rotates, ``v^2 >= c^2``, and the complementary modulus squared: (v^2 - c^2) / k^2 then, else c^2 - v^2
    (given, since they cancel).
    Libration: s = k sn u, c = dn u, v = k cn u, u = t + u0, modulus k. Rotation: s = sn u, c = cn u, v = +-k dn u,
    u = +-k t + u0, modulus 1/k.
    """
    s, c, v = start
    rotates, complement = regime
    if k == 0.0 or (complement == 0.0 and v == 0.0):
        return np.full(t.size, s), np.full(t.size, c), np.full(t.size, v)
    u = math.copysign(k, v) * t if rotates else t
    sine, cosine = (s, c) if rotates else (s / k, v / k)
    radius = math.hypot(sine, cosine)
    sine, cosine = sine / radius, cosine / radius
    if complement == 0.0:
        u = math.asinh(sine / cosine) + u
        sn, cn = np.tanh(u), 2.0 * np.exp(-np.abs(u)) / (1.0 + np.exp(-2.0 * np.abs(u)))
        dn = cn
    else:
        phi = amplitude(first_kind(sine, cosine, complement) + u, complement)
        sn, cn = np.sin(phi), np.cos(phi)
        dn = np.sqrt(complement + (1.0 - complement) * cn**2)
    return (sn, cn, math.copysign(k, v) * dn) if rotates else (k * sn, dn, k * cn)
