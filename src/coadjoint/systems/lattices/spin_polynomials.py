"""Energies of spins of degree four and six: biquadratic couplings of bonds and Stevens functions of sites."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product as products
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.polynomial import SparseMonomials, SparsePolynomial
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.summable import SeparatePolynomial
from coadjoint.systems.lattices.bonds import MATRIX_TOLERANCE, Site
from coadjoint.validation import read_number

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
SitePolynomial = dict[tuple[int, int, int], float]
"""Coefficients of the monomials of a direction (x, y, z)."""

STEVENS: Mapping[tuple[int, int], tuple[int, ...]] = {
    (2, 0): (3, 0, -1),
    (2, 1): (1, 0),
    (2, 2): (1,),
    (4, 0): (35, 0, -30, 0, 3),
    (4, 1): (7, 0, -3, 0),
    (4, 2): (7, 0, -1),
    (4, 3): (1, 0),
    (4, 4): (1,),
    (6, 0): (231, 0, -315, 0, 105, 0, -5),
    (6, 1): (33, 0, -30, 0, 5, 0),
    (6, 2): (33, 0, -18, 0, 1),
    (6, 3): (11, 0, -3, 0),
    (6, 4): (11, 0, -1),
    (6, 5): (1, 0),
    (6, 6): (1,),
}
"""(l, m) -> coefficients of P(z), the highest power first, of the Stevens functions P(z) Re (x + iy)^m for m >= 0 and
P(z) Im (x + iy)^-m of a direction.
"""
NAMES = tuple(f"B{degree}{m}" for degree in (2, 4, 6) for m in range(-degree, degree + 1))
BYTES_PER_MONOMIAL = 2000  # at the peak of a decomposition, measured


def stevens(degree: int, m: int) -> SitePolynomial:
    """Return the Stevens function of a degree and a number m of either sign as a polynomial of a direction."""
    found: SitePolynomial = {}
    n, of_z = abs(m), STEVENS[degree, abs(m)]
    for k in range(n + 1):  # x^(n - k) (iy)^k
        if k % 2 == (m < 0):
            factor = math.comb(n, k) * (-1) ** (k // 2)
            for power, c in enumerate(reversed(of_z)):
                if c:
                    found[n - k, k, power] = float(factor * c)
    return found


def not_empty(coefficients: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return a copy of Stevens coefficients; ValueError if there are none."""
    if not coefficients:
        raise ValueError("the Stevens coefficients are empty; give some, such as {'B20': 0.1, 'B43': -0.02}")
    return dict(coefficients)


def read_stevens(coefficients: Mapping[Any, Any], length: float) -> tuple[Floats, dict[int, SitePolynomial]]:
    """Return the matrix of degree two and polynomials by higher degree, of directions of a spin of a length."""
    matrix, total = np.zeros((3, 3)), dict[int, SitePolynomial]()
    for name, given in coefficients.items():
        degree, m, value = read_coefficient(name, given)
        factor, polynomial = value * length**degree, stevens(degree, m)
        if degree == 2:
            matrix += factor * _quadratic(polynomial)
        else:
            own = total.setdefault(degree, {})
            for exponents, c in polynomial.items():
                own[exponents] = own.get(exponents, 0.0) + factor * c
    return matrix, total


def read_coefficient(name: Any, given: Any) -> tuple[int, int, float]:
    """Validate the name and the value of a Stevens coefficient; return its degree, m and the value."""
    if name not in NAMES:
        raise ValueError(f"there is no Stevens coefficient {short(name)}; give some of B20, B21, B2-1, ..., B66, B6-6")
    return int(name[1]), int(name[2:]), read_number(given, f"the coefficient {name}")


def _quadratic(polynomial: SitePolynomial) -> Floats:
    """Return the matrix A of n . A n, of a polynomial of degree two; its constant is a multiple of n^2."""
    matrix = np.zeros((3, 3))
    for exponents, c in polynomial.items():
        axes = [axis for axis, e in enumerate(exponents) for _ in range(e)]
        if axes:
            matrix[axes[0], axes[1]] += 0.5 * c
            matrix[axes[1], axes[0]] += 0.5 * c
        else:
            matrix += c * np.eye(3)
    return matrix


def propagated(site: Site, polynomial: SitePolynomial, checked: bool = True) -> list[SitePolynomial]:
    """Return the polynomials of all equivalent sites; ValueError if symmetry does not allow the given one."""
    if not checked:
        return [turned(polynomial, turn) for turn in site._rotations]
    points = directions()
    here = values_of(polynomial, points)
    mean = np.mean([values_of(polynomial, points @ turn) for turn in site._kept], axis=0)
    if np.abs(here - mean).max() > MATRIX_TOLERANCE * np.abs(here).max():
        raise ValueError(
            f"the Stevens coefficients are not allowed by symmetry on site {site.label} {site.number}, in whose frame, "
            f"the Cartesian one of the lattice, it allows {_allowed(site)}; give these"
        )
    return [turned(polynomial, turn) for turn in site._rotations]


def directions() -> Floats:
    """Return directions that tell functions of degree six apart."""
    turns, heights = np.meshgrid(2.0 * np.pi * np.arange(13) / 13.0, np.linspace(-0.93, 0.95, 9))
    radii = np.sqrt(1.0 - heights**2)
    return np.stack([radii * np.cos(turns), radii * np.sin(turns), heights], axis=-1).reshape(-1, 3)


def values_of(polynomial: SitePolynomial, points: Floats | None = None) -> Floats:
    """Return the values of a polynomial at directions, by default many that tell polynomials apart."""
    points = directions() if points is None else points
    return np.asarray(sum(c * np.prod(points ** np.array(e), axis=1) for e, c in polynomial.items()))


def _allowed(site: Site) -> str:
    """Return the combinations of Stevens functions of each degree that symmetry allows, as text."""
    points, found = directions(), []
    for degree in (2, 4, 6):
        functions = [stevens(degree, m) for m in range(-degree, degree + 1)]
        own = np.stack([values_of(one, points) for one in functions], axis=1)
        means = np.mean([[values_of(one, points @ turn) for one in functions] for turn in site._kept], axis=0)
        projection = np.linalg.lstsq(own, means.T, rcond=None)[0]
        for k, m in enumerate(range(-degree, degree + 1)):
            if np.abs(projection[k]).max() > 1e-9:
                tied = [j for j in range(2 * degree + 1) if j != k and abs(projection[j, k]) > 1e-9]
                found.append(f"B{degree}{m}" + " (with others)" * bool(tied))
    return ", ".join(found) or "none"


def turned(polynomial: SitePolynomial, turn: Floats) -> SitePolynomial:
    """Return the polynomial p(R^T n)."""
    rows = turn.T.tolist()
    total: SitePolynomial = {}
    for exponents, c in polynomial.items():
        factors: list[SitePolynomial] = [_power(rows[axis], e) for axis, e in enumerate(exponents)]
        for chosen in products(*(factor.items() for factor in factors)):
            x, y, z = (sum(e[axis] for e, _ in chosen) for axis in range(3))
            total[x, y, z] = total.get((x, y, z), 0.0) + c * math.prod(v for _, v in chosen)
    size = max(map(abs, total.values()))
    return {key: value for key, value in total.items() if abs(value) > 1e-14 * size}


def _power(row: Sequence[float], exponent: int) -> SitePolynomial:
    """Return a power of a linear form."""
    found: SitePolynomial = {}
    for a in range(exponent + 1):
        for b in range(exponent + 1 - a):
            factor = math.comb(exponent, a) * math.comb(exponent - a, b)
            value = factor * row[0] ** a * row[1] ** b * row[2] ** (exponent - a - b)
            if value:
                found[a, b, exponent - a - b] = float(value)
    return found


def polynomial_of_spins(
    count: int,
    edges: Integers,
    strengths: Floats,
    turns: tuple[Floats, Integers],
    on_sites: Sequence[tuple[Integers, Floats, SitePolynomial]],
) -> Any:
    """Return the sum of strengths (S_i . R S_j)^2 over edges, and of polynomials of directions of sites times factors.

    `turns` are the distinct rotations R and the number of that of each edge.
    """
    number = 9 * len(edges) + sum(len(sites) * len(one) for sites, _, one in on_sites)
    check_available_memory(BYTES_PER_MONOMIAL * number, f"{number} monomials of {count} spins", "take fewer cells")
    total: SparseMonomials = {}

    def add(coordinates: Sequence[int], value: float) -> None:
        key = tuple((k, coordinates.count(k)) for k in sorted({*coordinates}))
        total[key] = total.get(key, 0.0) + value

    entries = [[(a, b, float(R[a, b])) for a in range(3) for b in range(3) if R[a, b]] for R in turns[0]]
    for (i, j), strength, turn in zip((3 * edges).tolist(), strengths.tolist(), turns[1].tolist(), strict=True):
        for (a, b, first), (c, d, second) in products(entries[turn], repeat=2):
            add((i + a, i + c, j + b, j + d), strength * first * second)
    for sites, scales, polynomial in on_sites:
        for site, scale in zip((3 * sites).tolist(), scales.tolist(), strict=True):
            for exponents, c in polynomial.items():
                add([site + axis for axis, e in enumerate(exponents) for _ in range(e)], scale * c)
    low = {key: c for key, c in total.items() if sum(e for _, e in key) <= 2}  # of Stevens functions with r = 1
    high = SeparatePolynomial(SparsePolynomial({key: c for key, c in total.items() if key not in low}, 3 * count))
    return Quadratic.from_polynomial(SparsePolynomial(low, 3 * count)) + high if low else high
