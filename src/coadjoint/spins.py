"""Crystals of spins, and files of spins (``co.spins``): sites, bonds, exchange by symmetry; OVF of micromagnetics."""

from __future__ import annotations

from coadjoint.analysis.energy_paths import minimum_energy_path
from coadjoint.analysis.hysteresis import hysteresis
from coadjoint.analysis.skyrmion_number import skyrmion_number
from coadjoint.analysis.thermal_averages import thermal_averages
from coadjoint.errors import refuse_others
from coadjoint.files.crystals.exchange import read_exchange
from coadjoint.files.crystals.magnetic_structure import magnetic_structure
from coadjoint.files.crystals.read import crystal, structure
from coadjoint.files.crystals.simulators import to_sunny, to_vampire
from coadjoint.files.ovf import read_ovf, write_ovf
from coadjoint.files.vtk import read_vtk, write_vtk
from coadjoint.systems.lattices.micromagnetic import micromagnetic
from coadjoint.systems.lattices.spin_operators import operators

__all__ = [
    "crystal",
    "hysteresis",
    "magnetic_structure",
    "micromagnetic",
    "minimum_energy_path",
    "operators",
    "read_exchange",
    "read_ovf",
    "read_vtk",
    "skyrmion_number",
    "structure",
    "thermal_averages",
    "to_sunny",
    "to_vampire",
    "write_ovf",
    "write_vtk",
]

TYPE_CHECKING = False

if not TYPE_CHECKING:  # type checkers know the names above and must report any other
    __getattr__, __dir__ = refuse_others("co.spins", __all__)
