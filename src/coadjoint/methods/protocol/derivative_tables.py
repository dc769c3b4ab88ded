"""Tables of the compiled loops that differentiate whole runs, forward and backward."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.loop import CompiledLoop
from coadjoint.kernels.tables.compiled import unrecorded
from coadjoint.kernels.tables.derivatives import (
    flow_cotangents,
    runge_kutta_cotangents,
    with_step,
)
from coadjoint.methods.protocol.flow_method import FlowMethod
from coadjoint.program.added_part import Places, terms_of, with_added_part
from coadjoint.program.sources import NO_MULTIPLES, Multiples, Sources, concatenated
from coadjoint.systems.energy_derivatives import EnergyDerivative
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.system import System

Floats = NDArray[np.float64]

EXACT = "exact"
ADDED_PART = "added part"
DIFFERENCES = "differences"
NEAREST_FIRST = (EXACT, DIFFERENCES, ADDED_PART)
COEFFICIENTS = ("base.terms.offset", "base.terms.weight", "base.terms.coefficient")


def least_exact(rules: Iterable[str]) -> str:
    """Return the rule that is farthest from the derivative of the computed map."""
    return max(rules, key=NEAREST_FIRST.index)


Kernel = str | Callable[[Any, Any, int, int], None]


class DerivativeTables(NamedTuple):
    """Tables of a scheme by step (and inputs), their kernels, and maps from coefficients to entries of parameters."""

    # `factors`: of Casimirs subtracted from H; `of_members`: those of a batch; `located`: differentiated fields.

    tables_at: Callable[..., Any]
    forward: Kernel
    backward: Kernel
    coefficient_count: int
    coefficients: Mapping[str, Multiples]
    factors: Mapping[str, Multiples]
    rules: Mapping[str, str]
    keepalive: tuple[Any, ...] = ()
    shift: tuple[Any, ...] = ()
    reversible: bool = False
    located: tuple[str, ...] = ()
    monomials: Mapping[str, tuple[Multiples, Multiples]] = {}
    of_members: NDArray[np.float64] | None = None
    sources: Callable[[], Sources] = unrecorded


def flow_derivatives(
    method: FlowMethod,
    system: LiePoissonSystem,
    h: float,
    representation: Any,
    energies: Mapping[str, EnergyDerivative],
) -> DerivativeTables:
    """Return the tables of flows and of their transposes."""
    # Parameters that are in no coefficient, as those of functions, are differentiated as an added part of size zero.
    flow_table = method.flow_table(system, group=representation)
    apart = {name: G.apart for name, G in energies.items()}
    places = Places(flow_table)
    found = {name: places.of(G) for name, G in apart.items()}
    own = {name: (of_parts, of_shift) for name, (of_parts, of_shift, missing) in found.items() if not len(missing)}
    others, added = [name for name in found if name not in own], None
    in_added = [G if name in others else G.of_functions for name, G in apart.items()]
    monomials = {name: own.get(name, (NO_MULTIPLES, NO_MULTIPLES)) for name in found}
    if others or any(G.functions for G in in_added):
        added = with_added_part(flow_table, method, system, representation, EnergyDerivative.joined(in_added))
        split = added.split({name: G.size for name, G in apart.items()})
        monomials = {
            name: (concatenated([split[name], added.renumbered(of_parts)]), of_shift)
            for name, (of_parts, of_shift) in monomials.items()
        }
    built = flow_cotangents(flow_table, system, representation, h, method.compensates, added)
    terms = built.tables.base.terms

    def tables_at(step: float) -> Any:
        return built.tables if step == h else with_step(built.tables, step)

    return DerivativeTables(
        tables_at=tables_at,
        keepalive=built.keepalive,
        forward="flow_directions",
        backward="flow_cotangents",
        coefficient_count=len(terms.offset) + len(terms.weight) + len(terms.coefficient),
        coefficients={name: one.of_energy(energies[name]) for name, (one, _) in monomials.items()},
        factors={name: one.of_energy(energies[name]) for name, (_, one) in monomials.items()},
        rules={name: ADDED_PART if name in others else EXACT for name in energies},
        shift=flow_table.shift,
        reversible=True,
        located=COEFFICIENTS,
        monomials=monomials,
        sources=lambda: built.sources().within("base."),
    )


def runge_kutta_derivatives(
    loop: CompiledLoop, system: System, energies: Mapping[str, EnergyDerivative]
) -> DerivativeTables:
    """Return the tables of stages and of their transposes; derivatives by parameters are those of the computed map."""
    apart = {name: energy.apart for name, energy in energies.items()}
    joined = EnergyDerivative.joined(list(apart.values()))
    added, coefficients = terms_of(joined, system.dim)
    of_monomials = coefficients.split({name: G.size for name, G in apart.items()})
    built = runge_kutta_cotangents(loop, system, added, joined.functions)
    return DerivativeTables(
        tables_at=lambda step: built.tables,
        keepalive=built.keepalive,
        forward="runge_kutta_directions",
        backward="runge_kutta_cotangents",
        coefficient_count=len(added.offset) + len(added.weight) + len(added.coefficient),
        coefficients={name: one.of_energy(energies[name]) for name, one in of_monomials.items()},
        factors=dict.fromkeys(energies, NO_MULTIPLES),
        rules=dict.fromkeys(energies, EXACT),
        monomials={name: (one, NO_MULTIPLES) for name, one in of_monomials.items()},
        sources=lambda: loop.sources().within("base."),
    )
