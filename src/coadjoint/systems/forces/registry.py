"""Forces by name, as in configuration files and records."""

from __future__ import annotations

from typing import Any

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.forces.base import Force
from coadjoint.systems.forces.beta_plane import BetaPlane
from coadjoint.systems.forces.control_moment_gyros import ControlMomentGyros
from coadjoint.systems.forces.custom_force import OwnForce
from coadjoint.systems.forces.double_bracket import DoubleBracketDamping
from coadjoint.systems.forces.friction import Friction
from coadjoint.systems.forces.gravity_gradient import GravityGradient
from coadjoint.systems.forces.heat_bath import HeatBath
from coadjoint.systems.forces.linear_damping import LinearDamping
from coadjoint.systems.forces.magnetic_dipole import MagneticDipole
from coadjoint.systems.forces.plates import Drag, SolarPressure
from coadjoint.systems.forces.pointing import Pointing
from coadjoint.systems.forces.random_forcing import RandomForcing
from coadjoint.systems.forces.reaction_wheels import ReactionWheels
from coadjoint.systems.forces.sampled import Sampled
from coadjoint.systems.forces.thrusters import Thrusters
from coadjoint.systems.forces.torque import Torque
from coadjoint.systems.forces.viscosity import Viscosity
from coadjoint.validation import construct

FORCES: tuple[type[Force], ...] = (
    *(BetaPlane, DoubleBracketDamping, Friction, HeatBath, LinearDamping),
    *(OwnForce, RandomForcing, Torque, Viscosity),
    *(GravityGradient, MagneticDipole, Drag, SolarPressure, Pointing),
    *(Sampled, ReactionWheels, ControlMomentGyros, Thrusters),
)

KINDS: dict[str, type[Force]] = {kind.__name__: kind for kind in FORCES}


@suggest_keywords
def names() -> tuple[str, ...]:
    """Return the names of the forces, sorted.

    Returns
    -------
    tuple of str

    Examples
    --------
    >>> names()[:3]
    ('BetaPlane', 'ControlMomentGyros', 'DoubleBracketDamping')
    """
    return tuple(sorted(KINDS))


@suggest_keywords
def get(name: str, /, **parameters: Any) -> Force:
    """Return a force by its name, as a configuration file does.

    Parameters
    ----------
    name : str
        One of `names`.
    **parameters
        Parameters of the force; omitted ones take their defaults.

    Returns
    -------
    Force

    Raises
    ------
    ValueError, TypeError
        Unknown force or parameter (the message suggests the nearest name), or an invalid value.

    Examples
    --------
    >>> get("LinearDamping", rate=0.5)
    LinearDamping(rate=0.5, toward=0.0)
    """
    return construct("force", KINDS, name, parameters)  # type: ignore[no-any-return]
