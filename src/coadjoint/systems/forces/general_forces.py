"""Forces on any system: linear damping towards a given state, and a force given by the function of its flow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import in_one_line
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.coordinates import momenta_of, rest_of
from coadjoint.systems.forces.base import (
    Force,
    ForceReader,
    apply_metric,
    check_state,
    read_matrix,
    read_state,
    sample_states,
    state_vector,
)
from coadjoint.systems.forces.torque import is_on_bodies, shapes_on, torque_vector
from coadjoint.systems.time_spans import sample_time_of
from coadjoint.systems.user_functions import check_arguments
from coadjoint.validation import as_tuples, read_bool, read_finite, read_title

DIFFERENCE_TIME = 2.0**-12  # step of differences of order four: their error, its fourth power, is that of rounding
ROUNDED = 2.0**-40  # change of a coordinate, relative to the state, that is taken for rounding


@suggest_keywords
@dataclass(frozen=True)
class LinearDamping(Force):
    """Linear damping towards a given state, ``x' = -rate (x - toward)``: friction, viscosity of modes, relaxation.

    It acts on momenta: axes and directions, positions, constants, and carried fields are left as they are. In a moving
    frame (a rotating sphere, an orbit) it damps the motion relative to the frame. Its flow is exact, ``x - toward``
    times ``exp(-rate tau)``, also if rate times step is large. It preserves neither energy nor Casimirs. To preserve
    the length of a spin use `DoubleBracketDamping`.

    Parameters
    ----------
    rate : float, (n,) or (n, n) array_like
        Rates (1/time). A number is the rate of each momentum; in arrays those of other coordinates are zero. A matrix
        need not be symmetric: its columns for positions make a spring. Negative rates amplify. For bodies and tops,
        such as ``co.systems.body``, also those of the angular momentum in the frame of the body, (3,), or of k bodies
        (k, 3).
    toward : float, (n,) or (N, N) array_like
        The state where the damping vanishes; a number applies to all coordinates, and zero is rest in the frame of the
        system. For a `MatrixSystem` it is a matrix or zero, and the rate is a number.

    Raises
    ------
    ValueError, TypeError
        A value is not finite or of the wrong shape.

    Examples
    --------
    A symmetric body whose spin about its axis decays:

    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 1, 2)).with_forces(co.forces.LinearDamping(0.1))
    >>> sol = co.integrate(body, (0.6, 0.0, 0.8), t_span=(0, 10), step=0.1, save_every=100)
    >>> bool(abs(sol.x[-1, 2] - 0.8 * 2.718281828459045 ** -1) < 1e-15)
    True
    """

    rate: Any
    toward: Any = 0.0

    example: ClassVar = {"rate": 0.2}
    uses_energy: ClassVar[bool] = False

    def __post_init__(self) -> None:
        self._read(rate=_read_rates, toward=partial(read_state, number=True))

    def check(self, system: Any) -> None:
        if system.has_matrices and np.ndim(self.rate):
            raise ValueError(
                f"rate of LinearDamping has the shape {np.shape(self.rate)}; {system.name} needs a number, or "
                "Friction for scale-dependent rates"
            )
        shape, square = np.shape(self.rate), (system.dim, system.dim)
        if shape not in ((), square[:1], square) and not is_on_bodies(shape, system):
            raise ValueError(
                f"rate of LinearDamping has the shape {shape}; {system.name} needs a number, {shapes_on(system)}, or "
                f"{square}"
            )
        if self._rates(system).ndim == 2 and self._in_turning_frame(system):
            raise ValueError(
                f"rate of LinearDamping is a matrix, and the frame of {system.name} turns; give a number or one for "
                "each coordinate, or a Pointing damper with a matrix"
            )
        check_state(self.toward, "toward of LinearDamping", system)
        if system.has_matrices and system.buoyancy is not None:
            raise ValueError(
                f"LinearDamping would act on the vorticity of {system.name} with a part of the buoyancy; take Friction"
            )

    def _in_turning_frame(self, system: Any) -> bool:
        return system.frame_rate is not None and np.ndim(self.toward) == 0 and self.toward == 0.0

    def _needs_energy(self, system: Any) -> bool:
        at_rest = np.ndim(self.toward) == 0 and getattr(system, "absolute", None) is not None  # of a planet
        return self._in_turning_frame(system) or at_rest

    def _rates(self, system: Any) -> NDArray[np.float64]:
        """Return the rates; a number is that of each momentum, and those on bodies are of their angular momenta."""
        rate, momenta = np.asarray(self.rate, dtype=np.float64), momenta_of(system)
        if is_on_bodies(rate.shape, system):
            return torque_vector(rate, system)
        return rate if rate.ndim or momenta is None else np.where(momenta, rate, 0.0)

    def _aim(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        """Return the state toward which momenta move: by default that at rest in the frame."""
        if self._in_turning_frame(system):
            return np.asarray(x @ system.momentum_at_rest(system.frame_rate(t)))
        rest = rest_of(system) if np.ndim(self.toward) == 0 else None
        return state_vector(self.toward, system) if rest is None else rest

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        return np.asarray(apply_metric(self._rates(system), self._aim(system, x, t) - x))

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        from scipy.linalg import expm

        rate, deviation = self._rates(system), np.asarray(x) - self._aim(system, x, t + 0.5 * tau)
        if rate.ndim == 2:
            n = len(rate)
            # The last column of this exponential is the displacement of the state by the flow.
            generator = np.zeros((n + 1, n + 1))
            generator[:n, :n], generator[:n, n] = -tau * rate, -tau * (rate @ deviation)
            return np.asarray(x + expm(generator)[:n, n])
        return np.asarray(x + np.expm1(-tau * rate) * deviation)

    def tangent(self, system: Any, x: NDArray[Any], t: float, tau: float) -> NDArray[np.float64]:
        from scipy.linalg import expm

        rate = self._rates(system)
        if self._in_turning_frame(system):
            kept = np.eye(system.dim) - system.momentum_at_rest(system.frame_rate(t + 0.5 * tau)).T
            return np.asarray(np.eye(system.dim) + np.expm1(-tau * rate)[:, None] * kept)
        return np.asarray(expm(-tau * rate) if rate.ndim == 2 else np.exp(-tau * rate))

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        if self._in_turning_frame(system):
            return reader.flow(_flow_in_frame(self, system))
        return reader.damping(self._rates(system), self._aim(system, np.zeros(system.dim), 0.0))


def _read_rates(argument: Any, what: str) -> Any:
    """Validate a number, a vector, a square matrix, or a row of three numbers for each body."""
    array = read_finite(argument, what)
    return as_tuples(array) if array.ndim == 2 and array.shape[1] == 3 and array.size else read_matrix(argument, what)


@lru_cache(maxsize=64)
def _flow_in_frame(damping: LinearDamping, system: Any) -> Callable[..., Any]:
    """Return the flow toward rest in a turning frame, whose rate is that at the middle of the duration."""
    rates, per_rate, turning = damping._rates(system), system.momentum_at_rest(1.0), system.frame_rate
    momenta, others = np.flatnonzero(rates), np.flatnonzero(per_rate.any(axis=1))

    def flow(x: Any, t: Any, tau: Any) -> Any:
        y, rate = x.copy(), turning(t + 0.5 * tau)
        for i in momenta:
            rest = 0.0 * x[0]
            for j in others:
                rest = rest + rate * per_rate[j, i] * x[j]
            y[i] = x[i] + np.expm1(-tau * rates[i]) * (x[i] - rest)
        return y

    return flow


@suggest_keywords
@dataclass(frozen=True)
class OwnForce(Force):
    """A custom force, given by the function of its flow.

    Choose it if the flow is known in closed form, or if no other force fits. For a torque known only as a function of
    the state use `Torque`.

    Parameters
    ----------
    function : callable
        Pure function of ``(x, t, tau)`` that returns the flow of the force: the state reached from x, shape (n,) or
        (N, N), at time t after the duration tau, which is negative in runs backward and in some substeps of schemes of
        order above two. Such schemes keep their order if it is exact, or undone by the flow over -tau. For tau = 0 it
        returns x. Compiled by Numba.
    name : str
        Name in balances and messages.
    keeps_casimirs : bool
        Whether it preserves every Casimir; balances then omit the Casimirs for it.
    backward : bool
        Whether it can run backward in time. If not, schemes of order above two are refused.

    Raises
    ------
    TypeError, ValueError
        Not a function of these arguments, or not a valid name.

    Examples
    --------
    Friction quadratic in the momentum along each axis, ``x_i' = -|x_i| x_i``:

    >>> import coadjoint as co
    >>> import numpy as np
    >>> drag = co.forces.OwnForce(lambda x, t, tau: x / (1.0 + np.abs(x) * tau), name="drag", backward=False)
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3)).with_forces(drag)
    >>> co.integrate(body, (0.0, 0.0, 1.0), t_span=(0, 3), step=0.125).x[-1]
    array([0.  , 0.  , 0.25])
    """

    function: Callable[..., Any]
    name: str = "own force"
    keeps_casimirs: bool = False
    backward: bool = True

    uses_energy: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_arguments(self.function, "the flow of an OwnForce", "x, t, tau")
        self._read(name=read_title, keeps_casimirs=read_bool, backward=read_bool)

    @property
    def label(self) -> str:
        """The given name."""
        return self.name

    @property
    def casimirs(self) -> bool:  # type: ignore[override]
        """Whether every Casimir is preserved, as given by `keeps_casimirs`."""
        return self.keeps_casimirs

    @property
    def reversible(self) -> bool:  # type: ignore[override]
        """Whether it can run backward in time, as given by `backward`."""
        return self.backward

    def check(self, system: Any) -> None:
        shape, failure, t = system.shape, "", sample_time_of(self.function)
        kinds = "fiuc" if system.has_matrices and system.complex else "fiu"
        for x in sample_states(system):
            try:
                with np.errstate(all="ignore"):
                    moved, unmoved = (np.asarray(self.function(x, t, tau)) for tau in (DIFFERENCE_TIME, 0.0))
            except Exception as error:  # outside its domain a user function may raise anything
                failure = in_one_line(str(error), 200)
                continue
            for result in (moved, unmoved):
                if result.shape != shape or result.dtype.kind not in kinds:
                    raise ValueError(
                        f"the flow of {self.name} returns {result.dtype} of shape {result.shape}; {system.name} needs "
                        f"{'' if 'c' in kinds else 'real '}numbers of shape {shape}"
                    )
                if system.has_matrices and np.all(np.isfinite(result)):
                    system.read(result, f"the value of the flow of {self.name}")
            if np.all(np.isfinite(unmoved)) and np.max(np.abs(unmoved - x)) > 1e-9 * np.max(np.abs(x)):
                raise ValueError(f"the flow of {self.name} changes a state for tau = 0; it must return x")
            return
        raise ValueError(f"the flow of {self.name} fails at every sample point ({failure}); correct the function")

    def _changed(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[np.bool_]:
        """Return which coordinates the flow changes, by more than rounding."""
        difference = np.abs(self.flow(system, x, t, DIFFERENCE_TIME) - x)
        return np.asarray(difference > ROUNDED * np.max(np.abs(x)))

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        """Return the derivative of the flow at tau = 0, by differences of order four: central, or forward only."""
        if not self.backward:
            moved = [self.flow(system, x, t, k * DIFFERENCE_TIME) for k in range(1, 5)]
            ahead = sum(weight * y for weight, y in zip((48.0, -36.0, 16.0, -3.0), moved, strict=True))
            return np.asarray((ahead - 25.0 * x) / (12.0 * DIFFERENCE_TIME))
        wide, narrow = (
            (self.flow(system, x, t, tau) - self.flow(system, x, t, -tau)) / (2.0 * tau)
            for tau in (2 * DIFFERENCE_TIME, DIFFERENCE_TIME)
        )
        return np.asarray((4.0 * narrow - wide) / 3.0)

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        if system.has_matrices:
            return np.asarray(system.to_vector(self.function(system.from_vector(x), t, tau)))
        return np.asarray(self.function(x.copy(), t, tau))

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        return reader.flow(self.function)
