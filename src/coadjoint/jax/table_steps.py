"""Flow table as JAX operations: angles, and closed forms of all blocks of a part at once.

Blocks are arranged in layers without common coordinates, x + S N x + C N^2 x with factors by coordinate, so that the
number of operations does not depend on that of blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.scipy.linalg import expm

from coadjoint.jax.body_motion import Angles, body_angles
from coadjoint.jax.stage_steps import Steps, sparse
from coadjoint.jax.traced_functions import TracedFunction, gradient_of
from coadjoint.program.blocks import MOST_SUBSTEPS, RULES, TAYLOR_DEGREE, BlockKind
from coadjoint.program.group_correction import UnshiftTables

Table = Mapping[str, Any]
State = tuple[Any, Any]
"""A state, and the rows of the group element, None in runs without an attitude."""
BlockAction = Callable[[Any, Any], Any]
"""The action exp(theta_1 D_1 + ...) x of blocks, of the angles theta of a part and x."""

# Version of the table of a splitting that is read, as docs/table.md describes it.
VERSION = 3
# Halvings of the generator of an attitude over the time of a run; beyond them it is NaN.
MOST_SQUARINGS = 48
DEPENDENT = ("offset", "weight", "coefficient_of_monomial")


@jax.custom_jvp
def exponential(D: Any, norm: Any, theta: Any) -> Any:
    """Return exp(theta D) for a constant matrix D of this 1-norm; NaN for more than `MOST_SUBSTEPS` substeps."""
    reach = jnp.abs(theta) * norm
    halvings = jnp.ceil(jnp.log2(jnp.clip(reach, 1.0, MOST_SUBSTEPS)))
    A, one = theta * jnp.exp2(-halvings) * D, jnp.eye(len(D))
    total = lax.fori_loop(0, TAYLOR_DEGREE, lambda k, E: one + A @ E / (TAYLOR_DEGREE - k), one)
    total = lax.while_loop(lambda s: s[0] > 0, lambda s: (s[0] - 1, s[1] @ s[1]), (halvings, total))[1]
    return jnp.where(reach <= MOST_SUBSTEPS, total, jnp.nan)


@exponential.defjvp
def _exponential_jvp(values: Any, tangents: Any) -> Any:
    D, norm, theta = values
    E = exponential(D, norm, theta)
    return E, D @ E * tangents[2]


def _part(
    table: Table, gradients: Mapping[int, TracedFunction], part: int, side: int | None
) -> tuple[Callable[[Any], Any], Callable[..., State]]:
    """Return the constants of a part from the numbers of the table, and its flow of these, tau, t and a state."""
    first, last = (int(k) for k in table["share"][part : part + 2])
    rows = slice(int(table["term_row"][first]), int(table["term_row"][last]))
    constants_of, angles = (
        body_angles(table, part) if first in table["bodies"] else _angles(table, gradients, first, last)
    )
    count = rows.stop - rows.start
    layers = _layers(table, "state", int(table["dim"]), part, count)
    on_group = [] if side is None else _layers(table, "group", side, part, count)
    w = table["frequency"][rows]
    safe = np.where(w == 0.0, 1.0, w)

    def flow(constants: Any, params: Any, tau: Any, t: Any, state: State) -> State:
        x, elements = state
        theta = angles(constants, params, tau, x, t)
        if np.any(w):
            theta = jnp.where(w == 0.0, theta, 2.0 * jnp.arctan(0.5 * safe * theta) / safe)
        for act in layers:
            x = act(theta, x)
        for act in on_group:
            elements = jax.vmap(partial(act, theta))(elements)
        return x, elements

    return constants_of, flow


def table_steps(
    table: Table, functions: Mapping[int, Any], side: int | None, unshift: Sequence[UnshiftTables]
) -> Steps:
    """Return the steps of a splitting; `begin` undoes the finish, so that all steps have the same flows."""
    if table["version"] > VERSION:
        raise ValueError(f"the table has the version {table['version']}; this reader knows versions up to {VERSION}")
    generators, after_shift = [_generator(one) for one in unshift], _after_shift(table)
    gradients = {k: gradient_of(term) for k, term in functions.items()}
    parts = [_part(table, gradients, p, side) for p in range(len(table["share"]) - 1)]
    first_rows, step_rows, finish_rows = (range(*table["section"][k : k + 2].tolist()) for k in range(3))

    def constants(energy: Any) -> Any:
        """Return the constants of the parts, factors of Casimirs, and params of the energy."""
        numbers = [jnp.asarray(table[name]) for name in DEPENDENT]
        factors = jnp.array([shift["factor"] for shift in table["shift"]])
        rest, factors = after_shift(energy.coefficients, factors)
        for k, name in enumerate(DEPENDENT):
            own = table["provenance"][name]
            numbers[k] = numbers[k].at[own["index"]].set(own["factor"] * rest[own["monomial"]])
        joined = jnp.concatenate(numbers)
        return [constants_of(joined) for constants_of, _ in parts], factors, energy.params

    def flows(constants: Any, rows: Sequence[int], t: Any, h: Any, state: State, direction: float = 1.0) -> State:
        """Apply the flows of rows of a step from t, or in the direction -1 those of its inverse."""
        if not len(rows):
            return state
        used = list(rows)
        chosen, number = np.unique(table["part"][used], return_inverse=True)
        each: list[Callable[..., Any]] = [partial(parts[p][1], constants[0][p], constants[2]) for p in chosen.tolist()]

        def flow(state: State, row: Any) -> Any:
            part, coefficient, moment = row
            return lax.switch(part, each, direction * coefficient * h, t + moment * h, state), None

        # A loop, since XLA would otherwise join flows into one, and compute their sines again for each use.
        columns = number, table["coefficient"][used], table["moment"][used]
        return lax.scan(jax.checkpoint(flow, prevent_cse=False), state, columns)[0]

    def unturned(start: State) -> State:
        return start[0], None if side is None else jnp.eye(side)

    def begin(constants: Any, start: State, t: Any, h: Any) -> State:
        return flows(constants, finish_rows[::-1], t - h, h, unturned(start), -1.0)

    def step(constants: Any, state: State, t: Any, h: Any, member: Any) -> State:
        return flows(constants, step_rows, t, h, state)

    def finish(constants: Any, state: State, t: Any, h: Any, start: State, elapsed: Any) -> State:
        """Return the finished state, with the attitude, which subtracted Casimirs turn."""
        (x, element), (x0, attitude) = flows(constants, finish_rows, t, h, state), start
        if side is None:
            return x, None
        if generators:
            turn = sum(factor * generator(x0) for factor, generator in zip(constants[1], generators, strict=True))
            attitude = product(attitude, expm(elapsed * turn, max_squarings=MOST_SQUARINGS))
        return x, product(attitude, element)

    def whole(constants: Any, start: State, t: Any, h: Any, member: Any) -> State:
        return finish(constants, flows(constants, first_rows, t, h, unturned(start)), t, h, start, h)

    def undo(constants: Any, state: State, t: Any, h: Any, member: Any) -> State:
        return flows(constants, step_rows[::-1], t, h, state, -1.0)

    return Steps(constants, step, whole, begin, finish, tuple(gradients.values()), undo)


def _generator(tables: UnshiftTables) -> Callable[[Any], Any]:
    """Return the generator X of the group element for a Casimir, as a function of the momentum."""
    cells, summands = [], []
    for b in range(tables.components):
        inside = tables.coordinate[tables.begin[b] : tables.begin[b + 1]].tolist()
        for f in range(int(tables.form[b]), int(tables.form[b + 1])):
            column, row = divmod(int(tables.cell[f]), len(inside))
            for e in range(int(tables.entry[f]), int(tables.entry[f + 1])):
                cells.append((inside[row], inside[column]))
                summands.append((int(tables.column[e]), float(tables.weight[e])))
    places = np.array(cells, dtype=np.int64).reshape(-1, 2).T
    columns, weights = (np.array([one[k] for one in summands]) for k in (0, 1))

    def generator(x: Any) -> Any:
        return jnp.zeros((tables.size, tables.size)).at[places[0], places[1]].add(weights * x[columns.astype(np.int64)])

    return generator


def product(A: Any, B: Any) -> Any:
    """Return A B in full precision, which devices do not use otherwise."""
    return jnp.matmul(A, B, precision=lax.Precision.HIGHEST)


def _after_shift(table: Table) -> Callable[..., tuple[Any, Any]]:
    """Return the function that subtracts Casimirs from the coefficients of the energy, and returns the factors."""
    monomials = {tuple(key): k for k, key in enumerate(table["energy"]["monomials"])}
    shifts = [] if table["bodies"] else table["shift"]
    found = [
        (k, monomials[tuple(np.repeat(np.arange(len(exponents)), exponents).tolist())], float(c))
        for k, shift in enumerate(shifts)
        for exponents, c in zip(shift["exponents"], shift["coefficients"], strict=True)
    ]
    number, cells, values = (np.array([one[column] for one in found]) for column in range(3))
    removed = np.flatnonzero([cell == shifts[k]["monomial"] for k, cell, _ in found])

    def after_shift(energy: Any, factor: Any) -> tuple[Any, Any]:
        energy = jnp.asarray(energy)
        if not found:
            return energy, factor
        factor = factor.at[number[removed]].set(energy[cells[removed]] / values[removed])
        return energy.at[cells].add(-factor[number] * values), factor

    return after_shift


def _angles(table: Table, gradients: Mapping[int, TracedFunction], first: int, last: int) -> Angles:
    """Return the angles of the terms `first` to `last` - 1, which are one part, as sums over factors and monomials."""
    n, rows = int(table["dim"]), slice(int(table["term_row"][first]), int(table["term_row"][last]))
    may_change = {*table["provenance"]["offset"]["index"].tolist()}
    starts = np.cumsum([0, *(len(table[name]) for name in DEPENDENT)])
    found: list[tuple[int, int, float, tuple[int, ...]]] = []
    for row in range(rows.start, rows.stop):
        if table["offset"][row] or row in may_change:
            found.append((row - rows.start, row, 1.0, ()))
        for e in range(table["entry"][row], table["entry"][row + 1]):
            found.append((row - rows.start, int(starts[1] + e), 1.0, (int(table["column"][e]),)))
    for m in range(table["monomial"][first], table["monomial"][last]):
        factors = range(table["factor"][m], table["factor"][m + 1])
        own = {int(table["factor_row"][f]): int(table["exponent"][f]) for f in factors}
        for row, power in own.items():
            rest = [(table["target"][r], e - (r == row)) for r, e in own.items()]
            coordinates = tuple(int(i) for i, e in rest for _ in range(e))
            found.append((row - rows.start, int(starts[2] + m), float(power), coordinates))
    width = max((len(one[3]) for one in found), default=0)
    padded = [(*one[3], *[n] * (max(1, width) - len(one[3]))) for one in found]
    # Of each summand: its angle, its number among the dependent ones, and the multiple of it. The coordinates are
    # multiplied, padded by one behind the last coordinate, where there is a one.
    coordinate = np.array(padded, dtype=np.int64).reshape(len(found), max(1, width))
    angle, number = (np.array([one[k] for one in found], dtype=np.int64) for k in (0, 1))
    factor, degree, size = np.array([one[2] for one in found]), (coordinate < n).sum(axis=1), rows.stop - rows.start
    alone, linear, other = degree == 0, degree == 1, degree > 1
    of_user = [
        (int(table["term_row"][k] - rows.start), table["target"][slice(*table["term_row"][k : k + 2])], gradient)
        for k, gradient in gradients.items()
        if first <= k < last
    ]

    def constants(numbers: Any) -> Any:
        """Return the offsets, the matrix of linear summands, and the sums of all others with their coordinates."""
        values = factor * numbers[number]
        offsets = jnp.zeros(size).at[angle[alone]].add(values[alone])
        matrix = sparse(angle[linear], coordinate[linear, 0], values[linear], (size, n))
        if not other.any():
            return offsets, matrix, None
        index = np.arange(int(other.sum()))
        return offsets, matrix, sparse(angle[other], index, values[other], (size, len(index)))

    def at(constants: Any, params: Any, tau: Any, x: Any, t: Any) -> Any:
        offsets, matrix, others = constants
        theta = offsets + matrix.times(x)
        if others is not None:
            theta = theta + others.times(jnp.append(x, 1.0)[coordinate[other]].prod(axis=1))
        for start, own, gradient in of_user:
            theta = theta.at[start : start + len(own)].add(gradient.at(x[own], t, params))
        return tau * theta

    return constants, at


def _layers(table: Table, action: str, n: int, part: int, count: int) -> list[BlockAction]:
    """Return the blocks of a part in layers, in an order in which overlapping blocks remain, on n coordinates."""
    prefix = f"{action}_"
    table = {name.removeprefix(prefix): column for name, column in table.items() if name.startswith(prefix)}
    level, layers = np.zeros(n, dtype=np.int64), dict[int, list[int]]()
    for b in range(table["block"][part], table["block"][part + 1]):
        inside = _coordinates(table, b)
        own = int(level[inside].max())
        level[inside] = own + 1
        layers.setdefault(own, []).append(b)
    found: list[BlockAction] = []
    for _, blocks in sorted(layers.items()):
        series = [b for b in blocks if table["kind"][b] == BlockKind.SERIES and table["norm"][b]]
        closed = [b for b in blocks if b not in series]
        if closed:
            found.append(_layer(table, closed, n, count))
        for b in series:
            inside, entries = _coordinates(table, b), _entries(table, b)
            D = np.zeros((n, n))
            D[table["row"][entries], table["column"][entries]] = table["value"][entries]
            found.append(_series(int(table["angle"][entries][0]), inside, D[np.ix_(inside, inside)], table["norm"][b]))
    return found


def _series(angle: int, coordinates: Any, D: Any, norm: Any) -> BlockAction:
    """Return the action of a block of no closed form, by its series with repeated squares."""

    def act(theta: Any, x: Any) -> Any:
        return x.at[coordinates].set(exponential(D, float(norm), theta[angle]) @ x[coordinates])

    return act


def _layer(table: Table, blocks: Sequence[int], n: int, count: int) -> BlockAction:
    """Return the action exp(theta_1 D_1 + ...) of blocks without common coordinates, with constants for each one."""
    angle, degree, nilpotent = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=bool)
    mean, square = np.zeros(n), np.zeros(n)
    cells: dict[tuple[int, int], float] = {}
    for b in blocks:
        inside, entries, kind = _coordinates(table, b), _entries(table, b), table["kind"][b]
        angle[inside] = table["angle"][entries][0]
        mean[inside], square[inside] = table["mean"][b], table["lambda"][b]
        nilpotent[inside] = kind != BlockKind.SCALE and table["lambda"][b] == 0.0
        powers = RULES[BlockKind(kind)].degree
        degree[inside] = table["degree"][b] if powers is None else powers
        own = {(int(i), int(i)): -float(table["mean"][b]) for i in inside if table["mean"][b]}
        places = zip(table["row"][entries].tolist(), table["column"][entries].tolist(), strict=True)
        for place, value in zip(places, table["value"][entries].tolist(), strict=True):
            own[place] = own.get(place, 0.0) + value
        cells |= {place: value for place, value in own.items() if value}
    root = np.sqrt(np.abs(square))
    rows, columns = ([place[k] for place in cells] for k in (0, 1))
    of_angle = sparse(np.arange(n), angle, np.ones(n), (n, count))
    frequency, growth = np.where(square < 0.0, root, 0.0), np.where(square > 0.0, root, 0.0)
    inverse = 1.0 / np.where(root == 0.0, np.inf, root)
    N = sparse(rows, columns, np.array(list(cells.values())), (n, n))

    def act(theta: Any, x: Any) -> Any:
        t = of_angle.times(theta)
        S, half = jnp.where(nilpotent, t, 0.0), jnp.zeros_like(t)
        if np.any(frequency):
            S = S + jnp.sin(frequency * t) * inverse
            half = half + jnp.sin(0.5 * frequency * t) * inverse
        if np.any(growth):
            S = S + jnp.sinh(growth * t) * inverse
            half = half + jnp.sinh(0.5 * growth * t) * inverse
        power = N.times(x)
        moved = S * power
        if np.any(degree > 1):
            power = N.times(power)
            moved = moved + (jnp.where(nilpotent, 0.5 * t * t, 0.0) + 2.0 * half * half) * power
        factor = 0.5 * t * t
        for k in range(3, int(degree.max()) + 1):
            power, factor = N.times(power), factor * t / k
            moved = moved + jnp.where(nilpotent & (degree >= k), factor, 0.0) * power
        if not np.any(mean):
            return x + moved
        return x + jnp.expm1(mean * t) * x + jnp.exp(mean * t) * moved

    return act


def _entries(table: Table, b: int) -> slice:
    return slice(int(table["entry"][b]), int(table["entry"][b + 1]))


def _coordinates(table: Table, b: int) -> Any:
    entries = _entries(table, b)
    return np.union1d(table["row"][entries], table["column"][entries])
