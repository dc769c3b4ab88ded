"""The classical Sklyanin algebra: a Poisson bracket quadratic in the coordinates."""

from __future__ import annotations

from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.short_repr import short
from coadjoint.systems.bodies.inertia import read_vector
from coadjoint.systems.closed_forms.closed_form import move_state
from coadjoint.systems.closed_forms.free_rigid_body import free_motion
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.poisson import PoissonSystem
from coadjoint.systems.registry import ready_made

Floats = npt.NDArray[np.float64]


def _energy(masses: npt.NDArray[Any]) -> tuple[npt.NDArray[Any]]:
    return (masses,)


@ready_made(
    energy=_energy,
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
        Quadratic(*_energy(np.array(M))),
        derivative=derivative,
        casimirs={
            "x1^2 + x2^2 + x3^2": Polynomial(dict.fromkeys(squares, 1)),
            "x0^2 + J.x^2": Polynomial({(2, 0, 0, 0): 1.0, **squares}),
        },
        name="sklyanin",
        parameters={"anisotropy": J, "masses": M},
        exact=partial(move_state, "sklyanin", 4, partial(_motion, np.array(body))) if constant else None,
    )


def _motion(body: Floats, start: Floats, times: Floats) -> Floats:
    """Return the states with x0 constant, a free body in the time x0 t."""
    moved, _ = free_motion(body, -1, start[1:], start[0] * times)
    return np.concatenate([np.full((len(times), 1), start[0]), moved], axis=-1)
