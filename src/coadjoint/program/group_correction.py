"""Action of subtracted Casimirs on the group element: exp(t X), X = -sign rho(grad C(x0)), linear in x0.

Algebra, Casimirs and representation alone determine its pattern and the closed form of each component.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, connected, parts
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.program.blocks import Turn
from coadjoint.program.generators import BasisMatrices, Generators
from coadjoint.program.parts.casimir_shifts import quadratic_entries
from coadjoint.program.sparse_rows import Pattern, SparseRows, layers, order_by, run_starts, starts_of
from coadjoint.rounding import UNIT_ROUNDOFF

SubtractedCasimir = tuple[Polynomial, float]
Entries = tuple[Integers, Integers, NDArray[np.float64]]

SEED = 1993  # of the momenta at which the form of X is seen, the same on every machine
SAMPLES = 3  # of these; an identity of polynomials that holds at random points holds everywhere
# Smallest ratio of pivots for which an invariant form counts as definite.
MIN_CHOLESKY_PIVOT = 2.0**-20
# Largest representation (number of entries) for which tables are cached.
MAX_CACHED_SIZE = 4096


class UnshiftTables(NamedTuple):
    """X, of `size` rows, for a momentum of `dim` numbers: component b has the coordinates begin[b] to begin[b + 1] and
    the entries form[b] to form[b + 1], at `cell` (column-major), sums of weight * x[column]. `order`: last power, or
    nonzero eigenvalues; a `leaning` component changes x by rounding, which is subtracted; `metric`: position of the
    form in `metrics`, or -1.
    """

    size: int
    dim: int
    components: int
    kind: NDArray[np.uint8]
    leaning: NDArray[np.uint8]
    order: NDArray[np.uint32]
    begin: NDArray[np.uint32]
    coordinate: NDArray[np.uint32]
    form: NDArray[np.uint32]
    cell: NDArray[np.uint32]
    entry: NDArray[np.uint32]
    column: NDArray[np.uint32]
    weight: NDArray[np.float64]
    metric: NDArray[np.int64]
    metrics: NDArray[np.float64]


Component = tuple[Integers, Generators]
"""Connected set of coordinates, and its entries of X in local numbers for each unit momentum, by cell and momentum."""


Kind = tuple[Turn, int, NDArray[np.float64] | None]
"""Closed form of a component, its `order`, and the form that it preserves."""


def unshift_tables(
    algebra: LieAlgebra,
    representation: NDArray[np.float64] | None,
    sign: int,
    shift: Sequence[SubtractedCasimir],
) -> UnshiftTables:
    """Return the tables of X = -sign sum c rho(grad C(x)), for pairs (C, c) of homogeneous quadratic Casimirs."""
    casimirs = tuple(shift)
    if (algebra.dim**2 if representation is None else representation.size) > MAX_CACHED_SIZE:
        return _tables(algebra, representation, sign, casimirs)
    columns = [] if representation is None else [representation]
    return _cached_tables(algebra, Pattern(representation, *columns), sign, casimirs)


@lru_cache(maxsize=64)
def _cached_tables(
    algebra: LieAlgebra,
    representation: Pattern[NDArray[np.float64] | None],
    sign: int,
    shift: tuple[SubtractedCasimir, ...],
) -> UnshiftTables:
    return _tables(algebra, representation.source, sign, shift)


def _tables(
    algebra: LieAlgebra,
    representation: NDArray[np.float64] | None,
    sign: int,
    shift: Sequence[SubtractedCasimir],
) -> UnshiftTables:
    matrices = BasisMatrices.on_group(algebra, representation)
    quadratic = [(quadratic_entries(casimir), factor) for casimir, factor in shift]
    casimir_entries = [(found[0], found[1], factor * found[2]) for found, factor in quadratic if found is not None]
    generators = _generators(matrices, algebra.dim, sign, casimir_entries)
    samples = np.random.default_rng(SEED).integers(-8, 9, (SAMPLES, algebra.dim)).astype(np.float64) + 0.5
    components = list(_components(matrices.size, generators))
    kinds = [
        _kind_of(component, samples, casimir_entries if representation is None else []) for component in components
    ]
    cells = [_cells(component) for component in components]
    begins = [run_starts(cell) for cell in cells]
    metrics = [metric for *_, metric in kinds]
    metric_start = starts_of([0 if metric is None else metric.size for metric in metrics])

    def joined(pieces: Sequence[NDArray[Any]], kind: type = np.uint32) -> NDArray[Any]:
        return np.concatenate([np.zeros(0, dtype=kind), *pieces]).astype(kind)

    first = joined(begins, bool)
    return UnshiftTables(
        size=matrices.size,
        dim=algebra.dim,
        components=len(components),
        kind=np.array([turn for turn, *_ in kinds], dtype=np.uint8),
        leaning=np.array([representation is None and not _is_skew(one) for _, one in components], dtype=np.uint8),
        order=np.array([order for _, order, _ in kinds], dtype=np.uint32),
        begin=starts_of([len(coordinates) for coordinates, _ in components]).astype(np.uint32),
        coordinate=joined([coordinates for coordinates, _ in components]),
        form=starts_of([int(np.count_nonzero(one)) for one in begins]).astype(np.uint32),
        cell=joined(cells)[first],
        entry=np.append(np.flatnonzero(first), len(first)).astype(np.uint32),
        column=joined([entries.angle for _, entries in components]),
        weight=joined([entries.value for _, entries in components], np.float64),
        metric=np.array(
            [-1 if metric is None else metric_start[b] for b, metric in enumerate(metrics)], dtype=np.int64
        ),
        metrics=joined([metric.ravel() for metric in metrics if metric is not None], np.float64),
    )


def _generators(matrices: BasisMatrices, dim: int, sign: int, entries: Sequence[Entries]) -> Generators:
    """Return X for each unit momentum, as its `angle`."""
    i, j, value = (np.concatenate([entry[side] for entry in entries]) for side in range(3))
    order = order_by(j, i)
    j, i, value = j[order], i[order], value[order]
    forms = SparseRows(np.searchsorted(j, np.arange(dim + 1)), i.astype(np.uint32), value)
    pieces = list(matrices.combinations(forms, float))
    momentum, column, row, weight = (np.concatenate([piece[side] for piece in pieces]) for side in range(4))
    # rho acts on the rows of a group element as -rho^T.
    return Generators(momentum, row, column, sign * weight)


def _components(size: int, generators: Generators) -> Iterator[Component]:
    """Yield the connected sets of coordinates, sorted by their first ones."""
    momentum, row, column, weight = generators
    label = connected(size, row, column)
    order = order_by(label[row], column, row, momentum)
    owner = label[row][order]
    local = np.zeros(size, dtype=np.int64)
    for members in parts(label):
        first, last = np.searchsorted(owner, [members[0], members[0] + 1])
        if first == last:
            continue
        selected = np.arange(len(row))[order][first:last]
        local[members] = np.arange(len(members))
        rows, columns = local[row[selected]], local[column[selected]]
        yield members, Generators(momentum[selected], rows, columns, weight[selected])


def _cells(component: Component) -> Integers:
    coordinates, entries = component
    return entries.column * len(coordinates) + entries.row


def _is_skew(entries: Generators) -> bool:
    order = order_by(entries.row, entries.column, entries.angle)
    return (
        np.array_equal(entries.row[order], entries.column)
        and np.array_equal(entries.column[order], entries.row)
        and np.array_equal(entries.angle[order], entries.angle)
        and np.array_equal(entries.value[order], -entries.value)
    )


def _kind_of(component: Component, samples: NDArray[np.float64], casimirs: Sequence[Entries]) -> Kind:
    """Classify a component for all momenta by the properties it has at a few generic ones."""
    (coordinates, entries), cell = component, _cells(component)
    m, is_skew, first = len(coordinates), _is_skew(entries), run_starts(cell)
    layer = layers(m, entries.column[first], entries.row[first])
    if layer.min() >= 0:
        return Turn.NILPOTENT, int(layer.max()), None
    if m <= 2:
        return Turn.PLANE, 0, None
    if is_skew and m > 4:
        return Turn.SKEW, 0, None
    flat = (np.bincount(cell, weights=entries.value * x[entries.angle], minlength=m**2) for x in samples)
    matrices: list[NDArray[np.float64]] = [np.asarray(one.reshape(m, m).T) for one in flat]
    powers = [(D, D @ D, D @ D @ D) for D in matrices]
    bounds = [(abs(D), abs(D) @ abs(D), abs(D) @ abs(D) @ abs(D)) for D in matrices]
    for order in (1, 2):
        if all(_vanishes(p[order], 8 * m * (order + 1) * b[order]) for p, b in zip(powers, bounds, strict=True)):
            return Turn.NILPOTENT, order, None
    ranks = [_rank_of_cubic(p, b) for p, b in zip(powers, bounds, strict=True)]
    if ranks[0] and ranks.count(ranks[0]) == len(ranks):
        return Turn.CUBIC, ranks[0], None
    if is_skew:
        return (Turn.PAIR if m == 4 else Turn.SKEW), 0, None
    metrics = (_metric(coordinates, entry) for entry in casimirs)
    metric = next((form for form in metrics if form is not None), None)
    return (Turn.GENERAL if metric is None else Turn.SKEW), 0, metric


def _vanishes(matrix: NDArray[np.float64], bound: NDArray[np.float64]) -> bool:
    return bool(np.all(abs(matrix) <= UNIT_ROUNDOFF * bound))


def _rank_of_cubic(powers: Sequence[NDArray[np.float64]], bounds: Sequence[NDArray[np.float64]]) -> int:
    """Return the rank of D if D^3 = lam D, lam = trace(D^2) / rank; else 0."""
    D, square, cube = powers
    m, largest = len(D), int(np.argmax(abs(D)))
    lam = cube.flat[largest] / D.flat[largest]
    if lam == 0.0 or not _vanishes(cube - lam * D, 8 * m * 3 * (bounds[2] + abs(lam) * bounds[0])):
        return 0
    return max(0, round(float(np.trace(square)) / lam))


def _metric(coordinates: Integers, casimir: Entries) -> NDArray[np.float64] | None:
    """Return L^T and its inverse, column-major, for the form L L^T of a definite Casimir, which X preserves."""
    rows, columns, values = casimir
    m, local = len(coordinates), np.full(max(int(rows.max()), int(coordinates[-1])) + 1, -1)
    local[coordinates] = np.arange(m)
    inside = (local[rows] >= 0) & (local[columns] >= 0)
    form = np.zeros((m, m))
    form[local[rows[inside]], local[columns[inside]]] = values[inside]
    lower = _cholesky(form if form[0, 0] > 0.0 else -form)
    return None if lower is None else np.stack([lower, _inverse(lower)])


def _cholesky(form: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return L with L L^T = form, or None if it is not definite."""
    m, lower = len(form), np.zeros(form.shape)
    residual = form.copy()
    for k in range(m):
        if not residual[k, k] > MIN_CHOLESKY_PIVOT * form.max():
            return None
        lower[k:, k] = residual[k:, k] / np.sqrt(residual[k, k])
        residual -= np.outer(lower[:, k], lower[:, k])
    return lower


def _inverse(lower: NDArray[np.float64]) -> NDArray[np.float64]:
    m, inverse = len(lower), np.eye(len(lower))
    for k in range(m):
        inverse[k] /= lower[k, k]
        inverse[k + 1 :] -= np.outer(lower[k + 1 :, k], inverse[k])
    return inverse
