"""Derivatives of runs by Runge-Kutta methods: parameters as coefficients of the energy in all stages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from coadjoint.kernels.tables.cotangents import runge_kutta_cotangents
from coadjoint.methods.protocol.derivative_tables import EXACT, DerivativeTables
from coadjoint.program.added_part import terms_of
from coadjoint.program.multiples import NO_MULTIPLES
from coadjoint.systems.energy_derivatives import EnergyDerivative

if TYPE_CHECKING:
    from coadjoint.methods.protocol.substep_method import SubstepMethod
    from coadjoint.systems.system import System

FORWARD, BACKWARD = "runge_kutta_directions", "runge_kutta_cotangents"


def runge_kutta_derivatives(
    method: SubstepMethod,
    system: System,
    h: float,
    representation: Any,
    energies: Mapping[str, EnergyDerivative],
    fractions: Sequence[float],
) -> DerivativeTables:
    """Return the tables of a method with substeps; derivatives by parameters are those of the computed map."""
    apart = {name: energy.apart for name, energy in energies.items()}
    joined = EnergyDerivative.joined(list(apart.values()))
    added, coefficients = terms_of(joined, system.dim)
    of_monomials = coefficients.split({name: G.size for name, G in apart.items()})
    loop = method.loop_of_substeps(system, h, representation, fractions)
    built = runge_kutta_cotangents(loop, system, added, joined.functions)
    return DerivativeTables(
        tables_at=lambda step: built.tables,
        keepalive=built.keepalive,
        forward=FORWARD,
        backward=BACKWARD,
        coefficient_count=len(added.offset) + len(added.weight) + len(added.coefficient),
        coefficients={name: one.of_energy(energies[name]) for name, one in of_monomials.items()},
        factors=dict.fromkeys(energies, NO_MULTIPLES),
        rules=dict.fromkeys(energies, EXACT),
        shift=(),
        reversible=False,
        monomials={name: (one, NO_MULTIPLES) for name, one in of_monomials.items()},
        sources=lambda: loop.sources().within("base."),
    )
