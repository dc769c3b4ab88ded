"""Compilation of user-written C++ steps; cached libraries are loaded only if no other user can have written them."""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from coadjoint.code_cache import CodeCache
from coadjoint.kernels.library import SOURCE, compiler_options, kernels, level_in_use, level_options
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.private_folders import private_folder
from coadjoint.regular_files import open_regular
from coadjoint.short_repr import short

# On Windows GCC does not align the stack for vectors.
COMPILERS = ("clang++",) if sys.platform == "win32" else ("c++", "g++", "clang++")
COMPILER_TIMEOUT = 600.0  # seconds; a step compiles in some three

LINE_MARKER = re.compile(rb'^# \d+ "((?:[^"\\\n]|\\.)*)"([ \d]*)$', re.MULTILINE)
SYSTEM_HEADER = b"3"
SEARCH_FOLDERS = re.compile(
    rb"^#include .* search starts here:\n((?: .*\n|#include .*\n)*)End of search list\.", re.MULTILINE
)
ABSENT_FOLDER = re.compile(rb'^ignoring nonexistent directory "(.*)"$', re.MULTILINE)
TIMESTAMP_GRANULARITY = 2 * 10**9
"""Files modified within this time (nanoseconds) can change again without a new time stamp."""
Stamp = tuple[int, ...] | None


@dataclass(frozen=True)
class CompiledSource:
    """A compiled step: its name in ``STEP_SCHEME``, its file, and the digest of the file, its headers and options."""

    name: str
    path: str
    digest: str

    @property
    def address(self) -> int:
        library = _LIBRARIES.get((self.path, self.digest))
        if library is None:
            # Pickled in another process, perhaps on another machine: machine code may differ, its source must not.
            recompiled = compile_step(self.path, self.name)
            if recompiled.digest != self.digest:
                raise ValueError(
                    f"{self.path}: is not what the step {self.name} was compiled from: the file, its headers or the "
                    "options in CXX have changed; give every process the same ones"
                )
            library = _LIBRARIES[self.path, self.digest]
        return ctypes.cast(getattr(library, f"{self.name}_step"), ctypes.c_void_p).value or 0


_LOADED: dict[str, ctypes.CDLL] = {}
"""Libraries in use by digest of all inputs of the machine code; never unloaded."""
_LIBRARIES: dict[tuple[str, str], ctypes.CDLL] = {}
"""The same libraries by path and digest of a step."""
_LAST_COMPILATIONS: dict[str, tuple[object, dict[bytes, Stamp], str]] = {}
"""Of each file the settings of the last compilation, the stamps of all that it has read, and its digest."""


@suggest_keywords
def compile_step(path: str | Path, name: str | None = None) -> CompiledSource:
    """Compile a step in C++ for this processor, in some seconds, and load it.

    The file includes ``steps/step_scheme.hpp``, derives from ``StepScheme``, and ends with ``STEP_SCHEME(name, Type)``.
    The compiled code is cached for other processes in the folder ``coadjoint`` of the user's cache. It is compiled
    again, also within a process, when the file, a header that it includes, the compiler, or an option in ``CXX``
    changes. Code is loaded from the cache only if no other user can have written it; otherwise a `RuntimeWarning`
    gives the reason, and the file is compiled in a temporary folder.

    Parameters
    ----------
    path : str or Path
        The file.
    name : str, optional
        Name of the step, required if the file has several.

    Returns
    -------
    CompiledSource
        The value of `compiled_step` for a scheme that derives from `CompiledStepMethod`. It refers to the file as it
        was at the time of this call.

    Raises
    ------
    ValueError
        There is no such file, it has no such step, or it does not compile; the message quotes the compiler.
    RuntimeError
        There is no compiler, or it does not work; the environment variable ``CXX`` selects another one.
    """
    source = Path(path)
    try:
        with open_regular(source) as file:
            text = file.read().decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{source}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    names = re.findall(r"^\s*STEP_SCHEME\(\s*(\w+)\s*,", text, re.MULTILINE)
    if not names:
        raise ValueError(f"{source}: has no STEP_SCHEME(name, Type), by which a step is found")
    if name is None and len(names) > 1:
        raise ValueError(f"{source}: has the steps {', '.join(names)}; select one by name=")
    if name is not None and name not in names:
        raise ValueError(f"{source}: has no step {short(name)}; it has {', '.join(names)}")
    source_path = str(source.resolve())
    step = CompiledSource(name or names[0], source_path, _digest_of_library(source_path))
    if not hasattr(_LIBRARIES[source_path, step.digest], f"{step.name}_step"):
        raise ValueError(f"{source}: has no step {step.name} after preprocessing")
    return step


def _digest_of_library(source_path: str) -> str:
    """Load the library of a file, compiled if necessary, and return its digest."""
    kernels()  # raises first if the kernels are missing
    # Compiled for the level in use, so that the bits are the same.
    settings = level_in_use(), dict(os.environ)
    last_settings, stamps, digest = _LAST_COMPILATIONS.get(source_path, (None, {}, ""))
    if last_settings == settings and stamps_of(stamps) == stamps:
        return digest
    compiler = _compiler()
    executable = os.fsencode(shutil.which(compiler[0]) or compiler[0])
    command = [*compiler, *compiler_options(level_options(settings[0])), "-DCOADJOINT_APART"]
    version = _run([*compiler, "--version"], source_path).stdout.decode(errors="replace")
    if sys.platform == "win32" and "clang" not in version.lower():
        raise RuntimeError(
            f"{source_path}: steps are compiled by Clang on Windows, and {compiler[0]} is another compiler"
        )
    preprocessed = _run([*command, "-E", "-v", source_path], source_path)
    if preprocessed.returncode != 0:
        raise _compiler_error(compiler, source_path, preprocessed)
    # Lines of Windows end in another way.
    text, messages = (output.replace(b"\r\n", b"\n") for output in (preprocessed.stdout, preprocessed.stderr))
    files = files_of(text)
    dependencies = dependencies_of(files, messages)
    stamps = stamps_of([*dependencies, executable])
    identity = [command, version, os.fsdecode(executable), (stamps[executable] or ())[2:4]]
    key = hashlib.sha256(json.dumps(identity).encode() + text).hexdigest()
    if key not in _LOADED:
        _LOADED[key] = _load(f"{Path(source_path).stem[:40]}-{key[:32]}", source_path, partial(_build, command, text))
    digest = digest_of(files, [word for word in compiler if word.startswith("-")])
    _LIBRARIES[source_path, digest] = _LOADED[key]
    if dependencies and stamps_are_final(stamps):
        _LAST_COMPILATIONS[source_path] = settings, stamps, digest
    return digest


def _load(name: str, source_path: str, build: Callable[[str, Path], None]) -> ctypes.CDLL:
    try:
        library = cached_library(name, partial(build, source_path))
    except OSError as reason:
        raise ValueError(f"{source_path}: the compiled step cannot be loaded ({reason})") from None
    exports = kernels().interrupt_functions
    exports.restype = ctypes.c_void_p
    library.import_interrupts(ctypes.c_void_p(exports()))
    return library


def _build(command: Sequence[str], text: bytes, source_path: str, output_path: Path) -> None:
    """Compile the preprocessed text, not the file, which may have changed since."""
    # The folders of PATH are not searched for what a library of Windows needs.
    linking = ["-shared", "-static-libgcc", "-static-libstdc++"] if sys.platform == "win32" else ["-shared"]
    process = _run([*command, *linking, "-o", str(output_path), "-x", "c++-cpp-output", "-"], source_path, text)
    if process.returncode != 0:
        raise _compiler_error(command, source_path, process)
    if not output_path.is_file():
        raise RuntimeError(f"{source_path}: the compiler {command[0]} has written nothing; name another one by CXX=")


def _run(command: Sequence[str], source_path: str, text: bytes = b"") -> subprocess.CompletedProcess[bytes]:
    """Run a compiler with messages in English."""
    language = {**os.environ, "LC_ALL": "C"}
    try:
        return subprocess.run(
            command, input=text, capture_output=True, timeout=COMPILER_TIMEOUT, check=False, env=language
        )
    except OSError as reason:
        raise RuntimeError(
            f"{source_path}: the compiler {command[0]} cannot be run ({reason.strerror}); name another one by CXX="
        ) from None
    except subprocess.TimeoutExpired:
        raise RuntimeError(
            f"{source_path}: the compiler {command[0]} did not end within {COMPILER_TIMEOUT:.0f} s; name another one "
            "by CXX="
        ) from None


def _compiler_error(command: Sequence[str], source_path: str, process: subprocess.CompletedProcess[bytes]) -> Exception:
    lines = process.stderr.decode(errors="replace").splitlines()
    shown = [line for line in lines if re.search(r"\berror: ", line)][:3] or lines[-3:]
    if process.returncode < 0 or not shown:
        return RuntimeError(
            f"{source_path}: the compiler {command[0]} failed (exit status {process.returncode}); "
            "name another one by CXX="
        )
    return ValueError(f"{source_path}: the compiler {command[0]} rejects it: {' | '.join(shown)[:600]}")


def _compiler() -> list[str]:
    setting = os.environ.get("CXX", "")
    try:
        # The paths of Windows have backslashes, which would quote what follows.
        words = shlex.split(setting.replace("\\", "/") if sys.platform == "win32" else setting)
    except ValueError as reason:
        raise RuntimeError(f"CXX is {short(setting)}, which cannot be read as a command ({reason})") from None
    if words:
        return words
    compiler = next((name for name in COMPILERS if shutil.which(name)), None)
    if compiler is None:
        known = " or ".join(COMPILERS)
        raise RuntimeError(f"no C++ compiler is installed ({known}); install one, or name it by CXX=")
    return [compiler]


def files_of(text: bytes) -> dict[bytes, bool]:
    """Return the source files of a preprocessed text, and whether each is a system header."""
    files: dict[bytes, bool] = {}
    for name, flags in LINE_MARKER.findall(text):
        if not name.startswith(b"<"):
            files.setdefault(re.sub(rb"\\(.)", rb"\1", name), SYSTEM_HEADER in flags.split())
    return files


def digest_of(files: dict[bytes, bool], options: Sequence[str]) -> str:
    """Return a digest of the user's files and options, independent of the compiler."""
    digest = hashlib.sha256(json.dumps(list(options)).encode())
    for name, system in files.items():
        if not system and not name.startswith(os.fsencode(SOURCE)):
            try:
                content = Path(os.fsdecode(name)).read_bytes()
            except OSError:  # a name from a #line directive, not a file
                continue
            digest.update(hashlib.sha256(content).digest())
    return digest.hexdigest()


def dependencies_of(files: dict[bytes, bool], messages: bytes) -> set[bytes]:
    """Return the files, and the folders in which a new header would shadow an included one; empty if unknown."""
    listed = SEARCH_FOLDERS.search(messages)
    searched = re.findall(rb"^ (.*?)(?: \(framework directory\))?$", listed[1], re.MULTILINE) if listed else []
    if not searched:
        return set()
    of_user = (os.path.dirname(name) for name, system in files.items() if not system)
    folders = {*searched, *ABSENT_FOLDER.findall(messages), *of_user}
    subfolders = {
        os.path.dirname(name[len(folder) + 1 :])
        for name in files
        for folder in folders
        if name.startswith(folder + b"/")
    }
    return {*files, *(_existing(os.path.join(folder, name)) for folder in folders for name in subfolders)}


def _existing(folder: bytes) -> bytes:
    """Return the folder, or the nearest existing parent in which it would appear."""
    while folder and not os.path.isdir(folder):
        folder = os.path.dirname(folder)
    return folder or b"."


def stamps_of(paths: Iterable[bytes]) -> dict[bytes, Stamp]:
    """Return metadata that changes when a file or the entries of a folder change; None for missing paths."""
    stamps: dict[bytes, Stamp] = {}
    for path in paths:
        try:
            status = os.stat(path)
        except OSError:
            stamps[path] = None
        else:
            stamps[path] = status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns
    return stamps


def stamps_are_final(stamps: dict[bytes, Stamp]) -> bool:
    """Return whether every later change will alter the stamps."""
    newest = max((max(stamp[3:]) for stamp in stamps.values() if stamp), default=0)
    return bool(stamps) and newest < time.time_ns() - TIMESTAMP_GRANULARITY


def cached_library(name: str, build: Callable[[Path], None]) -> ctypes.CDLL:
    """Load a library from the cache, after `build` (which raises no OSError) has written it there if necessary."""
    try:
        cache = CodeCache(".so")
        path = cache.find(name) or cache.add(name, build)
    except OSError as reason:
        detail = f"{reason.strerror}: {reason.filename}" if reason.strerror else reason
        warnings.warn(
            f"the cache of compiled steps is not used ({detail}), so that each process compiles them again; correct "
            "this or name another folder by XDG_CACHE_HOME",
            RuntimeWarning,
            stacklevel=2,
        )
        with private_folder() as temporary_folder:
            build(temporary_folder / name)
            return ctypes.CDLL(str(temporary_folder / name))
    return ctypes.CDLL(str(path))
