"""Public import path of `growth`; the code is in `coadjoint.analysis.fits`."""

from coadjoint.analysis.fits import Growth, growth

__all__ = ["Growth", "growth"]
