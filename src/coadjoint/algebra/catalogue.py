"""The known algebras, each with a basis, a matrix representation and Casimirs: behind ``coadjoint.algebras``."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from coadjoint.algebra.constants import Triples
from coadjoint.algebra.invariant import Invariant
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomial import Polynomial
from coadjoint.errors import unknown_name

__all__ = ["A3_7", "e", "get", "heisenberg", "names", "sl", "so"]

HAT = np.array(
    [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]]
)


def _whole(value: Any, least: int, what: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{what} must be an integer from {least} up, not {value!r}")
    return int(value)


def _square(dim: int, begin: int = 0) -> Polynomial:
    """Return the sum of x_i^2 from coordinate `begin` on."""
    return Polynomial({tuple(2 * (j == i) for j in range(dim)): 1 for i in range(begin, dim)})


def so(n: int) -> LieAlgebra:
    """Return so(n), the skew-symmetric n x n matrices: rotations.

    so(3) has c_12^3 = +1 and the hat matrices, hat(u) v = u x v, as representation. For n >= 4 (and n = 2) the basis is
    E_ij - E_ji, i < j, in the order 12, 13, ..., 1n, 23, ...; these matrices are the representation.

    Parameters
    ----------
    n : int
        Size of the matrices, from 2; the dimension is n (n - 1)/2.

    Returns
    -------
    LieAlgebra
        With the Casimir ``"|x|^2"``, and ``"Pfaffian"`` for n = 4. so(2) is abelian and has ``"x1"``. For n >= 5 the
        quadratic Casimir is not the only one: so(n) has floor(n/2) independent ones.

    Raises
    ------
    ValueError
        n is not an integer from 2 up.

    Examples
    --------
    >>> so(4)
    LieAlgebra('so(4)', dim=6)
    >>> so(4).casimirs_known["Pfaffian"]
    x1*x6 - x2*x5 + x3*x4
    """
    n = _whole(n, 2, "n of so(n)")
    if n == 3:
        brackets = {(0, 1): {2: 1.0}, (1, 2): {0: 1.0}, (2, 0): {1: 1.0}}
        return LieAlgebra.from_brackets(3, brackets, name="so(3)", representation=HAT, casimirs={"|x|^2": _square(3)})
    first, second = np.triu_indices(n, 1)
    dim = first.size
    number = np.zeros((n, n), dtype=np.int64)
    number[first, second] = np.arange(dim)
    rho = np.zeros((dim, n, n))
    rho[np.arange(dim), first, second] = 1.0
    rho[np.arange(dim), second, first] = -1.0
    last = np.arange(n)
    pair, last = np.nonzero(last[None, :] > second[:, None])  # i < j < k
    ij, ik, jk = pair, number[first[pair], last], number[second[pair], last]
    one = np.ones(pair.size)
    constants = Triples(  # [e_ij, e_ik] = -e_jk, [e_ij, e_jk] = e_ik, [e_ik, e_jk] = -e_ij
        np.concatenate([ij, ij, ik]),
        np.concatenate([ik, jk, jk]),
        np.concatenate([jk, ik, ij]),
        np.concatenate([-one, one, -one]),
    )
    casimirs = {"|x|^2": _square(dim)} if n > 2 else {"x1": Polynomial.variable(0, 1)}
    if n == 4:
        x = [Polynomial.variable(i, 6) for i in range(6)]
        casimirs["Pfaffian"] = x[0] * x[5] - x[1] * x[4] + x[2] * x[3]
    return LieAlgebra(constants, dim=dim, name=f"so({n})", representation=rho, casimirs=casimirs)


def sl(n: int = 2) -> LieAlgebra:
    """Return sl(2), the 2 x 2 matrices of trace zero, in the basis [e1, e2] = e1, [e1, e3] = -2 e2, [e2, e3] = e3.

    It is A_{3,8} of Patera, Sharp, Winternitz and Zassenhaus. In terms of the usual (E, H, F) the basis is (F, H/2, E).

    Parameters
    ----------
    n : int, optional
        Only 2 is in the catalogue.

    Returns
    -------
    LieAlgebra
        With the 2 x 2 representation and the Casimir ``"x1*x3 + x2^2"``.

    Raises
    ------
    ValueError
        n is not 2.

    Examples
    --------
    >>> sl(2).bracket([1, 0, 0], [0, 0, 1])
    array([ 0., -2.,  0.])
    """
    if _whole(n, 2, "n of sl(n)") != 2:
        raise ValueError(f"the catalogue has sl(2) only, not sl({n}): build it with LieAlgebra(constants)")
    brackets = {(0, 1): {0: 1.0}, (0, 2): {1: -2.0}, (1, 2): {2: 1.0}}
    rho = [[[0.0, 0.0], [1.0, 0.0]], [[0.5, 0.0], [0.0, -0.5]], [[0.0, 1.0], [0.0, 0.0]]]
    casimir = Polynomial({(1, 0, 1): 1, (0, 2, 0): 1})
    return LieAlgebra.from_brackets(3, brackets, name="sl(2)", representation=rho, casimirs={"x1*x3 + x2^2": casimir})


def e(n: int = 3) -> LieAlgebra:
    """Return e(3), the rigid motions of space: rotations e1-e3 and translations e4-e6.

    The state is the angular momentum m (x1-x3) and p (x4-x6): the weight vector of a heavy top, or the linear momentum
    of a body in a fluid.

    Parameters
    ----------
    n : int, optional
        Only 3 is in the catalogue.

    Returns
    -------
    LieAlgebra
        With the 4 x 4 representation by affine matrices and the Casimirs ``"|p|^2"`` = x4^2 + x5^2 + x6^2 and
        ``"m.p"`` = x1 x4 + x2 x5 + x3 x6.

    Raises
    ------
    ValueError
        n is not 3.

    Examples
    --------
    >>> e(3).casimirs_known["m.p"]
    x1*x4 + x2*x5 + x3*x6
    """
    if _whole(n, 2, "n of e(n)") != 3:
        raise ValueError(f"the catalogue has e(3) only, not e({n}): build it with LieAlgebra(constants)")
    rows = []
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        rows += [(a, b, c, 1.0), (a, b + 3, c + 3, 1.0), (b, a + 3, c + 3, -1.0)]
    rho = np.zeros((6, 4, 4))
    rho[:3, :3, :3] = HAT
    rho[[3, 4, 5], [0, 1, 2], 3] = 1.0
    x = [Polynomial.variable(i, 6) for i in range(6)]
    casimirs = {"|p|^2": _square(6, 3), "m.p": x[0] * x[3] + x[1] * x[4] + x[2] * x[5]}
    return LieAlgebra(rows, dim=6, name="e(3)", representation=rho, casimirs=casimirs)


def heisenberg(n: int = 1) -> LieAlgebra:
    """Return the Heisenberg algebra: [q_i, p_i] = z, in the order q1 ... qn, p1 ... pn, z.

    With the central coordinate z fixed to 1 it carries canonical variables.

    Parameters
    ----------
    n : int, optional
        Number of pairs, from 1; the dimension is 2 n + 1.

    Returns
    -------
    LieAlgebra
        With the representation by (n + 2) x (n + 2) upper triangular matrices and the Casimir ``"z"``.

    Raises
    ------
    ValueError
        n is not an integer from 1 up.

    Examples
    --------
    >>> heisenberg().basis
    ('q1', 'p1', 'z')
    """
    n = _whole(n, 1, "n of heisenberg(n)")
    basis = [f"q{i}" for i in range(1, n + 1)] + [f"p{i}" for i in range(1, n + 1)] + ["z"]
    rho = np.zeros((2 * n + 1, n + 2, n + 2))
    rho[range(n), 0, range(1, n + 1)] = 1.0
    rho[range(n, 2 * n), range(1, n + 1), n + 1] = 1.0
    rho[2 * n, 0, n + 1] = 1.0
    return LieAlgebra(
        [(i, n + i, 2 * n, 1.0) for i in range(n)],
        dim=2 * n + 1,
        basis=basis,
        name=f"heisenberg({n})",
        representation=rho,
        casimirs={"z": Polynomial.variable(2 * n, 2 * n + 1)},
    )


def A3_7(a: float) -> LieAlgebra:
    """Return A_{3,7}: [e1, e3] = a e1 - e2, [e2, e3] = e1 + a e2; spirals (Bianchi VII_h), not unimodular for a != 0.

    Parameters
    ----------
    a : float
        Any finite number; 0 gives e(2).

    Returns
    -------
    LieAlgebra
        With a 3 x 3 representation by affine matrices, and the Casimir ``"log C"``, log(x1^2 + x2^2) - 2 a theta with
        theta = atan2(x2, x1): multivalued, with period 4 pi abs(a).

    Raises
    ------
    TypeError, ValueError
        a is not a finite real number.

    References
    ----------
    S. Reich, Numerical integration of the generalized Euler equations, section 5.1; J. Patera, R. T. Sharp,
    P. Winternitz, H. Zassenhaus, J. Math. Phys. 17 (1976) 986.

    Examples
    --------
    >>> A3_7(2.0).casimirs_known["log C"]([1.0, 0.0, 5.0])
    0.0
    """
    try:
        a = float(a)
    except (TypeError, ValueError):
        raise TypeError(f"a of A3_7 must be a real number, not {a!r}") from None
    if not math.isfinite(a):
        raise ValueError(f"a of A3_7 must be finite, not {a}")

    def value(x: Any) -> Any:
        return math.log(x[0] * x[0] + x[1] * x[1]) - 2.0 * a * math.atan2(x[1], x[0])

    def gradient(x: Any) -> Any:
        half = 0.5 * (x[0] * x[0] + x[1] * x[1])
        return np.array([(x[0] + a * x[1]) / half, (x[1] - a * x[0]) / half, 0.0])

    brackets = {(0, 2): {0: a, 1: -1.0}, (1, 2): {0: 1.0, 1: a}}
    rho = np.zeros((3, 3, 3))
    rho[[0, 1], [0, 1], 2] = 1.0
    rho[2, :2, :2] = [[-a, -1.0], [1.0, -a]]
    casimirs = {"log C": Invariant(value, gradient, period=4.0 * math.pi * abs(a))}
    return LieAlgebra.from_brackets(3, brackets, name=f"A3_7(a={a:g})", representation=rho, casimirs=casimirs)


_FAMILIES: dict[str, Callable[..., LieAlgebra]] = {"so": so, "sl": sl, "e": e, "heisenberg": heisenberg, "A3_7": A3_7}
_NAMES = ("A3_7", "e(3)", "heisenberg", "sl(2)", "so(2)", "so(3)", "so(4)", "so(n)")


def names() -> tuple[str, ...]:
    """Return the names that `get` knows; ``so(n)`` and ``heisenberg`` stand for any n.

    Examples
    --------
    >>> names()
    ('A3_7', 'e(3)', 'heisenberg', 'sl(2)', 'so(2)', 'so(3)', 'so(4)', 'so(n)')
    """
    return _NAMES


def get(name: str, **parameters: Any) -> LieAlgebra:
    """Return an algebra of the catalogue by name.

    Parameters
    ----------
    name : str
        One of `names`; any n may be written in ``"so(5)"`` or ``"heisenberg(2)"``; ``"A3,7"`` is ``"A3_7"``.
    **parameters
        Parameters of the function of that name: ``a`` of A3_7, ``n`` of so and heisenberg where the name has no number.

    Returns
    -------
    LieAlgebra

    Raises
    ------
    ValueError
        The name is unknown, or a parameter is missing, unknown, or out of range.
    TypeError
        The name is not a string, or a parameter not a number.

    Examples
    --------
    >>> get("so(5)")
    LieAlgebra('so(5)', dim=10)
    >>> get("A3,7", a=2.0) == A3_7(2.0)
    True
    """
    if not isinstance(name, str):
        raise TypeError(f"name of an algebra must be a string, not {name!r}")
    match = re.fullmatch(r"(so|sl|e|heisenberg)\((n|\d+)\)|(A3[_,]7|heisenberg)", name.strip())
    if match is None:
        raise unknown_name("algebra", name, _NAMES)
    family = (match[1] or match[3]).replace(",", "_")
    build = _FAMILIES[family]
    expected = set(inspect.signature(build).parameters)
    if match[2] and match[2] != "n":
        expected, fixed = set(), {"n": int(match[2])}
    else:
        fixed = {}
        required = {key for key, p in inspect.signature(build).parameters.items() if p.default is p.empty}
        missing = sorted(required - set(parameters))
        if missing:
            raise ValueError(
                f"algebra {name!r} needs the parameter {missing[0]!r}, as in get({name!r}, {missing[0]}=...)"
            )
    extra = sorted(set(parameters) - expected)
    if extra:
        accepted = ", ".join(sorted(expected)) or "none"
        raise ValueError(f"algebra {name!r} has no parameter {extra[0]!r}; it takes: {accepted}")
    return build(**fixed, **parameters)
