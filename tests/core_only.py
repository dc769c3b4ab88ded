"""Python processes that import this package, with all installed packages or only the requirements of the core."""

import os
import subprocess
import sys
from pathlib import Path

import coadjoint

ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(coadjoint.__file__).parents[1])}
CORE = {"coadjoint", "numpy", "scipy", "flint", "threadpoolctl", "lazy_loader", "filelock"}

HIDE = """
import sys

KNOWN = ...

class Hiding:
    # Wraps a finder of the interpreter, as if only the core and the standard library were installed.
    def __init__(self, finder):
        self.finder = finder

    def __getattr__(self, name):
        return getattr(self.finder, name)

    def find_spec(self, name, path=None, target=None):
        package = name.partition(".")[0]
        # sysconfig imports a module named after the platform.
        known = package in sys.stdlib_module_names | KNOWN or package.startswith("_sysconfigdata")
        return self.finder.find_spec(name, path, target) if known else None

sys.meta_path[:] = [Hiding(finder) for finder in sys.meta_path]
"""


def run_with_the_core(code, *arguments, folder=None, also=()):
    """Run Python code with only the core and some named packages importable; return the finished process."""
    command = [sys.executable, "-c", HIDE.replace("...", repr(CORE | set(also))) + code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=folder, env=ENVIRONMENT)


def run_python(code, *arguments, timeout=200):
    """Run Python code with all packages importable; return the finished process."""
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout, env=ENVIRONMENT)
