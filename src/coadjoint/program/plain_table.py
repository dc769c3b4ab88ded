"""Programs as plain arrays by name, for interpreters elsewhere: JAX, Julia, a microcontroller."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.actions import Action
from coadjoint.program.numbers import array_of

if TYPE_CHECKING:
    from coadjoint.program.table import Program


RENAMED = {"kind": "term_kind", "row": "term_row", "coefficient": "coefficient_of_monomial"}


def plain_table(program: Program) -> dict[str, Any]:
    """Return a program as arrays, numbers and lists, documented in `docs/table.md`.

    Arrays are integers, or of the number type of the program. As lists they can be written to JSON.

    Examples
    --------
    >>> import coadjoint as co
    >>> table = co.Splitting(order=2).program(co.systems.rigid_body(inertia=(1, 2, 2.5))).to_mapping()
    >>> table["part"].tolist(), table["section"].tolist()
    ([0, 1, 0, 1, 0], [0, 2, 4, 5])
    >>> [table[name].tolist() for name in ("state_part", "state_row", "state_column", "state_value")]
    [[0, 0, 1, 1], [1, 2, 0, 1], [2, 1, 1, 0], [-1.0, 1.0, -1.0, 1.0]]
    """
    rows, terms = program.rows, program.terms
    table: dict[str, Any] = {
        "dim": int(program.state.size),
        "section": rows.section,
        "part": rows.part,
        "coefficient": rows.coefficient,
        "moment": rows.moment,
        "share": program.share,
        "frequency": program.frequency,
        **{RENAMED.get(name, name): getattr(terms, name) for name in terms._fields[1:]},
        **_generators("state", program.state, program),
        "shift": [
            {
                "factor": factor,
                "exponents": [list(map(int, exponents)) for exponents in casimir.monomials],
                "coefficients": list(casimir.monomials.values()),
            }
            for casimir, factor in program.shift
        ],
        "functions": sorted(int(k) for k in program.functions),
        "bodies": sorted(program.parts.bodies),
    }
    return table | (_generators("group", program.group, program) if program.group is not None else {})


def _generators(name: str, action: Action, program: Program) -> dict[str, NDArray[Any]]:
    """Return the entries of the generators D of all angles of all parts, sorted."""
    from coadjoint.program.run_matrices import run_entries

    found = []
    for part in range(len(program.parts)):
        for run in range(action.run[part], action.run[part + 1]):
            for q in range(action.angles[run]):
                entries = run_entries(action, run, q)
                found += [(part, int(action.angle[run]) + q, i, j, value) for (i, j), value in sorted(entries.items())]
    found.sort(key=lambda entry: entry[:4])
    columns = list(zip(*found, strict=True)) or [()] * 5
    places = [np.array(column, dtype=np.int64) for column in columns[:4]]
    values = array_of(program.number, np.array(columns[4], dtype=object)) if found else array_of(program.number, [])
    return {
        f"{name}_{label}": column
        for label, column in zip(("part", "angle", "row", "column", "value"), [*places, values], strict=True)
    }
