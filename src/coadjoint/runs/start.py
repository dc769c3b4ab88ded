"""The state at the start of a run: momenta of all members, and the group element where an attitude is asked for."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.constants import read_numbers
from coadjoint.methods.attitude import check_attitude
from coadjoint.methods.base import Method, System
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.poisson import PoissonSystem


class Start(NamedTuple):
    """Initial momenta (members, n), group elements (members, d, d), and how they were given."""

    momenta: NDArray[np.float64]
    groups: NDArray[np.float64]
    representation: NDArray[np.float64] | str | None
    single: bool

    @property
    def carried(self) -> str | None:
        """In which matrices the group element is: "representation", "coadjoint", or None where there is none."""
        if self.representation is None:
            return None
        return "coadjoint" if isinstance(self.representation, str) else "representation"


def start_of(system: System, method: Method, x0: Any, attitude: Any) -> Start:
    """Check the initial state and the attitude.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system.
    method : Method
        The scheme; it refuses an attitude that it cannot keep.
    x0 : array_like, shape (n,) or (members, n)
        Initial momentum.
    attitude : bool, "coadjoint", or array_like of shape (d, d) or (members, d, d)
        What to carry beside the momentum.

    Returns
    -------
    Start
        Copies.

    Raises
    ------
    ValueError
        Naming what does not fit.
    """
    check_system(system)
    momenta = read_numbers(x0, "x0")
    single = momenta.ndim == 1
    if momenta.ndim not in (1, 2) or momenta.shape[-1] != system.dim:
        raise ValueError(f"x0 has the shape {momenta.shape}; it must be ({system.dim},) or (members, {system.dim})")
    if not np.all(np.isfinite(momenta)):
        raise ValueError("x0 contains NaN or infinity; every component must be finite")
    momenta = np.atleast_2d(momenta)
    if not len(momenta):
        raise ValueError(f"x0 has the shape {np.shape(x0)}; an ensemble needs at least one member")
    representation = _representation(system, attitude)
    if representation is None:
        return Start(momenta, np.zeros((len(momenta), 0, 0)), None, single)
    check_attitude(method, system, representation)
    size = system.dim if isinstance(representation, str) else representation.shape[1]
    initial = np.eye(size) if isinstance(attitude, bool | str) else read_numbers(attitude, "attitude")
    if initial.shape not in ((size, size), (len(momenta), size, size)):
        raise ValueError(
            f"attitude has the shape {initial.shape}; the representation of {system.name} needs ({size}, {size})"
        )
    if not np.all(np.isfinite(initial)):
        raise ValueError("attitude contains NaN or infinity; every entry must be finite")
    if np.any(np.linalg.matrix_rank(initial) < size):
        raise ValueError("attitude is a singular matrix; a group element has an inverse")
    groups = np.broadcast_to(initial, (len(momenta), size, size)).copy()
    return Start(momenta, groups, representation, single)


def check_system(system: Any) -> None:
    """Refuse what is no system, before it fails somewhere else.

    Parameters
    ----------
    system : object
        What was given as one.

    Raises
    ------
    TypeError
        It is neither a `LiePoissonSystem` nor a `PoissonSystem`.
    """
    if not isinstance(system, LiePoissonSystem | PoissonSystem):
        raise TypeError(
            f"system is {system!r}; it must be a LiePoissonSystem or a PoissonSystem, such as co.systems.rigid_body()"
        )


def _representation(system: System, attitude: Any) -> NDArray[np.float64] | str | None:
    if isinstance(attitude, bool) and not attitude:
        return None
    if system.algebra is None:
        raise ValueError(f"{system.name} has no Lie algebra, so it moves no group element; use attitude=False")
    if isinstance(attitude, str):
        if attitude != "coadjoint":
            raise ValueError(
                f"attitude is {attitude!r}; it must be True, False, 'coadjoint' or an initial group element"
            )
        return attitude
    if system.representation is None:
        raise ValueError(
            f"{system.name} has no representation for an attitude; give representation=, or use attitude='coadjoint'"
        )
    return np.asarray(system.representation)
