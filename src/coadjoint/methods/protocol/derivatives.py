"""Capability for derivatives of whole runs: loops with tangent vectors forward and cotangents backward."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.systems.system_checks import System

if TYPE_CHECKING:
    from coadjoint.program.added_part import CoefficientMap
    from coadjoint.program.parts.part import Parts
    from coadjoint.systems.energy_derivatives import EnergyDerivative

EXACT = "exact"
ADDED_PART = "added part"
DIFFERENCES = "differences"

Kernel = str | Callable[[Any, Any, int, int], None]


class DerivativeTables(NamedTuple):
    """Tables of a scheme, and the coefficients in them that depend on parameters.

    `tables_at(h)` are those of a step h, or `tables_at(h, values)` with inputs, and `forward` and `backward` names of
    kernels for them, or functions of tables, run, and the first and last of its members. `keepalive` must live as long
    as the tables. Derivatives by `coefficient_count` coefficients are mapped to those by the entries of the parameters
    by `coefficients`, and derivatives by the factors of Casimirs subtracted from the energy, `shift`, by `factors`. The
    `rules` are those above. `reversible` steps can be undone from their end.

    The coefficients are all entries of the fields `located`, one after the other; if there are none, they are those of
    the derivative of the energy only. The `parts` are those of a program.
    """

    tables_at: Callable[..., Any]
    keepalive: tuple[Any, ...]
    forward: Kernel
    backward: Kernel
    coefficient_count: int
    coefficients: Mapping[str, CoefficientMap]
    factors: Mapping[str, CoefficientMap]
    rules: Mapping[str, str]
    shift: tuple[Any, ...]
    reversible: bool
    located: tuple[str, ...] = ()
    parts: Parts | None = None


class CompiledDerivatives(Method):
    """A scheme with loops that differentiate whole runs."""

    @property
    def differentiable(self) -> bool:
        """Whether this scheme has such loops."""
        return True

    @abstractmethod
    def derivative_tables(
        self, system: System, h: float, representation: Representation, energies: Mapping[str, EnergyDerivative]
    ) -> DerivativeTables:
        """Return the tables; `energies` are the derivatives of the energy by the parameters wanted."""


def derivative_tables(
    method: Method,
    system: System,
    h: float,
    representation: Representation,
    energies: Mapping[str, EnergyDerivative],
) -> DerivativeTables:
    """Return the tables of a scheme; raise TypeError, by name, for one whose runs cannot be differentiated."""
    form = method.expanded
    if not isinstance(form, CompiledDerivatives) or not form.differentiable:
        raise TypeError(f"runs by {method} have no derivatives; take a Splitting or a Runge-Kutta method")
    form.properties(system)
    return form.derivative_tables(system, h, representation, energies)


def has_derivatives(method: Method) -> bool:
    """Return whether runs by a scheme can be differentiated."""
    form = method.expanded
    return isinstance(form, CompiledDerivatives) and form.differentiable
