# Public names of `co.forces`; lazy_loader and type checkers read this file.

from .actuators import ControlMomentGyros as ControlMomentGyros
from .actuators import ReactionWheels as ReactionWheels
from .actuators import Thrusters as Thrusters
from .base import Force as Force
from .body_torque import Pointing as Pointing
from .double_bracket import DoubleBracketDamping as DoubleBracketDamping
from .double_bracket import HeatBath as HeatBath
from .environment_torques import Drag as Drag
from .environment_torques import GravityGradient as GravityGradient
from .environment_torques import MagneticDipole as MagneticDipole
from .environment_torques import SolarPressure as SolarPressure
from .fluid_forces import BetaPlane as BetaPlane
from .fluid_forces import Friction as Friction
from .fluid_forces import RandomForcing as RandomForcing
from .fluid_forces import Viscosity as Viscosity
from .general_forces import LinearDamping as LinearDamping
from .general_forces import OwnForce as OwnForce
from .gilbert import Gilbert as Gilbert
from .hamiltonian_noise import HamiltonianNoise as HamiltonianNoise
from .langevin import Langevin as Langevin
from .magnetorquers import BDot as BDot
from .magnetorquers import Magnetorquers as Magnetorquers
from .random_field import RandomField as RandomField
from .random_torque import RandomTorque as RandomTorque
from .registry import get as get
from .registry import names as names
from .sampled import Sampled as Sampled
from .selective_decay import SelectiveDecay as SelectiveDecay
from .torque import Torque as Torque
from .transport_noise import TransportNoise as TransportNoise
from .wheel_friction import WheelFriction as WheelFriction

__all__: list[str]
