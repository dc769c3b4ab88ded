"""Reference pages: one for each public name, from its docstring; `docs/api.md` lists and groups them."""

from __future__ import annotations

import inspect
import types
from typing import Any

import write_api

import coadjoint as co

SPACES = "", *(f"{name}." for name in ("algebras", *(space for _, space in write_api.NAMESPACES)))


def reference_pages(written: set[str]) -> tuple[dict[str, str], dict[str, str]]:
    """Return pages by their paths, and the page of each name of `docs/api.md`, without those already written."""
    members = {kind: names for _, kind, names in write_api.MEMBERS_OF}
    pages: dict[str, str] = {}
    targets: dict[str, str] = {}
    known: dict[int, str] = {}
    for space in SPACES:
        module = eval(f"co.{space}".removesuffix("."), {"co": co})
        for name in sorted(dir(module)):
            value = getattr(module, name)
            if isinstance(value, str | types.ModuleType):
                continue
            path = known.get(id(value)) or _existing(name, written)
            if path is None:
                path = _path(f"coadjoint.{space}{name}", value)
                pages[path] = _page(f"coadjoint.{space}{name}", value, members.get(value) if _is_class(value) else None)
            known[id(value)] = path
            targets[f"co.{space}{name}"] = path
            if _is_class(value):
                targets.setdefault(value.__name__, path)
    for kind, names in members.items():
        if kind.__name__ not in targets:
            qualified = f"{kind.__module__}.{kind.__qualname__}"
            path = _path(qualified, kind)
            pages[path] = _page(qualified, kind, names)
            targets[kind.__name__] = path
    pages["reference/index.rst"] = _index(pages)
    return pages, targets


def _existing(name: str, written: set[str]) -> str | None:
    """Return the page of a system or scheme of this name."""
    return next((f"{path}.md" for path in (f"systems/{name}", f"schemes/{name}") if path in written), None)


def _path(qualified: str, value: Any) -> str:
    """Return the path of a page; classes have their own folder, since file systems may ignore case."""
    return f"reference/{'classes/' if _is_class(value) else ''}{qualified}.rst"


def _is_class(value: Any) -> bool:
    return inspect.isclass(value)


def _page(qualified: str, value: Any, members: str | None) -> str:
    title = f"co.{qualified.removeprefix('coadjoint.')}" if qualified.count(".") < 3 else qualified.rpartition(".")[2]
    lines = [title, "=" * len(title), ""]
    if _is_class(value):
        lines.append(f".. autoclass:: {qualified}")
        if members is None:
            lines.append("   :members:")
        elif members:
            lines.append(f"   :members: {', '.join(members.split())}")
    elif callable(value):
        lines.append(f".. autofunction:: {qualified}")
    else:
        lines.append(f".. autodata:: {qualified}")
    return "\n".join([*lines, ""])


def _index(pages: dict[str, str]) -> str:
    paths = sorted((path.removeprefix("reference/").removesuffix(".rst") for path in pages), key=str.lower)
    title = "Pages of public names"
    heading = [title, "=" * len(title), "", "A page of each public name.", ""]
    return "\n".join([*heading, ".. toctree::", "   :maxdepth: 1", "", *(f"   {p}" for p in paths), ""])
