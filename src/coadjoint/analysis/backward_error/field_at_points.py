"""Modified fields evaluated pointwise, from steps in multiprecision arithmetic."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.analysis.backward_error.field_of_step import field_at
from coadjoint.analysis.backward_error.modified_field_base import Floats, ModifiedField
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.methods.formal.formal_numbers import vector
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian
from coadjoint.systems.system import System
from coadjoint.systems.user_functions import sample_points

DISPLACEMENT_BITS = 53  # steps move by about 2^-53 of the state
MAX_DISAGREEMENT = 1e-6  # largest accepted relative disagreement of two sets of steps
SAMPLE_POINTS = (0, 1)  # the sample points of a system at which invariants are tested
CHANGE_THRESHOLD = 1e-9  # relative threshold for a change of an invariant at a point


class FieldAtPoints(ModifiedField):
    """A modified field evaluated pointwise, from steps in multiprecision arithmetic."""

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
        self._cache: dict[bytes, tuple[Floats, Floats]] = {}
        self._at_sample_point(0)

    @property
    def terms(self) -> Mapping[int, Callable[[npt.ArrayLike], Floats]]:
        """Power k -> f_k as a function of a state."""

        def term(k: int) -> Callable[[npt.ArrayLike], Floats]:
            return lambda x: self.values(x)[k]

        return MappingProxyType({k: term(k) for k in range(self.order)})

    def _values(self, x: Floats) -> npt.NDArray[np.float64]:
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

    def _at_sample_point(self, number: int) -> tuple[Floats, Floats, Floats]:
        """Return a sample point with the values there and their errors, cached."""
        state = sample_points(self.system.dim)[number]
        key = state.tobytes()
        if key not in self._cache:
            self._cache[key] = self.at(state)
        return (state, *self._cache[key])

    def _checked_step(self, x: npt.NDArray[Any], h: Any) -> npt.NDArray[Any]:
        note_progress(f"a step of {self.method} in many digits")
        end = np.asarray(self._step(x, h))
        if end.dtype != object or end.shape != x.shape:
            raise TypeError(
                f"a step of {self.method} from {len(x)} mpmath numbers returned {end.dtype} of shape {end.shape}; a "
                f"modified field needs steps in mpmath numbers ({self.reason})"
            )
        return end

    @property
    def first_error(self) -> int | None:
        for k in range(self.order):
            for state, values, errors in map(self._at_sample_point, SAMPLE_POINTS):
                field = np.asarray(self.system.vector_field(state))
                rate = np.abs(field).max() / np.abs(state).max()
                tolerance = CHANGE_THRESHOLD * np.abs(field).max() * rate**k
                if np.any(np.abs(values[k] - field * (k == 0)) > tolerance + 2 * errors[k]):
                    return k
        return None

    def keeps(self, invariant: Any) -> int | None:
        """Return the first power of h with a term that changes a function at sample points; None if there is none."""
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

    def _loss(self, k: int) -> str:
        state, values, _ = self._at_sample_point(0)
        change = np.asarray(self.system.hamiltonian.gradient(state)) @ values[k]
        return f"grad H . f is {change:.3g} at {short(state.tolist())}"
