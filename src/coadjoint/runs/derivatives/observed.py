"""Quantities of a state, observed or of events, as functions of rows of numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.protocol import states_of, unforced_matrix_system
from coadjoint.systems.user_functions import takes_time


def function_of_rows(system: Any, quantity: Any, t: float) -> Callable[[NDArray[Any]], NDArray[Any]]:
    """Return a quantity at a time as a function of a row of numbers, of which matrices are projected."""
    if isinstance(quantity, Quadratic):
        quantity = quantity.bind(system.dim).value
        time_argument: tuple[float, ...] = ()
    else:
        is_function = not isinstance(quantity, Polynomial | Invariant)
        time_argument = (t,) if is_function and takes_time(quantity, "observe") else ()

    matrices = unforced_matrix_system(system)

    def of_row(row: NDArray[Any]) -> NDArray[Any]:
        state = states_of(system, row)
        if matrices is not None:
            state = matrices.algebra.projected(matrices.from_vector(row))
        return np.ravel(quantity(state, *time_argument))

    return of_row
