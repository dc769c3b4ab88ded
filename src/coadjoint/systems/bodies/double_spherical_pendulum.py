"""The double spherical pendulum: two massless rods in space, one hanging from the other, with a mass at each end."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.phase_space import heisenberg
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.systems.bodies.inertia import read_in_range
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.double_pendulum_energy import pendulum_energy
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_finite


def _swinging() -> npt.NDArray[np.float64]:
    """Return the state with both rods horizontal at a right angle, the lower one moving sideways."""
    return np.array([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.5, 0.0, -0.3, 0.0, 0.2, 1.0])


@ready_made(
    unit="z",
    gallery_entry=GalleryEntry(
        x0=_swinging,
        t_span=(0.0, 20.0),
        step=0.02,
        caption="Two pendulums, one at the end of the other, pulled aside and pushed sideways. The picture shows the "
        "directions of both rods on one sphere. The motion is chaotic, and the vertical angular momentum is "
        "constant.",
        pictures=(
            Picture(
                "directions",
                vectors={"upper rod": (0, 1, 2), "lower rod": (3, 4, 5)},
                axes_named=("$X$", "$Y$", "$Z$"),
                title="directions of the rods in space",
                view=(35.0, -20.0),
            ),
        ),
        components=Picture("components", chosen=(2, 5), quantity="height of the rods' ends"),
        coordinates=("q1", "q2", "q3", "q4", "q5", "q6", "p1", "p2", "p3", "p4", "p5", "p6", "z"),
        quantity="state",
    ),
)
def double_spherical_pendulum(
    masses: npt.ArrayLike = (1.0, 1.0), lengths: npt.ArrayLike = (1.0, 1.0), gravity: float = 1.0
) -> LiePoissonSystem:
    """Return a spherical pendulum that hangs from another one, in terms of two directions in space and their momenta.

    With unit vectors u_1 (from the pivot to the first mass) and u_2 (from there to the second), the Lagrangian is ``a
    |u_1'|^2/2 + b |u_2'|^2/2 + c u_1' . u_2' - gravity ((m_1 + m_2) l_1 u_13 + m_2 l_2 u_23)``, a = (m_1 + m_2) l_1^2,
    b = m_2 l_2^2, c = m_2 l_1 l_2; the third axis points up. H depends on the directions ``q/|q|`` and the angular
    momenta ``q cross p`` only: so q stays on its sphere, and the component of p along q has no effect. Sign +1.

    Parameters
    ----------
    masses, lengths : (2,)
        m and l, positive; the first belong to the rod at the pivot.
    gravity : float
        Acceleration (length/time^2), not negative.

    Returns
    -------
    LiePoissonSystem
        State: ``(q_1, q_2, p_1, p_2, 1)``, 13 numbers, q_1 = u_1, q_2 = u_2, and ``p_1 = a u_1' + c u_2'``, ``p_2 = b
        u_2' + c u_1'`` (angular momentum), up to components along q;
        ``coadjoint.systems.canonical.canonical_state`` assembles it. Casimir: ``"z"``, which is 1. Integrals, all
        quadratic: ``"|q1|^2"``, ``"q1.p1"``, the same of q2 and p2, and the vertical component ``"total L3"`` of the
        angular momentum, or all three components without gravity.

    Raises
    ------
    TypeError, ValueError
        Not two positive masses and two positive lengths, or negative gravity.

    Notes
    -----
    Marsden and Scheurle, Z. angew. Math. Phys. 44, 17 (1993). The kinetic energy does not split. The bracket is
    constant, so `GaussLegendre` is a symplectic map that preserves all quadratic integrals: McLachlan, Modin and
    Verdier, Nonlinearity 27, 1525 (2014).

    Examples
    --------
    >>> pendulum = double_spherical_pendulum()
    >>> hanging = [0, 0, -1.0, 0, 0, -1.0, 0, 0, 0, 0, 0, 0, 1]
    >>> pendulum.energy(hanging), bool(abs(pendulum.vector_field(hanging)).max() == 0)
    (-3.0, True)
    """
    first, second = (_pair(argument, what) for argument, what in ((masses, "masses"), (lengths, "lengths")))
    g = read_in_range(gravity, "gravity", zero=True)
    H = pendulum_energy(first, second, g)
    return LiePoissonSystem(
        _algebra(),
        H,
        sign=+1,
        name="double_spherical_pendulum",
        parameters={"masses": first, "lengths": second, "gravity": g},
        integrals=_integrals(g),
    )


def _pair(argument: Any, what: str) -> tuple[float, float]:
    numbers = read_finite(argument, what)
    if numbers.shape != (2,):
        raise ValueError(f"{what} has shape {numbers.shape}; give two numbers, the first of the rod at the pivot")
    first, second = (read_in_range(value, f"{what}[{k}]") for k, value in enumerate(numbers.tolist()))
    return first, second


@cache
def _algebra() -> LieAlgebra:
    return heisenberg(6)


def _integrals(gravity: float) -> dict[str, Quadratic]:
    """Return the squares of q_1 and q_2, their products with the momenta, and the angular momentum."""

    def form(*entries: tuple[int, int, float]) -> Quadratic:
        M = np.zeros((13, 13))
        for i, j, value in entries:
            M[i, j] += value
            M[j, i] += value
        return Quadratic(M)

    integrals = {}
    for k in (0, 1):
        q, p = 3 * k, 6 + 3 * k
        integrals[f"|q{k + 1}|^2"] = form(*((q + i, q + i, 1.0) for i in range(3)))
        integrals[f"q{k + 1}.p{k + 1}"] = form(*((q + i, p + i, 1.0) for i in range(3)))
    for axis in range(3) if gravity == 0.0 else (2,):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        pairs = [(3 * k + i, 6 + 3 * k + j, 1.0) for k in (0, 1)] + [(3 * k + j, 6 + 3 * k + i, -1.0) for k in (0, 1)]
        integrals[f"total L{axis + 1}"] = form(*pairs)
    return integrals
