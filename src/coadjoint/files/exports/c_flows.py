"""Parts of a splitting in C: their angles at a state, and the blocks that move it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from coadjoint.files.exports.c_statements import (
    FEW,
    VECTORS,
    DeclaredInputs,
    Numbers,
    Value,
    block,
    function,
    gradient,
    literal,
    numbers,
    repeated,
)
from coadjoint.kernels.interface import limit
from coadjoint.kernels.tables.flow import FlowTables
from coadjoint.program.actions import Action
from coadjoint.program.blocks import CUBIC_HEADER, RULES, BlockKind

BODY_COLUMNS, BODY_CONSTANTS, BODY_ROTATIONS = 6, 15, 4
DIRECT, BONDS = 1, 2
ATTITUDE = "double *A, double *E"
"""Arguments: a group element, row by row, and the errors of its sums."""
MOST_ROWS = 40
"""Flows of a step that are written out; more of them are a loop over a table."""


class RepeatedBlocks(NamedTuple):
    """Blocks of one kind in order, `repeat` for each of some angles; none if the angle `skip` is zero."""

    kind: int
    rational: bool
    angle: list[int]
    repeat: int
    skip: int
    indices: list[int]
    constants: list[float]
    width: int
    entries: int
    degree: int

    def joins(self, other: RepeatedBlocks) -> bool:
        """Return whether the blocks of another run may follow in the same list."""
        if self.kind in (BlockKind.CUBIC, BlockKind.SERIES) or (self.skip < 0) != (other.skip < 0):
            return False
        return self[:2] == other[:2] and self.repeat == other.repeat


def runs_of_part(action: Action, p: int, called: bool) -> list[RepeatedBlocks]:
    """Return the runs of a part; neighbours of one kind are joined. `called` means that bodies move it."""
    found: list[RepeatedBlocks] = []
    for run in range(int(action.run[p]), int(action.run[p + 1])):
        kind, rational = int(action.kind[run]) % limit("RATIONAL"), int(action.kind[run]) >= limit("RATIONAL")
        angles, repeat, width, entries = (
            int(column[run]) for column in (action.angles, action.repeat, action.width, action.entries)
        )
        indices, constants = RULES[BlockKind(kind)].stored(angles, repeat, width, entries)
        first, constant, angle = int(action.position[run]), int(action.constant[run]), int(action.angle[run])
        one = RepeatedBlocks(
            kind,
            rational,
            list(range(angle, angle + angles)),
            repeat,
            angle if called and angle % BODY_ROTATIONS == 0 else -1,
            action.indices[first : first + indices].tolist(),
            action.constants[constant : constant + constants].tolist(),
            width,
            entries,
            int(action.degree[run]),
        )
        if found and found[-1].joins(one):
            last = found.pop()
            joined = {name: getattr(last, name) + getattr(one, name) for name in ("angle", "indices", "constants")}
            one = one._replace(**joined)
        found.append(one)
    return found


class PartsInC:
    """The functions of the parts of a splitting; `inputs` declares the inputs as an argument, if there are any."""

    def __init__(self, tables: FlowTables, number: Numbers, inputs: DeclaredInputs) -> None:
        compensated = tables.compensated
        self.state = (
            DeclaredInputs("double *x, double *error", "x, error") if compensated else DeclaredInputs("double *x", "x")
        )
        self.tables, self.terms, self.number, self.inputs = tables, tables.terms, number, inputs
        self.parts = sorted(set(tables.part.tolist()))
        self.runs = {p: runs_of_part(tables.state, p, bool(self._called(p))) for p in self.parts}
        self.size, self.side = tables.state.size, tables.group.size
        self.group_runs = {
            p: runs_of_part(tables.group, p, bool(self._called(p))) if self.side else [] for p in self.parts
        }

    @property
    def widest(self) -> int:
        """The number of coordinates of the widest block that is a matrix."""
        both = *self.runs.values(), *self.group_runs.values()
        return max((run.width for runs in both for run in runs), default=0)

    def functions(self, tangent: bool) -> list[str]:
        """Return the functions of all parts, and those of a flow by the number of its part."""
        lines: list[str] = []
        for p in self.parts:
            part = self._called_part(p) if self._called(p) else self._part(p)
            lines += [*part.functions(self, p), *(part.with_tangents(self, p) if tangent else [])]
        if max(np.diff(self.tables.section)) > MOST_ROWS:
            lines += self._switch("part", *self.state)
            if tangent:
                declared, passed = self.state
                lines += self._switch("part_with_tangents", f"{declared}, {VECTORS}", f"{passed}, v, vectors")
            if self.side:
                lines += self._switch(
                    "part_with_attitude", f"{self.state.declared}, {ATTITUDE}", f"{self.state.passed}, A, E"
                )
        return lines

    def _switch(self, name: str, arguments: str, passed: str) -> list[str]:
        cases = [f"case {p}: coadjoint_{name}_{p}({passed}{self.inputs.passed}, tau); break;" for p in self.parts]
        body = block("switch (part)", [*cases, "default: break;"])
        return function(name, f"int part, {arguments}{self.inputs.declared}, double tau", body)

    def rows(self, first: int, last: int, kind: str = "", h: str = "h") -> list[str]:
        """Return the calls of the flows first to last - 1 over a step h; `kind` says what else they move."""
        name, state = f"part{kind}", {"": "", "_with_tangents": ", v, vectors", "_with_attitude": ", A, E"}[kind]
        state = self.state.passed + state + self.inputs.passed
        parts, taus = self.tables.part[first:last].tolist(), self.tables.tau[first:last].tolist()
        if len(parts) <= MOST_ROWS:
            return [f"coadjoint_{name}_{p}({state}, {c!r} * {h});" for p, c in zip(parts, taus, strict=True)]
        return repeated(f"coadjoint_{name}({{p}}, {state}, {{c}} * {h});", {"p": parts, "c": taus})

    def _shares(self, p: int) -> range:
        return range(int(self.tables.share[p]), int(self.tables.share[p + 1]))

    def _called(self, p: int) -> list[int]:
        """Return the free bodies or bonds of a part."""
        return [int(self.tables.called[k]) for k in self._shares(p) if self.tables.called[k] >= 0]

    def _part(self, p: int) -> PartInC:
        shares = self._shares(p)
        origin, end = int(self.terms.row[shares.start]), int(self.terms.row[shares.stop])
        angles: list[str] = []
        changes: list[str] = []
        for k in shares:
            angles += gradient(self.terms, k, self.number, lambda row: row - origin, "angle")
            changes += gradient(self.terms, k, self.number, lambda row: row - origin, "change", change=True)
        frequency, by = self.tables.frequency[origin:end].tolist(), ["tau"]
        if any(frequency):  # a rational rotation by phi rotates by 2 atan(phi/2)
            changes = [*numbers("double", "frequency", frequency), *changes]
            by = ["tau / (1.0 + half * half)"]
            half = "const double half = 0.5 * frequency[a] * (tau * angle[a]);"
        each = block(
            f"for (unsigned long a = 0; a < {end - origin}; ++a)",
            [*([half] if any(frequency) else []), f"change[a] *= {by[0]};"],
        )
        moves, corrected = (
            [line for run in self.runs[p] for line in _moves_of_run(run, "tau", errors)]
            for errors in (False, self.tables.compensated)
        )
        turns = [line for run in self.group_runs[p] for line in _moves_of_run(run, "tau", True)]
        return PartInC(end - origin, ("angle",), angles, moves, [*changes, *each], corrected=corrected, turns=turns)

    def _called_part(self, p: int) -> PartInC:
        tables, bodies = self.tables, self._called(p)
        columns = tables.body_column.reshape(-1, BODY_COLUMNS)[bodies].tolist()
        constants = tables.body.reshape(-1, BODY_CONSTANTS)[bodies].tolist()
        direct, together = bool(tables.properties[p] & DIRECT), bool(tables.properties[p] & BONDS)
        different = list(dict.fromkeys(map(tuple, constants)))
        stored = [
            *numbers("double", "constant", [number for one in different for number in one]),
            *numbers("coadjoint_index", "column", [column for one in columns for column in one]),
        ]
        each: dict[str, list[Value]] = {
            "c": [BODY_CONSTANTS * different.index(tuple(one)) for one in constants],
            "f": [BODY_COLUMNS * k for k in range(len(bodies))],
            "bond": [int(one[3] != one[0]) for one in columns],
            "a": [BODY_ROTATIONS * k for k in range(len(bodies))],
        }
        body = "constant + {c}, column + {f}, {bond}, tau, x"
        results = ("sine", "cosm1") if direct else ("angle", "sine", "cosm1")
        outputs = ", ".join("0" if one not in results else f"{one} + {{a}}" for one in ("angle", "sine", "cosm1"))
        angles = [*stored, *repeated(f"coadjoint_rotations({body}, {outputs});", each)]
        moves, corrected = (
            [
                line
                for run in self.runs[p]
                for line in (_direct_turns(run, errors) if direct else _moves_of_run(run, "1.0", errors))
            ]
            for errors in (False, tables.compensated)
        )
        changes = [*stored, *repeated(f"coadjoint_body_changes({body}, v, change + {{a}});", each)]
        together_moves: list[str] = []
        if together and not tables.compensated:
            names = ("z0", "z1", "z2", "w0", "w1", "w2")
            found: dict[str, list[Value]] = dict(zip(names, map(list, zip(*columns, strict=True)), strict=True))
            found["s"] = [one[0] for one in constants]
            together_moves = repeated("coadjoint_bond(x, {z0}, {z1}, {z2}, {w0}, {w1}, {w2}, {s}, tau);", found)
        turns: list[str] = []
        for run in self.group_runs[p]:
            turns += _direct_turns(run, True) if direct else _moves_of_run(run, "1.0", True)
        return PartInC(BODY_ROTATIONS * len(bodies), results, angles, moves, changes, together_moves, corrected, turns)


class PartInC(NamedTuple):
    """The statements of a part with `number` angles, found at x as `results`; vectors and states are moved by them."""

    number: int
    results: tuple[str, ...]
    angles: list[str]
    moves: list[str]
    changes: list[str]
    together: Sequence[str] = ()
    corrected: Sequence[str] = ()
    turns: Sequence[str] = ()

    def functions(self, parts: PartsInC, p: int) -> list[str]:
        """Return the functions that find angles, move a vector by them, and move a state."""
        local = f"double {', '.join(f'{one}[{self.number}]' for one in self.results)};"
        outputs = "".join(f", double *{one}" for one in self.results)
        given = f", {self._given()}, double tau"
        corrected = function(f"correct_{p}", parts.state.declared + given, self.corrected)
        name = f"correct_{p}" if parts.tables.compensated else f"move_{p}"
        move = f"coadjoint_{name}({parts.state.passed}, {', '.join(self.results)}, tau);"
        found = [local, f"{self._find(parts, p, 'x')};", move]
        lines = self._with_attitude(parts, p, given, [local, f"{self._find(parts, p, 'x')};"]) if parts.side else []
        state = f"{parts.state.declared}{parts.inputs.declared}, double tau"
        return [
            *function(f"angles_{p}", f"const double *x{parts.inputs.declared}{self._tau[0]}{outputs}", self.angles),
            *function(f"move_{p}", f"double *x{given}", self.moves),
            *(corrected if parts.tables.compensated else []),
            *function(f"part_{p}", state, list(self.together) or found),
            *lines,
        ]

    def _with_attitude(self, parts: PartsInC, p: int, given: str, find: Sequence[str]) -> list[str]:
        """Return the function of a flow that also moves the rows of the group element, by the angles of the state."""
        d = parts.side
        row = f"coadjoint_turn_row_{p}(A + row * {d}, E + row * {d}, {', '.join(self.results)}, tau);"
        body = [
            *find,
            f"coadjoint_part_{p}({parts.state.passed}{parts.inputs.passed}, tau);",
            *block(f"for (unsigned long row = 0; row < {d}; ++row)", [row]),
        ]
        declared = f"{parts.state.declared}, {ATTITUDE}{parts.inputs.declared}, double tau"
        return [
            *function(f"turn_row_{p}", f"double *x, double *error{given}", self.turns),
            *function(f"part_with_attitude_{p}", declared, body),
        ]

    def _given(self) -> str:
        return ", ".join(f"const double *{one}" for one in self.results)

    def _find(self, parts: PartsInC, p: int, x: str) -> str:
        return f"coadjoint_angles_{p}({x}{parts.inputs.passed}{self._tau[1]}, {', '.join(self.results)})"

    @property
    def _tau(self) -> DeclaredInputs:
        """Angles of bodies are those of the whole flow; others are multiplied by its time."""
        return DeclaredInputs(", double tau", ", tau") if len(self.results) > 1 else DeclaredInputs()

    def with_tangents(self, parts: PartsInC, p: int) -> list[str]:
        """Return the derivative of a flow: vectors move as the state does, and further by the changes of the angles."""
        n, results = parts.size, ", ".join(self.results)
        gains = [line for run in parts.runs[p] for line in _gains_of_run(run)]
        arguments = (
            f"const double *x{parts.inputs.declared}, double tau, {self._given()}, const double *v, double *change"
        )
        each = [
            f"double *const one = v + vector * {n};",
            f"coadjoint_changes_{p}(before{parts.inputs.passed}, tau, {results}, one, change);",
            f"coadjoint_move_{p}(one, {results}, tau);",
            f"coadjoint_gain_{p}(x, change, one);",
        ]
        body = [
            f"double {', '.join(f'{one}[{self.number}]' for one in self.results)}, change[{self.number}], before[{n}];",
            f"for (unsigned long i = 0; i < {n}; ++i) before[i] = x[i];",
            f"{self._find(parts, p, 'before')};",
            f"coadjoint_part_{p}({parts.state.passed}{parts.inputs.passed}, tau);",
            *block("for (unsigned long vector = 0; vector < vectors; ++vector)", each),
        ]
        return [
            *function(f"changes_{p}", arguments, self.changes),
            *function(f"gain_{p}", "const double *x, const double *change, double *v", gains),
            *function(
                f"part_with_tangents_{p}", f"{parts.state.declared}, {VECTORS}{parts.inputs.declared}, double tau", body
            ),
        ]


def _pairs(run: RepeatedBlocks, names: str = "ij") -> dict[str, list[int]]:
    """Return the coordinates of all blocks, in order."""
    size = len(names)
    return {name: run.indices[position::size] for position, name in enumerate(names)}


def _each_block(run: RepeatedBlocks, per_angle: int = 0) -> dict[str, list[Any]]:
    """Return the angle of every block, and its constants, `per_angle` for each angle, or one for each block."""
    angle = [angle for angle in run.angle for _ in range(run.repeat)]
    if not per_angle:
        return {"a": angle, "w": run.constants}
    found: dict[str, list[Any]] = {"a": angle}
    for c in range(per_angle):
        values = run.constants[c::per_angle]
        found["w" if per_angle == 1 else f"w{c}"] = [value for value in values for _ in range(run.repeat)]
    return found


def _moves_of_run(run: RepeatedBlocks, tau: str, errors: bool) -> list[str]:
    """Return the statements that move x by a run, and with `errors` those of its sums."""
    scaled, skip, error = f"angle[{{a}}] * ({tau} * {{w}})", "angle", "error" if errors else "0"
    if run.kind == BlockKind.ROTATE:
        return _turns(run, f"coadjoint_rotate{'_rationally' if run.rational else '_by'}({scaled})", skip, errors)
    if run.kind == BlockKind.SCALE:
        return _blocks(run, f"coadjoint_stretch(x, {error}, {{i}}, {scaled});", "i", 1, skip)
    if run.kind == BlockKind.SHEAR:
        by = f"({tau} * angle[{{a}}]) * {{w}}"
        if errors:
            return _blocks(run, f"coadjoint_shear_corrected(x, error, {{i}}, {{j}}, {by});", "ij", 0, skip)
        return _blocks(run, f"x[{{i}}] = x[{{i}}] + (({tau} * angle[{{a}}]) * {{w}}) * x[{{j}}];", "ij", 0, skip)
    if run.kind == BlockKind.PLANE:
        moved = f"coadjoint_plane(x, {error}, {{i}}, {{j}}, {{w0}}, {{w1}}, {{w2}}, {{w3}}, {tau} * angle[{{a}}]);"
        return _blocks(run, moved, "ij", 4, skip)
    stored = _matrix(run)
    theta = f"{tau} * angle[{run.angle[0]}]"
    if run.kind == BlockKind.CUBIC:
        values = run.constants[CUBIC_HEADER:]
        header = numbers("double", "constant", run.constants[:CUBIC_HEADER])
        header += numbers("double", "square", values[run.entries : 2 * run.entries])
        header += numbers("double", "rest", values[2 * run.entries :])
        call = f"coadjoint_cubic(x, &block, constant, square, rest, {int(run.rational)}, {theta});"
        if errors:
            header = header[: len(numbers("double", "constant", run.constants[:CUBIC_HEADER]))]
            call = f"coadjoint_cubic_corrected(x, error, &block, constant, {int(run.rational)}, {theta});"
        lines = [*stored, *header, call]
    else:
        lines = [*stored, f"coadjoint_series(x, {error}, &block, {run.constants[0]!r}, {run.degree}, {theta});"]
    return block("" if run.skip < 0 else f"if (!(angle[{run.skip}] == 0.0))", lines)


def _blocks(run: RepeatedBlocks, move: str, names: str, per_angle: int, skip: str) -> list[str]:
    """Statements for every block."""
    return repeated(_unless_zero(run, move, skip), {**_pairs(run, names), **_each_block(run, per_angle)})


def _unless_zero(run: RepeatedBlocks, statement: str, skip: str) -> str:
    return statement if run.skip < 0 else f"if (!({skip}[{{a}}] == 0.0)) {statement}"


def _turns(run: RepeatedBlocks, rotation: str, skip: str, errors: bool) -> list[str]:
    """Rotations by the angles of a run, each of all of its blocks; sines are computed once."""
    turn = "coadjoint_turn_corrected(x, error" if errors else "coadjoint_turn(x"
    if run.repeat == 1:
        return _blocks(run, f"{turn}, {{i}}, {{j}}, {rotation});", "ij", 1, skip)
    once = f"const struct coadjoint_rotation r = {rotation};"
    if run.repeat <= FEW:
        columns: dict[str, list[Any]] = {"a": run.angle, "w": run.constants}
        lines = [f"    {once}"]
        for b in range(run.repeat):
            columns[f"i{b}"] = run.indices[2 * b :: 2 * run.repeat]
            columns[f"j{b}"] = run.indices[2 * b + 1 :: 2 * run.repeat]
            lines.append(f"    {turn}, {{i{b}}}, {{j{b}}}, r);")
        return repeated(_unless_zero(run, "\n".join(["{{", *lines, "}}"]), skip), columns)
    found: list[str] = []
    for q, angle in enumerate(run.angle):
        first = 2 * run.repeat * q
        pairs, given = run.indices[first : first + 2 * run.repeat], {"a": angle, "w": literal(run.constants[q])}
        turned = repeated(f"{turn}, {{i}}, {{j}}, r);", {"i": pairs[::2], "j": pairs[1::2]})
        head = "" if run.skip < 0 else f"if (!({skip}[{angle}] == 0.0))"
        found += block(head, [once.format(**given), *turned])
    return found


def _direct_turns(run: RepeatedBlocks, errors: bool) -> list[str]:
    return _turns(run, "coadjoint_rotation_of(sine[{a}] * {w}, cosm1[{a}])", "cosm1", errors)


def _matrix(run: RepeatedBlocks) -> list[str]:
    """Return the declarations of a block of several coordinates."""
    width, first = run.width, RULES[BlockKind(run.kind)].header
    return [
        *numbers("coadjoint_index", "coordinate", run.indices[:width]),
        *numbers("coadjoint_index", "start", run.indices[width : 2 * width + 1]),
        *numbers("coadjoint_index", "column", run.indices[2 * width + 1 :]),
        *numbers("double", "value", run.constants[first : first + run.entries]),
        f"static const struct coadjoint_block block = {{coordinate, start, column, value, {width}}};",
    ]


def _gains_of_run(run: RepeatedBlocks) -> list[str]:
    """Add D_a x times the change of its angle to v, for the angles of a run."""
    if run.kind in (BlockKind.CUBIC, BlockKind.SERIES):
        return block("", [*_matrix(run), f"coadjoint_gain(&block, x, change[{run.angle[0]}], v);"])
    if run.kind == BlockKind.SCALE:
        return repeated("v[{i}] += {w} * x[{i}] * change[{a}];", {**_pairs(run, "i"), **_each_block(run, 1)})
    if run.kind == BlockKind.SHEAR:
        return repeated("v[{i}] += {w} * x[{j}] * change[{a}];", {**_pairs(run), **_each_block(run)})
    if run.kind == BlockKind.ROTATE:
        gained = "v[{i}] -= {w} * x[{j}] * change[{a}];\nv[{j}] += {w} * x[{i}] * change[{a}];"
        return repeated(gained, {**_pairs(run), **_each_block(run, 1)})
    gained = (
        "v[{i}] += (({w0} + {w1}) * x[{i}] + {w2} * x[{j}]) * change[{a}];\n"
        "v[{j}] += ({w3} * x[{i}] + ({w0} - {w1}) * x[{j}]) * change[{a}];"
    )
    return repeated(gained, {**_pairs(run), **_each_block(run, 4)})
