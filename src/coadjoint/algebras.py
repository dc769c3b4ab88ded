"""Catalogue of Lie algebras by name, and constructions of new algebras (``co.algebras``)."""

from coadjoint.algebra import catalogue
from coadjoint.algebra.catalogue import *  # noqa: F403

__all__ = catalogue.__all__

TYPE_CHECKING = False

if not TYPE_CHECKING:  # type checkers know the names above and must report any other
    __getattr__, __dir__ = catalogue.__getattr__, catalogue.__dir__
