"""Names found on first use: public names of packages, functions of later layers, and attributes of a field."""

from __future__ import annotations

import importlib
from operator import attrgetter

import lazy_loader

from coadjoint.rounding import in_standard_mode

TYPE_CHECKING = False

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

SHORTCUTS = {
    "archive_run": "coadjoint.files.archives.resume:archive_run",
    "choose": "coadjoint.choosing.accuracy:choose",
    "dataset_of": "coadjoint.files.datasets.export:dataset_of",
    "draw_result": "coadjoint.pictures.analysis_figures:draw_result",
    "draw_solution": "coadjoint.pictures.solution:draw_solution",
    "frames_of": "coadjoint.pictures.solution:frames_of",
    "modified_hamiltonian": "coadjoint.analysis.backward_error.modified_hamiltonian:modified_hamiltonian",
    "ovf_of_run": "coadjoint.files.ovf:ovf_of_run",
    "run_to_accuracy": "coadjoint.choosing.validated_run:SampledRun",
    "save_movie": "coadjoint.files.output.output_files:save_movie",
}
"""Name -> "module:function"."""


def of(path: str) -> Any:
    """Return a property that is an attribute or a method of an object in a field, such as "base.order"."""
    return property(attrgetter(path), doc=f"That of `{path.partition('.')[0]}`.")


def shortcut(name: str) -> Any:
    """Return the function of a later layer that is registered under a name; it is imported on first use."""
    module, _, function = SHORTCUTS[name].partition(":")
    return getattr(importlib.import_module(module), function)


def attach(package: str, file: str, shown: str = "") -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package; `shown` is its name in error messages."""
    resolve, _, names = lazy_loader.attach_stub(package, file)
    # Modules compute constants when they are imported, and their compiled files are kept.
    resolve = in_standard_mode(resolve)

    def __getattr__(name: str) -> Any:
        if name not in names:
            from coadjoint.errors import unknown_attribute
            from coadjoint.keyword_hints import unknown_function

            elsewhere = unknown_function(name) if package == "coadjoint" else None
            raise elsewhere or unknown_attribute(shown or package, name, names)
        return resolve(name)

    def __dir__() -> list[str]:
        return sorted(names)

    return __getattr__, __dir__, names
