"""Compositions of a symmetric scheme with itself (section 4 of Reich 1993), and those of even order (Remark 6.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Context, Decimal
from functools import cached_property
from typing import Any

from coadjoint.kernels.loop import CompiledLoop
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.methods.protocol.composed import MAX_ORDER, Composed, check_base
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.methods.splitting import Splitting
from coadjoint.program.numbers import Number
from coadjoint.program.table import FlowTable
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.shortcuts import of
from coadjoint.systems.system import System
from coadjoint.validation import read_choice, read_finite, read_integer

MAX_SUM = 1000.0  # of absolute coefficients: states move so much farther, and rounding with them
MAX_SUBSTEPS = 1000  # of a step; tables of flows stay small
CUBE_ROOT_OF_2 = 1.2599210498948732  # literal, since ** calls pow of the C library, whose bits differ by machine
SIDE_STEPS = {"triple": 1, "suzuki": 2}  # number of steps on each side of the middle one


@suggest_keywords
@dataclass(frozen=True)
class Composition(Composed):
    """One step of the base at each fraction c_1 h, c_2 h, ... of the step: a higher order from a symmetric base.

    Choose it for your own coefficients, or for a base other than `Splitting`, such as `GaussLegendre`. A composition
    preserves what its base preserves.

    Parameters
    ----------
    base : Method
        A symmetric scheme: `Splitting` of even order, or `GaussLegendre`.
    coefficients : sequence of float
        The fractions, with sum 1. ``(c1, c2, c1)`` with 2 c1 + c2 = 1, 2 c1^3 + c2^3 = 0 gives order 4.

    Raises
    ------
    ValueError
        If the base is not symmetric, or the sum of the coefficients is not 1.

    References
    ----------
    S. Reich 1993, section 4; H. Yoshida, Phys. Lett. A 150 (1990) 262.

    Examples
    --------
    >>> import coadjoint as co
    >>> c1 = 1 / (2 - 2 ** (1 / 3))
    >>> method = co.Composition(co.Splitting(order=2), (c1, 1 - 2 * c1, c1))
    >>> method.order, method.symmetric
    (4, True)
    """

    base: Method
    coefficients: tuple[float, ...]

    composed = of("expanded.composed")
    compiled = of("expanded.compiled")
    step = of("expanded.step")
    tangent = of("expanded.tangent")
    tangent_on = of("expanded.tangent_on")
    linearized = of("expanded.linearized")
    tangent_loop = of("expanded.tangent_loop")
    by_stages = of("expanded.by_stages")
    differentiates = of("expanded.differentiates")
    stored_states = of("expanded.stored_states")
    derivative_tables = of("expanded.derivative_tables")
    formal_step = of("expanded.formal_step")
    known_to = of("expanded.known_to")
    restored = of("expanded.restored")
    took_newton = of("expanded.took_newton")
    work = of("expanded.work")

    def __post_init__(self) -> None:
        check_base(self.base, "a Composition", "Splitting(order=2)")
        object.__setattr__(self, "coefficients", _read_fractions(self.coefficients, self.base))
        if not self.base.symmetric:
            raise ValueError(f"Composition needs a symmetric base, which {self.base} is not{self.base.instead}")
        if sum(map(abs, self.coefficients)) > MAX_SUM:
            raise ValueError(
                f"the absolute coefficients of a Composition add up to {sum(map(abs, self.coefficients)):.3g}; above "
                f"{MAX_SUM:g} rounding would undo the composition"
            )
        total = sum(self.coefficients)
        if abs(total - 1.0) > 4 * len(self.coefficients) * UNIT_ROUNDOFF * sum(map(abs, self.coefficients)):
            raise ValueError(f"the coefficients of a Composition add up to 1, not to {total!r}")

    @cached_property
    def expanded(self) -> Method:
        return self.base.composed(self.coefficients)

    def steps_between_forces(self) -> tuple[Method, tuple[float, ...]]:
        base, fractions = self.base.steps_between_forces()
        return base, tuple(c * f for c in self.coefficients for f in fractions)

    def _shared_loop(self, system: System, h: float, representation: Representation) -> CompiledLoop:
        self._check_loop(system)
        return self.expanded._shared_loop(system, h, representation)

    def flow_table(self, system: System, *, group: Representation = None, number: Number = float) -> FlowTable:
        if type(self.expanded).flow_table is Method.flow_table:  # refused, by the name of the scheme that was given
            return super().flow_table(system, group=group, number=number)
        return self.expanded.flow_table(system, group=group, number=number)

    @classmethod
    def examples(cls) -> Sequence[Method]:
        """Return compositions of flows and of stages."""
        outer = 1.0 / (2.0 - CUBE_ROOT_OF_2)
        fractions = (outer, 1.0 - 2.0 * outer, outer)
        return [cls(Splitting(order=2), fractions), cls(GaussLegendre(1), fractions)]


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
    check_base(base, "even_order", "Splitting(order=1)")
    target = read_integer(order, "order", 2, MAX_ORDER)
    read_choice(jump, "jump", SIDE_STEPS)
    method = base if base.symmetric else base.symmetrized()
    if target % 2 or target < method.order:
        raise ValueError(f"order is {target}; from {base} it is even, and {method.order} or more")
    for current in range(method.order, target, 2):
        sides = SIDE_STEPS[jump]
        # In decimals, since ** calls pow of the C library, whose bits differ by machine.
        root = float(Context(prec=40).power(Decimal(2 * sides), Decimal(1.0 / (current + 1))))
        outer = 1.0 / (2 * sides - root)
        method = Composition(method, (*[outer] * sides, 1.0 - 2 * sides * outer, *[outer] * sides))
    return method


def _read_fractions(coefficients: Any, base: Method) -> tuple[float, ...]:
    fractions = read_finite(coefficients, "coefficients")
    if fractions.ndim != 1:
        raise ValueError(f"coefficients has shape {fractions.shape}; give a sequence of numbers")
    substeps = fractions.size * len(base.fractions)
    if substeps > MAX_SUBSTEPS:
        raise ValueError(f"a step of the Composition has {substeps} substeps; the limit is {MAX_SUBSTEPS}")
    return tuple(fractions.tolist())
