"""Energies with parameters of JAX, and what their forces share with them."""

from __future__ import annotations

from typing import Any

import jax

from coadjoint.jax.primitives import doubles
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.parametrized_functions import ParametrizedEnergy, ParametrizedFeatures, Trees
from coadjoint.validation import is_of_torch, is_real


class JaxTrees(Trees):
    """Parameters as pytrees of JAX."""

    library, module = "JAX", jax.tree_util

    def array(self, name: str, value: Any, owner: str) -> Any:
        if is_of_torch(value) or not (is_real(value) or hasattr(value, "dtype")):
            raise TypeError(
                f"{name} of {owner} is {short(value)}; parameters are arrays of JAX or NumPy, in lists, "
                "dictionaries and the like: keep functions in the function itself, and convert tensors of PyTorch"
            )
        return doubles({name: value})[name]


TREES = JaxTrees()


class JaxEnergy(ParametrizedEnergy):
    """An energy of JAX."""

    caller, trees = "co.jax.energy", TREES
    of_jax = True


class FeatureEnergy(ParametrizedFeatures):
    """An energy of features of JAX."""

    caller, trees = "co.jax.features", TREES
    of_jax = True
    vmap, grad = staticmethod(jax.vmap), staticmethod(jax.grad)
