"""A stream given by a user function, P = f(W) or f(W, t), linear or nonlinear."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.user_functions import takes_time
from coadjoint.validation import to_array

Floats = npt.NDArray[np.float64]
Matrix = npt.NDArray[Any]


@suggest_keywords
@dataclass(frozen=True, eq=False)
class FunctionStream:
    """P = f(W), or f(W, t), given by a Python function of one matrix.

    Compiled loops call machine code if Numba can compile the function, otherwise Python.

    Parameters
    ----------
    function : callable
        Pure function of a matrix (N, N), real or complex like the algebra, or of a matrix and the time.
    traceless : tuple of (int, int)
        Ranges of rows of the blocks whose matrices have trace zero. The stages of a step have a trace there, which is
        removed before the function is called: otherwise a step would not be a Poisson map.

    Raises
    ------
    TypeError
        Not a function of these arguments.

    Examples
    --------
    >>> FunctionStream(lambda W: 2.0 * W)(np.eye(2))
    array([[2., 0.],
           [0., 2.]])
    """

    function: Callable[..., Any]
    traceless: tuple[tuple[int, int], ...] = ()
    timed: bool = field(init=False)
    table: Floats = field(init=False, repr=False)

    kind = "BY_FUNCTION"

    def __post_init__(self) -> None:
        object.__setattr__(self, "timed", takes_time(self.function, "stream"))
        object.__setattr__(self, "table", np.zeros(0))

    def __call__(self, W: Matrix, t: float = 0.0) -> Matrix:
        W = np.asarray(W)
        if W.ndim == 2:
            W = self._centred(W)
            return self.checked(self.function(W, t) if self.timed else self.function(W), W)
        return np.stack([self(part, t) for part in W]) if len(W) else np.zeros_like(W)

    def _centred(self, W: Matrix) -> Matrix:
        result = W.copy() if self.traceless else W
        for first, last in self.traceless:
            rows = np.arange(first, last)
            result[rows, rows] -= result[rows, rows].mean()
        return result

    def checked(self, P: Any, W: Matrix) -> Matrix:
        """Validate the returned value, and return it as a matrix like W.

        Raises
        ------
        TypeError
            Another shape, or another type of numbers than that of W.
        """
        kinds = "iufc" if np.iscomplexobj(W) else "iuf"
        result = to_array(P, "the value of the stream", kinds)
        if result.shape != W.shape or result.dtype.kind not in kinds:
            kind = "complex" if kinds == "iufc" else "real"
            raise TypeError(f"the stream returns {short(P)}; it must return a {kind} matrix of shape {W.shape}")
        return result.astype(W.dtype, copy=False)
