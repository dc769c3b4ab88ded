"""What a modified field is: terms by power of the step, exact or computed at points, and what they keep."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.exact_polynomials import Exact
from coadjoint.algebra.polynomial import Polynomial
from coadjoint.algebra.polynomial_text import coordinate_names, readable_latex
from coadjoint.algebra.product_sums import ProductSum
from coadjoint.analysis.field_of_step import Field, field_at, size_of
from coadjoint.analysis.hamiltonian_fields import bracket_change, hamiltonian_of
from coadjoint.analysis.skew_fields import Matrix, skew_factor
from coadjoint.analysis.step_series import ExactSystem
from coadjoint.given import read_finite, read_number
from coadjoint.methods.formal_numbers import vector
from coadjoint.systems.hamiltonian import as_hamiltonian
from coadjoint.systems.kinds import System
from coadjoint.systems.points import QUIET
from coadjoint.systems.user_functions import sample_points
from coadjoint.wording import short

Floats = npt.NDArray[np.float64]
SLIGHT = 53  # the steps of the numerical way move by about 2^-53 of the state
WORTH = 1e-6  # relative disagreement of two sets of steps that is still a result
SAMPLES = (0, 1)  # the sample points of a system at which a term is looked at
SEEN = 1e-9  # relative size from which a change that was computed at points is one


class ModifiedField(ABC):
    """The field f_0 + h f_1 + ... of a scheme on a system, see `modified_field`.

    Attributes
    ----------
    system, method
        Whose it is.
    order : int
        The terms f_k h^k with k < order are there.
    exact : bool
        Whether the terms are polynomials from exact series; otherwise they are computed at each point.
    reason : str
        Why they are not polynomials; empty where they are.
    """

    def __init__(self, system: System, method: Any, order: int, reason: str) -> None:
        self.system, self.method, self.order, self.reason = system, method, order, reason
        self.exact = not reason

    @property
    @abstractmethod
    def terms(self) -> Mapping[int, Any]:
        """Power k -> f_k: n polynomials, or a function of a state."""

    @abstractmethod
    def values(self, x: Floats) -> npt.NDArray[np.float64]:
        """Return f_k at states (m, n), shape (order, m, n)."""

    @abstractmethod
    def keeps(self, invariant: Any) -> int | None:
        """Return the first power of h whose term does not keep a function; None where all of them keep it.

        Parameters
        ----------
        invariant : str, Polynomial, Quadratic or Invariant
            "energy", the name of a Casimir, or a function. Polynomials are asked exactly where the field is exact.

        Returns
        -------
        int or None
        """

    @property
    @abstractmethod
    def first_error(self) -> int | None:
        """The first power of h whose term is not that of the motion, the order of the scheme; None where all are.

        It is 0 where f_0 is another field, that of a scheme with a wrong coefficient or at a wrong speed.
        """

    @QUIET
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
        states, given = self._states(x)
        step = read_number(h, "h")
        total = np.zeros_like(states)
        for term in reversed(self.values(states)):
            total = total * step + term
        return total.reshape(given)

    @QUIET
    def skew_matrix(self, x: npt.ArrayLike, h: float) -> Floats:
        """Return the skew matrix K(x, h) = J(x) + O(h^p) of a scheme that keeps the energy: the field is sign K grad H.

        Where the terms are polynomials and H is quadratic, K is of polynomials, `skew_terms`. Elsewhere it is
        K = J + sign (d g^T - g d^T) / |g|^2 with g = grad H and d the field less f_0, where g is not zero.

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
            The scheme does not keep the energy; with the power of h and the size.
        """
        states, given = self._states(x)
        step = read_number(h, "h")
        self._check_energy()
        values = self.values(states)
        result = np.empty((*states.shape, self.system.dim))
        for m, state in enumerate(states):
            slope = np.asarray(self.system.hamiltonian.gradient(state))
            if not np.any(slope):
                raise ValueError(
                    f"the gradient of H is zero at {short(state.tolist())}; the matrix is not defined there"
                )
            rest = sum((step**k * values[k, m] for k in range(1, self.order)), np.zeros_like(state))
            skew = np.outer(rest, slope) - np.outer(slope, rest)
            result[m] = self.system.structure_matrix(state) + self.system.sign * skew / (slope @ slope)
        return result.reshape(*given, self.system.dim)

    def _check_energy(self) -> None:
        lost = self.keeps("energy")
        if lost is not None:
            raise ValueError(
                f"{self.method} does not keep the energy of {self.system.name}: at h^{lost} {self._loss(lost)}, so its "
                "field is no skew matrix times the gradient of H"
            )

    @abstractmethod
    def _loss(self, k: int) -> str:
        """Return how grad H . f_k is not zero."""

    def _states(self, x: npt.ArrayLike) -> tuple[Floats, tuple[int, ...]]:
        states = read_finite(x, "x")
        if states.ndim not in (1, 2) or states.shape[-1] != self.system.dim:
            n = self.system.dim
            raise ValueError(f"x has the shape {states.shape}; it must be ({n},) or (k, {n})")
        return np.atleast_2d(states), states.shape

    def _invariant(self, given: Any) -> Any:
        if isinstance(given, str):
            if given == "energy":
                return self.system.hamiltonian
            if given not in self.system.casimirs:
                known = ", ".join(["energy", *self.system.casimirs])
                raise ValueError(f"{short(given)} is no invariant of {self.system.name}; it has {known}")
            return self.system.casimirs[given]
        if isinstance(given, type) or not hasattr(given, "gradient"):
            raise TypeError(f"{short(given)} is no function with a gradient; give a Polynomial, a Quadratic or a name")
        return given

    def __repr__(self) -> str:
        how = "exact polynomials" if self.exact else f"at points ({self.reason})"
        return f"<modified field of {self.method} on {self.system.name}, below h^{self.order}: {how}>"


class ExactField(ModifiedField):
    """A modified field of polynomials.

    Attributes
    ----------
    known_to : float
        Relative error of the scheme's own coefficients. Where they are rounded, what the scheme keeps is still kept
        exactly by each term; terms below its order that are no more than that rounding are zero.
    """

    def __init__(
        self,
        system: System,
        method: Any,
        order: int,
        given: ExactSystem,
        fields: list[Field],
        known_to: float,
    ) -> None:
        super().__init__(system, method, order, "")
        self._given, self._fields, self.known_to = given, fields, known_to

    @cached_property
    def terms(self) -> Mapping[int, tuple[Polynomial, ...]]:
        """Power k -> the n polynomials of f_k."""
        polynomial = self._given.ring.polynomial
        return MappingProxyType({k: tuple(map(polynomial, f)) for k, f in enumerate(self._fields)})

    @cached_property
    def _table(self) -> ProductSum:
        return Polynomial.side_by_side([F for term in self.terms.values() for F in term])

    def values(self, x: Floats) -> npt.NDArray[np.float64]:
        return self._table.along(x).reshape(len(x), self.order, -1).transpose(1, 0, 2)

    @property
    def first_error(self) -> int | None:
        motion = [self._given.field, *[[self._given.ring.zero] * self.system.dim] * (self.order - 1)]
        return next((k for k, (f, due) in enumerate(zip(self._fields, motion, strict=True)) if f != due), None)

    def rate(self, invariant: Any) -> dict[int, Polynomial]:
        """Return what is not zero of grad F . f_k: how fast a function changes, by power of h.

        Parameters
        ----------
        invariant : str, Polynomial or Quadratic
            "energy", the name of a Casimir, or a function that is a polynomial.

        Returns
        -------
        dict
            Power -> Polynomial.
        """
        return {k: self._given.ring.polynomial(F) for k, F in self._changes(self._polynomial(invariant)).items()}

    def keeps(self, invariant: Any) -> int | None:
        return next(iter(self._changes(self._polynomial(invariant))), None)

    def _polynomial(self, given: Any) -> Exact:
        found = self._invariant(given)
        if isinstance(found, Polynomial):
            return self._given.ring.of(found)
        try:
            return self._given.value_of(as_hamiltonian(found, self.system.dim).value)
        except (TypeError, AttributeError, ArithmeticError) as reason:
            raise TypeError(f"{short(given)} is no polynomial, and only of those it is known what is kept") from reason

    def _changes(self, F: Exact) -> dict[int, Exact]:
        ring, found = self._given.ring, {}
        for k, field in enumerate(self._fields):
            change = ring.along(field, F)
            if change != 0:
                found[k] = change
        return found

    def _loss(self, k: int) -> str:
        change = self._changes(self._given.energy)[k]
        return f"grad H . f has a coefficient of {size_of(change):.3g}"

    @cached_property
    def skew_terms(self) -> Mapping[int, tuple[tuple[Polynomial, ...], ...]]:
        """Power k -> the skew K_k of polynomials with f_k = sign K_k grad H, K_0 = J, where H is quadratic.

        Raises
        ------
        ValueError
            The scheme does not keep the energy, with the power of h and the size; or H is not quadratic.
        """
        self._check_energy()
        ring, sign, found = self._given.ring, self.system.sign, {}
        for k, field in enumerate(self._fields):
            K: Matrix = self._given.structure
            if k:
                K = skew_factor(ring, self._given.energy, [sign * f for f in field])
            found[k] = tuple(tuple(map(ring.polynomial, row)) for row in K)
        return MappingProxyType(found)

    @cached_property
    def _skew_table(self) -> ProductSum:
        return Polynomial.side_by_side([F for K in self.skew_terms.values() for row in K for F in row])

    @QUIET
    def skew_matrix(self, x: npt.ArrayLike, h: float) -> Floats:
        if self._given.energy.total_degree() > 2:
            return super().skew_matrix(x, h)
        states, given = self._states(x)
        n, step = self.system.dim, read_number(h, "h")
        values = self._skew_table.along(states).reshape(len(states), self.order, n, n)
        return np.einsum("mkij,k->mij", values, step ** np.arange(self.order)).reshape(*given, n)

    @cached_property
    def poisson_defects(self) -> Mapping[int, float]:
        """Power k -> the largest coefficient of L_f J for f = f_k, the change of the bracket; only those not zero.

        Where there are none, the scheme is a Poisson map to this order.
        """
        ring, J, found = self._given.ring, self._given.structure, {}
        for k, field in enumerate(self._fields):
            size = bracket_change(ring, J, field)
            if size:
                found[k] = size
        return MappingProxyType(found)

    @cached_property
    def hamiltonians(self) -> Mapping[int, Polynomial]:
        """Power k -> the H_k with f_k = sign J grad H_k, of a scheme that is a Poisson map; unique up to Casimirs.

        Raises
        ------
        ValueError
            The scheme is no Poisson map, with the power of h and the size; or the field is Poisson without being
            Hamiltonian: it moves a Casimir, or belongs to no polynomial.
        """
        for k, size in self.poisson_defects.items():
            raise ValueError(
                f"{self.method} is no Poisson map on {self.system.name}: at h^{k} the change of the bracket along its "
                f"field has a coefficient of {size:.3g}"
            )
        for name, C in self._given.casimirs.items():
            for k, change in self._changes(C).items():
                raise ValueError(
                    f"the field of {self.method} on {self.system.name} is not Hamiltonian: at h^{k} it moves {name}, "
                    f"with a coefficient of {size_of(change):.3g}"
                )
        ring, sign, found = self._given.ring, self.system.sign, {0: self._given.energy}
        for k, field in enumerate(self._fields[1:], 1):
            H = hamiltonian_of(ring, self._given.structure, [sign * f for f in field])
            if H is None:
                raise ValueError(
                    f"the term f_{k} of {self.method} on {self.system.name} is Poisson, but J grad H of no polynomial H"
                )
            found[k] = H
        return MappingProxyType({k: ring.polynomial(H) for k, H in found.items()})

    def to_latex(self) -> str:
        """Return the terms that are not zero, as lines of LaTeX ``f_{k} = ...``, transposed, all digits."""
        return self._lines(Polynomial.to_latex)

    def _repr_latex_(self) -> str:
        return f"$${self._lines(lambda F: readable_latex(F.monomials, coordinate_names(F.dim)))}$$"

    def _lines(self, written: Callable[[Polynomial], str]) -> str:
        lines = [
            rf"f_{{{k}}} = \left({', '.join(map(written, term))}\right)^T"
            for k, term in self.terms.items()
            if any(F.monomials for F in term)
        ]
        return " \\\\\n".join(lines)


class FieldAtPoints(ModifiedField):
    """A modified field whose terms are computed at each point, from steps in many digits."""

    def __init__(
        self,
        system: System,
        method: Any,
        order: int,
        reason: str,
        step: Callable[[npt.NDArray[Any], Any], Any],
    ) -> None:
        super().__init__(system, method, order, reason)
        self._step = step
        self._found: dict[bytes, tuple[Floats, Floats]] = {}
        self._sampled(0)

    @property
    def terms(self) -> Mapping[int, Callable[[npt.ArrayLike], Floats]]:
        """Power k -> a function of a state."""

        def term(k: int) -> Callable[[npt.ArrayLike], Floats]:
            return lambda x: self.values(self._states(x)[0])[k].reshape(np.shape(x))

        return MappingProxyType({k: term(k) for k in range(self.order)})

    def values(self, x: Floats) -> npt.NDArray[np.float64]:
        return np.stack([self.at(state)[0] for state in x], axis=1)

    def at(self, x: npt.ArrayLike) -> tuple[Floats, Floats]:
        """Return f_0(x), f_1(x), ... and their errors.

        Parameters
        ----------
        x : (n,)
            The state.

        Returns
        -------
        values, errors : (order, n) arrays
            The errors are the differences of the values from two sets of steps, of which one is twice the other.

        Raises
        ------
        TypeError
            The step does not keep the digits of mpmath's numbers.
        ValueError
            The two sets disagree: the step is no power series in h there.
        """
        from mpmath import mp, workdps

        state = self._states(x)[0][0]
        # f_k is known to h^(order - k), and loses h^(k + 1) to rounding.
        digits = 30 + int(0.302 * (SLIGHT + 4) * (self.order + 2))
        with workdps(digits):
            exact = vector(map(mp.mpf, state.tolist()))
            slope = np.abs(np.asarray(self.system.vector_field(state), dtype=np.float64)).max()
            size = np.abs(state).max()
            unit = mp.ldexp(1, -SLIGHT) * (mp.mpf(size) / slope if slope and size else 1)
            multiples = [k // 2 + 1 if k % 2 == 0 else -(k // 2 + 1) for k in range(self.order)]
            sets = [
                field_at(self._stepped, exact, [factor * unit * multiple for multiple in multiples])
                for factor in (1, 2)
            ]
            errors = np.array(abs(sets[1] - sets[0]), dtype=np.float64)
        values = np.array(sets[0], dtype=np.float64)
        rate = slope / size if slope and size else 1.0
        scale = np.maximum(np.abs(values).max(axis=1), max(slope, size) * rate ** np.arange(self.order))
        worst = np.max(errors / scale[:, None], axis=1)
        if not np.all(worst <= WORTH):
            k = int(np.flatnonzero(~(worst <= WORTH))[0])
            raise ValueError(
                f"f_{k} of {self.method} differs by {worst[k]:.2g} of its size between two sets of steps at "
                f"{short(state.tolist())}: there the step is no power series in h, or it rounds"
            )
        return values, errors

    def _sampled(self, which: int) -> tuple[Floats, Floats, Floats]:
        """Return a sample point with the values there and their errors, computed once."""
        state = sample_points(self.system.dim)[which]
        key = state.tobytes()
        if key not in self._found:
            self._found[key] = self.at(state)
        return (state, *self._found[key])

    def _stepped(self, x: npt.NDArray[Any], h: Any) -> npt.NDArray[Any]:
        end = np.asarray(self._step(x, h))
        if end.dtype != object or end.shape != x.shape:
            raise TypeError(
                f"a step of {self.method} from {len(x)} mpmath numbers returned {end.dtype} of shape {end.shape}; a "
                f"modified field is found from their digits ({self.reason})"
            )
        return end

    @property
    def first_error(self) -> int | None:
        for k in range(self.order):
            for state, values, errors in map(self._sampled, SAMPLES):
                motion = np.asarray(self.system.vector_field(state))
                rate = np.abs(motion).max() / np.abs(state).max()
                least = SEEN * np.abs(motion).max() * rate**k
                if np.any(np.abs(values[k] - motion * (k == 0)) > least + 2 * errors[k]):
                    return k
        return None

    def keeps(self, invariant: Any) -> int | None:
        """Return the first power of h whose term does not keep a function at sample points; None where all keep it."""
        given = self._invariant(invariant)
        gradient = (as_hamiltonian(given, self.system.dim) if hasattr(given, "monomials") else given).gradient
        lost = [self.order]
        for state, values, _ in map(self._sampled, SAMPLES):
            slope = np.asarray(gradient(state))
            motion = np.abs(values[0]).max()
            for k in range(self.order):
                scale = max(np.abs(values[k]).max(), motion * (motion / np.abs(state).max()) ** k)
                if abs(slope @ values[k]) > SEEN * np.abs(slope).sum() * scale:
                    lost.append(k)
        return None if min(lost) == self.order else min(lost)

    def _loss(self, k: int) -> str:
        state, values, _ = self._sampled(0)
        change = np.asarray(self.system.hamiltonian.gradient(state)) @ values[k]
        return f"grad H . f is {change:.3g} at {short(state.tolist())}"
