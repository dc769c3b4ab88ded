"""Plants each defect of the list in a copy of the tree, runs the tests that should notice it, and prints survivors."""

from __future__ import annotations

import argparse
import compileall
import os
import py_compile
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue

from building import Kernels
from mutants.defects import ROOT, Defect, defects, missing_test

SECONDS = 300.0
COPIED = ("src", "tests", "docs", "examples", "README.md", "pyproject.toml")
NOTICED, SURVIVED, EQUIVALENT, WRONG = "noticed", "SURVIVED", "equivalent", "WRONG"
# Exit statuses of pytest: a test failed, or its file could not be read; the others say that it was called wrongly.
FAILED, STOPPED = 1, 2


class Tree:
    """A copy of the checkout in a temporary folder."""

    def __init__(self, root: Path, kernels: Kernels | None) -> None:
        self.root, self.kernels = root, kernels

    @classmethod
    def of_checkout(cls, folder: Path, compiled: bool) -> Tree:
        """Return a copy of what the tests need, its kernels built if they are to change."""
        for name in COPIED:
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
            elif (ROOT / name).exists():
                shutil.copy2(ROOT / name, folder / name)
        # By the hash of the source: a defect of the same length within the same second would be read from the cache.
        mode = py_compile.PycInvalidationMode.CHECKED_HASH
        compileall.compile_dir(folder / "src", quiet=2, invalidation_mode=mode)
        kernels = Kernels(folder) if compiled else None
        if kernels is not None and (said := kernels.build()):
            raise RuntimeError(f"the kernels cannot be built: {said}")
        return cls(folder, kernels)

    def again(self, folder: Path) -> Tree:
        """Return a copy of this copy."""
        shutil.copytree(self.root, folder)
        return Tree(folder, None if self.kernels is None else Kernels(folder))

    def pytest(self, tests: Iterable[str], seconds: float) -> tuple[int, str]:
        """Run tests; return pytest's exit status, 0 where all passed, and what it printed. Too long is a failure."""
        environment = {
            **os.environ,
            "PYTHONPATH": str(self.root / "src"),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
        try:
            run = subprocess.run(
                command, cwd=self.root, env=environment, capture_output=True, text=True, timeout=seconds, check=False
            )
        except subprocess.TimeoutExpired:
            return FAILED, f"longer than {seconds:g} s"
        return run.returncode, run.stdout + run.stderr

    def verdict(self, defect: Defect, seconds: float) -> tuple[str, str]:
        """Plant a defect, run its tests, and take it out again; return the verdict and what shows it."""
        place = self.root / defect.file
        text = place.read_text(encoding="utf-8")
        kept = self.kernels.keep(defect.compile) if self.kernels is not None and defect.compile else {}
        try:
            place.write_text(defect.planted(text), encoding="utf-8")
            if kept and self.kernels is not None and (said := self.kernels.build(defect.compile)):
                return WRONG, f"it does not compile: {said}"
            status, said = self.pytest(defect.tests, seconds)
        finally:
            place.write_text(text, encoding="utf-8")
            if kept and self.kernels is not None:
                self.kernels.restore(defect.compile, kept)
        if status == 0:
            return (EQUIVALENT if defect.equivalent else SURVIVED), defect.equivalent
        if status > STOPPED:
            return WRONG, f"pytest ended with status {status}: {said[-500:]}"
        if defect.equivalent:
            return WRONG, f"it is listed as equivalent ({defect.equivalent}), but is noticed: {_failure(said)}"
        return NOTICED, _failure(said)


def _failure(said: str) -> str:
    lines = [line for line in said.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return lines[0] if lines else said.strip().rpartition("\n")[2]


def checked(chosen: Sequence[Defect]) -> None:
    """Refuse a list that no longer fits the sources."""
    for defect in chosen:
        defect.planted((ROOT / defect.file).read_text(encoding="utf-8"))
        for test in defect.tests:
            if wrong := missing_test(test):
                raise ValueError(f"{defect.room}: {defect.name!r}: {wrong}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Return 0 where all defects were noticed but those that are listed as equivalent, else 1."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("only", nargs="*", help="rooms, or words in the names of defects; all by default")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="trees at work side by side")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="time for the tests of one defect")
    options = parser.parse_args(arguments)
    chosen = [d for d in defects() if not options.only or any(w == d.room or w in d.name for w in options.only)]
    if not chosen:
        print("no defect has such a name")
        return 1
    checked(chosen)
    compiled = any(defect.compile for defect in chosen)
    counts = dict.fromkeys((NOTICED, SURVIVED, EQUIVALENT, WRONG), 0)
    left: list[tuple[str, Defect, str]] = []
    with tempfile.TemporaryDirectory(prefix="defects-") as folder:
        first = Tree.of_checkout(Path(folder) / "0", compiled)
        tests = sorted({test for defect in chosen for test in defect.tests})
        status, said = first.pytest(tests, 20 * options.seconds)
        if status:
            print(said)
            print("the tests fail without a defect")
            return 1
        trees: SimpleQueue[Tree] = SimpleQueue()
        trees.put(first)
        for number in range(1, min(options.jobs, len(chosen))):
            trees.put(first.again(Path(folder) / str(number)))

        def judged(defect: Defect) -> tuple[Defect, str, str, float]:
            tree = trees.get()
            began = time.perf_counter()
            try:
                return defect, *tree.verdict(defect, options.seconds), time.perf_counter() - began
            finally:
                trees.put(tree)

        with ThreadPoolExecutor(max(1, options.jobs)) as pool:
            for defect, verdict, shown, seconds in pool.map(judged, chosen):
                counts[verdict] += 1
                print(f"{verdict:10} {seconds:5.1f} s  {defect.room}: {defect.name}  ({shown})", flush=True)
                if verdict in (SURVIVED, WRONG):
                    left.append((verdict, defect, shown))
    print(", ".join(f"{count} {verdict}" for verdict, count in counts.items()))
    for verdict, defect, shown in left:
        print(f"{verdict}: {defect.room}: {defect.name} in {defect.file}{f': {shown}' if shown else ''}")
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main())
