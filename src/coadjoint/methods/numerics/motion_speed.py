"""Speed of a motion and its rate of change, for variable steps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.system_checks import System


@dataclass(frozen=True)
class Speed:
    """A speed of the motion of a system: the square root of a quadratic form of grad H, or a given polynomial."""

    system: System
    kind: str
    given: Any

    def at(self, x: Any) -> tuple[Any, Any]:
        """Return the speed Q at a state of any number type, and its rate of change Q' / Q along the motion.

        Examples
        --------
        The speed of a rigid body is its angular velocity times the square root of 2/3:

        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(2, 4, 4))
        >>> Q, rate = speed_of(body, None).at(np.array([0.0, 0.0, 3.0]))
        >>> bool(abs(Q - 0.75 * (2 / 3) ** 0.5) < 1e-15), float(rate)
        (True, 0.0)
        """
        system = self.system
        f = system.vector_field(x)
        if self.kind == "given":
            Q = self.given.value(x) if isinstance(self.given, Quadratic) else self.given(x)
            return Q, np.dot(self.given.gradient(x), f) / Q
        u, change = system.hamiltonian.gradient(x, 0.0), np.dot(system.hamiltonian.hessian(x, 0.0), f)
        square = self.given.value(u)
        return square**0.5, np.dot(self.given.gradient(u), change) / (2 * square)


def speed_of(system: System, speed: Any) -> Speed:
    """Return the speed for `ReversibleSteps`: a given polynomial, or the root mean square size of D, x' = D x, grad H
    constant.

    Raise ValueError if a default speed needs a Lie algebra or a nonzero bracket, or a polynomial has another dimension.
    """
    if isinstance(speed, Quadratic):
        return Speed(system, "given", speed.bind(system.dim))
    if isinstance(speed, Polynomial):
        if speed.dim != system.dim:
            raise ValueError(f"speed is a polynomial in {speed.dim} coordinates, and {system.name} has {system.dim}")
        return Speed(system, "given", speed)
    algebra = system.algebra
    if algebra is None:
        raise ValueError(
            f"ReversibleSteps finds the speed from a Lie algebra, which {system.name} does not have; give speed=, a "
            "Polynomial that is positive"
        )
    square = _square_of_generators(algebra)
    if square is None:
        raise ValueError(f"all brackets of {algebra} are zero, so that nothing moves; take any scheme")
    return Speed(system, "generator", square)


@lru_cache(maxsize=64)
def _square_of_generators(algebra: Any) -> Quadratic | None:
    """Return u -> |D_u|^2 / n, the mean square row norm of D_u, as a quadratic form; None if all brackets are zero.

    D_u x = J(x) u, so that its entries are sums of structure constants times u.
    """
    from scipy import sparse

    i, j, k, c = algebra.triples
    n = algebra.dim
    if not len(c):
        return None
    # J_ij(x) = c x_k: entry (i, k) of D_u has c u_j, and entry (j, k) has -c u_i.
    rows, columns = np.concatenate([i * n + k, j * n + k]), np.concatenate([j, i])
    places, entry = np.unique(rows, return_inverse=True)
    C = sparse.csr_array((np.concatenate([c, -c]), (entry, columns)), shape=(len(places), n))
    return Quadratic(sparse.csr_array(C.T @ C) * (2.0 / n))
