"""Settings of all tests."""

import gc
import os
import signal

import pytest

from long import thin

collect_ignore = ["browsed"]  # programs of `make site-test`, which has a browser


def pytest_configure():
    """Let tests interrupt processes, also if they run in the background of a shell, which ignores interrupts."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark thinned cases before pytest selects by marks."""
    thin(items)


def pytest_collection_finish():
    """Exclude collected tests, which live to the end, from garbage collections, which are rarer than usual."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)


@pytest.fixture
def no_fsync(monkeypatch):
    """Do not wait for the disk."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


@pytest.fixture
def compiled(monkeypatch):
    """The functions that Numba has compiled during a test."""
    import numba

    found, original = [], numba.cfunc

    def counting(*given, **options):
        found.append(given)
        return original(*given, **options)

    monkeypatch.setattr(numba, "cfunc", counting)
    return found


@pytest.fixture
def tables_built(monkeypatch):
    """A list of an entry for each flow table or table of forces that is built for a loop."""
    from coadjoint.methods.forced import Forced
    from coadjoint.methods.protocol.flow_method import FlowMethod

    built = []
    for kind in (FlowMethod, Forced):
        original = kind.compiled

        def compiled(self, system, h, representation, original=original):
            built.append(system)
            return original(self, system, h, representation)

        monkeypatch.setattr(kind, "compiled", compiled)
    return built
