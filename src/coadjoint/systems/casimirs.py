"""Are the functions that a user calls Casimirs constant along every motion of the bracket?"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.invariant import Invariant
from coadjoint.algebra.polynomial import Polynomial
from coadjoint.systems.points import UNIT_ROUNDOFF
from coadjoint.systems.user_functions import sample_points

Product = Callable[[npt.NDArray[np.float64], npt.NDArray[np.float64]], npt.NDArray[np.float64]]


def checked_casimirs(casimirs: Mapping[str, Any], n: int, product: Product, size: Product) -> dict[str, Any]:
    """Return the Casimirs by name, plain functions wrapped, each one checked where its gradient is known.

    Parameters
    ----------
    casimirs : mapping
        Name to `Polynomial`, `Invariant` or function of x.
    n : int
        Dimension of the system.
    product : callable
        ``product(x, u)`` is J(x) u.
    size : callable
        ``size(x, u)`` is the sum of the absolute products in each component of it.

    Returns
    -------
    dict
        Name to `Polynomial` or `Invariant`.

    Raises
    ------
    TypeError
        Not a mapping, or an entry is neither polynomial nor function.
    ValueError
        ``J(x) grad C(x)`` is not zero at a sample point; the Casimir is named.

    Notes
    -----
    The tolerance is u times the number of operations, times the sum of the absolute products, for a polynomial.
    The gradient of an `Invariant` is a function of unknown rounding: it may lose 20 bits.
    """
    if not isinstance(casimirs, Mapping):
        raise TypeError(f"casimirs is a {type(casimirs).__name__}; give a mapping from name to Polynomial or Invariant")
    result: dict[str, Any] = {}
    for name, given in casimirs.items():
        if isinstance(given, Polynomial | Invariant):
            casimir = given
        elif callable(given):
            casimir = Invariant(given)
        else:
            raise TypeError(f"the Casimir {name!r} is {given!r}; give a Polynomial, an Invariant or a function of x")
        if isinstance(casimir, Polynomial) and casimir.dim != n:
            raise ValueError(f"the Casimir {name!r} has {casimir.dim} variables but the system has dimension {n}")
        if casimir.gradient is not None:
            _check(str(name), casimir, n, product, size)
        result[str(name)] = casimir
    return result


def _check(name: str, casimir: Polynomial | Invariant, n: int, product: Product, size: Product) -> None:
    gradient: Any = casimir.gradient
    for x in sample_points(n):
        with np.errstate(all="ignore"):
            slope = np.asarray(gradient(x), dtype=np.float64)
        if slope.shape != (n,):
            raise ValueError(f"the gradient of the Casimir {name!r} has shape {slope.shape}; it must have ({n},)")
        if not np.all(np.isfinite(slope)):
            continue
        if isinstance(casimir, Polynomial):
            monomials: dict[tuple[int, ...], Any] = {e: abs(c) for e, c in casimir.monomials.items()}
            absolute = Polynomial(monomials, dim=n)
            bound = np.asarray(absolute.gradient(np.abs(x)), dtype=np.float64)
            operations = 64 + 2 * n + len(casimir.monomials) + casimir.degree
        else:
            bound, operations = np.abs(slope), 2**20
        defect = np.abs(product(x, slope))
        tolerance = operations * UNIT_ROUNDOFF * size(x, bound).max(initial=0.0)
        if defect.max(initial=0.0) > tolerance:
            i = int(np.argmax(defect))
            raise ValueError(
                f"{name!r} is not a Casimir: component {i} of J(x) grad C(x) is {defect[i]:.3g} at a sample point, "
                "and it must vanish everywhere"
            )
