"""Logs of attitudes: readers and writers of their files (``co.attitudes``)."""

from __future__ import annotations

from coadjoint.errors import refuse_others
from coadjoint.files.attitudes.attitude_log import AttitudeLog
from coadjoint.files.attitudes.reading import read, write

__all__ = ["AttitudeLog", "read", "write"]

TYPE_CHECKING = False

if not TYPE_CHECKING:  # type checkers know the names above and must report any other
    __getattr__, __dir__ = refuse_others("co.attitudes", __all__)
