"""Inputs of a prepared run: which coefficients of the linear term of H a call brings, and what it brought."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import unknown_name
from coadjoint.given import are_finite, read_numbers
from coadjoint.systems.batch import Batch
from coadjoint.systems.forced import ForcedSystem
from coadjoint.systems.kinds import System
from coadjoint.systems.linear_term import check_linear, linear_of, with_linear
from coadjoint.wording import short

Floats = NDArray[np.float64]

# Names that a run has for something else.
TAKEN = frozenset(("x", "x0", "t", "t_span", "save_every", "attitude", "progress", "self"))
SEED = 1993


class Inputs:
    """The inputs that a run was prepared with.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        Its Hamiltonian has a linear term that may be another one.
    given : True, sequence of int, or mapping
        Coordinates whose coefficients may change: all, or these, as the input ``linear``; or name -> coordinates.

    Raises
    ------
    TypeError, ValueError
        The Hamiltonian has no linear term that could change, or what was given is wrong.

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
        if isinstance(system, ForcedSystem):
            raise TypeError(
                f"inputs are for systems without forces, and this is {system.name}; give what changes with the time "
                "as a Torque of the time"
            )
        check_linear(system)
        self.system, self.linear = system, linear_of(system.hamiltonian, system.dim)
        if isinstance(given, bool | np.bool_) and given:
            self.coordinates = {"linear": np.arange(system.dim)}
        elif isinstance(given, Mapping):
            self.coordinates = {_name(name): _coordinates(where, name, system.dim) for name, where in given.items()}
        else:
            self.coordinates = {"linear": _coordinates(given, "linear", system.dim)}
        if not self.coordinates:
            raise ValueError("inputs names none; give True, coordinates, or a mapping from names to coordinates")
        whole = (name for name, where in self.coordinates.items() if np.array_equal(where, np.arange(system.dim)))
        self._all = next(whole, "")
        self.changing = np.concatenate([where.ravel() for where in self.coordinates.values()])
        if len(np.unique(self.changing)) < len(self.changing):
            twice = int(np.flatnonzero(np.bincount(self.changing) > 1)[0])
            raise ValueError(f"inputs name coordinate {twice} more than once; each coefficient is one input")

    def __repr__(self) -> str:
        return ", ".join(f"{name} {where.shape}" for name, where in self.coordinates.items())

    def read(self, given: Mapping[str, Any]) -> Floats:
        """Return the linear term with what was given, (n,), or (members, n) where members have their own.

        Raises
        ------
        ValueError, TypeError
            No such input, or its value has another shape or is not finite.
        """
        if len(given) == 1 and self._all in given:
            # Every coefficient, in the order of the coordinates: nothing is to be put together.
            numbers = read_numbers(given[self._all], self._all)
            if numbers.shape[-1:] == self.linear.shape and numbers.ndim <= 2 and len(numbers) and are_finite(numbers):
                return numbers
        found, members = {}, None
        for name, value in given.items():
            where = self.coordinates.get(name)
            if where is None:
                raise unknown_name("input of this run", name, self.coordinates)
            numbers = read_numbers(value, name)
            if numbers.shape != where.shape:
                several = numbers.shape[1:] == where.shape and numbers.ndim > where.ndim
                if not several or not len(numbers) or members not in (None, len(numbers)):
                    raise self._misshapen(name, numbers.shape, members)
                members = len(numbers)
            if not are_finite(numbers):
                raise ValueError(f"{name} contains NaN or infinity; every coefficient must be finite")
            found[name] = numbers
        linear = self.linear.copy() if members is None else np.tile(self.linear, (members, 1))
        for name, numbers in found.items():
            where = self.coordinates[name]
            linear[..., where.ravel()] = numbers.reshape(*numbers.shape[: numbers.ndim - where.ndim], -1)
        return linear

    def _misshapen(self, name: str, shape: tuple[int, ...], members: int | None) -> ValueError:
        own = self.coordinates[name].shape
        each = ", ".join(map(str, ("members" if members is None else members, *own)))
        return ValueError(
            f"{name} has the shape {shape}; as prepared it must be {own}, or ({each}) with a value for each member"
        )

    def drawn(self) -> tuple[Floats, Floats]:
        """Return two linear terms whose coefficients that may change have random digits, the same ones always."""
        one, other = self.linear.copy(), self.linear.copy()
        digits = 1.0 + np.random.default_rng(SEED).random((2, len(self.changing)))
        one[self.changing], other[self.changing] = digits
        return one, other

    def system_of(self, linear: Floats) -> System | Batch:
        """Return the system of a call, or one for each member."""
        if linear.ndim == 1:
            return with_linear(self.system, linear)
        return Batch([with_linear(self.system, own) for own in linear])


def _name(name: Any) -> str:
    if not isinstance(name, str) or not name.isidentifier():
        raise TypeError(f"inputs has the name {short(name)}; it must be a name that a keyword may have, such as field")
    if name in TAKEN:
        raise ValueError(f"inputs has the name {name!r}, which a run has for something else; choose another one")
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
