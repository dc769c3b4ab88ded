"""Unknown entries of the values of a run, as a function of which a fit compares its outputs with measurements."""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.measured_quantities import Quantities
from coadjoint.errors import unknown_name
from coadjoint.runs.derivatives.parametrized_run import ParametrizedRun
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.start import read_attitude
from coadjoint.short_repr import short
from coadjoint.systems.parameters import parameter_of
from coadjoint.systems.registry import unit_coordinate
from coadjoint.validation import read_integer, read_numbers, to_array

Floats = NDArray[np.float64]

OUTPUTS = ("x", "attitude")


class FitProblem(NamedTuple):
    """A run with unknown entries of its values, as a function of their changes z."""

    system: Any
    run: ParametrizedRun
    values: dict[str, Floats]
    chosen: dict[str, NDArray[np.int64]]
    symmetric: frozenset[str]
    generators: Floats
    unknowns: tuple[tuple[str, int], ...]
    quantities: Quantities | None = None

    def measuring(self, ready: PreparedRun, measured: Mapping[str, Any], observe: Mapping[str, Any]) -> FitProblem:
        """Return the problem with the measured functions of the states among its outputs."""
        known = Quantities.names_of(ready, observe)
        names = [name for name in measured if name in known]
        if not names:
            return self
        quantities = Quantities(ready, names, self.run.saved_times, self.values["x0"], observe)
        return self._replace(quantities=quantities)

    @classmethod
    def of(cls, ready: PreparedRun, x0: Any, attitude: Any, run: ParametrizedRun, unknown: Any) -> FitProblem:
        """Validate the guesses and the names of the unknowns."""
        state, n = read_numbers(x0, "x0"), ready.system.dim
        if state.ndim not in (1, 2) or state.shape[-1] != n or not state.size:
            raise ValueError(f"x0 has the shape {state.shape}; it must be ({n},) or (members, {n})")
        if not isinstance(unknown, Mapping) or not unknown:
            raise TypeError(f"unknown is {short(unknown)}; give a mapping from names to True or numbers of entries")
        values: dict[str, Floats] = {"x0": state, **ready.parameters}
        generators = np.zeros((0, 0, 0))
        if ready.representation is not None:
            initial = ready.initial_attitude if attitude is None else attitude
            side = run.output_shapes(state.shape)[1][-1]
            start = np.eye(side) if isinstance(initial, bool | str) else read_attitude(initial, ready.system)
            shape = (*state.shape[:-1], side, side)
            if start.shape not in (shape, shape[-2:]):
                raise ValueError(f"attitude has the shape {start.shape}; it must be {shape}")
            values["attitude0"] = np.broadcast_to(start, shape).copy()
            if not isinstance(ready.representation, str):
                generators = ready.representation
        chosen: dict[str, NDArray[np.int64]] = {}
        symmetric: set[str] = set()
        fixed = unit_coordinate(ready.system.of_member(0).unforced)
        for name, entries in unknown.items():
            if name not in values:
                raise unknown_name("unknown of this run", name, values)
            if name == "attitude0" and not len(generators):
                raise TypeError("attitude0 cannot be fitted in this representation; give matrices of the basis")
            members = state.size // n
            count = members * len(generators) if name == "attitude0" else values[name].size
            what = f"a number of an unknown entry of {name}"
            given = np.arange(count) if entries is True else to_array(entries, f"unknown of {name}")
            if given.size > count:
                raise ValueError(f"unknown gives {given.size} numbers of entries of {name}, which has {count}")
            numbers = given.ravel().tolist()
            chosen[name] = np.array([read_integer(k, what, 0, count - 1) for k in numbers], dtype=np.int64)
            if name == "x0" and fixed is not None:
                if entries is not True and np.any(chosen[name] % n == fixed):
                    raise ValueError(f"x0[{fixed}] of {ready.system.name} must be 1, and is not unknown; omit {fixed}")
                chosen[name] = chosen[name][chosen[name] % n != fixed]
            if name in ready.parameters and parameter_of(ready.system, name).symmetric:
                symmetric.add(name)
                chosen[name] = np.unique(np.minimum(chosen[name], _mirror(chosen[name], len(values[name]))))
        unknowns = tuple((name, int(k)) for name, numbers in chosen.items() for k in numbers)
        return cls(ready.system, run, values, chosen, frozenset(symmetric), generators, unknowns)

    def moved(self, z: Floats) -> dict[str, Floats]:
        """Return all values after the changes z of the unknowns."""
        from scipy.linalg import expm

        values, first = dict(self.values), 0
        for name, numbers in self.chosen.items():
            change = z[first : first + len(numbers)]
            first += len(numbers)
            if name == "attitude0":
                rotations = expm(self._exponents(numbers, change)).reshape(values[name].shape)
                values[name] = rotations @ values[name] if change.any() else values[name]
            else:
                values[name] = self._moved_entries(name, change, values[name].copy())
        return values

    def split(self, z: Floats, names: Container[str]) -> tuple[dict[str, Floats], Floats]:
        """Return changes z of the unknowns as directions of the values of these names, and the other changes."""
        moved, rest, first = {}, np.zeros(0), 0
        for name, numbers in self.chosen.items():
            change = z[first : first + len(numbers)]
            first += len(numbers)
            if name in names:
                moved[name] = self._moved_entries(name, change, np.zeros(self.values[name].shape))
            else:
                rest = np.concatenate([rest, change])
        return moved, rest

    def _moved_entries(self, name: str, change: Floats, value: Floats) -> Floats:
        """Add changes of unknown entries in place, and of mirror images in a symmetric matrix; return the array."""
        numbers, entries = self.chosen[name], value.ravel()
        entries[numbers] += change
        if name in self.symmetric:
            entries[_mirror(numbers, len(value))] = entries[numbers]
        return value

    def entry(self, name: str, number: int) -> str:
        """Describe an unknown entry by its indices in the array of this name, and by its number."""
        value = self.values[name]
        if name == "attitude0" or value.ndim < 2:
            return f"{name}[{number}]"
        index = ", ".join(str(k) for k in np.unravel_index(number, value.shape))
        return f"{name}[{index}] (number {number})"

    def _exponents(self, numbers: NDArray[np.int64], change: Floats) -> Floats:
        """Return the elements of the algebra (members, d, d) by which initial attitudes change."""
        coordinates = np.zeros((self.values["x0"].size // self.values["x0"].shape[-1], len(self.generators)))
        coordinates.ravel()[numbers] = change
        return np.tensordot(coordinates, self.generators, 1)

    def outputs(self, z: Floats | None = None) -> dict[str, Floats]:
        """Return states, attitudes and measured quantities at the saved times."""
        values = self.values if z is None else self.moved(z)
        found = dict(zip(OUTPUTS, self.run.solve(values, False), strict=False))
        return found if self.quantities is None else found | self.quantities.values(found["x"], values)

    def tangents(self, z: Floats) -> dict[str, Floats]:
        """Return their derivatives by z, with a first axis of unknowns."""
        from scipy.linalg import expm_frechet

        moved, directions, first = self.moved(z), {}, 0
        for name, numbers in self.chosen.items():
            direction = np.zeros((len(z), *moved[name].shape))
            if name == "attitude0":
                exponents = self._exponents(numbers, z[first : first + len(numbers)])
                starts, by_member = self.values[name].reshape(exponents.shape), direction.reshape(-1, *exponents.shape)
                for k, (m, j) in enumerate(zip(*divmod(numbers, len(self.generators)), strict=True)):
                    change = expm_frechet(exponents[m], self.generators[j], compute_expm=False)
                    by_member[first + k, m] = change @ starts[m]
            else:
                for k, unit in enumerate(np.eye(len(numbers)), first):
                    self._moved_entries(name, unit, direction[k, ...])
            first += len(numbers)
            directions[name] = direction
        found = dict(zip(OUTPUTS, self.run.tangents(moved, directions), strict=False))
        if self.quantities is None:
            return found
        x = self.run.solve(moved, False)[0]
        return found | self.quantities.tangents(x, found["x"], moved, directions)


def _mirror(numbers: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """Return the numbers of the mirror images of entries of a square matrix."""
    i, j = np.divmod(numbers, size)
    return j * size + i
