"""One step as a function, with its exact tangent and its group element."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.given import read_number
from coadjoint.memory import check_room
from coadjoint.methods.base import Method
from coadjoint.methods.forced import check_serves, serving
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.start import momenta_of
from coadjoint.runs.times import Times
from coadjoint.systems.forced import ForcedSystem
from coadjoint.systems.kinds import System, check_one_system
from coadjoint.systems.points import QUIET
from coadjoint.wording import short


class Stepper:
    """The map that a scheme makes of one step; see `stepper`.

    Parameters
    ----------
    system : LiePoissonSystem, PoissonSystem or ForcedSystem
        What moves.
    method : Method
        The scheme.
    h : float
        The step; negative for backward.
    """

    def __init__(self, system: System | ForcedSystem, method: Method, h: float) -> None:
        if not isinstance(method, Method):
            raise TypeError(f"method is {short(method)}; it must be a scheme such as Splitting(order=2)")
        self.h = read_number(h, "h")
        if self.h == 0.0:
            raise ValueError(f"h is {self.h!r}; it must not be zero")
        if not isinstance(system, ForcedSystem):
            check_one_system(system)
        self._scheme = serving(system, method)
        check_serves(system, method)
        self.system: Any = system
        self.method = method
        self._prepared: dict[bool | str, PreparedRun] = {}

    def __repr__(self) -> str:
        return f"stepper({self.system!r}, {self.method!r}, {self.h!r})"

    def _advance(self, x: Any, t: float, attitude: Any) -> Any:
        initial = None if isinstance(attitude, bool | str) else attitude
        kind = True if initial is not None else attitude
        ready = self._prepared.get(kind)
        if ready is None:
            ready = PreparedRun(self.system, self.method, abs(self.h), attitude=kind, watch=False, threads=1)
            self._prepared[kind] = ready
        return ready.follow(Times(read_number(t, "t"), self.h, 1, 1), ready.start(x, initial))

    def __call__(self, x: Any, t: float = 0.0) -> NDArray[np.float64]:
        """Return the state after one step.

        Parameters
        ----------
        x : array_like, shape (n,) or (members, n)
            Momentum.
        t : float
            Time at the start of the step, for a Hamiltonian that depends on it.

        Returns
        -------
        ndarray
            Of the same shape; the same bits as the first step of `integrate`.
        """
        return np.asarray(self._advance(x, t, False).x[-1])

    def group(self, x: Any, t: float = 0.0, attitude: Any = None) -> NDArray[np.float64]:
        """Return the group element g of the step: attitude after it, for the unit element before it.

        Parameters
        ----------
        x : array_like, shape (n,)
            Momentum before the step.
        t : float
            Time at the start of the step.
        attitude : bool, "coadjoint", or array_like, optional
            As in `integrate`; None is the system's own representation where it has one, else the coadjoint matrix K
            (with K step(x) = x).

        Returns
        -------
        ndarray, shape (d, d)
            The element.
        """
        if attitude is None:
            attitude = True if self.system.representation is not None else "coadjoint"
        if attitude is False:
            raise ValueError("attitude is False; a group element needs True, 'coadjoint', an initial one, or None")
        return np.asarray(self._advance(x, t, attitude).attitude[-1])

    @QUIET
    def tangent(self, x: Any, t: float = 0.0) -> NDArray[np.float64]:
        """Return the exact derivative of the step at x, by the chain rule through the scheme.

        Parameters
        ----------
        x : array_like, shape (n,)
            Momentum before the step.
        t : float
            Time at the start of the step.

        Returns
        -------
        ndarray, shape (n, n)
            d step_i / d x_j.

        Raises
        ------
        TypeError
            If the Hamiltonian was given without second derivatives.
        """
        return self._scheme.tangent(self.system, *self._place(x, t), self.h)[1]

    @QUIET
    def tangent_by(self, x: Any, t: float = 0.0) -> str:
        """Return how `tangent` is found at x: by its "formula", by "complex step", or by "differences".

        Parameters
        ----------
        x, t
            As for `tangent`.

        Returns
        -------
        str
            The first two are exact to round-off; differences have some nine digits.
        """
        return self._scheme.tangent_by(self.system, *self._place(x, t), self.h)

    def _place(self, x: Any, t: float) -> tuple[NDArray[np.float64], float]:
        momenta, single = momenta_of(self.system, x)
        if not single:
            raise ValueError(
                f"x has the shape {np.shape(x)}; a tangent is taken at one state, of shape ({self.system.dim},)"
            )
        check_room(8 * 4 * self.system.dim**2, f"a tangent of dimension {self.system.dim}")
        return momenta[0], read_number(t, "t")


def stepper(system: System | ForcedSystem, method: Method, h: float) -> Stepper:
    """Return one step of a scheme as a function, for maps, certificates and Lyapunov exponents.

    Parameters
    ----------
    system : LiePoissonSystem, PoissonSystem or ForcedSystem
        What moves.
    method : Method
        The scheme.
    h : float
        The step; negative for backward.

    Returns
    -------
    Stepper
        ``step(x)``, ``step.tangent(x)``, ``step.group(x)``.

    Raises
    ------
    ValueError, TypeError
        If the scheme cannot serve the system, or h is zero.

    Examples
    --------
    The condition of a Poisson map, P J(x) P^T = J(step(x)):

    >>> import coadjoint as co
    >>> import numpy as np
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> step, x = co.stepper(body, co.Splitting(order=2), 0.1), np.array([1.0, 0.2, 0.5])
    >>> P = step.tangent(x)
    >>> bool(np.allclose(P @ body.structure_matrix(x) @ P.T, body.structure_matrix(step(x)), atol=1e-15))
    True
    """
    return Stepper(system, method, h)
