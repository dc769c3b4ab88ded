"""Names of the coordinates of a system."""

from __future__ import annotations

import re
from typing import Any

from coadjoint.systems.registry import gallery_entry_of


def coordinate_names(system: Any, count: int) -> tuple[str, ...]:
    """Return `count` coordinate names as plain text: those of the system, else of the basis, else x1, x2, ...

    Examples
    --------
    >>> from coadjoint.systems.bodies.rigid_body import rigid_body
    >>> coordinate_names(rigid_body((1, 2, 3)), 3)
    ('x1', 'x2', 'x3')
    """
    gallery_entry = gallery_entry_of(system.name)
    told = () if gallery_entry is None else gallery_entry.names(count)
    if told:
        return told
    basis = getattr(system.algebra, "basis", ())
    if len(basis) != count:
        return tuple(f"x{i + 1}" for i in range(count))
    # e1, e2, ... are default names of basis elements; the coordinate of e_i is x_i.
    return tuple(re.sub(r"^e(?=\d)", "x", name) for name in basis)
