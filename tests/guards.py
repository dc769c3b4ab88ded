"""Guards of resources: processor time, independent of other processes and disks, and open file descriptors."""

import os
import time
from contextlib import contextmanager


@contextmanager
def bounded_work(seconds=60.0):
    """Fail if a block takes more processor time (s) than bounded work on any machine; unbounded work takes hours."""
    began = time.process_time()
    yield
    assert time.process_time() - began < seconds


def open_descriptors():
    """Return the open file descriptors of this process; empty if the system does not list them."""
    return set(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else set()
