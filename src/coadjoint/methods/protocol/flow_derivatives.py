"""Derivatives of runs by flow methods: parameters as coefficients of the parts, or as an added part."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from coadjoint.kernels.tables.cotangents import flow_cotangents, with_step
from coadjoint.methods.protocol.derivative_tables import ADDED_PART, EXACT, DerivativeTables
from coadjoint.program.added_part import with_added_part
from coadjoint.program.multiples import NO_MULTIPLES, concatenated
from coadjoint.program.places import Places
from coadjoint.systems.energy_derivatives import EnergyDerivative

if TYPE_CHECKING:
    from coadjoint.methods.protocol.flow_method import FlowMethod
    from coadjoint.systems.lie_poisson import LiePoissonSystem

FORWARD, BACKWARD = "flow_directions", "flow_cotangents"
COEFFICIENTS = ("base.terms.offset", "base.terms.weight", "base.terms.coefficient")


def flow_derivatives(
    method: FlowMethod,
    system: LiePoissonSystem,
    h: float,
    representation: Any,
    energies: Mapping[str, EnergyDerivative],
) -> DerivativeTables:
    """Return the tables of flows and of their transposes.

    Parameters that enter coefficients of the parts are differentiated there. Functions of parameters, and parameters on
    which the forms of the parts depend, are differentiated as an added part of size zero.
    """
    program = method.program(system, group=representation)
    apart = {name: G.apart for name, G in energies.items()}
    places = Places(program)
    found = {name: places.of(G) for name, G in apart.items()}
    own = {name: (of_parts, of_shift) for name, (of_parts, of_shift, missing) in found.items() if not len(missing)}
    others, added = [name for name in found if name not in own], None
    in_added = [G if name in others else G.of_functions for name, G in apart.items()]
    monomials = {name: own.get(name, (NO_MULTIPLES, NO_MULTIPLES)) for name in found}
    if others or any(G.functions for G in in_added):
        added = with_added_part(program, method, system, representation, EnergyDerivative.joined(in_added))
        split = added.split({name: G.size for name, G in apart.items()})
        monomials = {
            name: (concatenated([split[name], added.renumbered(of_parts)]), of_shift)
            for name, (of_parts, of_shift) in monomials.items()
        }
    built = flow_cotangents(program, system, representation, h, method.compensates, added)
    terms = built.tables.base.terms

    def tables_at(step: float) -> Any:
        return built.tables if step == h else with_step(built.tables, step)

    return DerivativeTables(
        tables_at=tables_at,
        keepalive=built.keepalive,
        forward=FORWARD,
        backward=BACKWARD,
        coefficient_count=len(terms.offset) + len(terms.weight) + len(terms.coefficient),
        coefficients={name: one.of_energy(energies[name]) for name, (one, _) in monomials.items()},
        factors={name: one.of_energy(energies[name]) for name, (_, one) in monomials.items()},
        rules={name: ADDED_PART if name in others else EXACT for name in energies},
        shift=program.shift,
        reversible=True,
        located=COEFFICIENTS,
        monomials=monomials,
        sources=lambda: built.sources().within("base."),
    )
