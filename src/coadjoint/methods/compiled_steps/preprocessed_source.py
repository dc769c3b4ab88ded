"""Preprocessed C++ sources, and the detection of changes of the files that they include."""

from __future__ import annotations

import hashlib
import json
import os
import re
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from coadjoint.kernels.library import SOURCE

LINE_MARKER = re.compile(rb'^# \d+ "((?:[^"\\\n]|\\.)*)"([ \d]*)$', re.MULTILINE)
SYSTEM_HEADER = b"3"
SEARCH_FOLDERS = re.compile(
    rb"^#include .* search starts here:\n((?: .*\n|#include .*\n)*)End of search list\.", re.MULTILINE
)
ABSENT_FOLDER = re.compile(rb'^ignoring nonexistent directory "(.*)"$', re.MULTILINE)
TIMESTAMP_GRANULARITY = 2 * 10**9
"""Files modified within this time (nanoseconds) can change again without a new time stamp."""

Stamp = tuple[int, ...] | None


class PreprocessedSource(NamedTuple):
    """Preprocessed `text` with its source `files`, in order, and the `folders` searched for headers.

    `files` maps names to whether they are system headers; `folders` is empty if the compiler does not list them.
    """

    text: bytes
    files: dict[bytes, bool]
    folders: list[bytes]

    @classmethod
    def read(cls, text: bytes, messages: bytes) -> PreprocessedSource:
        """Return the source from the output of a compiler with ``-E -v``."""
        text, messages = (output.replace(b"\r\n", b"\n") for output in (text, messages))  # of Windows
        files: dict[bytes, bool] = {}
        for name, flags in LINE_MARKER.findall(text):
            if not name.startswith(b"<"):
                files.setdefault(re.sub(rb"\\(.)", rb"\1", name), SYSTEM_HEADER in flags.split())
        listed = SEARCH_FOLDERS.search(messages)
        searched = re.findall(rb"^ (.*?)(?: \(framework directory\))?$", listed[1], re.MULTILINE) if listed else []
        return cls(text, files, [*searched, *ABSENT_FOLDER.findall(messages)] if searched else [])

    def digest(self, options: Sequence[str]) -> str:
        """Return a digest of the user's files and options, independent of the compiler."""
        digest = hashlib.sha256(json.dumps(list(options)).encode())
        for name, system in self.files.items():
            if not system and not name.startswith(os.fsencode(SOURCE)):
                try:
                    content = Path(os.fsdecode(name)).read_bytes()
                except OSError:  # a name from a #line directive, not a file
                    continue
                digest.update(hashlib.sha256(content).digest())
        return digest.hexdigest()

    def dependencies(self) -> set[bytes]:
        """Return the files, and the folders in which a new header would shadow an included one; empty if unknown."""
        if not self.folders:
            return set()
        folders = {*self.folders, *(os.path.dirname(name) for name, system in self.files.items() if not system)}
        subfolders = {
            os.path.dirname(name[len(folder) + 1 :])
            for name in self.files
            for folder in folders
            if name.startswith(folder + b"/")
        }
        return {*self.files, *(_existing(os.path.join(folder, name)) for folder in folders for name in subfolders)}


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
