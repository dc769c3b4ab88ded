"""Compare the bits of runs on aarch64 with those of this machine: `python aarch64.py FOLDER`.

The kernels are compiled for aarch64 and run by a Debian Python in qemu's user emulation. Debian packages and wheels are
unpacked and cached in the folder; nothing is installed on the machine.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from building import Kernels

ROOT = Path(__file__).parents[1]
COMPILER, TOOLS = "aarch64-linux-gnu-g++", "g++-aarch64-linux-gnu qemu-user-static"
KEYRING = Path("/usr/share/keyrings/debian-archive-keyring.gpg")
WHEELS = ("numpy", "scipy", "python-flint", "lazy_loader", "numba")
GLIBC = range(17, 37)


def emulator() -> str | None:
    """Return the qemu command for aarch64 processes, or None."""
    return shutil.which("qemu-aarch64-static") or shutil.which("qemu-aarch64")


def missing() -> str:
    """Return the missing requirement in one sentence, or an empty string."""
    if platform.machine() == "aarch64":
        return "this machine is an aarch64 itself: `make test` compares its bits"
    if shutil.which(COMPILER) is None or emulator() is None:
        return f"{COMPILER} or qemu-aarch64 is missing: on Debian, `apt-get install {TOOLS}`"
    if shutil.which("apt-get") is None or shutil.which("dpkg-deb") is None or not KEYRING.exists():
        return "a Python for aarch64 is taken from Debian's packages, and this machine is no Debian"
    return ""


def called(command: Sequence[str], **how: object) -> str:
    """Return the output of a command; errors go to the terminal, and a failure ends the process."""
    done = subprocess.run([*command], stdout=subprocess.PIPE, text=True, check=False, **how)  # type: ignore[call-overload]
    if done.returncode:
        sys.exit(f"{' '.join(command[:4])} ... ended with exit status {done.returncode}\n{done.stdout[-2000:]}")
    return str(done.stdout)


def unpacked_python(folder: Path) -> Path:
    """Return the root folder of a Debian for aarch64 with Python, created by apt without its database."""
    root, apt = folder / "root", folder / "apt"
    if not (root / "usr/bin/python3").exists():
        for name in ("lists/partial", "cache/archives/partial"):
            (apt / name).mkdir(parents=True, exist_ok=True)
        release = platform.freedesktop_os_release()["VERSION_CODENAME"]
        source = f"deb [arch=arm64 signed-by={KEYRING}] http://deb.debian.org/debian {release} main\n"
        (apt / "sources.list").write_text(source)
        (apt / "status").touch()
        settings = {
            "APT::Architecture": "arm64",
            "APT::Architectures": "arm64",
            "APT::Install-Recommends": "false",
            "Dir::State": apt,
            "Dir::State::status": apt / "status",
            "Dir::Cache": apt / "cache",
            "Dir::Etc::sourcelist": apt / "sources.list",
            "Dir::Etc::sourceparts": "/dev/null",
        }
        call = ["apt-get", "-q", "-y", *(f"-o{name}={value}" for name, value in settings.items())]
        called([*call, "update"])
        called([*call, "--download-only", "install", "python3", "libstdc++6"])
        for package in sorted((apt / "cache/archives").glob("*.deb")):
            called(["dpkg-deb", "-x", str(package), str(root)])
    return root


def unpacked_wheels(folder: Path, version: str) -> Path:
    """Return a folder with the packages of runs, built for aarch64."""
    place = folder / "wheels"
    if not place.exists():
        fitting = ["manylinux2014_aarch64", *(f"manylinux_2_{minor}_aarch64" for minor in GLIBC)]
        asked = [f"--platform={name}" for name in fitting]
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--only-binary=:all:"]
        unfinished = folder / "unfinished"
        shutil.rmtree(unfinished, ignore_errors=True)
        called([*pip, f"--target={unfinished}", f"--python-version={version}", *asked, *WHEELS])
        unfinished.rename(place)
    return place


def tree_of_kernels(folder: Path) -> Path:
    """Return a copy of the sources with the kernels compiled for aarch64."""
    tree = folder / "tree"
    for name in ("src", "tests"):
        shutil.rmtree(tree / name, ignore_errors=True)
        ignored = shutil.ignore_patterns("__pycache__", "*.so", "*.dylib")
        shutil.copytree(ROOT / name, tree / name, ignore=ignored)
    if message := Kernels(tree, [COMPILER], elsewhere=True).build():
        sys.exit(message)
    return tree


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of downloads and builds")
    folder = parser.parse_args().folder.absolute()
    if message := missing():
        print(f"aarch64 skipped: {message}")
        return 0
    folder.mkdir(parents=True, exist_ok=True)
    root = unpacked_python(folder)
    python = [str(emulator()), "-L", str(root), str(root / "usr/bin/python3")]
    version = called([*python, "-c", "import sys; print(*sys.version_info[:2], sep='.')"]).strip()
    wheels = unpacked_wheels(folder, version)
    tree = tree_of_kernels(folder)
    print(f"built for aarch64, Python {version}", flush=True)
    digests = ["-m", "digests.digests_of_runs"]
    here = os.environ | {"PYTHONPATH": str(ROOT / "src")}
    expected = json.loads(called([sys.executable, *digests], cwd=ROOT / "tests", env=here))
    there = os.environ | {"PYTHONPATH": f"{tree / 'src'}{os.pathsep}{wheels}"}
    found = json.loads(called([*python, *digests], cwd=tree / "tests", env=there))
    different = sorted(name for name in expected.keys() | found if expected.get(name) != found.get(name))
    for name in different:
        print(f"other bits: {name}")
    print(f"{len(expected)} runs, {len(different)} with other bits on aarch64")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
