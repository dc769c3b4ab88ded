"""The compiled kernels in a copy of the tree: built once, and again after one source has changed."""

from __future__ import annotations

import ast
import subprocess
import sysconfig
from pathlib import Path

from coadjoint.kernels.library import processor_level

SOURCE = "src/coadjoint/kernels/source"


class Kernels:
    """The library of one level in a copy of the tree.

    Parameters
    ----------
    tree : Path
        The root of the copy.
    """

    def __init__(self, tree: Path) -> None:
        self.tree = tree
        self.flags, self.library = flags_of(tree)
        self.objects = tree / "objects"
        self.sources = sorted(
            path
            for folder in (SOURCE, "src/coadjoint/methods")
            for path in (tree / folder).glob("*.cpp")
            if path.name != "processor.cpp"
        )

    def build(self, only: tuple[str, ...] = ()) -> str:
        """Compile all sources, or those named, and link; return what the compiler said if it refused."""
        self.objects.mkdir(exist_ok=True)
        chosen = [path for path in self.sources if not only or path.name in only]
        for path in chosen:
            if said := _called(["g++", *self.flags, "-c", str(path), "-o", str(self._object(path))]):
                return said
        # Of a template that several sources have made, the linker takes the first: that of a changed source.
        order = [*chosen, *(path for path in self.sources if path not in chosen)]
        return _called(["g++", "-shared", "-pthread", *(str(self._object(path)) for path in order), "-o", self.library])

    def restore(self, only: tuple[str, ...], kept: dict[str, bytes]) -> None:
        """Put back the objects that a defect replaced."""
        for name in only:
            self._object(Path(name)).write_bytes(kept[name])

    def keep(self, only: tuple[str, ...]) -> dict[str, bytes]:
        """Return the objects of some sources, to put them back."""
        return {name: self._object(Path(name)).read_bytes() for name in only}

    def _object(self, path: Path) -> Path:
        return self.objects / f"{path.stem}.o"


def flags_of(tree: Path) -> tuple[list[str], str]:
    """Return how the sources are compiled for this machine, and the library that they make, as the build says it."""
    constants = {
        target.id: ast.literal_eval(node.value)
        for node in ast.parse((tree / "setup.py").read_text(encoding="utf-8")).body
        if isinstance(node, ast.Assign) and isinstance(target := node.targets[0], ast.Name)
        if target.id in ("FLAGS", "LEVELS")
    }
    level = processor_level()
    tuning = ["-O3"] if level is None else [*constants["LEVELS"][f"v{level}"], "-mtune=generic"]
    name = "_kernels" if level is None else f"_kernels_v{level}"
    place = tree / "src/coadjoint/kernels" / f"{name}{sysconfig.get_config_var('EXT_SUFFIX')}"
    return [*constants["FLAGS"], *tuning, "-fPIC", f"-I{tree / SOURCE}"], str(place)


def _called(command: list[str]) -> str:
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    return result.stderr[-2000:] or f"exit status {result.returncode}" if result.returncode else ""
