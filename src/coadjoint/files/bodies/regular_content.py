"""Contents of files of bodies, bounded in size."""

from __future__ import annotations

import os
from pathlib import Path

from coadjoint.memory import check_available_memory, format_bytes
from coadjoint.regular_files import open_regular


def content_of(path: Path, limit: int, what: str, factor: int = 1) -> bytes:
    """Return the bytes of a regular file; ValueError above a limit, or if `factor` times its size is not available."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > limit:
            raise ValueError(f"{path} has {format_bytes(size)}, and {what} at most {format_bytes(limit)}")
        check_available_memory(factor * size, f"{path}, {what},")
        return file.read(limit)
