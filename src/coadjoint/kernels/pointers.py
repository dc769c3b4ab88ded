"""Arrays as plain pointers: no reference counts and no index checks inside a loop over steps."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic


def pointed_type(kind: Any) -> Any:
    """Return the Numba type that `pointed` makes of a Numba type."""
    if isinstance(kind, types.Array):
        if kind.layout != "C":
            raise TypingError("only C-contiguous arrays become pointers")
        return types.CPointer(kind.dtype)
    if isinstance(kind, types.BaseTuple):
        members = tuple(pointed_type(member) for member in kind.types)
        return types.BaseTuple.from_types(members, getattr(kind, "instance_class", None))
    return kind


def _pointed_value(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.Array):
        return context.make_array(kind)(context, builder, value).data
    if isinstance(kind, types.BaseTuple):
        members = [
            _pointed_value(context, builder, member, item)
            for member, item in zip(kind.types, cgutils.unpack_tuple(builder, value), strict=True)
        ]
        return context.make_tuple(builder, pointed_type(kind), members)
    return value


@intrinsic
def pointed(typingctx: Any, given: Any) -> Any:
    """Return an array as a pointer to its first element; in (named) tuples each of their arrays, under the same names.

    The caller keeps the arrays alive.
    """

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _pointed_value(context, builder, signature.args[0], arguments[0])

    return pointed_type(given)(given), codegen


@intrinsic
def alive(typingctx: Any, arrays: Any) -> Any:
    """Keep arrays up to here: Numba frees one after its last use, and does not know that a pointer still uses it."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return context.get_dummy_value()

    return types.void(arrays), codegen


@intrinsic
def shifted(typingctx: Any, pointer: Any, count: Any) -> Any:
    """Return a pointer that lies `count` elements further."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        base, offset = arguments
        return builder.gep(base, [context.cast(builder, offset, signature.args[1], types.intp)])

    return pointer(pointer, count), codegen


@intrinsic
def call_function(typingctx: Any, address: Any, y: Any, t: Any, out: Any) -> Any:
    """Call the compiled function at an address: it reads the numbers at y and the time t and fills those at out."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number, point, time, result = arguments
        point = _pointed_value(context, builder, signature.args[1], point)
        result = _pointed_value(context, builder, signature.args[3], result)
        kind = ir.FunctionType(ir.VoidType(), [point.type, ir.DoubleType(), result.type])
        builder.call(builder.inttoptr(number, ir.PointerType(kind)), [point, time, result])
        return context.get_dummy_value()

    return types.void(types.int64, y, types.float64, out), codegen
