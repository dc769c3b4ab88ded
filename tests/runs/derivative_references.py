"""Runs in many digits by the plain interpreter, and their derivatives as central differences."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import mpmath
import numpy as np

from coadjoint.methods.protocol.flow_method import flows_of
from coadjoint.program.interpreter import Interpreter
from coadjoint.program.sweeps import Rows, Sweep

DIGITS = 40
SMALL = mpmath.mpf(10) ** -15
"""Half the width of central differences: their error is of the size 1e-30, and rounding 1e-25."""
ADDED = -1

Numbers = np.ndarray


class Kick(NamedTuple):
    """A part `size` G of the energy, of which the gradient is given; small: it is applied to the first order."""

    size: Any
    gradient: Callable[[Numbers], Numbers]


class Reference:
    """Runs of a scheme from t0 with the step h, its flows one by one; `kicks` are applied beside the first part.

    Joined rational rotations differ from single ones, so that those are joined that form a turn.
    """

    def __init__(self, system: Any, method: Any, h: float, t0: float = 0.0, representation: Any = None) -> None:
        self.system, self.h, self.t0 = system, mpmath.mpf(h), mpmath.mpf(t0)
        self.rho = _matrices(system, representation)
        flows = flows_of(method)
        program = flows.program(system, group=representation, number=mpmath.mpf)
        self.shift = program.shift
        count, rational = len(program.parts), flows.rotation == "rational"
        self.kernel = list(_flows(flows.sweeps(mpmath.mpf), count, rational))
        self.processor = list(_flows(flows.processor(mpmath.mpf), count, rational))
        # One row for each part; the time and the moment are those of the calls.
        one, zero = (np.array([mpmath.mpf(v)] * max(1, count), dtype=object) for v in (1, 0))
        parts = np.arange(max(1, count), dtype=np.uint32)
        rows = Rows(parts, one, zero, np.array([0, count, count, count], dtype=np.uint32))
        self.interpreter = Interpreter(dataclasses.replace(program, rows=rows))

    def at(
        self, x0: Any, outputs: Sequence[tuple[int, float]], A0: Any = None, kick: Kick | None = None
    ) -> tuple[Numbers, Numbers | None]:
        """Return the states and attitudes at outputs, each a number of steps and the length of a partial one after."""
        x, rows = exact(x0), None if self.rho is None else _unit(self.rho.shape[1])
        states, elements, done = [], [], 0
        for number, length in outputs:
            if number > done == 0:
                self._process(x, rows, self.t0, self.h, -1, kick)
            for k in range(done, number):
                self._apply_all(self.kernel, x, rows, self.t0 + k * self.h, self.h, kick)
            done = max(done, number)
            state, element = x.copy(), None if rows is None else rows.copy()
            end = self.t0 + number * self.h
            if number:
                self._process(state, element, end, self.h, 1, kick)
            if length:
                part = mpmath.mpf(length)
                self._process(state, element, end, part, -1, kick)
                self._apply_all(self.kernel, state, element, end, part, kick)
                self._process(state, element, end + part, part, 1, kick)
            states.append(state)
            if element is not None:
                # The first factor is that of the Casimirs that were subtracted.
                elements.append(exact(A0) @ self._of_shift(exact(x0), end + length - self.t0) @ element.T)
        return np.array(states), np.array(elements) if elements else None

    def _process(self, x: Numbers, rows: Numbers | None, t: Any, h: Any, way: int, kick: Kick | None) -> None:
        """Apply the processor of a scheme P K P^-1, backward before the first step."""
        self._apply_all([(part, way * c, moment) for part, c, moment in self.processor][::way], x, rows, t, h, kick)

    def _apply_all(self, flows: Any, x: Numbers, rows: Numbers | None, t: Any, h: Any, kick: Kick | None) -> None:
        for part, coefficient, moment in flows:
            self._apply(part, coefficient * h, t + moment * h, x, rows, kick)

    def _apply(self, part: int, tau: Any, t: Any, x: Numbers, rows: Numbers | None, kick: Kick | None) -> None:
        tau = self.system.sign * tau
        if part != ADDED:
            self.interpreter._apply_rows(range(part, part + 1), x, tau, t, rows, None)
        elif kick is not None:
            slope = kick.size * tau * kick.gradient(x)
            if rows is not None:
                rows -= np.tensordot(slope, self.rho, axes=1).T @ rows
            x += _structure(self.system, x) @ slope

    def _of_shift(self, x0: Numbers, t: Any) -> Numbers:
        total = _unit(self.rho.shape[1]) * 0
        for casimir, factor in self.shift:
            slope = np.array([casimir.derivative(i)(x0) for i in range(len(x0))], dtype=object)
            total = total - self.system.sign * t * mpmath.mpf(factor) * np.tensordot(slope, self.rho, axes=1)
        found = mpmath.expm(mpmath.matrix(total.tolist()))
        return np.array(found.tolist(), dtype=object).reshape(total.shape)


def _flows(sweeps: Sequence[Sweep], count: int, rational: bool) -> Iterator[tuple[int, Any, Any]]:
    """Yield part, fraction of the step and moment of each flow, with the added part beside the first one."""
    order = list(range(count))
    order.insert(min(1, max(0, count - 1)), ADDED)
    found: list[tuple[int, Any, Any]] = []
    for sweep in sweeps:
        for k, part in enumerate(order if sweep.forward else order[::-1]):
            coefficient = sweep.coefficient
            if rational and sweep.turn and k == 0:
                coefficient += found.pop()[1]
            found.append((part, coefficient, sweep.moment))
    yield from found


def reference_of(ready: Any, x0: Any, ends: tuple[float, float], points: Mapping[str, Any], element: Any = None) -> Any:
    """Return the function from a system, kick, state and element to the outputs of a prepared run from these values.

    Those that are not given are the values of the run. The lengths of its steps are floats.
    """
    times, moments = ready.times_of(ends, points.get("save_every", 1), points.get("t_eval"))
    outputs = [(int(k), 0.0) for k in times.saved]
    if moments is not None:
        outputs = list(zip(moments.number.tolist(), moments.length.tolist(), strict=True))

    def at(system: Any = ready.system, kick: Kick | None = None, x: Any = x0, A: Any = element) -> Any:
        reference = Reference(system, ready.method, times.h, times.t0, ready.representation)
        return reference.at(x, outputs, A, kick)

    return at


def floats(values: Numbers) -> np.ndarray:
    """Return numbers of many digits, rounded."""
    return np.array([float(v) for v in values.ravel()]).reshape(values.shape)


def difference(function: Callable[[Any], Any]) -> Any:
    """Return the derivative of a function of a number at zero, or of each array that it returns."""
    with mpmath.workdps(DIGITS):
        above, below = function(SMALL), function(-SMALL)
        return tuple(None if a is None else ((a - b) / (2 * SMALL)) for a, b in zip(above, below, strict=True))


STEP = 2.0**-10
WEIGHTS = (45.0, -9.0, 1.0)


def difference_of_systems(function: Callable[[float], Any]) -> Any:
    """Return the derivative at zero from six multiples of 2^-10, which systems of floats can have as their constants.

    The error is (3!)^2/7! 2^-60 times the seventh derivative.
    """
    with mpmath.workdps(DIGITS):
        pairs = [(weight, function(k * STEP), function(-k * STEP)) for k, weight in enumerate(WEIGHTS, 1)]
        arrays = len(pairs[0][1])
        return tuple(
            None if pairs[0][1][n] is None else sum(w * (a[n] - b[n]) for w, a, b in pairs) / (60 * STEP)
            for n in range(arrays)
        )


def _matrices(system: Any, representation: Any) -> Numbers | None:
    """Return rho_i, (n, d, d), of a representation, of "coadjoint", or None."""
    if representation is None:
        return None
    if isinstance(representation, str):
        return exact(np.array([system.algebra.coadjoint(unit) for unit in np.eye(system.dim)]))
    return exact(representation)


def _structure(system: Any, x: Numbers) -> Numbers:
    J = np.zeros((len(x), len(x)), dtype=object)
    for i, j, k, c in zip(*(column.tolist() for column in system.algebra.triples), strict=True):
        J[i, j] += c * x[k]
        J[j, i] -= c * x[k]
    return J


def exact(values: Any) -> Numbers:
    """Return floats, or numbers of many digits, as these."""
    values = np.asarray(values)
    return np.array([mpmath.mpf(v) for v in values.ravel().tolist()], dtype=object).reshape(values.shape)


def _unit(size: int) -> Numbers:
    return exact(np.eye(size))
