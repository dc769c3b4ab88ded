"""Correlations in space and time: structure factors of lattices, autocorrelation functions (``co.spectra``)."""

from __future__ import annotations

from coadjoint.analysis.linear_modes import LinearModes, linear_modes
from coadjoint.analysis.neutrons import Neutrons
from coadjoint.analysis.signals import Autocorrelation, autocorrelation
from coadjoint.analysis.structure_factor import StructureFactor, structure_factor
from coadjoint.analysis.wave_vectors import Plane, Powder
from coadjoint.errors import refuse_others

__all__ = [
    "Autocorrelation",
    "LinearModes",
    "Neutrons",
    "Plane",
    "Powder",
    "StructureFactor",
    "autocorrelation",
    "linear_modes",
    "structure_factor",
]

TYPE_CHECKING = False

if not TYPE_CHECKING:  # type checkers know the names above and must report any other
    __getattr__, __dir__ = refuse_others("co.spectra", __all__)
