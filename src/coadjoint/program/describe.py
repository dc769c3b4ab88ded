"""Description of a splitting of a system: parts, generators, kinds of blocks, and operations per step."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from coadjoint.program.actions import Action
from coadjoint.program.blocks import RULES, BlockKind
from coadjoint.program.parts.decompose import decompose
from coadjoint.program.parts.part import BodyShare, Form
from coadjoint.program.parts.split import separated_functions
from coadjoint.program.sweeps import Swept
from coadjoint.program.table import FlowTable, build_flow_table
from coadjoint.program.term_table import LINEAR
from coadjoint.systems.coordinates import coordinate_names
from coadjoint.systems.hamiltonians.terms import Term
from coadjoint.systems.lie_poisson import LiePoissonSystem

MAX_SHOWN = 6  # generators of a part in a line
# Multiplications in the flow of a free body over a short time.
BODY_WORK = 600
# Multiplications in the flow of a bond, which has no blocks.
BOND_WORK = 60


@dataclass(frozen=True)
class PartDescription:
    """One part with counts for one flow: forms, blocks by kind, multiplications with additions, calls of functions."""

    generators: tuple[str, ...]
    blocks: dict[str, int]
    multiplications: int
    functions: int


@dataclass(frozen=True)
class Description:
    """Description of a splitting, with a readable `str`; counts are per step, outer flows of neighbouring steps merged.

    `shift`: Casimir -> multiple subtracted from H; `found`: sums that functions in H were recognized as.
    """

    system: str
    method: str
    parts: tuple[PartDescription, ...]
    shift: dict[str, float]
    flows: int
    multiplications: int
    functions: int
    found: tuple[str, ...] = ()

    def __str__(self) -> str:
        subtracted = "".join(_subtracted(name, factor) for name, factor in self.shift.items())
        lines = [f"{self.method} on {self.system}: H{subtracted} in {len(self.parts)} parts"]
        lines += [f"  a function in H is {sum_found}" for sum_found in self.found]
        for number, part in enumerate(self.parts, start=1):
            shown = list(part.generators[:MAX_SHOWN])
            if len(part.generators) > MAX_SHOWN:
                shown.append(f"... ({len(part.generators)})")
            kinds = ", ".join(f"{count} {kind}" for kind, count in part.blocks.items()) or "nothing moves"
            lines.append(f"  part {number}: {', '.join(shown)}: {kinds}")
        lines.append(
            f"  a step: {self.flows} flows, {self.multiplications} multiplications, {self.functions} sines and the like"
        )
        return "\n".join(lines)


def _subtracted(name: str, factor: float) -> str:
    shown = f"({name})" if " + " in name or " - " in name else name
    return f" {'+' if factor < 0 else '-'} {abs(factor):.6g} {shown}"


def describe(system: LiePoissonSystem, method: Swept) -> Description:
    """Describe a splitting of a system; the result is printable."""
    flow_table = build_flow_table(system, method)
    names = coordinate_names(system)
    parts = tuple(_describe_part(names, flow_table, number, forms) for number, forms in enumerate(flow_table.parts))
    first, last = int(flow_table.stages.section[1]), int(flow_table.stages.section[2])
    step = [parts[int(flow_table.stages.part[row])] for row in range(first, last)]
    return Description(
        system=system.name,
        method=str(method),
        parts=parts,
        shift=dict(decompose(system, method.parts).choice.shift),
        flows=len(step),
        multiplications=sum(part.multiplications for part in step),
        functions=sum(part.functions for part in step),
        found=tuple(_sum_found(names, terms) for terms in separated_functions(system).values()),
    )


def _sum_found(names: Sequence[str], terms: Sequence[Term]) -> str:
    pieces = []
    for term in terms:
        coordinates = sorted({int(k) for coupled in term.couplings() for k in coupled})
        shown = [names[k] for k in coordinates[:MAX_SHOWN]] + ["..."] * (len(coordinates) > MAX_SHOWN)
        pieces.append(f"a {'function' if term.called else 'polynomial'} of {', '.join(shown)}")
    more = [f"{rest} more function{'s' if rest > 1 else ''}"] if (rest := len(pieces) - MAX_SHOWN) > 0 else []
    return "the sum of " + " and ".join([*pieces[:MAX_SHOWN], *more]) if len(pieces) > 1 else "".join(pieces)


def _describe_part(names: Sequence[str], flow_table: FlowTable, number: int, forms: Sequence[Form]) -> PartDescription:
    blocks: Counter[str] = Counter()
    action = flow_table.state
    for run in range(action.run[number], action.run[number + 1]):
        blocks[BlockKind(int(action.kind[run])).name] += int(action.angles[run]) * int(action.repeat[run])
    acting, shares = action_work(action, number), share_work(flow_table, number)
    bodies = bodies_of(flow_table, number)
    if bodies:
        acting = 0 if bodies[0].other else acting[0], 0
    multiplications, functions = (a + b for a, b in zip(acting, shares, strict=True))
    # The coordinates of separated functions are repeated.
    generators = tuple(dict.fromkeys(_form_name(names, form) for form in forms))
    if bodies:
        generators = tuple(_body_name(names, body) for body in bodies)
    return PartDescription(generators, dict(blocks), multiplications, functions)


def _body_name(names: Sequence[str], body: BodyShare) -> str:
    first, second = (", ".join(names[i] for i in coordinates) for coordinates in (body.coordinates, body.other or ()))
    return f"bond of {first} and {second}" if second else f"free body of {first}"


def bodies_of(flow_table: FlowTable, number: int) -> list[BodyShare]:
    """Return the free bodies of one part."""
    shares = range(int(flow_table.parts.share[number]), int(flow_table.parts.share[number + 1]))
    return [body for s, body in flow_table.parts.bodies.items() if s in shares]


def action_work(action: Action, number: int) -> tuple[int, int]:
    """Return the multiplications and elementary function calls of the action of one part on one vector."""
    multiplications, functions = 0, 0
    for run in range(action.run[number], action.run[number + 1]):
        rule, angles = RULES[BlockKind(action.kind[run])], int(action.angles[run])
        each = rule.multiplications(int(action.entries[run]), int(action.degree[run]))
        multiplications += angles * int(action.repeat[run]) * each
        functions += rule.calls * angles
    return multiplications, functions


def count_series_blocks(action: Action, number: int) -> int:
    """Count the SERIES blocks of one part."""
    runs = range(action.run[number], action.run[number + 1])
    return sum(
        int(action.angles[run]) * int(action.repeat[run]) for run in runs if action.kind[run] == BlockKind.SERIES
    )


def share_work(flow_table: FlowTable, number: int) -> tuple[int, int]:
    """Return the multiplications and function calls for the angles of one part."""
    terms, bodies, multiplications, functions = flow_table.terms, flow_table.parts.bodies, 0, 0
    for term in range(flow_table.share[number], flow_table.share[number + 1]):
        rows = range(terms.row[term], terms.row[term + 1])
        if term in bodies:
            work = BOND_WORK if bodies[term].other else BODY_WORK
            multiplications, functions = multiplications + work, functions + 1
        elif terms.kind[term] == LINEAR:
            multiplications += int(terms.entry[rows.stop] - terms.entry[rows.start])
        elif term in flow_table.functions:
            functions += 1
        else:
            monomials = range(terms.monomial[term], terms.monomial[term + 1])
            multiplications += sum(int(terms.factor[m + 1] - terms.factor[m]) ** 2 for m in monomials)
    return multiplications, functions


def _form_name(names: Sequence[str], form: Form) -> str:
    words = [names[i] if value == 1 else f"{float(value):.4g} {names[i]}" for i, value in zip(*form, strict=True)]
    shown = words if len(words) <= MAX_SHOWN else [*words[:MAX_SHOWN], "..."]
    return " + ".join(shown).replace("+ -", "- ")
