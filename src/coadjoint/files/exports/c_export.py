"""Prepared runs as freestanding C99."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple, cast

import numpy as np

from coadjoint.errors import in_one_line
from coadjoint.files.exports.c_flows import ATTITUDE, PartsInC
from coadjoint.files.exports.c_stages import StagesInC
from coadjoint.files.exports.c_statements import (
    FREE_BODY,
    VECTORS,
    WIDTH,
    DeclaredInputs,
    Value,
    block,
    function,
    includes,
    repeated,
    runtime,
    wrapped,
)
from coadjoint.files.output.output_files import HEADERS, write_text
from coadjoint.kernels.interface import codes, limit
from coadjoint.kernels.loop import CompiledLoop
from coadjoint.kernels.tables.flow import FlowTables
from coadjoint.kernels.tables.forces import ForceTable
from coadjoint.kernels.tables.runge_kutta import RungeKuttaTables
from coadjoint.kernels.tables.steps import INNER_LOOP_INDEX
from coadjoint.kernels.tables.writable import WritableTables
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.forced import Forced
from coadjoint.program.blocks import BlockKind
from coadjoint.program.term_table import FUNCTION, Terms
from coadjoint.runs.loops.loops import loops_of_system
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.short_repr import short
from coadjoint.validation import read_bool, read_path

IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,40}")
"""Names of C functions; longer ones are not distinguished by all linkers."""
FIELDS = ("offset", "coefficient")
"""The numbers of terms that may be inputs."""
MOST_NUMBERS = 2**22
"""Numbers of the tables; a file of more would take compilers minutes and gigabytes."""


@suggest_keywords
def export_c(prepared: PreparedRun, path: str | Path, *, name: str | None = None, tangent: bool = False) -> Path:
    """Write the steps of a prepared run as C99: one header, without allocation, that needs only ``sqrt``.

    For microcontrollers, simulators and other programs without Python. The functions compute with the elementary
    functions of the library and have the bits of its runs, whatever the compiler, its optimization and the processor.

    Parameters
    ----------
    prepared : PreparedRun
        System, scheme, step and inputs. Exported are splittings and compositions of exact flows with any polynomial
        energy, free bodies and bonds, and explicit Runge-Kutta methods; also with `forces.LinearDamping` and constant
        `forces.Torque`, or of splittings with an attitude.
    path : str or Path
        Path of the header, .h or .hpp. A header that this function has written is replaced.
    name : str, optional
        What the names of all functions begin with; by default the file name without its suffix.
    tangent : bool
        Whether to write the derivative of a step, too.

    Returns
    -------
    Path
        The path of the header.

    Raises
    ------
    TypeError
        The run cannot be exported: it has functions of the user, matrices, an implicit scheme, noise, a group element
        where Casimirs were subtracted from the energy, or several systems. The message names what cannot be exported.
    ValueError, OutputError
        The name is not an identifier of C, or the path cannot be written.

    Notes
    -----
    With the name ``top``, n coordinates, and m inputs (without inputs there is no argument ``u``)::

        void top_step(double x[n], const double u[m], double h);
        void top_run(double x[n], const double u[m], double h, unsigned long steps);
        void top_step_with_tangents(double x[n], double v[], unsigned long vectors, const double u[m], double h);

    ``top_run`` has the bits of a run with this number of steps, ``top_step`` those of a run of one step. The last flow
    of a step of a splitting is joined with the first flow of the next one, so that one long run and several short ones
    differ by round-off.

    Examples
    --------
    >>> import tempfile
    >>> import coadjoint as co
    >>> top = co.prepare(co.systems.heavy_top(), co.Splitting(order=4), step=0.05)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     text = co.export_c(top, f"{folder}/top.h").read_text()
    >>> "static inline void top_step(double *x, double h)" in text
    True
    """
    target = read_path(path, "path")
    text = c_header(prepared, target.stem if name is None else name, read_bool(tangent, "tangent"))
    write_text(text, target, HEADERS)
    return target


class Exported(NamedTuple):
    """Statements of a step, of all steps of a run, and of the derivative of a step; `lines` define what they call."""

    # `resumable`: functions for the first step and all others, which take the errors of `compensated` sums.

    lines: list[str]
    step: list[str]
    steps: list[str]
    change: list[str]
    widest: int = 0
    resumable: bool = False
    compensated: bool = False
    side: int = 0


def c_header(prepared: PreparedRun, name: str, tangent: bool = False) -> str:
    """Return the text of the header of `export_c`."""
    if type(name) is not str or not IDENTIFIER.fullmatch(name) or name.lower() == "coadjoint":
        raise ValueError(
            f"the functions cannot begin with {short(name)}; give a name of at most 41 letters, digits and underscores "
            "that begins with a letter, other than coadjoint"
        )
    loop, numbers = loop_of_run(prepared)
    inputs = DeclaredInputs(", const double *u", ", u") if prepared.inputs is not None else DeclaredInputs()
    exported = _exported(prepared, loop, numbers, inputs, tangent, bool(prepared.system.forces))
    lines = exported.lines
    lines += function("step", f"double *x{inputs.declared}, double h", exported.step)
    lines += function("run", f"double *x{inputs.declared}, double h, unsigned long steps", exported.steps)
    if tangent:
        arguments = f"double *x, {VECTORS}{inputs.declared}, double h"
        lines += function("step_with_tangents", arguments, exported.change)
    body = "\n".join(lines)
    n = prepared.system.dim
    kind = "uint16_t" if max(n, _largest(body)) < 2**16 else "uint32_t"
    called = runtime(body)
    defined = [f"#define COADJOINT_SIZE {n}", f"#define COADJOINT_STEP {prepared.step!r}"]
    if "COADJOINT_WIDEST" in called:
        defined.append(f"#define COADJOINT_WIDEST {exported.widest}")
    defined += [f"typedef {kind} coadjoint_index;"] if "coadjoint_index" in body else []
    code = "\n".join([includes(defined), called, body, END])
    code = code.replace("coadjoint_", f"{name}_").replace("COADJOINT_", f"{name.upper()}_")
    return _comment(prepared, name, tangent, exported) + "\n".join(map(wrapped, code.split("\n")))


END = """
#if defined(__clang__)
#pragma STDC FP_CONTRACT DEFAULT
#elif defined(__GNUC__)
#pragma GCC pop_options
#endif
#endif
"""


def _largest(body: str) -> int:
    """Return the largest whole number that a table may contain."""
    return max(map(int, re.findall(r"(?<![\w.])\d+(?![\w.])", body)), default=0)


class _Numbers:
    """The numbers of tables: written out, or the inputs that each call sets."""

    def __init__(self, entries: dict[tuple[int, str, int], int]) -> None:
        self._entries = entries

    def of(self, table: Any, field: str, values: Any) -> list[Value]:
        """Return the numbers of a field of a table."""
        found: list[Value] = values.tolist()
        for (owner, name, position), index in self._entries.items():
            if owner == id(table) and name == field:
                found[position] = f"u[{index}]"
        return found

    def of_terms(self, table: Any, prefix: str, terms: Terms) -> Any:
        """Return the function of numbers of terms, for `gradient`."""
        known = {
            field: self.of(table, prefix + field, getattr(terms, field))
            for field in ("offset", "weight", "coefficient")
        }
        return lambda field, position: known[field][position]

    def check_constant(self, table: Any, fields: Sequence[str], why: str) -> None:
        """Raise TypeError if numbers that are not in `fields` of a table are inputs."""
        for owner, name, _ in self._entries:
            if owner == id(table) and name not in fields:
                raise TypeError(f"{why} has inputs in {name}, which cannot be exported; prepare it without inputs")


def loop_of_run(prepared: PreparedRun) -> tuple[CompiledLoop, _Numbers]:
    """Return the loop of a run of step 1, whose flows have the lengths of the coefficients, and its numbers."""
    if not isinstance(prepared, PreparedRun):
        raise TypeError(f"{short(prepared)} is no prepared run; give co.prepare(system, method, step)")
    system, scheme = prepared.system, prepared.scheme
    if system.is_batch:
        raise TypeError(f"the {system.name} has several systems, and one is exported; prepare the system of a member")
    if system.has_matrices:
        raise TypeError(
            f"{system.name} has matrices as states, which are multiplied by BLAS and not exported; give a system on a "
            "Lie algebra, whose states are vectors"
        )
    if system.unforced.algebra is None:
        raise TypeError(
            f"{system.name} has a structure matrix that is a function, which cannot be exported; give a "
            "LiePoissonSystem, with structure constants"
        )
    if system.forces:  # substeps multiply the step, as those of the library
        scheme = Forced(cast(Forced, scheme).inner)
    if prepared.inputs is None:
        return loops_of_system(system, scheme, 1.0, prepared.representation).compiled[0], _Numbers({})
    loops = prepared.inputs.loops(scheme, 1.0, prepared.representation)
    assert loops.writable is not None
    return loops.compiled[0], _Numbers(_entries(prepared, loops.writable))


def _entries(prepared: PreparedRun, tables: WritableTables) -> dict[tuple[int, str, int], int]:
    assert prepared.inputs is not None
    place = {index: position for position, index in enumerate(prepared.inputs.changing.tolist())}
    found = {}
    for table, field, (positions, sources, factor) in tables.multiples():
        assert factor is None or np.all(factor == 1.0)  # coefficients of linear terms, and torques
        for position, source in zip(positions.tolist(), sources.tolist(), strict=True):
            found[id(table), field, position] = place[source]
    if tables.has_sums:
        raise TypeError(
            f"inputs of {prepared.system.name} enter completed squares of several coordinates, which cannot be "
            'exported; take Splitting(parts="coordinates"), or prepare it without inputs'
        )
    return found


def _exported(
    prepared: PreparedRun, loop: CompiledLoop, numbers: _Numbers, inputs: DeclaredInputs, tangent: bool, forced: bool
) -> Exported:
    exporters: dict[Any, Callable[..., Exported]] = {FlowTables: _splitting, RungeKuttaTables: _stages}
    export = exporters.get(type(loop.tables))
    if prepared.representation is not None:
        _check_attitude(prepared, loop)
    if export is not None:
        return export(prepared, loop.tables, numbers, inputs, tangent)
    if forced:
        return _forced(prepared, loop, numbers, inputs, tangent)
    raise TypeError(
        f"{prepared.method} is neither a splitting nor an explicit Runge-Kutta method, so it cannot be exported; take "
        "Splitting or ExplicitRungeKutta"
    )


def _check_attitude(prepared: PreparedRun, loop: CompiledLoop) -> None:
    """Raise TypeError for group elements that need more than the flows of a table."""
    tables, instead = loop.tables, "take Splitting(parts='free_body')"
    if prepared.system.forces:
        why, instead = "the system has forces", "take co.systems.body, whose state contains the attitude"
    elif type(tables) is not FlowTables:
        why = f"{prepared.method} is no splitting"
    elif loop.shift:
        why = "Casimirs were subtracted from the energy, so that the parts turn it by other angles than the state"
    elif tables.bent.any() or (tables.group.kind % limit("RATIONAL") == BlockKind.SERIES).any():
        why = "its blocks are series, or its rotations are not rational as those of the state are"
    else:
        return
    raise TypeError(
        f"the attitude of {prepared.system.name}, a group element, cannot be exported: {why}; {instead}, or prepare "
        "the run without attitude="
    )


def check_terms(prepared: PreparedRun, terms: Terms) -> None:
    """Raise TypeError for energies with functions, or with more numbers than are exported."""
    if (terms.kind == FUNCTION).any():
        raise TypeError(
            f"the energy of {prepared.system.name} has a function that is no polynomial and cannot be exported; give "
            "a polynomial near it, or call the run from Python"
        )
    size = len(terms.weight) + len(terms.coefficient)
    if size > MOST_NUMBERS:
        raise TypeError(
            f"the energy of {prepared.system.name} has {size} numbers, and at most {MOST_NUMBERS} are exported; give a "
            "smaller system"
        )


def _splitting(
    prepared: PreparedRun, tables: FlowTables, numbers: _Numbers, inputs: DeclaredInputs, tangent: bool
) -> Exported:
    terms = tables.terms
    check_terms(prepared, terms)
    numbers.check_constant(tables, [f"terms.{field}" for field in FIELDS], str(prepared.method))
    parts = PartsInC(tables, numbers.of_terms(tables, "terms.", terms), inputs)
    begin, first, every, end = (int(row) for row in tables.section)
    lines = parts.functions(tangent)
    state, x = f"{parts.state.declared}{inputs.declared}, double h", f"{parts.state.passed}{inputs.passed}, h"
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
    state, x = f"{parts.state.declared}, {ATTITUDE}{u.declared}, double h", f"{parts.state.passed}, A, E{u.passed}, h"
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
    return lines + function(
        "run_with_attitude", f"double *x, double *A{u.declared}, double h, unsigned long steps", run
    )


def _stages(
    prepared: PreparedRun, tables: RungeKuttaTables, numbers: _Numbers, inputs: DeclaredInputs, tangent: bool
) -> Exported:
    solver = {value: key for key, value in codes("Solver").items()}[tables.solver]
    if solver not in ("EXPLICIT", "ITERATED"):
        raise TypeError(
            f"{prepared.method} solves equations in each step, so it cannot be exported; take Splitting or "
            "ExplicitRungeKutta"
        )
    terms = tables.field.terms
    check_terms(prepared, terms)
    numbers.check_constant(tables, [f"field.terms.{field}" for field in FIELDS], str(prepared.method))
    stages = StagesInC(tables, numbers.of_terms(tables, "field.terms.", terms), inputs, solver == "EXPLICIT")
    n = tables.field.size
    lines = stages.functions(tangent)
    error = [f"double error[{n}];", f"for (unsigned long i = 0; i < {n}; ++i) error[i] = 0.0;"]
    step = stages.substeps()
    steps = [*error, *block("for (; steps > 0; --steps)", step)]
    change = [*error, *stages.substeps(tangent=True)] if tangent else []
    return Exported(lines, [*error, *step], steps, change)


def _forced(
    prepared: PreparedRun, loop: CompiledLoop, numbers: _Numbers, inputs: DeclaredInputs, tangent: bool
) -> Exported:
    """Half flows of the forces, a step of the scheme, and half flows in reversed order, at fractions of the step."""
    inner = _exported(prepared, loop.referenced[INNER_LOOP_INDEX], numbers, inputs, tangent, forced=False)
    forces = [table.tables for index, table in loop.referenced.items() if index != INNER_LOOP_INDEX]
    if inner.compensated:
        raise TypeError(f"{prepared.method} has compensated sums beside forces; give compensated=False to export it")
    lines, n = inner.lines, prepared.system.dim
    declared = inputs.declared
    for k, (label, table) in enumerate(zip(prepared.system.labels, forces, strict=True)):
        flow, change = _flow_of_force(label, table, numbers, n)
        lines += function(f"force_{k}", f"double *x{declared}, double tau", flow)
        if tangent:
            lines += function(f"force_change_{k}", "double *v, double tau", change)
    x, numbered, fractions = f"x{inputs.passed}", range(len(forces)), prepared.scheme.fractions
    forward = [f"coadjoint_force_{k}({x}, 0.5 * h);" for k in numbered]
    lines += function("inner_step", f"double *x{declared}, double h", inner.step)
    step = [*forward, f"coadjoint_inner_step({x}, h);", *forward[::-1]]
    if len(fractions) > 1:
        lines += function("substep", f"double *x{declared}, double h", step)
        step = [f"coadjoint_substep({x}, {c!r} * h);" for c in fractions]
    steps = [f"for (; steps > 0; --steps) coadjoint_step({x}, h);"]
    changed: list[str] = []
    if tangent:
        lines += function("inner_change", f"double *x, {VECTORS}{declared}, double h", inner.change)
        each = "for (unsigned long vector = 0; vector < vectors; ++vector)"
        moved = [f"coadjoint_force_change_{k}(v + vector * {n}, 0.5 * h);" for k in numbered]
        half = [[*block(each, [moved[k]]), forward[k]] for k in numbered]
        middle = f"coadjoint_inner_change(x, v, vectors{inputs.passed}, h);"
        changed = [*(line for one in half for line in one), middle, *(line for one in half[::-1] for line in one)]
        if len(fractions) > 1:
            lines += function("subchange", f"double *x, {VECTORS}{declared}, double h", changed)
            changed = [f"coadjoint_subchange(x, v, vectors{inputs.passed}, {c!r} * h);" for c in fractions]
    return Exported(lines, step, steps, changed, inner.widest)


def _flow_of_force(label: str, table: ForceTable, numbers: _Numbers, n: int) -> tuple[list[str], list[str]]:
    """Return the statements of the flow of a force, and those of its derivative."""
    kinds, shapes = codes("ForceKind"), codes("Shape")
    aim = numbers.of(table, "aim", table.aim)
    if table.kind == kinds["CONSTANT"]:
        numbers.check_constant(table, ("aim",), label)
        return repeated("x[{i}] = coadjoint_fma(tau, {b}, x[{i}]);", {"i": range(n), "b": aim[:n]}), []
    if table.kind != kinds["DAMPING"]:
        raise TypeError(
            f"{label} is random, nonlinear or a function, and its flow cannot be exported; take LinearDamping or a "
            "constant Torque, which may be an input that each call sets: inputs={'torque': 'Torque'}"
        )
    if table.shape == shapes["FULL"]:
        raise TypeError(f"the rate of {label} is a matrix, which cannot be exported; give a number for each coordinate")
    rates = table.rate.tolist() * (n if table.shape == shapes["MULTIPLE"] else 1)
    numbers.check_constant(table, (), label)
    found = {"i": range(n), "r": rates[:n], "b": aim[:n]}
    flow = repeated("coadjoint_damp(x, {i}, {r}, {b}, tau);", found)
    change = repeated("coadjoint_damp(v, {i}, {r}, 0.0, tau);", {"i": range(n), "r": rates[:n]})
    return flow, change


def _comment(prepared: PreparedRun, name: str, tangent: bool, exported: Exported) -> str:
    """Return the license, what is exported, and how it is called."""
    license_text = FREE_BODY.read_text(encoding="utf-8").partition("\n")[2].partition("\nConventions.")[0]
    u = "" if prepared.inputs is None else f", const double u[{len(prepared.inputs.changing)}]"
    n, upper = prepared.system.dim, name.upper()
    functions = [
        (f"step(double x[{n}]{u}, double h)", "one step of the length h"),
        (f"run(double x[{n}]{u}, double h, unsigned long steps)", "several steps"),
    ]
    if exported.resumable:
        error, begun, copied = "", "", "a copy of the state"
        if exported.compensated:
            error, begun, copied = f", double error[{n}]", ", with errors of 0", "copies of the state and of the errors"
        functions += [
            (f"first(double x[{n}]{error}{u}, double h)", f"the first step of a run{begun}"),
            (f"next(double x[{n}]{error}{u}, double h)", "every other step"),
            (f"finish(double x[{n}]{error}{u}, double h)", f"completes {copied} between two steps"),
        ]
    if exported.side:
        d = exported.side
        run = f"run_with_attitude(double x[{n}], double A[{d * d}]{u}, double h, unsigned long steps)"
        functions.append((run, f"also moves a group element of {d} rows"))
    if tangent:
        moved = f"also moves {n} numbers each by its derivative"
        functions.append((f"step_with_tangents(double x[{n}], double v[], unsigned long vectors{u}, double h)", moved))
    what = _safe(f"{prepared.system.name} by {prepared.method}")
    lines = [fill(f"/* {name}: steps of {what}, written by coadjoint.", WIDTH, break_on_hyphens=False), ""]
    lines += [license_text.strip(), ""]
    lines += [f"    void {name}_{function};\n        {meaning}" for function, meaning in functions]
    conditions = f"The prepared step is {upper}_STEP, and a state has {upper}_SIZE numbers. "
    if prepared.inputs is not None:
        order, position = [], 0
        for key, indices in prepared.inputs.indices.items():
            order.append(f"{key} from u[{position}] on")
            position += indices.size
        conditions += f"The inputs are {', '.join(order)}. "
    lines += ["", fill(conditions + CONDITIONS.format(upper=upper), WIDTH, break_on_hyphens=False)]
    return "\n".join(lines) + "\n"


CONDITIONS = """C99 or C++11, compiled by GCC or Clang at any level, has the bits of the library. Numbers must be \
rounded to nearest; -ffast-math is refused; do not give -ffp-contract=fast to Clang, and give other compilers an \
option that does not fuse products. {upper}_FMA may name a function of three numbers, a b + c rounded once; if it is \
not defined, it is an instruction of the processor, or else computed by integers. Names that are not in this list are \
internal. */"""


def _safe(text: str) -> str:
    line = in_one_line(text, 200).encode("ascii", "replace").decode()
    return line.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?").replace("\\", "/")
