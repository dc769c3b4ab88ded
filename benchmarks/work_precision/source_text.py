"""The right-hand side as source text, lines that are C and Python at once: every solver gets the same formula."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from work_precision.problems import Problem


class Written:
    """A number that remembers how it came about."""

    def __init__(self, text: str, *parts: Written) -> None:
        self.text = text  # with {} for each part
        self.parts = parts

    def __add__(self, other: Written) -> Written:
        return Written("({} + {})", self, other)

    def __sub__(self, other: Written) -> Written:
        return Written("({} - {})", self, other)

    def __mul__(self, other: Written) -> Written:
        return Written("{} * {}", self, other)

    def __rmul__(self, factor: float) -> Written:
        return Written(f"({float(factor)!r} * {{}})", self)


def lines(problem: Problem, declare: str = "") -> list[str]:
    """Return "dx[i] = ..." in terms of x[j], after "u0 = ..." for every value that is used more than once."""
    n = problem.system.dim
    moved = problem.field([Written(f"x[{j}]") for j in range(n)])
    uses: Counter[Written] = Counter()

    def count(value: Written) -> None:
        uses[value] += 1
        if uses[value] == 1:
            for part in value.parts:
                count(part)

    for value in moved:
        count(value)
    written: list[str] = []
    names: dict[Written, str] = {}

    def text(value: Written) -> str:
        if value in names:
            return names[value]
        whole = value.text.format(*(text(part) for part in value.parts))
        if value.parts and uses[value] > 1:
            names[value] = f"u{len(names)}"
            written.append(f"{declare}{names[value]} = {whole}")
            return names[value]
        return whole

    for i, value in enumerate(moved):
        written.append(f"dx[{i}] = {text(value)}")
    return written


def python_function(problem: Problem, arguments: str, first: str = "pass", last: str = "pass") -> Any:
    """Return the function field(arguments) that runs the line `first`, sets dx, and runs the line `last`."""
    body = [first, *lines(problem), last]
    space: dict[str, Any] = {"np": np}
    exec(f"def field({arguments}):\n" + "".join(f"    {line}\n" for line in body), space)
    return space["field"]


def c_header(problem: Problem) -> str:
    """Return the macros N and FIELD_BODY for c/extrapolation.c."""
    body = " ".join(f"{line};" for line in lines(problem, declare="real "))
    return f"#define N {problem.system.dim}\n#define FIELD_BODY {body}\n"
