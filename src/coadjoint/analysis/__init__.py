"""Analysis of schemes and runs: periods, phase errors, growth of deviations, orders, round-off (``co.analysis``)."""

from __future__ import annotations

from coadjoint.shortcuts import attach

# The names are listed in __init__.pyi.
__getattr__, __dir__, __all__ = attach("coadjoint.analysis", __file__, "co.analysis")
