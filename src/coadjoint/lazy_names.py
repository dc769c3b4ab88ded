"""Public names of packages and modules: lazy ones, listed in a stub file, and the error for any other name."""

from __future__ import annotations

import lazy_loader

TYPE_CHECKING = False

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any


def attach(package: str, file: str, shown: str = "") -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package; `shown` is its name in error messages."""
    resolve, _, names = lazy_loader.attach_stub(package, file)

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


def refuse_others(shown: str, names: list[str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a module with these public names; `shown` is its name in messages."""

    def __getattr__(name: str) -> Any:
        from coadjoint.errors import unknown_attribute

        raise unknown_attribute(shown, name, names)

    return __getattr__, lambda: names
