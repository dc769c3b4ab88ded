"""Weights of the cost model of steps, fitted to measured steps, and what choices by them lose.

python benchmarks/fit_cost_model.py [--measure] [--rounds R] [--only rigid_body so4 ...]

The regret of a choice is the time of the chosen run over that of the fastest candidate. The weights are fitted to the
ready-made systems; the systems that they have not seen are those of `work_precision`, and energies drawn on algebras.
`--measure` times the steps again (some minutes), otherwise those in build/cost_model.json are used.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from c_programs import HERE
from scipy.optimize import least_squares
from work_precision.further_problems import further_problems
from work_precision.problems import problems

import coadjoint as co
from coadjoint.choosing.accuracy import _fits_with_acceptable_roundoff
from coadjoint.choosing.candidates import supported_candidates
from coadjoint.choosing.fitting import StepFit, confirmed_fit, fit, fit_of_tolerance, target_error
from coadjoint.choosing.pilot import Pilot, short_run
from coadjoint.methods.numerics.tuned_parts import rate_at
from coadjoint.methods.protocol import cost_model
from coadjoint.methods.registry import candidate_schemes
from coadjoint.systems.registry import gallery_entry_of, ready_made_systems

MEASURED = HERE / "build" / "cost_model.json"
ACCURACIES = (1e-3, 1e-6, 1e-10)
MEMBERS = (1, 64)
RADIANS, WIDEST = 100.0, 128
SECONDS, MAX_STEPS, MOST_REPETITIONS = 1e-3, 2**14, 32  # of a timed run
UNIT = 1.1e-8  # seconds of a rotation
LOGARITHM = 0.2  # deviations of the logarithm above it count less
WEIGHTS = (
    "FLOW_COST",
    "MULTIPLICATION_COST",
    "FUNCTION_COST",
    "CALL_COST",
    "VECTOR_COST",
    "ITERATION_COST",
    "ELIMINATION_COST",
    "WAITING_COST",
    "INVARIANT_COST",
    "STEP_CONTROL_COST",
)
LANE_WEIGHTS = {"LANE_FLOW_FACTOR": co.Splitting, "LANE_SERIES_FACTOR": co.Taylor}


class Row(NamedTuple):
    """A measured step: its scheme by the number among the candidates, counts of the trial, and seconds."""

    case: str
    unseen: bool
    members: int
    accuracy: float
    scheme: int
    order: int
    tolerance: float | None
    compensated: bool
    steps: int
    iterations: float
    evaluations: float
    newton: bool
    seconds: float

    @property
    def run(self) -> tuple[str, int, float]:
        """What the scheme is chosen for."""
        return self.case, self.members, self.accuracy


class Case(NamedTuple):
    """A system with the state and the span of its runs; weights are not fitted to those that are `unseen`."""

    name: str
    system: Any
    x0: np.ndarray
    span: float
    unseen: bool


def cases() -> Iterator[Case]:
    for name, make in ready_made_systems().items():
        entry = gallery_entry_of(name)
        if entry is None:
            continue
        system = make(**entry.parameters)
        if system.has_matrices or system.dim > WIDEST:
            continue
        x0 = np.asarray(entry.start() if callable(getattr(entry, "start", None)) else entry.x0, dtype=np.float64)
        x0 = x0.reshape(-1, system.dim)[0]
        yield Case(name, system, x0, RADIANS / rate_at(system, x0), False)
    for name, problem in {**problems(), **further_problems()}.items():
        yield Case(f"wp {name}", problem.system, problem.states[0], min(problem.span, 2e3), True)
    for name, system in drawn_systems().items():
        x0 = np.random.default_rng(system.dim).standard_normal(system.dim) / 2.0
        yield Case(f"drawn {name}", system, x0, RADIANS / rate_at(system, x0), True)


def drawn_systems() -> dict[str, Any]:
    rng = np.random.default_rng(1993)

    def full(n: int) -> np.ndarray:
        draw = rng.standard_normal((n, n))
        return draw @ draw.T / n + 0.5 * np.eye(n)

    def diagonal(n: int) -> np.ndarray:
        return rng.uniform(0.5, 2.0, n)

    def polynomial(n: int, degree: int) -> Any:
        terms = {tuple(2 * (np.arange(n) == i)): float(rng.uniform(0.5, 1.0)) for i in range(n)}
        for _ in range(n):
            powers = np.bincount(rng.integers(0, n, degree), minlength=n)
            terms[tuple(powers.tolist())] = 0.1 * float(rng.uniform(-1.0, 1.0))
        return co.Polynomial(terms)

    a = co.algebras
    energies = {
        "so(4), full": (a.so(4), full),
        "so(6), diagonal": (a.so(6), diagonal),
        "e(3), full": (a.e(3), full),
        "e(4), diagonal": (a.e(4), diagonal),
        "sl(3), diagonal": (a.sl(3), diagonal),
        "su(3), full": (a.su(3), full),
        "gl(2), full": (a.gl(2), full),
        "heisenberg(3), full": (a.heisenberg(3), full),
        "4 spins, full": (a.copies(a.so(3), 4), full),
        "12 spins, diagonal": (a.copies(a.so(3), 12), diagonal),
        "A5_36, full": (a.get("A5_36"), full),
        "so(3), quartic": (a.so(3), lambda n: polynomial(n, 4)),
        "e(3), cubic": (a.e(3), lambda n: polynomial(n, 3)),
        "so(4), quartic": (a.so(4), lambda n: polynomial(n, 4)),
    }
    found = {}
    for name, (algebra, draw) in energies.items():
        energy = draw(algebra.dim)
        energy = energy if isinstance(energy, co.Polynomial) else co.Quadratic(energy)
        found[name] = co.LiePoissonSystem(algebra, energy, name=name)
    return found


def fits_of(case: Case, accuracy: float, members: int) -> Iterator[tuple[int, StepFit]]:
    """Yield every candidate, with its number, and the step that it needs; none is left out for its cost."""
    momenta, schemes = ensemble(case, members), candidate_schemes(True)
    try:
        pilot = Pilot(case.system, momenta[:1], 0.0, case.span, accuracy)
    except ValueError:
        return
    for candidate in supported_candidates(case.system, schemes, momenta, False, strict=False):
        number = schemes.index(candidate.method)
        found = (
            fit_of_tolerance(pilot, candidate, accuracy)
            if candidate.method.own_steps
            else fit(pilot, candidate, target_error(pilot, accuracy), math.inf)
        )
        if found is None:
            continue
        try:
            (found,) = _fits_with_acceptable_roundoff(pilot, [candidate], accuracy, [found])
        except ValueError:
            continue
        found = confirmed_fit(found, accuracy)
        if found.error <= accuracy:
            yield number, found


def ensemble(case: Case, members: int) -> np.ndarray:
    return np.repeat(case.x0[None], members, axis=0)


def seconds_of_step(case: Case, fitted: StepFit, members: int, rounds: int) -> float:
    """Return the least processor time of a step and member, over several runs, without that of the call."""
    method, momenta, h = fitted.candidate.method, ensemble(case, members), case.span / fitted.steps

    def run(steps: float) -> tuple[float, float]:
        """Return the processor time of so many steps, and their number."""
        count = 1 if method.own_steps else math.ceil(steps)
        begun_run = short_run(case.system, method, momenta, 0.0, steps * h, count, 2**53, False)
        begun = time.process_time()
        begun_run.advance()
        seconds = time.process_time() - begun
        if np.any(begun_run.state["status"]):
            return math.nan, count
        own = float(begun_run.state["evaluations"].sum()) / (method.order * members)
        return seconds, own if method.own_steps else count

    steps = 1
    while steps < min(MAX_STEPS, fitted.steps) and run(steps)[0] < SECONDS:
        steps = min(2 * steps, fitted.steps)
    few = 0.5 if method.own_steps else 1
    seconds = run(steps)[0]
    if math.isnan(seconds):
        return seconds
    # Short runs are repeated for as long as others.
    repetitions = rounds * max(1, min(MOST_REPETITIONS, round(SECONDS / max(seconds, 1e-9))))
    (most, taken), (least, others) = (min(run(each) for _ in range(repetitions)) for each in (steps, few))
    return (most - least) / ((taken - others) * members) if taken > others else most / members


def measure(rounds: int, only: Sequence[str]) -> list[Row]:
    """Measure all steps and write them to build/cost_model.json."""
    rows = []
    for case in cases():
        if only and case.name not in only:
            continue
        begun = time.perf_counter()
        for members, accuracy in product(MEMBERS, ACCURACIES):
            for number, found in fits_of(case, accuracy, members):
                method, trial = found.candidate.method, found.trial
                chosen = (number, method.order, getattr(method, "tolerance", None), method.compensates)
                counts = (found.steps, trial.iterations, trial.evaluations, trial.newton)
                seconds = seconds_of_step(case, found, members, rounds)
                if not math.isnan(seconds):
                    rows.append(Row(case.name, case.unseen, members, accuracy, *chosen, *counts, seconds))
        print(f"{case.name}: {time.perf_counter() - begun:.1f} s", file=sys.stderr)
    MEASURED.write_text(json.dumps([row._asdict() for row in rows], indent=0))
    return rows


def method_of(row: Row) -> Any:
    """Return the scheme of a row."""
    method = candidate_schemes(True)[row.scheme]
    if row.tolerance is not None:
        return replace(method, order=row.order, tolerance=row.tolerance)
    return method.with_compensation() if row.compensated and not method.compensates else method


def costs_by(weights: Mapping[str, float], rows: Sequence[Row]) -> np.ndarray:
    """Return the costs of the steps of rows by the model with other weights."""
    systems = {case.name: case.system for case in cases()}
    costs, works = np.empty(len(rows)), dict[Any, Any]()
    kept = {name: getattr(cost_model, name) for name in weights}
    try:
        for name, value in weights.items():
            setattr(cost_model, name, value)
        for k, row in enumerate(rows):
            system, scheme = systems[row.case], (row.case, *row[4:8])
            work = works.get(scheme) or works.setdefault(scheme, method_of(row).work(system))
            costs[k] = work.cost(row.iterations, row.evaluations)
            if row.newton:
                costs[k] += cost_model.newton_work(system.dim, row.evaluations / row.iterations)
            if row.members >= cost_model.MIN_LANE_MEMBERS:
                costs[k] *= work.in_lanes
    finally:
        for name, value in kept.items():
            setattr(cost_model, name, value)
    return costs


def fitted_weights(rows: Sequence[Row]) -> dict[str, float]:
    """Fit all weights to the logarithms of measured costs, mostly of schemes that are nearly the fastest."""
    single = [row for row in rows if row.members == 1]
    columns = np.stack([costs_by({n: float(n == name) for n in WEIGHTS}, single) for name in WEIGHTS], axis=1)
    times, near = np.array([row.seconds / UNIT for row in single]), np.sqrt(relative_speeds(single))
    present = np.log([getattr(cost_model, name) for name in WEIGHTS])
    # The model is linear in these weights, which are positive.
    found = least_squares(
        lambda z: near * np.log((columns @ np.exp(z)) / times), present, loss="soft_l1", f_scale=LOGARITHM
    )
    weights = dict(zip(WEIGHTS, np.exp(found.x).tolist(), strict=True))
    for name, family in LANE_WEIGHTS.items():
        lanes = [
            row for row in rows if row.members > 1 and isinstance(method_of(row), family) and row.tolerance is None
        ]
        ratios = np.log([row.seconds / UNIT for row in lanes]) - np.log(costs_by({**weights, name: 1.0}, lanes))
        weights[name] = float(np.exp(np.average(ratios, weights=relative_speeds(lanes))))
    return weights


def relative_speeds(rows: Sequence[Row]) -> np.ndarray:
    """Return the time of the fastest run of the same case, relative to that of each row."""
    fastest: dict[Any, float] = {}
    for row in rows:
        fastest[row.run] = min(fastest.get(row.run, math.inf), row.seconds * row.steps)
    return np.array([fastest[row.run] / (row.seconds * row.steps) for row in rows])


def regrets(rows: Sequence[Row], weights: Mapping[str, float]) -> dict[Any, float]:
    """Return the time of the chosen run over that of the fastest candidate, for each run."""
    default = [row for row in rows if row.scheme < len(candidate_schemes())]
    cheapest: dict[Any, tuple[float, float]] = {}
    for row, cost, speed in zip(default, costs_by(weights, default), relative_speeds(default), strict=True):
        cheapest[row.run] = min(cheapest.get(row.run, (math.inf, 1.0)), (cost * row.steps, float(1.0 / speed)))
    return {run: regret for run, (_, regret) in cheapest.items()}


def table(rows: Sequence[Row], weights: Mapping[str, float]) -> str:
    """Return the weights, and the regrets of both models by kinds of runs."""
    lines = ["| weight | present | fitted |", "|---|---|---|"]
    lines += [f"| {name} | {getattr(cost_model, name):.3g} | {value:.3g} |" for name, value in weights.items()]
    lines += [
        "",
        "| systems | members | model | runs | median | mean | 90 % | worst |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for unseen, members in product((False, True), MEMBERS):
        chosen = [row for row in rows if row.unseen == unseen and row.members == members]
        for name, model in (("present", {}), ("fitted", weights)):
            found = regrets(chosen, model)
            if not found:
                continue
            values, worst = np.array(list(found.values())), max(found, key=lambda run: found[run])
            kind, mean = "unseen" if unseen else "fitted", np.exp(np.mean(np.log(values)))
            lines.append(
                f"| {kind} | {members} | {name} | {len(values)} | {np.median(values):.3f} | {mean:.3f} | "
                f"{np.quantile(values, 0.9):.2f} | {found[worst]:.2f}, {worst[0]} at {worst[2]:g} |"
            )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="fit the weights of the cost model")
    parser.add_argument("--measure", action="store_true")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", nargs="+", default=[])
    given = parser.parse_args()
    if given.measure or not MEASURED.exists():
        rows = measure(given.rounds, given.only)
    else:
        rows = [Row(**row) for row in json.loads(MEASURED.read_text())]
        rows = [row for row in rows if not given.only or row.case in given.only]
    print(table(rows, fitted_weights([row for row in rows if not row.unseen])))


if __name__ == "__main__":
    main()
