"""Poisson systems with any skew matrix J(x), linear in x or not."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import all_in_coordinates_of, in_coordinates_of, names_for
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike, as_hamiltonian
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import (
    check_structure,
    read_casimirs,
    read_closed_form,
    read_name,
    read_parameters,
    read_sign,
)
from coadjoint.systems.user_functions import check_derivative, takes_time
from coadjoint.validation import read_bool, read_integer, set_fields

BYTES_PER_PRODUCT = 40  # peak, while J(x) is checked


@suggest_keywords
@dataclass(frozen=True, init=False, repr=False, eq=False)
class PoissonSystem(System):
    """The system ``x' = sign * J(x) grad H(x)`` with any skew-symmetric function J.

    Use it for brackets that are not linear in x (Lotka-Volterra, and with ``jacobi=False`` nonholonomic systems). The
    energy-conserving schemes support it. Splitting does not, since its flows would not be linear. If J is linear in x,
    use `LiePoissonSystem`.

    Parameters
    ----------
    structure_matrix : callable
        Pure function of x, shape (n,), that returns J(x), a skew (n, n) array. Checked at sample points, as is the
        Jacobi identity, by `derivative` or differences.
    hamiltonian : Quadratic, Polynomial, Separable, SplitHamiltonian, Hamiltonian, function or text
        The energy, as for `LiePoissonSystem`; a function or a text needs `dim`.
    sign : {+1, -1}
        Sign of the right-hand side.
    dim : int, optional
        n; required if the Hamiltonian does not determine it.
    derivative : callable, optional
        Function of x that returns ``d J_ij / d x_k``, shape (n, n, n); needed for exact tangents only.
    casimirs : mapping, optional
        Name to `Polynomial`, `Invariant` or function of x, with ``J(x) grad C(x) = 0``; checked at sample points
        where they are finite, by differences where the gradient is not given.
    name : str, optional
        Name in messages, files and pictures.
    parameters, exact
        As for `LiePoissonSystem`.
    jacobi : bool, optional
        False for a bracket that need not fulfil the Jacobi identity, which is then not checked.

    Attributes
    ----------
    structure_function, derivative_function : callable
        The functions as given.
    hamiltonian : Hamiltonian
        Bound to `dim`.
    algebra, representation
        None; present for compatibility with `LiePoissonSystem`.
    jacobi : bool
        As given.

    Raises
    ------
    TypeError, ValueError
        J is not a function, has the wrong shape or is not skew at a sample point; the dimension is unknown; or as for
        `LiePoissonSystem`.

    Warns
    -----
    UserWarning
        J violates the Jacobi identity at a sample point, and `jacobi` is not False.

    Notes
    -----
    Equation (17) of Reich, "Numerical integration of the generalized Euler equations" (1993).

    Examples
    --------
    >>> from coadjoint.systems.hamiltonians.quadratic import Quadratic
    >>> J = lambda x: x[0] * x[1] * np.array([[0.0, 1.0], [-1.0, 0.0]])
    >>> PoissonSystem(J, Quadratic([1.0, 1.0])).vector_field([2.0, 3.0])
    array([ 18., -12.])
    """

    structure_function: Callable[..., Any]
    hamiltonian: HamiltonianLike
    sign: int
    _dim: int
    derivative_function: Callable[..., Any] | None
    name: str
    _casimirs: dict[str, Any]
    _parameters: dict[str, Any] | None
    closed_form: Callable[..., Any] | None
    jacobi: bool

    def __init__(
        self,
        structure_matrix: Callable[..., Any],
        hamiltonian: Any,
        sign: int = +1,
        dim: int | None = None,
        derivative: Callable[..., Any] | None = None,
        casimirs: Mapping[str, Any] | None = None,
        name: str | None = None,
        parameters: Mapping[str, Any] | None = None,
        exact: Callable[..., Any] | None = None,
        jacobi: bool = True,
    ) -> None:
        functions = {"structure_matrix": structure_matrix} | ({} if derivative is None else {"derivative": derivative})
        for what, function in functions.items():
            if takes_time(function, what):
                raise TypeError(f"{what} is a function of (x, t); give a function of x alone")
        n = dim if dim is not None else getattr(hamiltonian, "dim", None)
        if n is None:
            raise TypeError(f"the dimension is unknown: {short(hamiltonian)} fits any; give dim=")
        n = read_integer(n, "dim")
        check_available_memory(
            BYTES_PER_PRODUCT * n**2, f"a Poisson system of dimension {short(n)}, whose J(x) is dense,"
        )
        set_fields(
            self,
            sign=read_sign(sign),
            _dim=n,
            structure_function=structure_matrix,
            derivative_function=derivative,
            name=read_name(name, f"Poisson system of dimension {n}"),
        )
        H = as_hamiltonian(hamiltonian, n, names=names_for(self, hamiltonian))
        set_fields(
            self,
            hamiltonian=in_coordinates_of(self, H),
            jacobi=read_bool(jacobi, "jacobi"),
            _parameters=read_parameters(parameters),
            closed_form=read_closed_form(exact),
        )
        if derivative is not None:
            shape = (self.dim, self.dim)
            names = ("structure_matrix", "derivative")
            check_derivative(
                structure_matrix, derivative, names=names, shapes=(shape, (*shape, self.dim)), n=self.dim, timed=False
            )
        check_structure(self)  # its differences use the derivative
        set_fields(self, _casimirs=read_casimirs({} if casimirs is None else casimirs, self))

    def _absolute_product(self, x: npt.NDArray[Any], u: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return np.abs(self.structure_matrix(x)) @ np.abs(u)

    @property
    def dim(self) -> int:  # type: ignore[override]
        return self._dim

    @property
    def casimirs(self) -> dict[str, Any]:
        """Name to `Polynomial` or `Invariant` (a copy)."""
        return all_in_coordinates_of(self, self._casimirs)

    def _text(self) -> str:
        return f"<{self.name}: {self.hamiltonian!r}, J a function of x, sign={self.sign:+d}>"
