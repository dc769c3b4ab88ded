"""Builds the compiled kernels: the same sources for every level of the processor, chosen when they are loaded."""

import os
import platform
from concurrent.futures import ThreadPoolExecutor
from glob import glob
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

KERNELS = "src/coadjoint/kernels/source"
# No contraction and no fast-math: the bits of a run must not depend on the compiler's choices.
FLAGS = [
    "-std=c++17",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-g0",
    "-fvisibility=hidden",
    "-Wno-psabi",
    "-Wno-ignored-attributes",
]
# For x86-64 a library for each level, by the end of its name. Without fused products in hardware each is a call: more
# than -O1 costs more time to build than it saves.
LEVELS = {
    "v1": ["-O1", "-march=x86-64"],
    "v3": ["-O3", "-march=x86-64-v3", "-mprefer-vector-width=512"],
    "v4": ["-O3", "-march=x86-64-v4", "-mprefer-vector-width=512"],
}


def kernels(level: str | None) -> Extension:
    """Return the library of kernels for one of the levels; None for what the compiler makes by default."""
    name = "_kernels" if level is None else f"_kernels_{level}"
    sources = [*glob(f"{KERNELS}/*/*.cpp"), *glob("src/coadjoint/methods/*.cpp")]
    tuning = ["-O3"] if level is None else [*LEVELS[level], "-mtune=generic"]
    return Extension(
        f"coadjoint.kernels.{name}",
        sorted(source for source in sources if not source.endswith("processor.cpp")),
        include_dirs=[KERNELS],
        depends=sorted(glob(f"{KERNELS}/*/*.hpp")),
        extra_compile_args=[*FLAGS, *tuning],
        language="c++",
    )


class BuildKernels(build_ext):
    """Compiles all sources side by side; a library here is called by address and has no Python module in it."""

    def build_extensions(self) -> None:
        """Compile the sources of all libraries at once, and link each library."""

        def compiled(job: tuple[Extension, str]) -> None:
            extension, source = job
            self.compiler.compile(
                [source],
                output_dir=os.path.join(self.build_temp, extension.name),
                include_dirs=extension.include_dirs,
                extra_postargs=extension.extra_compile_args,
                depends=extension.depends,
            )

        jobs = [(extension, source) for extension in self.extensions for source in extension.sources]
        # The longest first.
        jobs.sort(key=lambda job: -Path(job[1]).stat().st_size)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            list(pool.map(compiled, jobs))
        for extension in self.extensions:
            objects = self.compiler.object_filenames(
                extension.sources, output_dir=os.path.join(self.build_temp, extension.name)
            )
            self.compiler.link_shared_object(objects, self.get_ext_fullpath(extension.name), target_lang="c++")

    def get_export_symbols(self, ext: Extension) -> list[str]:
        """Return none: what is exported says so in its source."""
        return []


processor = Extension(
    "coadjoint.kernels._processor", [f"{KERNELS}/boundary/processor.cpp"], extra_compile_args=["-O2"], language="c++"
)
levels = LEVELS if platform.machine().lower() in ("x86_64", "amd64") else [None]
setup(ext_modules=[processor, *map(kernels, levels)], cmdclass={"build_ext": BuildKernels})
