"""Figures of the source tree: sizes, concepts, imports and cycles (`python tests/structure.py`).

Nothing is imported or run: the files that git tracks are parsed. `MAXIMA` is the budget that a test checks.
"""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
ENTRY = "coadjoint.runs.integrate"
NAMED = re.compile(r'"(\w+)": "(coadjoint(?:\.\w+)+):\w+"')  # a function of a later layer, imported on first use
CALLED = re.compile(r'\bshortcut\("(\w+)"\)')
INTERNAL = re.compile(r"^\s*from coadjoint\.\w+", re.MULTILINE)

# With slack: the next thousand lines, the next ten of what is counted. A change that raises a number says in a comment
# beside it what users gain.
MAXIMA: dict[str, int] = {
    "Python files": 532,  # spins of SU(N), scattering, loops and barriers, files of simulators, PyTorch: a file each
    "Python lines": 125_000,  # the same: what users of SpinW, Sunny, mumax3, planets and of learned forces look for
    "longest file": 700,
    "isinstance": 640,  # values of files of others, energies and params of users
    "calls by text": 10,  # `sol.to_ovf` writes files
    "files in cycles, with calls by text and imports inside functions and for types": 70,
    "modules behind integrate": 102,
    "C++ lines": 28_500,  # derivatives of forces, of matrices and of their noise; fluids, dipoles, planets in a browser
    "test lines": 89_500,  # with what they test, derivatives of forces on matrices and of batches last
    "test files that import internals": 80,
}


class Import(NamedTuple):
    """An import of a module of the package: inside a function, or only for types."""

    module: str
    inside: bool
    typing: bool


def tracked(root: Path = ROOT) -> list[Path]:
    """Return the files that git tracks; all files outside of a repository."""
    command = ["git", "-C", str(root), "ls-files", "--cached", "--others", "--exclude-standard"]
    try:
        names = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    except (OSError, subprocess.CalledProcessError):
        return sorted(path for path in root.rglob("*") if path.is_file())
    return sorted(path for name in names if (path := root / name).is_file())


def line_count(paths: Iterable[Path]) -> int:
    return sum(path.read_text("utf-8").count("\n") for path in paths)


def module_name(path: Path, root: Path = ROOT) -> str:
    """Return the dotted name of a file of the package."""
    parts = path.relative_to(root / "src").with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports_of(tree: ast.AST, own: str, modules: Iterable[str]) -> Iterator[Import]:
    """Yield the imports of modules of the package in a syntax tree."""
    known = set(modules)
    pending = [(tree, False, False)]
    while pending:
        node, inside, typing = pending.pop()
        inside = inside or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        typing = typing or (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test))
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            deeper = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if name in known else str(node.module) for name in deeper]
        yield from (Import(name, inside, typing) for name in dict.fromkeys(names) if name in known and name != own)
        for block in ("body", "orelse", "finalbody", "handlers", "cases"):  # imports are statements
            pending += [(child, inside, typing) for child in getattr(node, block, [])]


def imports_by_text(texts: dict[str, str]) -> dict[str, set[str]]:
    """Return the modules whose functions are called by their names in a table, such as that of `shortcuts.py`."""
    targets = dict(found for text in texts.values() for found in NAMED.findall(text))
    return {name: {targets[called] for called in CALLED.findall(text)} for name, text in texts.items()}


def reached(start: str, graph: dict[str, set[str]]) -> set[str]:
    """Return the modules that are imported with one."""
    found: set[str] = set()
    pending = [start]
    while pending:
        name = pending.pop()
        if name not in found:
            found.add(name)
            pending += graph.get(name, ())
    return found


def cycles(graph: dict[str, set[str]]) -> list[set[str]]:
    """Return the largest sets of modules each of which imports every other, directly or not."""
    behind = {name: reached(name, graph) for name in graph}
    found: list[set[str]] = []
    done: set[str] = set()
    for name in graph:
        if name not in done:
            ring = {other for other in behind[name] if name in behind[other]}
            done |= ring
            found += [ring] if len(ring) > 1 else []
    return sorted(found, key=len, reverse=True)


def figures(root: Path = ROOT) -> dict[str, int]:
    """Return the figures by name."""
    files = tracked(root)
    python = [path for path in files if path.suffix == ".py" and path.is_relative_to(root / "src")]
    cpp = [path for path in files if path.suffix in (".cpp", ".hpp") and path.is_relative_to(root / "src")]
    tests = [path for path in files if path.suffix == ".py" and path.is_relative_to(root / "tests")]
    pages = [path for path in files if path.suffix == ".md" and path.is_relative_to(root / "docs")]
    modules = {module_name(path, root): path for path in python}
    texts = {name: path.read_text("utf-8") for name, path in modules.items()}
    trees = {name: ast.parse(text) for name, text in texts.items()}
    imports = {name: list(imports_of(tree, name, modules)) for name, tree in trees.items()}
    nodes = [node for tree in trees.values() for node in ast.walk(tree)]
    on_import = {n: {one.module for one in found if not one.inside and not one.typing} for n, found in imports.items()}
    by_text = imports_by_text(texts)
    rings = cycles({name: {one.module for one in found} | by_text[name] for name, found in imports.items()})
    behind = reached(ENTRY, on_import)
    functions = [node for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    return {
        "Python files": len(python),
        "Python lines": line_count(python),
        "folders": len({path.parent for path in python}),
        "longest file": max(line_count([path]) for path in python),
        "longest function": max((node.end_lineno or 0) - node.lineno + 1 for node in functions),
        "classes": sum(isinstance(node, ast.ClassDef) for node in nodes),
        "isinstance": sum(getattr(getattr(node, "func", None), "id", "") == "isinstance" for node in nodes),
        "imports inside functions": sum(one.inside and not one.typing for found in imports.values() for one in found),
        "import cycles": len(cycles(on_import)),
        "calls by text": sum(len(NAMED.findall(text)) for text in texts.values()),
        "files in cycles, with calls by text and imports inside functions and for types": sum(map(len, rings)),
        "modules behind integrate": len(behind),
        "lines behind integrate": line_count(modules[name] for name in behind),
        "C++ files": len(cpp),
        "C++ lines": line_count(cpp),
        "test files": len(tests),
        "test lines": line_count(tests),
        "test files that import internals": sum(bool(INTERNAL.search(path.read_text("utf-8"))) for path in tests),
        "public names": len(re.findall(r"^\| `", (root / "docs" / "api.md").read_text("utf-8"), re.MULTILINE)),
        "doc pages": len(pages),
        "doc page lines": line_count(pages),
    }


if __name__ == "__main__":
    for name, value in figures().items():
        print(f"{value:>8}  {name}" + (f"  (at most {MAXIMA[name]})" if name in MAXIMA else ""))
