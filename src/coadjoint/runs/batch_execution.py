"""Execution of crews in one or several threads, and descriptions of their failures."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any

from coadjoint.kernels.interface import codes
from coadjoint.kernels.loop import Crew, Stop
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.loops import Loops


def at_work(crews: Sequence[Crew], given: tuple[Any, ...], loops: Loops, workers: int = 1) -> int:
    """Advance crews in `workers` threads (1: the calling thread); return the number of members that failed.

    `given` holds the arguments of `Crew.advance` except the last; an exception raised by a user's function in `loops`
    takes precedence over any other.
    """
    stop = Stop()

    def take(crew: Crew) -> int:
        return crew.advance(*(*given, stop))

    try:
        wrong = sum(map(take, crews)) if workers == 1 else _sum_in_threads(take, crews, workers, stop)
    except BaseException as ended:
        raised = loops.raised()
        if raised is not None:
            raise raised from None
        raise ended
    if wrong and (raised := loops.raised()) is not None:
        raise raised
    return wrong


def _sum_in_threads(take: Callable[[Crew], int], crews: Sequence[Crew], workers: int, stop: Stop) -> int:
    """Sum the results of `take` over all crews; the first error stops all threads and is raised.

    The threads are daemons: those of a pool would make the interpreter wait at exit for a run in a daemon thread.
    """
    waiting, lock = list(reversed(crews)), threading.Lock()
    found: list[int] = []
    errors: list[BaseException] = []

    def work() -> None:
        try:
            while True:
                with lock:
                    if not waiting:
                        return
                    crew = waiting.pop()
                found.append(take(crew))
        except BaseException as error:
            errors.append(error)
            waiting.clear()
            stop.say()

    threads = [threading.Thread(target=work, daemon=True) for _ in range(min(workers, len(crews)))]
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    except BaseException:
        with lock:
            waiting.clear()
        stop.say()
        for thread in threads:
            if thread.ident is not None:
                thread.join()
        raise
    if errors:
        raise errors[0]
    return sum(found)


def name_of_status(status: Any) -> str:
    """Return the name of a status code."""
    return next(name for name, code in codes("Status").items() if code == status)


def what_failed(status: str, method: Method, loops: Loops, residual: float) -> str:
    """Describe the failure with this status name, for messages."""
    if status in method.failures:
        return method.failures[status]
    if status == "NOT_CONVERGED":
        or_of = ", or of a force," if loops.accounts else ""
        return f"the iteration of {method}{or_of} did not converge (last correction {residual:.3g})"
    if status == "PARALLEL":
        return "a tangent vector lost half of its digits against the others"
    return "a number overflowed"
