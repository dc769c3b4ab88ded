"""The numerical schemes: base classes for user-defined schemes, and the registry of schemes by name.

Each scheme is a frozen dataclass with its parameters and a declaration of what it preserves.
"""

from __future__ import annotations

from coadjoint.shortcuts import attach

# The names are listed in __init__.pyi.
__getattr__, __dir__, __all__ = attach("coadjoint.methods", __file__, "co.methods")
