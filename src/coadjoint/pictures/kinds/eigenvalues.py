"""The eigenvalues of a matrix that turns: what an isospectral motion keeps."""

from __future__ import annotations

from typing import Any

import numpy as np

from coadjoint.pictures.drawn import Drawn
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.pictures.style import colour, key, plain_axes
from coadjoint.systems.matrices.matrix_system import MatrixSystem


@kind("eigenvalues", low=True)
def eigenvalues(drawn: Drawn, at: float = 1.0) -> Paint:
    """Show the eigenvalues of -i W in rising order, at the start and at another time, and say how far they moved.

    Of a fluid they tell how much of the surface has which vorticity. Of two fields those of the carried one are shown,
    which stay.

    Parameters
    ----------
    drawn : Drawn
        The run; of several members the first.
    at : float
        The time, as a part of the span: 0 is the start, 1 the end.

    Returns
    -------
    Paint
    """
    if not isinstance(drawn.family, MatrixSystem):
        raise CannotShow(f"{drawn.family.name} moves no matrix, and has no eigenvalues")
    k = drawn.at(at)
    first, last = (drawn.family.spectrum(drawn.state(j)) for j in (0, k))
    size = float(np.abs(first).max()) or 1.0
    moved = float(np.abs(last - first).max()) / size
    part = (np.arange(len(first)) + 0.5) / len(first)

    def paint(axes: Any) -> None:
        axes.plot(part, first / size, color=colour(4), linewidth=3.0, label="$t$ = " + f"{drawn.t[0]:.4g}")
        axes.plot(part, last / size, color=colour(6), linewidth=0.9, label="$t$ = " + f"{drawn.t[k]:.4g}")
        axes.set(xlabel="part of the eigenvalues below", ylabel="eigenvalues of $-iW$ over the largest")
        axes.set_title(f"spectrum of $W$: moved by {moved:.1e} of the largest")
        plain_axes(axes)
        key(axes, loc="upper left")

    return paint
