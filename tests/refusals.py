"""Refused calls: the exception, and the names and values in its message."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def refused(
    error: type[BaseException] | tuple[type[BaseException], ...], *named: object
) -> Iterator[pytest.ExceptionInfo]:
    """Check that the block raises `error` with a message that contains each of `named`, in any case and order."""
    with pytest.raises(error) as caught:
        yield caught
    message = str(caught.value).casefold()
    missing = [text for text in map(str, named) if text.casefold() not in message]
    assert not missing, f"{missing} are not in the message {str(caught.value)!r}"
