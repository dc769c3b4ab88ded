# Public names of `co.methods`; lazy_loader and type checkers read this file.

from .composition import even_order as even_order
from .forced import Forced as Forced
from .gauss_legendre import gauss_tableau as gauss_tableau
from .numerics.solvers import Coefficients as Coefficients
from .numerics.solvers import begin as begin
from .numerics.solvers import iterate_to_stagnation as iterate_to_stagnation
from .protocol.cost_model import Operations as Operations
from .protocol.cost_model import Work as Work
from .protocol.flow_method import FlowMethod as FlowMethod
from .protocol.flow_method import Sweep as Sweep
from .protocol.method import Method as Method
from .protocol.properties import Properties as Properties
from .protocol.runge_kutta import RungeKuttaMethod as RungeKuttaMethod
from .protocol.step_method import CompiledStepMethod as CompiledStepMethod
from .protocol.step_method import StepMethod as StepMethod
from .registry import get as get
from .registry import names as names
from .registry import register as register
from .step_compiler import compile_step as compile_step

__all__: list[str]
