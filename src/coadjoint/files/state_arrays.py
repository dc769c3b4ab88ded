"""How are states written? Vectors by components, matrices by rows and columns, complex ones with their parts last."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray

PARTS = ("real", "imaginary")
"""Of a complex number, along the last axis: NetCDF has no complex numbers."""
DIMENSIONS = (("component",), ("row", "column"), ("layer", "row", "column"))
"""Of a state: a vector, a matrix, or matrices in layers."""


def state_dimensions(states: NDArray[Any], before: int) -> tuple[str, ...]:
    """Return the dimensions of states that have so many axes before those of one state.

    Examples
    --------
    >>> state_dimensions(np.zeros((5, 3)), 1), state_dimensions(np.zeros((5, 2, 2), dtype=complex), 1)
    (('component',), ('row', 'column', 'part'))
    """
    found = DIMENSIONS[states.ndim - before - 1]
    return (*found, "part") if np.iscomplexobj(states) else found


def in_parts(states: NDArray[Any]) -> NDArray[np.float64]:
    """Return states as real numbers: of complex ones the parts along a last axis."""
    return np.stack([states.real, states.imag], axis=-1) if np.iscomplexobj(states) else states


def state_of(dataset: xarray.Dataset, name: str, allowed: tuple[tuple[str, ...], ...]) -> NDArray[Any]:
    """Return a variable of the start: finite numbers over some dimensions, or over members before them.

    Parameters
    ----------
    dataset : xarray.Dataset
        Of a run.
    name : str
        Of the variable.
    allowed : tuple of tuple of str
        Dimensions that it may have; each also with parts of complex numbers behind it.

    Returns
    -------
    ndarray
        Float64 or complex128.

    Raises
    ------
    ValueError
        It is missing, over other dimensions, or not finite.
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
        raise ValueError(f"{name} holds something else than finite numbers")
    values = np.asarray(variable.values, dtype=np.float64)
    if not parts:
        return values
    if values.shape[-1] != len(PARTS):
        raise ValueError(f"{name} has {values.shape[-1]} parts; complex numbers have {len(PARTS)}")
    return np.asarray(values[..., 0] + 1j * values[..., 1])
