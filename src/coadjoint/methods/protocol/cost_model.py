"""Cost model of steps: elementary operations, in units of one rotation in a flow."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from coadjoint.kernels.interface import limit
from coadjoint.program.describe import action_work, bodies_of, series_in, share_work
from coadjoint.program.table import Program
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.system_checks import System

# Weights of the cost model, to be adjusted when the compiled loops change. The unit is a flow that rotates one pair of
# coordinates by a linear angle (five multiplications, a sine with its cosine), about 11 ns on one core. An iteration of
# eight stages of a field in three dimensions, in vector lanes, then costs 1.6.
FLOW = 0.2
MULTIPLICATION = 0.04
FUNCTION = 0.6
COMPENSATED = 1.3
# A sparse series, in addition to its multiplications: its rows are addressed by indices, term by term.
SERIES = 5.0
# The flow of a free body over a short time.
BODY = 7.0
# A bond of a lattice, in vector lanes, and with compensated sums.
BOND = 1.3
BOND_COMPENSATED = 12.0
ITERATION = 0.5
LANES = 8
VECTOR_MULTIPLICATION = 0.05
# Dimensions and products of fields whose stages stay in registers if H is quadratic (so(3), e(3), so(4), see
# ``brackets.hpp``); vectors are half as wide for few stages.
HELD, FEW_STAGES = ((3, 6), (6, 18), (6, 24)), 4
IN_REGISTERS = 0.7
NARROW = 0.65
# Factor for products of a polynomial, which are addressed by indices.
BY_INDEX = 2.0
IMPLICIT_STEP = 5.0
# A step without iterations: products of series, dependent sums, evaluations of invariants (after the first correction,
# and after later ones).
EXPLICIT_STEP = 2.7
VECTOR = 0.017
WAITING = 0.136
LOOK = 0.25
# Selection of the length of a step.
OWN_STEP = 6.0
FIRST_CORRECTION = 3.2
NEXT_CORRECTION = 1.0
# From CROWD members on, flows and series in few dimensions are computed for many members in vector lanes, at these
# fractions of the cost. Other steps fill the lanes with one member.
CROWD = 16
FLOWS_OF_A_CROWD = 0.1
BODIES_OF_A_CROWD = 0.17
SERIES_OF_A_CROWD = 0.6
ELIMINATION = 0.015
# A multiplication in a matrix product by BLAS, and the overhead per product. For IsospectralGauss on so(3) to so(20)
# and on spheres of N = 4 to 64 the estimate is correct within a factor of 2.6, or 3.3 for one stage.
PRODUCT, PRODUCT_CALL = 0.006, 10.0


@dataclass(frozen=True)
class Work:
    """Cost of a step of a scheme on a system.

    Parameters
    ----------
    cost : callable
        ``cost(iterations, evaluations)`` returns the cost of a step in rotations, from the counts of the loop for a
        step of one member. Linear systems are not counted.
    flows : int
        Number of elementary flows that round the momentum in a step; 0 for schemes that do not consist of flows.
    in_a_crowd : float
        Cost per member in a large ensemble, relative to that of a single member.
    compensated : callable, optional
        Returns the work of the same step with compensated sums, if it differs.
    """

    cost: Callable[[float, float], float]
    flows: int = 0
    in_a_crowd: float = 1.0
    compensated: Callable[[], Work] | None = None


def flow_work(program: Program, compensated: bool) -> float:
    """Return the cost of one step of a splitting, in rotations: its rows, including the group action, by the blocks
    that they rotate.
    """
    parts = [_part_work(program, number, compensated) for number in range(len(program.parts))]
    first, last = int(program.rows.section[1]), int(program.rows.section[2])
    return sum(parts[int(part)] for part in program.rows.part[first:last])


def _part_work(program: Program, number: int, compensated: bool) -> float:
    multiplications, functions = share_work(program, number)
    bodies = bodies_of(program, number)
    if bodies:
        multiplications, functions = 0, 0
    cost = FLOW + MULTIPLICATION * multiplications + FUNCTION * functions
    acting = action_work(program.state, number)
    if bodies:
        bonds = bool(bodies[0].other)
        cost += len(bodies) * (BODY if not bonds else BOND_COMPENSATED if compensated else BOND)
        acting = 0 if bonds else acting[0], 0  # sines are part of the cost of the body
    cost += (MULTIPLICATION * acting[0] + FUNCTION * acting[1]) * (COMPENSATED if compensated else 1.0)
    cost += SERIES * series_in(program.state, number)
    if program.group is not None:
        # The rows of a group element are rotated in vector lanes, by one sine.
        acting = action_work(program.group, number)
        cost += MULTIPLICATION * acting[0] * math.ceil(program.group.size / LANES) + FUNCTION * acting[1]
    return cost


def iteration_work(system: System, stages: float, group: Any) -> float:
    """Return the cost of one iteration of an implicit scheme, in rotations: the field at all stages, and mixing."""
    multiplications, functions = field_work(system)
    vectors = multiplications + stages * system.dim
    if group is not None and isinstance(system, LiePoissonSystem):
        entries = 2 * len(system.algebra.triples[3]) if isinstance(group, str) else np.count_nonzero(group)
        edge = system.dim if isinstance(group, str) else group.shape[1]
        vectors += edge * entries + stages * edge * edge
    elif stages <= LANES and _held(system):
        vectors *= IN_REGISTERS * (NARROW if stages <= FEW_STAGES else 1.0)
    return ITERATION + VECTOR_MULTIPLICATION * math.ceil(stages / LANES) * vectors + FUNCTION * stages * functions


def _held(system: System) -> bool:
    """Return whether the stages of a system stay in registers."""
    quadratic = all(term.form is not None for term in system.hamiltonian.terms())
    algebra = system.algebra
    return quadratic and algebra is not None and (system.dim, 2 * len(algebra.triples[3])) in HELD


def field_work(system: System) -> tuple[float, int]:
    """Return the numbers of multiplications and function calls in one evaluation of the vector field."""
    terms = system.hamiltonian.terms()
    multiplications = sum(term.multiplications * (1.0 if term.form is not None else BY_INDEX) for term in terms)
    functions = sum(term.called for term in terms)
    if isinstance(system, LiePoissonSystem):
        return multiplications + 2 * len(system.algebra.triples[3]), functions
    return multiplications + system.dim**2, functions + 1


def flows_of(program: Program) -> int:
    """Return the number of flows in a step."""
    return int(program.rows.section[2] - program.rows.section[1])


def work_of_flows(program: Program, compensated: bool) -> Work:
    """Return the work of a step that consists of flows."""
    cost = flow_work(program, compensated)
    better = None if compensated else lambda: work_of_flows(program, True)
    crowd = BODIES_OF_A_CROWD if program.parts.bodies else FLOWS_OF_A_CROWD
    return Work(lambda iterations, evaluations: cost, flows_of(program), crowd, better)


def work_of_iterations(system: System, group: Any) -> Work:
    """Return the work of a step that iterates, as a function of the counted iterations and evaluations."""

    def cost(iterations: float, evaluations: float) -> float:
        rounds = max(1.0, iterations)
        return IMPLICIT_STEP + rounds * iteration_work(system, evaluations / rounds, group)

    return Work(cost)


def work_of_evaluations(system: System, evaluations: int, explicit: bool) -> Work:
    """Return the work of a step with these evaluations of the field, and a linear system unless it is explicit."""
    cost = IMPLICIT_STEP + evaluations * iteration_work(system, 1, None)
    if not explicit:
        cost += newton_work(system.dim, 1)
    return Work(lambda iterations, counted: cost)


def work_of_products(system: Any, products: int, iterated: bool = False) -> Work:
    """Return the work of a step, or of each of its iterations, with this number of products of matrices."""
    numbers = 4.0 if system.complex else 1.0
    cost = products * (PRODUCT_CALL + PRODUCT * numbers * float(system.algebra.N) ** 3)
    return Work(lambda iterations, evaluations: cost * (max(1.0, iterations) if iterated else 1.0))


class Operations(NamedTuple):
    """Operations of an explicit step with a projection, for its cost estimate.

    Parameters
    ----------
    vectors : float
        Number of multiplications of vectors of eight numbers.
    waiting : float
        Number of operations that depend on the previous one.
    looks : float
        Number of terms of invariants that are evaluated after every correction; once if there is none.
    """

    vectors: float
    waiting: float
    looks: float


def work_of_operations(operations: Operations, substeps: int, in_a_crowd: float = 1.0) -> Work:
    """Return the work of a step with this number of substeps; its corrections are counted as iterations."""

    def cost(iterations: float, evaluations: float) -> float:
        corrections = FIRST_CORRECTION * min(iterations, substeps) + NEXT_CORRECTION * max(0.0, iterations - substeps)
        series = EXPLICIT_STEP + VECTOR * operations.vectors + WAITING * operations.waiting
        return substeps * series + LOOK * operations.looks * (substeps + corrections)

    return Work(cost, in_a_crowd=in_a_crowd)


def work_of_own_steps(operations: Operations, order: int) -> Work:
    """Return the work of a scheme with own steps, of `order` evaluations each, up to the next output point."""
    step = work_of_operations(operations, 1)

    def cost(iterations: float, evaluations: float) -> float:
        own = evaluations / order
        look = LOOK * operations.looks * (1.0 + FIRST_CORRECTION) + WAITING * 0.5 * order
        return look + (own * (OWN_STEP + step.cost(iterations / own, evaluations)) if own > 0.0 else 0.0)

    return Work(cost)


def work_of_projection(base: Work, invariants: int) -> Work:
    """Return the work of a step of another scheme, and of a projection to this number of invariants."""
    back = LOOK * invariants * (1.0 + FIRST_CORRECTION)
    return Work(lambda iterations, evaluations: base.cost(iterations, evaluations) + back)


def newton_work(dim: int, stages: float) -> float:
    """Return the additional work of Newton's method in a step: about one elimination of the stages' linear system."""
    return ELIMINATION * min(dim * stages, limit("LARGEST_DENSE")) ** 3
