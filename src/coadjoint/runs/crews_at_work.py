"""Crews at work: in this thread or in several, and what is said where one of them fails."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from coadjoint.kernels.description import codes
from coadjoint.kernels.loop import Crew, Stop
from coadjoint.methods.base import Method
from coadjoint.runs.loops import Loops


def at_work(crews: Sequence[Crew], given: tuple[Any, ...], loops: Loops, pool: ThreadPoolExecutor | None = None) -> int:
    """Let crews take steps; return how many members have failed.

    Parameters
    ----------
    crews : sequence of Crew
        At work at the same time, where there is a pool.
    given : tuple
        The arguments of `Crew.advance` but for the last.
    loops : Loops
        Whose they are: it knows what functions of the user have raised.
    pool : ThreadPoolExecutor, optional
        Its threads.

    Returns
    -------
    int
    """
    stop = Stop()

    def take(crew: Crew) -> int:
        return crew.advance(*(*given, stop))

    try:
        wrong = sum(map(take, crews) if pool is None else pool.map(take, crews))
    except BaseException as ended:
        stop.say()
        raised = loops.raised()
        if raised is not None:
            raise raised from None
        raise ended
    if wrong and (raised := loops.raised()) is not None:
        raise raised
    return wrong


@contextmanager
def pool_of(workers: int) -> Iterator[ThreadPoolExecutor | None]:
    """A pool of threads, or None where one thread does the work."""
    if workers == 1:
        yield None
    else:
        with ThreadPoolExecutor(workers) as pool:
            yield pool


def name_of_status(status: Any) -> str:
    """Return the name of the number that says how a step ended."""
    return next(name for name, code in codes("Status").items() if code == status)


def what_failed(status: str, method: Method, loops: Loops, residual: float) -> str:
    """Return what a status says, by its name, for messages."""
    if status in method.failures:
        return method.failures[status]
    if status == "NOT_CONVERGED":
        or_of = ", or of a force," if loops.accounts else ""
        return f"the iteration of {method}{or_of} did not converge (last correction {residual:.3g})"
    if status == "PARALLEL":
        return "a tangent vector lost half of its digits against the others"
    return "a number overflowed"
