"""Systems solved by elliptic functions: the Maxwell-Bloch equations, and the Poisson brackets of Sklyanin."""

from __future__ import annotations

import math
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.short_repr import short
from coadjoint.systems.bodies.inertia import read_vector
from coadjoint.systems.closed_forms.closed_form import move_state
from coadjoint.systems.closed_forms.free_rigid_body import amplitude, first_kind, free_motion
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.poisson import PoissonSystem
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


def _pulse_energy(coupling: Any) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    return np.array([1.0, 0.0, 0.0]), np.append(np.zeros(2), coupling)


@ready_made(
    energy=_pulse_energy,
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
        Quadratic(*_pulse_energy(coupling)),
        casimirs={"P^2 + D^2": Polynomial({(0, 2, 0): 1, (0, 0, 2): 1})},
        name="maxwell_bloch",
        parameters={"coupling": coupling},
        exact=partial(move_state, "maxwell_bloch", 3, partial(_pulse_motion, coupling)),
    )


def _pulse_motion(coupling: float, start: Floats, times: Floats) -> Floats:
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


def _sum_of_squares(masses: npt.NDArray[Any]) -> tuple[npt.NDArray[Any]]:
    return (masses,)


@ready_made(
    energy=_sum_of_squares,
    gallery_entry=GalleryEntry(
        x0=(1.0, 0.1, 0.9, 0.2),
        t_span=(0.0, 30.0),
        step=0.05,
        caption="A free body whose speed is multiplied by x0: the vector (x1, x2, x3) keeps its length and moves on a "
        "closed curve of its sphere.",
        pictures=(
            Picture(
                "directions",
                vectors={"$(x_1, x_2, x_3)$": (1, 2, 3)},
                axes_named=("$x_1$", "$x_2$", "$x_3$"),
                title="direction of $(x_1, x_2, x_3)$",
            ),
        ),
        coordinates=("x0", "x1", "x2", "x3"),
        quantity="state",
    ),
)
def sklyanin(
    anisotropy: npt.ArrayLike = (1.0, 2.0, 4.0), masses: npt.ArrayLike = (1.0, 0.5, 2.0, 1.5)
) -> PoissonSystem:
    """Return a quadratic energy on Sklyanin's quadratic bracket, equation (17) with a J that is not linear in x.

    ``{x1, x0} = (J2 - J3) x2 x3``, ``{x1, x2} = -x0 x3`` and cyclic in 1, 2, 3, with ``H = sum of masses_i x_i^2 /
    2`` and sign +1: the bracket of one site of the lattice Landau-Lifshitz magnet. The Jacobi identity holds. So x1' =
    x0 x2 x3 (m3 - m2) and cyclic, ``m_a = masses_a - masses_0 J_a``: a free rigid body with time rescaled by x0, and
    ``x0' = -x1 x2 x3 sum of masses_1 (J2 - J3)``.

    Parameters
    ----------
    anisotropy : (3,)
        J1, J2, J3 (dimensionless); only their differences matter.
    masses : (4,)
        Coefficients of x0, x1, x2, x3, of any sign (1/time for dimensionless x).

    Returns
    -------
    PoissonSystem
        State (x0, x1, x2, x3). Casimirs: ``x1^2 + x2^2 + x3^2`` and ``x0^2 + J1 x1^2 + J2 x2^2 + J3 x3^2``; with H they
        make the system integrable. ``exact(x0, t)`` in closed form if x0 is constant: if the masses of x1, x2, x3 are
        equal, or a linear function of J, exactly in float64.

    Raises
    ------
    ValueError
        Not three and four finite numbers, or products of them leave the range of float64.

    Notes
    -----
    Sklyanin, "Some algebraic structures connected with the Yang-Baxter equation", Funct. Anal. Appl. 16, 263 (1982).
    Equation (17) of Reich (1993).

    Examples
    --------
    >>> system = sklyanin(anisotropy=(1.0, 2.0, 4.0), masses=(1.0, 0.5, 2.0, 1.5))
    >>> system.vector_field([1.0, 1.0, 1.0, 1.0])
    array([-3.5, -2.5,  2. ,  0.5])
    """
    J, M = (tuple(read_vector(*one).tolist()) for one in ((anisotropy, "anisotropy"), (masses, "masses", 4)))
    differences = [Fraction(J[a - 2]) - Fraction(J[a - 1]) for a in range(3)]
    constant = sum(Fraction(m) * j for m, j in zip(M[1:], differences, strict=True)) == 0
    try:
        j1, j2, j3 = (float(j) for j in differences)
        body = [float(Fraction(m) - Fraction(M[0]) * Fraction(j)) for m, j in zip(M[1:], J, strict=True)]
    except OverflowError:
        raise ValueError(
            f"anisotropy {short(J)} and masses {short(M)} leave the range of float64; take other units"
        ) from None

    def structure(x: Any) -> Any:
        a, b, c = j1 * x[2] * x[3], j2 * x[3] * x[1], j3 * x[1] * x[2]
        p, q, r = x[0] * x[1], x[0] * x[2], x[0] * x[3]
        o = 0.0 * x[0]
        return np.array([[o, -a, -b, -c], [a, o, -r, q], [b, r, o, -p], [c, -q, p, o]])

    def derivative(x: Any) -> Any:
        d = np.zeros((4, 4, 4), dtype=np.asarray(x).dtype)
        for a, j in ((1, j1), (2, j2), (3, j3)):
            b, c = a % 3 + 1, (a + 1) % 3 + 1
            d[a, 0, b], d[a, 0, c] = j * x[c], j * x[b]
            d[b, c, 0], d[b, c, a] = -x[a], -x[0]
        return d - d.transpose(1, 0, 2)

    squares: dict[tuple[int, ...], Any] = {(0, 2, 0, 0): J[0], (0, 0, 2, 0): J[1], (0, 0, 0, 2): J[2]}
    return PoissonSystem(
        structure,
        Quadratic(*_sum_of_squares(np.array(M))),
        derivative=derivative,
        casimirs={
            "x1^2 + x2^2 + x3^2": Polynomial(dict.fromkeys(squares, 1)),
            "x0^2 + J.x^2": Polynomial({(2, 0, 0, 0): 1.0, **squares}),
        },
        name="sklyanin",
        parameters={"anisotropy": J, "masses": M},
        exact=partial(move_state, "sklyanin", 4, partial(_bracket_motion, np.array(body))) if constant else None,
    )


def _bracket_motion(body: Floats, start: Floats, times: Floats) -> Floats:
    """Return the states with x0 constant, a free body in the time x0 t."""
    moved, _ = free_motion(body, -1, start[1:], start[0] * times)
    return np.concatenate([np.full((len(times), 1), start[0]), moved], axis=-1)
