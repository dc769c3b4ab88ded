"""Orbits, and what acts along them, as functions of the time that forces on satellites take (``co.orbits``)."""

from __future__ import annotations

from coadjoint.errors import refuse_others
from coadjoint.files.orbits.oem import read_oem
from coadjoint.systems.orbits.epochs import Epoch
from coadjoint.systems.orbits.kepler import circular, kepler
from coadjoint.systems.orbits.magnetic_field import igrf, tilted_dipole
from coadjoint.systems.orbits.orbit import EARTH, Orbit, OrbitStates, Planet
from coadjoint.systems.orbits.samples import from_samples
from coadjoint.systems.orbits.tle import from_tle

__all__ = [
    "EARTH",
    "Epoch",
    "Orbit",
    "OrbitStates",
    "Planet",
    "circular",
    "from_samples",
    "from_tle",
    "igrf",
    "kepler",
    "read_oem",
    "tilted_dipole",
]

TYPE_CHECKING = False

if not TYPE_CHECKING:  # type checkers know the names above and must report any other
    __getattr__, __dir__ = refuse_others("co.orbits", __all__)
