"""Schemes of any even order from one of first order: a step and its adjoint, then compositions (Remark 6.1)."""

from __future__ import annotations

from decimal import Context, Decimal

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.composition import Composition
from coadjoint.methods.protocol.composed import MAX_ORDER
from coadjoint.methods.protocol.method import Method
from coadjoint.short_repr import short
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
