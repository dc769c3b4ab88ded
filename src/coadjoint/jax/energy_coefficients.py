"""Coefficients of the energy at values of parameters or inputs, as functions of JAX with two derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.inputs import Inputs
from coadjoint.systems.coefficients import coefficients_of
from coadjoint.systems.parameter_differences import differences, moved_entry, nearby_systems
from coadjoint.systems.parameters import force_numbers, parameters_at, parameters_of, with_parameters

# Changes of coefficients of the energy below this multiple of their rounding are zero.
ZERO_CHANGE = 256 * UNIT_ROUNDOFF


class CoefficientsAtParameters:
    """The coefficients of the energy of a system, or of the energies of a batch, in the table of a splitting."""

    # `caller` is the public function, in messages.

    def __init__(self, system: Any, table: Mapping[str, Any], inputs: Inputs | None, caller: str) -> None:
        self._system, self._table, self._inputs = system, table, inputs
        self._linear: Mapping[int, int] = {} if inputs is None else self._number_linear_terms(inputs, caller)

    def _number_linear_terms(self, inputs: Inputs, caller: str) -> Mapping[int, int]:
        """Return the number of the monomial of each coordinate that is an input."""
        if len(inputs.in_energy) < len(inputs.changing):
            raise TypeError(f"{caller} has inputs of the energy only, not torques; write them as a function of time")
        number = {tuple(key): k for k, key in enumerate(self._table["energy"]["monomials"])}
        found = {k: number[k,] for k in inputs.in_energy.tolist()}
        if set(found.values()) & {*self._table["fixed"]}:
            raise TypeError(
                f"inputs of {self._system.name} change the parts of the splitting, and not only numbers of its table; "
                f'take parts="coordinates" with {caller}'
            )
        return found

    def __call__(self, values: Mapping[str, Any]) -> Any:
        known, energy = self._table["parameters"], self._table["energy"]["coefficients"]
        if self._inputs is not None:
            return self._of_inputs(energy, values)
        if values and self._system.is_batch:
            raise ValueError(
                f'{next(iter(values))} has the values of the members of the batch with backend="xla"; take '
                'backend="compiled"'
            )
        for name in values:
            if self._system.forces and name in force_numbers(self._system):
                raise ValueError(
                    f'{name} is a parameter of a force, which has the numbers of the prepared run with backend="xla"; '
                    'take backend="compiled"'
                )
            self._check_places(name)
        if not values:
            return energy
        if not all(known[name]["linear"] for name in values):
            return self._on_host(values)
        for name, value in values.items():
            one = known[name]
            change = one["derivative"] * (value.ravel() - one["value"])[one["entry"]]
            energy = jnp.asarray(energy).at[one["monomial"]].add(change)
        return energy

    def _of_inputs(self, energy: Any, values: Mapping[str, Any]) -> Any:
        """Return the coefficients at values of inputs, others as prepared."""
        inputs: Any = self._inputs
        energy = jnp.asarray(energy)
        for k, number in self._linear.items():
            energy = energy.at[number].set(inputs.values[k])
        for name, value in values.items():
            if name not in inputs.indices:
                raise ValueError(
                    f'{name} has the value of the prepared run with inputs and backend="xla"; prepare without inputs='
                )
            numbers = [self._linear[k] for k in inputs.indices[name].ravel().tolist()]
            energy = energy.at[np.array(numbers)].set(value.ravel())
        return energy

    def _check_places(self, name: str) -> None:
        one = self._table["parameters"].get(name)
        if one is None or np.any(np.isin(one["monomial"], self._table["fixed"]) & (one["derivative"] != 0.0)):
            raise ValueError(
                f"{name} of {self._system.name} changes the parts of the splitting, and not only numbers of its table; "
                'take parts="coordinates", no zeros in place of coefficients that change, or backend="compiled"'
            )

    def _on_host(self, values: Mapping[str, Any]) -> Any:
        """Return the coefficients of a ready-made system, whose function is called, and differentiated, on the host."""
        names, system = tuple(values), self._system.unforced
        keys = [tuple(key) for key in self._table["energy"]["monomials"]]
        number = {key: k for k, key in enumerate(keys)}
        count = sum(array.size for array in values.values())

        def coefficients(at: Mapping[str, Any]) -> Any:
            found = coefficients_of(with_parameters(system, at)).by_key()
            found.pop((), None)
            energy = np.array([found.pop(key, 0.0) for key in keys])
            self._check_forms(energy, found)
            return energy

        def slopes(at: Mapping[str, Any]) -> Any:
            found, start = np.zeros((len(keys), count)), 0
            for parameter in parameters_at(system, at).values():
                for one in parameter.energy().as_monomials:
                    if one.coordinates:
                        found[number[one.coordinates], start + one.entry] += one.factor
                start += parameter.value.size
            return found

        def curvatures(at: Mapping[str, Any]) -> Any:
            """Return the differences of the derivatives, with about twelve digits."""
            symmetric = {name: parameters_of(system)[name].symmetric for name in names}

            def moved_slopes(name: str, index: tuple[int, ...], by: float) -> Any:
                return slopes({**at, name: moved_entry(at[name], index, by, symmetric[name])})

            nearby = [one for name in names for one in nearby_systems(name, at[name], partial(moved_slopes, name))]
            return np.stack(differences(nearby, np.asarray), axis=-1)

        return _differentiable(names, (coefficients, slopes, curvatures), (len(keys),), count)(*values.values())

    def _check_forms(self, energy: Any, others: Mapping[Any, float]) -> None:
        """Raise ValueError if coefficients change on which the parts depend."""
        fixed = self._table["fixed"]
        changes = energy[fixed] - self._table["energy"]["coefficients"][fixed]
        largest = np.max(np.abs(energy), initial=0.0)
        if np.max(np.abs([*changes, *others.values()]), initial=0.0) > ZERO_CHANGE * largest:
            raise ValueError(
                f"these parameters of {self._system.name} change the parts of the splitting, and not only numbers of "
                'its table; take parts="coordinates", or backend="compiled"'
            )


def _differentiable(
    names: tuple[str, ...],
    functions: tuple[Callable[..., Any], ...],
    shape: tuple[int, ...],
    count: int,
) -> Callable[..., Any]:
    """Return a function on the host of named arrays with `count` entries, with its derivatives, as one of JAX."""
    function, *derivatives = functions

    def on_host(*arrays: Any) -> Any:
        return function({name: np.array(array) for name, array in zip(names, arrays, strict=True)})

    @jax.custom_jvp
    def value(*arrays: Any) -> Any:
        result = jax.ShapeDtypeStruct(shape, np.float64)
        return jax.pure_callback(on_host, result, *arrays, vmap_method="sequential")

    @value.defjvp
    def value_jvp(arrays: Any, tangents: Any) -> Any:
        if not derivatives:
            raise NotImplementedError("parameters of ready-made systems have first and second derivatives only")
        along = jnp.concatenate([tangent.ravel() for tangent in tangents])
        return value(*arrays), _differentiable(names, tuple(derivatives), (*shape, count), count)(*arrays) @ along

    return value
