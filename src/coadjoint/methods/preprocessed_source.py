"""C++ sources after preprocessing: all that a compiler reads, and whether it has changed since."""

from __future__ import annotations

import hashlib
import json
import os
import re
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from coadjoint.kernels.compiling import SOURCE

LINE_MARKER = re.compile(rb'^# \d+ "((?:[^"\\\n]|\\.)*)"([ \d]*)$', re.MULTILINE)
SYSTEM_HEADER = b"3"
SEARCHED = re.compile(
    rb"^#include .* search starts here:\n((?: .*\n|#include .*\n)*)End of search list\.", re.MULTILINE
)
ABSENT = re.compile(rb'^ignoring nonexistent directory "(.*)"$', re.MULTILINE)
SETTLED = 2 * 10**9
"""Files that changed within so many nanoseconds can change again without another time stamp."""

Stamp = tuple[int, ...] | None


class PreprocessedSource(NamedTuple):
    """The text that is compiled.

    Parameters
    ----------
    text : bytes
        After preprocessing, so that it needs no header.
    files : dict of bytes to bool
        The files that it comes from, in their order; whether each is a system header.
    folders : list of bytes
        Where headers were searched; empty where the compiler does not list them.
    """

    text: bytes
    files: dict[bytes, bool]
    folders: list[bytes]

    @classmethod
    def read(cls, text: bytes, messages: bytes) -> PreprocessedSource:
        """Return the source from what a compiler writes for ``-E -v``."""
        files: dict[bytes, bool] = {}
        for name, flags in LINE_MARKER.findall(text):
            if not name.startswith(b"<"):
                files.setdefault(re.sub(rb"\\(.)", rb"\1", name), SYSTEM_HEADER in flags.split())
        listed = SEARCHED.search(messages)
        searched = re.findall(rb"^ (.*?)(?: \(framework directory\))?$", listed[1], re.MULTILINE) if listed else []
        return cls(text, files, [*searched, *ABSENT.findall(messages)] if searched else [])

    def digest(self, options: Sequence[str]) -> str:
        """Return a digest of the user's files and options, the same on machines with other compilers."""
        found = hashlib.sha256(json.dumps(list(options)).encode())
        for name, system in self.files.items():
            if not system and not name.startswith(os.fsencode(SOURCE)):
                try:
                    content = Path(os.fsdecode(name)).read_bytes()
                except OSError:  # a name that a #line directive gives
                    continue
                found.update(hashlib.sha256(content).digest())
        return found.hexdigest()

    def watched(self) -> set[bytes]:
        """Return the files, and the folders in which a new header would take the place of one; empty if unknown."""
        if not self.folders:
            return set()
        folders = {*self.folders, *(os.path.dirname(name) for name, system in self.files.items() if not system)}
        below = {
            os.path.dirname(name[len(folder) + 1 :])
            for name in self.files
            for folder in folders
            if name.startswith(folder + b"/")
        }
        return {*self.files, *(_existing(os.path.join(folder, name)) for folder in folders for name in below)}


def _existing(folder: bytes) -> bytes:
    """Return the folder, or the one above it in which it would appear."""
    while folder and not os.path.isdir(folder):
        folder = os.path.dirname(folder)
    return folder or b"."


def stamps_of(paths: Iterable[bytes]) -> dict[bytes, Stamp]:
    """Return what differs after a file was changed, or an entry of a folder; None of what does not exist."""
    found: dict[bytes, Stamp] = {}
    for path in paths:
        try:
            of = os.stat(path)
        except OSError:
            found[path] = None
        else:
            found[path] = of.st_dev, of.st_ino, of.st_size, of.st_mtime_ns, of.st_ctime_ns
    return found


def settled(stamps: dict[bytes, Stamp]) -> bool:
    """Return whether every later change will show in the stamps."""
    newest = max((max(stamp[3:]) for stamp in stamps.values() if stamp), default=0)
    return bool(stamps) and newest < time.time_ns() - SETTLED
