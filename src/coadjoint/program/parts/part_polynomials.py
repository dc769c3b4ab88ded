"""Parts as polynomials: pieces of the Hamiltonian, terms of rational rotations, Taylor polynomials of functions."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import exact_number, fraction, rational
from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials
from coadjoint.algebra.polynomials.monomials import Exponents, exponents_of
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.program.parts.part import GradientShare, Parts
from coadjoint.program.sparse_rows import sparse_row
from coadjoint.program.term_table import derivative_of
from coadjoint.systems.hamiltonians.terms import FunctionTerm

# Completed squares may have numerators of thousands of digits; above this size floats are used, as in a run.
MAX_BITS = 512

MAX_EVALUATIONS = 2**15
"""Largest number of evaluations on one circle, or product of circles, around a point."""

RADII = tuple(2.0**-k for k in range(8))
"""Radii of the circles, relative to the size of the point; the two with the best agreement are used."""

MAX_RELATIVE_ERROR = 1e-6
"""Relative disagreement above which a function counts as not analytic."""


def part_polynomials(ring: ExactPolynomials, parts: Parts) -> list[Exact]:
    """Return the piece of the Hamiltonian of each part, whose gradient is sum_a l_a theta_a."""
    pieces = [ring.zero for _ in range(len(parts))]
    for angle, p in enumerate(parts.part_of_angle.tolist()):
        pieces[p] += _linear_angle(ring, parts, angle)
    for s, share in parts.gradients.items():
        if share.term is not None:
            raise TypeError("a part of the Hamiltonian is a function of Python, not a polynomial")
        if share.polynomial is not None:
            pieces[int(parts.part_of_angle[parts.row[s]])] += ring.from_polynomial(share.polynomial)
    return pieces


def _linear_angle(ring: ExactPolynomials, parts: Parts, angle: int) -> Exact:
    form = linear_form(ring, *sparse_row(parts.forms, angle))
    weights = linear_form(ring, *sparse_row(parts.weights, angle))
    return form * (weights / 2 + to_rational(parts.offset[angle]))


def linear_form(ring: ExactPolynomials, coordinates: list[int], values: list[Any]) -> Exact:
    """Return a linear form as a polynomial."""
    total = ring.zero
    for i, value in zip(coordinates, values, strict=True):
        total += ring.coordinates[i] * to_rational(value)
    return total


def to_rational(value: Any) -> Any:
    """Convert a number to a rational one; above `MAX_BITS` it is first rounded to float64, as in a run."""
    exact = Fraction(exact_number(value))
    long = exact.numerator.bit_length() + exact.denominator.bit_length() > MAX_BITS
    return rational(float(exact) if long else exact)


def with_hamiltonian_coefficients(
    ring: ExactPolynomials, parts: Parts, pieces: Sequence[Exact], H: Polynomial, factors: Mapping[Exponents, Exact]
) -> list[Exact]:
    """Replace coefficients of pieces by those of H, without Casimirs subtracted, or by polynomials `factors`.

    Parts not made of monomials of H are unchanged; with symbols they raise ValueError.
    """
    lengths, values = np.diff(parts.forms.start), parts.forms.value
    unit_forms = bool(np.all(lengths == 1) and np.all(np.asarray(values == 1, dtype=bool)))
    n = ring.dim
    replaced = []
    for piece in pieces:
        total = ring.zero
        for exponents, value in piece.to_dict().items():
            powers = tuple(map(int, exponents[:n]))
            coefficient = H.monomials.get(powers)
            matches = unit_forms and coefficient is not None and float(coefficient) == float(fraction(value))
            if powers in factors and not matches:
                raise ValueError(
                    "symbols stand for the coefficients of H, but a part is made of completed squares or shares a "
                    "monomial with another part; give M a diagonal, or parts of commuting coordinates"
                )
            if matches and coefficient is not None:
                total += ring.monomial(powers) * (factors[powers] if powers in factors else rational(coefficient))
            else:
                total += ring.monomial(powers) * value
        replaced.append(total)
    return replaced


def rational_pieces(
    ring: ExactPolynomials, parts: Parts, frequency: NDArray[Any], highest: int
) -> list[dict[int, Exact]]:
    """Return by part {j: h^j coefficient}, j = 3, 5, ..., that rational rotations add to its piece.

    They are the exact flow of K(s; h), K' = theta - (h w/2)^2 theta^3/3 + ..., for angles theta of s = l.x alone.
    """
    terms: list[dict[int, Exact]] = [{} for _ in range(len(parts))]
    share_of_angle = {
        int(parts.row[s]) + k: (share.polynomial, i)
        for s, share in parts.gradients.items()
        if share.polynomial is not None
        for k, i in enumerate(share.coordinates)
    }
    for angle, p in enumerate(parts.part_of_angle.tolist()):
        w = rational(frequency[angle])
        if w == 0:
            continue
        s = linear_form(ring, *sparse_row(parts.forms, angle))
        theta = _angle(ring, parts, angle, *share_of_angle.get(angle, (None, 0)))
        power = theta
        for j in range(3, highest + 1, 2):
            power = _times(_times(power, theta), theta)
            factor = (-1) ** (j // 2) * (w / 2) ** (j - 1) / j
            K = ring.zero
            for k, c in enumerate(power):
                if c != 0:
                    K += s ** (k + 1) * (c * factor / (k + 1))
            terms[p][j] = terms[p].get(j, ring.zero) + K
    return terms


def _angle(
    ring: ExactPolynomials, parts: Parts, angle: int, polynomial: Polynomial | None, coordinate: int
) -> list[Any]:
    """Return the coefficients of an angle as a polynomial in its own form."""
    if polynomial is not None:
        coefficients = [rational(0)] * polynomial.degree
        for exponents, value in polynomial.monomials.items():
            if exponents[coordinate]:
                coefficients[exponents[coordinate] - 1] += rational(value) * exponents[coordinate]
        return coefficients
    _, form = sparse_row(parts.forms, angle)
    _, weights = sparse_row(parts.weights, angle)
    slope = to_rational(weights[0]) / to_rational(form[0]) if weights else rational(0)
    return [to_rational(parts.offset[angle]), slope]


def _times(left: list[Any], right: list[Any]) -> list[Any]:
    result = [rational(0)] * (len(left) + len(right) - 1)
    for i, x in enumerate(left):
        for j, y in enumerate(right):
            result[i + j] += x * y
    return result


def parts_at(parts: Parts, x: NDArray[np.float64], degree: int) -> Parts:
    """Replace functions in time-independent parts by Taylor polynomials of a degree at the point x (n,)."""
    gradients: dict[int, GradientShare] = {}
    for s, share in parts.gradients.items():
        if share.term is not None:
            local = taylor_polynomial(share.term, x[share.term.coordinates], degree)
            share = GradientShare(share.coordinates, _expanded(local, x, share.coordinates))
        gradients[s] = share
    return replace(parts, gradients=gradients)


def _expanded(local: dict[tuple[int, ...], float], x: NDArray[np.float64], coordinates: Sequence[int]) -> Polynomial:
    """Return sum c (x - x0)^e as an exact polynomial in all coordinates."""
    n = len(x)
    distance = [Polynomial.variable(i, n) - Fraction(float(x[i])) for i in coordinates]
    total = Polynomial({}, dim=n)
    for exponents, value in local.items():
        term = Polynomial({(0,) * n: Fraction(value)})
        for factor, power in zip(distance, exponents, strict=True):
            term = term * factor**power
        total = total + term
    return total


def taylor_polynomial(term: FunctionTerm, y: NDArray[np.float64], degree: int) -> dict[tuple[int, ...], float]:
    """Return {exponents: coefficient} of a function at y (m,), without its constant, for degree >= 1.

    Above degree two by Fourier coefficients of the gradient on complex circles, to about 1e-10 of the largest.
    """
    gradient = np.asarray(derivative_of(term, 1, y, 0.0), dtype=np.float64)
    m = len(y)
    coefficients = {exponents_of((i,), m): float(gradient[i]) for i in range(m)}
    if degree < 2:
        return coefficients
    hessian = np.asarray(derivative_of(term, 2, y, 0.0), dtype=np.float64) if term.hessian is not None else None
    if degree > 2 or hessian is None:
        coefficients |= _circle_coefficients(term, y, degree, gradient, hessian)
    else:
        for i, j in product(range(m), repeat=2):
            if i <= j:
                coefficients[exponents_of((i, j), m)] = float(hessian[i, j]) / (1 + (i == j))
    return coefficients


def _circle_coefficients(
    term: FunctionTerm, y: NDArray[np.float64], degree: int, gradient: NDArray[np.float64], hessian: Any
) -> dict[tuple[int, ...], float]:
    m = len(y)
    nodes = 2 ** int(np.ceil(np.log2(2 * degree + 2)))
    if nodes**m > MAX_EVALUATIONS:
        raise ValueError(
            f"a function of {m} coordinates would be evaluated at {nodes**m} points for derivatives of order {degree}; "
            "take a lower order, or give the Hamiltonian as a Polynomial"
        )
    size = max(1.0, float(np.max(np.abs(y))))
    trials = [_coefficients(term, y, degree, nodes, size * radius) for radius in RADII]
    keys = [e for e in trials[0] if sum(e) > 1]
    # Coefficients of degree d are weighted by size^d.
    weighted = np.array([[coefficients[e] * size ** sum(e) for e in keys] for coefficients in trials])
    scale = float(np.max(np.abs(gradient), initial=0.0)) * size + np.min(np.max(np.abs(weighted), axis=1, initial=0.0))
    differences = np.max(np.abs(np.diff(weighted, axis=0)), axis=1, initial=0.0)
    best = int(np.argmin(np.where(np.isfinite(differences), differences, np.inf)))
    best_coefficients = trials[best + 1]
    errors = [
        differences[best],
        *(abs(best_coefficients[exponents_of((i,), m)] - gradient[i]) * size for i in range(m)),
    ]
    if hessian is not None:
        errors += [
            abs(best_coefficients[exponents_of((i, j), m)] * (1 + (i == j)) - hessian[i, j]) * size**2
            for i, j in product(range(m), repeat=2)
        ]
    if not max(errors) <= MAX_RELATIVE_ERROR * scale:
        raise ValueError(
            f"derivatives of order {degree} of a function of the Hamiltonian cannot be computed near "
            f"{y.tolist()}: it is not analytic on circles in the complex plane; take a lower order"
        )
    return {e: best_coefficients[e] for e in keys}


def _coefficients(
    term: FunctionTerm, y: NDArray[np.float64], degree: int, nodes: int, radius: float
) -> dict[tuple[int, ...], float]:
    """Return the Taylor coefficients up to a degree, from gradients on a product of circles."""
    m = len(y)
    circle = radius * np.exp(2j * np.pi * np.arange(nodes) / nodes)
    values = np.empty((m,) + (nodes,) * m, dtype=np.complex128)
    for node in np.ndindex(*values.shape[1:]):
        values[:, *node] = _complex_gradient(term, y + circle[list(node)])
    spectrum = np.fft.fftn(values, axes=tuple(range(1, m + 1))) / nodes**m
    coefficients = {}
    for exponents in product(range(degree + 1), repeat=m):
        if 0 < sum(exponents) <= degree:
            # Component i of the gradient has e_i times the coefficient at one power less of x_i; averaged over i.
            estimates = []
            for i, e in enumerate(exponents):
                if e:
                    lower = (*exponents[:i], e - 1, *exponents[i + 1 :])
                    estimates.append(spectrum[(i, *lower)].real / radius ** sum(lower) / e)
            coefficients[exponents] = float(np.mean(estimates))
    return coefficients


def _complex_gradient(term: FunctionTerm, y: NDArray[np.complex128]) -> Any:
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("error")
            return derivative_of(term, 1, y, 0.0)
    except Exception as reason:
        raise TypeError(
            "a function of the Hamiltonian was given without the higher derivatives needed here, and its "
            f"gradient rejects complex numbers ({type(reason).__name__}: {reason}); write it with NumPy's functions, "
            "or take a lower order"
        ) from reason
