"""Terms of the modified Hamiltonian H + h^p H_p + ... of a splitting: polynomials of the parts, in a Lie series."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.free_algebra import Word, standard_factorization
from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials
from coadjoint.algebra.polynomials.monomials import Exponents
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.long_operations import warn_if_long
from coadjoint.program.logarithms import (
    BALL_BITS,
    SECONDS_PER_PRODUCT,
    Commutators,
    Coordinates,
    Flow,
    check_products,
    composition_logarithm,
    exact_sweeps,
    sweep_logarithm,
)
from coadjoint.program.parts.part import Parts
from coadjoint.program.parts.part_polynomials import part_polynomials, rational_pieces, with_hamiltonian_coefficients
from coadjoint.program.sparse_rows import Rows
from coadjoint.program.sweeps import Sweep, Swept
from coadjoint.program.table import FlowTable, build_flow_table
from coadjoint.systems.lie_poisson import LiePoissonSystem

MAX_ESTIMATED_DIMENSION = 1500
"""Largest dimension for which products are counted. Larger systems are lattices, whose brackets are short."""
MAX_CUBIC_DIMENSION = 400
"""Largest dimension for which nested brackets are counted, which takes n^3 bytes."""
SAMPLED_PARTS = 6
"""Number of points along the parts at which the brackets are counted."""
MIN_BITS = 60  # of a coefficient, relative to the largest product: seven more than those of a float


def nested_brackets(commutators: Commutators, flows: Sequence[Flow], highest: int) -> Callable[[Word], Exact]:
    """Return the function that gives, as a polynomial, the nested bracket of a Lyndon word of letters of a step."""

    @cache
    def sweep() -> list[Exact]:
        return sweep_logarithm(commutators, flows, highest)

    @cache
    def bracket(word: Word) -> Exact:
        if len(word) > 1:
            left, right = standard_factorization(word)
            return commutators(bracket(left), bracket(right))
        weight, origin = word[0]
        if origin == "sweep":
            return sweep()[weight - 1]
        return flows[0 if origin == "first" else -1].get(weight, commutators.ring.zero)

    return bracket


def _term(
    ring: ExactPolynomials, bracket: Callable[[Word], Exact], coefficients: Mapping[Word, Any]
) -> tuple[Polynomial, float, float]:
    """Return a term h^w (w >= 2) of a Lie series in coordinates and symbols, its radius, and a bound.

    The radius is that of the largest ball relative to its midpoint (0 if exact); the bound is of coefficients dropped.
    """
    from flint import arb, ctx

    if not any(isinstance(value, arb) for value in coefficients.values()):
        total = ring.zero
        for word, value in coefficients.items():
            total += bracket(word) * value
        return ring.with_symbols(total), 0.0, 0.0
    sums: dict[tuple[int, ...], Any] = {}
    largest = 0.0
    with ctx.workprec(BALL_BITS):
        for word, value in coefficients.items():
            for exponents, factor in bracket(word).to_dict().items():
                sums[exponents] = sums.get(exponents, 0) + (product := value * factor)
                largest = max(largest, float(abs(product).upper()))
        floats, radius, neglected = _rounded(sums, largest)
    return Polynomial(floats, dim=ring.dim + len(ring.symbols)), radius, neglected


def _rounded(balls: Mapping[tuple[int, ...], Any], largest: float) -> tuple[dict[Exponents, float], float, float]:
    coefficients: dict[Exponents, float] = {}
    radius = neglected = 0.0
    for exponents, ball in balls.items():
        size = float(ball.rad())
        if size > largest * 2.0**-MIN_BITS:
            raise ValueError(
                "the coefficients of the scheme are known to too few digits: a coefficient of the modified Hamiltonian "
                f"is known up to {size:.1e} only, from products of size {largest:.1e}"
            )
        if ball.contains(0):
            neglected = max(neglected, float(abs(ball).upper()))
        else:
            coefficients[tuple(map(int, exponents))] = float(ball.mid())
            radius = max(radius, float((ball.rad() / abs(ball).lower()).upper()))
    return coefficients, radius, neglected


def coordinates_of(
    flow_table: FlowTable, sweeps: list[Sweep], after: list[Sweep], highest: int, order: int
) -> Coordinates:
    """Return the Lie series of a step by a flow table; for the arguments see `composition_logarithm`."""
    rational = bool(np.any(flow_table.frequency != 0))
    return composition_logarithm(sweeps, after, highest, order=order, parts=len(flow_table.parts), rational=rational)


def modified_terms(
    ring: ExactPolynomials,
    system: LiePoissonSystem,
    flow_table: FlowTable,
    coordinates: Coordinates,
    weights: Iterable[int],
    H: Polynomial | None = None,
    factors: Mapping[Exponents, Exact] = MappingProxyType({}),
) -> tuple[dict[int, Polynomial], float, float]:
    """Return {power of h: nonzero term} for `weights` >= 2 (power + 1), their rounding, and a bound of dropped ones.

    Terms are polynomials in coordinates, then symbols of the ring. `H` or `factors` in symbols replace the coefficients
    of parts (see `with_hamiltonian_coefficients`), unless a Casimir was subtracted.
    """
    nonzero = [weight for weight in weights if coordinates.of_weight[weight]]
    highest = max(nonzero, default=1)
    if highest > 1:
        _check_cost(system, flow_table, highest)
    elif not factors:
        return {}, 0.0, coordinates.neglected
    polynomials = [ring.about_point(piece) for piece in part_polynomials(ring, flow_table.parts)]
    if H is not None and not flow_table.shift:
        polynomials = with_hamiltonian_coefficients(ring, flow_table.parts, polynomials, H, factors)
    rotation_terms = rational_pieces(ring, flow_table.parts, flow_table.frequency, highest)
    flows = [{1: piece, **more} for piece, more in zip(polynomials, rotation_terms, strict=True)]
    bracket = nested_brackets(Commutators(ring, system.sign), flows, highest)
    of_power: dict[int, Polynomial] = {}
    radius, neglected = 0.0, coordinates.neglected
    for weight in nonzero:
        polynomial, rounding, dropped = _term(ring, bracket, coordinates.of_weight[weight])
        radius, neglected = max(radius, rounding), max(neglected, dropped)
        if polynomial.monomials:
            of_power[weight - 1] = polynomial
    return of_power, radius, neglected


def _check_cost(system: LiePoissonSystem, flow_table: FlowTable, highest: int) -> None:
    """Estimate the cost of the terms up to a weight: raise ValueError if it is too large, warn if slow."""
    count = estimated_products(system.algebra, flow_table.parts, highest)
    check_products(count)
    warn_if_long("the modified Hamiltonian", SECONDS_PER_PRODUCT * count, "a lower order takes less")


def estimated_products(algebra: LieAlgebra, parts: Parts, highest: int) -> float:
    """Estimate a lower bound on products of monomials in `sweep_logarithm` from sparsity, up to h^3; 0 if unknown.

    Part p acts on the series R of the parts after it. There is none for parts that are no quadratic forms.
    """
    n = algebra.dim
    if highest < 2 or parts.nonlinear or n > MAX_ESTIMATED_DIMENSION:
        return 0.0
    i, j, k, _ = algebra.triples
    acting = np.concatenate([i, j]), np.concatenate([j, i]), np.concatenate([k, k])
    cubic = highest > 2 and n <= MAX_CUBIC_DIMENSION
    slopes = np.zeros((n, n), dtype=bool)  # slopes[i]: coordinates in dR_1/dx_i
    second = np.zeros((n, n, n) if cubic else 0, dtype=bool)  # second[m]: pairs that multiply x_m in R_2
    counts = np.zeros(n)  # counts[i]: monomials in dR_2/dx_i
    stride = max(1, len(parts) // SAMPLED_PARTS)
    total = 0.0
    angles = np.split(np.argsort(parts.part_of_angle, kind="stable"), np.cumsum(np.diff(parts.angle))[:-1])
    for number, p in enumerate(reversed(range(len(parts)))):
        length, pair_counts = slopes.sum(axis=1, dtype=float), np.zeros(n)
        if cubic and number % stride == 0:
            counts = _monomials_per_coordinate(second)
        for angle in angles[p].tolist():
            weights = _mask(parts.weights, angle, n)
            field, field_pattern = _field(acting, _mask(parts.forms, angle, n), weights, parts.offset[angle] != 0, n)
            total += float(field @ (length + counts))
            if cubic and np.any(length):
                pairs = _pairs(field_pattern, slopes)
                second[weights] |= pairs
                pair_counts += np.where(weights, pairs.sum() / 2, 0.0) + pairs.sum(axis=1) * weights.sum()
                total += float(field @ np.minimum(pair_counts, n * (n + 1) / 2))
        for angle in angles[p].tolist():
            form, weights = _mask(parts.forms, angle, n), _mask(parts.weights, angle, n)
            slopes |= (form[:, None] & weights) | (weights[:, None] & form)
    return total


def _mask(rows: Rows, row: int, n: int) -> NDArray[np.bool_]:
    mask = np.zeros(n, dtype=bool)
    mask[rows.coordinate[rows.start[row] : rows.start[row + 1]]] = True
    return mask


def _field(
    acting: tuple[Integers, Integers, Integers],
    form: NDArray[np.bool_],
    weights: NDArray[np.bool_],
    shifted: bool,
    n: int,
) -> tuple[NDArray[np.float64], Integers]:
    """Count the monomials in each component of the field of (form.x) (weights.x); and where it has x_k, as i n + k."""
    row, column, k = acting
    selected = form[column]
    field_pattern = np.unique(row[selected] * n + k[selected])
    component, coordinate = np.divmod(field_pattern, n)
    length = np.bincount(component, minlength=n).astype(float)
    overlap = np.bincount(component[weights[coordinate]], minlength=n)
    return length * (int(weights.sum()) + shifted) - overlap * (overlap - 1) / 2, field_pattern


def _pairs(field_pattern: Integers, slopes: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the symmetric pattern of coordinate pairs in the products of the two linear factors of a bracket."""
    n = len(slopes)
    linear = np.zeros((n, n), dtype=np.float32)
    linear[np.divmod(field_pattern, n)] = 1.0
    pattern = (linear.T @ slopes.astype(np.float32)) > 0.0
    return np.asarray(pattern | pattern.T)


def _monomials_per_coordinate(second: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Count for each coordinate the monomials that contain it, in a cubic polynomial given by pairs."""
    n = len(second)
    counts = np.empty(n)
    for i in range(n):
        pairs = second[i] | second[:, i] | second[:, :, i]
        counts[i] = (np.count_nonzero(pairs | pairs.T) + np.count_nonzero(np.diagonal(pairs))) / 2
    return counts


def leading_term(system: LiePoissonSystem, method: Swept, order: int) -> Polynomial:
    """Return H_p of a scheme of order p, whose step is the flow of H + h^p H_p + ..."""
    flow_table = build_flow_table(system, method)
    coordinates = coordinates_of(flow_table, *exact_sweeps(method), order + 1, order)
    terms, _, _ = modified_terms(ExactPolynomials(system.algebra), system, flow_table, coordinates, [order + 1])
    return terms.get(order, Polynomial({}, dim=system.dim))
