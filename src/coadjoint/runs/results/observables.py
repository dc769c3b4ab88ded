"""Observed quantities (`observe`), compiled once, and invariants of matrices, evaluated at the saved points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.errors import in_one_line
from coadjoint.kernels.loop import NamedArrays
from coadjoint.kernels.tables.recording import values_along
from coadjoint.runs.start import Start
from coadjoint.runs.times import Times
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.system import System
from coadjoint.systems.user_functions import takes_time, with_time
from coadjoint.validation import read_number

Floats = NDArray[np.float64]


class Observed:
    """Quantities evaluated at saved points; each function is called once at x0 for validation."""

    def __init__(self, system: System, observe: Mapping[str, Any], x0: Floats) -> None:
        from coadjoint.kernels.tables.invariants import watch_tables

        self._names, self._matrices = list(observe), system.unforced if system.has_matrices else None
        self._quantities = dict(observe)
        start: Any = x0
        if self._matrices is not None:
            start = self._matrices.states_of(x0)
            _check_matrix_functions(self._matrices, observe)
        for name, quantity in observe.items():
            value = _value_at(quantity, name, start.copy())
            if np.ndim(value) != 0 or np.asarray(value).dtype.kind not in "iuf":
                raise TypeError(
                    f"observe[{short(name)}] returns {short(value)} at the start; it must return one real number"
                )
        if self._matrices is not None:
            return
        kinds = (Polynomial, Quadratic, Invariant)
        wrapped = {
            name: quantity if isinstance(quantity, kinds) else Invariant(quantity) for name, quantity in observe.items()
        }
        self._compiled, self._values_along = watch_tables(system, wrapped), values_along

    def along(self, t: Floats, points: Floats) -> dict[str, Floats]:
        """Return the values (k, members) of every quantity at the times (k,) and points (k, members, n)."""
        if self._matrices is not None:
            return {name: self._of_matrices(name, t, points) for name in self._names}
        # The first invariant of a watch is the energy.
        out = np.empty((*points.shape[:2], len(self._names) + 1))
        self._values_along(self._compiled.tables, points, t, out)
        return {name: out[..., i + 1] for i, name in enumerate(self._names)}

    def _of_matrices(self, name: str, t: Floats, points: Floats) -> Floats:
        """Evaluate a Python function of a matrix at all points; NaN for failed members."""
        assert self._matrices is not None
        function, system = with_time(self._quantities[name], name), self._matrices
        values = np.full(points.shape[:2], np.nan)
        for k, m in np.argwhere(np.isfinite(points).all(axis=-1)).tolist():
            W = system.states_of(points[k, m, : system.dim].copy())
            values[k, m] = read_number(function(W, float(t[k])), f"what observe[{short(name)}] returns at t = {t[k]:g}")
        return values


class MatrixInvariants:
    """The energy and the invariants of a system of matrices, and with `accounts` the same minus the work of forces."""

    def __init__(self, system: MatrixSystem, names: Sequence[str], accounts: Sequence[tuple[str, str]]) -> None:
        self._system, self._names, self._accounts = system, names, accounts

    def measure(
        self, times: Times, start: Start, saved: NamedArrays, worst: NDArray[Any], points: NDArray[np.int64]
    ) -> None:
        """Compute the values at new saved `points` in place, and the largest deviations, `worst`, in each tenth."""
        if not len(points):
            return
        first = self._values(start.momenta, times.t0)
        for k in points.tolist():
            number = int(times.saved[k])
            values = saved["values"][k] = self._values(saved["x"][k], float(times.at(times.saved[k])))
            tenth = max(0, number - 1) * worst.shape[1] // max(1, times.steps)
            with np.errstate(invalid="ignore"):  # members may be about to overflow
                worst[:, tenth] = np.fmax(worst[:, tenth], np.abs(values - first))

    def at(self, states: Floats, t: Floats) -> Floats:
        """Return the values of states (m, size) at times (m,)."""
        return np.concatenate([self._values(x[None], time) for x, time in zip(states, t.tolist(), strict=True)])

    def _values(self, states: Floats, t: float) -> Floats:
        system = self._system
        # States after a failure are NaN; user functions are not called on them.
        finite = np.isfinite(states[:, : system.dim]).all(axis=-1)
        result = np.full((len(states), len(self._names) * (2 if self._accounts else 1)), np.nan)
        W = system.from_vector(states[finite, : system.dim])
        with np.errstate(all="ignore"):
            values = [system.energy(W, t), *system.casimirs_at(W).values()]
        if self._accounts:
            # Minus the work of the forces, from the accounts of a state; the start has none.
            work = {name: np.zeros(len(W)) for name in self._names}
            for (_, name), column in zip(self._accounts, states[finite, system.dim :].T, strict=False):
                work[name] += column
            values += [value - work[name] for value, name in zip(values, self._names, strict=True)]
        result[finite] = np.stack(values, axis=-1)
        return result


def _check_matrix_functions(system: MatrixSystem, observe: Mapping[str, Any]) -> None:
    for name, quantity in observe.items():
        if isinstance(quantity, Polynomial | Quadratic):
            raise TypeError(
                f"observe[{short(name)}] is a function of coordinates, and the states of {system.name} are matrices; "
                "give a function of a matrix"
            )


def check_observe(observe: Any) -> dict[str, Any]:
    """Validate `observe` and return a copy."""
    if not isinstance(observe, Mapping) or not all(isinstance(name, str) for name in observe):
        raise TypeError(f"observe is {short(observe)}; it must map names to Polynomials or functions of x")
    for name, quantity in observe.items():
        if not isinstance(quantity, Polynomial | Quadratic | Invariant) and not callable(quantity):
            raise TypeError(
                f"observe[{short(name)}] is {short(quantity)}; it must be a Polynomial or a function, or a Quadratic"
            )
    return dict(observe)


def _value_at(quantity: Any, name: str, x0: Floats) -> Any:
    """Evaluate a quantity at the start; NaN if it is undefined there, as in the run."""
    try:
        return 0.0 if isinstance(quantity, Polynomial | Quadratic) or takes_time(quantity, name) else quantity(x0)
    except (ArithmeticError, ValueError, OSError):
        return float("nan")
    except (IndexError, KeyError, TypeError, AttributeError) as reason:
        message = in_one_line(str(reason), 200)
        raise type(reason)(f"observe[{short(name)}] cannot be evaluated at the start: {message}") from None
