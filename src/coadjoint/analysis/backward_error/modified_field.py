"""Modified vector field of a scheme: a power series in the step, or values at points from steps in high precision."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.analysis.backward_error.exact_field import ExactField
from coadjoint.analysis.backward_error.modified_field_base import Floats, ModifiedField
from coadjoint.analysis.backward_error.step_series import (
    ExactSystem,
    check_at_a_point,
    field_at,
    field_of_series,
    scale_of_motion,
    size_of,
)
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.methods.numerics.formal_series import vector
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.registry import read_method
from coadjoint.optional_packages import require_packages
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_vector_states
from coadjoint.systems.user_functions import check_arguments, sample_points
from coadjoint.validation import read_choice, read_integer

MAX_ORDER = 64
MARGIN = 1000  # below the order of a scheme, terms within this many roundings of its coefficients are set to zero
WAYS = ("auto", "exact", "numerical")

DISPLACEMENT_BITS = 53  # steps move by about 2^-53 of the state
MAX_DISAGREEMENT = 1e-6  # largest accepted relative disagreement of two sets of steps
SAMPLE_POINTS = (0, 1)  # the sample points of a system at which invariants are tested
CHANGE_THRESHOLD = 1e-9  # relative threshold for a change of an invariant at a point


@suggest_keywords
@long_operation("modified_field")
def modified_field(system: System, method: Any, order: int, *, way: str = "auto") -> ModifiedField:
    """Return the field X = f_0 + h f_1 + h^2 f_2 + ... whose flow over a time h is the step of a scheme (Lemma 6.1).

    A scheme of order p solves x' = X(x, h) far more accurately than x' = f(x): f_0 = f, f_1 = ... = f_(p-1) = 0, and
    f_p is its leading error. A scheme preserves an invariant if every f_k does; otherwise the first f_k that does not
    gives the power of h at which the invariant changes. Choose it to analyse a scheme on your own system. For
    splittings `coadjoint.modified_hamiltonian` gives more detail.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system; its Hamiltonian does not depend on time.
    method : Method, str, mapping or callable
        The scheme, its name as in `integrate`, or a step of your own as a function ``step(x, h)``.
    order : int
        The terms f_k h^k with k < order are computed.
    way : {"auto", "exact", "numerical"}
        ``"exact"``: polynomials with rational coefficients, from the step evaluated in power series. It supports
        Runge-Kutta, modified and splitting schemes, Taylor series, compositions of these, and steps of your own made of
        sums, products and quotients, on systems with a polynomial field. ``"numerical"``: the terms are computed
        pointwise from steps in multiprecision, for any step that accepts mpmath numbers. ``"auto"``: exact if possible;
        otherwise ``reason`` of the field gives the obstacle.

    Returns
    -------
    ModifiedField

    Raises
    ------
    TypeError, ValueError
        The Hamiltonian depends on time, the scheme does not apply to the system, or neither way is possible.

    References
    ----------
    S. Reich 1993, section 6, Lemma 6.1.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1, 1/2, 1/4]), sign=-1)
    >>> field = co.modified_field(body, co.GaussLegendre(1), order=4)
    >>> field.terms[2][0]
    (1/128)*x1^2*x2*x3 - (1/384)*x2^3*x3 + (1/256)*x2*x3^3
    >>> field.keeps("energy"), field.keeps("|x|^2"), field.first_error
    (None, None, 2)
    """
    require_packages("a modified field", "mpmath")
    check_vector_states(system, "a modified field is available for states that are vectors")
    order = read_integer(order, "order of a modified field", 1, MAX_ORDER)
    read_choice(way, "way to a modified field", WAYS)
    if system.hamiltonian.timed:
        raise ValueError(
            f"the Hamiltonian of {system.name} depends on time; a modified field needs an autonomous system"
        )
    if isinstance(method, str | Mapping):
        method = read_method(method)
    if isinstance(method, Method):
        method.properties(system)
    elif not callable(method):
        raise TypeError(f"method is {short(method)}; give a scheme such as GaussLegendre(2), or a function step(x, h)")
    else:
        check_arguments(method, "method", "x, h")
    step = _step_of(system, method)
    reason = 'way="numerical" was given'
    if way != "numerical":
        try:
            return _exact(system, method, step, order)
        except MemoryError:
            raise
        except Exception as error:  # user functions may raise anything on formal numbers
            if way == "exact":
                raise TypeError(f"no exact modified field: {error}") from error
            reason = str(error)
    return FieldAtPoints(system, method, order, reason, step)


def _step_of(system: System, method: Any) -> Callable[[npt.NDArray[Any], Any], Any]:
    if isinstance(method, Method):
        return lambda x, h: method.step(system, x, 0 * h, h)
    return lambda x, h: method(x, h)


def _exact(system: System, method: Any, step: Callable[..., Any], order: int) -> ExactField:
    exact = ExactSystem(system)
    exact.check_available_memory(order)
    formal, known_to, declared = step, UNIT_ROUNDOFF, order
    fractions: tuple[float, ...] = (1.0,)
    if isinstance(method, Method):
        known_to, fractions, declared = method.known_to, method.fractions, method.order

        def formal(x: npt.NDArray[Any], h: Any) -> npt.NDArray[Any]:
            return method.formal_step(system, x, h)

    series = exact.series_of(formal, order)
    check_at_a_point(step, exact, series, known_to)
    fields = field_of_series(exact.ring, series)
    difference = max(size_of(a - b) for a, b in zip(fields[0], exact.field, strict=True))
    if 0.0 < difference <= MARGIN * max(known_to, UNIT_ROUNDOFF) * max(map(size_of, exact.field)):
        # The decomposition of a full M into squares is rounded as well.
        known_to, fields[0] = max(known_to, UNIT_ROUNDOFF), exact.field
    if known_to:
        # Substeps back and forth move further than their sum.
        reach = 2.0 * float(np.sum(np.abs(fractions)))
        for k, scale in enumerate(scale_of_motion(exact, min(order, declared))[1:], 1):
            if max(map(size_of, fields[k])) <= MARGIN * known_to * reach**k * scale:
                fields[k] = [exact.ring.zero] * system.dim
    return ExactField(system, method, order, exact, fields, known_to)


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
