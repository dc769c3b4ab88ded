"""Steps to be certified: schemes, or functions ``step(x, h)`` with claims."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from coadjoint.methods.protocol.method import Method, declared_properties
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.protocol.step_method import StepMethod
from coadjoint.short_repr import short
from coadjoint.systems.system import System
from coadjoint.validation import read_bool, read_integer

NO_PROPERTIES = Properties(poisson=False, energy=False, casimirs="none", attitude="none")
MAX_ORDER = 256


@dataclass(frozen=True)
class Claims:
    """Declared order, symmetry and invariants of a step; None if not declared."""

    order: int | None
    symmetric: bool | None
    properties: Properties | None


@dataclass(frozen=True)
class FunctionStep(StepMethod):
    """A function ``step(x, h)``, or ``step(x, t, h)`` if `timed`, as a scheme."""

    function: Callable[..., Any]
    timed: bool = False

    order = 1
    explicit = False
    symmetric = False
    offered: ClassVar[bool] = False
    compiles: ClassVar[bool] = False

    def __str__(self) -> str:
        """Name the function."""
        return f"the function {getattr(self.function, '__name__', type(self.function).__name__)}"

    def properties(self, system: System) -> Properties:
        return NO_PROPERTIES

    def step(self, system: System, x: Any, t: Any, h: Any) -> Any:
        return np.asarray(self.function(x, t, h) if self.timed else self.function(x, h))


def scheme_and_claims(
    system: System, method: Any, order: int | None, properties: Properties | None, symmetric: bool | None
) -> tuple[Method, Claims]:
    """Return the scheme to be certified, with its own claims or, for a function, the claims in the arguments."""
    arguments = {"order": order, "properties": properties, "symmetric": symmetric}
    if isinstance(method, Method):
        for name, value in arguments.items():
            if value is not None:
                raise TypeError(f"{name} is given, but {type(method).__name__} declares its own; omit {name}")
        # The error of a scheme with its own step size does not depend on the step of the run.
        return method, Claims(
            None if method.own_steps else method.order, method.symmetric, declared_properties(method, system)
        )
    if isinstance(method, type) or not callable(method):
        raise TypeError(
            f"method is {short(method)}; it must be a scheme such as Splitting(order=2), or a function step(x, h)"
        )
    if order is not None:
        order = read_integer(order, "order", 1, MAX_ORDER)
    if symmetric is not None:
        symmetric = read_bool(symmetric, "symmetric")
    if not isinstance(properties, Properties | None):
        raise TypeError(f"properties is {short(properties)}; give co.methods.Properties(...), or None")
    if properties is not None and properties.attitude != "none":
        raise ValueError(
            f'properties has attitude="{properties.attitude}", but a function step(x, h) moves the momentum only; '
            'give attitude="none"'
        )
    return FunctionStep(method, _takes_time(method)), Claims(order, symmetric, properties)


def _takes_time(function: Callable[..., Any]) -> bool:
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return False
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    needed = sum(p.kind in kinds and p.default is inspect.Parameter.empty for p in parameters)
    if needed not in (2, 3):
        raise TypeError(f"{short(function)} takes {needed} arguments; a step is a function of (x, h), or of (x, t, h)")
    return needed == 3
