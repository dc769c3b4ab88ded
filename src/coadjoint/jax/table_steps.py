"""The table of a splitting as operations of JAX: angles, and closed forms of all blocks of a part at once.

The blocks of a part are arranged in layers without common coordinates. A layer is x + S N x + C N^2 x, with factors S
and C for each coordinate, so that its operations do not depend on the number of blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from coadjoint.jax.body_angles import BodyAngles
from coadjoint.jax.sparse import Sparse, sparse
from coadjoint.program.blocks import MOST_SUBSTEPS, RULES, TAYLOR_DEGREE, Kind

Table = Mapping[str, Any]

# Version of the table of a splitting that is read, as docs/table.md describes it.
VERSION = 3
DEPENDENT = ("offset", "weight", "coefficient_of_monomial")


class Layer(NamedTuple):
    """Blocks without common coordinates: the angle of each coordinate, the constants of its block, and N of all."""

    angle: Sparse
    mean: Any
    frequency: Any
    growth: Any
    inverse: Any
    nilpotent: Any
    degree: Any
    N: Sparse

    def act(self, theta: Any, x: Any) -> Any:
        """Return exp(theta_1 D_1 + ...) x."""
        t = self.angle.times(theta)
        S, half = jnp.where(self.nilpotent, t, 0.0), jnp.zeros_like(t)
        if np.any(self.frequency):
            S = S + jnp.sin(self.frequency * t) * self.inverse
            half = half + jnp.sin(0.5 * self.frequency * t) * self.inverse
        if np.any(self.growth):
            S = S + jnp.sinh(self.growth * t) * self.inverse
            half = half + jnp.sinh(0.5 * self.growth * t) * self.inverse
        power = self.N.times(x)
        moved = S * power
        if np.any(self.degree > 1):
            power = self.N.times(power)
            moved = moved + (jnp.where(self.nilpotent, 0.5 * t * t, 0.0) + 2.0 * half * half) * power
        factor = 0.5 * t * t
        for k in range(3, int(self.degree.max()) + 1):
            power, factor = self.N.times(power), factor * t / k
            moved = moved + jnp.where(self.nilpotent & (self.degree >= k), factor, 0.0) * power
        if not np.any(self.mean):
            return x + moved
        mean = self.mean * t
        return x + jnp.expm1(mean) * x + jnp.exp(mean) * moved


class SeriesBlock(NamedTuple):
    """A block of no closed form, by its series with repeated squares."""

    angle: int
    coordinates: Any
    D: Any
    norm: float

    def act(self, theta: Any, x: Any) -> Any:
        """Return exp(theta D) x."""
        y = x[self.coordinates]
        return x.at[self.coordinates].set(exponential(self.D, self.norm, theta[self.angle]) @ y)


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


class Angles(NamedTuple):
    """Angles of a part as sums over factors in (linear terms) or over monomials of coordinates.

    `row`, `number` and `factor` are of each summand: its angle, its number among the dependent ones, and the multiple
    of it; `coordinates` are those that are multiplied, padded by one behind the last coordinate, where there is a one.
    """

    size: int
    dim: int
    row: Any
    number: Any
    factor: Any
    coordinates: Any

    def constants(self, numbers: Any) -> Any:
        """Return the offsets, the matrix of linear summands, and the sums of all others with their coordinates."""
        values, degree = self.factor * numbers[self.number], (self.coordinates < self.dim).sum(axis=1)
        offset, linear, other = degree == 0, degree == 1, degree > 1
        offsets = jnp.zeros(self.size).at[self.row[offset]].add(values[offset])
        matrix = sparse(self.row[linear], self.coordinates[linear, 0], values[linear], (self.size, self.dim))
        if not other.any():
            return offsets, matrix, None
        index = np.arange(int(other.sum()))
        return offsets, matrix, sparse(self.row[other], index, values[other], (self.size, len(index)))

    def at(self, constants: Any, x: Any) -> Any:
        """Return the angles at a state."""
        offsets, matrix, others = constants
        theta = offsets + matrix.times(x)
        if others is None:
            return theta
        chosen = self.coordinates[(self.coordinates < self.dim).sum(axis=1) > 1]
        products = jnp.append(x, 1.0)[chosen].prod(axis=1)
        return theta + others.times(products)


class Part:
    """A part of the table: its angles, and layers of its blocks."""

    def __init__(self, table: Table, part: int) -> None:
        first, last = (int(k) for k in table["share"][part : part + 2])
        self.rows = slice(int(table["term_row"][first]), int(table["term_row"][last]))
        self.angles = _angles(table, first, last)
        self.bodies = BodyAngles(table, part) if first in table["bodies"] else None
        self.layers = _layers(table, part, self.rows.stop - self.rows.start)
        w = table["frequency"][self.rows]
        self.frequency, self.safe = w, np.where(w == 0.0, 1.0, w)

    def flow(self, constants: Any, tau: Any, x: Any) -> Any:
        """Advance the state by the flow of the part over the time tau."""
        if self.bodies is not None:
            theta = self.bodies.angles(tau, x)
        else:
            theta = tau * self.angles.at(constants, x)
        if np.any(self.frequency):
            rational = 2.0 * jnp.arctan(0.5 * self.safe * theta) / self.safe
            theta = jnp.where(self.frequency == 0.0, theta, rational)
        for layer in self.layers:
            x = layer.act(theta, x)
        return x


class TableSteps:
    """Steps of a splitting, from its table.

    Between steps the state is unfinished: `begin` undoes the finish, so that all steps have the same flows.
    """

    def __init__(self, table: Table) -> None:
        if table["version"] > VERSION:
            raise ValueError(
                f"the table has the version {table['version']}; this reader knows versions up to {VERSION}"
            )
        self.table = table
        self.after_shift = _after_shift(table)
        self.parts = [Part(table, p) for p in range(len(table["share"]) - 1)]
        sections = [range(*table["section"][k : k + 2].tolist()) for k in range(3)]
        self.first_rows, self.step_rows, self.finish_rows = sections

    def in_bodies(self) -> list[int]:
        """Return the coefficients of the energy in the weights of free bodies, of which constants are made."""
        table, own = self.table, self.table["provenance"]["weight"]
        edges = table["entry"][table["term_row"]]
        share = np.searchsorted(edges, own["index"], side="right") - 1
        found: list[int] = own["monomial"][np.isin(share, table["bodies"])].tolist()
        return found

    def constants(self, energy: Any) -> Any:
        """Return the constants of the parts for coefficients of the energy, those of `table["energy"]`."""
        numbers = [jnp.asarray(self.table[name]) for name in DEPENDENT]
        if energy is not None:
            rest = self.after_shift(energy)
            for k, name in enumerate(DEPENDENT):
                own = self.table["provenance"][name]
                numbers[k] = numbers[k].at[own["index"]].set(own["factor"] * rest[own["monomial"]])
        joined = jnp.concatenate(numbers)
        return [part.angles.constants(joined) for part in self.parts]

    def begin(self, constants: Any, x: Any, h: Any) -> Any:
        """Return the unfinished state of which x is the finished one."""
        return self._flows(constants, self.finish_rows[::-1], -h, x)

    def step(self, constants: Any, x: Any, t: Any, h: Any) -> Any:
        """Take a step of an unfinished state."""
        return self._flows(constants, self.step_rows, h, x)

    def finish(self, constants: Any, x: Any, h: Any) -> Any:
        """Return the finished state."""
        return self._flows(constants, self.finish_rows, h, x)

    def whole(self, constants: Any, x: Any, t: Any, h: Any) -> Any:
        """Take a step of a finished state to a finished state."""
        return self._flows(constants, [*self.first_rows, *self.finish_rows], h, x)

    def _flows(self, constants: Any, rows: Sequence[int], h: Any, x: Any) -> Any:
        if not len(rows):
            return x
        used, parts = np.unique(self.table["part"][list(rows)], return_inverse=True)
        flows: list[Callable[..., Any]] = [partial(self.parts[part].flow, constants[part]) for part in used.tolist()]
        # A loop, since XLA would otherwise join flows into one, and compute their sines again for each use.
        flow = jax.checkpoint(lambda x, row: (lax.switch(row[0], flows, row[1] * h, x), None), prevent_cse=False)
        return lax.scan(flow, x, (parts, self.table["coefficient"][list(rows)]))[0]


def _after_shift(table: Table) -> Callable[[Any], Any]:
    """Return the function that subtracts Casimirs, whose factors may follow coefficients, from those of the energy."""
    monomials = {tuple(key): k for k, key in enumerate(table["energy"]["monomials"])}
    shifts = [] if table["bodies"] else table["shift"]
    found = [
        (k, monomials[tuple(np.repeat(np.arange(len(exponents)), exponents).tolist())], float(c))
        for k, shift in enumerate(shifts)
        for exponents, c in zip(shift["exponents"], shift["coefficients"], strict=True)
    ]
    number, cells, values = (np.array([one[column] for one in found]) for column in range(3))
    removed = np.flatnonzero([cell == shifts[k]["monomial"] for k, cell, _ in found])

    def after_shift(energy: Any) -> Any:
        energy = jnp.asarray(energy)
        if not found:
            return energy
        factor = jnp.array([shift["factor"] for shift in shifts])
        factor = factor.at[number[removed]].set(energy[cells[removed]] / values[removed])
        return energy.at[cells].add(-factor[number] * values)

    return after_shift


def _angles(table: Table, first: int, last: int) -> Angles:
    """Return the angles of the terms `first` to `last` - 1, which are one part."""
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
    places = np.array(padded, dtype=np.int64).reshape(len(found), max(1, width))
    angle, number = (np.array([one[k] for one in found], dtype=np.int64) for k in (0, 1))
    return Angles(rows.stop - rows.start, n, angle, number, np.array([one[2] for one in found]), places)


def _layers(table: Table, part: int, count: int) -> list[Layer | SeriesBlock]:
    """Return the blocks of a part with `count` angles in layers, in an order in which overlapping blocks remain."""
    n = int(table["dim"])
    level, layers = np.zeros(n, dtype=np.int64), dict[int, list[int]]()
    for b in range(table["state_block"][part], table["state_block"][part + 1]):
        inside = _coordinates(table, b)
        own = int(level[inside].max())
        level[inside] = own + 1
        layers.setdefault(own, []).append(b)
    found: list[Layer | SeriesBlock] = []
    for _, blocks in sorted(layers.items()):
        series = [b for b in blocks if table["state_kind"][b] == Kind.SERIES and table["state_norm"][b]]
        closed = [b for b in blocks if b not in series]
        if closed:
            found.append(_layer(table, closed, n, count))
        for b in series:
            inside, entries = _coordinates(table, b), _entries(table, b)
            D = np.zeros((n, n))
            D[table["state_row"][entries], table["state_column"][entries]] = table["state_value"][entries]
            angle = int(table["state_angle"][entries][0])
            found.append(SeriesBlock(angle, inside, D[np.ix_(inside, inside)], float(table["state_norm"][b])))
    return found


def _layer(table: Table, blocks: Sequence[int], n: int, count: int) -> Layer:
    angle, degree, nilpotent = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=bool)
    mean, square = np.zeros(n), np.zeros(n)
    cells: dict[tuple[int, int], float] = {}
    for b in blocks:
        inside, entries, kind = _coordinates(table, b), _entries(table, b), table["state_kind"][b]
        angle[inside] = table["state_angle"][entries][0]
        mean[inside], square[inside] = table["state_mean"][b], table["state_lambda"][b]
        nilpotent[inside] = kind != Kind.SCALE and table["state_lambda"][b] == 0.0
        powers = RULES[Kind(kind)].degree
        degree[inside] = table["state_degree"][b] if powers is None else powers
        own = {(int(i), int(i)): -float(table["state_mean"][b]) for i in inside if table["state_mean"][b]}
        places = zip(table["state_row"][entries].tolist(), table["state_column"][entries].tolist(), strict=True)
        for place, value in zip(places, table["state_value"][entries].tolist(), strict=True):
            own[place] = own.get(place, 0.0) + value
        cells |= {place: value for place, value in own.items() if value}
    root = np.sqrt(np.abs(square))
    rows, columns = ([place[k] for place in cells] for k in (0, 1))
    return Layer(
        angle=sparse(np.arange(n), angle, np.ones(n), (n, count)),
        mean=mean,
        frequency=np.where(square < 0.0, root, 0.0),
        growth=np.where(square > 0.0, root, 0.0),
        inverse=1.0 / np.where(root == 0.0, np.inf, root),
        nilpotent=nilpotent,
        degree=degree,
        N=sparse(rows, columns, np.array(list(cells.values())), (n, n)),
    )


def _entries(table: Table, b: int) -> slice:
    return slice(int(table["state_entry"][b]), int(table["state_entry"][b + 1]))


def _coordinates(table: Table, b: int) -> Any:
    """Return the coordinates of a block."""
    entries = _entries(table, b)
    return np.union1d(table["state_row"][entries], table["state_column"][entries])
