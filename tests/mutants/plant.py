"""Plant each defect in a copy of the tree, run the tests that should notice it, and print the survivors."""

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
        """Return a copy of the files that the tests need; build its kernels if a defect changes them."""
        for name in COPIED:
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
            elif (ROOT / name).exists():
                shutil.copy2(ROOT / name, folder / name)
        # By the hash of the source: a defect of the same length within the same second would be read from the cache.
        mode = py_compile.PycInvalidationMode.CHECKED_HASH
        compileall.compile_dir(folder / "src", quiet=2, invalidation_mode=mode)
        kernels = Kernels(folder) if compiled else None
        if kernels is not None and (message := kernels.build()):
            raise RuntimeError(f"the kernels cannot be built: {message}")
        return cls(folder, kernels)

    def copied(self, folder: Path) -> Tree:
        """Return a copy of this tree."""
        shutil.copytree(self.root, folder)
        return Tree(folder, None if self.kernels is None else Kernels(folder))

    def pytest(self, tests: Iterable[str], seconds: float) -> tuple[int, str]:
        """Run tests; return pytest's exit status, 0 if all passed, and its output. A timeout is a failure."""
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
        """Plant a defect, run its tests, and restore the source; return the verdict and its reason."""
        path = self.root / defect.file
        text = path.read_text(encoding="utf-8")
        objects = self.kernels.keep(defect.compile) if self.kernels is not None and defect.compile else {}
        try:
            path.write_text(defect.planted(text), encoding="utf-8")
            if objects and self.kernels is not None and (message := self.kernels.build(defect.compile)):
                return WRONG, f"it does not compile: {message}"
            status, output = self.pytest(defect.tests, seconds)
        finally:
            path.write_text(text, encoding="utf-8")
            if objects and self.kernels is not None:
                self.kernels.restore(defect.compile, objects)
        if status == 0:
            return (EQUIVALENT if defect.equivalent else SURVIVED), defect.equivalent
        if status > STOPPED:
            return WRONG, f"pytest ended with status {status}: {output[-500:]}"
        if defect.equivalent:
            return WRONG, f"it is listed as equivalent ({defect.equivalent}), but is noticed: {_failure(output)}"
        return NOTICED, _failure(output)


def _failure(output: str) -> str:
    lines = [line for line in output.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return lines[0] if lines else output.strip().rpartition("\n")[2]


def check(chosen: Sequence[Defect]) -> None:
    """Raise ValueError if a defect does not fit the sources or a test is missing."""
    for defect in chosen:
        defect.planted((ROOT / defect.file).read_text(encoding="utf-8"))
        for test in defect.tests:
            if wrong := missing_test(test):
                raise ValueError(f"{defect.folder}: {defect.name!r}: {wrong}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Return 0 if all defects were noticed or are listed as equivalent, else 1."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("only", nargs="*", help="folders, or words in the names of defects; all by default")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="number of trees used in parallel")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="time limit for the tests of one defect")
    options = parser.parse_args(arguments)
    chosen = [d for d in defects() if not options.only or any(w == d.folder or w in d.name for w in options.only)]
    if not chosen:
        print("no defect has such a name")
        return 1
    check(chosen)
    compiled = any(defect.compile for defect in chosen)
    counts = dict.fromkeys((NOTICED, SURVIVED, EQUIVALENT, WRONG), 0)
    remaining: list[tuple[str, Defect, str]] = []
    with tempfile.TemporaryDirectory(prefix="defects-") as folder:
        first = Tree.of_checkout(Path(folder) / "0", compiled)
        tests = sorted({test for defect in chosen for test in defect.tests})
        status, output = first.pytest(tests, 20 * options.seconds)
        if status:
            print(output)
            print("the tests fail without a defect")
            return 1
        trees: SimpleQueue[Tree] = SimpleQueue()
        trees.put(first)
        for number in range(1, min(options.jobs, len(chosen))):
            trees.put(first.copied(Path(folder) / str(number)))

        def tested(defect: Defect) -> tuple[Defect, str, str, float]:
            tree = trees.get()
            began = time.perf_counter()
            try:
                return defect, *tree.verdict(defect, options.seconds), time.perf_counter() - began
            finally:
                trees.put(tree)

        with ThreadPoolExecutor(max(1, options.jobs)) as pool:
            for defect, verdict, reason, seconds in pool.map(tested, chosen):
                counts[verdict] += 1
                print(f"{verdict:10} {seconds:5.1f} s  {defect.folder}: {defect.name}  ({reason})", flush=True)
                if verdict in (SURVIVED, WRONG):
                    remaining.append((verdict, defect, reason))
    print(", ".join(f"{count} {verdict}" for verdict, count in counts.items()))
    for verdict, defect, reason in remaining:
        print(f"{verdict}: {defect.folder}: {defect.name} in {defect.file}{f': {reason}' if reason else ''}")
    return 1 if remaining else 0


if __name__ == "__main__":
    sys.exit(main())
