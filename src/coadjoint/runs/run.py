"""Arrays of one run and the compiled loop that fills them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.methods.base import Method, System
from coadjoint.runs.loops import Crew, Loops, Work
from coadjoint.runs.observed import Observed
from coadjoint.runs.solution import Solution, Statistics
from coadjoint.runs.start import Start
from coadjoint.runs.times import Times
from coadjoint.systems.batch import Batch

# Between two calls of the compiled loop the interpreter can show progress and hear an interrupt.
SECONDS_BETWEEN_LOOKS = 0.2


class Run:
    """Arrays of one run, from checked states and times, and the loops that fill them."""

    def __init__(
        self, system: System | Batch, method: Method, loops: Loops, times: Times, start: Start, watching: bool
    ) -> None:
        from coadjoint.kernels.watching import TENTHS, Report, Saves, Schedule

        self.system, self.method, self.loops = system, method, loops
        self.times, self.start, self.watching = times, start, watching
        self.names = loops.names
        self.saved = times.saved
        members, size = start.momenta.shape
        square = start.groups.shape[1] ** 2
        count, invariants = len(self.saved), len(self.names)
        self.saves = Saves(
            members=members,
            x=_blank(count, members, size),
            group=_blank(count, members, square),
            values=_blank(count, members, invariants),
            worst=np.zeros((members, TENTHS, invariants)),
            first=np.zeros((members, invariants)),
            last=np.zeros((members, invariants)),
        )
        self.schedule = Schedule(times.t0, times.h, times.steps, times.save_every, watching)
        held = slice(None) if loops.order is None else loops.order
        # Group elements are held transposed.
        groups = np.swapaxes(loops.started(start.groups)[held], 1, 2).reshape(members, square).copy()
        momenta, memory = start.momenta[held].copy(), _blank(members, loops.memory)
        self.state = (momenta, np.zeros((members, size)), groups, np.zeros((members, square)), memory)
        counts = np.zeros((4, members), dtype=np.int64)
        self.report = Report(counts[0], counts[1], _blank(members), counts[2], counts[3])
        self.seconds = 0.0
        loops.record_start(self.saves, self.schedule, self.state)

    def advance(self, workers: int, progress: bool) -> None:
        """Take all steps: round after round, each in chunks between which an interrupt is heard."""
        rounds = self.loops.rounds(len(self.start.momenta), workers)
        began = time.perf_counter()
        with _pool(workers) as pool, _bar(self.times.steps * len(rounds), progress) as bar:
            chunk = 1
            for crews in rounds:
                chunk = self._advance(crews, chunk, pool, bar)
        self.seconds = time.perf_counter() - began
        if self.loops.order is not None:
            self._put_in_order(self.loops.order)

    def _advance(self, crews: list[Crew], chunk: int, pool: ThreadPoolExecutor | None, bar: Callable[..., Any]) -> int:
        """Take all steps of some crews; returns how many steps are a chunk of the right length."""
        report, steps = self.report, self.times.steps
        works = [(self.loops.work(crew), np.array(crew, dtype=np.int64)) for crew in crews]
        status = report.status[crews[0][0] : crews[-1][1]]

        def take(given: tuple[Work, NDArray[np.int64]]) -> None:
            (advance, tables, watch), crew = given
            advance(tables, watch, self.saves, self.schedule, self.state, crew, done, target, report)

        done = 0
        while done < steps and not status.all():
            target = min(steps, done + chunk)
            before = time.perf_counter()
            if pool is None:
                for work in works:
                    take(work)
            else:
                list(pool.map(take, works))
            spent = max(time.perf_counter() - before, 1e-6)
            bar(target - done)
            whole, done = target - done == chunk, target
            if whole:
                chunk = max(1, min(int(chunk * SECONDS_BETWEEN_LOOKS / spent), 1000 * chunk))
        return chunk

    def _put_in_order(self, order: NDArray[np.int64]) -> None:
        """Give every member the place that it was given at."""
        place = np.argsort(order)
        self.saves = self.saves._replace(
            x=self.saves.x.take(place, axis=1),
            group=self.saves.group.take(place, axis=1),
            values=self.saves.values.take(place, axis=1),
            worst=self.saves.worst[place],
            first=self.saves.first[place],
            last=self.saves.last[place],
        )
        report = self.report
        self.report = report._replace(
            status=report.status[place],
            step=report.step[place],
            residual=report.residual[place],
            evaluations=report.evaluations[place],
            iterations=report.iterations[place],
        )

    def solution(self, observed: Observed | None) -> Solution:
        """Return what was saved, or raise the failure with it."""
        failed = self.report.status.nonzero()[0]
        kept = len(self.saved)
        if not len(failed):
            whole = self._solution(kept, observed)
            self._check_energy(whole)
            return whole
        if len(self.start.momenta) == 1:
            kept = int(np.searchsorted(self.saved, self.report.step[0]))
        raise self._error(int(failed[0]), len(failed), self._solution(kept, observed))

    def _check_energy(self, whole: Solution) -> None:
        """A state that is finite with an energy that is not: the function of the user is not defined there."""
        finite = np.isfinite(whole.energy)
        if not finite.all():
            wrong = np.flatnonzero(~finite.reshape(len(whole.t), -1).all(axis=1))
            step, when = int(self.saved[wrong[0]]), float(whole.t[wrong[0]])
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

    def _solution(self, kept: int, observed: Observed | None) -> Solution:
        t = self.times.at(self.saved[:kept])
        pick: Any = (lambda a: a[:, 0]) if self.start.single else (lambda a: a)
        values, x = self.saves.values[:kept], self.saves.x[:kept]
        worst = self.saves.worst[0] if self.start.single else self.saves.worst
        quantities = {} if observed is None else observed.along(t, x)
        return Solution(
            t=t,
            x=pick(x),
            energy=pick(values[..., 0]),
            casimirs={name: pick(values[..., i + 1]) for i, name in enumerate(self.names[1:])},
            attitude=None if self.start.representation is None else pick(self._groups(t)),
            observed={name: pick(series) for name, series in quantities.items()},
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

    def _groups(self, t: NDArray[np.float64]) -> NDArray[np.float64]:
        members, size = self.start.groups.shape[:2]
        held = self.saves.group[: len(t)].reshape(len(t), members, size, size)
        return self.loops.turned(self.start, t - self.times.t0, np.swapaxes(held, 2, 3))


def _blank(*shape: int) -> NDArray[np.float64]:
    """Return an array in which nothing has been saved yet: a NaN that is left over says so."""
    blank = np.empty(shape)
    blank.fill(np.nan)
    return blank


@contextmanager
def _pool(workers: int) -> Iterator[ThreadPoolExecutor | None]:
    """A pool of threads, or None where one thread does the work."""
    if workers == 1:
        yield None
    else:
        with ThreadPoolExecutor(workers) as pool:
            yield pool


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
