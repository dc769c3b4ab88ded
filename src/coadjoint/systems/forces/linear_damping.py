"""Linear damping towards a given state."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.systems.forces.base import (
    Force,
    ForceReader,
    apply_metric,
    check_dimension,
    check_state,
    read_matrix,
    read_state,
    state_vector,
)


@dataclass(frozen=True)
class LinearDamping(Force):
    """Linear damping towards a given state, ``x' = -rate (x - toward)``: friction, viscosity of modes, relaxation.

    Its flow is exact, ``x - toward`` times ``exp(-rate tau)``, also if rate times step is large. It preserves neither
    energy nor Casimirs. To preserve the length of a spin use `DoubleBracketDamping`.

    Parameters
    ----------
    rate : float, (n,) or (n, n) array_like
        Rates (1/time). A matrix need not be symmetric. Negative rates amplify.
    toward : float, (n,) or (N, N) array_like
        The state where the damping vanishes; a number applies to all coordinates. For a `MatrixSystem` it is a matrix
        or zero, and the rate is a number.

    Raises
    ------
    ValueError, TypeError
        A value is not finite or of the wrong shape.

    Examples
    --------
    A symmetric body whose spin about its axis decays:

    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 1, 2)).with_forces(co.forces.LinearDamping(0.1))
    >>> sol = co.integrate(body, (0.6, 0.0, 0.8), t_span=(0, 10), step=0.1, save_every=100)
    >>> bool(abs(sol.x[-1, 2] - 0.8 * 2.718281828459045 ** -1) < 1e-15)
    True
    """

    rate: Any
    toward: Any = 0.0

    uses_energy: ClassVar[bool] = False

    def __post_init__(self) -> None:
        self._read(rate=read_matrix, toward=partial(read_state, number=True))

    def check(self, system: Any) -> None:
        if system.has_matrices and np.ndim(self.rate):
            raise ValueError(
                f"rate of LinearDamping has the shape {np.shape(self.rate)}; {system.name} needs a number, or "
                "Friction for scale-dependent rates"
            )
        check_dimension(self.rate, "rate of LinearDamping", system)
        check_state(self.toward, "toward of LinearDamping", system)

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        return np.asarray(apply_metric(self.rate, state_vector(self.toward, system) - x))

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        from scipy.linalg import expm

        rate, deviation = np.asarray(self.rate), np.asarray(x) - state_vector(self.toward, system)
        if rate.ndim == 2:
            n = len(rate)
            # The last column of this exponential is the displacement of the state by the flow.
            generator = np.zeros((n + 1, n + 1))
            generator[:n, :n], generator[:n, n] = -tau * rate, -tau * (rate @ deviation)
            return np.asarray(x + expm(generator)[:n, n])
        return np.asarray(x + np.expm1(-tau * rate) * deviation)

    def tangent(self, system: Any, x: NDArray[Any], t: float, tau: float) -> NDArray[np.float64]:
        from scipy.linalg import expm

        rate = np.asarray(self.rate)
        return np.asarray(expm(-tau * rate) if rate.ndim == 2 else np.exp(-tau * rate))

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        return reader.damping(np.asarray(self.rate), state_vector(self.toward, system))
