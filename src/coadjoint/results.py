"""Stored runs: read them, and repeat them from what is stored (``co.results``)."""

from __future__ import annotations

from coadjoint.errors import refuse_others
from coadjoint.files.datasets.export import dataset_of, mark_failed
from coadjoint.files.datasets.loaded_solution import load, rebuild, solution_inputs

__all__ = ["dataset_of", "load", "mark_failed", "rebuild", "solution_inputs"]

TYPE_CHECKING = False

if not TYPE_CHECKING:  # type checkers know the names above and must report any other
    __getattr__, __dir__ = refuse_others("co.results", __all__)
