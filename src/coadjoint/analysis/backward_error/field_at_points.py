"""Modified fields: values and terms at points from steps in high precision, and tests of invariants."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.invariants.sampled_checks import sample_points
from coadjoint.analysis.backward_error.step_series import field_at
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.methods.numerics.formal_series import vector
from coadjoint.methods.protocol.method import Method
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian
from coadjoint.systems.system import System
from coadjoint.validation import read_finite, read_number

Floats = npt.NDArray[np.float64]

DISPLACEMENT_BITS = 53  # steps move by about 2^-53 of the state
MAX_DISAGREEMENT = 1e-6  # largest accepted relative disagreement of two sets of steps
SAMPLE_POINTS = (0, 1)  # the sample points of a system at which invariants are tested
CHANGE_THRESHOLD = 1e-9  # relative threshold for a change of an invariant at a point


class ModifiedField:
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

    def __init__(self, system: System, method: Method, order: int, reason: str) -> None:
        self.system, self.method, self.order, self.reason = system, method, order, reason
        self.dim: int = system.dim
        self.exact = not reason
        self._cache: dict[bytes, tuple[Floats, Floats]] = {}

    @property
    def terms(self) -> Mapping[int, Any]:
        """Power k -> f_k: n polynomials, or a function of a state."""

        def term(k: int) -> Callable[[npt.ArrayLike], Floats]:
            return lambda x: self.values(x)[k]

        return MappingProxyType({k: term(k) for k in range(self.order)})

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

    def _values(self, x: Floats) -> npt.NDArray[np.float64]:
        """Return f_k at validated states (m, n), shape (order, m, n)."""
        return np.stack([self.at(state)[0] for state in x], axis=1)

    def at(self, x: npt.ArrayLike) -> tuple[Floats, Floats]:
        """Return f_0(x), f_1(x), ... and their errors, from steps in multiprecision arithmetic.

        Parameters
        ----------
        x : (n,)
            The state.

        Returns
        -------
        values, errors : (order, n) arrays
            The errors are the differences of the values from two sets of steps, one twice as long as the other.

        Raises
        ------
        TypeError
            The step rounds mpmath numbers to fewer digits.
        ValueError
            The two sets disagree: the step has no power series in h at the state.
        """
        from mpmath import mp, workdps

        state = self._read_states(x)[0][0]
        # The truncation error of f_k is h^(order - k), and its rounding error is divided by h^(k + 1).
        digits = 30 + int(0.302 * (DISPLACEMENT_BITS + 4) * (self.order + 2))
        with workdps(digits), long_operation("a modified field at a point"):
            exact = vector(map(mp.mpf, state.tolist()))
            slope = np.abs(np.asarray(self.system.vector_field(state), dtype=np.float64)).max()
            size = np.abs(state).max()
            unit = mp.ldexp(1, -DISPLACEMENT_BITS) * (mp.mpf(size) / slope if slope and size else 1)
            multiples = [k // 2 + 1 if k % 2 == 0 else -(k // 2 + 1) for k in range(self.order)]
            sets = [
                field_at(self._checked_step, exact, [factor * unit * multiple for multiple in multiples])
                for factor in (1, 2)
            ]
            errors = np.array(abs(sets[1] - sets[0]), dtype=np.float64)
        values = np.array(sets[0], dtype=np.float64)
        rate = slope / size if slope and size else 1.0
        with np.errstate(over="ignore", invalid="ignore"):  # overflow fails the test below
            scale = np.maximum(np.abs(values).max(axis=1), max(slope, size) * rate ** np.arange(self.order))
            worst = np.max(errors / scale[:, None], axis=1)
        if not np.all(worst <= MAX_DISAGREEMENT):
            k = int(np.flatnonzero(~(worst <= MAX_DISAGREEMENT))[0])
            raise ValueError(
                f"f_{k} of {self.method} differs by {worst[k]:.2g} of its size between two sets of steps at "
                f"{short(state.tolist())}: the step has no power series in h there, or rounds"
            )
        return values, errors

    def check_steps(self) -> None:
        """Raise TypeError or ValueError if steps from a sample point have no power series in the step."""
        self._at_sample_point(0)

    def _at_sample_point(self, number: int) -> tuple[Floats, Floats, Floats]:
        """Return a sample point with the values there and their errors, cached."""
        state = sample_points(self.system.dim)[number]
        key = state.tobytes()
        if key not in self._cache:
            self._cache[key] = self.at(state)
        return (state, *self._cache[key])

    def _checked_step(self, x: npt.NDArray[Any], h: Any) -> npt.NDArray[Any]:
        note_progress(f"a step of {self.method} in many digits")
        end = np.asarray(self.method.step(self.system, x, 0 * h, h))
        if end.dtype != object or end.shape != x.shape:
            raise TypeError(
                f"a step of {self.method} from {len(x)} mpmath numbers returned {end.dtype} of shape {end.shape}; a "
                f"modified field needs steps in mpmath numbers ({self.reason})"
            )
        return end

    def keeps(self, invariant: Any) -> int | None:
        """Return the first power of h with a term that changes an invariant; None if every term preserves it.

        Parameters
        ----------
        invariant : str, Polynomial, Quadratic or Invariant
            "energy", the name of a Casimir, or a function. An exact field tests polynomials exactly, other fields test
            at sample points.

        Returns
        -------
        int or None
        """
        function = self._invariant(invariant)
        gradient = (as_hamiltonian(function, self.system.dim) if hasattr(function, "monomials") else function).gradient
        powers = []
        for state, values, _ in map(self._at_sample_point, SAMPLE_POINTS):
            slope = np.asarray(gradient(state))
            speed = np.abs(values[0]).max()
            for k in range(self.order):
                scale = max(np.abs(values[k]).max(), speed * (speed / np.abs(state).max()) ** k)
                if abs(slope @ values[k]) > CHANGE_THRESHOLD * np.abs(slope).sum() * scale:
                    powers.append(k)
        return min(powers, default=None)

    @property
    def first_error(self) -> int | None:
        """The first power of h with a term that differs from that of the exact motion; None if no term differs.

        It is the order of the scheme; 0 if f_0 is not the field of the system (wrong coefficients or wrong speed).
        """
        for k in range(self.order):
            for state, values, errors in map(self._at_sample_point, SAMPLE_POINTS):
                field = np.asarray(self.system.vector_field(state))
                rate = np.abs(field).max() / np.abs(state).max()
                tolerance = CHANGE_THRESHOLD * np.abs(field).max() * rate**k
                if np.any(np.abs(values[k] - field * (k == 0)) > tolerance + 2 * errors[k]):
                    return k
        return None

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

    def _loss(self, k: int) -> str:
        state, values, _ = self._at_sample_point(0)
        change = np.asarray(self.system.hamiltonian.gradient(state)) @ values[k]
        return f"grad H . f is {change:.3g} at {short(state.tolist())}"

    def _read_states(self, x: npt.ArrayLike) -> tuple[Floats, tuple[int, ...]]:
        states = read_finite(x, "x")
        if states.ndim not in (1, 2) or states.shape[-1] != self.system.dim:
            n = self.system.dim
            raise ValueError(f"x has the shape {states.shape}; it must be ({n},) or (k, {n})")
        return np.atleast_2d(states), states.shape

    def _invariant(self, invariant: Any) -> Any:
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
