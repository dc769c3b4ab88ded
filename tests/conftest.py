"""Settings of all tests."""

import signal

import pytest

from long import thin


def pytest_configure():
    """Processes in the background of a shell ignore interrupts, and so would those that tests start and interrupt."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Before cases are chosen by their marks."""
    thin(items)
