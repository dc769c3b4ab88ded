"""Blocks of the parts of a splitting in C: what moves a state by known angles, and what its derivative adds."""

from __future__ import annotations

from typing import Any, NamedTuple

from coadjoint.files.exports.c_statements import FEW, block, literal, numbers, repeated
from coadjoint.kernels.interface import limit
from coadjoint.program.actions import Action
from coadjoint.program.blocks import CUBIC_HEADER, RULES, BlockKind

BODY_ROTATIONS = 4
"""Angles of a free body or a bond."""


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


def moves_of_run(run: RepeatedBlocks, tau: str, errors: bool) -> list[str]:
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


def direct_turns(run: RepeatedBlocks, errors: bool) -> list[str]:
    """Return the statements that turn x by sines and cosines that bodies have computed."""
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


def gains_of_run(run: RepeatedBlocks) -> list[str]:
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
