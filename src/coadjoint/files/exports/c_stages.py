"""Runge-Kutta methods in C whose slopes need no convergence: the field of a system, and the stages of a step."""

from __future__ import annotations

from typing import Any

from coadjoint.files.exports.c_statements import (
    FIELDS,
    LONGEST_CHAIN,
    VECTORS,
    Exported,
    Numbers,
    TableNumbers,
    block,
    chain_of,
    check_terms,
    function,
    gradient,
    numbers,
    passed,
    repeated,
    rows_of,
    runs_of,
)
from coadjoint.kernels.interface import codes
from coadjoint.kernels.tables.field import Field
from coadjoint.kernels.tables.runge_kutta import RungeKuttaTables
from coadjoint.program.term_table import LINEAR
from coadjoint.runs.prepared_run import PreparedRun


def _functions(tables: RungeKuttaTables, number: Numbers, u: str, explicit: bool, tangent: bool) -> list[str]:
    """Return the functions of the field and of a substep, which keeps the rounding errors of its sums."""
    field = tables.field
    size, head = field.size + field.partials, f"const double *x{u}"
    slope = [
        f"double d[{size}];",
        f"coadjoint_gradient(x{passed(u)}, d);",
        *_products(field, "x", "d"),
    ]
    lines = function("gradient", f"{head}, double *d", _gradient(field, number, change=False))
    lines += function("slope", f"{head}, double length, double *f", slope)
    lines += _substep(tables, u, explicit, tangent=False)
    if not tangent:
        return lines
    change = [
        f"double d[{size}], w[{size}];",
        f"coadjoint_gradient(x{passed(u)}, d);",
        f"coadjoint_gradient_change(x{passed(u)}, v, w);",
        *_products(field, "v", "d"),
        *_products(field, "x", "w", "f[{i}] + "),
    ]
    lines += function("gradient_change", f"{head}, const double *v, double *d", _gradient(field, number, change=True))
    lines += function("slope_change", f"{head}, const double *v, double length, double *f", change)
    each = "for (unsigned long vector = 0; vector < vectors; ++vector)"
    both = [
        *block(each, [f"coadjoint_substep_change(x, error, v + vector * {field.size}{passed(u)}, h);"]),
        f"coadjoint_substep(x, error{passed(u)}, h);",
    ]
    arguments = f"double *x, double *error, {VECTORS}{u}, double h"
    return [*lines, *_substep(tables, u, explicit, tangent=True), *function("substep_with_tangents", arguments, both)]


def _substeps(tables: RungeKuttaTables, inputs: str, tangent: bool = False) -> list[str]:
    """Return the calls of the substeps of a step."""
    name, state = ("substep_with_tangents", "x, error, v, vectors") if tangent else ("substep", "x, error")
    fractions = tables.fraction.tolist()
    return repeated(f"coadjoint_{name}({state}{passed(inputs)}, {{c}} * h);", {"c": fractions})


def _gradient(field: Field, number: Numbers, change: bool) -> list[str]:
    terms = field.terms
    targets = terms.target.tolist()
    clear = f"for (unsigned long i = 0; i < {field.size + field.partials}; ++i) d[i] = 0.0;"

    def find(k: int, origin: int | None, out: str) -> list[str]:
        def target(row: int) -> int:
            return int(targets[row]) if origin is None else row - origin

        return gradient(terms, k, number, target, out, change)

    if terms.size == 1 and terms.kind[0] == LINEAR:
        return ([clear] if int(terms.row[1]) < field.size else []) + find(0, None, "d")
    lines = [clear]
    partial_of = list(zip(field.partial_row.tolist(), field.partial.tolist(), strict=True))
    for k in range(terms.size):
        rows = rows_of(terms, k)
        if rows:
            to = [(row - rows.start, targets[row]) for row in rows]
            to += [(row - rows.start, field.size + partial) for row, partial in partial_of if row in rows]
            added = repeated("d[{i}] += row[{r}];", {"i": [i for _, i in to], "r": [r for r, _ in to]})
            lines += block("", [f"double row[{len(rows)}];", *find(k, rows.start, "row"), *added])
    return lines


def _substep(tables: RungeKuttaTables, u: str, explicit: bool, tangent: bool) -> list[str]:
    n = tables.field.size
    s, at = tables.stages, f"i * {n}"
    count = "i" if explicit else f"(pass ? {s} : 0)"
    point = [f"coadjoint_mixed({count}, {n}, mix + i * {s}, slope, x, error, point + {at});"]
    slope = [f"coadjoint_slope(point + {at}{passed(u)}, h * scale[i], slope + {at});"]
    arrays = [f"slope[{s * n}]", f"point[{s * n}]"]
    name, declared = "substep", "double *x, double *error"
    end = f"coadjoint_add_slopes({s}, {n}, out, slope, x, error);"
    if tangent:
        arrays += [f"further[{s * n}]", f"moved[{s * n}]"]
        name, declared = "substep_change", "const double *x, const double *error, double *v"
        point += [f"coadjoint_mixed_change({count}, {n}, mix + i * {s}, further, v, moved + {at});"]
        slope += [f"coadjoint_slope_change(point + {at}{passed(u)}, moved + {at}, h * scale[i], further + {at});"]
        end = f"coadjoint_mixed_change({s}, {n}, out, further, v, v);"
    each = f"for (unsigned long i = 0; i < {s}; ++i)"
    if explicit:
        stages = block(each, [*point, *slope])
    else:
        passes = f"for (unsigned long pass = 0; pass < {tables.iterations + 1}; ++pass)"
        stages = block(passes, [*block(each, point), *block(each, slope)])
    body = [
        *numbers("double", "mix", tables.mix.tolist()),
        *numbers("double", "scale", tables.scale.tolist()),
        *numbers("double", "out", tables.out.tolist()),
        f"double {', '.join(arrays)};",
        *stages,
        end,
    ]
    return function(name, f"{declared}{u}, double h", body)


def _products(field: Field, state: str, gradient_name: str, before: str = "") -> list[str]:
    """Statements that set f to the products of a field, with the state of one vector and the gradient of another."""
    own = field.own_first, field.own_column, field.own_state, field.own_constant
    first, column, at, constant = own if field.separated else (field.first, field.column, field.state, field.constant)
    columns, states, constants, lines = column.tolist(), at.tolist(), constant.tolist(), []
    entries = [range(int(first[i]), int(first[i + 1])) for i in range(field.size)]
    for low, high in runs_of([len(one) for one in entries]):
        length = len(entries[low])
        if length > LONGEST_CHAIN:
            for i in range(low, high):
                chosen = entries[i]
                stored = [
                    *numbers("double", "constant", [constants[q] for q in chosen]),
                    *numbers("coadjoint_index", "state", [states[q] for q in chosen]),
                    *numbers("coadjoint_index", "column", [columns[q] for q in chosen]),
                ]
                total = f"coadjoint_bracket({length}, constant, state, column, {state}, {gradient_name})"
                lines += block("", [*stored, f"f[{i}] = {before.format(i=i)}length * {total};"])
            continue
        found: dict[str, list[Any]] = {"i": list(range(low, high))}
        for q in range(length):
            found[f"c{q}"] = [constants[one[q]] for one in entries[low:high]]
            found[f"s{q}"] = [states[one[q]] for one in entries[low:high]]
            found[f"u{q}"] = [columns[one[q]] for one in entries[low:high]]
        factors = [(f"{{c{q}}} * {state}[{{s{q}}}]", f"{gradient_name}[{{u{q}}}]") for q in range(length)]
        lines += repeated(f"f[{{i}}] = {before}length * {chain_of(factors, '0.0')};", found)
    return lines


def stages(
    prepared: PreparedRun, tables: RungeKuttaTables, numbers: TableNumbers, inputs: str, tangent: bool
) -> Exported:
    """Return the statements of a scheme with stages, and the functions that they call."""
    solver = {value: key for key, value in codes("Solver").items()}[tables.solver]
    if solver not in ("EXPLICIT", "ITERATED"):
        raise TypeError(
            f"{prepared.method} solves equations in each step, so it cannot be exported; take Splitting or "
            "ExplicitRungeKutta"
        )
    terms = tables.field.terms
    check_terms(prepared.system.name, terms)
    numbers.check_constant(tables, [f"field.terms.{field}" for field in FIELDS], str(prepared.method))
    number, n = numbers.of_terms(tables, "field.terms.", terms), tables.field.size
    lines = _functions(tables, number, inputs, solver == "EXPLICIT", tangent)
    error = [f"double error[{n}];", f"for (unsigned long i = 0; i < {n}; ++i) error[i] = 0.0;"]
    step = _substeps(tables, inputs)
    steps = [*error, *block("for (; steps > 0; --steps)", step)]
    change = [*error, *_substeps(tables, inputs, tangent=True)] if tangent else []
    return Exported(lines, [*error, *step], steps, change)
