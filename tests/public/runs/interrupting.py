"""Schemes in Python that interrupt a run or fail, and interrupts after some processor time."""

from __future__ import annotations

import dataclasses
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

import coadjoint as co

NOTHING = co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")


ARMED: list[bool] = []
"""Has an entry while `Interruptible` may interrupt."""


@dataclasses.dataclass(frozen=True)
class Interruptible(co.methods.StepMethod):
    """The explicit midpoint rule. Once armed, it is interrupted in a step beyond a time from a state beyond a norm."""

    at: float = 0.0
    norm: float = 0.0

    order, explicit, symmetric, compiles = 2, True, False, False

    def properties(self, system: Any) -> Any:
        return NOTHING

    def step(self, system: Any, x: Any, t: float, h: float) -> Any:
        if ARMED and h * (t - self.at) > 0.0 and np.linalg.norm(x) > self.norm:
            ARMED.clear()
            raise KeyboardInterrupt
        return x + h * system.vector_field(x + h / 2 * system.vector_field(x, t), t + h / 2)


@dataclasses.dataclass(frozen=True)
class Failing(co.methods.StepMethod):
    """Euler's method, which raises in Python beyond a time, for systems of one name if that is given."""

    beyond: float
    name: str = ""

    order, explicit, symmetric, compiles = 1, True, False, False

    def properties(self, system: Any) -> Any:
        return NOTHING

    def step(self, system: Any, x: Any, t: float, h: float) -> Any:
        if t > self.beyond and self.name in ("", system.name):
            raise LookupError(f"nothing is known at t = {t:.1f}")
        return x + h * system.vector_field(x, t)


def interrupted(call: Callable[[], Any]) -> BaseException:
    """Return the interrupt of a call that uses `Interruptible`."""
    ARMED.append(True)
    with pytest.raises(KeyboardInterrupt) as raised:
        call()
    return raised.value


@contextmanager
def interrupt_after(seconds: float) -> Iterator[None]:
    """Send SIGINT to this process in the block, after a processor time (s), and again if a callback ignored it."""
    ended, began, unraisable = threading.Event(), time.process_time(), sys.unraisablehook
    waiting = [True]

    def watch() -> None:
        while not ended.wait(0.002):
            if waiting and time.process_time() - began > seconds:
                waiting.clear()
                os.kill(os.getpid(), signal.SIGINT)

    def ignored(what: Any) -> None:
        if isinstance(what.exc_value, KeyboardInterrupt):
            waiting.append(True)
        else:
            unraisable(what)

    watching = threading.Thread(target=watch)
    sys.unraisablehook = ignored
    watching.start()
    try:
        yield
    finally:
        ended.set()
        watching.join()
        sys.unraisablehook = unraisable
