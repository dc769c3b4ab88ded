"""JAX as a library of arrays: its operations, random numbers of the compiled runs, and functions with parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.scipy.linalg import expm
from jax.scipy.special import ndtri

from coadjoint.jax.primitives import doubles
from coadjoint.jax.stage_steps import fixed_point
from coadjoint.jax.table_steps import product
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.parametrized_functions import ArrayLibrary, ParametrizedEnergy, ParametrizedFeatures
from coadjoint.systems.hamiltonians.user_hamiltonian import X64
from coadjoint.systems.learned_forces import ParametrizedRoot, ParametrizedTorque
from coadjoint.validation import is_of_torch, is_real


class JaxLibrary(ArrayLibrary):
    """JAX; numbers that are known remain those of NumPy, which JAX takes in double precision when it traces."""

    library, module, xp, float64_hint = "JAX", jax.tree_util, jnp, X64
    vjp, jvp = staticmethod(jax.vjp), staticmethod(jax.jvp)
    expm, product = staticmethod(expm), staticmethod(product)

    def array(self, name: str, value: Any, owner: str) -> Any:
        if is_of_torch(value) or not (is_real(value) or hasattr(value, "dtype")):
            raise TypeError(
                f"{name} of {owner} is {short(value)}; parameters are arrays of JAX or NumPy, in lists, "
                "dictionaries and the like: keep functions in the function itself, and convert tensors of PyTorch"
            )
        return doubles({name: value})[name]

    def numbers(self, value: Any) -> Any:
        return value if isinstance(value, jax.Array) else np.asarray(value, dtype=np.float64)

    def result(self, value: Any) -> Any:
        return jnp.asarray(value)

    def set_at(self, x: Any, places: Any, values: Any) -> Any:
        return x.at[places].set(values)

    def add_at(self, x: Any, places: Any, values: Any) -> Any:
        return x.at[places].add(values)

    def iterate(self, body: Callable[..., Any], carry: Any, rows: Sequence[Any]) -> Any:
        return lax.scan(lambda carry, row: (body(carry, *row), None), carry, tuple(map(jnp.asarray, rows)))[0]

    def fixed_point(self, prepare: Callable[..., Any], first: Any, *arguments: Any) -> Any:
        return fixed_point(prepare(*arguments), first, jnp.abs(first))

    def normal_deviates(self, seed: int, stream: Any, moments: Any, part: int, count: int) -> Any:
        drawn = partial(_deviates, seed, stream, part=part, count=count)
        return jax.vmap(lambda moment: drawn(moment))(moments) if jnp.ndim(moments) else drawn(moments)

    def type_of(self, function: Callable[..., Any], params: Any, n: int) -> tuple[tuple[int, ...], str]:
        found = jax.eval_shape(function, params, np.zeros(n), 0.0)
        return tuple(found.shape), str(found.dtype)

    def may_hide(self, function: Callable[..., Any], params: Any, n: int) -> bool:
        operations = str(jax.make_jaxpr(function)(params, np.zeros(n), 0.0))
        return any(name in operations for name in ("stop_gradient", "custom_vjp"))

    def in_numpy(self, function: Callable[..., Any]) -> Callable[..., Any]:
        compiled = jax.jit(function)
        return lambda *arguments: np.asarray(compiled(*arguments))


LIBRARY = JaxLibrary()


class JaxEnergy(ParametrizedEnergy):
    """An energy of JAX."""

    caller, trees = "co.jax.energy", LIBRARY
    of_jax = True


class FeatureEnergy(ParametrizedFeatures):
    """An energy of features of JAX."""

    caller, trees = "co.jax.features", LIBRARY
    of_jax = True
    vmap, grad = staticmethod(jax.vmap), staticmethod(jax.grad)


class TorqueFunction(ParametrizedTorque):
    """A torque of JAX."""

    caller, trees = "co.jax.torque", LIBRARY


class RootFunction(ParametrizedRoot):
    """A root of a metric of JAX."""

    caller, trees = "co.jax.double_bracket", LIBRARY


def _deviates(seed: Any, stream: Any, moment: Any, part: int, count: int) -> Any:
    time = lax.bitcast_convert_type(jnp.asarray(moment, jnp.float64) + 0.0, jnp.uint64)
    blocks = jnp.arange(-(-count // 4), dtype=jnp.uint64)
    words = jax.vmap(partial(_philox, key=seed), (0, None, None, None))(
        blocks, time, jnp.asarray(stream, jnp.uint64), jnp.uint64(part)
    )
    words = words.ravel()[:count]
    size = -ndtri((jnp.asarray(words >> jnp.uint64(12), jnp.float64) + 0.5) * 2.0**-53)
    return jnp.where(words & jnp.uint64(1), -size, size)


def _philox(*counter: Any, key: Any) -> Any:
    """Return four random words by Philox4x64-10; see `forces/random.hpp`."""
    a, b, c, d = counter
    first, second = (jnp.uint64(word) for word in (0xD2E7470EE14C6C93, 0xCA5A826395121157))
    for k in range(10):
        one = jnp.uint64((key + k * 0x9E3779B97F4A7C15) % 2**64)
        two = jnp.uint64(k * 0xBB67AE8584CAA73B % 2**64)
        a, b, c, d = _high(second, c) ^ b ^ one, second * c, _high(first, a) ^ d ^ two, first * a
    return jnp.stack([a, b, c, d])


def _high(a: Any, b: Any) -> Any:
    low, half = jnp.uint64(2**32 - 1), jnp.uint64(32)
    a0, a1, b0, b1 = a & low, a >> half, b & low, b >> half
    middle = a1 * b0 + (a0 * b0 >> half)
    return a1 * b1 + (middle >> half) + (a0 * b1 + (middle & low) >> half)
