"""Forces, which act in addition to the Hamiltonian: damping, torques, heat baths (``co.forces``).

A force breaks the Lie-Poisson structure and declares what it keeps. ``system.with_forces(force, ...)`` adds it to a
system.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False

_HOME = {
    "Viscosity": "coadjoint.systems.forces.viscosity",
    "RandomForcing": "coadjoint.systems.forces.random_forcing",
    "Friction": "coadjoint.systems.forces.friction",
    "BetaPlane": "coadjoint.systems.forces.beta_plane",
    "DoubleBracketDamping": "coadjoint.systems.forces.double_bracket",
    "Force": "coadjoint.systems.forces.base",
    "HeatBath": "coadjoint.systems.forces.heat_bath",
    "LinearDamping": "coadjoint.systems.forces.linear_damping",
    "OwnForce": "coadjoint.systems.forces.custom_force",
    "Torque": "coadjoint.systems.forces.torque",
    "get": "coadjoint.systems.forces.registry",
    "names": "coadjoint.systems.forces.registry",
}

__all__ = sorted(_HOME)

if TYPE_CHECKING:
    from typing import Any

    from coadjoint.systems.forces.base import Force as Force
    from coadjoint.systems.forces.beta_plane import BetaPlane as BetaPlane
    from coadjoint.systems.forces.custom_force import OwnForce as OwnForce
    from coadjoint.systems.forces.double_bracket import DoubleBracketDamping as DoubleBracketDamping
    from coadjoint.systems.forces.friction import Friction as Friction
    from coadjoint.systems.forces.heat_bath import HeatBath as HeatBath
    from coadjoint.systems.forces.linear_damping import LinearDamping as LinearDamping
    from coadjoint.systems.forces.random_forcing import RandomForcing as RandomForcing
    from coadjoint.systems.forces.registry import get as get
    from coadjoint.systems.forces.registry import names as names
    from coadjoint.systems.forces.torque import Torque as Torque
    from coadjoint.systems.forces.viscosity import Viscosity as Viscosity


if not TYPE_CHECKING:  # type checkers resolve the names statically and report unknown ones

    def __getattr__(name: str) -> Any:
        if name not in _HOME:
            from coadjoint.errors import unknown_attribute

            raise unknown_attribute("co.forces", name, __all__)
        value = getattr(importlib.import_module(_HOME[name]), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return __all__
