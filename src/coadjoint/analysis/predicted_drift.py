"""Predicted phase drift of a scheme, from the period of its modified motion on the same orbit; periods of motions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coadjoint.analysis.backward_error.field_at_points import ModifiedField
from coadjoint.analysis.backward_error.modified_hamiltonian import ModifiedHamiltonian
from coadjoint.analysis.phase_error import acts_by_rotations, twist
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import record_repr, short
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.system_checks import check_vector_states
from coadjoint.systems.user_functions import check_arguments
from coadjoint.validation import read_bool, read_finite, read_number, read_numbers

Floats = NDArray[np.float64]
Function = Callable[[Floats], Any]

RELATIVE_TOLERANCE, ABSOLUTE_TOLERANCE = 2.5e-14, 1e-16  # tolerances of the integration; SciPy's smallest relative one
RETURN_TOLERANCE = 1e-8  # largest distance from the start at a return, relative to the size of the orbit
CROSSING_TOLERANCE = 1e-5  # the same for an interpolated crossing
EQUILIBRIUM_SPEED = 2.0**-40  # speed, relative to the size of the state times the rate of change of the field
MIN_PERIOD = 1e-6  # shortest period, times the rate
SEGMENT_DURATION = 20.0  # duration of one integration, times the rate
MAX_SEGMENTS = 400  # of the search for a return
MAX_CROSSINGS = 64  # of the plane through the start; an orbit that winds more often is not called periodic
MAX_EVALUATIONS = 2**18  # of the field; periods of bodies near a separatrix take up to 2^14


class PredictedDrift(NamedTuple):
    """The phase drift predicted by a modified Hamiltonian or field.

    Parameters
    ----------
    slope : float
        Lead of the momentum per unit of time, P/P~ - 1.
    precession : float or None
        Lead of the attitude about the momentum in space, in radians per unit of time, as long as the lead of the
        momentum is a small fraction of a period.
    period, modified_period : float
        P and P~.
    """

    slope: float
    precession: float | None
    period: float
    modified_period: float


@suggest_keywords
@ignore_overflow
def predicted_drift(
    system: Any,
    x0: ArrayLike,
    *,
    modified: Any = None,
    step: float | None = None,
    gradient: Function | None = None,
    field: Function | None = None,
    attitude: bool = False,
) -> PredictedDrift:
    """Return the phase drift of a scheme on a periodic motion, from its modified Hamiltonian or field.

    Choose it to predict the phase error of a long run, and to compare schemes by it.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system. Its motion from x0 must be periodic, as for the free rigid body and other systems whose coadjoint
        orbits are surfaces with closed energy curves.
    x0 : array_like, shape (n,)
        The initial state.
    modified : ModifiedHamiltonian or ModifiedField
        The modified Hamiltonian H~ = H + h^2 H2 + ... of the scheme on this system, or its modified field.
    step : float
        The step h, given with `modified`; negative for backward.
    gradient : callable
        Alternatively, the gradient of H~ at a state, for one step.
    field : callable
        Alternatively, the modified field at a state, for one step. Give exactly one of the three.
    attitude : bool
        Whether to predict the drift of the attitude of a body, 3 x 3; needs a Hamiltonian or its gradient.

    Returns
    -------
    PredictedDrift
        If H~, or the field, is accurate to O(h^r), so is the slope; a measured one (`phase_drift`) differs by as much.

    Raises
    ------
    ValueError
        The state is an equilibrium, or the motion does not return.
    TypeError
        None or several of modified, gradient and field are given, or the system has no attitude of a body.

    Notes
    -----
    The numerical solution follows x' = f~(x) on the orbit of x0, along the energy curve H~(x) = H~(x0), with period P~;
    the exact motion has period P. After n periods the numerical solution is at the state of the exact motion n (P~ - P)
    earlier, so the lead grows by P - P~ in the time P~. To lowest order, with the integral I(E) of H2 over one period
    and the frequency w(E) = 2 pi / P, P/P~ - 1 = h^2 (H2(x0) d(log w)/dE + I'(E) / P). The first term comes from the
    energy: the numerical solution has the energy E at which H + h^2 H2 is H~(x0) on average, and not H(x0).

    In one period the attitude rotates about the momentum by psi (a dynamic and a geometric phase: Montgomery, How much
    does the rigid body rotate?, 1991). At equal times the computed attitude is ahead by n (psi~ - psi) after n periods,
    and by the lead times the speed about the momentum, which is ``2T/|x|`` for a free body:
    ``(psi~ - psi) / P~ + 2T/|x| (P/P~ - 1)`` per unit of time.

    Examples
    --------
    >>> import coadjoint as co
    >>> body, x0 = co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.5)
    >>> predicted = predicted_drift(body, x0, modified=co.modified_hamiltonian(body, co.Splitting()), step=0.1)
    >>> run = co.integrate(body, x0, (0, 1000), 0.1, co.Splitting(), save_every=7)
    >>> bool(abs(predicted.slope / co.phase_drift(run).slope - 1) < 0.01)
    True

    A field that is too fast by a factor of 1.001:

    >>> fast = predicted_drift(body, (1.0, 0.2, 0.5), field=lambda x: 1.001 * body.vector_field(x))
    >>> round(fast.slope, 11)
    0.001
    """
    check_vector_states(system, "a phase drift can be predicted for states that are vectors")
    if sum(argument is not None for argument in (modified, gradient, field)) != 1:
        raise TypeError("give exactly one of modified, gradient and field")
    if modified is not None:
        gradient, field = _at_step(system, modified, step)
    elif step is not None:
        raise TypeError(
            "step is given without modified; a gradient or a field already belongs to one step, so omit step"
        )
    function: Any = gradient if field is None else field
    check_arguments(function, "gradient" if field is None else "field", "x")
    if gradient is not None:
        gradient = _validated(gradient, system.dim, "gradient")
    if field is not None:
        field = _validated(field, system.dim, "field")
    start = read_finite(x0, "x0")
    if start.shape != (system.dim,):
        raise ValueError(f"x0 has the shape {start.shape}; it must be ({system.dim},)")
    if not read_bool(attitude, "attitude"):
        modified_field = field or _field_of(system, gradient)
        exact_period = period(system.vector_field, start).time
        modified_period = period(modified_field, start).time
        return PredictedDrift(exact_period / modified_period - 1.0, None, exact_period, modified_period)
    if gradient is None:
        raise TypeError(
            "attitude=True needs the gradient of the Hamiltonian, which a field does not provide; give gradient"
        )
    if not system.has_structure_constants or not acts_by_rotations(system):
        raise TypeError(f"{system.name} has no attitude of a body, 3 x 3")
    exact_period, exact_psi, speed = _attitude_motion(system, system.hamiltonian.gradient, start)
    modified_period, modified_psi, _ = _attitude_motion(system, gradient, start)
    slope = exact_period / modified_period - 1.0
    psi = float(np.remainder(modified_psi - exact_psi + np.pi, 2.0 * np.pi) - np.pi)
    return PredictedDrift(slope, psi / modified_period + speed * slope, exact_period, modified_period)


def _at_step(system: Any, modified: Any, step: Any) -> tuple[Function | None, Function | None]:
    if not isinstance(modified, ModifiedHamiltonian | ModifiedField):
        raise TypeError(
            f"modified is {short(modified)}; give a ModifiedHamiltonian, which has a gradient, or a ModifiedField"
        )
    if modified.dim != system.dim:
        raise ValueError(f"modified is in {modified.dim} coordinates; {system.name} has {system.dim}")
    if step is None:
        raise TypeError("step is missing; give the step of the scheme with modified")
    h = read_number(step, "step")
    if isinstance(modified, ModifiedHamiltonian):
        return lambda x: modified.gradient(x, h), None
    return None, lambda x: modified(x, h)


def _field_of(system: Any, gradient: Function | None) -> Function:
    assert gradient is not None
    slope: Function = gradient
    return lambda x: system.sign * (system.structure_matrix(x) @ slope(x))


def _validated(function: Function, n: int, name: str) -> Function:
    """Wrap a user function so that its values are validated, with its name in messages."""

    def validated(x: Floats) -> Floats:
        value = read_numbers(function(x), f"what {name} returns")
        if value.shape != (n,):
            raise ValueError(f"what {name} returns has the shape {value.shape}; it must be ({n},)")
        return value

    return validated


def _attitude_motion(system: LiePoissonSystem, gradient: Function, start: Floats) -> tuple[float, float, float]:
    """Integrate momentum and attitude over a period: its length, rotation about the momentum mod 2 pi, mean rate."""
    representation = system.representation
    assert representation is not None
    along = start / np.linalg.norm(start)

    def field_with_attitude(y: Floats) -> Floats:
        x, g = y[:3], y[3:12].reshape(3, 3)
        u = gradient(x)
        rate = -system.sign * np.einsum("i,iab->ab", u, representation)
        spatial = g @ rate @ g.T
        axial = np.array([spatial[2, 1] - spatial[1, 2], spatial[0, 2] - spatial[2, 0], spatial[1, 0] - spatial[0, 1]])
        field = system.sign * (system.structure_matrix(x) @ u)
        return np.concatenate([field, (g @ rate).ravel(), [0.5 * float(axial @ along)]])

    motion = period(field_with_attitude, start, np.append(np.eye(3).ravel(), 0.0))
    psi = twist(motion.carried[:9].reshape(3, 3), np.eye(3), start)
    return motion.time, float(psi), float(motion.carried[9]) / motion.time


class Period(NamedTuple):
    """A periodic motion.

    Parameters
    ----------
    time : float
        The time of the first return.
    misfit : float
        Distance from the start at that time, relative to the size of the orbit.
    carried : ndarray, shape (c,)
        The additional variables after one period.
    """

    time: float
    misfit: float
    carried: Floats

    def __repr__(self) -> str:
        return record_repr(self)


@suggest_keywords
@ignore_overflow
def period(field: Callable[[Floats], Any], x0: ArrayLike, carried: ArrayLike = ()) -> Period:
    """Return the period of the motion x' = f(x) through a state, to about 13 digits.

    Choose it for motions on coadjoint orbits that are surfaces with closed energy curves: of the free rigid body, of
    modified fields of schemes on it, and of other systems of three coordinates with a Casimir.

    Parameters
    ----------
    field : callable
        The function f of the state followed by the additional variables, (n + c,); returns the derivatives of both.
    x0 : array_like, shape (n,)
        The initial state.
    carried : array_like, shape (c,), optional
        Initial values of additional variables that are integrated with the state and need not return.

    Returns
    -------
    Period

    Raises
    ------
    ValueError
        The state is an equilibrium, or does not return, or the field is not smooth.

    Notes
    -----
    The motion is integrated by the Dormand-Prince method of order 8 (SciPy), until it returns to x0 in the plane
    through x0 normal to the field.

    Examples
    --------
    >>> circle = period(lambda x: np.array([x[1], -4.0 * x[0]]), (1.0, 0.0))
    >>> round(circle.time / np.pi, 11)
    1.0
    """
    start, extra = read_finite(x0, "x0"), read_finite(carried, "carried")
    if start.ndim != 1 or not start.size or extra.ndim != 1:
        raise ValueError(f"x0 has the shape {start.shape}; it must be one state, (n,)")
    motion = _Motion(field, start, extra)
    y, time, reach, crossings = np.concatenate([start, extra]), 0.0, 0.0, 0
    for _ in range(MAX_SEGMENTS):
        segment = motion.run(y, SEGMENT_DURATION / motion.rate, crossings=True)
        reach = max(reach, motion.distance_from_start(segment.y))
        for t, state in zip(segment.t_events[0], segment.y_events[0], strict=True):
            if time + t <= MIN_PERIOD / motion.rate:
                continue  # the start itself
            crossings += 1
            if motion.distance_from_start(state[:, None]) <= CROSSING_TOLERANCE * reach:
                end, late = motion.at_plane(y, float(t))
                misfit = motion.distance_from_start(end[:, None]) / reach
                if misfit <= RETURN_TOLERANCE:
                    return Period(time + float(t) - late, misfit, end[motion.n :])
        y, time = segment.y[:, -1], time + float(segment.t[-1])
        if crossings > MAX_CROSSINGS:
            break
    raise ValueError(f"the motion from x0 = {short(start.tolist())} does not return until t = {time:g}: not periodic")


class _Motion:
    """The motion from an initial state, and the plane through that state normal to the field."""

    def __init__(self, field: Callable[[Floats], Any], start: Floats, extra: Floats) -> None:
        self.n, self.start, self.evaluations = len(start), start, 0
        self.field: Callable[[Floats], Floats] = lambda y: np.asarray(field(y), dtype=np.float64)
        y = np.concatenate([start, extra])
        first = self.field(y.copy())[: self.n]
        speed, size = float(np.linalg.norm(first)), float(np.linalg.norm(start)) or 1.0
        nudge = size * 2.0**-20
        moved = [self.field(y + nudge * row)[: self.n] - first for row in np.eye(len(y))[: self.n]]
        rate = float(np.linalg.norm(moved)) / nudge
        if not np.isfinite(speed + rate):
            raise ValueError(f"the field at x0 = {short(start.tolist())} is {short(first.tolist())}; it must be finite")
        if speed <= EQUILIBRIUM_SPEED * rate * size:
            raise ValueError(f"x0 = {short(start.tolist())} is at rest: the field there is {short(first.tolist())}")
        self.rate, self.normal = max(rate, speed / size), first / speed
        self.tolerance = ABSOLUTE_TOLERANCE * np.where(np.arange(len(y)) < self.n, size, 1.0)

    def distance_from_start(self, states: Floats) -> float:
        return float(np.max(np.linalg.norm(states[: self.n] - self.start[:, None], axis=0)))

    def plane(self, _: float, y: Floats) -> float:
        return float(self.normal @ (y[: self.n] - self.start))

    def run(self, y: Floats, duration: float, crossings: bool = False) -> Any:
        """Integrate over a duration; with `crossings`, record the upward crossings of the plane."""
        from scipy.integrate import solve_ivp

        def upward(t: float, z: Floats) -> float:
            return self.plane(t, z)

        upward.direction = 1.0  # type: ignore[attr-defined]
        result = solve_ivp(
            self._counted,
            (0.0, duration),
            y,
            "DOP853",
            rtol=RELATIVE_TOLERANCE,
            atol=self.tolerance,
            events=upward if crossings else None,
        )
        if not result.success or not np.all(np.isfinite(result.y[:, -1])):
            raise ValueError(f"the motion from x0 = {short(self.start.tolist())} could not be followed: it diverges")
        return result

    def _counted(self, _: float, z: Floats) -> Floats:
        """Return the field, a bounded number of times; on rounding errors, steps become ever shorter."""
        self.evaluations += 1
        if self.evaluations > MAX_EVALUATIONS:
            raise ValueError(
                f"the motion from x0 = {short(self.start.tolist())} takes more than {MAX_EVALUATIONS} evaluations of "
                "the field: it does not return, or the field is rounding errors or not smooth"
            )
        return self.field(z)

    def at_plane(self, y: Floats, t: float) -> tuple[Floats, float]:
        """Return the state on the plane near a time, and the time since the crossing at the given time."""
        end = self.run(y, t).y[:, -1]
        slope = self.field(end.copy())
        late = self.plane(0.0, end) / float(self.normal @ slope[: self.n])
        return end - late * slope, late
