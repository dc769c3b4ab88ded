"""Parts of a splitting in C: their angles at a state, and the blocks that move it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from coadjoint.files.exports.c_blocks import BODY_ROTATIONS, direct_turns, gains_of_run, moves_of_run, runs_of_part
from coadjoint.files.exports.c_statements import (
    FIELDS,
    VECTORS,
    Exported,
    Numbers,
    TableNumbers,
    Value,
    block,
    check_terms,
    function,
    gradient,
    numbers,
    passed,
    repeated,
)
from coadjoint.kernels.tables.flow import FlowTables
from coadjoint.runs.prepared_run import PreparedRun

BODY_COLUMNS, BODY_CONSTANTS = 6, 15
DIRECT, BONDS = 1, 2
ATTITUDE = "double *A, double *E"
"""Arguments: a group element, row by row, and the errors of its sums."""
MOVED = {"": "", "_with_tangents": f", {VECTORS}", "_with_attitude": f", {ATTITUDE}"}
"""What functions move beside the state, by the ends of their names, as further arguments."""
MOST_ROWS = 40
"""Flows of a step that are written out; more of them are a loop over a table."""


class PartsInC:
    """The functions of the parts of a splitting; `inputs` declares the inputs as an argument, if there are any."""

    def __init__(self, tables: FlowTables, number: Numbers, inputs: str) -> None:
        compensated = tables.compensated
        self.state = "double *x, double *error" if compensated else "double *x"
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
            kinds = [kind for kind, wanted in (("_with_tangents", tangent), ("_with_attitude", self.side)) if wanted]
            for kind in ("", *kinds):
                lines += self._switch(f"part{kind}", self.state + MOVED[kind] + self.inputs)
        return lines

    def _switch(self, name: str, arguments: str) -> list[str]:
        cases = [f"case {p}: coadjoint_{name}_{p}({passed(arguments)}, tau); break;" for p in self.parts]
        return function(name, f"int part, {arguments}, double tau", block("switch (part)", [*cases, "default: break;"]))

    def rows(self, first: int, last: int, kind: str = "", h: str = "h") -> list[str]:
        """Return the calls of the flows first to last - 1 over a step h; `kind` says what else they move."""
        name, state = f"part{kind}", passed(self.state + MOVED[kind] + self.inputs)
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
            [line for run in self.runs[p] for line in moves_of_run(run, "tau", errors)]
            for errors in (False, self.tables.compensated)
        )
        turns = [line for run in self.group_runs[p] for line in moves_of_run(run, "tau", True)]
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
                for line in (direct_turns(run, errors) if direct else moves_of_run(run, "1.0", errors))
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
            turns += direct_turns(run, True) if direct else moves_of_run(run, "1.0", True)
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
        corrected = function(f"correct_{p}", parts.state + given, self.corrected)
        name = f"correct_{p}" if parts.tables.compensated else f"move_{p}"
        move = f"coadjoint_{name}({passed(parts.state)}, {', '.join(self.results)}, tau);"
        found = [local, f"{self._find(parts, p, 'x')};", move]
        lines = self._with_attitude(parts, p, given, [local, f"{self._find(parts, p, 'x')};"]) if parts.side else []
        state = f"{parts.state}{parts.inputs}, double tau"
        return [
            *function(f"angles_{p}", f"const double *x{parts.inputs}{self._tau}{outputs}", self.angles),
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
            f"coadjoint_part_{p}({passed(parts.state + parts.inputs)}, tau);",
            *block(f"for (unsigned long row = 0; row < {d}; ++row)", [row]),
        ]
        arguments = f"{parts.state}, {ATTITUDE}{parts.inputs}, double tau"
        return [
            *function(f"turn_row_{p}", f"double *x, double *error{given}", self.turns),
            *function(f"part_with_attitude_{p}", arguments, body),
        ]

    def _given(self) -> str:
        return ", ".join(f"const double *{one}" for one in self.results)

    def _find(self, parts: PartsInC, p: int, x: str) -> str:
        return f"coadjoint_angles_{p}({x}{passed(parts.inputs + self._tau)}, {', '.join(self.results)})"

    @property
    def _tau(self) -> str:
        """Angles of bodies are those of the whole flow; others are multiplied by its time."""
        return ", double tau" if len(self.results) > 1 else ""

    def with_tangents(self, parts: PartsInC, p: int) -> list[str]:
        """Return the derivative of a flow: vectors move as the state does, and further by the changes of the angles."""
        n, results = parts.size, ", ".join(self.results)
        gains = [line for run in parts.runs[p] for line in gains_of_run(run)]
        arguments = f"const double *x{parts.inputs}, double tau, {self._given()}, const double *v, double *change"
        each = [
            f"double *const one = v + vector * {n};",
            f"coadjoint_changes_{p}(before{passed(parts.inputs)}, tau, {results}, one, change);",
            f"coadjoint_move_{p}(one, {results}, tau);",
            f"coadjoint_gain_{p}(x, change, one);",
        ]
        body = [
            f"double {', '.join(f'{one}[{self.number}]' for one in self.results)}, change[{self.number}], before[{n}];",
            f"for (unsigned long i = 0; i < {n}; ++i) before[i] = x[i];",
            f"{self._find(parts, p, 'before')};",
            f"coadjoint_part_{p}({passed(parts.state + parts.inputs)}, tau);",
            *block("for (unsigned long vector = 0; vector < vectors; ++vector)", each),
        ]
        return [
            *function(f"changes_{p}", arguments, self.changes),
            *function(f"gain_{p}", "const double *x, const double *change, double *v", gains),
            *function(f"part_with_tangents_{p}", f"{parts.state}, {VECTORS}{parts.inputs}, double tau", body),
        ]


def splitting(prepared: PreparedRun, tables: FlowTables, numbers: TableNumbers, inputs: str, tangent: bool) -> Exported:
    """Return the statements of a splitting, and the functions that they call."""
    terms = tables.terms
    check_terms(prepared.system.name, terms)
    numbers.check_constant(tables, [f"terms.{field}" for field in FIELDS], str(prepared.method))
    parts = PartsInC(tables, numbers.of_terms(tables, "terms.", terms), inputs)
    begin, first, every, end = (int(row) for row in tables.section)
    lines = parts.functions(tangent)
    state = f"{parts.state}{inputs}, double h"
    x = passed(state)
    n = tables.state.size
    zeros = [f"double error[{n}];", f"for (unsigned long i = 0; i < {n}; ++i) error[i] = 0.0;"]
    errors = zeros if tables.compensated else []
    lines += function("first", state, parts.rows(begin, first))
    lines += function("next", state, parts.rows(first, every))
    lines += function("finish", state, parts.rows(every, end))
    finish = f"coadjoint_finish({x});"
    steps = [
        *errors,
        "if (steps == 0) return;",
        f"coadjoint_first({x});",
        f"while (--steps > 0) coadjoint_next({x});",
        finish,
    ]
    change = [line for ends in ((begin, first), (every, end)) for line in parts.rows(*ends, "_with_tangents")]
    if parts.side:
        lines += _attitude_functions(parts, zeros)
    step = [*errors, f"coadjoint_first({x});", finish]
    return Exported(lines, step, steps, [*errors, *change], parts.widest, True, tables.compensated, parts.side)


def _attitude_functions(parts: PartsInC, zeros: Sequence[str]) -> list[str]:
    """Return the functions of runs that also move a group element, whose sums are always compensated."""
    tables, u, count = parts.tables, parts.inputs, parts.side**2
    begin, first, every, end = (int(row) for row in tables.section)
    state = f"{parts.state}, {ATTITUDE}{u}, double h"
    x = passed(state)
    lines: list[str] = []
    for name, ends in {"first": (begin, first), "next": (first, every), "finish": (every, end)}.items():
        lines += function(f"{name}_with_attitude", state, parts.rows(*ends, "_with_attitude"))
    run = [
        f"double E[{count}];",
        *(zeros if tables.compensated else []),
        f"for (unsigned long i = 0; i < {count}; ++i) E[i] = 0.0;",
        "if (steps == 0) return;",
        f"coadjoint_first_with_attitude({x});",
        f"while (--steps > 0) coadjoint_next_with_attitude({x});",
        f"coadjoint_finish_with_attitude({x});",
    ]
    return lines + function("run_with_attitude", f"double *x, double *A{u}, double h, unsigned long steps", run)
