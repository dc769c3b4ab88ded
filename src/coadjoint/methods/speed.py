"""How fast is a motion? A speed for steps that follow it, and the rate at which it changes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from coadjoint.algebra.polynomial import Polynomial
from coadjoint.systems.kinds import System
from coadjoint.systems.quadratic import Quadratic


@dataclass(frozen=True)
class Speed:
    """A speed of the motion of a system: the square root of a quadratic form of grad H, or a given polynomial."""

    system: System
    kind: str
    given: Any

    def at(self, x: Any) -> tuple[Any, Any]:
        """Return the speed Q at a state, and the rate Q' / Q at which it changes with the motion.

        Parameters
        ----------
        x : (n,) array
            The state, of any number type.

        Returns
        -------
        Q, rate : number

        Examples
        --------
        Of a body the speed is that of its turn, times the square root of 2/3:

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
    """Return the speed of a system that `ReversibleSteps` names.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system.
    speed : Quadratic, Polynomial or None
        None is the root mean square size of the matrix D, x' = D x with grad H held.

    Returns
    -------
    Speed

    Raises
    ------
    ValueError
        There is no Lie algebra, or all brackets are zero; or the polynomial has another dimension.
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
            f"ReversibleSteps finds the speed from a Lie algebra, which {system.name} has not; give speed=, a "
            "Polynomial that is positive"
        )
    square = _square_of_generators(algebra)
    if square is None:
        raise ValueError(f"all brackets of {algebra} are zero, so that nothing moves; take any scheme")
    return Speed(system, "generator", square)


@lru_cache(maxsize=64)
def _square_of_generators(algebra: Any) -> Quadratic | None:
    """Return the mean square of the entries of D_u in a row times their number, u -> |D_u|^2 / n, as a quadratic form.

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
