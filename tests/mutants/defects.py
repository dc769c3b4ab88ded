"""The list of defects: small changes of one place each that a test must notice, read from the TOML files beside."""

from __future__ import annotations

import ast
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
FIELDS = {"name", "file", "old", "new", "tests", "equivalent", "compile"}


@dataclass(frozen=True)
class Defect:
    """One change of one place.

    Attributes
    ----------
    room : str
        The TOML file that it stands in.
    name : str
        What goes wrong.
    file : str
        From the root of the repository.
    old, new : str
        The text, which occurs once, and what takes its place.
    tests : tuple of str
        As pytest names them; one of them must fail.
    equivalent : str
        Why nothing can notice it; empty where something must.
    compile : tuple of str
        The C++ sources that are compiled again.
    """

    room: str
    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    equivalent: str = ""
    compile: tuple[str, ...] = ()

    def planted(self, text: str) -> str:
        """Return the text of the file with the defect; a text that does not hold `old` exactly once is an error."""
        found = text.count(self.old)
        if found != 1:
            raise ValueError(f"{self.room}: {self.name!r}: the old text occurs {found} times in {self.file}, not once")
        if self.old == self.new:
            raise ValueError(f"{self.room}: {self.name!r} changes nothing")
        return text.replace(self.old, self.new)


@cache
def defects() -> tuple[Defect, ...]:
    """Return the whole list, room after room."""
    found: list[Defect] = []
    for path in sorted(HERE.glob("*.toml")):
        for entry in tomllib.loads(path.read_text(encoding="utf-8"))["defect"]:
            if unknown := entry.keys() - FIELDS:
                raise ValueError(f"{path.name}: {entry.get('name')!r} has the unknown field {min(unknown)!r}")
            lists = {key: tuple(entry.pop(key, ())) for key in ("tests", "compile")}
            found.append(Defect(room=path.stem, **entry, **lists))
    return tuple(found)


@cache
def functions_of(file: Path) -> frozenset[str]:
    """Return the names of the functions of a file, those in classes after the name of the class and two colons."""
    names: set[str] = set()
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        inner = node.body if isinstance(node, ast.ClassDef) else [node]
        prefix = f"{node.name}::" if isinstance(node, ast.ClassDef) else ""
        names.update(prefix + each.name for each in inner if isinstance(each, ast.FunctionDef))
    return frozenset(names)


def missing_test(test: str, root: Path = ROOT) -> str:
    """Return what is wrong with the name of a test; empty where there is such a test."""
    path, _, function = test.partition("::")
    if not (root / path).is_file():
        return f"there is no file {path}"
    function = function.partition("[")[0]
    if function and path.startswith("tests/") and function not in functions_of(root / path):
        return f"{path} has no {function}"
    return ""
