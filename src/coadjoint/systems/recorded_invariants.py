"""Casimirs and integrals of a system: validation, and a search for the Casimirs of its algebra."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.user_functions import evaluate, sample_points

# Systems search for Casimirs automatically up to this number of monomials times constants per coordinate, which takes
# a fraction of a second.
MAX_SEARCH_SIZE = 5000
MAX_SEARCH_DEGREE = 4

Product = Callable[[npt.NDArray[np.float64], npt.NDArray[np.float64]], npt.NDArray[np.float64]]


class KnownInvariants(Mapping[str, Any]):
    """Invariants that are valid by construction, each by a function that makes it whenever it is read."""

    def __init__(self, makers: Mapping[str, Callable[[], Any]]) -> None:
        self._makers = dict(makers)

    def __getitem__(self, name: str) -> Any:
        return self._makers[name]()

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)


def read_casimirs(casimirs: Mapping[str, Any], n: int, product: Product, size: Product) -> dict[str, Any]:
    """Validate Casimirs by name; wrap plain functions, and check ``J(x) grad C(x) = 0`` at sample points."""
    # ``product(x, u)`` is J(x) u, and ``size(x, u)`` the sum of absolute products in each component. The tolerance is u
    # times the number of operations times that sum for polynomials; gradients of an `Invariant` may lose 20 bits.
    if isinstance(casimirs, KnownInvariants):
        return dict(casimirs)
    result = read_invariants(casimirs, n, "Casimir")
    for name, casimir in result.items():
        if casimir.gradient is not None:
            _check(name, casimir, n, product, size)
    return result


def read_invariants(argument: Any, n: int, kind: str) -> dict[str, Any]:
    """Validate invariants in n coordinates by name; functions are wrapped. `kind` is their name in messages."""
    if not isinstance(argument, Mapping):
        raise TypeError(
            f"{kind.lower()}s is a {type(argument).__name__}; give a mapping from name to Polynomial or Invariant"
        )
    result: dict[str, Any] = {}
    for name, invariant in argument.items():
        if name == "energy":
            article = "an" if kind[0] in "aeiou" else "a"
            raise ValueError(
                f"{article} {kind} is called 'energy', which is the name of the Hamiltonian; choose another name"
            )
        if not isinstance(invariant, Polynomial | Quadratic | Invariant):
            if not callable(invariant):
                raise TypeError(
                    f"the {kind} {short(name)} is {short(invariant)}; "
                    "give a Polynomial, a Quadratic, an Invariant or a function of x"
                )
            invariant = Invariant(invariant)
        if isinstance(invariant, Polynomial) and invariant.dim != n:
            raise ValueError(f"the {kind} {short(name)} has {invariant.dim} variables but the system has dimension {n}")
        result[str(name)] = invariant.bind(n) if isinstance(invariant, Quadratic) else invariant
    return result


# Algebras are immutable and compare by value, so a scan over Hamiltonians searches once.
_CASIMIR_CACHE: WeakKeyDictionary[LieAlgebra, dict[str, Polynomial]] = WeakKeyDictionary()


def known_or_found_casimirs(algebra: LieAlgebra) -> Mapping[str, Any]:
    """Return the known Casimirs of an algebra or, if some are missing, those of a quick search."""
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
    casimirs = _CASIMIR_CACHE[algebra]
    return casimirs if len(casimirs) > len(known) else known


def _search_size(dim: int, degree: int, constants: int) -> float:
    return math.comb(dim + degree - 1, degree) * max(1.0, constants / dim)


def gradient_and_scale(
    name: str, invariant: Any, x: npt.NDArray[np.float64], kind: str = "Casimir"
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], int] | None:
    """Return gradient (n,) at a point, sums of its absolute products (n,), and their number; None if not finite."""
    n = x.size
    with np.errstate(all="ignore"):
        gradient, size, operations = invariant.gradient_and_size(x)
    if gradient.shape != (n,):
        raise ValueError(f"the gradient of the {kind} {short(name)} has shape {gradient.shape}; it must have ({n},)")
    if not np.all(np.isfinite(gradient)):
        return None
    return np.asarray(gradient, dtype=np.float64), np.asarray(size, dtype=np.float64), operations


def _check(name: str, casimir: Polynomial | Quadratic | Invariant, n: int, product: Product, size: Product) -> None:
    for x in sample_points(n):
        scaled = gradient_and_scale(name, casimir, x)
        if scaled is None:
            continue
        gradient, bound, operations = scaled
        defect = np.abs(product(x, gradient))
        tolerance = operations * UNIT_ROUNDOFF * size(x, bound).max(initial=0.0)
        if defect.max(initial=0.0) > tolerance:
            i = int(np.argmax(defect))
            raise ValueError(
                f"{short(name)} is not a Casimir: component {i} of J(x) grad C(x) is {defect[i]:.3g} at a sample "
                "point, and it must vanish everywhere"
            )


TIMES = (0.0, 1.0)  # at which integrals are checked: a field may rest at time zero


@ignore_overflow
def read_integrals(integrals: Any, H: HamiltonianLike, n: int, product: Product, size: Product) -> Mapping[str, Any]:
    """Validate integrals by name; check ``grad F(x) . J(x) grad H(x) = 0`` at sample points where grad F is known."""
    if isinstance(integrals, KnownInvariants):
        return integrals
    result = read_invariants(integrals, n, "integral")
    points = sample_points(n) if any(F.gradient is not None for F in result.values()) else []
    for x in points:
        for t in TIMES if H.timed else TIMES[:1]:
            force = evaluate(lambda y, t=t: H.gradient(y, t), x, False)
            if force is None or not np.all(np.isfinite(force)):
                continue
            bound, work = np.abs(force), 2**20
            if hasattr(H, "gradient_and_size"):
                _, bound, work = gradient_and_scale("energy", H, x) or (force, bound, work)
            field, sizes = product(x, force), size(x, bound)
            for name, F in result.items():
                scaled = None if F.gradient is None else gradient_and_scale(name, F, x, "integral")
                if scaled is None:
                    continue
                gradient, scale, operations = scaled
                # Products of long vectors by BLAS wait for its threads.
                rate = abs(float(np.sum(gradient * field)))
                if rate > (work + operations) * UNIT_ROUNDOFF * float(np.sum(scale * sizes)):
                    raise ValueError(
                        f"{short(name)} is not an integral: it changes at the rate {rate:.3g} at a sample point, and "
                        "its bracket with the Hamiltonian must vanish everywhere"
                    )
    return result
