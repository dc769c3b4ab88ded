"""Bodies from files: mass properties of URDF, SDF, MJCF and meshes (``co.bodies``)."""

from __future__ import annotations

from coadjoint.errors import refuse_others
from coadjoint.files.bodies.read import read
from coadjoint.systems.bodies.mass_properties import MassProperties

__all__ = ["MassProperties", "read"]

TYPE_CHECKING = False

if not TYPE_CHECKING:  # type checkers know the names above and must report any other
    __getattr__, __dir__ = refuse_others("co.bodies", __all__)
