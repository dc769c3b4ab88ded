"""Headers of C and C++ that the package contains."""

from __future__ import annotations

from pathlib import Path

FREE_BODY = Path(__file__).with_name("coadjoint.h")


def free_body_header(name: str = FREE_BODY.name) -> str:
    """Return the header of free bodies for a file of this name, which includes itself by its name.

    ValueError if a name cannot be included.

    Examples
    --------
    >>> '#include "body.h"' in free_body_header("body.h")
    True
    """
    if not name.isprintable() or any(sign in name for sign in '"\\'):
        raise ValueError(f"{name!r} cannot be included; give a name without quotes, backslashes and control characters")
    return FREE_BODY.read_text(encoding="utf-8").replace(f'#include "{FREE_BODY.name}"', f'#include "{name}"')
