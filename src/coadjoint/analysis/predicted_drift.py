"""Predicted phase drift of a scheme, from the period of its modified motion on the same orbit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coadjoint.analysis.backward_error.modified_field_base import ModifiedField
from coadjoint.analysis.backward_error.modified_hamiltonian import ModifiedHamiltonian
from coadjoint.analysis.periods import period
from coadjoint.analysis.rotations import acts_by_rotations, twist
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.system_checks import check_vector_states
from coadjoint.systems.user_functions import check_arguments
from coadjoint.validation import read_bool, read_finite, read_number, read_numbers

Floats = NDArray[np.float64]
Function = Callable[[Floats], Any]


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
    exact, computed = (_attitude_motion(system, slope, start) for slope in (system.hamiltonian.gradient, gradient))
    slope = exact.time / computed.time - 1.0
    psi = float(np.remainder(computed.psi - exact.psi + np.pi, 2.0 * np.pi) - np.pi)
    return PredictedDrift(slope, psi / computed.time + exact.speed * slope, exact.time, computed.time)


def _at_step(system: Any, modified: Any, step: Any) -> tuple[Function | None, Function | None]:
    """Return the gradient (or None) and the field (or None) at a step."""
    if not isinstance(modified, ModifiedHamiltonian | ModifiedField):
        raise TypeError(
            f"modified is {short(modified)}; give a ModifiedHamiltonian, which has a gradient, or a ModifiedField"
        )
    dim = modified.dim if isinstance(modified, ModifiedHamiltonian) else modified.system.dim
    if dim != system.dim:
        raise ValueError(f"modified is in {dim} coordinates; {system.name} has {system.dim}")
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


class _AttitudeMotion(NamedTuple):
    time: float
    psi: float  # rotation about the momentum in space in one period, modulo 2 pi
    speed: float  # mean angular velocity about it


def _attitude_motion(system: LiePoissonSystem, gradient: Function, start: Floats) -> _AttitudeMotion:
    """Integrate the momentum, the attitude from the unit matrix, and the angle about the momentum, over one period."""
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
    return _AttitudeMotion(motion.time, float(psi), float(motion.carried[9]) / motion.time)
