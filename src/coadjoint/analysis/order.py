"""Public import path of `fit_order`; the code is in `coadjoint.analysis.fits`."""

from coadjoint.analysis.fits import OrderFit, fit_order

__all__ = ["OrderFit", "fit_order"]
