"""Derivatives of runs by flow methods: parameters as coefficients of the parts, or as an added part."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from coadjoint.kernels.tables.cotangents import flow_cotangents, with_step
from coadjoint.methods.protocol.derivative_tables import ADDED_PART, EXACT, DerivativeTables
from coadjoint.program.added_part import CoefficientMap, with_added_part
from coadjoint.program.provenance import in_parts
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
    """Return the tables of flows and of their transposes."""
    # Parameters that are in no coefficient, as those of functions, are differentiated as an added part of size zero.
    program = method.program(system, group=representation)
    apart = {name: G.apart for name, G in energies.items()}
    found = {name: in_parts(program, G) for name, G in apart.items()}
    others = [name for name, pair in found.items() if pair is None]
    own, empty, added = {name: pair[0] for name, pair in found.items() if pair}, CoefficientMap.of_triplets(()), None
    in_added = [G if name in others else G.of_functions for name, G in apart.items()]
    if others or any(G.functions for G in in_added):
        added = with_added_part(program, method, system, representation, EnergyDerivative.joined(in_added))
        split = added.split({name: G.size for name, G in apart.items()})
        own = {name: one.joined(added.renumbered(own[name])) if name in own else one for name, one in split.items()}
    monomials = {name: (own[name], pair[1] if pair else empty) for name, pair in found.items()}
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
