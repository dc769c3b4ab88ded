# Public names of `co.forces`; lazy_loader and type checkers read this file.

from .base import Force as Force
from .beta_plane import BetaPlane as BetaPlane
from .control_moment_gyros import ControlMomentGyros as ControlMomentGyros
from .custom_force import OwnForce as OwnForce
from .double_bracket import DoubleBracketDamping as DoubleBracketDamping
from .friction import Friction as Friction
from .gravity_gradient import GravityGradient as GravityGradient
from .heat_bath import HeatBath as HeatBath
from .linear_damping import LinearDamping as LinearDamping
from .magnetic_dipole import MagneticDipole as MagneticDipole
from .plates import Drag as Drag
from .plates import SolarPressure as SolarPressure
from .pointing import Pointing as Pointing
from .random_forcing import RandomForcing as RandomForcing
from .reaction_wheels import ReactionWheels as ReactionWheels
from .registry import get as get
from .registry import names as names
from .sampled import Sampled as Sampled
from .thrusters import Thrusters as Thrusters
from .torque import Torque as Torque
from .viscosity import Viscosity as Viscosity

__all__: list[str]
