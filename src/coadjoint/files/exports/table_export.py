"""Prepared splittings as tables in JSON, which the C interface runs, and the files of that interface."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

from coadjoint.errors import in_one_line
from coadjoint.files.exports.c_export import loop_of_run
from coadjoint.files.exports.c_statements import check_terms
from coadjoint.files.output.output_files import OutputError, pending, write_text
from coadjoint.kernels.library import SOURCE, SUFFIX, kernels
from coadjoint.kernels.tables.derivatives import flow_cotangents
from coadjoint.kernels.tables.flow import FlowTables
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.validation import read_path

INTERFACE = SOURCE / "interface" / "coadjoint_runs.h"
LIBRARY = f"libcoadjoint{SUFFIX}"


@suggest_keywords
def export_table(prepared: PreparedRun, path: str | Path) -> Path:
    """Write a prepared splitting as a table in JSON, which the C interface of the library runs.

    For programs in C, C++, Julia, Rust or any language that can call C, with the compiled library and without Python.
    The table can be read by hand too: it contains everything that `Splitting.flow_table` exports.

    Parameters
    ----------
    prepared : PreparedRun
        System, scheme and step. Exported are splittings and compositions of exact flows with any polynomial energy,
        free bodies and bonds, with compensated sums or without, as long as there are no forces.
    path : str or Path
        Path of the table, .json. A table that exists is replaced.

    Returns
    -------
    Path
        The path of the table.

    Raises
    ------
    TypeError
        The run cannot be exported: it is no splitting, or it has functions of the user, forces, inputs, a group
        element, or several systems. The message names what cannot be exported.
    OutputError
        The path cannot be written.

    Examples
    --------
    >>> import json, tempfile
    >>> import coadjoint as co
    >>> top = co.prepare(co.systems.heavy_top(), co.Splitting(order=4), step=0.05)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     table = json.loads(co.export_table(top, f"{folder}/top.json").read_text())
    >>> table["version"], table["dim"], table["step"]
    (3, 6, 0.05)
    """
    target = read_path(path, "path")
    write_text(table_text(prepared), target)
    return target


def table_text(prepared: PreparedRun) -> str:
    """Return the text of the table of `export_table`."""
    loop, _ = loop_of_run(prepared)
    system, scheme = prepared.system, prepared.scheme
    further = {
        "inputs": prepared.inputs is not None,
        "forces": bool(system.forces),
        "an attitude": prepared.representation is not None,
    }
    if any(further.values()):
        given = next(name for name, has in further.items() if has)
        raise TypeError(f"the run has {given}, which a table does not contain; prepare it without, or take co.export_c")
    if type(loop.tables) is not FlowTables:
        raise TypeError(f"{prepared.method} is not made of exact flows, so it has no table; take Splitting")
    flow_table = scheme.flow_table(system)
    check_terms(prepared.system.name, flow_table.terms)
    compensated = loop.tables.compensated
    tables = flow_cotangents(flow_table, system, None, prepared.step, compensated, None).tables
    table = flow_table.to_mapping() | {
        "step": prepared.step,
        "compensated": compensated,
        "body_column": tables.base.body_column,
        "body": tables.base.body,
        "state_action": tables.base.state._asdict(),
        "dual_action": tables.dual._asdict(),
        "made_of": in_one_line(f"{system.name} by {prepared.method}", 200),
    }
    return json.dumps(table, default=_plain, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    """Return arrays, and the fractions of Casimirs, as JSON has them."""
    return float(value) if type(value) is Fraction else value.tolist()


def write_interface(folder: str | Path) -> list[Path]:
    """Copy the header of the C interface and the library for this processor to a folder."""
    target = Path(folder)
    if not target.is_dir():
        raise OutputError(f"{folder}: the folder does not exist; create it first")
    copies = {INTERFACE: target / INTERFACE.name, Path(kernels()._name): target / LIBRARY}
    for source, copy in copies.items():
        with pending(copy) as unfinished:  # programs that have loaded the library keep the old one
            unfinished.path.write_bytes(source.read_bytes())
    return list(copies.values())
