"""By which scheme? Each one a small frozen dataclass: its coefficients and what it declares to keep.

Here are the base classes that a scheme of your own derives from, and the registry of schemes by name.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False

_HOME = {
    "CompiledStepMethod": "compiled_step",
    "FlowMethod": "flow_method",
    "Method": "base",
    "Properties": "base",
    "RungeKuttaMethod": "runge_kutta",
    "StepMethod": "step_method",
    "compile_step": "compiling",
    "get": "registry",
    "names": "registry",
    "register": "registry",
}

__all__ = sorted(_HOME)

if TYPE_CHECKING:
    from typing import Any

    from coadjoint.methods.base import Method as Method
    from coadjoint.methods.base import Properties as Properties
    from coadjoint.methods.compiled_step import CompiledStepMethod as CompiledStepMethod
    from coadjoint.methods.compiling import compile_step as compile_step
    from coadjoint.methods.flow_method import FlowMethod as FlowMethod
    from coadjoint.methods.registry import get as get
    from coadjoint.methods.registry import names as names
    from coadjoint.methods.registry import register as register
    from coadjoint.methods.runge_kutta import RungeKuttaMethod as RungeKuttaMethod
    from coadjoint.methods.step_method import StepMethod as StepMethod


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'coadjoint.methods' has no attribute {name!r}")
    found = getattr(importlib.import_module(f"coadjoint.methods.{_HOME[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return __all__
