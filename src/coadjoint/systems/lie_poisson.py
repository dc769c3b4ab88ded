"""Lie-Poisson systems: generalized Euler equations of a Hamiltonian on the dual of a Lie algebra."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.representation import check_representation
from coadjoint.caching import cached_if_small
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.coordinates import all_in_coordinates_of, coordinate_names, in_coordinates_of, names_for
from coadjoint.systems.evaluation import ProductSums, scatter
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike, as_hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.summable import Summable
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import (
    read_casimirs,
    read_closed_form,
    read_integrals,
    read_layout,
    read_name,
    read_parameters,
    read_sign,
)
from coadjoint.systems.vanishing_products import Products, field_products
from coadjoint.validation import set_fields

# Systems search for Casimirs automatically up to this number of monomials times constants per coordinate, which takes
# a fraction of a second.
MAX_SEARCH_SIZE = 5000
SEARCH_DEGREES = range(1, 5)

# Algebras are immutable and compare by value, so a scan over Hamiltonians searches once.
_CASIMIR_CACHE: WeakKeyDictionary[LieAlgebra, Mapping[str, Any]] = WeakKeyDictionary()


def known_or_found_casimirs(algebra: LieAlgebra) -> Mapping[str, Any]:
    """Return the known Casimirs of an algebra or, if some are missing, those of a quick search."""
    known = algebra.casimirs_known
    constants = len(algebra.triples.c)
    # A nonzero bracket has rank at least two.
    if constants == 0 or (known and len(known) >= algebra.dim - 2):
        return known
    sizes = {d: math.comb(algebra.dim + d - 1, d) * max(1.0, constants / algebra.dim) for d in SEARCH_DEGREES}
    degree = max((d for d, size in sizes.items() if size <= MAX_SEARCH_SIZE), default=0)
    if degree < 2 or (known and len(known) >= algebra.dim - algebra.generic_rank()):
        return known
    if algebra not in _CASIMIR_CACHE:
        try:
            _CASIMIR_CACHE[algebra] = algebra._find_casimirs(degree)
        except ValueError:  # undecidable with rounded constants
            _CASIMIR_CACHE[algebra] = {}
    casimirs = _CASIMIR_CACHE[algebra]
    return casimirs if len(getattr(casimirs, "independent", ())) > len(known) else known


@suggest_keywords
@dataclass(frozen=True, init=False, repr=False, eq=False)
class LiePoissonSystem(System):
    """The generalized Euler equations ``x' = sign * J(x) grad H(x)`` on the dual of a Lie algebra.

    Use it if the bracket is linear in x. All schemes support it, and explicit splitting preserves all its Casimirs. For
    nonlinear brackets see `PoissonSystem`.

    Parameters
    ----------
    algebra : LieAlgebra
        The algebra, on whose dual x lies; ``J_ij(x) = sum_k c_ij^k x_k``.
    hamiltonian : Quadratic, Polynomial, Separable, SplitHamiltonian, Hamiltonian, function or text
        The energy. A function of x is a `Hamiltonian`; a text is a `formula` in the names of the coordinates, which are
        those of the basis (of e0, e1, ... both e0 and x0), or in x1, x2, ... if none of these is the name of another
        coordinate.
    sign : {+1, -1}
        +1 for right-invariant systems (the convention of Reich, 1993), -1 for left-invariant (body) systems.
    casimirs : mapping, optional
        Name to `Polynomial`, `Quadratic`, `Invariant` or function of x. By default the known Casimirs of the algebra,
        or those of a quick search. Every run records all of them. Therefore `copies` of an algebra have none by default
        above 2^22 exponents (682 copies of so(3)); give the ones to record, as sparse `Quadratic` if they contain few
        of many coordinates.
    representation : (n, d, d), optional
        Matrices of the basis for the group element, ``g' = -sign g rho(grad H)``. By default that of the algebra.
    name : str, optional
        Name in messages, files and pictures.
    parameters : mapping, optional
        Parameters for which ``co.systems.get(name, **parameters)`` makes this system again.
    exact : callable, optional
        Closed form ``exact(x0, t, attitude)``, if known.
    integrals : mapping, optional
        Further constants of motion for this Hamiltonian: name to `Polynomial`, `Quadratic`, `Invariant` or function
        of x. ``observe=system.integrals`` records them in a run.
    layout : mapping, optional
        Arrangement of sites in pictures, ``"lattice"`` and ``"shape"``, as for `spin_lattice`; and under
        ``"coordinates"`` what coordinates are, by their names or these without numbers: ``{"r": "position"}``, or with
        a unit ``{"r": ("position", "m")}``. Kinds are momentum (the default), axis, direction, position, angle,
        constant and memory. Forces act on momenta only.

    Attributes
    ----------
    algebra, sign, name
        As given.
    hamiltonian : Hamiltonian
        Bound to the dimension of the algebra.
    representation : ndarray or None
        Read-only, shape (n, d, d).

    Raises
    ------
    TypeError, ValueError
        An argument of the wrong type; a sign that is not +1 or -1; a Hamiltonian of another dimension; a function
        written with the name of another coordinate; coordinates of a piece of a `SplitHamiltonian` that do not commute;
        a Casimir or an integral that is not constant (by differences at sample points if its gradient is not known); a
        representation with other commutators.

    Notes
    -----
    Equation (1) of Reich, "Numerical integration of the generalized Euler equations" (1993). Systems are immutable.

    Examples
    --------
    >>> from coadjoint.algebra import catalogue
    >>> from coadjoint.systems.hamiltonians.quadratic import Quadratic
    >>> s = LiePoissonSystem(catalogue.so(3), Quadratic([1.0, 0.5, 0.25]), sign=-1)
    >>> s.vector_field([1.0, 2.0, 4.0])
    array([-2.,  3., -1.])
    >>> s.energy([1.0, 2.0, 4.0])
    3.5
    """

    algebra: LieAlgebra
    hamiltonian: HamiltonianLike
    sign: int
    representation: npt.NDArray[np.float64] | None
    name: str
    _casimirs: dict[str, Any] | None
    _parameters: dict[str, Any] | None
    closed_form: Callable[..., Any] | None
    _integrals: Mapping[str, Any]
    _layout: dict[str, Any]

    def __init__(
        self,
        algebra: LieAlgebra,
        hamiltonian: Any,
        sign: int = +1,
        casimirs: Mapping[str, Any] | None = None,
        representation: npt.ArrayLike | None = None,
        name: str | None = None,
        parameters: Mapping[str, Any] | None = None,
        exact: Callable[..., Any] | None = None,
        integrals: Mapping[str, Any] | None = None,
        layout: Mapping[str, Any] | None = None,
    ) -> None:
        if not isinstance(algebra, LieAlgebra):
            raise TypeError(f"algebra is a {type(algebra).__name__}; give a LieAlgebra, such as co.algebras.so(3)")
        set_fields(self, algebra=algebra, sign=read_sign(sign))
        set_fields(self, name=read_name(name, f"Lie-Poisson system on {algebra.name or 'g*'}"))
        owner = algebra.name or "the algebra"
        set_fields(self, hamiltonian=as_hamiltonian(hamiltonian, algebra.dim, owner, names_for(self, hamiltonian)))
        if isinstance(self.hamiltonian, Summable):
            self.hamiltonian.check_commuting(algebra)
        given_casimirs = None if casimirs is None else read_casimirs(casimirs, self)
        found_integrals = read_integrals({} if integrals is None else integrals, self)
        matrices = algebra.representation
        if representation is not None:
            matrices = check_representation(representation, algebra.triples, algebra.dim, algebra.basis)
        set_fields(self, _casimirs=given_casimirs, _integrals=found_integrals, representation=matrices)
        set_fields(
            self,
            hamiltonian=in_coordinates_of(self, self.hamiltonian),
            _parameters=read_parameters(parameters),
            closed_form=read_closed_form(exact),
            _layout=read_layout(layout, partial(coordinate_names, self)),
        )

    @property
    def dim(self) -> int:  # type: ignore[override]
        return self.algebra.dim

    @property
    def casimirs(self) -> dict[str, Any]:
        """Name to `Polynomial`, `Quadratic` or `Invariant` (a copy); empty by default for many `copies`."""
        if self._casimirs is None:
            set_fields(self, _casimirs=dict(known_or_found_casimirs(self.algebra)))
        return dict(self._named_casimirs)

    @cached_property
    def _named_casimirs(self) -> dict[str, Any]:
        return all_in_coordinates_of(self, self._casimirs or {})

    @property
    def integrals(self) -> dict[str, Any]:
        """Further constants of motion: name to `Polynomial`, `Quadratic` or `Invariant` (a copy)."""
        return all_in_coordinates_of(self, self._integrals)

    @property
    def layout(self) -> dict[str, Any]:
        """Lattice and shape of sites, and kinds and units of coordinates (a copy); empty if not given."""
        return dict(self._layout)

    @cached_if_small
    def _brackets(self) -> tuple[npt.NDArray[Any], ...]:
        """Rows, factors, states and constants of J(x) u: row i gets c x_k u_j, and row j gets -c x_k u_i."""
        i, j, k, c = self.algebra.triples
        return np.concatenate([i, j]), np.concatenate([j, i]), np.concatenate([k, k]), np.concatenate([c, -c])

    @cached_if_small
    def _sums(self) -> ProductSums:
        return ProductSums(self._brackets[0], self._brackets[3], self.dim)

    @cached_property
    def _products_of_field(self) -> Products:
        """The products of the vector field, with partial components of the gradient behind the whole ones."""
        own = field_products(self)
        assert own is not None
        rows, factors, states, constants = self._brackets
        products = Products(rows, states, factors, constants)
        columns = own.columns(products, self.dim)
        retained = columns >= 0
        return Products(rows[retained], states[retained], columns[retained], constants[retained])

    def _product(self, x: npt.NDArray[Any], u: npt.NDArray[Any]) -> npt.NDArray[Any]:
        rows, factors, states, constants = self._brackets
        if x.dtype == object:
            return self._sums((x, states), (u, factors))
        return scatter(rows, constants * x[states] * u[factors], self.dim)

    def _absolute_product(self, x: npt.NDArray[Any], u: npt.NDArray[Any]) -> npt.NDArray[Any]:
        rows, factors, states, constants = self._brackets
        return scatter(rows, np.abs(constants * x[states] * u[factors]), self.dim)

    def hamiltonian_field(self, x: npt.NDArray[Any], t: Any) -> npt.NDArray[Any]:
        own = None if x.dtype == object else field_products(self)
        if own is None:
            return super().hamiltonian_field(x, t)
        rows, states, columns, constants = self._products_of_field
        whole = np.concatenate([self.hamiltonian.gradient(x, t), own.partial_components(x, t)])
        return self.sign * scatter(rows, constants * x[states] * whole[columns], self.dim)

    def _text(self) -> str:
        algebra = self.algebra.name or f"an algebra of dimension {self.dim}"
        return f"<{self.name}: {self.hamiltonian!r} on {algebra}, sign={self.sign:+d}{self._convention()}>"

    def _convention(self) -> str:
        """Return the bracket that the sign of a user's system means; on so(3) the equation, of a body or in space."""
        if self._parameters is not None:
            return ""
        if self.algebra.name != "so(3)":
            return f": {{x_i, x_j}} = {'-' if self.sign < 0 else ''}sum c_ij^k x_k"
        if self.sign < 0:
            return ": x' = cross(x, grad H), as co.systems.rigid_body in its own axes"
        hint = ""
        if isinstance(self.hamiltonian, Quadratic) and np.linalg.eigvalsh(self.hamiltonian.hessian(np.zeros(3)))[0] > 0:
            hint = ", a rigid body backward in time; take sign=-1, or co.systems.rigid_body"
        return f": x' = cross(grad H, x){hint}"
