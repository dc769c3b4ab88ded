"""Files of references: CSV with comment lines, and JSON, with the digits that are certain."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from coadjoint import __version__
from coadjoint.checkcases.attitudes import stacked
from coadjoint.checkcases.check_case import CheckCase
from coadjoint.checkcases.comparison import Comparison
from coadjoint.files.output.output_files import TEXTS, check_target, write_text

FORMATS = (".csv", *TEXTS)
FORMAT_VERSION = 1
LICENSE = "CC0 1.0, https://creativecommons.org/publicdomain/zero/1.0/: copy, change and ship this file freely"


def certain_columns(case: CheckCase) -> dict[str, list[float]]:
    """Return the reference at the sampled times, rounded to the digits that are certain, and one more."""
    columns = case.reference([float(f"{t:.15g}") for t in case.times])
    result = {"t": columns["t"].tolist()}
    for quantity in case.quantities:
        values = stacked(columns, quantity.columns)
        size = 1.0 if quantity.kind == "attitude" else float(np.linalg.norm(values, axis=1).max())
        digits = math.ceil(-math.log10(case.accuracy * (size or 1.0))) + 1
        result |= {name: [round(v, digits) + 0.0 for v in columns[name].tolist()] for name in quantity.columns}
    return result


def csv_text(case: CheckCase) -> str:
    """Return a check-case as CSV: its description in comment lines, names of columns, numbers."""
    columns = certain_columns(case)
    comments = [f"coadjoint {__version__} check-case, format {FORMAT_VERSION}", *str(case).splitlines()]
    comments += [f"license: {LICENSE}"]
    lines = [f"# {line}".rstrip() for line in comments]
    lines.append(",".join(columns))
    lines += [",".join(map(repr, row)) for row in zip(*columns.values(), strict=True)]
    return "\n".join(lines) + "\n"


def json_text(case: CheckCase) -> str:
    """Return a check-case as JSON."""
    document: dict[str, Any] = {
        "format": "coadjoint check-case",
        "format_version": FORMAT_VERSION,
        "license": LICENSE,
        "name": case.name,
        "title": case.title,
        "statement": case.statement,
        "parameters": {key: {"value": _plain(v), "unit": unit} for key, (v, unit) in case.parameters.items()},
        "results": {key: {"value": _plain(v), "unit": unit} for key, (v, unit) in case.results.items()},
        "accuracy": case.accuracy,
        "basis": case.basis,
        "source": case.source,
        "quantities": [
            {"name": q.name, "columns": list(q.columns), "unit": q.unit, "kind": q.kind, "meaning": q.meaning}
            for q in case.quantities
        ],
        "samples": certain_columns(case),
    }
    return json.dumps(document, indent=1) + "\n"


def _plain(value: Any) -> Any:
    return np.asarray(value).tolist()


def write_reference(case: CheckCase, path: str | Path) -> None:
    """Write a check-case as CSV or JSON, by the suffix, atomically."""
    target = check_target(path, FORMATS)
    write_text(csv_text(case) if target.suffix == ".csv" else json_text(case), target, FORMATS)


def write_errors(comparison: Comparison, path: str | Path) -> None:
    """Write the relative errors of a comparison over time as CSV."""
    columns = comparison.columns()
    heads = ",".join(columns)
    rows = "\n".join(",".join(map(repr, map(float, row))) for row in zip(*columns.values(), strict=True))
    comment = f"# errors against the check-case {comparison.case.name}: relative, or in rad for an attitude"
    write_text(f"{comment}\n{heads}\n{rows}\n", path, (".csv",))
