"""One step of a scheme as a function, with its exact tangent and its group element."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation
from coadjoint.methods.forced import check_steps, check_supports, effective_scheme
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.registry import read_method
from coadjoint.rounding import in_standard_mode
from coadjoint.runs.derivatives.differentiable_run import DifferentiableRun
from coadjoint.runs.derivatives.run_tables import INPUTS, StepTangents, compiled_tangents, step_tangents
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.start import any_momenta_of, is_attitude_kind, momenta_of
from coadjoint.runs.times import Times
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_one_system
from coadjoint.validation import Immutable, read_number


class Stepper(Immutable):
    """One step of a scheme as a map; see `stepper`.

    Parameters
    ----------
    system : System
        The system.
    method : Method
        The scheme.
    h : float
        The step; negative for a step backward in time.
    inputs : True, sequence of int, or mapping, optional
        Inputs of each call, as for `prepare`.
    """

    def __init__(
        self,
        system: System,
        method: Method | str | Mapping[str, Any],
        h: float,
        inputs: Any = None,
    ) -> None:
        method = read_method(method)
        self.h = read_number(h, "h")
        if self.h == 0.0:
            raise ValueError(f"h is {self.h!r}; it must not be zero")
        self._span = (0.0, self.h)
        check_one_system(system, forces=True)
        check_supports(system, method)
        self.system: Any = system
        self.method, self._inputs = method, inputs
        self._prepared: dict[bool | str, PreparedRun] = {}
        self._tangents: dict[bool, StepTangents] = {}

    def __repr__(self) -> str:
        return f"stepper({self.system!r}, {self.method!r}, {self.h!r})"

    def _prepared_with(self, attitude: bool | str) -> PreparedRun:
        prepared = self._prepared.get(attitude)
        if prepared is None:
            options: Any = {"attitude": attitude, "watch": False, "threads": 1, "inputs": self._inputs}
            prepared = self._prepared[attitude] = PreparedRun(self.system, self.method, abs(self.h), **options)
        return prepared

    @in_standard_mode
    def _advance(self, x: Any, t: float, attitude: bool | str, initial: Any, inputs: Mapping[str, Any]) -> Solution:
        prepared = self._prepared_with(attitude)
        values = prepared.values_of(inputs, x)
        start = prepared.start(x, initial, values, begins=not self.system.forces)
        times = Times(read_number(t, "t"), self.h, 1, 1)
        check_steps(self.system, prepared.scheme, times.t0, times.h, 1)
        return prepared.follow(times, start, values=values)

    def __call__(self, x: Any, t: float = 0.0, **inputs: Any) -> NDArray[np.float64]:
        """Return the state after one step.

        Parameters
        ----------
        x : array_like, shape (n,) or (members, n)
            Momentum.
        t : float
            Time at the start of the step, for a Hamiltonian that depends on it.
        **inputs : array_like
            Values of the prepared inputs, as in `PreparedRun.run`.

        Returns
        -------
        ndarray
            Momentum in the shape of x; bitwise equal to the first step of `integrate`.
        """
        if self._inputs is None and not inputs and type(t) is float and t == 0.0:
            return self._prepared_with(False).end(x, self._span)
        return np.asarray(self._advance(x, t, False, None, inputs).x[-1])

    def both(
        self, x: Any, g: Any = None, t: float = 0.0, *, attitude: bool | str | None = None, **inputs: Any
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return momentum and group element after one step, computed together.

        Parameters
        ----------
        x : array_like, shape (n,) or (members, n)
            Momentum before the step.
        g : array_like, shape (d, d) or (members, d, d), optional
            Group element before the step; the unit element if None.
        t : float
            Time at the start of the step.
        attitude : True or "coadjoint", optional
            Representation of the group elements: that of the system, or the coadjoint one. None is the former if the
            system has a representation.
        **inputs : array_like
            Values of the prepared inputs, as in `PreparedRun.run`.

        Returns
        -------
        x : ndarray
            Momentum in the shape of x; bitwise equal to a step without the group element.
        g : ndarray
            Group element; bitwise equal to that of `group`.

        Examples
        --------
        >>> import coadjoint as co
        >>> import numpy as np
        >>> step = co.stepper(co.systems.rigid_body(inertia=(1, 2, 3)), co.Splitting(order=2), 0.1)
        >>> x, g = np.array([1.0, 0.2, 0.5]), np.eye(3)
        >>> for _ in range(10):
        ...     x, g = step.both(x, g)
        >>> bool(np.allclose(g @ x, [1.0, 0.2, 0.5], atol=1e-14))
        True
        """
        kind, element = self._read_attitude(attitude)
        if element is not None:
            raise TypeError("attitude of `both` must be True or 'coadjoint'; give the initial group element as g")
        sol = self._advance(x, t, kind, g, inputs)
        assert sol.attitude is not None
        return np.asarray(sol.x[-1]), np.asarray(sol.attitude[-1])

    def _read_attitude(self, attitude: Any) -> tuple[bool | str, Any]:
        """Return True or "coadjoint", which None is without a representation, and an initial element or None."""
        if attitude is None:
            return (True if self.system.representation is not None else "coadjoint"), None
        if attitude is False:
            raise ValueError("attitude is False; a group element needs True, 'coadjoint', an initial one, or None")
        return (attitude, None) if is_attitude_kind(attitude) else (True, attitude)

    def group(self, x: Any, t: float = 0.0, attitude: Any = None, **inputs: Any) -> NDArray[np.float64]:
        """Return the group element g of the step: the attitude after it, from the unit element before it.

        Parameters
        ----------
        x : array_like, shape (n,)
            Momentum before the step.
        t : float
            Time at the start of the step.
        attitude : bool, "coadjoint", or array_like, optional
            As in `integrate`; None is the system's own representation if it has one, else the coadjoint matrix K
            (with K step(x) = x).
        **inputs : array_like
            Values of the prepared inputs, as in `PreparedRun.run`.

        Returns
        -------
        ndarray, shape (d, d)
            Group element.
        """
        sol = self._advance(x, t, *self._read_attitude(attitude), inputs)
        assert sol.attitude is not None
        return np.asarray(sol.attitude[-1])

    @ignore_overflow
    def tangent(self, x: Any, t: float = 0.0, **inputs: Any) -> NDArray[np.float64]:
        """Return the exact derivative of the step at x, by the chain rule through the scheme.

        Parameters
        ----------
        x : array_like, shape (n,)
            Momentum before the step.
        t : float
            Time at the start of the step.
        **inputs : array_like
            Values of the prepared inputs, as in `PreparedRun.run`.

        Returns
        -------
        ndarray, shape (n, n)
            d step_i / d x_j.

        Raises
        ------
        TypeError
            The Hamiltonian was given without second derivatives.
        """
        values, (point, time) = self._read_values(inputs), self._read_point(x, t)
        found = self._compiled_tangents(values, point, time, False)
        if found is not None:
            return found
        method, system = self._scheme(values)
        with long_operation("tangent"):
            return method.tangent(system, point, time, self.h)[1]

    @ignore_overflow
    def tangent_by_inputs(self, x: Any, t: float = 0.0, **inputs: Any) -> NDArray[np.float64]:
        """Return the derivative of the step at x by the prepared inputs.

        With `tangent` it gives the linear model of a step, ``dx_after = A dx + B du``, of controllers and filters.

        Parameters
        ----------
        x : array_like, shape (n,)
            Momentum before the step.
        t : float
            Time at the start of the step.
        **inputs : array_like
            Values of the prepared inputs, as in `PreparedRun.run`.

        Returns
        -------
        ndarray, shape (n, m)
            d step_i / d u_j, for all coefficients of the linear term and torques that are inputs, in the order in which
            they were prepared.

        Raises
        ------
        TypeError
            There are no inputs, or the scheme has no derivatives.

        Examples
        --------
        >>> import coadjoint as co
        >>> step = co.stepper(co.systems.rigid_body((1, 2, 2.5)), co.Splitting(order=2), 0.1, inputs={"rotors": (0, 2)})
        >>> step.tangent_by_inputs([0.1, 1.0, 0.2], rotors=[0.0, 0.1]).shape
        (3, 2)
        """
        if self._inputs is None or self._inputs is False:
            raise TypeError(
                "the stepper has no inputs; give inputs=True, or coordinates of the linear term, to stepper"
            )
        values, (point, time) = self._read_values(inputs), self._read_point(x, t)
        found = self._compiled_tangents(values, point, time, True)
        if found is None:
            raise IntegrationError(
                f"the derivative by the inputs at t = {time:g} is not finite; take a smaller step than {abs(self.h):g}",
                step=1,
                time=time,
                residual=float("nan"),
            )
        return found

    def _compiled_tangents(
        self, values: NDArray[np.float64] | None, x: NDArray[np.float64], t: float, by_inputs: bool
    ) -> NDArray[np.float64] | None:
        """Return a derivative by the compiled loop, None if there is no such loop or the result is not finite."""
        # A call removes the arrays while it uses them, so that concurrent calls never share any.
        tangents = self._tangents.pop(by_inputs, None)
        if tangents is None:
            tangents = self._build_tangents(by_inputs)
            if tangents is None:
                return None
        found = tangents(x, t, values)
        self._tangents[by_inputs] = tangents
        return None if found is None else found[:, self.system.dim :] if by_inputs else found

    def _build_tangents(self, by_inputs: bool) -> StepTangents | None:
        prepared = self._prepared_with(False)
        system, scheme, n = self.system, prepared.scheme, self.system.dim
        if by_inputs:
            assert prepared.inputs is not None
            tables = DifferentiableRun(prepared).tables(self.h, (INPUTS,))
            return step_tangents(tables, n, self.h, prepared.inputs.changing.tolist())
        return compiled_tangents(scheme, system, self.h, inputs=prepared.inputs)

    @ignore_overflow
    def tangent_by(self, x: Any, t: float = 0.0, **inputs: Any) -> str:
        """Return how `tangent` is computed at x: "formula", "complex step", or "differences".

        Parameters
        ----------
        x, t
            As for `tangent`.
        **inputs : array_like
            As for `tangent`.

        Returns
        -------
        str
            The first two are exact to round-off; differences have about nine digits.
        """
        method, system = self._scheme(self._read_values(inputs))
        return method.tangent_by(system, *self._read_point(x, t), self.h)

    def _read_values(self, inputs: Mapping[str, Any]) -> NDArray[np.float64] | None:
        values = self._prepared_with(False).values_of(inputs)
        if values is not None and values.ndim > 1:
            raise ValueError(f"{next(iter(inputs))} has values for members; a tangent is taken at one state, with one")
        return values

    def _scheme(self, values: NDArray[np.float64] | None) -> tuple[Method, Any]:
        """Return the scheme and the system of a step with these inputs, for evaluation in Python."""
        prepared = self._prepared_with(False)
        system = prepared.system_at(values)
        return effective_scheme(system, prepared.method), system

    def _read_point(self, x: Any, t: float) -> tuple[NDArray[np.float64], float]:
        momenta, single = (any_momenta_of if self.system.forces else momenta_of)(self.system, x)
        if not single:
            raise ValueError(
                f"x has the shape {np.shape(x)}; a tangent is taken at one state, of shape ({self.system.dim},)"
            )
        return momenta[0], read_number(t, "t")


@suggest_keywords
def stepper(system: System, method: Method | str | Mapping[str, Any], h: float, *, inputs: Any = None) -> Stepper:
    """Return one step of a scheme as a function, for maps, certificates and Lyapunov exponents.

    Parameters
    ----------
    system : System
        The system.
    method : Method
        The scheme.
    h : float
        The step; negative for a step backward in time.
    inputs : True, sequence of int, or mapping, optional
        Inputs that may change from call to call, as for `prepare`: coefficients of the linear term of H, and constant
        torques.

    Returns
    -------
    Stepper
        To be called as ``step(x)``; methods ``step.both(x, g)``, ``step.tangent(x)``, ``step.group(x)``.

    Raises
    ------
    ValueError, TypeError
        The scheme cannot be used for the system, or h is zero.

    Examples
    --------
    The condition of a Poisson map, P J(x) P^T = J(step(x)):

    >>> import coadjoint as co
    >>> import numpy as np
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> step, x = co.stepper(body, co.Splitting(order=2), 0.1), np.array([1.0, 0.2, 0.5])
    >>> P = step.tangent(x)
    >>> bool(np.allclose(P @ body.structure_matrix(x) @ P.T, body.structure_matrix(step(x)), atol=1e-15))
    True
    """
    return Stepper(system, method, h, inputs)
