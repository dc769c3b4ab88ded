"""Planted defects: small changes of the sources that a test must notice, read from the TOML files of this folder."""

from __future__ import annotations

import ast
import re
import tomllib
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
FIELDS = {"name", "file", "old", "new", "tests", "equivalent", "compile"}
# A number, a word, an operator or any other character; ">>" is two tokens, since it also closes two templates.
TOKEN = re.compile(
    r"\d+(?:\.\d*)?(?:[eE][+-]?\d+)?\w*|\w+"
    r"|\*\*=|//=|<<=|->|::|:=|\*\*|//|<<|&&|\|\||\+\+|--|[-+*/%&|^<>=!@]=|\S"
)


@dataclass(frozen=True)
class Defect:
    """One change in one place.

    Attributes
    ----------
    folder : str
        The TOML file, which is named for the folder of the source.
    name : str
        What goes wrong.
    file : str
        Path from the root of the repository.
    old, new : str
        The text to replace, whose tokens occur once in the file, and its replacement.
    tests : tuple of str
        As pytest names them; one of them must fail.
    equivalent : str
        Why no test can notice the defect; empty otherwise.
    compile : tuple of str
        The C++ sources to compile again.
    """

    folder: str
    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    equivalent: str = ""
    compile: tuple[str, ...] = ()

    def planted(self, text: str) -> str:
        """Return the text of the file with the defect; raise unless `old` occurs in it exactly once."""
        old, words, tokens = words_of(self.old), words_of(text), tokens_of(text)
        starts = [i for i in range(len(words) - len(old) + 1) if words[i : i + len(old)] == old]
        if len(starts) != 1:
            raise ValueError(f"{self.folder}: {self.name!r}: `old` occurs {len(starts)} times in {self.file}, not once")
        if old == words_of(self.new):
            raise ValueError(f"{self.folder}: {self.name!r} changes nothing")
        begin, end = tokens[starts[0]].start(), tokens[starts[0] + len(old) - 1].end()
        line = text[text.rfind("\n", 0, begin) + 1 : begin]
        indentation = line[: len(line) - len(line.lstrip())]
        return text[:begin] + self.new.replace("\n", f"\n{indentation}") + text[end:]


@lru_cache(maxsize=4)
def tokens_of(text: str) -> tuple[re.Match[str], ...]:
    """Return the tokens of a source, without trailing commas before closing brackets."""
    found = list(TOKEN.finditer(text))
    closes = [each.group() in {")", "]", "}"} for each in found[1:]]
    trailing = {i for i, closing in enumerate(closes) if closing and found[i].group() == ","}
    return tuple(each for i, each in enumerate(found) if i not in trailing)


@lru_cache(maxsize=4)
def words_of(text: str) -> tuple[str, ...]:
    """Return the texts of the tokens of a source."""
    return tuple(each.group() for each in tokens_of(text))


@cache
def defects() -> tuple[Defect, ...]:
    """Return the list of all folders."""
    found: list[Defect] = []
    for path in sorted(HERE.glob("*.toml")):
        for entry in tomllib.loads(path.read_text(encoding="utf-8"))["defect"]:
            if unknown := entry.keys() - FIELDS:
                raise ValueError(f"{path.name}: {entry.get('name')!r} has the unknown field {min(unknown)!r}")
            lists = {key: tuple(entry.pop(key, ())) for key in ("tests", "compile")}
            found.append(Defect(folder=path.stem, **entry, **lists))
    return tuple(found)


@cache
def functions_of(file: Path) -> frozenset[str]:
    """Return the names of the functions of a file; methods are written `Class::name`."""
    names: set[str] = set()
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        inner = node.body if isinstance(node, ast.ClassDef) else [node]
        prefix = f"{node.name}::" if isinstance(node, ast.ClassDef) else ""
        names.update(prefix + each.name for each in inner if isinstance(each, ast.FunctionDef))
    return frozenset(names)


def missing_test(test: str, root: Path = ROOT) -> str:
    """Return why there is no such test; empty if it exists."""
    path, _, function = test.partition("::")
    if not (root / path).is_file():
        return f"there is no file {path}"
    function = function.partition("[")[0]
    if function and path.startswith("tests/") and function not in functions_of(root / path):
        return f"{path} has no {function}"
    return ""
