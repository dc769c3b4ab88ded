"""The numerical schemes: base classes for user-defined schemes, and the registry of schemes by name.

Each scheme is a frozen dataclass with its parameters and a declaration of what it keeps.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False

_HOME = {
    "Coefficients": "coadjoint.methods.numerics.stages",
    "CompiledStepMethod": "coadjoint.methods.protocol.compiled_step",
    "FlowMethod": "coadjoint.methods.protocol.flow_method",
    "Forced": "coadjoint.methods.forced",
    "Method": "coadjoint.methods.protocol.method",
    "Operations": "coadjoint.methods.protocol.cost_model",
    "Properties": "coadjoint.methods.protocol.properties",
    "RungeKuttaMethod": "coadjoint.methods.protocol.runge_kutta",
    "StepMethod": "coadjoint.methods.protocol.step_method",
    "Sweep": "coadjoint.program.sweeps",
    "compile_step": "coadjoint.methods.compiled_steps.step_compiler",
    "even_order": "coadjoint.methods.symmetrized",
    "get": "coadjoint.methods.registry",
    "names": "coadjoint.methods.registry",
    "register": "coadjoint.methods.registry",
}

__all__ = sorted(_HOME)

if TYPE_CHECKING:
    from typing import Any

    from coadjoint.methods.compiled_steps.step_compiler import compile_step as compile_step
    from coadjoint.methods.forced import Forced as Forced
    from coadjoint.methods.numerics.stages import Coefficients as Coefficients
    from coadjoint.methods.protocol.compiled_step import CompiledStepMethod as CompiledStepMethod
    from coadjoint.methods.protocol.cost_model import Operations as Operations
    from coadjoint.methods.protocol.flow_method import FlowMethod as FlowMethod
    from coadjoint.methods.protocol.method import Method as Method
    from coadjoint.methods.protocol.properties import Properties as Properties
    from coadjoint.methods.protocol.runge_kutta import RungeKuttaMethod as RungeKuttaMethod
    from coadjoint.methods.protocol.step_method import StepMethod as StepMethod
    from coadjoint.methods.registry import get as get
    from coadjoint.methods.registry import names as names
    from coadjoint.methods.registry import register as register
    from coadjoint.methods.symmetrized import even_order as even_order
    from coadjoint.program.sweeps import Sweep as Sweep


if not TYPE_CHECKING:  # type checkers see the names above and report any other

    def __getattr__(name: str) -> Any:
        if name not in _HOME:
            from coadjoint.errors import unknown_attribute

            raise unknown_attribute("co.methods", name, __all__)
        value = getattr(importlib.import_module(_HOME[name]), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return __all__
