"""Primitives of JAX that integrate, and their rules: the derivative is a linear primitive with a transpose.

Both modes follow. Names of values are parameters: "x0", "attitude0" and those of parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from coadjoint.runs.derivatives.parametrized_run import ParametrizedRun
from coadjoint.validation import is_of_torch, reject_lost_labels

Names = tuple[str, ...]


def solve(run: ParametrizedRun, x0: Any, attitude0: Any, parameters: Mapping[str, Any]) -> Any:
    """Return the states of a run, and the attitudes if it has them, as functions of arrays of JAX."""
    values = doubles(run.arguments(x0, attitude0, parameters))
    run.check({name: value.shape for name, value in values.items()})
    if "attitude0" in values:
        attitude = values["attitude0"]
        values["attitude0"] = jnp.broadcast_to(attitude, (*values["x0"].shape[:-1], *attitude.shape[-2:]))
    outputs = SOLUTION.bind(*values.values(), run=run, names=tuple(values), for_gradient=False)
    return tuple(outputs) if len(outputs) > 1 else outputs[0]


def doubles(values: Mapping[str, Any], dtype: Any = np.float64) -> dict[str, Any]:
    """Convert values to arrays of float64, and x0 to `dtype`; raise TypeError for numbers of lower precision."""
    if not jax.config.jax_enable_x64:
        raise TypeError(
            'JAX computes in float32 and coadjoint in float64; call jax.config.update("jax_enable_x64", True) first'
        )
    return {name: _double(name, value, dtype if name == "x0" else np.float64) for name, value in values.items()}


def unrounded(name: str, value: Any) -> Any:
    """Convert an argument to an array of JAX, and refuse those whose labels would be lost, or numbers rounded."""
    reject_lost_labels(value, name)
    if is_of_torch(value):
        raise TypeError(f"{name} is a tensor of PyTorch; use co.torch, or give an array, its detach().numpy()")
    if isinstance(value, np.ndarray) and value.dtype == np.float64 and not jax.config.jax_enable_x64:
        raise TypeError(f"{name} is an array of float64, which JAX rounds; give float32, or set jax_enable_x64")
    return jnp.asarray(value)


def _double(name: str, value: Any, dtype: Any) -> Any:
    """Convert whole numbers to `dtype`, also float64 to complex128, and refuse numbers of lower precision."""
    array = unrounded(name, value)
    if not jnp.issubdtype(array.dtype, jnp.integer) and array.dtype not in (jnp.float64, dtype):
        raise TypeError(f"{name} has the dtype {array.dtype}; give {jnp.dtype(dtype).name}")
    return array.astype(dtype)


# What the primitives compute, with arrays of NumPy, and the shapes of that.


def _solution(*values: Any, run: ParametrizedRun, names: Names, for_gradient: bool) -> list[Any]:
    return run.solve(dict(zip(names, values, strict=True)), for_gradient)


def _solution_shapes(*shapes: Any, run: ParametrizedRun, names: Names, for_gradient: bool) -> list[Any]:
    return list(run.output_shapes(shapes[0]))


def _tangents(*arrays: Any, run: ParametrizedRun, names: Names, along: Names) -> list[Any]:
    values, directions = arrays[: len(names)], arrays[len(names) :]
    return run.tangents(dict(zip(names, values, strict=True)), dict(zip(along, directions, strict=True)))


def _tangent_shapes(*shapes: Any, run: ParametrizedRun, names: Names, along: Names) -> list[Any]:
    (count, *_), *_ = shapes[len(names) :]
    return [(count, *shape) for shape in run.output_shapes(shapes[0])]


def _gradients(*arrays: Any, run: ParametrizedRun, names: Names, by: Names, by_member: bool) -> list[Any]:
    values, cotangents = arrays[: len(names)], arrays[len(names) :]
    return run.gradients(dict(zip(names, values, strict=True)), list(cotangents), by, by_member)


def _gradient_shapes(*shapes: Any, run: ParametrizedRun, names: Names, by: Names, by_member: bool) -> list[Any]:
    (count, *_), *_ = shapes[len(names) :]
    members = shapes[0][:1] if by_member else ()
    known = dict(zip(names, shapes[: len(names)], strict=True))
    return [(count, *(members if run.is_parameter(name) else ()), *known[name]) for name in by]


def _primitive(name: str, compute: Callable[..., list[Any]], shapes_of: Callable[..., list[Any]]) -> Primitive:
    """Return a primitive that runs at once outside of compiled programs, and as a callback inside of them."""
    primitive = Primitive(f"coadjoint_{name}")
    primitive.multiple_results = True

    def on_host(*arrays: Any, **parameters: Any) -> list[Any]:
        return compute(*map(np.asarray, arrays), **parameters)

    def at_once(*arrays: Any, **parameters: Any) -> list[Any]:
        # Copies: arrays of JAX may not share memory with those of cached runs.
        return [jnp.array(one) for one in on_host(*arrays, **parameters)]

    def abstract(*arrays: Any, **parameters: Any) -> list[Any]:
        shapes = shapes_of(*(array.shape for array in arrays), **parameters)
        return [jax.core.ShapedArray(shape, np.dtype(np.float64)) for shape in shapes]

    def called_back(*arrays: Any, **parameters: Any) -> Any:
        return jax.pure_callback(partial(on_host, **parameters), abstract(*arrays, **parameters), *arrays)

    def lowered(context: Any, *operands: Any, **parameters: Any) -> Any:
        if getattr(context.module_context.axis_context, "num_devices", None) != 1:
            return mlir.lower_fun(called_back, multiple_results=True)(context, *operands, **parameters)
        # pure_callback copies large arguments on a thread of the running program, and waits for ever if it has one.
        results, _, _ = mlir.emit_python_callback(
            context,
            partial(on_host, **parameters),
            None,
            list(operands),
            context.avals_in,
            context.avals_out,
            has_side_effect=False,
        )
        return results

    primitive.def_impl(at_once)
    primitive.def_abstract_eval(abstract)
    mlir.register_lowering(primitive, lowered)
    return primitive


SOLUTION = _primitive("solution", _solution, _solution_shapes)
TANGENTS = _primitive("tangents", _tangents, _tangent_shapes)
"""Takes values, then directions of those in `along`, with a first axis for several; so have its results."""
GRADIENTS = _primitive("gradients", _gradients, _gradient_shapes)
"""The transpose: takes values, then cotangents of the outputs, and returns those of the values in `by`."""


# Derivatives.


def _is_zero(tangent: Any) -> bool:
    return type(tangent) is ad.Zero


def _jvp_of_solution(values: Sequence[Any], tangents: Sequence[Any], *, run: Any, names: Names, **_: Any) -> Any:
    given = {name: tangent[None] for name, tangent in zip(names, tangents, strict=True) if not _is_zero(tangent)}
    outputs = SOLUTION.bind(*values, run=run, names=names, for_gradient=True)
    of_outputs = TANGENTS.bind(*values, *given.values(), run=run, names=names, along=tuple(given))
    return outputs, [one[0] for one in of_outputs]


def _jvp_of_linear(primitive: Primitive, arrays: Sequence[Any], tangents: Sequence[Any], **parameters: Any) -> Any:
    count = len(parameters["names"])
    if not all(map(_is_zero, tangents[:count])):
        raise NotImplementedError(
            "runs have first derivatives only; take differences of gradients, or a Gauss-Newton product of jvp and vjp"
        )
    linear = map(ad.instantiate_zeros, tangents[count:])
    return primitive.bind(*arrays, **parameters), primitive.bind(*arrays[:count], *linear, **parameters)


def _transpose_of_tangents(cotangents: Sequence[Any], *arrays: Any, run: Any, names: Names, along: Names) -> list[Any]:
    count = len(names)
    given = map(ad.instantiate_zeros, cotangents)
    found = GRADIENTS.bind(*arrays[:count], *given, run=run, names=names, by=along, by_member=False)
    return [None] * count + found


def _transpose_of_gradients(
    cotangents: Sequence[Any], *arrays: Any, run: Any, names: Names, by: Names, by_member: bool
) -> list[Any]:
    if by_member:
        raise NotImplementedError("gradients by members have no transpose; apply vmap after linear_transpose")
    count = len(names)
    given = map(ad.instantiate_zeros, cotangents)
    return [None] * count + TANGENTS.bind(*arrays[:count], *given, run=run, names=names, along=by)


ad.primitive_jvps[SOLUTION] = _jvp_of_solution
for _linear in (TANGENTS, GRADIENTS):
    ad.primitive_jvps[_linear] = partial(_jvp_of_linear, _linear)
ad.primitive_transposes[TANGENTS] = _transpose_of_tangents
ad.primitive_transposes[GRADIENTS] = _transpose_of_gradients


# Batches: of members if all share the parameters, of directions at one state, else one after the other.


def _at(axis: int, array: Any, batched: int | None, size: int) -> Any:
    """Return an array with its axis of a batch at `axis`; repeat one that has none."""
    if batched is None:
        return jnp.broadcast_to(jnp.expand_dims(array, axis), (*array.shape[:axis], size, *array.shape[axis:]))
    return jnp.moveaxis(array, batched, axis)


def _merged(array: Any, axis: int) -> Any:
    return array.reshape(*array.shape[:axis], -1, *array.shape[axis + 2 :])


def _split(array: Any, axis: int, size: int) -> Any:
    return array.reshape(*array.shape[:axis], size, -1, *array.shape[axis + 1 :])


def _size(arrays: Sequence[Any], axes: Sequence[int | None]) -> int:
    return next(array.shape[axis] for array, axis in zip(arrays, axes, strict=True) if axis is not None)


class _Members:
    """A batch of initial states, merged with the axis of members, if there is one."""

    def __init__(self, names: Names, values: Sequence[Any], axes: Sequence[int | None], size: int) -> None:
        self.size = size
        self.single = values[0].ndim == (1 if axes[0] is None else 2)
        self.names = {name for name in names if name in ("x0", "attitude0")}
        self.values = [
            self.merged(_at(0, value, axis, size), 0) if name in self.names else value
            for name, value, axis in zip(names, values, axes, strict=True)
        ]

    def merged(self, array: Any, axis: int) -> Any:
        """Join the axis of the batch and that of members."""
        return array if self.single else _merged(array, axis)

    def split(self, array: Any, axis: int) -> Any:
        return array if self.single else _split(array, axis, self.size)


def _shared(run: Any, names: Names, axes: Sequence[int | None]) -> bool:
    """Whether no parameter has an axis of a batch, and states may become members of one ensemble."""
    return not run.has_batch and all(
        axis is None for name, axis in zip(names, axes, strict=True) if run.is_parameter(name)
    )


def _in_turn(primitive: Primitive, arrays: Sequence[Any], axes: Sequence[int | None], **parameters: Any) -> Any:
    """Apply a primitive to the entries of a batch, one after the other."""
    batched = [jnp.moveaxis(a, axis, 0) for a, axis in zip(arrays, axes, strict=True) if axis is not None]

    def once(entries: list[Any]) -> Any:
        rest = iter(entries)
        return primitive.bind(
            *(a if axis is None else next(rest) for a, axis in zip(arrays, axes, strict=True)), **parameters
        )

    outputs = jax.lax.map(once, batched)
    return outputs, [0] * len(outputs)


def _batch_of_solution(values: Any, axes: Any, *, run: Any, names: Names, for_gradient: bool) -> Any:
    parameters = {"run": run, "names": names, "for_gradient": for_gradient}
    if not _shared(run, names, axes):
        return _in_turn(SOLUTION, values, axes, **parameters)
    members = _Members(names, values, axes, _size(values, axes))
    outputs = SOLUTION.bind(*members.values, **parameters)
    return [members.split(one, 1) for one in outputs], [1] * len(outputs)


def _batch_of_tangents(arrays: Any, axes: Any, *, run: Any, names: Names, along: Names) -> Any:
    parameters, count, size = {"run": run, "names": names, "along": along}, len(names), _size(arrays, axes)
    values, directions = arrays[:count], list(zip(along, arrays[count:], axes[count:], strict=True))
    if all(axis is None for axis in axes[:count]):
        merged = [_merged(_at(0, one, axis, size), 0) for _, one, axis in directions]
        outputs = TANGENTS.bind(*values, *merged, **parameters)
        return [_split(one, 0, size) for one in outputs], [0] * len(outputs)
    if not (_shared(run, names, axes[:count]) and _shared(run, along, axes[count:])):
        return _in_turn(TANGENTS, arrays, axes, **parameters)
    members = _Members(names, values, axes[:count], size)
    given = [
        members.merged(_at(1, one, axis, size), 1) if name in members.names else one for name, one, axis in directions
    ]
    outputs = TANGENTS.bind(*members.values, *given, **parameters)
    return [members.split(one, 2) for one in outputs], [2] * len(outputs)


def _batch_of_gradients(arrays: Any, axes: Any, *, run: Any, names: Names, by: Names, by_member: bool) -> Any:
    parameters, count, size = {"run": run, "names": names, "by": by}, len(names), _size(arrays, axes)
    values, cotangents = arrays[:count], list(zip(arrays[count:], axes[count:], strict=True))
    if all(axis is None for axis in axes[:count]):
        merged = [_merged(_at(0, one, axis, size), 0) for one, axis in cotangents]
        outputs = GRADIENTS.bind(*values, *merged, by_member=by_member, **parameters)
        return [_split(one, 0, size) for one in outputs], [0] * len(outputs)
    if not _shared(run, names, axes[:count]):
        return _in_turn(GRADIENTS, arrays, axes, by_member=by_member, **parameters)
    members = _Members(names, values, axes[:count], size)
    given = [members.merged(_at(2, one, axis, size), 2) for one, axis in cotangents]
    outputs = GRADIENTS.bind(*members.values, *given, by_member=True, **parameters)
    found = []
    for name, output in zip(by, outputs, strict=True):
        split = members.split(output, 1)
        summed = run.is_parameter(name) and not members.single and not by_member
        found.append(split.sum(axis=2) if summed else split)
    return found, [1] * len(found)


batching.primitive_batchers[SOLUTION] = _batch_of_solution
batching.primitive_batchers[TANGENTS] = _batch_of_tangents
batching.primitive_batchers[GRADIENTS] = _batch_of_gradients
