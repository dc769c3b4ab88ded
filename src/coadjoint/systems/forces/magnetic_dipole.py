"""The torque of a magnetic field on a dipole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from coadjoint.systems.forces.body_torque import BodyTorque, body_products, prescribed, read_prescribed
from coadjoint.systems.user_functions import callable_from_compiled


@dataclass(frozen=True)
class MagneticDipole(BodyTorque):
    """The torque of a magnetic field on a dipole that is fixed in the body, ``moment cross B``.

    Parameters
    ----------
    moment : (3,)
        The dipole in the body frame (current times area).
    B : (3,) or callable
        B in space: constant, a function of the time t, or with `position` of ``(t, r)``; compiled by Numba.
    position : (3,) or callable, optional
        The argument r of the field, in space: constant, or a function of the time.

    Raises
    ------
    TypeError, ValueError
        Wrong shapes or arguments, or a system that is not one body with its attitude in the state.

    Examples
    --------
    >>> import coadjoint as co
    >>> magnet = co.forces.MagneticDipole((0, 0, 0.5), B=(0.0, 0.1, 0.0))
    >>> sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(magnet)
    >>> sat.vector_field(sat.state())[:3]
    array([-0.05,  0.  ,  0.  ])
    """

    moment: Any
    B: Any
    position: Any = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "moment", read_prescribed(self.moment, "moment of MagneticDipole"))
        arguments = "t" if self.position is None else "t, r"
        if self.position is not None:
            object.__setattr__(self, "position", read_prescribed(self.position, "position of MagneticDipole"))
        given = read_prescribed(self.B, "B of MagneticDipole", arguments)
        object.__setattr__(self, "B", given)
        if callable(self.moment):
            raise TypeError("moment of MagneticDipole is a function; give three numbers, or a co.forces.Torque")
        if self.position is not None and not callable(given):
            raise TypeError(
                "position of MagneticDipole was given, but its field is constant; give a function of (t, r)"
            )

    def torque_on(self, system: Any) -> Callable[..., Any]:
        in_body, crossed = body_products()
        moment = np.array(self.moment)
        if self.position is None:
            field = prescribed(self.B)

            def torque(x: Any, A: Any, t: Any) -> Any:
                return crossed(moment, in_body(A, field(t)))

            return torque
        given, position = callable_from_compiled(self.B), prescribed(self.position)

        def along_path(x: Any, A: Any, t: Any) -> Any:
            return crossed(moment, in_body(A, given(t, position(t))))

        return along_path
