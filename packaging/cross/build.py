"""Compile and link the kernels for other systems: `python build.py FOLDER [TARGET ...]`.

Each library is checked: it takes names only from libraries that every machine of its system has, and exports the names
that Python calls. The environment variable CROSS_OPTIONS has options after those of the package; by default they make
the build quick, and if it is empty, the libraries are those of a release.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

import lief

ROOT = Path(__file__).parents[2]
# Packages for Python 3.11 need a glibc of 2018 or newer.
TARGETS = {
    "x86_64-linux-gnu.2.28": 4,
    "aarch64-linux-gnu.2.28": 1,
    "x86_64-macos": 4,
    "aarch64-macos": 1,
    "x86_64-windows-gnu": 4,
}
"""zig's name of each system, and the number of its libraries: `_processor`, and one for each level."""
LEFT_OUT = (
    "x86_64-windows-msvc is left out: only Windows has Microsoft's headers and libraries. The sources are those of "
    "x86_64-windows-gnu."
)
SHOWN = 60
"""Lines of the compiler that are shown."""
QUICK = "-O0 -DCOADJOINT_UNROLLED=2"
SYSTEM_LIBRARIES = {
    "linux": r"(libc|libm|libpthread|libdl)\.so\.\d|ld-linux-.*\.so\.\d",
    "macos": r"/usr/lib/libSystem\.B\.dylib",
    "windows": r"(?i)(api-ms-win-crt-.*|kernel32|ntdll|ucrtbase)\.dll",
}


def called(command: list[str]) -> str:
    """Run a command; return the end of what it wrote if it failed, or an empty string."""
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    said = [line for line in done.stdout.splitlines() if not re.match(r"\[\d+/\d+\]", line)]
    return "\n".join([*said[-SHOWN:], f"exit status {done.returncode}"]) if done.returncode else ""


def build(folder: Path, target: str, options: str) -> str:
    """Compile and link the libraries of a target; return the errors, or an empty string."""
    places = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    cmake, ninja = (shutil.which(tool, path=places) or tool for tool in ("cmake", "ninja"))
    settings = {
        "CMAKE_MAKE_PROGRAM": ninja,
        "CMAKE_TOOLCHAIN_FILE": Path(__file__).with_name("zig.cmake"),
        "COADJOINT_TARGET": target,
        "COADJOINT_PYTHON": sys.executable,
        "COADJOINT_LEVELS": "all" if target.startswith("x86_64") else "",
        "COADJOINT_FURTHER_OPTIONS": ";".join(shlex.split(options)),
        # As for a wheel: libraries are not written beside the sources.
        "SKBUILD": "2",
        "SKBUILD_STATE": "wheel",
    }
    given = [f"-D{name}={value}" for name, value in settings.items()]
    return called([cmake, "-G", "Ninja", "-S", str(ROOT), "-B", str(folder), *given]) or called(
        [cmake, "--build", str(folder), "--", "-k", "0"]
    )


def exports(library: lief.Binary) -> set[str]:
    """Return the names that a library exports, as C spells them, without those of the compiler."""
    if isinstance(library, lief.PE.Binary):
        table = library.get_export()
        names = {str(entry.name) for entry in table.entries} if table else set()
    else:
        names = {str(symbol.name) for symbol in library.exported_symbols}
        if isinstance(library, lief.MachO.Binary):
            names = {name.removeprefix("_") for name in names}
    return {name for name in names if not name.startswith("_")}


def needed(library: lief.Binary) -> set[str]:
    """Return the libraries that a library is linked with."""
    listed = [str(getattr(one, "name", one)) for one in library.libraries]
    # A library of macOS lists itself first.
    return set(listed[isinstance(library, lief.MachO.Binary) :])


def newest_glibc(library: lief.Binary) -> tuple[int, ...]:
    """Return the newest version of glibc that a library asks for, if any."""
    if not isinstance(library, lief.ELF.Binary):
        return ()
    names = [str(one.name) for needs in library.symbols_version_requirement for one in needs.get_auxiliary_symbols()]
    return max((tuple(map(int, name[6:].split("."))) for name in names if re.match(r"GLIBC_\d", name)), default=())


def faults(path: Path, target: str, expected: dict[str, set[str]]) -> list[str]:
    """Return what is wrong with a library; `expected` has the exports of each kind of library, and takes the first."""
    library = lief.parse(str(path))
    if library is None:
        return ["is not readable"]
    system = target.split("-")[1]
    kind = "_processor" if path.stem == "_processor" else "_kernels"
    found = exports(library)
    size, libraries = path.stat().st_size / 1e6, ", ".join(sorted(needed(library)))
    print(f"  {path.name}: {size:.1f} MB, {len(found)} exports, needs {libraries or 'no library'}")
    wrong = [f"needs {name}" for name in needed(library) if not re.fullmatch(SYSTEM_LIBRARIES[system], name)]
    glibc = newest_glibc(library)
    if "gnu." in target and glibc > tuple(map(int, target.partition("gnu.")[2].split("."))):
        wrong.append(f"needs glibc {'.'.join(map(str, glibc))}")
    reference = expected.setdefault(kind, found)
    if found != reference or not found:
        wrong.append(f"exports other names: {', '.join(sorted(found ^ reference))}")
    return wrong


def main() -> int:
    """Build and check all targets; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the builds")
    parser.add_argument("targets", nargs="*", help=f"some of {', '.join(TARGETS)}; by default all")
    arguments = parser.parse_args()
    lief.logging.disable()
    options = os.environ.get("CROSS_OPTIONS", QUICK)
    folder = arguments.folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    os.environ["ZIG_GLOBAL_CACHE_DIR"] = os.environ["ZIG_LOCAL_CACHE_DIR"] = str(folder / "zig")
    expected: dict[str, set[str]] = {}
    failed = []
    for target in arguments.targets or TARGETS:
        print(f"{target}:", flush=True)
        began = time.monotonic()
        if errors := build(folder / target, target, options):
            print(errors)
            failed.append(target)
            continue
        paths = sorted(path for path in (folder / target).iterdir() if path.suffix in {".so", ".dylib", ".dll"})
        wrong = [f"{path.name} {fault}" for path in paths for fault in faults(path, target, expected)]
        if len(paths) != TARGETS[target]:
            wrong.append(f"{len(paths)} libraries, not {TARGETS[target]}")
        print(f"  compiled and linked in {time.monotonic() - began:.0f} s", *wrong, sep="\n  ", flush=True)
        failed += [target] if wrong else []
    print(LEFT_OUT)
    print(f"failed: {', '.join(failed)}" if failed else "all targets compiled, linked and export the same names")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
