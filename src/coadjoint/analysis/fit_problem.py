"""Unknown entries of the values of a run, and measured functions of its states, which a fit compares with data."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra import catalogue
from coadjoint.errors import IntegrationError, unknown_name
from coadjoint.runs.derivatives.parametrized_run import ParametrizedRun
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.quantities import observed_quantities
from coadjoint.runs.start import is_attitude_kind, read_attitude
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import CoordinateGroups, states_by_label
from coadjoint.systems.parameters import parameter_of, parameters_of, with_parameters
from coadjoint.systems.registry import unit_coordinate
from coadjoint.systems.user_functions import with_time
from coadjoint.validation import read_integer, read_numbers, to_array

Floats = NDArray[np.float64]

OUTPUTS = ("x", "attitude")
# Measured values by the names of functions of bodies.
MOTIONS = {
    "angular_velocity": "angular_velocity",
    "angular_momentum": "angular_momentum",
    "attitude": "attitudes",
    "positions": "positions",
    "velocities": "velocities",
}
DISTANCE = 2.0**-17  # relative step of central differences, whose errors h^2 and u/h are both near 1e-11

FIRST_STEP = 1000.0  # in standard deviations: the first step is not limited by their scale
SMALLEST = 2.0**-10  # size of an entry of a parameter for these differences, at least, relative to the largest entry


class Quantities:
    """Functions of the states by name, with derivatives: exact tangents of states, and differences of the functions."""

    def __init__(
        self, ready: PreparedRun, names: Iterable[str], t: Floats, x0: Floats, observe: Mapping[str, Any]
    ) -> None:
        self._system, self._t, wanted = ready.system, t, [*names]
        observed = {name: ready.observe[name] for name in wanted if name in ready.observe}
        state = np.atleast_2d(x0)[0]
        self._observed = observed_quantities(ready.system.of_member(0), observed, state) if observed else None
        self._functions = {
            name: with_time(observe[name], f"observe[{short(name)}]") for name in wanted if name in observe
        }
        self._shapes = {name: np.shape(_value(f, name, state, float(t[0]))) for name, f in self._functions.items()}
        self._motions = [name for name in wanted if name not in observed and name not in observe]
        self._groups = CoordinateGroups(ready.system.of_member(0))

    @staticmethod
    def names_of(ready: PreparedRun, observe: Mapping[str, Any]) -> tuple[str, ...]:
        names = [*ready.observe, *observe]
        if not ready.system.is_batch:
            names += [name for name in MOTIONS if name not in names and _has(ready, name)]
        return tuple(names)

    def values(self, x: Floats, parameters: Mapping[str, Floats]) -> dict[str, Floats]:
        """Return the values at states (points, n) or (points, members, n), by name."""
        found: dict[str, Floats] = {}
        if self._observed is not None:
            along = self._observed.along(self._t, np.ascontiguousarray(x.reshape(len(x), -1, x.shape[-1])))
            found = {name: value.reshape(x.shape[:-1]) for name, value in along.items()}
        for name, function in self._functions.items():
            rows = zip(self._t.tolist(), x.reshape(len(x), -1, x.shape[-1]), strict=True)
            series = [[_value(function, name, row, t) for row in states] for t, states in rows]
            try:
                found[name] = np.array(series).reshape(*x.shape[:-1], *self._shapes[name])
            except ValueError:
                raise ValueError(f"observe[{short(name)}] returns arrays of several shapes; return one shape") from None
        if self._motions:
            changed = {name: value for name, value in parameters.items() if name in parameters_of(self._system)}
            system = (with_parameters(self._system, changed) if changed else self._system).unforced
            found |= {name: _reader(system, name)(x) for name in self._motions}
        return found

    def tangents(self, x: Floats, tangents: Floats, parameters: Mapping[str, Floats], directions: Any) -> Any:
        """Return the derivatives, with a first axis of unknowns, from those of the states and of the parameters."""
        sizes, speeds = self._groups.norms(x), self._groups.norms(tangents)
        with np.errstate(divide="ignore", invalid="ignore"):
            lengths = np.where((speeds > 0.0) & (sizes > 0.0), sizes / speeds, np.inf).min(axis=-1)
        lengths = DISTANCE * np.where(np.isfinite(lengths), lengths, 1.0)
        found: dict[str, list[Floats]] = {}
        for k, (tangent, length) in enumerate(zip(tangents, lengths, strict=True)):
            move = length[..., None] * tangent
            ahead, behind = (self.values(x + side * move, parameters) for side in (1.0, -1.0))
            of_parameters = self._by_parameters(x, parameters, {name: one[k] for name, one in directions.items()})
            for name, value in ahead.items():
                span = 2.0 * length.reshape(*length.shape, *(1,) * (value.ndim - length.ndim))
                found.setdefault(name, []).append((value - behind[name]) / span + of_parameters.get(name, 0.0))
        return {name: np.array(rows) for name, rows in found.items()}

    def _by_parameters(
        self, x: Floats, parameters: Mapping[str, Floats], direction: Mapping[str, Floats]
    ) -> dict[str, Floats]:
        """Return the derivatives of motions at given states along a direction of parameters."""
        moving = {name: one for name, one in direction.items() if name in parameters_of(self._system) and one.any()}
        if not self._motions or not moving:
            return {}
        length = DISTANCE * min(_relative_size(parameters[name], one) for name, one in moving.items())
        changed = (
            {name: parameters[name] + side * length * one for name, one in moving.items()} for side in (1.0, -1.0)
        )
        ahead, behind = (self.values(x, {**parameters, **values}) for values in changed)
        return {name: (ahead[name] - behind[name]) / (2.0 * length) for name in self._motions}


def _relative_size(value: Floats, direction: Floats) -> float:
    """Return the smallest size of the entries of a parameter that a direction moves, in units of their motions."""
    # Products of inertia beside principal moments have the size of the diagonal; small entries a part of the largest.
    sizes = np.abs(value)
    if value.ndim == 2 and len(value) == value.shape[1] and np.diagonal(sizes).all():
        sizes = np.sqrt(np.multiply.outer(np.diagonal(sizes), np.diagonal(sizes)))
    moved = direction != 0.0
    sizes = np.maximum(sizes, SMALLEST * sizes.max())
    return float((sizes[moved] / np.abs(direction[moved])).min()) or 1.0


def _has(ready: PreparedRun, name: str) -> bool:
    """Return whether a function of the states of a body has this name; of attitudes, if they are part of the states."""
    system = ready.system.unforced
    if name == "attitude" and not (system.has_attitude and ready.representation is None):
        return False
    return getattr(system.unforced, MOTIONS[name], None) is not None


def _reader(system: Any, name: str) -> Callable[[Any], Floats]:
    found = getattr(system.unforced, MOTIONS[name], None)
    assert found is not None
    return found


def _value(function: Callable[[Floats, float], Any], name: str, x: Floats, t: float) -> Floats:
    return read_numbers(function(x.copy(), t), f"what observe[{short(name)}] returns at t = {t:g}")


class FitProblem(NamedTuple):
    """A run with unknown entries of its values as a function of their changes z, and the measured values by name."""

    system: Any
    run: ParametrizedRun
    values: dict[str, Floats]
    chosen: dict[str, NDArray[np.int64]]
    symmetric: frozenset[str]
    generators: Floats
    unknowns: tuple[tuple[str, int], ...]
    quantities: Quantities | None = None
    targets: Mapping[str, Floats] = MappingProxyType({})
    # Factors of the residuals, or matrices (..., n, d, d) of coordinates of the errors of attitudes.
    weights: Mapping[str, Floats] = MappingProxyType({})

    def measuring(self, ready: PreparedRun, measured: Mapping[str, Any], observe: Mapping[str, Any]) -> FitProblem:
        known = Quantities.names_of(ready, observe)
        names = [name for name in measured if name in known]
        if not names:
            return self
        quantities = Quantities(ready, names, self.run.saved_times, self.values["x0"], observe)
        return self._replace(quantities=quantities)

    @classmethod
    def of(cls, ready: PreparedRun, x0: Any, attitude: Any, run: ParametrizedRun, unknown: Any) -> FitProblem:
        """Validate the guesses and the names of the unknowns."""
        state, n = read_numbers(states_by_label(ready.system, x0, "x0"), "x0"), ready.system.dim
        if state.ndim not in (1, 2) or state.shape[-1] != n or not state.size:
            raise ValueError(f"x0 has the shape {state.shape}; it must be ({n},) or (members, {n})")
        if not isinstance(unknown, Mapping) or not unknown:
            raise TypeError(f"unknown is {short(unknown)}; give a mapping from names to True or numbers of entries")
        values: dict[str, Floats] = {"x0": state, **ready.parameters}
        generators = np.zeros((0, 0, 0))
        if ready.representation is not None:
            initial = ready.initial_attitude if attitude is None else attitude
            side = run.output_shapes(state.shape)[1][-1]
            start = np.eye(side) if is_attitude_kind(initial) else read_attitude(initial, ready.system)
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
                raise unknown_name("parameter, state or attitude of this run", name, values)
            if name == "attitude0" and not len(generators):
                raise TypeError("attitude0 cannot be fitted in this representation; give matrices of the basis")
            members = state.size // n
            count = members * len(generators) if name == "attitude0" else values[name].size
            what = f"a number of an unknown entry of {name}"
            try:
                given = np.arange(count) if entries is True else to_array(entries, f"unknown of {name}")
            except TypeError:
                raise TypeError(
                    f"unknown of {name} is {short(entries)}; give True for all entries, or the numbers of some, as in "
                    "(0, 2), and leave out what is known"
                ) from None
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
        values = self.values if z is None else self.moved(z)
        found = dict(zip(OUTPUTS, self.run.solve(values, False), strict=False))
        return found if self.quantities is None else found | self.quantities.values(found["x"], values)

    def tangents(self, z: Floats) -> dict[str, Floats]:
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

    @property
    def numbers(self) -> int:
        return sum(self._weighted(name, np.zeros(target.shape)).size for name, target in self.targets.items())

    @property
    def degrees_of_freedom(self) -> int:
        """The measured numbers, of each group element as many as the group has dimensions, less the unknowns."""
        measured = 0
        for name, target in self.targets.items():
            d = target.shape[-1] if name == "attitude" else 1
            known = self.generators if d == self.generators.shape[-1] else np.zeros((0, 0, 0))
            each = int(np.linalg.matrix_rank(known.reshape(len(known), -1))) if len(known) else d
            measured += target.size // d**2 * each
        return measured - len(self.unknowns)

    def _weighted(self, name: str, differences: Floats) -> Floats:
        """Return differences of a measured value, or their derivatives with a first axis, as residuals."""
        weights = self.weights[name]
        if weights.ndim == self.targets[name].ndim:
            return np.asarray(weights * differences)
        return np.einsum("...akj,...kj->...a", weights, differences)

    def residuals_of(self, outputs: Mapping[str, Floats]) -> Floats:
        parts = [self._weighted(name, outputs[name] - target).ravel() for name, target in self.targets.items()]
        return np.concatenate(parts)

    def near_attitudes(self, first: Floats, **options: Any) -> tuple[FitProblem, Floats]:
        """Return the problem and its Jacobian, near the minimum if coordinates of errors of attitudes are compared."""
        # They are linear for small errors only; entries of attitudes are comparable for all.
        linear = [name for name, one in self.weights.items() if one.ndim > self.targets[name].ndim]
        if not linear:
            return self, first
        alike = {name: np.full(self.targets[name].shape, np.sqrt(np.mean(self.weights[name] ** 2))) for name in linear}
        rough = self._replace(weights={**self.weights, **alike})
        zero = np.zeros(len(self.unknowns))
        near = self._replace(values=self.moved(rough.minimum(rough.jacobian(zero), **options).x))
        return near, near.jacobian(zero)

    def residuals(self, z: Floats) -> Floats:
        try:
            return self.residuals_of(self.outputs(z))
        except (IntegrationError, ValueError):
            if not z.any():
                raise
            return np.full(self.numbers, np.inf)  # the trial step is shortened

    def jacobian(self, z: Floats) -> Floats:
        tangents = self.tangents(z)
        columns = [self._weighted(name, tangents[name]).reshape(len(z), -1) for name in self.targets]
        return np.concatenate(columns, axis=1).T

    def minimum(self, first: Floats, watch: Callable[[float], None] = lambda squares: None, **limits: Any) -> Any:
        """Return the result of `scipy.optimize.least_squares` from the guess, whose Jacobian is `first`.

        `watch` is called with the sum of squares of each evaluation.
        """
        from scipy.optimize import least_squares

        # The first step may change each unknown by this many standard deviations.
        lengths = np.linalg.norm(first, axis=0)
        scale = FIRST_STEP / np.where(lengths > 0.0, lengths, 1.0)
        start = np.zeros(len(self.unknowns))

        def residuals(z: Floats) -> Floats:
            found = self.residuals(z)
            watch(float(found @ found))
            return found

        return least_squares(
            residuals, start, self.jacobian, x_scale=scale, xtol=1e-12, ftol=1e-10, gtol=1e-12, **limits
        )


def _mirror(numbers: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """Return the numbers of the mirror images of entries of a square matrix."""
    i, j = np.divmod(numbers, size)
    return j * size + i


def attitude_weights(sigma: Floats, measured: Floats, generators: Floats) -> Floats:
    """Return the factors of the entries of attitudes, or the maps of their errors to coordinates over sigma."""
    d = measured.shape[-1]
    if d == 3 and not len(generators):
        generators = np.asarray(catalogue.so(3).representation)
    n = len(generators)
    if n and sigma.shape in ((n,), (*measured.shape[:-2], n)):
        coordinates = np.linalg.pinv(generators.reshape(n, -1).T).reshape(n, d, d)
        maps = np.einsum("aij,...ik->...akj", coordinates, np.linalg.pinv(measured))
        return np.asarray(maps / sigma[..., None, None])
    if sigma.shape[-2:] not in ((), (1, 1), (d, d)):
        among = f"({n},) for the coordinates of the error, " if n else ""
        raise ValueError(
            f"sigma of attitude has the shape {sigma.shape}; give a number, {among}or an array that broadcasts to "
            f"{measured.shape} with its last two axes"
        )
    # The squares of an error in the group, in all entries, add up to those of its coordinates.
    lengths = np.sum(generators**2, axis=(1, 2))
    moved = np.any(generators, axis=1)
    inverse = moved.T @ (1.0 / lengths) / np.maximum(np.sum(moved, axis=0), 1) if n else np.full(d, 0.5)
    return np.asarray(np.broadcast_to(np.sqrt(np.where(inverse > 0.0, inverse, 1.0)) / sigma, measured.shape))
