"""Base class of modified fields: terms by power of the step, exact or pointwise, and tests of invariants."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.system import System
from coadjoint.validation import read_finite, read_number

Floats = npt.NDArray[np.float64]


class ModifiedField(ABC):
    """The modified field f_0 + h f_1 + ... of a scheme on a system; `modified_field` creates it.

    For splittings it is the Hamiltonian vector field of the `ModifiedHamiltonian`.

    Attributes
    ----------
    system, method
        The system and the scheme.
    order : int
        The field has the terms f_k h^k with k < order.
    exact : bool
        Whether the terms are polynomials from exact series; otherwise they are computed pointwise.
    reason : str
        Why the terms are not polynomials; empty if they are.
    """

    def __init__(self, system: System, method: Any, order: int, reason: str) -> None:
        self.system, self.method, self.order, self.reason = system, method, order, reason
        self.exact = not reason

    @property
    @abstractmethod
    def terms(self) -> Mapping[int, Any]:
        """Power k -> f_k: n polynomials, or a function of a state."""

    def values(self, x: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return f_0, f_1, ... at one state or many.

        Parameters
        ----------
        x : (n,) or (m, n)
            The states.

        Returns
        -------
        ndarray, shape (order, n) or (order, m, n)
        """
        states, shape = self._read_states(x)
        return self._values(states).reshape(self.order, *shape)

    @abstractmethod
    def _values(self, x: Floats) -> npt.NDArray[np.float64]:
        """Return f_k at validated states (m, n), shape (order, m, n)."""

    @abstractmethod
    def keeps(self, invariant: Any) -> int | None:
        """Return the first power of h with a term that changes an invariant; None if every term preserves it.

        Parameters
        ----------
        invariant : str, Polynomial, Quadratic or Invariant
            "energy", the name of a Casimir, or a function. An exact field tests polynomials exactly.

        Returns
        -------
        int or None
        """

    @property
    @abstractmethod
    def first_error(self) -> int | None:
        """The first power of h with a term that differs from that of the exact motion; None if no term differs.

        It is the order of the scheme; 0 if f_0 is not the field of the system (wrong coefficients or wrong speed).
        """

    @ignore_overflow
    def __call__(self, x: npt.ArrayLike, h: float) -> Floats:
        """Return f_0(x) + h f_1(x) + ... at one state or many.

        Parameters
        ----------
        x : (n,) or (k, n)
            The states.
        h : float
            The step, negative for backward.

        Returns
        -------
        ndarray of the shape of x
        """
        states, shape = self._read_states(x)
        step = read_number(h, "h")
        total = np.zeros_like(states)
        for term in reversed(self._values(states)):
            total = total * step + term
        return total.reshape(shape)

    @suggest_keywords
    @ignore_overflow
    def skew_matrix(self, x: npt.ArrayLike, h: float) -> Floats:
        """Return the skew K(x, h) = J(x) + O(h^p) with the field sign K grad H, of a scheme that preserves the energy.

        If the terms are polynomials and H is quadratic, the entries of K are polynomials, `skew_terms`. Otherwise
        ``K = J + sign (d g^T - g d^T) / |g|^2`` with g = grad H, not zero, and d the field minus f_0.

        Parameters
        ----------
        x : (n,) or (k, n)
            The states.
        h : float
            The step.

        Returns
        -------
        ndarray, shape (n, n) or (k, n, n)

        Raises
        ------
        ValueError
            The scheme does not preserve the energy; the message gives the power of h and the size.
        """
        states, shape = self._read_states(x)
        step = read_number(h, "h")
        self._check_energy()
        values = self._values(states)
        result = np.empty((*states.shape, self.system.dim))
        for m, state in enumerate(states):
            slope = np.asarray(self.system.hamiltonian.gradient(state))
            if not np.any(slope):
                raise ValueError(
                    f"the gradient of H is zero at {short(state.tolist())}; the matrix is not defined there"
                )
            error = sum((step**k * values[k, m] for k in range(1, self.order)), np.zeros_like(state))
            skew = np.outer(error, slope) - np.outer(slope, error)
            result[m] = self.system.structure_matrix(state) + self.system.sign * skew / (slope @ slope)
        return result.reshape(*shape, self.system.dim)

    def _check_energy(self) -> None:
        power = self.keeps("energy")
        if power is not None:
            raise ValueError(
                f"{self.method} does not keep the energy of {self.system.name}: at h^{power} {self._loss(power)}, so "
                "its field is not a skew matrix times the gradient of H"
            )

    @abstractmethod
    def _loss(self, k: int) -> str:
        """Format the size of grad H . f_k for a message."""

    def _read_states(self, x: npt.ArrayLike) -> tuple[Floats, tuple[int, ...]]:
        states = read_finite(x, "x")
        if states.ndim not in (1, 2) or states.shape[-1] != self.system.dim:
            n = self.system.dim
            raise ValueError(f"x has the shape {states.shape}; it must be ({n},) or (k, {n})")
        return np.atleast_2d(states), states.shape

    def _invariant(self, invariant: Any) -> Any:
        """Return the function for an invariant given by name, or a validated function itself."""
        if isinstance(invariant, str):
            if invariant == "energy":
                return self.system.hamiltonian
            if invariant not in self.system.casimirs:
                known = ", ".join(["energy", *self.system.casimirs])
                raise ValueError(f"{short(invariant)} is not an invariant of {self.system.name}; it has {known}")
            return self.system.casimirs[invariant]
        if isinstance(invariant, type) or not hasattr(invariant, "gradient"):
            raise TypeError(f"{short(invariant)} has no gradient; give a Polynomial, a Quadratic or a name")
        return invariant

    def __repr__(self) -> str:
        kind = "exact polynomials" if self.exact else f"at points ({self.reason})"
        return f"<modified field of {self.method} on {self.system.name}, below h^{self.order}: {kind}>"
