"""Inertia of bodies in space: tensors, their inverses on the directions in which a body can rotate, and anisotropy."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.bodies.inertia import (
    check_symmetric_matrix,
    inverse_of,
    plain,
    positive_moments,
    warn_unphysical_inertia,
)
from coadjoint.validation import check_finite, is_real, read_list, read_numbers

Floats = npt.NDArray[np.float64]

ROD_TOLERANCE = 64 * UNIT_ROUNDOFF
"""Relative deviation below which a tensor counts as that of a rod: its square is a multiple of it."""


class BodyInertia(NamedTuple):
    """The inertia of a body as given, as a tensor, and its inverse, (3,) or (3, 3), on directions that rotate it."""

    # `rotating` is the projection on these directions for a rod or a point, and None for other bodies.

    given: Any
    tensor: Floats
    inverse: Floats
    rotating: Floats | None = None

    @property
    def anisotropic(self) -> Floats:
        """The tensor without its isotropic part: the trace is zero, and the moments of a ball vanish exactly."""
        return np.asarray(anisotropic_part(self.tensor), dtype=np.float64)


def anisotropic_part(tensor: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a tensor without its isotropic part, real or complex, from differences of its moments."""
    result = tensor.copy()
    for i in range(3):
        a, b, c = (tensor[j, j] for j in (i, (i + 1) % 3, (i + 2) % 3))
        result[i, i] = ((a - b) + (a - c)) / 3.0
    return result


def read_body_inertia(inertia: Any, what: str = "inertia") -> BodyInertia:
    """Validate principal moments or a tensor; the moment along a rod, and all those of a point, may be zero."""
    array = read_numbers(inertia, what)
    if array.shape not in ((3,), (3, 3)):
        raise ValueError(f"{what} has shape {array.shape}; give three principal moments, or a symmetric (3, 3)")
    check_finite(array, what)
    if not array.any():
        return BodyInertia(plain(array), np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3)))
    inverse, rotating = (_inverse_moments if array.ndim == 1 else _inverse_tensor)(array, what)
    warn_unphysical_inertia(array, None, what)
    tensor = np.diag(array) if array.ndim == 1 else np.triu(array) + np.triu(array, 1).T
    return BodyInertia(plain(array), tensor, inverse, rotating)


def read_inertias(inertias: Any) -> tuple[BodyInertia, ...]:
    """Validate the inertia of each of several bodies, with the number of the one that is wrong."""
    rule = "give one inertia for each body, such as [(1, 2, 2.5), (1, 1, 1)]"
    listed = read_list(inertias, "inertias", rule)
    if not listed or any(map(is_real, listed)):
        raise ValueError(f"inertias is {short(inertias)}; {rule}")
    return tuple(read_body_inertia(entry, f"inertias[{k}]") for k, entry in enumerate(listed))


def inverse_of_moving(inertia: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the inverse of moments, zero where they are, or of a tensor, which is not that of a rod; also complex."""
    if inertia.ndim == 2:
        return inverse_of(inertia, "inertia")
    inverse = np.zeros_like(inertia)
    moving = inertia.real != 0.0
    inverse[moving] = 1.0 / inertia[moving]
    return inverse


def _inverse_moments(moments: Floats, what: str) -> tuple[Floats, Floats | None]:
    zero = np.flatnonzero(moments == 0.0)
    if not len(zero):
        return 1.0 / positive_moments(moments, what), None
    others = np.delete(moments, zero)
    # The mass of a body without a moment about an axis lies on that axis.
    if len(zero) > 1 or others[0] != others[1]:
        raise ValueError(
            f"{what}[{zero[0]}] is 0, as that of a rod along this axis, but the other moments are "
            f"{' and '.join(f'{m:g}' for m in np.delete(moments, zero[0]).tolist())}; those of a rod are equal"
        )
    positive_moments(others, what)
    inverse = np.zeros(3)
    inverse[moments != 0.0] = 1.0 / others
    return inverse, np.diag((moments != 0.0).astype(np.float64))


def _inverse_tensor(tensor: Floats, what: str) -> tuple[Floats, Floats | None]:
    check_symmetric_matrix(tensor, what)
    size = tensor.trace() / 2
    with np.errstate(all="ignore"):
        scaled = tensor / size if size else tensor
        defect = np.abs(np.einsum("ij,jk->ik", scaled, scaled) - scaled).max()
    # A rod with the direction n has the tensor I (1 - n n), whose square is I times itself.
    if size > 0 and defect <= ROD_TOLERANCE:
        positive_moments(np.array([size]), what)
        return np.asarray(scaled / size), scaled
    return inverse_of(tensor, what), None
