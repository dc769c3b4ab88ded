"""Reference interpreter of a flow table: NumPy, any number type or power series, with the exact tangent map."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.actions import Action, generator_entries, rational_angle, rational_angle_series, run_blocks
from coadjoint.program.blocks import FEW_SUBSTEPS, MOST_SUBSTEPS, RULES, BlockKind
from coadjoint.program.generators import Generators
from coadjoint.program.numbers import array_of, elementary, roundoff
from coadjoint.program.table import FlowTable
from coadjoint.program.term_table import FUNCTION, LINEAR, derivative_of


class Interpreter:
    """Reference interpreter in the number type of the flow table or the states; slow.

    With series truncated after `count` terms as numbers, flows with exact numbers are Lie series, which end there.
    """

    def __init__(self, flow_table: FlowTable, number: Any = None) -> None:
        self.flow_table = flow_table
        self.number = flow_table.number if number is None else number
        self._count: int | None = getattr(self.number, "count", None)
        self.functions: Any = elementary(self.number) if self._count is None else None  # Lie series need none
        self._u = roundoff(self.number)
        self._is_body_flow = body_flow_parts(flow_table)

    def steps(
        self,
        x: NDArray[Any],
        h: Any,
        count: int,
        t0: Any = 0.0,
        group: NDArray[Any] | None = None,
        tangent: NDArray[Any] | None = None,
    ) -> Any:
        """Take `count` steps h (negative: backward) from x (n,), not changed; return x, then `group`, `tangent` given.

        `group` (d, d) is in the representation of the flow table; `tangent` (n, m) has tangent vectors in columns.
        """
        x = self._converted(x)
        element = None if group is None else self._converted(group).T.copy()
        vectors = None if tangent is None else self._converted(tangent)
        ends = self.flow_table.stages.section
        for k in range(count):
            section = 0 if k == 0 else 1
            self._apply_rows(range(ends[section], ends[section + 1]), x, h, t0 + k * h, element, vectors)
        if count:
            self._apply_rows(range(ends[2], ends[3]), x, h, t0 + (count - 1) * h, element, vectors)
        extra = [item for item in (None if element is None else element.T, vectors) if item is not None]
        return (x, *extra) if extra else x

    def _converted(self, values: NDArray[Any]) -> NDArray[Any]:
        return array_of(self.number, np.ravel(values)).reshape(np.shape(values)).copy()

    def _apply_rows(self, rows: range, x: Any, h: Any, t: Any, group: Any, tangent: Any) -> None:
        table = self.flow_table.stages
        for r in rows:
            part = int(table.part[r])
            tau, moment = table.coefficient[r] * h, t + table.moment[r] * h
            if self._is_body_flow[part]:
                apply_body_flow(self, part, tau, (x, group, tangent))
                continue
            theta = [tau * angle for angle in self.angles(part, x, moment)]
            tangents = None if tangent is None else [tau * d for d in self._angle_tangents(part, x, moment, tangent)]
            theta, tangents = self._rational_angles(part, theta, tangents)
            self.act(self.flow_table.state, part, theta, x)
            if group is not None and self.flow_table.group is not None:
                self.act(self.flow_table.group, part, theta, group)
            if tangents is not None:
                self.act(self.flow_table.state, part, theta, tangent)
                for angle, change in enumerate(tangents):
                    tangent += np.multiply.outer(self._generator_on(part, angle, x), change)

    def _rational_angles(self, part: int, theta: list[Any], tangents: Any) -> tuple[list[Any], Any]:
        base = int(self.flow_table.terms.row[self.flow_table.share[part]])
        w = self.flow_table.frequency[base : base + len(theta)]
        if self._count is not None:
            return [rational_angle_series(angle, f, self._count) for angle, f in zip(theta, w, strict=True)], tangents
        if tangents is not None:
            tangents = [d / (1 + (f * angle / 2) ** 2) for d, angle, f in zip(tangents, theta, w, strict=True)]
        return [rational_angle(angle, f, self.functions.atan) for angle, f in zip(theta, w, strict=True)], tangents

    def angles(self, part: int, x: NDArray[Any], t: Any) -> list[Any]:
        """Return dH/d(l_a.x) for the forms of a part (operation `angle` of the table)."""
        terms, share = self.flow_table.terms, self.flow_table.share
        angles: list[Any] = []
        for k in range(share[part], share[part + 1]):
            rows = range(terms.row[k], terms.row[k + 1])
            if terms.kind[k] == LINEAR:
                for row in rows:
                    entries = range(terms.entry[row], terms.entry[row + 1])
                    angles.append(terms.offset[row] + sum(terms.weight[e] * x[terms.column[e]] for e in entries))
            else:
                angles.extend(self._term_derivative(k, x, t, 1))
        return angles

    def _angle_tangents(self, part: int, x: NDArray[Any], t: Any, tangent: NDArray[Any]) -> list[NDArray[Any]]:
        terms, share = self.flow_table.terms, self.flow_table.share
        tangents: list[NDArray[Any]] = []
        for k in range(share[part], share[part + 1]):
            rows = range(terms.row[k], terms.row[k + 1])
            if terms.kind[k] == LINEAR:
                for row in rows:
                    entries = range(terms.entry[row], terms.entry[row + 1])
                    zero = 0 * tangent[0]
                    tangents.append(sum((terms.weight[e] * tangent[terms.column[e]] for e in entries), zero))
            else:
                tangents.extend(self._term_derivative(k, x, t, 2) @ tangent[terms.target[rows.start : rows.stop]])
        return tangents

    def _term_derivative(self, k: int, x: NDArray[Any], t: Any, order: int) -> Any:
        """Return the gradient (order 1) or Hessian (order 2) of a term in its own coordinates."""
        terms = self.flow_table.terms
        coordinates = terms.target[terms.row[k] : terms.row[k + 1]]
        if terms.kind[k] == FUNCTION:
            return derivative_of(self.flow_table.functions[k], order, x[coordinates], t)
        result = np.full((len(coordinates),) * order, 0 * x[0], dtype=x.dtype)
        for monomial in range(terms.monomial[k], terms.monomial[k + 1]):
            factors = range(terms.factor[monomial], terms.factor[monomial + 1])
            powers = {int(terms.factor_row[f] - terms.row[k]): int(terms.exponent[f]) for f in factors}
            for indices in np.ndindex(*result.shape):
                result[indices] += self._derivative(terms.coefficient[monomial], powers, indices, x[coordinates])
        return result

    @staticmethod
    def _derivative(coefficient: Any, powers: dict[int, int], indices: tuple[int, ...], y: NDArray[Any]) -> Any:
        exponents = dict(powers)
        for index in indices:
            coefficient = coefficient * exponents.get(index, 0)
            exponents[index] = exponents.get(index, 0) - 1
        if coefficient == 0:
            return coefficient
        for index, exponent in exponents.items():
            coefficient = coefficient * y[index] ** exponent
        return coefficient

    def substeps(self, reach: Callable[[], Any]) -> int:
        """Return the number of time intervals in the flow of a free body; power series need no subdivision."""
        return substep_count(reach(), self.functions) if self._count is None else 1

    def negligible(self, terms: Sequence[FlowState]) -> bool:
        """Test whether the last two terms of a series are below rounding, or the next one beyond the truncation."""
        if self._count is not None:
            return len(terms) >= self._count
        first, last, previous = (largest_of(terms[k]) for k in (0, -1, -2))
        return all(max(a, b) <= self._u * c / 16 for a, b, c in zip(last, previous, first, strict=True))

    def _generator_on(self, part: int, angle: int, x: NDArray[Any]) -> NDArray[Any]:
        """Return D_a x for one form of a part (operation `apply` of the table)."""
        row, column, value = generator_entries(self.flow_table.state, part, angle)
        result = 0 * x
        np.add.at(result, row, value * x[column])
        return result

    def act(self, action: Action, part: int, theta: list[Any], vectors: NDArray[Any]) -> None:
        """Apply exp(sum theta_a D_a) of one part to vectors (n,) or (n, lanes), in place (operation `act`)."""
        if self._count is not None:
            self._act_by_series(part, theta, vectors, self._count)
            return
        for run in range(action.run[part], action.run[part + 1]):
            for q in range(action.angles[run]):
                angle = theta[int(action.angle[run]) + q]
                blocks = run_blocks(action, run, q)
                if action.kind[run] <= BlockKind.ROTATE:  # all blocks at once, number by number
                    together = np.stack([coordinates for coordinates, _ in blocks], axis=1)
                    local = vectors[together]
                    vectors[together] = local + self._increment(action, run, angle, blocks[0][1], local)
                    continue
                for coordinates, block in blocks:
                    local = vectors[coordinates]
                    vectors[coordinates] = local + self._increment(action, run, angle, block, local)

    def _act_by_series(self, part: int, theta: list[Any], vectors: NDArray[Any], count: int) -> None:
        """Add the terms of the Lie series to vectors (n,) of power series with `count` terms, in place."""
        power = vectors.copy()
        for k in range(1, count + 1):
            terms = [theta[a] * self._generator_on(part, a, power) for a in range(len(theta))]
            power = np.add.reduce(terms) / k
            vectors += power

    def _increment(self, action: Action, run: int, angle: Any, block: NDArray[Any], local: NDArray[Any]) -> Any:
        """Return (exp(angle B) - 1) on one block; arrays are first factors, since mpmath prints second ones."""
        f, rule, first = self.functions, RULES[BlockKind(action.kind[run])], action.constants[action.constant[run]]
        if rule.degree is None:
            return self._series(angle, first, int(action.degree[run]), block, local)
        mean, square = rule.mean(block, first), rule.square(block, first)
        s, c = self._entire_pair(angle**2 * square)
        moved = np.tensordot(block, local, axes=1) - local * mean
        if action.kind[run] == BlockKind.CUBIC:
            return moved * (angle * s) + (block @ moved) * (c / square)
        scale = f.exp(angle * mean)
        # If both are large, expm1(mean) = -1 + ... has lost digits, which a product with cosh would amplify.
        return local * (f.expm1(angle * mean) + scale * c) + moved * (scale * angle * s)

    def _series(self, angle: Any, norm: Any, degree: int, block: NDArray[Any], vectors: NDArray[Any]) -> Any:
        reach = abs(angle) * norm
        if not reach <= MOST_SUBSTEPS:
            raise ValueError(
                f"a flow is too long for one step: it would take {float(reach):.3g} substeps, and at most "
                f"{MOST_SUBSTEPS} are allowed; take a smaller step, or start nearer to the origin"
            )
        if reach > FEW_SUBSTEPS:
            halvings = int(np.ceil(np.log2(float(reach))))
            unit = block * 0 + np.eye(len(block), dtype=int)
            moved = self._series(angle / 2**halvings, norm, degree, block, unit)
            for _ in range(halvings):
                moved = moved * 2 + moved @ moved  # (1 + moved)^2 - 1
            return moved @ vectors
        substeps = max(1, int(self.functions.ceil(reach)))
        h, start = angle / substeps, vectors
        for _ in range(substeps):
            power, k, total = vectors, 0, 0 * vectors
            while k < degree or (norm != 0 and np.max(np.abs(power)) > self._u * np.max(np.abs(vectors))):
                k += 1
                power = (block @ power) * (h / k)
                total = total + power
            vectors = vectors + total
        return vectors - start

    def _entire_pair(self, z: Any) -> tuple[Any, Any]:
        """Return sinh(w)/w and cosh(w) - 1 with w^2 = z of either sign."""
        f = self.functions
        if abs(z) < 0.25:  # where cosh(w) - 1 would lose three bits or more
            s, c, term, k = 1 + 0 * z, z / 2, 1 + 0 * z, 1
            while abs(term) > self._u / 4:
                term = term * z / (2 * k * (2 * k + 1))
                s, c, k = s + term, c + term * z / (2 * k + 2), k + 1
            return s, c
        w = f.sqrt(abs(z))
        sine, half = (f.sinh(w), f.sinh(w / 2)) if z > 0 else (f.sin(w), f.sin(w / 2))
        return sine / w, (2 if z > 0 else -2) * half**2


def body_flow_parts(flow_table: FlowTable) -> list[bool]:
    """Test for each part whether it consists of free bodies."""
    shares = flow_table.parts.bodies
    return [int(first) in shares for first in flow_table.share[:-1]]


Vectors = NDArray[Any]
PIECE = 0.25  # largest norm of tau times the generator in one series
MAX_TERMS = 4096  # of a series, which converges after some hundred in thousands of digits


FlowState = tuple[Vectors, Vectors | None, Vectors | None]
"""State of a flow, or a term of its series: momentum, and optionally a group element (rows) and tangent vectors."""


def apply_body_flow(interpreter: Interpreter, part: int, tau: Any, state_of_flow: FlowState) -> None:
    """Apply the flow of free bodies over `tau` in place, by its time series, for angles that are not large."""
    body = _MovingBodies(interpreter.flow_table, part)
    count = interpreter.substeps(lambda: abs(tau) * body.speed(state_of_flow[0]) / PIECE)
    for _ in range(count):
        terms = [state_of_flow]
        while len(terms) <= MAX_TERMS:
            terms.append(body.next_term(terms, tau / count))
            if interpreter.negligible(terms):
                break
        for start, *more in zip(*terms, strict=True):
            if start is not None:
                start[...] = sum(reversed(more), 0 * start) + start


class _MovingBodies:
    """Generators and angular velocities of one part."""

    def __init__(self, flow_table: FlowTable, part: int) -> None:
        first, last = (flow_table.terms.row[flow_table.share[p]] for p in (part, part + 1))
        self.terms = flow_table.terms
        # The first row of a body has no weights, and is not an angular velocity.
        self.rows = [r for r in range(int(first), int(last)) if self.terms.entry[r] < self.terms.entry[r + 1]]
        angles = [r - int(first) for r in self.rows]
        self.state = _generators(flow_table.state, part, angles)
        self.group = None if flow_table.group is None else _generators(flow_table.group, part, angles)

    def speed(self, x: Vectors) -> Any:
        """Bound the angular speed of vectors."""
        return sum(abs(rate) * max(abs(self.state.value), default=0) for rate in self.rates(x))

    def rates(self, x: Vectors) -> NDArray[Any]:
        """Return the angular velocities along the generators, or their derivatives along the columns of x."""
        terms, rates = self.terms, np.empty((len(self.rows), *x.shape[1:]), dtype=x.dtype)
        for a, r in enumerate(self.rows):
            entries = range(terms.entry[r], terms.entry[r + 1])
            rates[a] = sum((terms.weight[e] * x[terms.column[e]] for e in entries), 0 * x[0])
        return rates

    def next_term(self, terms: Sequence[FlowState], tau: Any) -> FlowState:
        """Return the next term of the series, times its power of tau."""
        n = len(terms)
        sums: list[Any] = [None if item is None else 0 * item for item in terms[0]]
        for k, term in enumerate(terms):
            momentum, _, directions = term
            before, rates = terms[n - 1 - k], self.rates(momentum)
            for slot, generators in enumerate((self.state, self.group, self.state)):
                vectors = before[slot]
                if vectors is not None and generators is not None:
                    sums[slot] = sums[slot] + _turned(generators, rates, vectors)
            if directions is not None:
                changes, state = self.rates(directions), self.state
                np.add.at(sums[2], state.row, (state.value * before[0][state.column])[:, None] * changes[state.angle])
        x, group, tangent = (None if item is None else item * tau / n for item in sums)
        assert x is not None
        return x, group, tangent


def _generators(action: Action, part: int, angles: Sequence[int]) -> Generators:
    """Return the generators of some angles of a part, numbered by their positions."""
    pieces = [generator_entries(action, part, angle) for angle in angles]
    owner = np.repeat(np.arange(len(pieces)), [len(piece[0]) for piece in pieces])
    return Generators(owner, *(np.concatenate(column) for column in zip(*pieces, strict=True)))


def _turned(generators: Generators, rates: NDArray[Any], vectors: Vectors) -> Vectors:
    """Apply sum_a rate_a D_a to vectors (n,) or (n, m)."""
    factors = rates[generators.angle] * generators.value
    moved = vectors[generators.column] * (factors if vectors.ndim == 1 else factors[:, None])
    result = 0 * vectors
    np.add.at(result, generators.row, moved)
    return result


def largest_of(term: Iterable[Vectors | None]) -> Any:
    """Return the largest absolute entry of each array of a term."""
    return [np.max(np.abs(item), initial=0) for item in term if item is not None]


def substep_count(reach: Any, functions: Any) -> int:
    """Return the number of substeps of a flow of length `reach`; raise ValueError if it is too long."""
    if not reach <= MOST_SUBSTEPS:
        raise ValueError(
            f"a free body turns too far in one step: it would take {float(reach):.3g} substeps, and at most "
            f"{MOST_SUBSTEPS} are allowed; take a smaller step, or start nearer to the origin"
        )
    return max(1, int(functions.ceil(reach)))
