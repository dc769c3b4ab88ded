"""Explicit Runge-Kutta methods: Runge's method of order 2 and the classical one of order 4."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.numerics.solvers import Coefficients
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.protocol.runge_kutta import RungeKuttaMethod
from coadjoint.program.numbers import Number, convert
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_vector_states
from coadjoint.validation import read_choice

HALF = Fraction(1, 2)  # exact in every number type
TABLEAUX: dict[str, tuple[int, tuple[Any, ...], tuple[tuple[Any, ...], ...], tuple[Any, ...]]] = {
    "runge2": (2, (0, HALF), ((), (HALF,)), (0, 1)),
    "rk4": (
        4,
        (0, HALF, HALF, 1),
        ((), (HALF,), (0, HALF), (0, 0, 1)),
        (Fraction(1, 6), Fraction(1, 3), Fraction(1, 3), Fraction(1, 6)),
    ),
}
"""Name -> order, nodes c, rows of a, weights b."""


@suggest_keywords
@dataclass(frozen=True)
class ExplicitRungeKutta(RungeKuttaMethod):
    """An explicit Runge-Kutta method, a general-purpose scheme for comparisons; it preserves no invariants.

    ``X_i = x + h sum_{j<i} a_ij f(X_j)``, ``x_new = x + h sum_i b_i f(X_i)``. The group element is integrated with the
    momentum, ``g' = -sign g rho(grad H)`` (equation (13)), and slowly leaves the group. Choose it for short runs, and
    for comparison with the other schemes.

    Parameters
    ----------
    name : {"runge2", "rk4"}
        ``"runge2"``: Runge's method of order 2, ``x + h f(x + h/2 f(x))``. ``"rk4"``: the classical method of order 4.

    Raises
    ------
    ValueError
        The name is unknown.

    References
    ----------
    E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, II.1; S. Reich 1993, section 5.

    Examples
    --------
    >>> import coadjoint as co
    >>> co.ExplicitRungeKutta("rk4").order
    4
    """

    name: str = "rk4"

    explicit = True
    symmetric = False

    def __post_init__(self) -> None:
        read_choice(self.name, "explicit Runge-Kutta method", TABLEAUX)

    @property
    def solver(self) -> str:
        return "explicit"

    @property
    def order(self) -> int:
        """2 or 4."""
        return TABLEAUX[self.name][0]

    def properties(self, system: System) -> Properties:
        """Return the properties: only linear invariants are preserved; every system is supported."""
        check_vector_states(system)
        attitude = "none" if system.algebra is None else "integrated"
        return Properties(poisson=False, energy=False, casimirs="none", attitude=attitude)

    def coefficients(self, number: Number = float) -> Coefficients:
        _, nodes, rows, weights = TABLEAUX[self.name]

        def filled(values: tuple[Any, ...]) -> NDArray[Any]:
            padded = [*values, *[0] * (len(nodes) - len(values))]
            return np.array([convert(number, value) for value in padded])

        return Coefficients(
            filled(nodes), filled((1,) * len(nodes)), np.stack([filled(row) for row in rows]), filled(weights)
        )
