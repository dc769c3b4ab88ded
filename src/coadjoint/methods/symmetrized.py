"""Schemes of any even order from one of first order: a step and its adjoint, then compositions (Remark 6.1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Context, Decimal
from typing import Any

import numpy as np

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.composition import Composition
from coadjoint.methods.numerics.stages import Coefficients
from coadjoint.methods.protocol.composed import MAX_ORDER, FlowsOfBase
from coadjoint.methods.protocol.composing import symmetrized
from coadjoint.methods.protocol.flow_method import FlowMethod
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.protocol.runge_kutta import RungeKuttaMethod
from coadjoint.methods.protocol.wrapper import Wrapper
from coadjoint.program.numbers import Number
from coadjoint.program.sweeps import Sweep
from coadjoint.short_repr import short
from coadjoint.systems.system_checks import System
from coadjoint.validation import read_choice, read_integer

SIDE_STEPS = {"triple": 1, "suzuki": 2}
"""Number of steps on each side of the middle one."""


@suggest_keywords
def even_order(base: Method, order: int, jump: str = "triple") -> Method:
    """Return a symmetric scheme of an even order from one of any order, such as 1.

    A base that is not symmetric is followed by its adjoint, each over half a step. The result is symmetric and of even
    order, 2 for a base of order 1. A symmetric scheme of order 2 k is composed with itself, ``c h, (1 - 2 c) h, c h``
    with c = 1 / (2 - 2^(1/(2k+1))), or by Suzuki's five steps ``c h, c h, (1 - 4 c) h, c h, c h`` with c = 1 / (4 -
    4^(1/(2k+1))). The result has order 2 k + 2 and preserves what the base preserves. Choose it for a base of your own;
    `Splitting` has better named compositions of orders 4 to 10.

    Parameters
    ----------
    base : Method
        A symmetric scheme, or one with a known adjoint: a scheme that consists of flows, such as
        ``Splitting(order=1)``, or a Runge-Kutta method given by its tableau.
    order : int
        2, 4, ..., 12, at least the order of the symmetric base.
    jump : {"triple", "suzuki"}
        Three or five steps for each increase of the order by two. Five cost more, mostly with a smaller error.

    Returns
    -------
    Method

    Raises
    ------
    TypeError, ValueError
        The adjoint of the base is not known, or the order is odd, too small or too large.

    Notes
    -----
    S. Reich 1993, Remark 6.1. The remark omits the adjoint, without which the composition of a first-order scheme has
    the wrong error terms. H. Yoshida, Phys. Lett. A 150 (1990) 262; M. Suzuki, Phys. Lett. A 146 (1990) 319.

    Examples
    --------
    >>> import coadjoint as co
    >>> method = co.methods.even_order(co.Splitting(order=1), 6)
    >>> method.order, method.symmetric, len(method.fractions)
    (6, True, 9)
    """
    if not isinstance(base, Method):
        raise TypeError(f"base is {short(base)}; give a scheme such as Splitting(order=1)")
    target = read_integer(order, "order", 2, MAX_ORDER)
    read_choice(jump, "jump", SIDE_STEPS)
    method = base if base.symmetric else symmetrized(base)
    if target % 2 or target < method.order:
        raise ValueError(f"order is {target}; from {base} it is even, and {method.order} or more")
    for current in range(method.order, target, 2):
        sides = SIDE_STEPS[jump]
        # In decimals, since ** calls pow of the C library, whose bits differ by machine.
        root = float(Context(prec=40).power(Decimal(2 * sides), Decimal(1.0 / (current + 1))))
        outer = 1.0 / (2 * sides - root)
        method = Composition(method, (*[outer] * sides, 1.0 - 2 * sides * outer, *[outer] * sides))
    return method


def _order_of_pair(base: Method) -> int:
    """Return the order of a step and its adjoint: symmetric, hence even."""
    return base.order + base.order % 2


@dataclass(frozen=True)
class PairOfFlows(FlowsOfBase):
    """The sweeps of a scheme over half a step, then in reverse over the other half."""

    offered = False
    explicit = True
    symmetric = True

    base: FlowMethod

    def __post_init__(self) -> None:
        if len(self.base.processor()):
            raise TypeError(f"{self.base} has a processor, so its adjoint is not a list of sweeps; take another scheme")

    @property
    def order(self) -> int:
        """The order of the base, rounded up to an even number."""
        return _order_of_pair(self.base)

    def properties(self, system: System) -> Properties:
        """Return the properties of the base."""
        return self.base.properties(system)

    def sweeps(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of the base and their mirror images; times are mirrored too."""
        sweeps = list(self.base.sweeps(number))
        first_half = [Sweep(forward, c / 2, moment / 2, turn) for forward, c, moment, turn in sweeps]
        # `turn` marks the second sweep of a pair, which is the first in the mirror image.
        turns = [sweeps[-1].forward, *(sweep.turn for sweep in reversed(sweeps[1:]))]
        second_half = [
            Sweep(not forward, c / 2, 1 - moment / 2, turn)
            for (forward, c, moment, _), turn in zip(reversed(sweeps), turns, strict=True)
        ]
        return [*first_half, *second_half]


@dataclass(frozen=True)
class PairOfTableaux(Wrapper, RungeKuttaMethod):
    """A Runge-Kutta method over half a step, then its adjoint over the other half.

    The adjoint ends where a backward step of the base starts: X_i = x + sum_j (out_j - mix_ij) L_j. It is implicit.
    """

    offered = False
    explicit = False
    symmetric = True

    base: RungeKuttaMethod

    @property
    def order(self) -> int:
        """The order of the base, rounded up to an even number."""
        return _order_of_pair(self.base)

    @property
    def solver(self) -> str:
        """``"implicit"``."""
        return "implicit"

    def properties(self, system: System) -> Properties:
        """Return the properties of the base, without a group element."""
        declared = self.base.properties(system)
        return Properties(poisson=declared.poisson, energy=declared.energy, casimirs=declared.casimirs, attitude="none")

    def coefficients(self, number: Number = float) -> Coefficients:
        """Return the combined tableau."""
        node, scale, mix, out = self.base.coefficients(number)
        s = len(node)
        both = np.concatenate([mix, 0 * mix], axis=1), np.concatenate([np.stack([out] * s), out - mix], axis=1)
        return Coefficients(
            np.concatenate([node / 2, 1 - node / 2]),
            np.concatenate([scale / 2, scale / 2]),
            np.concatenate(both),
            np.concatenate([out, out]),
        )
