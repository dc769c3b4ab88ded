"""Functions of JAX as functions of a Hamiltonian: compiled by JAX, called from the loops."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from coadjoint.errors import in_one_line

X64 = ', which JAX has with jax.config.update("jax_enable_x64", True)'


@dataclass(frozen=True)
class JaxFunction:
    """The derivative of some order, 0 to 2, of a function of JAX of (x), or of (x, t) if `timed`, in float64."""

    function: Callable[..., Any]
    order: int
    timed: bool

    called_in_python: ClassVar[bool] = True

    @cached_property
    def compiled(self) -> Callable[..., Any]:
        """The derivative, compiled by JAX when it is first called."""
        import jax

        derivatives = (lambda f: f, jax.grad, jax.hessian)
        compiled: Callable[..., Any] = jax.jit(derivatives[self.order](self.function))
        return compiled

    def __call__(self, x: Any, t: float = 0.0) -> npt.NDArray[np.float64]:
        """Return the derivative at x and t; raise TypeError for numbers of another type than float64."""
        y = np.asarray(x)
        if y.dtype != np.float64:
            raise TypeError(f"a function of JAX is given numbers of {y.dtype}; its derivatives are of float64 only")
        result = np.asarray(self.compiled(y, t) if self.timed else self.compiled(y))
        if result.dtype != np.float64:
            raise TypeError(f"the function of JAX returns numbers of {result.dtype}, not of float64{X64}")
        return result

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the function without its compiled form."""
        return JaxFunction, (self.function, self.order, self.timed)


def is_array_of_jax(value: Any) -> bool:
    """Return whether a value is an array of JAX, without importing JAX."""
    jax = sys.modules.get("jax")
    return jax is not None and isinstance(value, jax.Array)


def check_traceable(function: Callable[..., Any], n: int, timed: bool) -> None:
    """Raise TypeError if JAX cannot trace a function, or it does not return one number of float64."""
    import jax

    try:
        result = jax.eval_shape(function, *((np.zeros(n), 0.0) if timed else (np.zeros(n),)))
    except Exception as reason:
        raise TypeError(
            f"JAX cannot trace the Hamiltonian, which returns an array of JAX ({type(reason).__name__}: "
            f"{in_one_line(str(reason), 160)}); compute with jax.numpy only"
        ) from reason
    if result.shape != () or result.dtype != np.float64:
        raise TypeError(
            f"the Hamiltonian returns an array of JAX of {result.dtype} and shape {result.shape}; it must return one "
            f"number of float64{'' if jax.config.jax_enable_x64 else X64}"
        )
