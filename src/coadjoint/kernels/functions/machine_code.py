"""Machine code of callbacks that Numba compiles, stored for other processes in the cache of the user."""

from __future__ import annotations

import ctypes
import hashlib
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numba
from numba.core.environment import Environment, lookup_environment
from numba.core.registry import cpu_target
from numba.core.runtime import rtsys

from coadjoint.code_cache import CodeCache

SUFFIX = ".function"
ENVIRONMENT = "_ZN08NumbaEnv"  # what the names of variables with objects of Python begin with
OPTIONS = ("OPT", "CPU_NAME", "CPU_FEATURES", "BOUNDSCHECK", "SLP_VECTORIZE", "LOOP_VECTORIZE", "ENABLE_AVX")
"""Settings of Numba with which the machine code varies."""


class MachineCode:
    """A callback at an `address`, which lives as long as this object."""

    def __init__(self, address: int, owner: Any) -> None:
        self.address, self._owner = address, owner

    @classmethod
    def of(cls, callback: Any) -> MachineCode:
        """Return that of a callback of Numba."""
        return cls(with_environments(callback).address, callback)


def with_environments(callback: Any) -> Any:
    """Return a callback of Numba after the functions linked into it have their objects of Python."""
    library = callback._library
    for name, environment in _environments(library._final_module.global_variables).items():
        library.codegen.set_env(name, environment)
    return callback


def _environments(variables: Any) -> dict[str, Environment]:
    """Return the objects of Python that functions raise or print, by the names of the variables with them."""
    found = {one.name: lookup_environment(one.name) for one in variables if one.name.startswith(ENVIRONMENT)}
    return {name: environment for name, environment in found.items() if environment is not None}


def stored_or_compiled(key: Any, compiled: Callable[[], Any]) -> MachineCode:
    """Return the callback of a key, equal for equal code, from the cache of the user, or that of Numba and store it."""
    name, found = _file_name(key), None
    try:
        cache = CodeCache(SUFFIX)
        path = cache.find(name)
        found = None if path is None else _loaded(path.read_bytes())
    except OSError:  # without a folder that is safe, each process compiles its functions
        return MachineCode.of(compiled())
    if found is not None:
        return found
    callback = compiled()
    content = _content_of(callback)
    if content is not None:
        with suppress(OSError):
            cache.add(name, lambda path: path.write_bytes(content))
    return MachineCode.of(callback)


@cache
def _own_digest() -> str:
    """Return a digest of the sources of this folder, which adapt functions for the kernels."""
    files = sorted(Path(__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def _file_name(key: Any) -> str:
    versions = _own_digest(), numba.__version__, llvmlite.__version__, sys.implementation.cache_tag, sys.platform
    processor = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    settings = [getattr(numba.config, name, None) for name in OPTIONS]
    return hashlib.sha256(repr((key, versions, processor, settings)).encode()).hexdigest()[:40]


def _content_of(callback: Any) -> bytes | None:
    """Return the object code of a callback, its symbol, those that it needs, and the objects of Python that its
    functions raise or print; None if it holds addresses of this process.
    """
    library = callback._library
    if library.has_dynamic_globals:
        return None
    module = library._final_module
    symbols = [one for of in (module.functions, module.global_variables) for one in of]
    needed = [one.name for one in symbols if one.is_declaration and not one.name.startswith("llvm.")]
    constants = {name: one.consts for name, one in _environments(symbols).items()}
    try:
        head = pickle.dumps((callback.native_name, needed, constants))
    except Exception:  # objects raise exceptions of any type
        return None
    _, _, (code, _) = library.serialize_using_object_code()
    return len(head).to_bytes(8, "little") + head + bytes(code)


def _loaded(content: bytes) -> MachineCode | None:
    """Return a stored callback; None if this process has not all that it needs, with which LLVM would end it."""
    size = int.from_bytes(content[:8], "little")
    name, needed, constants = pickle.loads(content[8 : 8 + size])
    rtsys.initialize(cpu_target.target_context)
    if any(llvm.address_of_symbol(one) is None for one in needed):
        return None
    # An engine for each: the names of other processes may be those of other functions.
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target_machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(content[8 + size :]))
    engine.finalize_object()
    environments = []
    for one, values in constants.items():
        environment = Environment({})
        environment.consts.extend(values)
        environments.append(environment)
        ctypes.c_void_p.from_address(engine.get_global_value_address(one)).value = id(environment)
    return MachineCode(engine.get_function_address(name), (engine, environments))


def _target_machine() -> Any:
    return llvm.Target.from_default_triple().create_target_machine(jit=True, codemodel="jitdefault")
