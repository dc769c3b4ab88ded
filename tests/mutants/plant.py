"""Plant drawn or listed defects, run the tests that cover them, and print those that no test notices.

Python defects are planted in a copy of the tree and tested by the tests that cover their lines, as recorded by
`make coverage`, the most specific first. C++ defects need a build each, and are tested by the tests of the kernels.
"""

from __future__ import annotations

import argparse
import ast
import compileall
import contextlib
import fnmatch
import os
import py_compile
import random
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from queue import SimpleQueue

from coverage import CoverageData

from building import Kernels
from coadjoint.kernels.library import SUFFIX, level_options, processor_level
from mutants import cpp_defects, python_defects
from mutants.defect import Defect
from structure import tracked

ROOT = Path(__file__).parents[2]
KERNEL_TESTS = (
    "tests/internal/kernels",
    "tests/public/runs/test_matrix.py",
    "tests/internal/program",
    "tests/public/runs",
    "tests/public/events",
    "tests/public/accuracy",
    "tests/public/systems",
    "tests/public/ensembles",
    "tests/public/derivatives",
)
CHUNKS = (20, 200, 2000)
"""Numbers of tests of one process: most defects are noticed by the first ones."""
DIED = "pytest did not end"
NOTICED, SURVIVED, UNCOVERED, INVALID = "noticed", "SURVIVED", "NOT COVERED", "invalid"


def defects_in(tree: Path, patterns: Sequence[str]) -> list[Defect]:
    """Return all defects of the sources whose paths from `src/coadjoint` match one of the patterns."""
    found: list[Defect] = []
    for path in sorted((tree / "src/coadjoint").rglob("*")):
        name = str(path.relative_to(tree / "src/coadjoint"))
        reader = {".py": python_defects, ".cpp": cpp_defects, ".hpp": cpp_defects}.get(path.suffix)
        if reader and any(fnmatch.fnmatch(name, pattern) for pattern in patterns):
            found += reader.defects_of(name, path.read_text("utf-8"))
    return found


def drawn(found: Iterable[Defect], seed: int) -> Iterator[Defect]:
    """Yield defects in random order: a kind, a file with defects of this kind, and one of them, all equally likely."""
    groups: dict[str, dict[str, list[Defect]]] = {}
    for defect in found:
        groups.setdefault(defect.kind, {}).setdefault(defect.file, []).append(defect)
    generator = random.Random(seed)
    while groups:
        kind = generator.choice(sorted(groups))
        file = generator.choice(sorted(groups[kind]))
        own = groups[kind][file]
        yield own.pop(generator.randrange(len(own)))
        if not own:
            del groups[kind][file]
        if not groups[kind]:
            del groups[kind]


def listed(found: Iterable[Defect], path: Path) -> list[Defect]:
    """Return the defects whose addresses a file lists; ValueError names those that no longer exist."""
    known = {defect.address: defect for defect in found}
    lines = [line.partition("#")[0].strip() for line in path.read_text("utf-8").splitlines()]
    addresses = [line for line in lines if line]
    if missing := [address for address in addresses if address not in known]:
        raise ValueError(f"{path.name} lists defects whose functions have changed: {missing}")
    return [known[address] for address in addresses]


class Coverage:
    """Which tests cover which lines."""

    def __init__(self, path: Path) -> None:
        if not path.exists():
            raise FileNotFoundError(f"{path} does not exist: run `make coverage` first")
        self.path, self.data = path, CoverageData(str(path))
        self.data.read()
        self.files = {
            Path(name).as_posix().rpartition("/src/coadjoint/")[2]: name for name in self.data.measured_files()
        }

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Number of lines or branches that each test covers."""
        sizes: dict[str, int] = {}
        table, size = ("arc", "1") if self.data.has_arcs() else ("line_bits", "length(numbits)")
        query = f"select context, total from context join (select context_id, sum({size}) as total from {table} "
        with contextlib.closing(sqlite3.connect(self.path)) as connection:
            for context, total in connection.execute(query + "group by context_id) on context.id = context_id"):
                test = context.partition("|")[0]
                sizes[test] = sizes.get(test, 0) + total
        return sizes

    def tests(self, defect: Defect, text: bytes) -> list[str]:
        """Return the tests that cover a defect, the most specific first.

        Lines that run on import count as covered where the body of their function is, or else any line of their file.
        """
        if (name := self.files.get(defect.file)) is None:
            return []
        by_line = self.data.contexts_by_lineno(name)
        lines: Iterable[int] = by_line
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef) and node.lineno <= defect.first_line <= (node.end_lineno or 0):
                body = range(node.body[0].lineno, (node.end_lineno or 0) + 1)
                lines = range(defect.first_line, defect.last_line + 1) if defect.first_line in body else body
        found = {one.partition("|")[0] for line in lines for one in by_line.get(line, ()) if one}
        return sorted(found, key=lambda test: (self.sizes[test], test))


class Copy:
    """A copy of a tree, in which defects are planted."""

    def __init__(self, tree: Path, folder: Path, compiled: bool) -> None:
        self.root = folder
        for path in [*tracked(tree), *(tree / "src/coadjoint/kernels").glob(f"*{SUFFIX}")]:
            copy = folder / path.relative_to(tree)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(path, copy)
        # By the hash of the source: a defect of the same length within the same second would be read from the cache.
        compileall.compile_dir(folder / "src", quiet=2, invalidation_mode=py_compile.PycInvalidationMode.CHECKED_HASH)
        # Without the optimizations that take most of the time of a build: bits do not depend on them.
        tuning = ["-O1" if option == "-O3" else option for option in level_options(processor_level())]
        self.kernels = Kernels(folder, tuning=tuning) if compiled else None
        if self.kernels is not None and (message := self.kernels.build()):
            raise RuntimeError(f"the kernels cannot be built: {message}")
        self.unreliable: set[str] = set()

    def pytest(self, tests: Sequence[str], seconds: float) -> tuple[list[str], bool]:
        """Run tests; return those that failed, at most one, and whether there was time for all."""
        file = self.root / "chosen_tests.txt"
        file.write_text("\n".join(tests), encoding="utf-8")
        paths = {"PYTHONPATH": str(self.root / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-rfE", "-p", "no:cacheprovider", "-m", "not long"]
        process = subprocess.Popen(
            [*command, *(f"--deselect={test}" for test in sorted(self.unreliable)), f"@{file}"],
            cwd=self.root,
            env=os.environ | paths,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        try:
            output, _ = process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, 9)
            process.communicate()
            return [], False
        if process.returncode in (0, 5):  # passed, or all deselected
            return [], True
        names = [
            line.split(" ", 1)[1].partition(" - ")[0]
            for line in output.splitlines()
            if line[:6] in ("FAILED", "ERROR ")
        ]
        return names[:1] or [DIED], True

    def noticed(self, tests: Sequence[str], seconds: float, passes_without: Callable[[Sequence[str]], bool]) -> str:
        """Return the test that notices the planted defect, or an empty string."""
        end, remaining, sizes = time.monotonic() + seconds, list(tests), list(CHUNKS)
        while remaining and time.monotonic() < end:
            size = sizes.pop(0) if sizes else len(remaining)
            failed, complete = self.pytest(remaining[:size], end - time.monotonic())
            if not complete:
                return "no end" if len(remaining) == len(tests) else ""
            if not failed:
                remaining = remaining[size:]
            elif failed == [DIED] or passes_without(failed):
                return failed[0]
            else:
                self.unreliable.update(failed)
                sizes.insert(0, size)
        return ""

    def verdict(self, defect: Defect, tests: Sequence[str], seconds: float) -> tuple[str, str]:
        """Plant a defect and run tests; restore the source; return the verdict, and the test or the reason."""
        path = self.root / "src/coadjoint" / defect.file
        text = path.read_bytes()
        compiled = self.kernels is not None and path.suffix != ".py"
        sources = self.kernels.including(path) if compiled else ()
        objects = self.kernels.keep(sources) if compiled else {}
        loaded = Path(self.kernels.library) if compiled else path
        original = loaded.read_bytes()

        def written(content: bytes) -> str:
            path.write_bytes(content)
            return self.kernels.build(sources) if compiled else ""

        def passes_without(failed: Sequence[str]) -> bool:
            """Return whether the tests that failed pass without the defect."""
            planted = loaded.read_bytes()
            loaded.write_bytes(original)
            again, complete = self.pytest(failed, seconds)
            loaded.write_bytes(planted)
            return complete and not again

        try:
            if message := written(defect.planted(text)):
                return INVALID, message[:100]
            test = self.noticed(tests, seconds, passes_without)
        finally:
            path.write_bytes(text)
            if compiled:
                self.kernels.restore(sources, objects)
        return (NOTICED, test) if test else (SURVIVED, f"{len(tests)} tests")


def main(arguments: Sequence[str] | None = None) -> int:
    """Return 0 if all defects were noticed, else 1."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "files", nargs="*", default=["*.py"], help="patterns of paths from src/coadjoint; all of Python"
    )
    parser.add_argument("--count", type=int, default=100, help="number of defects to draw")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--listed", type=Path, help="a file of addresses, instead of drawing")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="number of copies used in parallel")
    parser.add_argument("--seconds", type=float, default=150.0, help="time limit for the tests of one defect")
    parser.add_argument("--tree", type=Path, default=ROOT, help="the checkout to copy")
    parser.add_argument("--coverage", type=Path, help="recorded by `make coverage`")
    parser.add_argument("--tests", nargs="*", default=KERNEL_TESTS, help="tests of defects in C++")
    options = parser.parse_args(arguments)
    found = defects_in(options.tree, options.files)
    chosen = listed(found, options.listed) if options.listed else drawn(found, options.seed)
    coverage = None
    counts = dict.fromkeys((NOTICED, SURVIVED, UNCOVERED, INVALID), 0)
    missed: list[str] = []
    with tempfile.TemporaryDirectory(prefix="defects-") as folder:
        copies: SimpleQueue[Copy] = SimpleQueue()
        compiled = any(not defect.file.endswith(".py") for defect in found)
        for number in range(options.jobs):
            copies.put(Copy(options.tree, Path(folder) / str(number), compiled))

        def tested(defect: Defect, tests: Sequence[str]) -> tuple[Defect, str, str, float]:
            began, copy = time.monotonic(), copies.get()
            try:
                verdict, reason = copy.verdict(defect, tests, options.seconds) if tests else (UNCOVERED, "")
                return defect, verdict, reason, time.monotonic() - began
            finally:
                copies.put(copy)

        with ThreadPoolExecutor(options.jobs) as pool:
            waiting = []
            for defect in chosen:
                text = (options.tree / "src/coadjoint" / defect.file).read_bytes()
                if defect.file.endswith(".py"):
                    try:
                        compile(defect.planted(text), defect.file, "exec")
                    except SyntaxError:
                        continue
                    recorded = options.coverage or options.tree / "build" / "coverage" / "tests"
                    coverage = coverage or Coverage(recorded)
                    tests = coverage.tests(defect, text)
                else:
                    tests = list(options.tests)
                waiting.append(pool.submit(tested, defect, tests))
                if not options.listed and len(waiting) == options.count:
                    break
            for future in waiting:
                defect, verdict, reason, seconds = future.result()
                counts[verdict] += 1
                print(f"{verdict:11} {seconds:5.1f} s  {defect.address}  ({reason})", flush=True)
                if verdict in (SURVIVED, UNCOVERED):
                    text = (options.tree / "src/coadjoint" / defect.file).read_bytes()
                    missed.append(f"{verdict}: {defect.address}\n{defect.shown(text)}\n")
    print("\n".join([", ".join(f"{count} {verdict}" for verdict, count in counts.items()), "", *missed]))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
