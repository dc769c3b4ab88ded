"""Reproduction of S. Reich, Numerical integration of the generalized Euler equations (1993): figures and statements."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

from coadjoint.errors import LargeStepWarning
from coadjoint.experiments.reich1993 import section3, section5, sections2_and_4, sections6_and_7
from coadjoint.experiments.reich1993.figures import write_figures, write_long_time, write_modified_energies
from coadjoint.experiments.reich1993.statements import Statement, markdown, write_csv
from coadjoint.optional_packages import require_packages
from coadjoint.short_repr import short

LARGE_STEPS = """
The steps are those of the paper, and of fits of orders. Those of some runs are too large to follow the motion, which is
part of what the experiments show:

"""


def reproduce(
    out: str | Path,
    echo: Callable[[str], None] = print,
    *,
    phase_end: float = 500.0,
    steps: int = 1_000_000,
) -> tuple[list[Statement], list[Path]]:
    """Repeat the experiments of the paper; return a row for each of its statements, and the paths of its figures.

    Writes figure1.png ... figure5.png, modified_energies.png, long_time.png, table.md (which lists steps too large on
    purpose, in place of warnings) and table.csv to `out`. `phase_end`: a whole number, at least 50; `steps`: a multiple
    of 10,000, for the drift of invariants. `echo` is called with a line at the start of each section.
    """
    if phase_end < 50.0 or phase_end != int(phase_end):
        raise ValueError(f"phase_end is {short(phase_end)}; it must be a whole number from 50 up")
    if steps < 10_000 or steps % 10_000:
        raise ValueError(f"steps is {short(steps)}; it must be a positive multiple of 10,000")
    check_packages()
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", LargeStepWarning)
        rows, figures = _experiments(folder, echo, phase_end, steps)
    large_steps = []
    for warning in caught:
        if issubclass(warning.category, LargeStepWarning):
            large_steps.append(str(warning.message).partition(", though")[0])
        else:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    (folder / "table.md").write_text(_report(rows, list(dict.fromkeys(large_steps))), encoding="utf-8")
    write_csv(rows, folder / "table.csv")
    return rows, figures


def _experiments(
    folder: Path, echo: Callable[[str], None], phase_end: float, steps: int
) -> tuple[list[Statement], list[Path]]:
    rows = measured_statements(echo, phase_end)
    echo("figures 1 to 5, and one of section 6")
    figures = write_figures(folder)
    figures.append(write_modified_energies(folder))
    echo(f"long times: phase to t = {phase_end:g}, invariants over {steps} steps")
    figures.append(write_long_time(folder, phase_end, steps))
    return rows, figures


def check_packages() -> None:
    """Raise an error if packages for compiling functions or plotting are missing."""
    require_packages("repeating the experiments", "numba", "matplotlib")


def measured_statements(echo: Callable[[str], None] = print, phase_end: float = 500.0) -> list[Statement]:
    """Return a measured row for every testable statement of the paper, in its order; `echo` prints a line a section."""
    parts: list[tuple[str, Callable[[], list[Statement]]]] = [
        ("section 2: invariants of the exact motion", sections2_and_4.section2_statements),
        ("section 3: orders of Gauss and modified Gauss methods", section3.order_statements),
        ("section 3: orthogonality", section3.orthogonality_statements),
        ("section 4: splitting", sections2_and_4.section4_statements),
        ("section 5.1: A3,7", section5.spiral_statements),
        ("section 5.2: rigid body", lambda: section5.body_statements(phase_end)),
        ("section 6: backward error analysis", sections6_and_7.section6_statements),
        ("section 7: generalizations", sections6_and_7.section7_statements),
    ]
    rows = []
    for title, statements in parts:
        echo(title)
        rows += statements()
    return rows


def _report(rows: list[Statement], large_steps: list[str]) -> str:
    """Return the table with its heading, and the runs whose steps are too large."""
    verdicts = [row.verdict for row in rows]
    counts = ", ".join(f"{verdicts.count(verdict)} {verdict}" for verdict in dict.fromkeys(verdicts))
    return (
        "# S. Reich, Numerical integration of the generalized Euler equations (1993): the statements, tested\n\n"
        f"{len(rows)} statements: {counts}. Every number was measured in the run that wrote this table; "
        "u = 2^-53. Figures 1 to 5 are the paper's, drawn anew; modified_energies.png and long_time.png are added.\n\n"
        "Set here, because the paper does not print it: for A3,7 x(0) = (1, 1, 1) and t in [0, 20]; for the "
        "rigid body t in [0, 5] and "
        "[0, 50]. The paper's sign, x' = J(x) M x, is used throughout; M is the inverse inertia.\n\n"
        f"{markdown(rows)}\n" + (LARGE_STEPS + "".join(f"- {text}\n" for text in large_steps) if large_steps else "")
    )
