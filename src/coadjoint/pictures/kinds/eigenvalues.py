"""Eigenvalues of a matrix state, which an isospectral motion conserves."""

from __future__ import annotations

from typing import Any

import numpy as np

from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.pictures.style import colour, legend, plain_axes, thickness

MAX_MARKED = 40
"""Largest number of eigenvalues drawn with markers."""


@kind("eigenvalues", low=True)
def eigenvalues(drawn: PlottedRun, at: float = 1.0) -> Paint:
    """Show the eigenvalues of a matrix of the first member at the start and at another time, and their displacement.

    For a skew-Hermitian W, the eigenvalues of -i W are drawn in ascending order, otherwise those of W in the complex
    plane. For a fluid they are the distribution of vorticity over area. For two fields, the matrix is the carried one.

    Parameters
    ----------
    at : float
        The time as a fraction of the span: 0 is the start, 1 the end.
    """
    if not drawn.unforced.has_matrices:
        raise CannotShow(f"the state of {drawn.unforced.name} is not a matrix, and has no eigenvalues")
    k = drawn.index_at(at)
    if not np.isfinite(drawn.x[0, k]).all():
        raise CannotShow(f"the first member has failed before t = {drawn.t[k]:g}, and has no eigenvalues there")
    first, last = (drawn.unforced.spectrum(drawn.state(j)) for j in (0, k))
    size = float(np.abs(first).max()) or 1.0
    moved = float(np.abs(last - first).max()) / size
    name = r"\Theta" if len(drawn.unforced.matrix_shape) == 3 else "W"
    fraction = (np.arange(len(first)) + 0.5) / len(first)

    def paint(axes: Any) -> None:
        for values, j, line, width in ((first, 0, 4, 3.0), (last, k, 6, 0.9)):
            style = {"color": colour(line), "linewidth": thickness(width), "label": f"$t$ = {drawn.t[j]:.4g}"}
            if np.iscomplexobj(values):
                style |= {"linestyle": "none", "marker": "o", "markersize": 3.0 * width}
                axes.plot(values.real / size, values.imag / size, **style)
            else:
                style |= {"marker": "o", "markersize": 2.0 * width} if len(values) <= MAX_MARKED else {}
                axes.plot(fraction, values / size, **style)
        if np.iscomplexobj(first):
            axes.set(xlabel="real part over the largest", ylabel="imaginary part over the largest")
        else:
            axes.set(xlabel="part of the eigenvalues below", ylabel=f"eigenvalues of $-i{name}$ over the largest")
        axes.set_title(f"spectrum of ${name}${drawn.of_member}: moved by {moved:.1e} of the largest")
        plain_axes(axes)
        legend(axes, beside=True)

    return paint
