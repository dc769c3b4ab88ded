"""Certification of schemes: measured properties compared with declared ones."""

from __future__ import annotations

import platform
from typing import Any

import numpy as np

import coadjoint
from coadjoint.analysis.certificates.attitude import attitude_rows
from coadjoint.analysis.certificates.certificate import Certificate, Row
from coadjoint.analysis.certificates.convergence import convergence_rows, study
from coadjoint.analysis.certificates.forces import force_rows
from coadjoint.analysis.certificates.invariants import invariant_rows, long_run, run_row, steps_of
from coadjoint.analysis.certificates.step_map import poisson_row, reversibility_row, symmetry_row
from coadjoint.analysis.certificates.subject import Subject
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation, warn_if_long
from coadjoint.methods.forced import check_steps, check_supports
from coadjoint.methods.protocol.method import Method, declared_properties
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.protocol.step_method import FunctionStep, read_step
from coadjoint.methods.registry import description_of
from coadjoint.runs.start import momenta_of
from coadjoint.short_repr import short
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_one_system
from coadjoint.validation import read_bool, read_integer, read_number

MAX_ORDER, MAX_STEPS = 256, 10**7
ALLOWED_SIZES = (1e-75, 1e75)
"""Allowed sizes of the largest entry of a state."""


@suggest_keywords
def certify(
    system: System,
    method: Any,
    x0: Any,
    step: float,
    *,
    steps: int | None = None,
    order: int | None = None,
    properties: Properties | None = None,
    symmetric: bool | None = None,
) -> Certificate:
    """Measure the properties of a scheme on a system, and compare them with the declared ones.

    Choose it for the first run of a new system, a new scheme or an unusual step, and for every scheme of your own.
    It measures the order and the convergence to a closed form or an independent integration (since a motion at the
    wrong speed preserves every invariant); the symmetry; the Poisson bracket, by the tangent map of the step; energy
    and Casimirs, in one step and over a long run; and the invariants of the group element, if the scheme computes one.
    Groups of coordinates whose sizes differ much, such as the angular momentum and the position of a satellite in SI
    units, are each compared with their own size; values and bounds of states are in the unit of the largest group.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system. With forces, the rows of the scheme are those on the Hamiltonian part, and each force has three: its
        flow is that of its field, the compiled flow is that in NumPy, and the work recorded is that of the flow. A
        `HamiltonianNoise` has two more: strong and weak order, with standard errors and the number of paths.
    method : Method or callable
        A scheme, or a function ``step(x, h)`` (``step(x, t, h)`` if the Hamiltonian depends on time) that returns the
        state after a step of length h, which may be negative. `order`, `properties` and `symmetric` are the
        declarations of a function. Undeclared properties are measured and cannot fail, except the convergence to the
        motion of the system for small steps, which is always required.
    x0 : array_like, shape (n,) or (k, n)
        A state, or a sample of states. Fewer than four are extended along the motion; for steps longer than a quarter
        of a millisecond, two states suffice. Of more than eight, the first eight are used.
    step : float
        The step; negative for backward integration. Order, symmetry and defects are also measured at other steps.
    steps : int, optional
        Number of steps of the long run. None is 2000, reduced to a few seconds of computing time; the certificate
        reports a reduction.
    order : int, optional
        Declared order of accuracy of a function.
    properties : Properties, optional
        Declared invariants of a function, ``co.methods.Properties(poisson=, energy=, casimirs=, attitude="none")``.
    symmetric : bool, optional
        Declared symmetry of a function: a step by -h inverts a step by h.

    Returns
    -------
    Certificate
        With ``passed``, rows by name, ``plot()`` and ``to_json()``; ``print`` shows a table.

    Raises
    ------
    ValueError, TypeError
        For wrong input, a scheme that does not apply to the system, or a function on a system with forces. A failed run
        is a row, not an error.

    Examples
    --------
    >>> import coadjoint as co
    >>> import numpy as np
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> co.certify(body, co.Splitting(order=4), (0.3, 1.0, 0.2), 0.1, steps=200).passed
    True

    The explicit Euler method, falsely declared to conserve energy:

    >>> claims = co.methods.Properties(poisson=False, energy=True, casimirs="none", attitude="none")
    >>> def euler(x, h):
    ...     return x + h * body.vector_field(x)
    >>> certificate = co.certify(body, euler, (0.3, 1.0, 0.2), 0.1, steps=200, order=1, properties=claims)
    >>> [row.key for row in certificate.failures]
    ['energy']
    """
    check_one_system(system, forces=True)
    h = read_number(step, "step")
    if h == 0.0:
        raise ValueError(f"step is {h!r}; it must not be zero")
    count = None if steps is None else read_integer(steps, "steps", 1, MAX_STEPS, floats=True)
    scheme, claims = scheme_and_claims(system.unforced, method, order, properties, symmetric)
    if system.forces:
        if not claims.get("compiled", True):
            raise TypeError(f"{system.name} has forces, and a function is a step without them; certify its .unforced")
        check_supports(system, scheme)
        check_steps(system, method, 0.0, h)
    states, _ = momenta_of(system, x0)
    forced, system = system, system.unforced.in_numbers
    size = float(np.max(np.abs(states), initial=0.0))
    if size != 0.0 and not ALLOWED_SIZES[0] <= size <= ALLOWED_SIZES[1]:
        raise ValueError(
            f"x0 has entries up to {size!r}, whose products leave the range of float64; choose units in which they are "
            f"from {ALLOWED_SIZES[0]} to {ALLOWED_SIZES[1]}"
        )
    with np.errstate(all="ignore"), long_operation("certify"):
        subject = Subject(system, scheme, h, states, count, **claims)
        if count is not None:
            seconds = subject.seconds * len(subject.states) * count
            warn_if_long(
                f"the long run of {count} steps from {len(subject.states)} states", seconds, "fewer steps= take less"
            )
        rows = (*_rows(subject), *force_rows(subject, forced))
        return Certificate(rows, _describe(subject) | {"forces": list(map(str, forced.forces))})


def _rows(subject: Subject) -> tuple[Row, ...]:
    convergence = study(subject)
    coarse_step = subject.h if convergence is None else convergence.coarse_step(subject.h)
    run, failure = long_run(subject)
    return (
        *convergence_rows(subject, convergence),
        symmetry_row(subject, coarse_step),
        reversibility_row(subject, coarse_step),
        poisson_row(subject, coarse_step),
        *invariant_rows(subject, run, failure, coarse_step),
        *attitude_rows(subject, convergence, 0 if run is None else run.stats.steps),
        run_row(subject, failure),
    )


def _describe(subject: Subject) -> dict[str, Any]:
    system, algebra = subject.system, subject.system.algebra
    return {
        "system": {
            "name": system.name,
            "algebra": None if algebra is None else getattr(algebra, "name", None) or repr(algebra),
            "dim": system.dim,
            "sign": system.sign,
            "hamiltonian": repr(system.hamiltonian),
            "parameters": system.parameters,
        },
        "scheme": {"shown": str(subject.method), "description": _description(subject.method)},
        "step": subject.h,
        "steps": steps_of(subject),
        "given": subject.given,
        "states": subject.states,
        "versions": {
            "coadjoint": coadjoint.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
            "machine": platform.machine(),
        },
    }


def _description(method: Method) -> Any:
    try:
        return description_of(method)
    except TypeError:
        return None


def scheme_and_claims(
    system: System, method: Any, order: int | None, properties: Properties | None, symmetric: bool | None
) -> tuple[Method, dict[str, Any]]:
    """Return the scheme to be certified, with its own claims or, for a function, the claims in the arguments."""
    arguments: dict[str, Any] = {"order": order, "properties": properties, "symmetric": symmetric}
    scheme = read_step(method)
    if not isinstance(scheme, FunctionStep):
        for name, value in arguments.items():
            if value is not None:
                raise TypeError(f"{name} is given, but {type(scheme).__name__} declares its own; omit {name}")
        # The error of a scheme with its own step size does not depend on the step of the run.
        own_order = None if scheme.own_steps else scheme.order
        declared = declared_properties(scheme, system)
        return scheme, {"order": own_order, "properties": declared, "symmetric": scheme.symmetric}
    if order is not None:
        arguments["order"] = read_integer(order, "order", 1, MAX_ORDER)
    if symmetric is not None:
        arguments["symmetric"] = read_bool(symmetric, "symmetric")
    if not isinstance(properties, Properties | None):
        raise TypeError(f"properties is {short(properties)}; give co.methods.Properties(...), or None")
    if properties is not None and properties.attitude != "none":
        raise ValueError(
            f'properties has attitude="{properties.attitude}", but a function step(x, h) moves the momentum only; '
            'give attitude="none"'
        )
    return scheme, {**arguments, "compiled": False}
