"""Copies of functions for Numba, without machine code that is older than what they read; constants are an argument.

Numba compiles a float that a function closes over, or has as a default, into its machine code. In a copy such numbers
are read from an array instead, whose address is one argument more, also of the functions that pass it on, so that the
machine code serves other numbers too.
"""

from __future__ import annotations

import inspect
import types
from collections.abc import Mapping
from functools import cache
from math import prod
from typing import Any, NamedTuple

import numba
import numpy as np
from numba import types as numba_types
from numba.core import cgutils, ir
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.ir_utils import build_definitions
from numba.core.registry import cpu_target
from numba.core.untyped_passes import FixupArgs
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array

from coadjoint.kernels.functions.contents import (
    Place,
    cells_of,
    contents_of,
    defaults_of,
    global_reads,
    is_known,
    is_own,
)

POINTER = numba_types.CPointer(numba_types.float64)
ARGUMENT = "constants_of_coadjoint"
KIND = inspect.Parameter.POSITIONAL_OR_KEYWORD
MAX_CACHED = 4096
"""Number of compiled functions that are kept; the oldest one is dropped for the next."""
_COPIES: dict[str, Any] = {}
# Called by compiled code only, so that no Python wrappers are compiled.
WITHOUT_WRAPPERS: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
INTERNAL_OPTIONS: dict[str, Any] = {"error_model": "numpy", **WITHOUT_WRAPPERS}
Places = Mapping[int, Mapping[str, Place]]


class NotLiftedError(Exception):
    """Constants reach a function in a way that calls with an argument more do not serve."""


class Lifted(NamedTuple):
    """Intrinsics that read the constants of a function, by name, and the names of functions that take constants too."""

    readers: Mapping[str, Any]
    called: Mapping[str, int]  # with the number of their arguments without a default


def store(cached: dict[Any, Any], key: Any, value: Any) -> None:
    """Add a value to a cache of `MAX_CACHED` ones."""
    while len(cached) >= MAX_CACHED:
        del cached[next(iter(cached))]
    cached[key] = value


def called_in_machine_code(function: Any, places: Places | None = None) -> Any:
    """Return a function in the form that compiled code calls, in which no dispatcher has machine code yet; with
    `places` it and functions in it take constants as an argument. NotLiftedError: these are not all that are in it.
    """
    copies = _Copies(places or {})
    if isinstance(function, types.FunctionType):
        copy = copies.filled(function)
        inner = numba.njit(boundscheck=True, **INTERNAL_OPTIONS, **_pipeline(copy))(copy)
    else:
        inner = copies.of(function)
        if not isinstance(inner, numba.core.dispatcher.Dispatcher):
            inner = numba.njit(**INTERNAL_OPTIONS)(lambda *arguments: function(*arguments))
    if copies.lifted != {*copies.places}:
        raise NotLiftedError
    return inner


class _Copies:
    """Copies of the functions that one function reads, with constants at some places."""

    def __init__(self, places: Places) -> None:
        self.places, self.lifted = places, set[int]()
        self._made: dict[int, tuple[Any, Any]] = {}

    def of(self, value: Any, attributes: frozenset[str] = frozenset()) -> Any:
        """Return a value with copies of dispatchers; functions that Numba does not know become dispatchers."""
        if id(value) in self._made:
            return self._made[id(value)][1]
        if type(value) is tuple:
            return tuple(self.of(entry, attributes) for entry in value)
        if isinstance(value, types.ModuleType) and not is_known(value.__name__):
            module = types.ModuleType(value.__name__)
            self._made[id(value)] = value, module
            held = vars(value)
            vars(module).update(
                {**held, **{name: self.of(held[name], attributes) for name in attributes & held.keys()}}
            )
            return module
        if isinstance(value, types.FunctionType) and not is_known(value.__module__ or "") and not _is_typed(value):
            checked = not is_own(value.__module__ or "")
            new = self._dispatcher(numba.njit(value, boundscheck=checked, **INTERNAL_OPTIONS))
            self._made[id(value)] = value, new
            return new
        return self._dispatcher(value) if isinstance(value, numba.core.dispatcher.Dispatcher) else value

    def _dispatcher(self, value: Any) -> Any:
        """Return the copy of a dispatcher; without constants it is that of all functions which read the same."""
        takes = self.takes_constants(value)
        digest, unknown = ("", ()) if takes else contents_of(value)
        if not takes and not unknown and digest in _COPIES:
            return _COPIES[digest]
        copy = self._unfilled(value.py_func)
        new: Any = type(value)(copy, value.locals, value.targetoptions | WITHOUT_WRAPPERS, **_pipeline(copy))
        self._made[id(value)] = value, new  # before it is filled, since it may call itself
        self._fill(copy, value.py_func)
        if not value._can_compile:
            if takes:
                raise NotLiftedError
            for signature in value.nopython_signatures:
                new.compile(signature)
            new.disable_compile()
        if not takes and not unknown:
            store(_COPIES, digest, new)
        return new

    def takes_constants(self, function: Any) -> bool:
        """Whether a function has constants, or another one that it can call."""
        pending, seen = [_python_function(function)], set[int]()
        while self.places and pending:
            one = pending.pop()
            if id(one) in self.places:
                return True
            if id(one) not in seen:
                seen.add(id(one))
                pending += _called(one).values()
        return False

    def filled(self, function: types.FunctionType) -> types.FunctionType:
        return self._fill(self._unfilled(function), function)

    def _fill(self, copy: types.FunctionType, function: types.FunctionType) -> types.FunctionType:
        """Set the globals and cells of a copy to those of a function, with copies of dispatchers."""
        names, attributes = global_reads(function.__code__)
        for name in function.__globals__.keys() & {*names}:
            copy.__globals__[name] = self.of(function.__globals__[name], attributes)
        held = cells_of(function)
        for name, cell in zip(function.__code__.co_freevars, copy.__closure__ or (), strict=True):
            if name in held:
                cell.cell_contents = self.of(held[name], attributes)
        return copy

    def _unfilled(self, function: types.FunctionType) -> types.FunctionType:
        """Return a copy without its cells, with the constants among its arguments, behind those without a default."""
        cells = tuple(types.CellType() for _ in function.__closure__ or ()) or None
        names = dict(function.__globals__)
        copy: Any = types.FunctionType(function.__code__, names, function.__name__, function.__defaults__, cells)
        copy.__kwdefaults__, copy.__qualname__ = function.__kwdefaults__, function.__qualname__
        if not self.takes_constants(function):
            return copy
        own, given = self.places.get(id(function), {}), list(inspect.signature(function).parameters.values())
        if any(one.kind is not KIND for one in given):
            raise NotLiftedError
        readers = {name: reader(place) for name, place in own.items()}
        # Values of defaults that are read from the constants are not compiled.
        defaults = {name: 0.0 if name in own else value for name, value in defaults_of(function).items()}
        first = [one for one in given if one.name not in defaults]
        others = [one.replace(default=defaults[one.name]) for one in given[len(first) :]]
        copy.__defaults__ = tuple(defaults.values())
        copy.__signature__ = inspect.Signature([*first, inspect.Parameter(ARGUMENT, KIND), *others])
        called = {
            name: len(inspect.signature(one).parameters) - len(one.__defaults__ or ())
            for name, one in _called(function).items()
            if self.takes_constants(one)
        }
        copy.lifted = Lifted(readers, called)
        self.lifted.update({id(function)} & {*self.places})
        return copy


def _is_typed(function: types.FunctionType) -> bool:
    """Whether Numba knows a function of Python by another one, such as that of `register_jitable` or `overload`."""
    typing = cpu_target.typing_context
    typing.refresh()  # with those that were declared since something was compiled
    try:
        return bool(typing.resolve_value_type(function))
    except (ValueError, numba.errors.NumbaError):
        return False


def _pipeline(copy: Any) -> dict[str, Any]:
    return {"pipeline_class": LiftingCompiler if hasattr(copy, "lifted") else CopyCompiler}


def _python_function(value: Any) -> Any:
    return getattr(value, "py_func", value)


def _called(function: Any) -> dict[str, types.FunctionType]:
    """Return the functions in the cells and globals of a function, by name."""
    held = {name: function.__globals__.get(name) for name in global_reads(function.__code__)[0]}
    found = {name: _python_function(value) for name, value in {**held, **cells_of(function)}.items()}
    return {name: one for name, one in found.items() if isinstance(one, types.FunctionType)}


@cache
def reader(place: Place) -> Any:
    """Return an intrinsic that returns the constant at a place of an array."""
    offset, kind, shape = place

    @intrinsic  # type: ignore[untyped-decorator]
    def read(_: Any, constants: Any) -> Any:
        number = numba_types.complex128 if kind.startswith("complex") else numba_types.float64
        found = {
            "float": number,
            "complex": number,
            "tuple": numba_types.UniTuple(number, prod(shape)),
        }.get(kind) or numba_types.Array(number, max(1, len(shape)), "C", readonly=True)

        def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
            def address(k: int) -> Any:
                return builder.gep(arguments[0], [cgutils.intp_t(offset + k)])

            def loaded(k: int) -> Any:
                number_at = builder.load(address(k))
                # Nothing that a function writes changes it, so that loops read it once.
                number_at.set_metadata("invariant.load", builder.module.add_metadata([]))
                return number_at

            if kind == "float":
                return loaded(0)
            if kind == "complex":
                value = context.make_complex(builder, found)
                value.real, value.imag = loaded(0), loaded(1)
                return value._getvalue()
            if kind == "tuple":
                return context.make_tuple(builder, found, [loaded(k) for k in range(*shape)])
            size = number.bitwidth // 8
            array, strides = make_array(found)(context, builder), size * np.cumprod([1, *shape[:0:-1]])[::-1]
            populate_array(
                array,
                data=builder.bitcast(address(0), context.get_data_type(number).as_pointer()),
                shape=[cgutils.intp_t(n) for n in shape],
                strides=[cgutils.intp_t(int(n)) for n in strides],
                itemsize=cgutils.intp_t(size),
                meminfo=None,
            )
            return array._getvalue()

        return found(constants), generate

    return read


@register_pass(mutates_CFG=False, analysis_only=False)
class LiftConstants(FunctionPass):  # type: ignore[misc]
    """A pass of Numba by which a `Lifted` copy reads its constants, and passes their address on."""

    _name = "lift_constants"

    def __init__(self) -> None:
        FunctionPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        function = state.func_ir
        lifted = function.func_id.func.lifted
        statements = [one for block in function.blocks.values() for one in block.body if isinstance(one, ir.Assign)]
        of_argument = next(one for one in statements if isinstance(one.value, ir.Arg) and one.value.name == ARGUMENT)
        functions = {
            one.target.name: lifted.called[one.value.name]
            for one in statements
            if isinstance(one.value, ir.FreeVar | ir.Global) and one.value.name in lifted.called
        }
        for one in statements:
            if isinstance(one.value, ir.Expr) and one.value.op == "call" and one.value.func.name in functions:
                call = one.value
                if call.kws or call.vararg or call.varkwarg or len(call.args) != functions[call.func.name]:
                    raise NotLiftedError
                call.args = [*call.args, of_argument.target]
        for block in function.blocks.values():
            body = []
            for one in block.body:
                value = getattr(one, "value", None)
                if isinstance(value, ir.FreeVar | ir.Arg) and value.name in lifted.readers:
                    read = block.scope.redefine("$reader", one.loc)
                    body.append(ir.Assign(ir.Global("reader", lifted.readers[value.name], one.loc), read, one.loc))
                    one.value = ir.Expr.call(read, [of_argument.target], (), one.loc)
                body.append(one)
            block.body = body
        # The argument is assigned before the constants that are read from it.
        entry = function.blocks[min(function.blocks)]
        entry.body.remove(of_argument)
        entry.body.insert(0, of_argument)
        function._definitions = build_definitions(function.blocks)
        return True


class LinkedLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Code that is only linked into that of callers, with which LLVM optimizes it and makes machine code, once."""

    @property
    def codegen(self) -> Any:
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Pass: the callback has the environments of all functions in it."""

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class CopyCompiler(CompilerBase):  # type: ignore[misc]
    """The compiler of Numba, for code that is only linked."""

    def define_pipelines(self) -> list[Any]:
        self.state.library = LinkedLibrary(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        self.add_passes(passes)
        passes.finalize()
        return [passes]

    def add_passes(self, passes: Any) -> None:
        """Add passes before others."""


class LiftingCompiler(CopyCompiler):
    """The same with `LiftConstants`."""

    def add_passes(self, passes: Any) -> None:
        passes.add_pass_after(LiftConstants, FixupArgs)
