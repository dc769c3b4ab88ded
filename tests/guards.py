"""Guards against work that is not bounded: by processor time, which other processes and a slow disk do not change."""

import time
from contextlib import contextmanager


@contextmanager
def bounded_work(seconds=60.0):
    """Fail if a block takes more processor time than bounded work does on any machine; unbounded work takes hours."""
    began = time.process_time()
    yield
    assert time.process_time() - began < seconds
