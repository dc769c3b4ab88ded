"""Action of exponentials of gradients along coadjoint orbits: of momenta of a Lie algebra, and of matrices."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.numerics.isospectral_stages import slope_along
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.system_checks import check_one_system


class Generator(NamedTuple):
    """D in exp(D) y: its image of y, the change of that image by changes of y and D, and a bound of its norm."""

    image: Callable[[Any], Any]
    change: Callable[[Any, Any], Any]
    norm: Callable[[], float]


class VectorOrbit:
    """The orbit of a momentum: ``D y = sign J(y) k``. Changes are columns."""

    def __init__(self, system: LiePoissonSystem) -> None:
        self._system, self.derivative_by = system, "formula"

    def gradient(self, y: Any, t: Any) -> Any:
        """Return the gradient of H."""
        return self._system.hamiltonian.gradient(y, t)

    def gradient_change(self, y: Any, dy: Any, t: Any) -> Any:
        """Return the changes of the gradient."""
        return self._system.hamiltonian.hessian(y, t) @ dy

    def generator(self, k: Any, dk: Any) -> Generator:
        """Return D of a combination of gradients, and of its changes if given."""
        system, J, sign = self._system, self._system.structure_matrix, self._system.sign
        D = None if dk is None else sign * self._coadjoint(k)
        return Generator(
            lambda y: sign * (J(y) @ k),
            lambda y, dy: D @ dy + sign * (J(y) @ dk),
            lambda: float(max(abs(np.asarray(system.algebra.coadjoint(k))).sum(axis=1))),
        )

    def _coadjoint(self, k: Any) -> NDArray[Any]:
        return np.asarray(self._system.algebra.coadjoint(k))


class MatrixOrbit:
    """The orbit of a matrix: ``D W = [P, W]`` with the stream P as gradient; or of two layers."""

    def __init__(self, system: MatrixSystem) -> None:
        self._system, self.derivative_by = system, "formula" if system.linear_stream else "differences"

    def gradient(self, W: Any, t: Any) -> Any:
        """Return the stream P."""
        return self._system.stream_of(W, t)

    def gradient_change(self, W: Any, dW: Any, t: Any) -> Any:
        """Return the changes of P."""
        layers = len(self._system.matrix_shape) == 3  # streams of two layers are linear, without a constant
        return self._system.stream_of(dW, t) if layers else slope_along(self._system, W, dW, t)

    def generator(self, P: Any, dP: Any) -> Generator:
        """Return D of a combination of streams, and of its changes if given."""
        bracket = self._system.bracket
        sizes = np.abs(P).reshape(-1, *self._system.algebra.shape).sum(axis=0)  # summed over layers
        return Generator(
            lambda W: bracket(P, W),
            lambda W, dW: bracket(P, dW) + bracket(dP, W),
            lambda: float(sizes.sum(axis=-1).max() + sizes.sum(axis=-2).max()),
        )


def orbit_of(system: Any, scheme_name: str) -> VectorOrbit | MatrixOrbit:
    """Return the orbits of a system; raise an error that names the scheme if it is a batch or has no Lie algebra."""
    check_one_system(system)
    if system.has_matrices:
        return MatrixOrbit(system)
    if system.algebra is None:
        raise ValueError(
            f"{scheme_name} moves along coadjoint orbits, but {system.name} has no Lie algebra; take GaussLegendre"
        )
    return VectorOrbit(system)
