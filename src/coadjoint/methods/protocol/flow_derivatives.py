"""Derivatives of runs by flow methods: parameters as coefficients of the parts, or as an added part."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from coadjoint.kernels.tables.cotangents import flow_cotangents, with_step
from coadjoint.methods.protocol.derivative_tables import ADDED_PART, EXACT, DerivativeTables
from coadjoint.program.added_part import CoefficientMap, terms_of, with_added_part
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
    """Return the tables of flows and of their transposes.

    Parameters that enter coefficients of the parts are differentiated there. Functions of parameters, and parameters on
    which the forms of the parts depend, are differentiated as an added part of size zero.
    """
    program = method.program(system, group=representation)
    found = {name: in_parts(program, G) for name, G in energies.items()}
    factors = {name: pair[1] for name, pair in found.items() if pair is not None}
    others = [name for name, pair in found.items() if pair is None]

    def in_added_part(of: Mapping[str, EnergyDerivative]) -> EnergyDerivative:
        pieces = {name: G if name in others else G.of_functions for name, G in of.items()}
        return EnergyDerivative.joined([pieces[name] for name in energies])

    added = None
    if others or any(G.functions for G in energies.values()):
        added = with_added_part(program, method, system, representation, in_added_part(energies))

    def numbered(in_own: Mapping[str, CoefficientMap], in_added: CoefficientMap | None) -> dict[str, CoefficientMap]:
        if added is None or in_added is None:
            return dict(in_own)
        split = added.split(in_added, {name: G.size for name, G in energies.items()})
        renumbered = {name: added.renumbered(one) for name, one in in_own.items()}
        return {name: one.joined(renumbered[name]) if name in renumbered else one for name, one in split.items()}

    def maps(of_other: Mapping[str, EnergyDerivative]) -> dict[str, CoefficientMap]:
        pairs = ((name, in_parts(program, G)) for name, G in of_other.items() if name not in others)
        in_added = None if added is None else terms_of(in_added_part(of_other), system.dim)[1]
        return numbered({name: pair[0] for name, pair in pairs if pair is not None}, in_added)

    in_own = {name: pair[0] for name, pair in found.items() if pair is not None}
    built = flow_cotangents(program, system, representation, h, method.compensates, added)
    terms = built.tables.base.terms

    def tables_at(step: float) -> Any:
        return built.tables if step == h else with_step(built.tables, step)

    empty = CoefficientMap.of_triplets(())
    return DerivativeTables(
        tables_at=tables_at,
        keepalive=built.keepalive,
        forward=FORWARD,
        backward=BACKWARD,
        coefficient_count=len(terms.offset) + len(terms.weight) + len(terms.coefficient),
        coefficients=numbered(in_own, None if added is None else added.coefficients),
        factors={name: factors.get(name, empty) for name in energies},
        rules={name: ADDED_PART if name in others else EXACT for name in energies},
        shift=program.shift,
        reversible=True,
        located=COEFFICIENTS,
        maps=maps,
        sources=lambda: built.sources().within("base."),
    )
