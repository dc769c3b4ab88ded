"""Functions of coordinates and of constants, which parameters of ready-made systems determine."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.user_functions import callable_from_compiled


class FunctionOfConstants(NamedTuple):
    """value(y, c) of y = x[coordinates] and constants c (k,), with its derivatives by y, analytic in both."""

    coordinates: npt.NDArray[np.int64]
    constants: npt.NDArray[Any]
    value: Callable[[Any, Any], Any]
    gradient: Callable[[Any, Any], Any]
    hessian: Callable[[Any, Any], Any]

    def hamiltonian(self) -> Hamiltonian:
        """Return the function of y, bound without a check of the derivatives, which takes minutes for 200 bodies."""
        c = self.constants
        value, gradient, hessian = map(callable_from_compiled, (self.value, self.gradient, self.hessian))
        energy = Hamiltonian(lambda y: value(y, c), lambda y: gradient(y, c), lambda y: hessian(y, c))
        energy.dim = len(self.coordinates)
        return energy
