"""Strong and weak orders of noise around a scheme, from runs of several steps with the same paths."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.certificates.certificate import INAPPLICABLE, Row, checked
from coadjoint.analysis.certificates.convergence import MARGIN
from coadjoint.analysis.certificates.subject import Subject
from coadjoint.errors import IntegrationError
from coadjoint.long_operations import note_progress
from coadjoint.methods.forced import Forced
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.systems.forces.orbit_noise import OrbitNoise
from coadjoint.systems.system import System

Floats = NDArray[np.float64]

FACTORS = (4.0, 2.0, 1.0, 0.5)
"""Steps, in units of the given one: those of a path are sums of the increments of the last."""
STEPS = 16  # of the given length, to the end at which they are compared
FIRST_PATHS, MAX_PATHS = 256, 2**18
TIME_LIMIT = 4.0
"""Approximate seconds of the runs of a force."""
STRONG_UNCERTAINTY, WEAK_UNCERTAINTY = 0.05, 0.15
"""Standard errors of the slopes that end the runs."""
DECISIVE = 0.375  # a larger standard error does not tell order two from one
SEEN = 3.0  # standard errors by which a difference of averages must exceed zero
MAX_PRODUCTS = 12  # dimension up to which averages are those of products too


class Slope(NamedTuple):
    """A slope of base-two logarithms with its standard error; NaN without enough points."""

    order: float
    error: float


class PathDifferences:
    """Sums over paths of the differences between consecutive steps, of their squares, and of squared distances."""

    def __init__(self) -> None:
        self.paths = 0
        self._sums: list[list[Any]] = [[0.0] * 4 for _ in FACTORS[1:]]
        self.size = 0.0

    def add(self, ends: list[Floats]) -> None:
        """Add the ends of some paths by each step."""
        self.paths += len(ends[0])
        self.size = max(self.size, float(np.abs(ends[-1]).max(initial=0.0)))
        functions = [_functions(x) for x in ends]
        for sums, x, finer, f, of_finer in zip(self._sums, ends, ends[1:], functions, functions[1:], strict=False):
            squares, changes = np.sum((x - finer) ** 2, axis=1), f - of_finer
            for k, one in enumerate((squares.sum(), (squares**2).sum(), changes.sum(axis=0), changes.T @ changes)):
                sums[k] = sums[k] + one

    def strong(self) -> tuple[Floats, Floats]:
        """Return root mean square distances between paths, and their standard errors."""
        M = self.paths
        mean = np.array([sums[0] / M for sums in self._sums])
        error = np.array([math.sqrt(max(0.0, sums[1] / M - (sums[0] / M) ** 2) / M) for sums in self._sums])
        root = np.sqrt(mean)
        return root, error / np.maximum(2.0 * root, 2.0**-1000)

    def weak(self) -> tuple[Floats, Floats]:
        """Return differences of averages along the direction of the largest, and their standard errors."""
        M, direction = self.paths, self._sums[0][2]
        direction = direction / (float(np.sqrt(np.sum(direction**2))) or 1.0)
        means = np.array([float(sums[2] @ direction) / M for sums in self._sums])
        squares = np.array([float(direction @ sums[3] @ direction) / M for sums in self._sums])
        return means, np.sqrt(np.maximum(squares - means**2, 0.0) / M)


def _functions(x: Floats) -> Floats:
    """Return the functions whose averages are compared: coordinates and, in small dimensions, their products."""
    n = x.shape[1]
    if n > MAX_PRODUCTS:
        return x
    i, j = np.triu_indices(n)
    return np.concatenate([x, x[:, i] * x[:, j]], axis=1)


def _slope(values: Floats, errors: Floats) -> Slope:
    """Fit the slope of logarithms of consecutive values, as long as they are above their errors."""
    seen = int(np.argmin(np.append(values > SEEN * errors, False)))
    if seen < 2:
        return Slope(math.nan, math.nan)
    logs, sigma = np.log2(values[:seen]), errors[:seen] / values[:seen] / math.log(2.0)
    sigma = np.maximum(sigma, 2.0**-20)
    k, weight = -np.arange(seen), sigma**-2.0
    centred = k - np.sum(weight * k) / np.sum(weight)
    spread = float(np.sum(weight * centred**2))
    return Slope(float(np.sum(weight * centred * logs)) / spread, spread**-0.5)


def noise_rows(subject: Subject, system: System, force: Any, label: str) -> list[Row]:
    """Return the rows on the strong and the weak order of a noise around the scheme."""
    order = min(2, Forced(subject.method).order)
    claims = {"strong": 1.0 if force.commutes(system) else 0.5, "weak": float(order)}
    rows = {name: f"{name} order of {label}" for name in claims}
    empty = [checked(row, row, f"{claims[name]:g}", True, None) for name, row in rows.items()]
    begin, batch, differences = time.process_time(), FIRST_PATHS, PathDifferences()
    x0 = system.states_of(subject.given[0])
    while True:
        note_progress(f"{differences.paths + batch} paths of {label}")
        try:
            differences.add(
                [_ends(subject, system, force, k, x0, differences.paths, batch) for k in range(len(FACTORS))]
            )
        except (IntegrationError, ArithmeticError, ValueError) as failure:
            return [replace(row, reason=str(failure)) for row in empty]
        slopes = {"strong": _slope(*differences.strong()), "weak": _slope(*differences.weak())}
        settled = slopes["strong"].error < STRONG_UNCERTAINTY and slopes["weak"].error < WEAK_UNCERTAINTY
        passed = time.process_time() - begin
        if settled or differences.paths + 2 * batch > MAX_PATHS or 3.0 * passed > TIME_LIMIT:
            break
        batch = differences.paths
    return [_row(subject, differences, rows[name], claims[name], slopes[name], name) for name in claims]


def _ends(subject: Subject, system: System, force: OrbitNoise, number: int, x0: Any, first: int, count: int) -> Floats:
    """Return the ends (count, n) of the paths from `first` on by a step of FACTORS, in the units of the norm."""
    factor, other = FACTORS[number], force.of_members_from(first)
    noisy = system.with_forces(replace(other, levels=len(FACTORS) - 1 - number))  # type: ignore[type-var]
    steps, h = round(STEPS / factor), factor * subject.h
    run = PreparedRun(noisy, subject.method, h, watch=False, threads=1)
    sol = run.run(np.array([x0] * count), (0.0, steps * h), save_every=steps)
    return np.asarray(subject.norm.scaled(system.rows_of(sol.x[-1])))


def _row(subject: Subject, differences: PathDifferences, name: str, claim: float, slope: Slope, kind: str) -> Row:
    values, errors = differences.strong() if kind == "strong" else differences.weak()
    declared, paths = f"{claim:g}", f"{differences.paths} paths"
    steps = subject.h * np.array(FACTORS[:-1])
    evidence = {"steps": steps, "differences": values, "errors": errors, "paths": differences.paths}
    more: dict[str, Any] = {
        "evidence": evidence,
        "source": "declared; the slope may be lower by 1/4 and twice its standard error",
    }
    rounding = 64.0 * STEPS * UNIT_ROUNDOFF * differences.size
    if np.all(differences.strong()[0] <= rounding):
        return checked(name, name, declared, True, True, f"no difference above round-off, {paths}", **more)
    if not slope.error <= DECISIVE:
        seen = f"differences {', '.join(f'{v:.1g} +- {e:.1g}' for v, e in zip(values, errors, strict=True))}, {paths}"
        ratio = (SEEN * errors[1] / values[1]) ** 2 if values[1] > 0.0 else math.inf
        needed = (
            f"some {differences.paths * ratio:.0e} paths" if 1.0 < ratio < 1e6 else "stronger noise or a larger step"
        )
        reason = f"the averages differ too little for their standard errors; this needs {needed}"
        return replace(checked(name, name, declared, True, None, seen, **more), verdict=INAPPLICABLE, reason=reason)
    measured = f"order {slope.order:.2f} +- {slope.error:.2f}, by {paths}, steps from {steps[0]:.3g}"
    holds = slope.order + 2.0 * slope.error >= claim - MARGIN
    return checked(name, name, declared, True, holds, measured, value=slope.order, bound=claim, **more)
