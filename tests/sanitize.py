"""Run tests and random runs on kernels built with sanitizers: `python sanitize.py KIND`.

address: out-of-bounds accesses and undefined behaviour, over the tests of kernels, methods, runs and derivatives, and
300 random runs. threads: data races, over random ensembles and threads that share one member. Building takes some
minutes.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from building import Kernels

ROOT = Path(__file__).parents[1]
LEVEL = 3  # instructions of all current processors
QUICK = ["-O1", "-march=x86-64-v3", "-mtune=generic", "-g1", "-DCOADJOINT_UNROLLED=2"]
OPTIONS = {
    "address": ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"],
    "threads": ["-fsanitize=thread"],
}
# The interpreter is not checked: memory that it frees at exit is no leak of the kernels.
SETTINGS = {
    "ASAN_OPTIONS": "detect_leaks=0:halt_on_error=1:allocator_may_return_null=1:log_path={reports}",
    "UBSAN_OPTIONS": "halt_on_error=1:print_stacktrace=1:log_path={reports}",
    "TSAN_OPTIONS": "halt_on_error=1:exitcode=66:die_after_fork=0:suppressions={suppressions}:log_path={reports}",
    "COADJOINT_LEVEL": f"v{LEVEL}",
    "PYTHONMALLOC": "malloc",
}
# The C library frees thread-local memory by a synchronization that the sanitizer does not see.
SUPPRESSIONS = "race:_dl_deallocate_tls\n"
PRELOADED = {"address": ("libasan.so", "libubsan.so", "libstdc++.so.6"), "threads": ("libtsan.so", "libstdc++.so.6")}
PYTEST = ["-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-m", "not long"]
# Tests that start processes, interrupt them, or build the package are omitted.
OMITTED = ["--ignore=tests/internal/kernels/test_build.py", "--ignore=tests/public/runs/test_signals_during_runs.py"]
OMITTED += ["--ignore=tests/public/runs/test_memory_limits.py"]  # sanitizers reserve terabytes of addresses
TESTED = [f"tests/internal/{name}" for name in ("kernels", "methods", "runs", "derivatives")]
TESTED += ["tests/public/runs", "tests/public/accuracy", "tests/public/derivatives"]
COMMANDS = {
    "address": [
        [*PYTEST, *OMITTED, "-n", "2", *TESTED],
        ["-m", "matrix.soak", "1000000", "300", "--limit", "1200", "--jobs", "2"],
    ],
    "threads": [
        # The sanitizer does not know the threads of a forked process.
        [*PYTEST, "-k", "not forked", "tests/public/ensembles/test_threads_inside.py"],
        ["-m", "matrix.soak", "2000000", "200", "--threads", "--limit", "1200"],
    ],
}


def library_of_compiler(name: str) -> str:
    """Return the path of a library of the compiler."""
    found = subprocess.run(["g++", f"-print-file-name={name}"], capture_output=True, text=True, check=True)
    return found.stdout.strip()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=OPTIONS)
    kind = parser.parse_args().kind
    with tempfile.TemporaryDirectory(prefix="sanitize-") as folder:
        tree = Path(folder)
        for name in ("src", "tests", "docs", "examples"):
            shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
        for name in ("pyproject.toml", "README.md"):
            shutil.copy(ROOT / name, tree)
        if message := Kernels(tree, level=LEVEL, tuning=[*OPTIONS[kind], *QUICK]).build():
            print(message)
            return 1
        print(f"built for {kind}", flush=True)
        preloaded = " ".join(library_of_compiler(name) for name in PRELOADED[kind])
        (tree / "suppressions").write_text(SUPPRESSIONS)
        # In files, since pytest captures what processes write.
        files = {"suppressions": tree / "suppressions", "reports": tree / "report"}
        settings = {name: value.format(**files) for name, value in SETTINGS.items()}
        environment = os.environ | settings | {"PYTHONPATH": str(tree / "src"), "LD_PRELOAD": preloaded}
        for command in COMMANDS[kind]:
            where = tree / "tests" if command[1] != "pytest" else tree
            done = subprocess.run([sys.executable, *command], cwd=where, env=environment, check=False)
            if done.returncode:
                print(*(report.read_text() for report in sorted(tree.glob("report.*"))), f"status {done.returncode}")
                return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
