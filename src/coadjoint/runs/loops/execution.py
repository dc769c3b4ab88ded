"""Execution of member batches in one or several threads, and descriptions of failures."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from coadjoint.kernels.interface import codes
from coadjoint.kernels.loop import MemberBatch, StopFlag
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.loops.loops import Loops

BatchT = TypeVar("BatchT")


def run_in_threads(
    member_batches: Sequence[MemberBatch], arguments: tuple[Any, ...], loops: Loops, workers: int = 1
) -> int:
    """Advance member batches in `workers` threads (1: the calling thread); return the number of failed members.

    `arguments` are those of `MemberBatch.advance` except the last. Exceptions of user functions in `loops` take
    precedence over others.
    """
    stop = StopFlag()

    def advance(member_batch: MemberBatch) -> int:
        return member_batch.advance(*(*arguments, stop))

    try:
        failed_count = (
            sum(map(advance, member_batches))
            if workers == 1
            else sum_in_threads(advance, member_batches, workers, stop)
        )
    except BaseException as error:
        raised = loops.raised()
        if raised is not None:
            raise raised from None
        raise error
    if failed_count and (raised := loops.raised()) is not None:
        raise raised
    return failed_count


def sum_in_threads(
    advance: Callable[[BatchT], int], member_batches: Sequence[BatchT], workers: int, stop: StopFlag
) -> int:
    """Sum the results of `advance` over all batches, or ranges, of members; the first error stops all threads.

    It is raised. Daemon threads, since the interpreter would wait for the threads of a pool at exit.
    """
    waiting, lock = list(reversed(member_batches)), threading.Lock()
    counts: list[int] = []
    errors: list[BaseException] = []

    def work() -> None:
        try:
            while True:
                with lock:
                    if not waiting:
                        return
                    member_batch = waiting.pop()
                counts.append(advance(member_batch))
        except BaseException as error:
            errors.append(error)
            waiting.clear()
            stop.request()

    threads = [threading.Thread(target=work, daemon=True) for _ in range(min(workers, len(member_batches)))]
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    except BaseException:
        with lock:
            waiting.clear()
        stop.request()
        for thread in threads:
            if thread.ident is not None:
                thread.join()
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
    if status == "PARALLEL":
        return "a tangent vector lost half of its digits against the others"
    return "a number overflowed"
