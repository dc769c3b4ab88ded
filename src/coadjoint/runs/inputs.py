"""Inputs of a prepared run: coefficients of the linear term of H, and torques, that each call sets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import unknown_name
from coadjoint.methods.protocol.method import Method
from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch
from coadjoint.systems.forced import ForcedSystem
from coadjoint.systems.forces.torque import Torque
from coadjoint.systems.hamiltonians.linear_term import check_linear, linear_of, with_linear
from coadjoint.systems.system_checks import System
from coadjoint.validation import are_finite, read_numbers

Floats = NDArray[np.float64]

# Reserved: parameters of a run.
RESERVED_NAMES = frozenset(("x", "x0", "t", "t_span", "save_every", "attitude", "progress", "self"))
SEED = 1993


class Inputs:
    """The inputs of a prepared run: coefficients of the linear term of H, or constant torques.

    `given` is True (all coefficients, as the input ``linear``), a sequence of coordinates, or a mapping from names to
    coordinates or to the label of a constant torque. `values` (m,) holds the defaults from the system, the linear term
    first, then the torques; `indices` maps each name to its indices in `values`.

    Examples
    --------
    >>> import coadjoint as co
    >>> inputs = Inputs(co.systems.rigid_body((1, 2, 3)), {"rotors": (0, 2)})
    >>> inputs.read({"rotors": (0.5, 0.25)})
    array([0.5 , 0.  , 0.25])
    """

    def __init__(self, system: System | ForcedSystem | Batch, given: Any) -> None:
        if isinstance(system, Batch):
            raise TypeError(
                f"inputs are for one system, and this is {system!r}; prepare one system, whose inputs may have a value "
                "for each member"
            )
        self.system = system
        self._unforced: Any = system.system if isinstance(system, ForcedSystem) else system
        if isinstance(given, bool | np.bool_) and given:
            given = range(system.dim)
        if isinstance(given, str):
            raise TypeError(f"inputs is {short(given)}; give each torque a name, such as {{'torque': 'Torque'}}")
        named = given if isinstance(given, Mapping) else {"linear": given}
        if not named:
            raise ValueError("inputs is empty; give True, coordinates, or a mapping from names to coordinates")
        self._linear = np.zeros(0)
        if not all(isinstance(where, str) for where in named.values()):
            check_linear(self._unforced)
            self._linear = linear_of(self._unforced.hamiltonian, system.dim)
        self.values = self._linear
        self._torques: dict[int, NDArray[np.int64]] = {}
        self.indices: dict[str, NDArray[np.int64]] = {}
        for name, where in named.items():
            self.indices[_name(name)] = (
                self._torque_indices(where, name) if isinstance(where, str) else _coordinates(where, name, system.dim)
            )
        every = np.arange(len(self.values))
        self._full_input = next((name for name, where in self.indices.items() if np.array_equal(where, every)), None)
        self._input_indices = np.concatenate([where.ravel() for where in self.indices.values()])
        if len(np.unique(self._input_indices)) < len(self._input_indices):
            twice = int(np.flatnonzero(np.bincount(self._input_indices) > 1)[0])
            raise ValueError(f"inputs name coordinate {twice} more than once; each coefficient is one input")

    def _torque_indices(self, label: str, name: str) -> NDArray[np.int64]:
        """Append the torque of this label to the values, and return its indices."""
        if not isinstance(self.system, ForcedSystem):
            raise ValueError(
                f"inputs has {short(label)} for {name}, and {self.system.name} has no forces; give coordinates, or a "
                "system with_forces(co.forces.Torque(...))"
            )
        labels = self.system.labels
        if label not in labels:
            raise unknown_name("force", label, labels)
        k = labels.index(label)
        force = self.system.forces[k]
        if not isinstance(force, Torque) or callable(force.torque):
            raise TypeError(
                f"inputs has {short(label)} for {name}, which is {short(str(force))}; of the forces only a constant "
                "Torque may be an input"
            )
        if np.ndim(force.torque) > 1:
            raise TypeError(f"inputs has {short(label)} for {name}, which is a matrix; only a vector may be an input")
        if k in self._torques:
            raise ValueError(f"inputs name {short(label)} more than once; each torque is one input")
        indices = self._torques[k] = len(self.values) + np.arange(self.system.dim)
        self.values = np.concatenate([self.values, force.torque])
        return indices

    def __repr__(self) -> str:
        return ", ".join(f"{name} {where.shape}" for name, where in self.indices.items())

    def read(self, given: Mapping[str, Any]) -> Floats:
        """Return the values, (m,), or (members, m) if members have individual ones, with the given inputs inserted."""
        if self._full_input is not None and list(given) == [self._full_input]:
            # All coefficients in coordinate order are the array itself.
            numbers = read_numbers(given[self._full_input], self._full_input)
            if numbers.shape[-1:] == self.values.shape and numbers.ndim <= 2 and len(numbers) and are_finite(numbers):
                return numbers
        found, members = {}, None
        for name, value in given.items():
            where = self.indices.get(name)
            if where is None:
                raise unknown_name("input of this run", name, self.indices)
            numbers = read_numbers(value, name)
            if numbers.shape != where.shape:
                several = numbers.shape[1:] == where.shape and numbers.ndim > where.ndim
                if not several or not len(numbers) or members not in (None, len(numbers)):
                    raise self._shape_error(name, numbers.shape, members)
                members = len(numbers)
            if not are_finite(numbers):
                raise ValueError(f"{name} contains NaN or infinity; every number must be finite")
            found[name] = numbers
        values = self.values.copy() if members is None else np.tile(self.values, (members, 1))
        for name, numbers in found.items():
            where = self.indices[name]
            values[..., where.ravel()] = numbers.reshape(*numbers.shape[: numbers.ndim - where.ndim], -1)
        return values

    def _shape_error(self, name: str, shape: tuple[int, ...], members: int | None) -> ValueError:
        own = self.indices[name].shape
        each = ", ".join(map(str, ("members" if members is None else members, *own)))
        return ValueError(
            f"{name} has the shape {shape}; as prepared it must be {own}, or ({each}) with a value for each member"
        )

    def random_values(self) -> tuple[Floats, Floats]:
        """Return two arrays of values in which the inputs have reproducible random digits."""
        one, other = self.values.copy(), self.values.copy()
        digits = 1.0 + np.random.default_rng(SEED).random((2, len(self._input_indices)))
        one[self._input_indices], other[self._input_indices] = digits
        return one, other

    def settled(self, method: Method) -> Method:
        """Return the scheme with its automatic choices made explicit, valid for any linear term."""
        coordinates = np.sort(self._input_indices[self._input_indices < len(self._linear)])
        return method.settled(self._unforced, coordinates.tolist()) if len(coordinates) else method

    def system_at(self, values: Floats) -> Any:
        """Return the system with these values, (m,)."""
        size = len(self._linear)
        system = with_linear(self._unforced, values[:size]) if size else self._unforced
        if not isinstance(self.system, ForcedSystem):
            return system
        forces: list[Any] = list(self.system.forces)
        for k, indices in self._torques.items():
            forces[k] = replace(forces[k], torque=values[indices])
        return ForcedSystem(system, forces)

    def system_of(self, values: Floats) -> Any:
        """Return the system of a call, or a batch with one system for each member."""
        if values.ndim == 1:
            return self.system_at(values)
        return Batch([self.system_at(own) for own in values])


def _name(name: Any) -> str:
    if not isinstance(name, str) or not name.isidentifier():
        raise TypeError(f"inputs has the name {short(name)}; it must be a valid Python identifier, such as field")
    if name in RESERVED_NAMES:
        raise ValueError(f"inputs has the name {name!r}, which is reserved; choose another one")
    return name


def _coordinates(given: Any, name: str, n: int) -> NDArray[np.int64]:
    numbers = read_numbers(given, f"the coordinates of {name}") if not isinstance(given, bool) else None
    if numbers is None or not numbers.size or numbers.ndim == 0 or np.any(numbers != np.floor(numbers)):
        raise TypeError(
            f"inputs has {short(given)} for {name}; give coordinates, whole numbers from 0 to {n - 1}, or True"
        )
    if np.any((numbers < 0) | (numbers >= n)):
        raise ValueError(f"inputs has {short(given)} for {name}; coordinates run from 0 to {n - 1}")
    return numbers.astype(np.int64)
