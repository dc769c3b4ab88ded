"""Arrays of one run and the compiled loop that fills them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariant import Invariant
from coadjoint.algebra.polynomial import Polynomial
from coadjoint.errors import IntegrationError
from coadjoint.methods.base import Method, System
from coadjoint.runs.prepare import prepare
from coadjoint.runs.solution import Solution, Statistics
from coadjoint.runs.start import Start
from coadjoint.runs.times import Times
from coadjoint.runs.unshift import unshifted
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.user_functions import takes_time

# Between two calls of the compiled loop the interpreter can show progress and hear an interrupt.
SECONDS_BETWEEN_LOOKS = 0.2


class Run:
    """Arrays of one run and the compiled loop that fills them."""

    def __init__(
        self,
        system: System,
        method: Method,
        times: Times,
        start: Start,
        watch: bool,
        observe: Mapping[str, Any],
        casimirs: Mapping[str, Any] | None = None,
    ) -> None:
        from coadjoint.kernels.tables import watch_tables

        self.system, self.method, self.watching = system, method, watch
        followed = system.casimirs if casimirs is None else casimirs
        self.names = ["energy", *followed]
        self.prepared = prepare(system, method, times.h, start.representation)
        self.watch = watch_tables(system, followed)
        self.observed = _observables(system, observe, start.momenta[0]) if observe else None
        self.restart(times, start)

    def restart(self, times: Times, start: Start) -> None:
        """Begin again at another state or time; the step must be the one that was prepared."""
        from coadjoint.kernels.watching import TENTHS, Report, Saves, Schedule, record_start

        self.times, self.start = times, start
        members, size = start.momenta.shape
        square = start.groups.shape[1] ** 2
        count, invariants = len(times.saved), len(self.names)
        self.saves = Saves(
            members=members,
            x=np.full((count, members, size), np.nan),
            group=np.full((count, members, square), np.nan),
            values=np.full((count, members, invariants), np.nan),
            worst=np.zeros((members, TENTHS, invariants)),
            first=np.zeros((members, invariants)),
            last=np.zeros((members, invariants)),
        )
        self.schedule = Schedule(times.t0, times.h, times.steps, times.save_every, self.watching)
        # A shifted run starts at the unit element; `_groups` puts the initial one before it.
        groups = np.broadcast_to(np.eye(start.groups.shape[1]), start.groups.shape) if self.shifted else start.groups
        transposed = np.swapaxes(groups, 1, 2).reshape(members, square).copy()
        self.state = (start.momenta.copy(), np.zeros((members, size)), transposed, np.zeros((members, square)))
        whole = [np.zeros(members, dtype=np.int64) for _ in range(4)]
        self.report = Report(whole[0], whole[1], np.full(members, np.nan), whole[2], whole[3])
        self.seconds = 0.0
        record_start(self.watch.tables, self.saves, self.schedule, self.state[0], self.state[2])

    def advance(self, workers: int, progress: bool) -> None:
        """Take all steps, in chunks between which an interrupt is heard."""
        members = len(self.start.momenta)
        edges = [members * w // workers for w in range(workers + 1)]
        crews = [np.array(pair, dtype=np.int64) for pair in pairwise(edges)]
        began = time.perf_counter()
        with ThreadPoolExecutor(workers) as pool, _bar(self.times.steps, progress) as bar:
            done, chunk = 0, 1
            while done < self.times.steps and not np.all(self.report.status):
                target = min(self.times.steps, done + chunk)
                before = time.perf_counter()
                self._call(pool, crews, done, target)
                spent = max(time.perf_counter() - before, 1e-6)
                bar(target - done)
                done, chunk = target, max(1, min(int(chunk * SECONDS_BETWEEN_LOOKS / spent), 1000 * chunk))
        self.seconds = time.perf_counter() - began

    def _call(self, pool: ThreadPoolExecutor, crews: list[NDArray[np.int64]], k0: int, k1: int) -> None:
        def one(crew: NDArray[np.int64]) -> None:
            self.prepared.advance(
                self.prepared.tables,
                self.watch.tables,
                self.saves,
                self.schedule,
                self.state,
                crew,
                k0,
                k1,
                self.report,
            )

        if len(crews) == 1:
            one(crews[0])
        else:
            list(pool.map(one, crews))

    def solution(self) -> Solution:
        """Return what was saved, or raise the failure with it."""
        failed = np.flatnonzero(self.report.status)
        kept = len(self.times.saved)
        if not len(failed):
            whole = self._solution(kept)
            self._check_energy(whole)
            return whole
        if len(self.start.momenta) == 1:
            kept = int(np.searchsorted(self.times.saved, self.report.step[0]))
        raise self._error(int(failed[0]), len(failed), self._solution(kept))

    def _check_energy(self, whole: Solution) -> None:
        """A state that is finite with an energy that is not: the function of the user is not defined there."""
        wrong = np.flatnonzero(~np.all(np.isfinite(whole.energy.reshape(len(whole.t), -1)), axis=1))
        if len(wrong):
            step, when = int(self.times.saved[wrong[0]]), float(whole.t[wrong[0]])
            raise IntegrationError(
                f"the energy at t = {when:g} is not a finite number, though the state is: the Hamiltonian overflows "
                "or is undefined there; start elsewhere, or correct its value",
                step=step,
                time=when,
                residual=float("nan"),
                partial=whole,
            )

    def _error(self, member: int, count: int, partial: Solution) -> IntegrationError:
        from coadjoint.kernels.watching import NOT_CONVERGED

        step = int(self.report.step[member])
        when = float(self.times.t0 + (step - 1) * self.times.h)
        residual = float(self.report.residual[member])
        who = "" if self.start.single else f" for {count} of {len(self.start.momenta)} members (first: member {member})"
        status = int(self.report.status[member])
        if status in self.method.failures:
            what = self.method.failures[status]
        elif status == NOT_CONVERGED:
            what = f"the iteration of {self.method!r} did not converge (last correction {residual:.3g})"
        else:
            what = "a number overflowed"
        message = f"in step {step}, at t = {when:g}, {what}{who}; take a smaller step than {abs(self.times.h):g}"
        return IntegrationError(message, step=step, time=when, residual=residual, partial=partial)

    def _solution(self, kept: int) -> Solution:
        numbers = self.times.saved[:kept]
        t = self.times.at(numbers)
        pick: Any = (lambda a: a[:, 0]) if self.start.single else (lambda a: a)
        values = self.saves.values[:kept]
        worst = self.saves.worst[0] if self.start.single else self.saves.worst
        return Solution(
            t=t,
            x=pick(self.saves.x[:kept]),
            energy=pick(values[..., 0]),
            casimirs={name: pick(values[..., i + 1]) for i, name in enumerate(self.names[1:])},
            attitude=None if self.start.representation is None else pick(self._groups(kept)),
            observed={} if self.observed is None else self.observed(t, self.saves.x[:kept], pick),
            stats=Statistics(
                steps=int(self.times.steps),
                evaluations=int(self.report.evaluations.sum()),
                iterations=int(self.report.iterations.sum()),
                seconds=self.seconds,
            ),
            failed=None if self.start.single else self.report.status != 0,
            system=self.system,
            method=self.method,
            t_span=(self.times.t0, self.times.end),
            step=abs(self.times.h),
            save_every=self.times.save_every,
            watched=self.watching,
            carried=self.start.carried,
            _worst=worst,
        )

    @property
    def shifted(self) -> bool:
        """Whether a group element is carried that a Casimir shift has yet to turn."""
        return bool(self.prepared.shift) and self.start.representation is not None

    def _groups(self, kept: int) -> NDArray[np.float64]:
        members, size = self.start.groups.shape[:2]
        groups = np.swapaxes(self.saves.group[:kept].reshape(kept, members, size, size), 2, 3)
        representation = self.start.representation
        if not self.shifted or representation is None:
            return groups
        assert isinstance(self.system, LiePoissonSystem)
        elapsed = self.times.at(self.times.saved[:kept]) - self.times.t0
        start = (self.start.momenta, self.start.groups)
        return unshifted(self.system, self.prepared.shift, representation, *start, elapsed, groups)


def _observables(
    system: System, observe: Mapping[str, Any], x0: NDArray[np.float64]
) -> Callable[..., dict[str, NDArray[np.float64]]]:
    """Compile further quantities; returns the function that evaluates them along saved points."""
    from coadjoint.kernels.tables import watch_tables
    from coadjoint.kernels.watching import values_along

    if not isinstance(observe, Mapping) or not all(isinstance(name, str) for name in observe):
        raise TypeError(f"observe is {observe!r}; it must map names to Polynomials or functions of x")
    for name, given in observe.items():
        if not isinstance(given, Polynomial | Invariant) and not callable(given):
            raise TypeError(f"observe[{name!r}] is {given!r}; it must be a Polynomial or a function of x")
        value = _value_at(given, name, x0)
        if np.ndim(value) != 0 or np.asarray(value).dtype.kind not in "iuf":
            raise TypeError(f"observe[{name!r}] returns {value!r} at the start; it must return one real number")
    wrapped = {
        name: given if isinstance(given, Polynomial | Invariant) else Invariant(given)
        for name, given in observe.items()
    }
    compiled = watch_tables(system, wrapped)

    def evaluate(t: NDArray[np.float64], points: NDArray[np.float64], pick: Any) -> dict[str, NDArray[np.float64]]:
        out = np.empty((*points.shape[:2], len(wrapped) + 1))
        values_along(compiled.tables, points, t, out)
        return {name: pick(out[..., i + 1]) for i, name in enumerate(wrapped)}

    return evaluate


def _value_at(given: Any, name: str, x0: NDArray[np.float64]) -> Any:
    """Return a quantity at the start; NaN where it is not defined there, which the run then says of it as well."""
    try:
        return 0.0 if isinstance(given, Polynomial) or takes_time(given, name) else given(x0)
    except (ArithmeticError, ValueError, OSError):
        return float("nan")


class _bar:
    """A progress bar over the steps, or nothing."""

    def __init__(self, steps: int, shown: bool) -> None:
        self._bar: Any = None
        if shown:
            from tqdm import tqdm

            self._bar = tqdm(total=steps, unit="step", unit_scale=True)

    def __enter__(self) -> Callable[[int], None]:
        return (lambda count: None) if self._bar is None else (lambda count: self._bar.update(count))

    def __exit__(self, *exception: object) -> None:
        if self._bar is not None:
            self._bar.close()
