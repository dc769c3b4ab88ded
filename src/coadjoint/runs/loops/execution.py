"""Execution of member batches in one or several threads, and descriptions of failures."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Sequence
from queue import Empty, SimpleQueue
from typing import Any, NoReturn, TypeVar

from coadjoint.kernels.interface import codes, limit
from coadjoint.kernels.loop import NEVER_STOPPED, Layout, MemberBatch, NamedArrays, StopFlag
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.loops.loops import Loops

BatchT = TypeVar("BatchT")
Task = tuple[Callable[[], None], "SimpleQueue[None]"]

POLLING_SECONDS = 0.01  # while threads stop

# Threads that wait for work, each by its queue. Daemon threads, since the interpreter would wait for others at exit.
_IDLE: list[SimpleQueue[Task]] = []
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_IDLE.clear)


def _start(work: Callable[[], None], done: SimpleQueue[None]) -> None:
    """Call `work`, which must not raise, in an idle thread or a new one, which then reports to `done`."""
    try:
        tasks = _IDLE.pop()
    except IndexError:
        tasks = SimpleQueue()
        threading.Thread(target=_serve, args=(tasks,), daemon=True).start()
    tasks.put((work, done))


def _serve(tasks: SimpleQueue[Task]) -> None:
    while True:
        work, done = tasks.get()
        work()
        del work  # with all that it refers to
        _IDLE.append(tasks)
        done.put(None)


def run_in_threads(
    member_batches: Sequence[MemberBatch],
    arguments: tuple[Layout, bytes, NamedArrays, NamedArrays, int, int],
    loops: Loops,
    workers: int = 1,
) -> int:
    """Advance member batches in threads; return the number of failed members. User exceptions in `loops` come first."""

    def advance_all() -> int:
        if workers == 1:
            return sum(member_batch.advance(*arguments, NEVER_STOPPED) for member_batch in member_batches)
        stop = StopFlag()
        return sum_in_threads(
            lambda member_batch: member_batch.advance(*arguments, stop), member_batches, workers, stop
        )

    try:
        failed_count = advance_all()
    except BaseException as error:
        raise_reason(loops, error)
    if failed_count and (raised := loops.raised()) is not None:
        raise raised
    return failed_count


def raise_reason(loops: Loops, error: BaseException) -> NoReturn:
    """Raise what ended a call of the loops, which raised `error`: exceptions of user functions take precedence."""
    raised = loops.raised()
    raise error if raised is None else raised from None


def sum_in_threads(
    advance: Callable[[BatchT], int], member_batches: Sequence[BatchT], workers: int, stop: StopFlag
) -> int:
    """Sum the results of `advance` over batches or ranges of members; the first error stops all, and is raised."""
    waiting, lock = list(reversed(member_batches)), threading.Lock()
    advanced: list[None] = []  # an entry for each batch at present
    counts: list[int] = []
    errors: list[BaseException] = []

    def work() -> None:
        try:
            while True:
                with lock:
                    if not waiting:
                        return
                    member_batch = waiting.pop()
                    advanced.append(None)
                try:
                    counts.append(advance(member_batch))
                finally:
                    advanced.pop()
        except BaseException as error:
            errors.append(error)
            waiting.clear()
            stop.request()

    done: SimpleQueue[None] = SimpleQueue()
    try:
        threads = min(workers, len(member_batches))
        for _ in range(threads):
            _start(work, done)
        for _ in range(threads):
            done.get()
    except BaseException:
        with lock:
            waiting.clear()
        stop.request()
        while advanced:
            with contextlib.suppress(Empty):
                done.get(timeout=POLLING_SECONDS)
        raise
    if errors:
        raise errors[0]
    return sum(counts)


def status_name(status: Any) -> str:
    """Return the name of a status code."""
    return next(name for name, code in codes("Status").items() if code == status)


def failure_text(status: str, method: Method, loops: Loops, residual: float) -> str:
    """Describe the failure with this status name, for messages."""
    if status in method.failures:
        return method.failures[status]
    if status == "NOT_CONVERGED":
        forces = ", or of a force," if loops.accounts else ""
        return f"the iteration of {method}{forces} did not converge (last correction {residual:.3g})"
    if status == "TOO_LONG":
        return (
            f"a flow of a part is longer than {limit('MOST_SUBSTEPS')} (its angle times the norm of its generator), "
            "and flows so long leave no digits of float64"
        )
    if status == "PARALLEL":
        return "a tangent vector lost half of its digits against the others"
    return "a number overflowed"
