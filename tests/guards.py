"""Guards of resources: processor time, independent of other processes and disks, open file descriptors, and forks."""

import os
import time
from contextlib import contextmanager

import pytest

FORKS = pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")
"""Of tests that fork this process: JAX warns if another test has loaded it; its threads are not used in the child."""


@contextmanager
def bounded_work(seconds=60.0):
    """Fail if a block takes more processor time (s) than bounded work on any machine; unbounded work takes hours."""
    began = time.process_time()
    yield
    assert time.process_time() - began < seconds


def open_descriptors():
    """Return the open file descriptors of this process; empty if the system does not list them."""
    return set(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else set()
