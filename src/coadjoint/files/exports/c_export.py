"""Prepared runs as freestanding C99."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from textwrap import fill
from typing import Any, cast

import numpy as np

from coadjoint.errors import in_one_line
from coadjoint.files.exports.c_flows import splitting
from coadjoint.files.exports.c_stages import stages
from coadjoint.files.exports.c_statements import (
    FREE_BODY,
    INDENT,
    VECTORS,
    WIDTH,
    Exported,
    TableNumbers,
    block,
    function,
    passed,
    repeated,
    runtime,
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
from coadjoint.runs.loops.loops import loops_of_system
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.short_repr import short
from coadjoint.validation import read_bool, read_path

PUBLIC = {name: name for name in ("step_with_tangents", "run_with_attitude")}
# Only these functions have an underscore in their names, so that those of two headers are never equal.
IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,40}")
"""Names of C functions; longer ones are not distinguished by all linkers."""


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


def c_header(prepared: PreparedRun, name: str, tangent: bool = False) -> str:
    """Return the text of the header of `export_c`."""
    if type(name) is not str or not IDENTIFIER.fullmatch(name) or name.lower().startswith("coadjoint"):
        raise ValueError(
            f"the functions cannot begin with {short(name)}; give a name of at most 41 letters, digits and underscores "
            "that begins with a letter, and not with coadjoint"
        )
    loop, numbers = loop_of_run(prepared)
    inputs = "" if prepared.inputs is None else ", const double *u"
    exported = _exported(prepared, loop, numbers, inputs, tangent, bool(prepared.system.forces))
    lines = exported.lines
    lines += function("step", f"double *x{inputs}, double h", exported.step)
    lines += function("run", f"double *x{inputs}, double h, unsigned long steps", exported.steps)
    if tangent:
        arguments = f"double *x, {VECTORS}{inputs}, double h"
        lines += function("step_with_tangents", arguments, exported.change)
    body = "\n".join(lines)
    n = prepared.system.dim
    kind = "uint16_t" if max(n, _largest(body)) < 2**16 else "uint32_t"
    called = runtime(body)
    defined = [f"#define COADJOINT_SIZE {n}", f"#define COADJOINT_STEP {prepared.step!r}"]
    if "COADJOINT_WIDEST" in called:
        defined.append(f"#define COADJOINT_WIDEST {exported.widest}")
    defined += [f"typedef {kind} coadjoint_index;"] if "coadjoint_index" in body else []
    code = "\n".join([INCLUDES, *defined, "", called, body, END])
    code = re.sub(r"\bcoadjoint_(\w+)", lambda one: f"{name}_{PUBLIC.get(one[1], one[1].replace('_', ''))}", code)
    code = code.replace("COADJOINT_", f"{_of_macros(name)}_")
    return _comment(prepared, name, tangent, exported) + "\n".join(map(_wrapped, code.split("\n")))


def _of_macros(name: str) -> str:
    """Return what the macros begin with: another text for each name, also of those that differ in case alone."""
    return name.swapcase() if name in (name.lower(), name.upper()) else name


def _wrapped(line: str) -> str:
    """Return a line of code, broken at spaces if it is too long."""
    if len(line) <= WIDTH or line.startswith(("#", "/*")):
        return line
    start = line[: len(line) - len(line.lstrip())]
    return fill(
        line.strip(),
        WIDTH,
        initial_indent=start,
        subsequent_indent=start + 2 * INDENT,
        break_on_hyphens=False,
        break_long_words=False,
    )


INCLUDES = """#ifndef COADJOINT_H
#define COADJOINT_H
#include <float.h>
#include <stdint.h>
#if !defined(__STDC_HOSTED__) || __STDC_HOSTED__
#include <math.h>
#else /* freestanding: the program that links this provides sqrt, and fma if the processor has it */
#ifdef __cplusplus
extern "C" {
#endif
double sqrt(double x);
double fma(double a, double b, double c);
#ifdef __cplusplus
}
#endif
#endif
#if DBL_MANT_DIG != 53 || (defined(FLT_EVAL_METHOD) && (FLT_EVAL_METHOD < 0 || FLT_EVAL_METHOD == 2))
#error "double must have 53 bits, without excess precision: for 32-bit x86 give -msse2 -mfpmath=sse"
#endif
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "-ffast-math changes the meaning of sums; compile without it"
#endif
#if defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__) || defined(__NO_SIGNED_ZEROS__)
#error "a part of -ffast-math changes sums, quotients or zeros; compile without -funsafe-math-optimizations"
#endif
#if defined(__clang__) /* a product and a sum are fused only where this is written */
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC push_options
#pragma GCC optimize("fp-contract=off")
#endif
"""
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


def loop_of_run(prepared: PreparedRun) -> tuple[CompiledLoop, TableNumbers]:
    """Return the loop of a run of step 1, whose flows have the lengths of the coefficients, and its numbers."""
    if not isinstance(prepared, PreparedRun):
        raise TypeError(f"{short(prepared)} is no prepared run; give co.prepare(system, method, step)")
    system, scheme = prepared.system, prepared.scheme
    if system.is_batch:
        raise TypeError(f"the {system.name} has several systems, and one is exported; prepare the system of a member")
    sampled = [label for label, force in zip(system.labels, system.forces, strict=True) if force.sampled]
    if sampled:
        raise TypeError(f"{sampled[0]} calls a law, a function, which cannot be exported; give its torque as an input")
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
        return loops_of_system(system, scheme, 1.0, prepared.representation).compiled[0], TableNumbers({})
    loops = prepared.inputs.loops(scheme, 1.0, prepared.representation)
    return loops.compiled[0], TableNumbers(_entries(prepared, loops.writable[0]))


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
    prepared: PreparedRun,
    loop: CompiledLoop,
    numbers: TableNumbers,
    inputs: str,
    tangent: bool,
    forced: bool,
) -> Exported:
    exporters: dict[Any, Callable[..., Exported]] = {FlowTables: splitting, RungeKuttaTables: stages}
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


def _forced(prepared: PreparedRun, loop: CompiledLoop, numbers: TableNumbers, inputs: str, tangent: bool) -> Exported:
    """Half flows of the forces, a step of the scheme, and half flows in reversed order, at fractions of the step."""
    inner = _exported(prepared, loop.referenced[INNER_LOOP_INDEX], numbers, inputs, tangent, forced=False)
    forces = [table.tables for index, table in loop.referenced.items() if index != INNER_LOOP_INDEX]
    if inner.compensated:
        raise TypeError(f"{prepared.method} has compensated sums beside forces; give compensated=False to export it")
    lines, n = inner.lines, prepared.system.dim
    for k, ((position, _), table) in enumerate(zip(prepared.system.flows, forces, strict=True)):
        flow, change = _flow_of_force(prepared.system.labels[position], table, numbers, n)
        lines += function(f"force_{k}", f"double *x{inputs}, double tau", flow)
        if tangent:
            lines += function(f"force_change_{k}", "double *v, double tau", change)
    x, numbered, fractions = f"x{passed(inputs)}", range(len(forces)), prepared.scheme.fractions
    forward = [f"coadjoint_force_{k}({x}, 0.5 * h);" for k in numbered]
    lines += function("inner_step", f"double *x{inputs}, double h", inner.step)
    step = [*forward, f"coadjoint_inner_step({x}, h);", *forward[::-1]]
    if len(fractions) > 1:
        lines += function("substep", f"double *x{inputs}, double h", step)
        step = [f"coadjoint_substep({x}, {c!r} * h);" for c in fractions]
    steps = [f"for (; steps > 0; --steps) coadjoint_step({x}, h);"]
    changed: list[str] = []
    if tangent:
        lines += function("inner_change", f"double *x, {VECTORS}{inputs}, double h", inner.change)
        each = "for (unsigned long vector = 0; vector < vectors; ++vector)"
        moved = [f"coadjoint_force_change_{k}(v + vector * {n}, 0.5 * h);" for k in numbered]
        half = [[*block(each, [moved[k]]), forward[k]] for k in numbered]
        middle = f"coadjoint_inner_change(x, v, vectors{passed(inputs)}, h);"
        changed = [*(line for one in half for line in one), middle, *(line for one in half[::-1] for line in one)]
        if len(fractions) > 1:
            lines += function("subchange", f"double *x, {VECTORS}{inputs}, double h", changed)
            changed = [f"coadjoint_subchange(x, v, vectors{passed(inputs)}, {c!r} * h);" for c in fractions]
    return Exported(lines, step, steps, changed, inner.widest)


def _flow_of_force(label: str, table: ForceTable, numbers: TableNumbers, n: int) -> tuple[list[str], list[str]]:
    """Return the statements of the flow of a force, and those of its derivative."""
    kinds, shapes = codes("ForceKind"), codes("Shape")
    aim = numbers.of(table, "aim", table.aim)
    if table.kind == kinds["CONSTANT"]:
        numbers.check_constant(table, ("aim",), label)
        return repeated("x[{i}] = coadjoint_fma(tau, {b}, x[{i}]);", {"i": range(n), "b": aim[:n]}), []
    if table.kind != kinds["DAMPING"] or table.amplitude:
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
    n, upper = prepared.system.dim, _of_macros(name)
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
rounded to nearest. -ffast-math is refused, by GCC also parts of it. Do not give -ffp-contract=fast or \
-funsafe-math-optimizations to Clang, and give other compilers an option that does not fuse products. {upper}_FMA may \
name a function of three numbers, a b + c rounded once; if it is not defined, it is an instruction of the processor, \
or else computed by integers. Names that are not in this list are internal. */"""


def _safe(text: str) -> str:
    line = in_one_line(text, 200).encode("ascii", "replace").decode()
    return line.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?").replace("\\", "/")
