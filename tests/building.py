"""Builds of the kernels in a copy of the tree: as in the package, by another compiler, or with sanitizers."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from coadjoint.kernels.library import SUFFIX, compiler_options, level_options, processor_level

SOURCE = "src/coadjoint/kernels/source"


class Kernels:
    """The library of one level in a copy of the tree.

    Parameters
    ----------
    tree : Path
        The root of the copy.
    compiler : sequence of str
        The command.
    level : int, optional
        Of `coadjoint.kernels.library.levels`; that of this machine by default.
    tuning : sequence of str, optional
        In place of the options of the level.
    elsewhere : bool
        The compiler is for a processor that has no levels.
    """

    def __init__(
        self,
        tree: Path,
        compiler: Sequence[str] = ("g++",),
        level: int | None = None,
        tuning: Sequence[str] | None = None,
        elsewhere: bool = False,
    ) -> None:
        self.tree, self.compiler = tree, list(compiler)
        if level is None and not elsewhere:
            level = processor_level()
        source = tree / SOURCE
        self.flags = compiler_options(level_options(level, source) if tuning is None else tuning, source)
        name = "_kernels" if level is None else f"_kernels_v{level}"
        self.library = str(tree / "src/coadjoint/kernels" / f"{name}{SUFFIX}")
        self.linking = [option for option in tuning or () if option.startswith("-fsanitize")]
        self.objects = tree / "objects"
        self.sources = sorted(
            path
            for folder in (SOURCE, "src/coadjoint/methods")
            for path in (tree / folder).rglob("*.cpp")
            if path.name != "processor.cpp"
        )

    def build(self, only: tuple[str, ...] = ()) -> str:
        """Compile all sources, or those named, and link; return the errors of the compiler, or an empty string."""
        self.objects.mkdir(exist_ok=True)
        chosen = [path for path in self.sources if not only or path.name in only]

        def compiled(path: Path) -> str:
            return _called([*self.compiler, *self.flags, "-c", str(path), "-o", str(self._object(path))])

        with ThreadPoolExecutor(os.cpu_count() if len(chosen) > 2 else 1) as pool:
            for message in pool.map(compiled, sorted(chosen, key=lambda path: -path.stat().st_size)):
                if message:
                    return message
        return self._link(chosen)

    def _link(self, first: Sequence[Path] = ()) -> str:
        # Of several instances of a template the linker takes the first: that of a changed source.
        order = [*first, *(path for path in self.sources if path not in first)]
        objects = [str(self._object(path)) for path in order]
        return _called([*self.compiler, *self.linking, "-shared", "-pthread", *objects, "-o", self.library])

    def including(self, header: Path) -> tuple[str, ...]:
        """Return the names of the sources that a file is part of."""
        name = header.relative_to(self.tree)

        def includes(path: Path) -> bool:
            command = [*self.compiler, *self.flags, "-MM", str(path)]
            return str(name) in subprocess.run(command, capture_output=True, text=True, check=True).stdout

        with ThreadPoolExecutor(os.cpu_count()) as pool:
            return tuple(
                path.name for path, found in zip(self.sources, pool.map(includes, self.sources), strict=True) if found
            )

    def restore(self, only: tuple[str, ...], stored: dict[str, bytes]) -> None:
        """Restore the objects that a defect replaced, and the library."""
        for name in only:
            self._object(Path(name)).write_bytes(stored[name])
        if message := self._link():
            raise RuntimeError(f"the kernels cannot be linked again: {message}")

    def keep(self, only: tuple[str, ...]) -> dict[str, bytes]:
        """Return the objects of some sources, for `restore`."""
        return {name: self._object(Path(name)).read_bytes() for name in only}

    def _object(self, path: Path) -> Path:
        return self.objects / f"{path.stem}.o"


def _called(command: list[str]) -> str:
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    return result.stderr[-2000:] or f"exit status {result.returncode}" if result.returncode else ""
