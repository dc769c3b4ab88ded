"""Public import path of `slope`; the code is in `coadjoint.analysis.fits`."""

from coadjoint.analysis.fits import Slope, slope

__all__ = ["Slope", "slope"]
