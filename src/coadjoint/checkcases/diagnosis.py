"""What a difference looks like: known mistakes are undone, or made in the reference, until little of it is left.

Each candidate returns corrected samples, or another reference, such as the motion of the body by another law, and is
ranked by the sum of the logarithms of the errors of all quantities. The best one that divides the errors by
`LEAST_FACTOR` in total is reported, and the search repeats on what it leaves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import permutations, product
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from coadjoint.checkcases.altered_motions import (
    LEAST_ROWS,
    MOTION_ACCURACY,
    FittedNumber,
    Law,
    alterations,
    fitted_numbers,
    law_of,
    motions,
)
from coadjoint.checkcases.attitudes import rotations_of, stacked
from coadjoint.checkcases.check_case import RATES, CheckCase, Columns, DerivedQuantity, Quantity
from coadjoint.checkcases.emulated_schemes import emulated_runs

Floats = npt.NDArray[np.float64]
Table = Mapping[str, Floats]

LEAST_FACTOR = 8.0
"""Division of the errors that makes a mistake likely; parameters that are fitted to a wrong model gain two or three."""
SIMPLER = 3.0  # an earlier, simpler candidate is preferred to one whose errors are smaller by less than this
MAX_FINDINGS = 4
MAX_ROWS = 400  # samples that are looked at
GRID = 161  # trial offsets of the time and trial clock rates
WIDEST_OFFSET = 0.05  # of the span, and at least five samples
WIDEST_RATE = 0.05  # relative change of the clock
DENSE = 2000  # points of the interpolated reference
LEAST_SAMPLES = 4  # for other axes, which are fitted
FIT_ITERATIONS = 5  # of the rate of axes that turn
# Of the samples, to which numbers of a law are fitted one after the other.
FIT_SHARES = 1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0
FIT_ROWS = 6
FIT_STEPS = 3  # of Gauss and Newton, for each share
FIT_DIFFERENCE = 1e-6
FIT_LEAST, FIT_GAIN = 0.2, 0.5  # share of the samples from which on the errors must be smaller by this factor
FASTEST_START = 10.0  # of another start, relative to the rates of the case
STEADY = 0.9  # share of the variance of an invariant that a straight line explains, if it grows steadily


class Explanation(NamedTuple):
    """A mistake: its sentence, the samples without it, or the reference with it, on some rows."""

    sentence: str
    table: Table
    reference: Table
    rows: Any = slice(None)
    kind: str = ""  # of motions by another law: those of other kinds with the same motion are named with it

    def least(self, tolerance: float) -> float:
        """Return the error below which nothing is left to explain."""
        return max(tolerance, MOTION_ACCURACY) if self.kind else tolerance


class Problem(NamedTuple):
    """Samples and the reference at their times, which candidates see."""

    case: CheckCase
    table: Table
    reference: Table
    quantities: tuple[Quantity, ...]
    tolerance: float
    step: float | None

    def errors(self, table: Table, reference: Table, rows: Any = slice(None)) -> dict[str, float]:
        """Return root-mean-square errors of quantities, relative or in radians."""
        found = self.differences(table, reference, rows)
        return {name: float(np.sqrt(np.mean(np.sum(each**2, axis=1)))) for name, each in found.items()}

    def residuals(self, table: Table, reference: Table) -> Floats:
        """Return all differences of the rows of a reference, as one vector."""
        rows = slice(0, len(next(iter(reference.values()))))
        return np.concatenate([each.ravel() for each in self.differences(table, reference, rows).values()])

    def differences(self, table: Table, reference: Table, rows: Any) -> dict[str, Floats]:
        """Return the differences of quantities, relative to their sizes, or as rotation vectors, (k, n)."""
        found = {}
        for quantity in self.quantities:
            names = quantity.columns
            if quantity.kind == "attitude":
                between = rotations_of(table, names)[rows].inv() * rotations_of(reference, names)[rows]
                found[quantity.name] = np.asarray(between.as_rotvec())
            else:
                size = np.linalg.norm(stacked(self.reference, names), axis=1).max() or 1.0
                found[quantity.name] = (stacked(table, names)[rows] - stacked(reference, names)[rows]) / size
        return found

    def score(self, table: Table, reference: Table, rows: Any = slice(None)) -> float:
        """Return the sum of the logarithms of the errors; those far below the tolerance count alike."""
        # Errors above the size of the motion count alike too: smaller samples are not nearer to it.
        floor = max(0.01 * self.tolerance, self.case.accuracy)
        total = 0.0
        for name, error in self.errors(table, reference, rows).items():
            total += math.log(min(error, self.sizes[name]) + floor)
        return total

    @property
    def sizes(self) -> dict[str, float]:
        """Root-mean-square sizes of quantities, relative to the largest, and one radian for attitudes."""
        found = {}
        for quantity in self.quantities:
            lengths = np.linalg.norm(stacked(self.reference, quantity.columns), axis=1)
            largest = float(lengths.max()) or 1.0
            is_attitude = quantity.kind == "attitude"
            found[quantity.name] = 1.0 if is_attitude else float(np.sqrt(np.mean(lengths**2))) / largest
        return found


def diagnose(
    case: CheckCase,
    table: Table,
    reference: Table,
    quantities: tuple[Quantity, ...],
    tolerance: float,
    step: float | None,
) -> tuple[list[str], bool]:
    """Return what a difference beyond the tolerance looks like, as sentences, and whether a known mistake is in it."""
    rows = np.unique(np.linspace(0, len(table["t"]) - 1, MAX_ROWS).round().astype(int))
    problem = Problem(
        case,
        {name: values[rows] for name, values in table.items()},
        {name: values[rows] for name, values in reference.items()},
        quantities,
        tolerance,
        step,
    )
    kept = _kept_invariants(problem)
    found = _explained(Findings((), problem, tolerance), CANDIDATES)
    if not found.is_complete:
        for quantity in quantities if len(quantities) > 1 else ():
            # A law that is wrong hides other mistakes, unless it is found from a quantity that has none of them.
            alone = _explained(Findings((), problem._replace(quantities=(quantity,)), tolerance), LAWS)
            if alone.mistakes and alone.is_complete:
                whole = alone._replace(problem=alone.problem._replace(quantities=quantities))
                whole = _explained(whole, CANDIDATES)
                if whole.is_complete:
                    found = whole
                    break
                if not found.mistakes:
                    limited = [
                        each._replace(sentence=f"{each.sentence}; this explains the {quantity.name} alone")
                        for each in alone.mistakes
                    ]
                    found = Findings(tuple(limited), problem, tolerance)
    findings = [each.sentence for each in found.mistakes]
    if not found.is_complete:
        findings += _steady_changes(found.problem, kept)
    return findings, bool(found.mistakes)


class Findings(NamedTuple):
    """Mistakes that were found, the problem without them, and the error below which nothing is left to explain."""

    mistakes: tuple[Explanation, ...]
    problem: Problem
    least: float

    @property
    def is_complete(self) -> bool:
        """Whether nothing is left to explain."""
        return max(self.problem.errors(self.problem.table, self.problem.reference).values()) <= self.least


def _explained(findings: Findings, kinds: Sequence[Candidates]) -> Findings:
    """Return findings with further mistakes of some kinds, until nothing is left or none is likely."""
    for _ in range(MAX_FINDINGS):
        found = None if findings.is_complete else _best(findings.problem, kinds)
        if found is None:
            break
        # A motion by another law takes the place of an earlier one, which was not the cause.
        earlier = [each for each in findings.mistakes if not (each.kind and found.kind)]
        rows = found.rows
        problem = findings.problem._replace(
            table={name: np.asarray(values)[rows] for name, values in found.table.items()},
            reference={name: np.asarray(values)[rows] for name, values in found.reference.items()},
        )
        findings = Findings((*earlier, found), problem, found.least(findings.least))
    return findings


def _best(problem: Problem, kinds: Sequence[Candidates]) -> Explanation | None:
    """Return the simplest of the most likely mistakes; None if none divides the errors enough."""
    trials: list[tuple[float, Explanation, bool]] = []
    for candidates in kinds:
        if any(explained for _, _, explained in trials):
            break  # later kinds are less simple, and take longer
        for trial in candidates(problem):
            before = problem.score(problem.table, problem.reference, trial.rows)
            gain = before - problem.score(trial.table, trial.reference, trial.rows)
            if math.isfinite(gain) and gain > 0.0:
                left = problem.errors(trial.table, trial.reference, trial.rows)
                trials.append((gain, trial, max(left.values()) <= trial.least(problem.tolerance)))
    best = max((gain for gain, _, _ in trials), default=0.0)
    if best < math.log(LEAST_FACTOR):
        return None
    likely = max(best - math.log(SIMPLER), math.log(LEAST_FACTOR))
    found = next(trial for gain, trial, _ in trials if gain >= likely)
    return _with_same_motions(problem, found, [trial for gain, trial, _ in trials if gain >= likely])


def _with_same_motions(problem: Problem, found: Explanation, others: Sequence[Explanation]) -> Explanation:
    """Add mistakes of other kinds that have the same motion, which the samples cannot tell apart."""
    kinds, sentences = {found.kind}, [found.sentence]
    for each in others if found.kind else ():
        if not each.kind or each.kind in kinds or each.rows != found.rows:
            continue
        apart = problem.errors(found.reference, each.reference)
        if max(apart.values()) <= max(problem.tolerance, 10.0 * MOTION_ACCURACY):
            kinds.add(each.kind)
            sentences.append(each.sentence)
    if len(sentences) == 1:
        return found
    return found._replace(sentence=f"{', or '.join(sentences)} (these motions are the same)")


def _pairs(problem: Problem) -> Iterator[tuple[Quantity, Quantity | None, str]]:
    """Yield the quantities of rates with the attitude of the same body in the case, and a label of the body."""
    attitudes = {quantity.name: quantity for quantity in problem.case.quantities if quantity.kind == "attitude"}
    for quantity in problem.quantities:
        if quantity.name.startswith("rates"):
            suffix = quantity.name.removeprefix("rates")
            yield quantity, attitudes.get(f"attitude{suffix}"), f" of body{suffix}" if suffix else ""


def _with(table: Table, names: tuple[str, ...], values: Floats) -> Table:
    return {**table, **dict(zip(names, values.T, strict=True))}


FACTORS = (
    ("in degrees per second", math.pi / 180),
    ("in revolutions per minute", math.pi / 30),
    ("in revolutions per second", 2 * math.pi),
    ("of the opposite sign", -1.0),
)


def _rates(problem: Problem) -> Iterator[Explanation]:
    """Yield units, sign, frame and order of the rates."""
    for rates, attitude, of in _pairs(problem):
        w = stacked(problem.table, rates.columns)
        variants: list[tuple[str, Any]] = [(what, factor * w) for what, factor in FACTORS]
        if attitude is not None:
            turned = rotations_of(problem.reference, attitude.columns)
            variants.append(("along the axes of space, not of the body", turned.inv().apply(w)))
            variants.append(("turned from the body to space once more", turned.apply(w)))
            degrees = math.pi / 180 * w
            variants.append(("along the axes of space, and in degrees per second", turned.inv().apply(degrees)))
        if problem.case.body is not None and not of:
            tensor = problem.case.body.inertia
            if np.linalg.matrix_rank(tensor) == 3:
                variants.append(("angular momenta in the body frame", np.linalg.solve(tensor, w.T).T))
            orbit = problem.case.body.orbital_frame
            if orbit is not None and attitude is not None:
                turning = np.zeros_like(w)
                turning[:, 2] = orbit(problem.reference["t"])[1]
                variants.append(
                    ("relative to the orbital frame, not to inertial space", w + turned.inv().apply(turning))
                )
        for what, values in variants:
            yield Explanation(
                f"the rates{of} are {what}", _with(problem.table, rates.columns, values), problem.reference
            )
        for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
            if order == (0, 1, 2) and len(set(signs)) == 1:
                continue
            names = ", ".join(f"{'' if s > 0 else '-'}{rates.columns[k]}" for k, s in zip(order, signs, strict=True))
            values = np.empty_like(w)
            values[:, list(order)] = w * np.array(signs)
            sentence = f"the axes of the rates{of} are exchanged: {', '.join(rates.columns)} hold {names}"
            yield Explanation(sentence, _with(problem.table, rates.columns, values), problem.reference)


def _quaternions(problem: Problem) -> Iterator[Explanation]:
    """Yield conventions of quaternions: order, conjugation, and other axes of space or body."""
    conjugate = np.array([1.0, -1.0, -1.0, -1.0])
    inverse = "it is the rotation from space to the body"
    for quantity in problem.quantities:
        if quantity.kind != "attitude":
            continue
        suffix = quantity.name.removeprefix("attitude")
        of = f" of body{suffix}" if suffix else ""
        q = stacked(problem.table, quantity.columns)
        first, last = np.roll(q, 1, axis=1), np.roll(q, -1, axis=1)
        scalar_last = "has its scalar last: the columns hold x, y, z, w"
        variants = [
            (f"is conjugated: {inverse}", q * conjugate),
            (scalar_last, first),
            ("has its scalar in qx: the columns hold z, w, x, y", last),
            (f"{scalar_last}; and it is conjugated: {inverse}", first * conjugate),
        ]
        for what, values in variants:
            table = _with(problem.table, quantity.columns, values)
            yield Explanation(f"the quaternion{of} {what}", table, problem.reference)
        orbit = None if problem.case.body is None or of else problem.case.body.orbital_frame
        if orbit is not None:
            phase = orbit(problem.reference["t"])[0]
            turned = Rotation.from_rotvec(phase[:, None] * [0.0, 0.0, 1.0]) * rotations_of(problem.table)
            table = _with(problem.table, quantity.columns, np.roll(turned.as_quat(), 1, axis=1))
            yield Explanation("the attitude is relative to the orbital frame, not to space", table, problem.reference)
        if len(q) < LEAST_SAMPLES:
            continue
        mine, certain = (rotations_of(each, quantity.columns) for each in (problem.table, problem.reference))
        for what, convention in (("", mine), (f", and conjugated: {inverse}", mine.inv())):
            space, body = certain[0] * convention[0].inv(), convention[0].inv() * certain[0]
            for axes, constant, turned in (("space", space, space * convention), ("body", body, convention * body)):
                table = _with(problem.table, quantity.columns, np.roll(turned.as_quat(), 1, axis=1))
                angle = math.degrees(float(constant.magnitude()))
                sentence = f"the attitude{of} is relative to other axes of {axes}, turned by {angle:.6g} degrees{what}"
                yield Explanation(sentence, table, problem.reference)


def _altered(problem: Problem) -> Iterator[Explanation]:
    """Yield the motions of a body by the laws of common mistakes."""
    body = problem.case.body
    if body is not None:
        tried = tuple(alterations(body))
        columns = _motions(problem, [each.law for each in tried])
        for each, motion in zip(tried, columns, strict=True):
            yield from _moved(problem, each.kind, each.sentence, motion)


def _motions(problem: Problem, laws: Sequence[Law]) -> list[Columns]:
    """Return the motions by several laws at the times of the samples, as far as they are reached."""
    body = problem.case.body
    assert body is not None
    size = float(np.linalg.norm(stacked(problem.reference, RATES.columns), axis=1).max())
    return motions(body, laws, problem.reference["t"], size)


def _moved(problem: Problem, kind: str, sentence: str, motion: Columns) -> Iterator[Explanation]:
    """Yield a motion in place of the reference, on the rows that it has."""
    reached = len(motion[RATES.columns[0]])
    if reached >= min(LEAST_ROWS, len(problem.reference["t"])):
        reference = {"t": problem.reference["t"][:reached], **motion}
        yield Explanation(sentence, problem.table, reference, slice(0, reached), kind)


def _other_numbers(problem: Problem) -> Iterator[Explanation]:
    """Yield the motions of a body with another number of its law, or another start, fitted one at a time."""
    body = problem.case.body
    if body is None:
        return
    t = problem.reference["t"]
    fitted = fit_numbers(problem, list(fitted_numbers(body)))
    laws = [(each.kind, each.sentence(factor), each.law(factor)) for each, factor in fitted]
    if t[0] == 0.0 and any(quantity.name == RATES.name for quantity in problem.quantities):
        rates = stacked(problem.table, RATES.columns)[0]
        fastest = float(np.linalg.norm(stacked(problem.reference, RATES.columns), axis=1).max())
        given, wanted = (", ".join(f"{float(v):.6g}" for v in each) for each in (rates, body.rates))
        sentence = f"the rates at the start are ({given}), not ({wanted}) rad/s"
        if np.linalg.norm(rates) <= FASTEST_START * fastest:
            laws.append(("start", sentence, law_of(body)._replace(rates=rates)))
    if laws:
        columns = _motions(problem, [law for _, _, law in laws])
        for (kind, sentence, _), motion in zip(laws, columns, strict=True):
            yield from _moved(problem, kind, sentence, motion)


def fit_numbers(problem: Problem, numbers: Sequence[FittedNumber]) -> list[tuple[FittedNumber, float]]:
    """Return numbers and the factors with the least errors, without those that leave their bounds or gain nothing.

    Gauss-Newton steps of each number alone, on samples up to longer and longer times, since errors of the phase have
    other minima beyond a revolution.
    """
    t, factors = problem.reference["t"], {k: 1.0 for k in range(len(numbers))}
    ends = [int(np.searchsorted(t, t[-1] * share, side="right")) for share in FIT_SHARES]
    for until in (each for each in ends if each >= FIT_ROWS or each == len(t)):
        early = problem._replace(
            table={name: values[:until] for name, values in problem.table.items()},
            reference={name: values[:until] for name, values in problem.reference.items()},
        )
        size = float(np.linalg.norm(early.residuals(early.table, early.reference)))
        for step in range(FIT_STEPS):
            laws = [numbers[k].law(f + change) for k, f in factors.items() for change in (0.0, FIT_DIFFERENCE)]
            if not laws:
                return []
            columns = _motions(early, laws)
            reached = len(columns[0][RATES.columns[0]])
            if reached < LEAST_ROWS:
                return []
            for j, k in enumerate(tuple(factors)):
                near, far = (early.residuals(early.table, columns[2 * j + i]) for i in (0, 1))
                slope = (far - near) / FIT_DIFFERENCE
                square = float(slope @ slope)
                factor = factors[k] - float(slope @ near) / square if square else math.nan
                low, high = numbers[k].bounds
                is_better = step == 0 or until < FIT_LEAST * len(t) or float(np.linalg.norm(near)) < FIT_GAIN * size
                if low <= factor <= high and is_better:
                    factors[k] = factor
                else:
                    del factors[k]
        if reached < until:
            break  # further samples are too expensive
    return [(numbers[k], factor) for k, factor in factors.items()]


def _clocks(problem: Problem) -> Iterator[Explanation]:
    """Yield offsets of the time and clocks of another rate, of all quantities, and of each alone."""
    dense = _interpolated(problem.case, problem.quantities)
    t = problem.table["t"]
    widest = max(WIDEST_OFFSET * problem.case.end, 5.0 * float(np.median(np.diff(t))))
    groups = [problem.quantities, *([quantity] for quantity in problem.quantities if len(problem.quantities) > 1)]
    for group in groups:
        names = "the samples are" if len(group) == len(problem.quantities) else f"those of the {group[0].name} are"
        offset = dense.fit(problem, group, lambda value: t + value, lambda value: np.ones_like(t), widest)
        if offset is not None:
            value, trial = offset
            steps = _in_steps(value, problem.step)
            yield Explanation(f"{names} of other times: sample t is the motion at t {value:+.6g} s{steps}", *trial)
        rate = dense.fit(problem, group, lambda value: (1.0 + value) * t, lambda value: t, WIDEST_RATE)
        if rate is not None:
            value, trial = rate
            yield Explanation(f"{names} of a motion {1.0 + value:.9g} times as fast", *trial)


def _in_steps(offset: float, step: float | None) -> str:
    """Return an offset in steps, if it is a multiple of a half."""
    if step is None:
        return ""
    halves = round(2.0 * abs(offset) / step)
    is_multiple = halves > 0 and abs(2.0 * abs(offset) / step - halves) < 0.02
    return f", {halves / 2:g} steps {'later' if offset > 0 else 'earlier'}" if is_multiple else ""


class _Interpolated:
    """Cubic splines of a reference, by which parameters of the time are searched before the reference is evaluated."""

    def __init__(self, case: CheckCase, quantities: tuple[Quantity, ...]) -> None:
        from scipy.interpolate import CubicSpline

        self.end = case.end
        times = np.linspace(0.0, case.end, max(DENSE, 4 * len(case.times)))
        columns = case.reference(times)
        self.splines: dict[str, Any] = {}
        for quantity in quantities:
            values = stacked(columns, quantity.columns)
            if quantity.kind == "attitude":
                values = _continuous(values)
            self.splines[quantity.name] = CubicSpline(times, values)

    def fit(
        self,
        problem: Problem,
        group: Any,
        times: Callable[[float], Floats],
        slope: Callable[[float], Floats],
        widest: float,
    ) -> tuple[float, tuple[Table, Table, Any]] | None:
        """Return the parameter of the time with the least errors, and the reference there; None at the ends."""
        sizes = {q.name: float(np.abs(self.splines[q.name].c[3]).max()) or 1.0 for q in group}
        samples = {q.name: stacked(problem.table, q.columns) for q in group}

        started = problem.table["t"] > 0.0  # the start is often written before the loop, at its own time

        def residual(value: float) -> tuple[Floats, Floats]:
            moved = times(value)
            inside = (moved >= 0.0) & (moved <= self.end) & started
            parts, slopes = [], []
            for quantity in group:
                spline, wanted = self.splines[quantity.name], samples[quantity.name]
                there = spline(np.clip(moved, 0.0, self.end))
                if quantity.kind == "attitude":
                    sign = np.sign(np.sum(there * wanted, axis=1, keepdims=True))
                    wanted = np.where(sign == 0.0, 1.0, sign) * wanted
                size = sizes[quantity.name]
                rate = spline(np.clip(moved, 0.0, self.end), 1) * slope(value)[:, None]
                parts.append(((wanted - there) / size)[inside].ravel())
                slopes.append((rate / size)[inside].ravel())
            return np.concatenate(parts), np.concatenate(slopes)

        grid = np.linspace(-widest, widest, GRID)
        costs = []
        for value in grid:
            r, _ = residual(value)
            costs.append(float(np.mean(r**2)) if r.size else math.inf)
        k = int(np.argmin(costs))
        value = float(grid[k])
        for _ in range(30):
            r, s = residual(value)
            square = float(s @ s)
            if not square:
                return None
            change = float(s @ r) / square
            value += change
            if abs(value) > widest:
                return None
            if abs(change) <= 1e-15 * widest:
                break
        moved = times(value)
        rows = np.flatnonzero((moved >= 0.0) & (moved <= self.end) & started)
        if len(rows) < max(2, len(moved) // 2) or value == 0.0:
            return None
        there = problem.case.reference(np.clip(moved, 0.0, self.end))
        columns = {name for quantity in group for name in quantity.columns}
        reference = {name: there[name] if name in columns else values for name, values in problem.reference.items()}
        return value, (problem.table, reference, rows)


@lru_cache(maxsize=2)
def _interpolated(case: CheckCase, quantities: tuple[Quantity, ...]) -> _Interpolated:
    return _Interpolated(case, quantities)


def _continuous(q: Floats) -> Floats:
    """Return quaternions whose signs change the least from one to the next."""
    signs = np.sign(np.sum(q[1:] * q[:-1], axis=1))
    return q * np.cumprod(np.concatenate([[1.0], np.where(signs == 0.0, 1.0, signs)]))[:, None]


def _precession(problem: Problem) -> Iterator[Explanation]:
    """Yield an attitude that turns about the angular momentum at another rate."""
    body, names = problem.case.body, {quantity.name for quantity in problem.quantities}
    if body is None or body.torque is not None or "attitude" not in names:
        return
    t, certain, mine = problem.reference["t"], rotations_of(problem.reference), rotations_of(problem.table)
    momentum = certain.apply(stacked(problem.reference, ("wx", "wy", "wz")) @ body.inertia + body.rotors)
    n = momentum.mean(axis=0)
    if not np.linalg.norm(n) > 0.0:
        return
    n = n / np.linalg.norm(n)
    q = (mine * certain.inv()).as_quat()
    angle = np.unwrap(2.0 * np.arctan2(q[:, :3] @ n, q[:, 3]))
    rate = float(angle @ t / (t @ t)) if t.any() else 0.0
    if not rate:
        return
    turned = Rotation.from_rotvec(-rate * t[:, None] * n) * mine
    own = float(np.linalg.norm(momentum.mean(axis=0)) / np.trace(body.inertia) * 3.0)
    sentence = f"the attitude precesses about the angular momentum at another rate: {rate:+.3g} rad/s"
    quaternion = np.roll(turned.as_quat(), 1, axis=1)
    table = _with(problem.table, ("qw", "qx", "qy", "qz"), quaternion)
    yield Explanation(f"{sentence}, {abs(rate) / own:.2g} of its own" if own else sentence, table, problem.reference)


def _turning_frames(problem: Problem) -> Iterator[Explanation]:
    """Yield attitudes relative to axes of space that turn at a constant rate."""
    t = problem.reference["t"]
    for quantity in problem.quantities:
        if quantity.kind != "attitude" or len(t) < LEAST_SAMPLES:
            continue
        mine, certain = (rotations_of(each, quantity.columns) for each in (problem.table, problem.reference))
        between = certain * mine.inv()
        for is_apart in (False, True):
            rate, start = _steady_rotation(t, between, is_apart)
            turned = Rotation.from_rotvec(t[:, None] * rate) * Rotation.from_rotvec(start) * mine
            table = _with(problem.table, quantity.columns, np.roll(turned.as_quat(), 1, axis=1))
            sentence = f"the {quantity.name} is relative to axes that turn by ({_vector_text(rate)}) rad/s in space"
            angle = math.degrees(float(np.linalg.norm(start)))
            if is_apart:
                sentence += f", and that are turned by {angle:.6g} degrees at t = 0"
            yield Explanation(sentence, table, problem.reference)


def _steady_rotation(t: Floats, rotations: Rotation, is_apart: bool) -> tuple[Floats, Floats]:
    """Return a rate and a start of ``exp(t rate) exp(start)``, as vectors, near rotations of any total angle.

    The first rate is that between successive samples, which turn by less than half a revolution each. The start is
    zero unless `is_apart`.
    """
    angles = (rotations[1:] * rotations[:-1].inv()).as_rotvec()
    rate = np.median(angles / np.diff(t)[:, None], axis=0)
    start = np.zeros(3)
    for _ in range(FIT_ITERATIONS):
        still = Rotation.from_rotvec(-t[:, None] * rate) * rotations
        if not is_apart:
            rate = rate + t @ still.as_rotvec() / (t @ t)
            continue
        mean = still.mean()
        start = mean.as_rotvec()
        left = (still * mean.inv()).as_rotvec()
        centred = t - t.mean()
        rate = rate + centred @ left / (centred @ centred)
    return rate, start


def _vector_text(vector: Floats) -> str:
    """Return a vector with three digits of its largest component."""
    largest = float(np.abs(vector).max())
    unit = 10.0 ** (math.floor(math.log10(largest)) - 2) if largest else 1.0
    return ", ".join(f"{round(float(v) / unit) * unit + 0.0:.3g}" for v in vector)


def _schemes(problem: Problem) -> Iterator[Explanation]:
    """Yield the motions of common schemes of low order with the step of the simulator."""
    if problem.step is None or problem.case.body is None:
        return
    t = problem.reference["t"]
    for label, order, rows, columns in emulated_runs(problem.case.body, problem.step, t):
        reference = {name: np.array(values) for name, values in problem.reference.items()}
        for name, values in columns.items():
            reference[name][rows] = values
        sentence = f"the scheme is of order {order}: the samples agree with {label}, at steps of {problem.step:g} s"
        yield Explanation(sentence, problem.table, reference, rows)


def _scales(problem: Problem) -> Iterator[Explanation]:
    """Yield constant factors of vectors."""
    for quantity in problem.quantities:
        if quantity.kind == "vector":
            mine, certain = (stacked(each, quantity.columns) for each in (problem.table, problem.reference))
            square = float(np.sum(mine * mine))
            factor = float(np.sum(mine * certain)) / square if square else 0.0
            if factor:
                table = _with(problem.table, quantity.columns, factor * mine)
                yield Explanation(
                    f"the {quantity.name} are {1.0 / factor:.9g} times as large", table, problem.reference
                )


Candidates = Callable[[Problem], Iterator[Explanation]]

LAWS: tuple[Candidates, ...] = (_altered, _schemes, _other_numbers)
"""Kinds of mistakes that change the motion of a body, and not only what is written of it."""

CANDIDATES: tuple[Candidates, ...] = (
    _rates,
    _quaternions,
    _altered,
    _schemes,
    _precession,
    _turning_frames,
    _clocks,
    _other_numbers,
    _scales,
)
"""Kinds of mistakes, simpler ones first."""


def _kept_invariants(problem: Problem) -> tuple[DerivedQuantity, ...]:
    """Return the invariants of the samples that the motion of the case keeps: a torque changes the energy."""
    present = {quantity.name for quantity in problem.quantities}
    kept = []
    for invariant in problem.case.invariants:
        if not present.issuperset(invariant.quantities):
            continue
        certain = _sizes_of(invariant, problem.reference)
        size = max(float(np.abs(certain).max()), invariant.size)
        if np.ptp(certain) <= max(100.0 * problem.case.accuracy, 0.1 * problem.tolerance) * size:
            kept.append(invariant)
    return tuple(kept)


def _sizes_of(invariant: DerivedQuantity, table: Table) -> Floats:
    """Return the values of an invariant, and lengths of a vector."""
    values = invariant.function(table)
    return values if values.ndim == 1 else np.asarray(np.linalg.norm(values, axis=1))


def _steady_changes(problem: Problem, invariants: tuple[DerivedQuantity, ...]) -> list[str]:
    """Return which invariants grow or fall steadily, as sentences."""
    findings = []
    t = problem.table["t"]
    for invariant in invariants:
        mine, certain = _sizes_of(invariant, problem.table), _sizes_of(invariant, problem.reference)
        is_vector = invariant.function(problem.table).ndim > 1
        what = f"length of the {invariant.name}" if is_vector else invariant.name
        size = max(float(np.abs(certain).max()), invariant.size) or 1.0
        change = (mine - certain) / size
        if np.abs(change).max() <= problem.tolerance or len(t) < 4:
            continue
        slope, constant = np.polyfit(t, change, 1)
        line = slope * t + constant
        variance = float(np.var(change))
        if (
            variance
            and 1.0 - float(np.var(change - line)) / variance > STEADY
            and abs(change[0]) < 0.5 * np.abs(change).max()
        ):
            verb = "gained" if slope > 0.0 else "lost"
            findings.append(
                f"the {what} is {verb} steadily, by {abs(slope) * (t[-1] - t[0]):.3g} of its size over the samples"
            )
    return findings
