"""Export of flow tables as plain arrays by name: the table that `docs/table.md` documents."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.monomials import factors_of
from coadjoint.program.actions import Action, run_blocks
from coadjoint.program.added_part import Places
from coadjoint.program.blocks import RULES, BlockKind
from coadjoint.program.numbers import Number, array_of
from coadjoint.program.sources import Multiples, concatenated, products_of
from coadjoint.program.sparse_rows import starts_of
from coadjoint.program.table import FlowTable
from coadjoint.program.term_table import Terms
from coadjoint.systems.coefficients import Key, coefficients_of
from coadjoint.systems.energy_derivatives import DerivativeMonomial, EnergyDerivative
from coadjoint.systems.parameters import parameters_of

VERSION = 3
"""Increased if a reader of the previous version would read a table wrongly."""

RENAMED_COLUMNS = {"kind": "term_kind", "row": "term_row", "coefficient": "coefficient_of_monomial"}
"""Names that differ from those in `Terms`."""

PUBLIC_COLUMNS = tuple(name for name in Terms._fields if name not in ("size", "repeated", "shape"))
"""Fields of `Terms` in the table; rows that repeat are stored once only for kernels."""

DEPENDENT = ("offset", "weight", "coefficient_of_monomial")
"""Arrays that depend on the energy, in the order of positions in `Places`."""


def mapping_of(flow_table: FlowTable) -> dict[str, Any]:
    """Return a flow table as arrays, numbers, lists and mappings by name."""
    rows, terms = flow_table.stages, flow_table.terms
    table: dict[str, Any] = {
        "version": VERSION,
        "dim": int(flow_table.state.size),
        "section": rows.section,
        "part": rows.part,
        "coefficient": rows.coefficient,
        "moment": rows.moment,
        "share": flow_table.share,
        "frequency": np.array(flow_table.frequency),
        **{RENAMED_COLUMNS.get(name, name): getattr(terms, name) for name in PUBLIC_COLUMNS},
        **_blocks("state", flow_table.state, flow_table),
        "functions": sorted(int(k) for k in flow_table.functions),
        "bodies": sorted(flow_table.parts.bodies),
        **_provenance(flow_table),
    }
    if flow_table.group is not None:
        table |= _blocks("group", flow_table.group, flow_table)
    return {name: _with_long_integers(value) for name, value in table.items()}


def _with_long_integers(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype.kind in "ui":
        return value.astype(np.int64)
    return value


def _blocks(name: str, action: Action, flow_table: FlowTable) -> dict[str, Any]:
    """Return the blocks of all parts in the order of application, with their constants and entries of D."""
    angles: list[int] = []
    entries: list[tuple[int, int, int, int, Any]] = []
    kinds, lengths, degrees, count = [], [], [], [0]
    constants: list[tuple[Any, Any, Any]] = []
    for part in range(len(flow_table.parts)):
        for run in range(int(action.run[part]), int(action.run[part + 1])):
            for q in range(int(action.angles[run])):
                angle = int(action.angle[run]) + q
                for coordinates, D in run_blocks(action, run, q):
                    cells = np.argwhere(D != 0).tolist()
                    entries += [(part, angle, int(coordinates[i]), int(coordinates[j]), D[i, j]) for i, j in cells]
                    angles.append(angle)
                    lengths.append(len(cells))
                    kinds.append(int(action.kind[run]))
                    degrees.append(int(action.degree[run]))
                    first, rule = action.constants[int(action.constant[run])], RULES[BlockKind(action.kind[run])]
                    norm = first if rule.degree is None else 0 * first
                    constants.append((rule.mean(D, first), rule.square(D, first), norm))
        count.append(len(kinds))
    columns: Sequence[Any] = list(zip(*entries, strict=True)) or [()] * 5
    numbers: Sequence[Any] = list(zip(*constants, strict=True)) or [()] * 3
    integers = {
        "block": count,
        "kind": kinds,
        "degree": degrees,
        "entry": starts_of(np.array(lengths, dtype=np.int64)),
        **dict(zip(("part", "angle", "row", "column"), columns[:4], strict=True)),
    }
    others = dict(zip(("value", "mean", "lambda", "norm"), (columns[4], *numbers), strict=True))
    return {f"{name}_{label}": np.array(column, dtype=np.int64) for label, column in integers.items()} | {
        f"{name}_{label}": _numbers(flow_table.number, column) for label, column in others.items()
    }


def _numbers(number: Number, values: Sequence[Any]) -> NDArray[Any]:
    return array_of(number, np.array(values, dtype=object)) if len(values) else array_of(number, [])


def energy_and_parameters(system: Any) -> dict[str, Any]:
    """Return the coefficients of the energy of a system, and its parameters, as in its tables."""
    parameters: dict[str, Any] = {}
    keys: dict[Key, int] = {}
    values: list[float] = []
    for key, value in coefficients_of(system).by_key().items():
        if key:
            keys[key] = len(keys)
            values.append(float(value))
    for name, parameter in parameters_of(system).items():
        monomials = [one for one in parameter.energy().as_monomials if one.coordinates]
        for one in monomials:
            if keys.setdefault(one.coordinates, len(values)) == len(values):
                values.append(0.0)
        parameters[name] = {
            "shape": list(parameter.value.shape),
            "value": parameter.value.ravel(),
            "linear": name not in (system.parameters or {}),
            "monomial": np.array([keys[one.coordinates] for one in monomials], dtype=np.int64),
            "entry": np.array([one.entry for one in monomials], dtype=np.int64),
            "derivative": np.array([one.factor for one in monomials], dtype=np.float64),
        }
    return {
        "energy": {"monomials": [list(key) for key in keys], "coefficients": np.array(values, dtype=np.float64)},
        "parameters": parameters,
    }


def _provenance(flow_table: FlowTable) -> dict[str, Any]:
    """Return the coefficients of the energy, the numbers that depend on them, the Casimirs, and the parameters."""
    described = energy_and_parameters(flow_table.system)
    casimirs = [
        {tuple(factors_of(exponents)): float(c) for exponents, c in one.monomials.items()}
        for one, _ in flow_table.shift
    ]
    known = [tuple(key) for key in described["energy"]["monomials"]]
    keys: list[Key] = [*dict.fromkeys([*known, *(key for casimir in casimirs for key in casimir)])]
    values = np.append(described["energy"]["coefficients"], np.zeros(len(keys) - len(known)))
    rest, number = values.copy(), {key: k for k, key in enumerate(keys)}
    for casimir, (_, factor) in zip(casimirs, flow_table.shift, strict=True):
        for key, c in casimir.items() if not flow_table.parts.bodies else ():
            rest[number[key]] -= factor * c
    arrays = [flow_table.terms.offset, flow_table.terms.weight, flow_table.terms.coefficient]
    constants, starts = np.concatenate(arrays), starts_of(np.array([*map(len, arrays)]))
    places, each = Places(flow_table), [DerivativeMonomial(key, k, 1.0) for k, key in enumerate(keys)]
    found, shifts, missing = places.of(EnergyDerivative.of_monomials(len(keys), each))
    of_bodies = _weights_of_bodies(flow_table, {keys[k]: k for k in missing.tolist()})
    follows = np.ones(len(keys), dtype=bool)
    follows[[*missing, *found.number[~places.copied[found.position]]]] = False
    follows[of_bodies.number] = True
    removed: dict[int, int] = {}
    for k, monomial in zip(shifts.position.tolist(), shifts.number.tolist(), strict=True):
        follows[monomial] &= flow_table.shift[k][1] == values[monomial] / casimirs[k][keys[monomial]]
        removed |= {k: monomial} if follows[monomial] else {}
    found = concatenated([found.take(~np.isin(found.number, shifts.number)), of_bodies])
    # Monomials of several terms have other coefficients in each.
    equal = np.asarray(constants[found.position] == found.factor * rest[found.number], dtype=bool)
    follows[found.number[~equal]] = False
    found = found.take(follows[found.number])
    found = found.take(np.lexsort((found.factor, found.number, found.position)))
    bounds = np.searchsorted(found.position, starts).tolist()
    return {
        **described,
        "energy": {"monomials": [list(key) for key in keys], "coefficients": values},
        "provenance": {
            name: {
                "index": found.position[first:last] - start,
                "monomial": found.number[first:last],
                "factor": found.factor[first:last],
            }
            for name, start, (first, last) in zip(DEPENDENT, starts.tolist(), pairwise(bounds), strict=False)
        },
        "fixed": np.flatnonzero(~follows).tolist(),
        "shift": [
            {
                "factor": factor,
                "monomial": removed.get(k),
                "exponents": [list(map(int, exponents)) for exponents in casimir.monomials],
                "coefficients": list(casimir.monomials.values()),
            }
            for k, (casimir, factor) in enumerate(flow_table.shift)
        ],
    }


def _weights_of_bodies(flow_table: FlowTable, number: Mapping[Key, int]) -> Multiples:
    """Return the weights of free bodies, which are entries of M, as multiples of the monomials of these numbers."""
    found: list[tuple[int, int, float]] = []
    terms, forms = flow_table.terms, flow_table.parts.forms
    for share, body in flow_table.parts.bodies.items():
        if body.other is None:
            rows = np.arange(*terms.row[share : share + 2].tolist())
            entries, i, j = products_of(terms, rows, forms.coordinate[forms.start[rows]].astype(np.int64))
            for entry, *pair in zip(entries.tolist(), *np.sort([i, j], axis=0).tolist(), strict=True):
                if (monomial := number.get(tuple(pair))) is not None:
                    found.append((len(terms.offset) + entry, monomial, 1.0 + (pair[0] == pair[1])))
    return Multiples.of_triplets(found)
