"""Crystals of spins: sites, bonds and exchange by symmetry (``co.spins``)."""

from __future__ import annotations

from coadjoint.errors import refuse_others
from coadjoint.files.crystals.read import crystal

__all__ = ["crystal"]

TYPE_CHECKING = False

if not TYPE_CHECKING:  # type checkers know the names above and must report any other
    __getattr__, __dir__ = refuse_others("co.spins", __all__)
