"""Forces, which act in addition to the Hamiltonian: damping, torques, heat baths (``co.forces``).

A force breaks the Lie-Poisson structure and declares what it preserves. ``system.with_forces(force, ...)`` adds it to a
system.
"""

from __future__ import annotations

from coadjoint.shortcuts import attach

# The names are listed in __init__.pyi.
__getattr__, __dir__, __all__ = attach("coadjoint.systems.forces", __file__, "co.forces")
