# Public names of `co.forces`; lazy_loader and type checkers read this file.

from .base import Force as Force
from .beta_plane import BetaPlane as BetaPlane
from .custom_force import OwnForce as OwnForce
from .double_bracket import DoubleBracketDamping as DoubleBracketDamping
from .friction import Friction as Friction
from .heat_bath import HeatBath as HeatBath
from .linear_damping import LinearDamping as LinearDamping
from .random_forcing import RandomForcing as RandomForcing
from .registry import get as get
from .registry import names as names
from .torque import Torque as Torque
from .viscosity import Viscosity as Viscosity

__all__: list[str]
