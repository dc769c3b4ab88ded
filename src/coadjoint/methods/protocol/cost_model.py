"""Cost model of steps: elementary operations, in units of one rotation in a flow, also of series in kernels."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.monomials import factors_of
from coadjoint.kernels.interface import limit
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.program.describe import action_work, bodies_of, count_series_blocks, share_work
from coadjoint.program.generators import given_matrices, group_side
from coadjoint.program.table import FlowTable
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike
from coadjoint.systems.system import System

# Weights, fitted to measured steps by ``benchmarks/fit_cost_model.py``, to be fitted again when the compiled loops
# change. The unit is a flow that rotates one pair of coordinates by a linear angle (five multiplications, a sine with
# its cosine), about 11 ns on one core. Flows:
FLOW_COST = 0.27
MULTIPLICATION_COST = 0.052
FUNCTION_COST = 0.47
CALL_COST = 11.0  # of a function in the Hamiltonian, also in fields
PYTHON_COST = 1000.0  # of an evaluation of the field in Python, with what a step does beside it
# Vectors of eight numbers, in fields and series:
VECTOR_COST = 0.042
ITERATION_COST = 0.75
ELIMINATION_COST = 1.35  # of the square of the number of unknowns, by Newton's method
WAITING_COST = 0.2  # for the previous coefficient of a series
INVARIANT_COST = 0.36
STEP_CONTROL_COST = 5.0
# For many members in vector lanes, relative to one:
LANE_FLOW_FACTOR = 0.1
LANE_SERIES_FACTOR = 0.54

# Numbers of operations. Flows: multiplications of a sparse series, whose rows are addressed by indices, of a free body
# over a short time, and of a bond of a lattice, in vector lanes; sums with compensation.
SPARSE_SERIES, FREE_BODY, BOND, COMPENSATED_BOND = 100, 135, 25, 230
COMPENSATION_FACTOR = 1.3
LANES = 8
# Dimensions and products of fields whose stages stay in registers if H is quadratic (so(3), e(3), so(4), see
# ``brackets.hpp``), in which vectors are faster.
REGISTER_FIELDS, REGISTER_FACTOR = ((3, 6), (6, 18), (6, 24)), 0.5
# Factor for products of a polynomial, which are addressed by indices.
INDEXED_FACTOR = 2.0
# Invariants have this many further vectors of terms, in their values and their sums.
TERMS_PER_INVARIANT = 3.0
# From this many members on, flows and series in few dimensions are computed for many members in vector lanes.
MIN_LANE_MEMBERS = 16
# A multiplication in a matrix product by BLAS, and the overhead per product. For IsospectralGauss on so(3) to so(20)
# and on spheres of N = 4 to 64 the estimate is correct within a factor of 2.6, or 3.3 for one stage.
PRODUCT_COST, PRODUCT_CALL_COST = 0.006, 10.0


@suggest_keywords
@dataclass(frozen=True)
class Work:
    """Cost of a step of a scheme on a system, for `choose`; the method ``work`` of a scheme returns it.

    Parameters
    ----------
    cost : callable
        ``cost(iterations, evaluations)``: cost of a step, without linear systems, from the counts of one member. The
        unit is a flow that rotates one pair of coordinates, about 11 ns.
    flows : int
        Number of elementary flows that round the momentum in a step; 0 for schemes that do not consist of flows.
    in_lanes : float
        Cost per member in a large ensemble, relative to that of a single member.
    compensated : callable, optional
        Function that returns the work of the same step with compensated sums, if it differs.

    Examples
    --------
    >>> Work(lambda iterations, evaluations: 12.0 * evaluations).cost(0.0, 2.0)
    24.0
    """

    cost: Callable[[float, float], float]
    flows: int = 0
    in_lanes: float = 1.0
    compensated: Callable[[], Work] | None = None


def flow_work(flow_table: FlowTable, compensated: bool) -> float:
    """Return the cost of one step of a splitting, including the group action, in rotations."""
    parts = [_part_work(flow_table, number, compensated) for number in range(len(flow_table.parts))]
    first, last = int(flow_table.stages.section[1]), int(flow_table.stages.section[2])
    return sum(parts[int(part)] for part in flow_table.stages.part[first:last])


def _part_work(flow_table: FlowTable, number: int, compensated: bool) -> float:
    multiplications, functions = share_work(flow_table, number)
    bodies = bodies_of(flow_table, number)
    if bodies:
        multiplications, functions = 0, 0
    cost = FLOW_COST + MULTIPLICATION_COST * multiplications + CALL_COST * functions
    action = action_work(flow_table.state, number)
    if bodies:
        bonds = bool(bodies[0].other)
        each = FREE_BODY if not bonds else COMPENSATED_BOND if compensated else BOND
        cost += MULTIPLICATION_COST * each * len(bodies)
        action = 0 if bonds else action[0], 0  # sines are part of the cost of the body
    factor = COMPENSATION_FACTOR if compensated else 1.0
    cost += factor * (MULTIPLICATION_COST * action[0] + FUNCTION_COST * action[1])
    cost += MULTIPLICATION_COST * SPARSE_SERIES * count_series_blocks(flow_table.state, number)
    if flow_table.group is not None:
        # The rows of a group element are rotated in vector lanes, by one sine.
        action = action_work(flow_table.group, number)
        cost += MULTIPLICATION_COST * action[0] * math.ceil(flow_table.group.size / LANES) + FUNCTION_COST * action[1]
    return cost


def iteration_work(system: System, stages: float, group: Any) -> float:
    """Return the cost of one iteration of an implicit scheme, in rotations: the field at all stages, and mixing."""
    multiplications, functions = field_work(system)
    vectors = multiplications + stages * system.dim
    if group is not None and system.has_structure_constants:
        matrices = given_matrices(group)
        entries = 2 * len(system.algebra.triples[3]) if matrices is None else np.count_nonzero(matrices)
        edge = group_side(system.dim, group)
        vectors += edge * entries + stages * edge * edge
    elif stages <= LANES and _fits_in_registers(system):
        vectors *= REGISTER_FACTOR
    return ITERATION_COST + VECTOR_COST * math.ceil(stages / LANES) * vectors + CALL_COST * stages * functions


def _fits_in_registers(system: System) -> bool:
    return (
        system.has_quadratic_energy
        and system.has_structure_constants
        and (system.dim, 2 * len(system.algebra.triples[3])) in REGISTER_FIELDS
    )


def field_work(system: System) -> tuple[float, int]:
    """Return the numbers of multiplications and function calls in one evaluation of the vector field."""
    terms = system.hamiltonian.terms()
    multiplications = sum(term.multiplications * (1.0 if term.form is not None else INDEXED_FACTOR) for term in terms)
    functions = sum(term.called for term in terms)
    if system.has_structure_constants:
        return multiplications + 2 * len(system.algebra.triples[3]), functions
    return multiplications + system.dim**2, functions + 1


def flows_of(flow_table: FlowTable) -> int:
    """Return the number of flows in a step."""
    return int(flow_table.stages.section[2] - flow_table.stages.section[1])


def work_of_flows(flow_table: FlowTable, compensated: bool) -> Work:
    """Return the work of a step that consists of flows."""
    cost = flow_work(flow_table, compensated)
    compensated_work = None if compensated else lambda: work_of_flows(flow_table, True)
    return Work(lambda iterations, evaluations: cost, flows_of(flow_table), LANE_FLOW_FACTOR, compensated_work)


def work_of_iterations(system: System, group: Any) -> Work:
    """Return the work of a step that iterates, as a function of the counted iterations and evaluations."""

    def cost(iterations: float, evaluations: float) -> float:
        rounds = max(1.0, iterations)
        return rounds * iteration_work(system, evaluations / rounds, group)

    return Work(cost)


def work_of_evaluations(system: System, evaluations: int, explicit: bool, substeps: int = 1) -> Work:
    """Return the work of a step with evaluations of the field in each substep, and a linear system unless explicit."""
    cost = evaluations * iteration_work(system, 1, None)
    if not explicit:
        cost += newton_work(system.dim, 1)
    return Work(lambda iterations, counted: substeps * cost)


def work_of_products(system: Any, products: int, iterated: bool = False) -> Work:
    """Return the work of a step, or of each of its iterations, with this number of products of matrices."""
    numbers = 4.0 if system.complex else 1.0
    cost = products * (PRODUCT_CALL_COST + PRODUCT_COST * numbers * float(system.algebra.N) ** 3)
    return Work(lambda iterations, evaluations: cost * (max(1.0, iterations) if iterated else 1.0))


class Operations(NamedTuple):
    """Operations of an explicit step with a projection, for its cost estimate.

    Parameters
    ----------
    vectors : float
        Number of multiplications of vectors of eight numbers.
    waiting : float
        Number of operations that depend on the previous one.
    invariant_terms : float
        Number of terms of invariants that are evaluated after every correction; once if there is none.
    """

    vectors: float
    waiting: float
    invariant_terms: float


def work_of_operations(operations: Operations, substeps: int, in_lanes: bool = False) -> Work:
    """Return the work of a step with this number of substeps; its corrections are counted as iterations."""

    def cost(iterations: float, evaluations: float) -> float:
        series = VECTOR_COST * operations.vectors + WAITING_COST * operations.waiting
        return substeps * series + INVARIANT_COST * operations.invariant_terms * (substeps + iterations)

    return Work(cost, in_lanes=LANE_SERIES_FACTOR if in_lanes else 1.0)


def work_of_own_steps(operations: Operations, order: int) -> Work:
    """Return the work of a scheme with own steps, of `order` evaluations each, up to the next output point."""
    step = work_of_operations(operations, 1)

    def cost(iterations: float, evaluations: float) -> float:
        count = evaluations / order
        return count * (STEP_CONTROL_COST + step.cost(iterations / count, evaluations)) if count > 0.0 else 0.0

    return Work(cost)


def work_of_projection(base: Work, invariants: int) -> Work:
    """Return the work of a step of another scheme, and of a projection to this number of invariants."""
    projection = 2.0 * INVARIANT_COST * TERMS_PER_INVARIANT * invariants
    return Work(lambda iterations, evaluations: base.cost(iterations, evaluations) + projection)


def newton_work(dim: int, stages: float) -> float:
    """Return the additional work of Newton's method in a step: about one elimination of the stages' linear system."""
    return ELIMINATION_COST * min(dim * stages, limit("LARGEST_DENSE")) ** 2


# Sums of up to UNROLLED_VECTORS vectors of rows are unrolled, if no products are stored behind the coordinates. Others
# are slower by TABLE_FACTOR per vector.
UNROLLED_VECTORS, TABLE_FACTOR = 3, 2.0
# Dependent operations per vector of entries of the sums around factored products; one per vector of coordinates.
ENTRY_LATENCY = 0.5
# When products are factored, as in ``series_field.hpp``.
SERIES_PRODUCT_COST, GRADIENT_COST, FACTORED_COST, ENTRY_COST, CHAIN_COST, MEMORY_COST = 11.4, 2.9, 6.0, 2.5, 10.0, 18.0


def series_operations(system: System, order: int, invariants: Iterable[HamiltonianLike]) -> Operations:
    """Return the operations of a step: products of series, dependent operations, and the projection.

    >>> import coadjoint as co
    >>> series_operations(co.systems.rigid_body(inertia=(1, 2, 3)), 8, []).vectors  # four rows, half a vector
    16.0
    """
    lanes = 4 if system.dim <= 4 else LANES
    blocks = -(-system.dim // lanes)
    factored, waiting = factored_products(system, lanes), float(blocks)
    if factored is not None:
        products, entries = factored
        vectors = products * lanes / LANES
        waiting += ENTRY_LATENCY * entries
    else:
        product_blocks = vectors_of_gradient(system.hamiltonian)
        vectors = vectors_of_products(system, lanes) * lanes / LANES + product_blocks
        vectors *= TABLE_FACTOR if product_blocks or blocks > UNROLLED_VECTORS else 1.0
    rows = [vectors_of_invariant(C, system.dim, lanes) for C in invariants]
    invariant_terms = TERMS_PER_INVARIANT * len(rows) + sum(rows) / LANES
    return Operations(0.5 * order**2 * vectors, order * waiting, invariant_terms)


def vectors_of_products(system: System, lanes: int) -> float:
    """Return the number of vectors of rows that multiply series, in the layout of ``series_field.hpp``."""
    assert system.algebra is not None
    i, j, k, _ = system.algebra.triples
    row, state, factor = np.concatenate([i, j]), np.concatenate([k, k]), np.concatenate([j, i])
    terms = system.hamiltonian.terms()
    form = terms[0].form if len(terms) == 1 else None
    if form is not None and np.all(form.rows == form.indices):
        # Products are unrolled, each once; products with a coordinate that H does not contain are omitted.
        included = np.isin(factor, form.indices)
        pairs = np.stack([row, np.minimum(state, factor), np.maximum(state, factor)], axis=1)[included]
        row = np.unique(pairs, axis=0)[:, 0] if len(pairs) else pairs[:, 0]
    return _longest_of_blocks(np.bincount(row, minlength=system.dim), lanes)


def factored_products(system: System, lanes: int) -> tuple[int, float] | None:
    """Return vectors of products coordinate * sum of coordinates of H, and entries of sums; None if not factored."""
    assert system.algebra is not None
    terms, n = system.hamiltonian.terms(), system.dim
    most = 2 * lanes if lanes == LANES else lanes
    if n > most or not all(term.form is not None for term in terms):
        return None
    gradient, rows = np.zeros((n, n)), np.zeros((n, n, n))
    for form in filter(None, (term.form for term in terms)):
        np.add.at(gradient, (form.rows, form.indices), form.values)
    i, j, k, value = system.algebra.triples
    np.add.at(rows, (i, k, j), value)
    np.add.at(rows, (j, k, i), -value)
    pairs = rows @ gradient
    pairs += pairs.transpose(0, 2, 1).copy()
    written = SERIES_PRODUCT_COST * _longest_of_blocks(np.count_nonzero(np.triu(pairs), axis=(1, 2)), lanes)
    apart = SERIES_PRODUCT_COST * _longest_of_blocks(np.count_nonzero(rows, axis=(1, 2)), lanes)
    apart += GRADIENT_COST * _longest_of_blocks(np.count_nonzero(gradient, axis=1), lanes)
    lengths: dict[Hashable, int] = {}
    counts = [_count_factors(found, lengths) for found in pairs]
    products = -(-len(lengths) // lanes)
    entries = sum(_longest_of_blocks(np.array(each), lanes) for each in (counts, list(lengths.values())))
    in_memory = len(lengths) > most
    cost = (SERIES_PRODUCT_COST if in_memory else FACTORED_COST) * products + ENTRY_COST * entries + CHAIN_COST
    worthwhile = cost + MEMORY_COST * in_memory < min(written, apart)
    return (products, entries) if worthwhile else None


def _count_factors(pairs: NDArray[np.float64], lengths: dict[Hashable, int]) -> int:
    """Return the number of factored products in a row, and add the lengths of new sums; `pairs` is set to zero."""
    pairs[np.diag_indices(len(pairs))] /= 2.0
    count = 0
    while np.any(pairs):
        common = int(np.argmax(np.count_nonzero(pairs, axis=0)))
        others = np.flatnonzero(pairs[common])
        weights = pairs[common, others]
        scale = weights[0] if len(weights) == 1 else np.copysign(2.0 ** np.floor(np.log2(abs(weights[0]))), weights[0])
        lengths[common, others.tobytes(), (weights / scale).tobytes()] = len(others)
        pairs[common] = pairs[:, common] = 0.0
        count += 1
    return count


def _monomials_of(H: HamiltonianLike) -> Iterator[tuple[int, ...]]:
    for term in H.terms():
        polynomial = getattr(term, "polynomial", None)
        yield from () if polynomial is None else polynomial.monomials


def vectors_of_gradient(H: HamiltonianLike) -> int:
    """Return the number of vectors of products, stored behind the coordinates, for the gradient of a Hamiltonian."""
    products: set[tuple[int, ...]] = set()
    for exponents in _monomials_of(H):
        factors = factors_of(exponents)
        for i in set(factors):
            remaining = list(factors)
            remaining.remove(i)
            products.update(tuple(remaining[:count]) for count in range(2, len(remaining) + 1))
    # Products with equal numbers of factors share vectors.
    return sum(-(-count // LANES) for count in Counter(map(len, products)).values())


def vectors_of_invariant(C: HamiltonianLike, dim: int, lanes: int) -> float:
    """Return the number of vectors of rows of the gradient of an invariant, per factor, as in ``product_rows.hpp``."""
    rows = [(1, term.form.rows) for term in C.terms() if term.form is not None]
    rows += [(max(1, sum(exponents) - 1), np.flatnonzero(exponents)) for exponents in _monomials_of(C)]
    counts: dict[int, NDArray[np.int64]] = {}
    for factors, of_term in rows:
        counts[factors] = counts.get(factors, 0) + np.bincount(of_term, minlength=dim)
    return sum((factors * _longest_of_blocks(each, lanes) for factors, each in counts.items()), 0.0)


def _longest_of_blocks(counts: NDArray[np.int64], lanes: int) -> float:
    """Return the number of vectors for rows with these counts of entries: each block is as long as its longest row."""
    padded = np.zeros(-(-len(counts) // lanes) * lanes)
    padded[: len(counts)] = counts
    return float(np.max(padded.reshape(-1, lanes), axis=1).sum())
