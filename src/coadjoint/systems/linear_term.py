"""The linear term of a Hamiltonian: a field, gravity, rotors. Which is it, and what is the system with another one?"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomial import Polynomial
from coadjoint.systems.hamiltonian import HamiltonianLike, PolynomialHamiltonian
from coadjoint.systems.kinds import System
from coadjoint.systems.quadratic import Quadratic
from coadjoint.systems.split_hamiltonian import SplitHamiltonian
from coadjoint.wording import short

Floats = npt.NDArray[np.float64]


def linear_of(H: HamiltonianLike, n: int) -> Floats:
    """Return the coefficients of the linear term of a Hamiltonian.

    Parameters
    ----------
    H : Quadratic, Polynomial or SplitHamiltonian
        Bound to n coordinates. A piece that is a function of Python has no linear term of its own.
    n : int
        Number of coordinates.

    Returns
    -------
    ndarray, shape (n,)

    Raises
    ------
    TypeError
        The Hamiltonian is a function, or of a kind of the user.

    Examples
    --------
    >>> linear_of(Quadratic([1.0, 2.0], linear=[0.0, 3.0]), 2)
    array([0., 3.])
    """
    if isinstance(H, Quadratic):
        (term,) = H.terms()
        assert term.form is not None
        return np.array(term.form.linear)
    found = np.zeros(n)
    if isinstance(H, PolynomialHamiltonian):
        for exponents, coefficient in H.polynomial.monomials.items():
            if sum(exponents) == 1:
                found[exponents.index(1)] = float(coefficient)
        return found
    if isinstance(H, SplitHamiltonian):
        for coordinates, piece in zip(H.coordinates, H.pieces, strict=True):
            if _has_linear(piece):
                found[list(coordinates)] += linear_of(piece, len(coordinates))
        return found
    raise TypeError(
        f"the Hamiltonian is a {type(H).__name__}, which has no linear term that could change; give a Quadratic or a "
        "Polynomial, or a SplitHamiltonian with such a piece"
    )


def _has_linear(H: HamiltonianLike) -> bool:
    return isinstance(H, Quadratic | PolynomialHamiltonian | SplitHamiltonian)


def with_linear(system: System, linear: Floats) -> System:
    """Return the system whose Hamiltonian has another linear term, and is else the same.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        With a Hamiltonian that `linear_of` reads.
    linear : ndarray, shape (n,)
        The coefficients.

    Returns
    -------
    LiePoissonSystem or PoissonSystem
        With the same bracket, Casimirs and representation; without closed form, further integrals and parameters, which
        belong to the Hamiltonian.

    Raises
    ------
    TypeError
        The Hamiltonian has no linear term that could change.
    ValueError
        No piece of a SplitHamiltonian, or more than one, has a coordinate whose coefficient is another one.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body((1, 2, 3))
    >>> with_linear(body, np.array([0.0, 0.0, 0.5])).energy([0.0, 0.0, 3.0]) - body.energy([0.0, 0.0, 3.0])
    1.5
    """
    changed = copy.copy(system)
    fields: dict[str, Any] = {
        "hamiltonian": _other(system.hamiltonian, np.asarray(linear, dtype=np.float64)),
        "_exact": None,
        "_parameters": None,
        "_integrals": {},
    }
    for name, value in fields.items():
        if hasattr(system, name):
            object.__setattr__(changed, name, value)
    return changed


def _other(H: HamiltonianLike, linear: Floats) -> HamiltonianLike:
    if isinstance(H, Quadratic):
        return H.with_linear(linear)
    if isinstance(H, PolynomialHamiltonian):
        monomials = {e: c for e, c in H.polynomial.monomials.items() if sum(e) != 1}
        n = H.polynomial.dim
        for k in np.flatnonzero(linear).tolist():
            monomials[tuple(int(i == k) for i in range(n))] = float(linear[k])
        return PolynomialHamiltonian(Polynomial(monomials, dim=n))
    if isinstance(H, SplitHamiltonian):
        return _other_split(H, linear)
    raise TypeError(f"the Hamiltonian is a {type(H).__name__}, which has no linear term that could be another one")


def _other_split(H: SplitHamiltonian, linear: Floats) -> SplitHamiltonian:
    changed = np.flatnonzero(linear != linear_of(H, len(linear))).tolist()
    owners: dict[int, int] = {}
    for k in changed:
        own = [p for p, (where, piece) in enumerate(zip(H.coordinates, H.pieces, strict=True)) if k in where]
        able = [p for p in own if _has_linear(H.pieces[p])]
        if len(able) != 1:
            raise ValueError(
                f"the linear coefficient of coordinate {k} belongs to {len(able)} pieces of the SplitHamiltonian that "
                f"are polynomials; one piece must have it, such as (({k},), Quadratic(0.0, linear=[1.0]))"
            )
        owners[k] = able[0]
    pieces = []
    for p, (where, piece) in enumerate(zip(H.coordinates, H.pieces, strict=True)):
        mine = [k for k, owner in owners.items() if owner == p]
        if mine:
            own_linear = linear_of(piece, len(where))
            for k in mine:
                own_linear[where.index(k)] = linear[k]
            piece = _other(piece, own_linear)
        pieces.append((where, piece))
    return SplitHamiltonian(pieces).bind(len(linear))


def check_linear(system: Any) -> None:
    """Refuse a system whose Hamiltonian has no linear term that could change.

    Examples
    --------
    >>> import coadjoint as co
    >>> check_linear(co.systems.rigid_body((1, 2, 3)))
    """
    try:
        linear_of(system.hamiltonian, system.dim)
    except TypeError as reason:
        raise TypeError(f"{short(system.name)} cannot take inputs: {reason}") from None
