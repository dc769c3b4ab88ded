"""The page on Reich (1993): the figures, drawn by `coadjoint reproduce`, and what of its statements holds."""

from __future__ import annotations

import csv
import warnings
from pathlib import Path

from coadjoint.errors import LargeStepWarning
from coadjoint.experiments.reich1993 import reproduce

FIGURES = {
    "figure1": ("Figure 1", "Drift of the splitting on A3,7: energy dotted, Casimir solid."),
    "figure2": ("Figure 2", "Drift of the modified midpoint rule on A3,7: energy dotted, Casimir solid."),
    "figure3": ("Figure 3", "Attitude of the rigid body by Runge's method of order 2, and the exact one, dotted."),
    "figure4": ("Figure 4", "Attitude by the modified midpoint rule, and the exact one, dotted."),
    "figure5": ("Figure 5", "Attitude by the splitting, and the exact one, dotted."),
    "modified_energies": (
        "Added to section 6",
        "Modified Hamiltonians of increasing order along runs of the splitting.",
    ),
    "long_time": ("Added to section 5.2", "Phase errors, and the drift of energy and Casimir, over long times."),
}
"""Title and caption of each figure, by the name of its file."""
VERDICTS = {"does not hold": "do not hold", "holds with a limit": "hold with a limit", "holds": "hold"}
"""Verdicts, and their plurals."""


def paper_page(folder: Path, library: float) -> str:
    """Return the page; the experiments run again if their table is older than the library."""
    table = folder / "table.csv"
    if not table.exists() or table.stat().st_mtime < library:
        with warnings.catch_warnings():
            # The paper's steps are as large as that.
            warnings.simplefilter("ignore", LargeStepWarning)
            reproduce(folder, echo=lambda line: None)
    with table.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    counts = ", ".join(
        f"{sum(row['verdict'] == verdict for row in rows)} {plural}" for verdict, plural in VERDICTS.items()
    )
    lines = [
        "# The paper, figure by figure\n",
        "S. Reich, *Numerical integration of the generalized Euler equations*, 1993, is the source of this library. "
        "This page draws its figures anew and tests its statements. Every number was measured when the page was "
        "built, as by `coadjoint reproduce`.\n",
        f"Of {len(rows)} statements: {counts}.\n",
        "## Figures\n",
    ]
    for name, (title, caption) in FIGURES.items():
        lines.append(f"### {title}\n\n:::{{figure}} paper/{name}.png\n:alt: {caption}\n\n{caption}\n:::\n")
        number = title.rpartition(" ")[2] if name.startswith("figure") else ""
        for row in rows:
            if number and "figure" in row["place"] and number in row["place"].partition("figure")[2]:
                statement = row["statement"][:1].upper() + row["statement"][1:]
                lines.append(
                    f"{_text(statement)}; in the paper: {_text(row['paper'])}. "
                    f"**{row['verdict'].capitalize()}**: {_text(row['measured'])}.\n"
                )
    for verdict in VERDICTS:
        lines.append(f"## What {verdict}\n")
        lines.append("| place | statement, and what the paper says | criterion | measured |\n|---|---|---|---|")
        lines += [
            f"| {_text(row['place'])} | {_text(row['statement'])}: {_text(row['paper'])} | {_text(row['criterion'])} "
            f"| {_text(row['measured'])} |"
            for row in rows
            if row["verdict"] == verdict
        ]
        lines.append("")
    lines.append("Next: [User-defined systems, Hamiltonians and forces](extending.md).")
    return "\n".join(lines) + "\n"


def _text(cell: str) -> str:
    r"""Return plain text as Markdown.

    Examples
    --------
    >>> _text("|x|^2 * <y>")
    '\\|x\\|^2 \\* \\<y>'
    """
    for character in "\\|*_<[$":
        cell = cell.replace(character, f"\\{character}")
    return " ".join(cell.split())
