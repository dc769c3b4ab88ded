"""The states at the end, to some 30 digits: extrapolation in 113 bits, checked against heyoka in 113 bits."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from c_programs import HERE, build

from work_precision.problems import Problem
from work_precision.source_text import c_header

AGREEMENT = 1e-15  # relative, a thousandth of the smallest target
STEPS_PER_RADIAN = 1.0  # the check says whether that is enough


def reference(problem: Problem) -> np.ndarray:
    """Return the final states (states, n), from build/ if the same question was answered before."""
    header = c_header(problem)
    source = (HERE / "c" / "extrapolation.c").read_text()
    confirmed = importlib.util.find_spec("heyoka") is not None
    question = repr((header, source, problem.states.tolist(), problem.span, STEPS_PER_RADIAN, AGREEMENT, confirmed))
    cached = HERE / "build" / f"reference-{hashlib.sha256(question.encode()).hexdigest()[:16]}.json"
    if not cached.exists():
        ends = extrapolated(problem, header, STEPS_PER_RADIAN)
        checks = {"shorter steps": extrapolated(problem, header, 1.5 * STEPS_PER_RADIAN)}
        if confirmed:
            checks["heyoka in 113 bits"] = by_taylor_series(problem)
        else:
            print(f"{problem.name}: heyoka is missing, so that nothing else confirms the reference", file=sys.stderr)
        for name, other in checks.items():
            difference = relative_errors(other, ends).max()
            if not difference < AGREEMENT:
                raise SystemExit(f"{problem.name}: the reference and {name} differ by {difference:.2g}, relative")
        cached.write_text(json.dumps(ends.tolist()))
    return np.array(json.loads(cached.read_text()))


def relative_errors(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Return abs(found - expected) / abs(expected), Euclidean, for each state."""
    return np.linalg.norm(found - expected, axis=-1) / np.linalg.norm(expected, axis=-1)


def extrapolated(problem: Problem, header: str, steps_per_radian: float) -> np.ndarray:
    name = "field_" + "".join(letter if letter.isalnum() else "_" for letter in problem.name)
    included = HERE / "build" / f"{name}.h"
    included.parent.mkdir(exist_ok=True)
    included.write_text(header)
    program = build("extrapolation", f'-DFIELD="{included}"', target=name)
    steps = str(round(steps_per_radian * problem.rate * problem.span))

    def end(x: np.ndarray) -> list[float]:
        command = [str(program), repr(problem.span), steps, *(repr(float(value)) for value in x)]
        printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        return [float(line.split()[0]) for line in printed.splitlines()]

    with ThreadPoolExecutor(2) as threads:
        return np.array(list(threads.map(end, problem.states)))


def by_taylor_series(problem: Problem) -> np.ndarray:
    """Integrate by heyoka in quadruple precision; its field comes from the function, not from the text."""
    import heyoka as hy

    variables = hy.make_vars(*(f"x{i}" for i in range(problem.system.dim)))
    equations = list(zip(variables, problem.field(variables), strict=True))
    start = [hy.real128(float(value)) for value in problem.states[0]]
    taylor = hy.taylor_adaptive(equations, start, fp_type=hy.real128, compact_mode=True, tol=hy.real128(1e-26))
    ends = []
    for x in problem.states:
        taylor.time = hy.real128(0.0)
        taylor.state[:] = [hy.real128(float(value)) for value in x]
        taylor.propagate_until(hy.real128(problem.span))
        ends.append([float(value) for value in taylor.state])
    return np.array(ends)
