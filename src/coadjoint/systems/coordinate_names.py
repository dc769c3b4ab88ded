"""What are the coordinates of a system called?"""

from __future__ import annotations

import re
from typing import Any

from coadjoint.systems.ready_made import telling_of


def coordinate_names(system: Any, count: int) -> tuple[str, ...]:
    """Return the names of so many coordinates as plain text: those of the system, those of the basis, or x1, x2, ...

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system, without forces.
    count : int
        How many numbers a state has.

    Returns
    -------
    tuple of str

    Examples
    --------
    >>> from coadjoint.systems.rigid_body import rigid_body
    >>> coordinate_names(rigid_body((1, 2, 3)), 3)
    ('x1', 'x2', 'x3')
    """
    telling = telling_of(system.name)
    told = () if telling is None else telling.names(count)
    if told:
        return told
    basis = getattr(system.algebra, "basis", ())
    if len(basis) != count:
        return tuple(f"x{i + 1}" for i in range(count))
    # e1, e2, ... are names of basis elements where nobody has named them; x_i is the coordinate of e_i.
    return tuple(re.sub(r"^e(?=\d)", "x", name) for name in basis)
