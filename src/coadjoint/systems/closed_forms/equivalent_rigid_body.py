"""Systems of three coordinates equivalent to a free rigid body by rescaling, with its closed form."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.closed_forms.closed_form import reject_attitude, start_and_times
from coadjoint.systems.closed_forms.free_rigid_body import exact_solution
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem

Floats = npt.NDArray[np.float64]


def rigid_body_equivalent(
    constants: tuple[float, float, float],
    masses: tuple[float, float, float],
    casimirs: dict[str, Polynomial],
    name: str,
    parameters: dict[str, Any],
) -> LiePoissonSystem:
    """Return the system ``x1' = (c2 M3 - c3 M2) x2 x3`` and cyclic, ``H = x . M x / 2``, sign -1, with its closed form.

    `constants` are those of ``[e2, e3] = c1 e1`` and cyclic, nonzero and of one sign; `masses` are the diagonal of M.

    Examples
    --------
    >>> body = rigid_body_equivalent((1.0, 1.0, 2.0), (1.0, 2.0, 3.0), {}, "body", {})
    >>> body.vector_field([1.0, 1.0, 1.0])
    array([-1., -1.,  1.])
    """
    c1, c2, c3 = constants
    return LiePoissonSystem(
        LieAlgebra.from_brackets(3, {(1, 2): {0: c1}, (2, 0): {1: c2}, (0, 1): {2: c3}}, name=f"so(3) of {name}"),
        Quadratic(masses),
        sign=-1,
        casimirs=casimirs,
        name=name,
        parameters=parameters,
        exact=partial(_exact, np.array(constants), np.array(masses), name),
    )


def _exact(constants: Floats, masses: Floats, name: str, x0: Any, t: Any, attitude: Any = False) -> Floats:
    """Return the closed form: y_i = x_i sqrt(c_i / c_1) is a rigid body with masses M_i c_1 / c_i in scaled time."""
    reject_attitude(attitude, name)
    start, times = start_and_times(x0, t, 3)
    ratios = constants / constants[0]
    units = np.sqrt(ratios)
    pace = constants[0] * math.sqrt(ratios[1] * ratios[2])
    x: Floats = exact_solution(masses / ratios, -1, start * units, pace * times) / units
    return x
