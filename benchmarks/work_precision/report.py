"""The measurements as Markdown: milliseconds to every target, drifts, and set-up."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from measurements import DETAILS

TARGETS = (1e-3, 1e-6, 1e-9, 1e-12)
DRIFTS_AT = 1e-6
OURS = "coadjoint"
STEPPING = "coadjoint, the steps alone"
EXTRAS = {"heyoka": "bench", "diffrax": "bench", "numbalsoda": "bench-fortran", "scipy": "bench"}

Run = dict[str, Any]


def by_solver(runs: Iterable[Run]) -> dict[str, list[Run]]:
    """Sort the runs by solver, and add coadjoint without the time that a call takes whatever its span."""
    found: dict[str, list[Run]] = {}
    for run in runs:
        found.setdefault(run["solver"], []).append(run)
    if OURS in found:
        stepping = [{**run, "cpu": run["cpu"] - run["call"]} for run in found[OURS] if run["cpu"] > run["call"]]
        found = {OURS: found.pop(OURS), STEPPING: stepping, **found}
    return found


def front(runs: Sequence[Run]) -> list[Run]:
    """Return the runs than which none is both faster and more accurate, the fastest first."""
    best: list[Run] = []
    for run in sorted(runs, key=lambda run: run["cpu"]):
        if math.isfinite(run["error"]) and (not best or run["error"] < best[-1]["error"]):
            best.append(run)
    return best


def time_to(target: float, runs: Sequence[Run]) -> float | None:
    """Return the seconds to an error of `target`, between the two runs that bracket it linear in the logarithms."""
    before = None
    for run in front(runs):
        if run["error"] <= target:
            if before is None or run["error"] == 0.0:
                return run["cpu"]
            share = math.log(before["error"] / target) / math.log(before["error"] / run["error"])
            return before["cpu"] * (run["cpu"] / before["cpu"]) ** share
        before = run
    return None


def milliseconds(seconds: float | None) -> str:
    return "—" if seconds is None else f"{1e3 * seconds:.3g}"


def problem_table(name: str, found: dict[str, Any]) -> str:
    """One system: a row for each solver."""
    heads = [f"to {target:.0e}" for target in TARGETS]
    lines = [
        f"**{name}**, {found['dim']} coordinates, t = {found['span']:g}: milliseconds of one trajectory",
        "",
        f"| solver | {' | '.join(heads)} | best error | energy | Casimirs | a call, ms | set-up, s |",
        "|---|" + "---|" * (len(TARGETS) + 5),
    ]
    for solver, runs in by_solver(found["runs"]).items():
        times = [milliseconds(time_to(target, runs)) for target in TARGETS]
        reached = next((run for run in front(runs) if run["error"] <= DRIFTS_AT), None)
        drifts = [f"{reached[which]:.0e}" if reached else "—" for which in ("energy", "casimirs")]
        # compiled once for all settings, or once for each: the largest is what a first answer waits for
        costs = [f"{1e3 * min(run['call'] for run in runs):.2g}", f"{max(run['setup'] for run in runs):.2g}"]
        best = f"{min(run['error'] for run in runs):.0e}"
        lines.append(f"| {' | '.join([solver, *times, best, *drifts, *costs])} |")
    if found["failed"]:
        lines += ["", "Not run to the end: " + "; ".join(found["failed"])]
    return "\n".join(lines)


def best_other(target: float, solvers: dict[str, list[Run]]) -> tuple[float, str] | None:
    times = [(time_to(target, runs), name) for name, runs in solvers.items() if not name.startswith(OURS)]
    return min(((seconds, name) for seconds, name in times if seconds is not None), default=None)


def ratio_table(problems: dict[str, Any], missing: Iterable[str]) -> str:
    """The fastest other solver's time over coadjoint's, for every system and target."""
    without = "".join(f", without {name}" for name in missing)
    lines = [
        f"Time of the fastest other solver{without} over that of coadjoint (in brackets: the steps alone)",
        "",
        f"| system | {' | '.join(f'{target:.0e}' for target in TARGETS)} |",
        "|---|" + "---|" * len(TARGETS),
    ]
    for name, found in problems.items():
        solvers = by_solver(found["runs"])
        cells = []
        for target in TARGETS:
            ours, stepping = (time_to(target, solvers[which]) for which in (OURS, STEPPING))
            other = best_other(target, solvers)
            if ours is None or stepping is None:
                cells.append("coadjoint does not reach it" if other else "nobody reaches it")
            elif other is None:
                cells.append("only coadjoint")
            else:
                cells.append(f"{other[0] / ours:.2g} ({other[0] / stepping:.2g}) {other[1]}")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def tables(measured: dict[str, Any]) -> str:
    """Everything, with what is missing first."""
    versions = ", ".join(f"{name} {version}" for name, version in measured["versions"].items())
    parts = [f"Measured in turns, medians of {measured['rounds']}, CPU time, one thread: {versions}."]
    parts += [
        f"**Missing: {name}** ({reason}); `pip install 'coadjoint[{EXTRAS[name]}]'`"
        for name, reason in measured["missing"].items()
    ]
    parts.append(ratio_table(measured["problems"], measured["missing"]))
    parts.append(DETAILS)
    parts += [problem_table(name, found) for name, found in measured["problems"].items()]
    return "\n\n".join(parts)
