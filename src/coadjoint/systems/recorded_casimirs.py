"""Casimirs of a system: validation of given ones, and a search for those of its algebra."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, cast
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import scatter
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.terms import QuadraticTerm
from coadjoint.systems.user_functions import sample_points

# Systems search for Casimirs automatically up to this number of monomials times constants per coordinate, which takes
# a fraction of a second.
MAX_SEARCH_SIZE = 5000
MAX_SEARCH_DEGREE = 4

Product = Callable[[npt.NDArray[np.float64], npt.NDArray[np.float64]], npt.NDArray[np.float64]]


def checked_casimirs(casimirs: Mapping[str, Any], n: int, product: Product, size: Product) -> dict[str, Any]:
    """Validate Casimirs by name; wrap plain functions, and check ``J(x) grad C(x) = 0`` at sample points.

    ``product(x, u)`` is J(x) u, and ``size(x, u)`` the sum of absolute products in each component. The tolerance is u
    times the number of operations times that sum for polynomials; gradients of an `Invariant` may lose 20 bits.
    """
    result = read_invariants(casimirs, n, "Casimir")
    for name, casimir in result.items():
        if casimir.gradient is not None:
            _check(name, casimir, n, product, size)
    return result


def read_invariants(argument: Any, n: int, kind: str) -> dict[str, Any]:
    """Validate invariants in n coordinates by name: `Polynomial`, `Quadratic`, `Invariant` or a function (wrapped).

    `kind` is what messages call one of them.
    """
    if not isinstance(argument, Mapping):
        raise TypeError(
            f"{kind.lower()}s is a {type(argument).__name__}; give a mapping from name to Polynomial or Invariant"
        )
    result: dict[str, Any] = {}
    for name, one in argument.items():
        if name == "energy":
            article = "an" if kind[0] in "aeiou" else "a"
            raise ValueError(
                f"{article} {kind} is called 'energy', which is the name of the Hamiltonian; choose another name"
            )
        if not isinstance(one, Polynomial | Quadratic | Invariant) and not callable(one):
            raise TypeError(
                f"the {kind} {short(name)} is {short(one)}; "
                "give a Polynomial, a Quadratic, an Invariant or a function of x"
            )
        if isinstance(one, Polynomial) and one.dim != n:
            raise ValueError(f"the {kind} {short(name)} has {one.dim} variables but the system has dimension {n}")
        known = isinstance(one, Polynomial | Invariant)
        result[str(name)] = one if known else one.bind(n) if isinstance(one, Quadratic) else Invariant(one)
    return result


# Algebras are immutable and compare by value, so a scan over Hamiltonians searches once.
_CASIMIR_CACHE: WeakKeyDictionary[LieAlgebra, dict[str, Polynomial]] = WeakKeyDictionary()


def known_or_found_casimirs(algebra: LieAlgebra) -> Mapping[str, Any]:
    """Return the known Casimirs of an algebra or, if some are missing, those of a quick search.

    ``algebra.casimirs(max_degree)`` searches further.

    Examples
    --------
    >>> from coadjoint.algebra.lie_algebra import LieAlgebra
    >>> g = LieAlgebra.from_brackets(3, {(0, 1): {2: 1.0}, (1, 2): {0: 1.0}, (2, 0): {1: 1.0}})
    >>> dict(known_or_found_casimirs(g))
    {'C2': x1^2 + x2^2 + x3^2}
    """
    known = algebra.casimirs_known
    constants = len(algebra.triples.c)
    # A nonzero bracket has rank at least two.
    if constants == 0 or (known and len(known) >= algebra.dim - 2):
        return known
    degree = max(
        (d for d in range(1, MAX_SEARCH_DEGREE + 1) if _search_size(algebra.dim, d, constants) <= MAX_SEARCH_SIZE),
        default=0,
    )
    if degree < 2 or (known and len(known) >= algebra.dim - algebra.generic_rank()):
        return known
    if algebra not in _CASIMIR_CACHE:
        try:
            _CASIMIR_CACHE[algebra] = algebra.casimirs(degree)
        except ValueError:  # undecidable with rounded constants
            _CASIMIR_CACHE[algebra] = {}
    found = _CASIMIR_CACHE[algebra]
    return found if len(found) > len(known) else known


def _search_size(dim: int, degree: int, constants: int) -> float:
    return math.comb(dim + degree - 1, degree) * max(1.0, constants / dim)


def gradient_and_scale(
    name: str, invariant: Polynomial | Quadratic | Invariant, x: npt.NDArray[np.float64], kind: str = "Casimir"
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], int] | None:
    """Return gradient (n,) at a point, sums of its absolute products (n,), and their number; None if it is not finite.

    `name` and `kind` are for messages.
    """
    n, gradient = x.size, cast(Any, invariant.gradient)
    with np.errstate(all="ignore"):
        slope = np.asarray(gradient(x), dtype=np.float64)
    if slope.shape != (n,):
        raise ValueError(f"the gradient of the {kind} {short(name)} has shape {slope.shape}; it must have ({n},)")
    if not np.all(np.isfinite(slope)):
        return None
    if isinstance(invariant, Polynomial):
        monomials: dict[tuple[int, ...], Any] = {e: abs(c) for e, c in invariant.monomials.items()}
        absolute = Polynomial(monomials, dim=n)
        size = np.asarray(absolute.gradient(np.abs(x)), dtype=np.float64)
        return slope, size, 64 + 2 * n + len(invariant.monomials) + invariant.degree
    if isinstance(invariant, Quadratic):
        (term,) = invariant.terms()
        assert isinstance(term, QuadraticTerm)
        size = scatter(term.rows, np.abs(term.values * x[term.indices]), n) + np.abs(term.linear)
        return slope, size, 64 + 2 * n + len(term.values)
    return slope, np.abs(slope), 2**20


def _check(name: str, casimir: Polynomial | Quadratic | Invariant, n: int, product: Product, size: Product) -> None:
    for x in sample_points(n):
        found = gradient_and_scale(name, casimir, x)
        if found is None:
            continue
        slope, bound, operations = found
        defect = np.abs(product(x, slope))
        tolerance = operations * UNIT_ROUNDOFF * size(x, bound).max(initial=0.0)
        if defect.max(initial=0.0) > tolerance:
            i = int(np.argmax(defect))
            raise ValueError(
                f"{short(name)} is not a Casimir: component {i} of J(x) grad C(x) is {defect[i]:.3g} at a sample "
                "point, and it must vanish everywhere"
            )
