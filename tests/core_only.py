"""A Python in which only the requirements of the core can be imported, whatever else is installed."""

import os
import subprocess
import sys
from pathlib import Path

import coadjoint

ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(coadjoint.__file__).parents[1])}
CORE = {"coadjoint", "numpy", "scipy", "flint", "threadpoolctl", "lazy_loader"}

HIDE = """
import sys

KNOWN = ...

class Hiding:
    # Answers for a finder of the interpreter, as if only the core and the standard library were installed.
    def __init__(self, finder):
        self.finder = finder

    def __getattr__(self, name):
        return getattr(self.finder, name)

    def find_spec(self, name, path=None, target=None):
        package = name.partition(".")[0]
        # sysconfig has a module of this platform's name.
        known = package in sys.stdlib_module_names | KNOWN or package.startswith("_sysconfigdata")
        return self.finder.find_spec(name, path, target) if known else None

sys.meta_path[:] = [Hiding(finder) for finder in sys.meta_path]
"""


def run_with_the_core(code, *arguments, folder=None, also=()):
    """Run Python code with only the core, and packages that are named, importable; return the finished process."""
    command = [sys.executable, "-c", HIDE.replace("...", repr(CORE | set(also))) + code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=folder, env=ENVIRONMENT)
