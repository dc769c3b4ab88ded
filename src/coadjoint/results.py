"""Stored runs: read them, and repeat them from what is stored (``co.results``)."""

from __future__ import annotations

from coadjoint.errors import unknown_attribute
from coadjoint.files.datasets.export import dataset_of, mark_failed, rebuild, solution_inputs
from coadjoint.files.datasets.loaded_solution import load

__all__ = ["dataset_of", "load", "mark_failed", "rebuild", "solution_inputs"]

TYPE_CHECKING = False

if not TYPE_CHECKING:  # type checkers know the names above and must report any other

    def __getattr__(name: str) -> None:
        raise unknown_attribute("co.results", name, __all__)


def __dir__() -> list[str]:
    return __all__
