"""Check-cases for simulators of rotations: problems with certain answers, and comparison of files with them."""

from __future__ import annotations

from coadjoint.shortcuts import attach

# The names are listed in __init__.pyi.
__getattr__, __dir__, __all__ = attach("coadjoint.checkcases", __file__, "co.checkcases")
