"""File layout of states: vectors by components, matrices by rows and columns, complex numbers with their parts last."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray

COMPLEX_PARTS = ("real", "imaginary")
"""Parts of complex numbers along the last axis, since NetCDF has no complex numbers."""
STATE_DIMENSIONS = (("component",), ("row", "column"), ("layer", "row", "column"))
"""Dimensions of a state: a vector, a matrix, or matrices in layers."""


def state_dimensions(states: NDArray[Any], before: int) -> tuple[str, ...]:
    """Return the dimensions of one state, for arrays with `before` leading axes.

    Examples
    --------
    >>> state_dimensions(np.zeros((5, 3)), 1), state_dimensions(np.zeros((5, 2, 2), dtype=complex), 1)
    (('component',), ('row', 'column', 'part'))
    """
    found = STATE_DIMENSIONS[states.ndim - before - 1]
    return (*found, "part") if np.iscomplexobj(states) else found


def split_complex(states: NDArray[Any]) -> NDArray[np.float64]:
    """Convert complex states to real and imaginary parts along a last axis; return real states unchanged."""
    return np.stack([states.real, states.imag], axis=-1) if np.iscomplexobj(states) else states


def state_of(dataset: xarray.Dataset, name: str, allowed: tuple[tuple[str, ...], ...]) -> NDArray[Any]:
    """Read an initial variable as float64 or complex128, optionally over members; ValueError unless valid.

    `allowed` are its dimensions, without those of members and of complex parts; the numbers must be finite.
    """
    if name not in dataset:
        raise ValueError(f"the dataset has no variable {name!r}; it is damaged, or was not written by coadjoint")
    variable = dataset[name]
    dims = variable.dims[1:] if variable.dims[:1] == ("member",) else variable.dims
    parts = dims[-1:] == ("part",)
    if (dims[:-1] if parts else dims) not in allowed or not variable.size:
        said = " or ".join(map(str, allowed))
        raise ValueError(f"{name} is over {variable.dims}; it must be over {said}, or members and these")
    if variable.dtype.kind not in "if" or not np.isfinite(variable.values).all():
        raise ValueError(f"{name} contains values that are not finite numbers")
    values = np.asarray(variable.values, dtype=np.float64)
    if not parts:
        return values
    if values.shape[-1] != len(COMPLEX_PARTS):
        raise ValueError(f"{name} has {values.shape[-1]} parts; complex numbers have {len(COMPLEX_PARTS)}")
    return np.asarray(values[..., 0] + 1j * values[..., 1])
