"""Inputs of prepared runs (linear coefficients of H, torques): each call writes them into copies of the tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import unknown_name
from coadjoint.kernels.tables.compiled import NotWritable
from coadjoint.kernels.tables.writable import WritableTables
from coadjoint.labels import MEMBERS, STATE_DIMENSIONS, by_labels, labelled
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.runs.loops.loops import Loops, loops_of_batch, loops_of_system
from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch
from coadjoint.systems.coefficients import check_linear, linear_of, with_linear
from coadjoint.systems.coordinates import check_moved, coordinate_names, momenta_of
from coadjoint.systems.forces.torque import is_on_bodies, places_of_torques, torque_vector
from coadjoint.systems.system import System
from coadjoint.validation import are_finite, read_numbers, to_array

if TYPE_CHECKING:
    from coadjoint.kernels.tables.compiled import CompiledTables

Floats = NDArray[np.float64]

NONE = np.zeros(0)
# Reserved: parameters of a run.
RESERVED_NAMES = frozenset(
    (
        "x",
        "x0",
        "t",
        "t_span",
        "t_eval",
        "save_every",
        "attitude",
        "events",
        "progress",
        "directions",
        "reverse",
        "fixed",
        "self",
    )
)


class Inputs:
    """Inputs of a prepared run of one system: coefficients of the linear term of H, or constant torques.

    `values` (m,): defaults, linear terms first; `indices`: name -> indices in them; `changing`: all these in order.
    """

    def __init__(self, system: System, specification: Any) -> None:
        self.system = system
        self._leading: Mapping[str, Any] = MEMBERS  # labels of axes in front of those of a value
        self._unforced: Any = system.unforced
        if isinstance(specification, bool | np.bool_) and specification:
            specification = range(system.dim)
        if isinstance(specification, str):
            raise TypeError(
                f"inputs is {short(specification)}; give each torque a name, such as {{'torque': 'Torque'}}"
            )
        named = self.specification = specification if isinstance(specification, Mapping) else {"linear": specification}
        if not named:
            raise ValueError("inputs is empty; give True, coordinates, or a mapping from names to coordinates")
        torques = self._named_torques = {name for name, target in named.items() if isinstance(target, str)}
        self._linear = np.zeros(0)
        if len(torques) < len(named):
            check_linear(self._unforced)
            self._linear = linear_of(self._unforced.hamiltonian)
        self.values = self._linear
        self._torques: dict[int, NDArray[np.int64]] = {}
        self.indices: dict[str, NDArray[np.int64]] = {}
        for name, target in named.items():
            self._check_name(name, of_linear_term=name not in torques)
            self.indices[name] = (
                self._torque_indices(target, name) if name in torques else _read_coordinates(target, name, system.dim)
            )
        all_indices = np.arange(len(self.values))
        self._full_input = next(
            (name for name, target in self.indices.items() if np.array_equal(target, all_indices)), None
        )
        self.changing = np.concatenate([target.ravel() for target in self.indices.values()])
        if len(np.unique(self.changing)) < len(self.changing):
            repeated = int(np.flatnonzero(np.bincount(self.changing) > 1)[0])
            raise ValueError(f"inputs name coordinate {repeated} more than once; each coefficient is one input")
        self._check_forces()

    def _check_forces(self) -> None:
        if not len(self.in_energy) or not self.system.forces:
            return
        from coadjoint.kernels.tables.forces import linear_coefficients_in

        for k, force in self.system.flows:
            label = self.system.labels[k]
            contained = sorted({*linear_coefficients_in(force, self._unforced)} & {*self.in_energy.tolist()})
            if contained:
                raise TypeError(
                    f"inputs name coordinate {contained[0]}, whose coefficient {label} reads, as it does the angular "
                    "velocity of a body; take inputs of other coordinates or of a constant Torque, or make such a "
                    "coefficient a coordinate, as momenta of wheels are in co.systems.body(inertia, wheels=...)"
                )

    def _check_name(self, name: Any, of_linear_term: bool) -> None:
        if not isinstance(name, str) or not name.isidentifier():
            raise TypeError(f"inputs has the name {short(name)}; it must be a valid Python identifier, such as linear")
        if name in RESERVED_NAMES:
            raise ValueError(f"inputs has the name {name!r}, which is reserved; choose another one")
        if of_linear_term and name != "linear" and name in (self._unforced.parameters or ()):
            raise ValueError(
                f"inputs has the name {name!r}, a parameter of {self._unforced.name}, and its values would be "
                "coefficients of the linear term of H instead; choose another name, such as linear"
            )

    def _torque_indices(self, label: str, name: str) -> NDArray[np.int64]:
        """Append the torque of this label to the values, and return its indices."""
        labels = list(self.system.labels)
        if not labels:
            raise ValueError(
                f"inputs has {short(label)} for {name}, and {self.system.name} has no forces; give coordinates, or a "
                "system with_forces(co.forces.Torque(...))"
            )
        if label not in labels:
            raise unknown_name("force", label, labels)
        k = labels.index(label)
        force: Any = self.system.forces[k]
        if not force.is_constant_torque:
            raise TypeError(
                f"inputs has {short(label)} for {name}, which is {short(str(force))}; of the forces only a constant "
                "Torque may be an input"
            )
        if np.ndim(force.torque) > 1 and self.system.has_matrices:
            raise TypeError(f"inputs has {short(label)} for {name}, which is a matrix; only a vector may be an input")
        if k in self._torques:
            raise ValueError(f"inputs name {short(label)} more than once; each torque is one input")
        on_bodies = is_on_bodies(np.shape(force.torque), self.system)
        places = places_of_torques(self.system) if on_bodies else np.arange(self.system.dim)
        indices = self._torques[k] = len(self.values) + places
        self.values = np.concatenate([self.values, torque_vector(force.torque, self.system)])
        return indices

    def __repr__(self) -> str:
        return ", ".join(f"{name} {indices.shape}" for name, indices in self.indices.items())

    def read(self, inputs: Mapping[str, Any], defaults: Floats | None = None) -> Floats:
        """Return the values with these inputs inserted: (m,), or (members, m) for individual values of members.

        With `defaults` (members, m) of a batch there are values for each.
        """
        if self._full_input is not None and defaults is None and list(inputs) == [self._full_input]:
            # All coefficients in coordinate order are the array itself.
            numbers = self._numbers(inputs[self._full_input], self._full_input)
            if numbers.shape[-1:] == self.values.shape and numbers.ndim <= 2 and len(numbers) and are_finite(numbers):
                self.check_moved(inputs, numbers)
                return numbers
        arrays, members = {}, None if defaults is None else len(defaults)
        for name, value in inputs.items():
            indices = self.indices.get(name)
            if indices is None:
                raise unknown_name("input of this run", name, self.indices)
            numbers = self._numbers(value, name)
            if numbers.shape != indices.shape:
                per_member = numbers.shape[1:] == indices.shape and numbers.ndim > indices.ndim
                if not per_member or not len(numbers) or members not in (None, len(numbers)):
                    raise self._shape_error(name, numbers.shape, members)
                members = len(numbers)
            if not are_finite(numbers):
                raise ValueError(f"{name} contains NaN or infinity; every number must be finite")
            arrays[name] = numbers
        own = self.values if defaults is None else defaults
        values = own.copy() if members is None or own.ndim > 1 else np.tile(own, (members, 1))
        for name, numbers in arrays.items():
            indices = self.indices[name]
            values[..., indices.ravel()] = numbers.reshape(*numbers.shape[: numbers.ndim - indices.ndim], -1)
        if defaults is None:
            self.check_moved(inputs, values)
        return values

    def _numbers(self, value: Any, name: str) -> Floats:
        """Return the numbers of an input, of coordinates perhaps labelled by their names."""
        if labelled(value) is not None and self.indices[name].ndim == 1:
            names = coordinate_names(self.system)
            own = [names[k % self.system.dim] for k in self.indices[name].tolist()]
            order = {"component": own, **self._leading}
            value = by_labels(value, name, STATE_DIMENSIONS[0], order)
        return read_numbers(value, name)

    def check_moved(self, names: Iterable[str], values: Floats) -> None:
        """Raise ValueError if values of torques with these names change other coordinates than momenta."""
        momenta = momenta_of(self._unforced)
        for name in self._named_torques.intersection(names):
            if momenta is not None and self.indices[name].shape == momenta.shape:
                moved = (values[..., self.indices[name]] != 0.0).reshape(-1, len(momenta)).any(axis=0)
                check_moved(name, self._unforced, moved & ~momenta)

    def _shape_error(self, name: str, shape: tuple[int, ...], members: int | None) -> ValueError:
        expected = self.indices[name].shape
        per_member = ", ".join(map(str, ("members" if members is None else members, *expected)))
        return ValueError(
            f"{name} has the shape {shape}; as prepared it must be {expected}, or ({per_member}) with a "
            "value for each member"
        )

    def check_not_square(self, inputs: Mapping[str, Any]) -> None:
        """Raise ValueError if all values of members, for one state, are square, as a vector over a tensor is."""
        shapes = {name: np.shape(value) for name, value in inputs.items()}
        by_member = {name: shape for name, shape in shapes.items() if shape != self.indices[name].shape}
        members = next(iter(by_member.values()))[0]
        if members > 1 and all(shape == (members, members) for shape in by_member.values()):
            name, n = next(iter(by_member)), self.system.dim
            raise ValueError(
                f"{name} has the shape ({members}, {members}), which may be a matrix or values for {members} members, "
                f"and x0 is one state; give one value, ({members},), or x0 for each member, ({members}, {n})"
            )

    @property
    def of_hamiltonian(self) -> Inputs | None:
        """The inputs of the Hamiltonian part, whose values are the first ones; None if all inputs are torques."""
        named = {name: indices for name, indices in self.indices.items() if np.all(indices < len(self._linear))}
        return Inputs(self._unforced, named) if named else None

    def of(self, system: System) -> Inputs:
        """Return the same inputs of another system."""
        return Inputs(system, self.specification)

    def force_of(self, index: int) -> int | None:
        """Return the index of the force whose torque a value is; None for a coefficient of the linear term."""
        return next((k for k, indices in self._torques.items() if index in indices), None)

    @property
    def in_energy(self) -> NDArray[np.int64]:
        """Coordinates of the linear term that are inputs."""
        return self.changing[self.changing < len(self._linear)]

    @property
    def generic(self) -> Floats:
        """Values for which no input vanishes, and no products of the field cancel by chance."""
        values = self.values.copy()
        values[self.changing] = 1.5 + 0.5 * np.cos(1.0 + np.arange(len(self.changing)))
        return values

    def writable(
        self, loop: CompiledTables, watch: CompiledTables, others: Sequence[int] = (), first: Floats = NONE
    ) -> WritableTables:
        """Return the tables, of `generic` values, for any others; `NotWritable` if inputs are no constants.

        Before the values are those of `others`, sources that differ between systems, here with the numbers `first`.
        """
        from coadjoint.program.sources import CoefficientNumbers

        values = self.generic
        energy = CoefficientNumbers.of(self.system_at(values).hamiltonian.terms())
        indices, tangled = {source: k for k, source in enumerate(others)}, list[int]()
        present = energy.present()
        for k in self.in_energy.tolist():
            own = np.flatnonzero(present.coordinate == k)
            if len(own) == 1 and present.value[own[0]] == values[k]:
                indices[int(present.number[own[0]])] = len(others) + k
            else:
                tangled += present.number[own].tolist()
        for k, (force, numbers) in enumerate(self._torques.items()):
            # Each torque has a number for every coordinate; those of one on bodies are some of them.
            places = numbers.ravel() - len(self._linear) - k * self.system.dim
            start = energy.size + force * self.system.dim
            indices.update(zip((start + places).tolist(), (len(others) + numbers.ravel()).tolist(), strict=True))
        return WritableTables(loop, watch, indices, np.concatenate([first, values]), tangled)

    def settled(self, method: Method, system: Any = None) -> Method:
        """Return the scheme with its automatic choices fixed as for the default values, for any linear term."""
        return _settled(method, [self.system_at(self.values, system)], self.in_energy)

    def system_at(self, values: Floats, of: Any = None) -> Any:
        """Return the system, or one with other parameters, whose further coefficients are kept, at values (m,)."""
        size, system = len(self._linear), self._unforced if of is None else of.unforced
        if size:
            linear, at = values[:size], self.in_energy
            if of is not None:
                linear = linear_of(system.hamiltonian)
                linear[at] = values[at]
            system = with_linear(system, linear)
        forces: list[Any] = list((self.system if of is None else of).forces)
        if not forces:
            return system
        for k, indices in self._torques.items():
            forces[k] = replace(forces[k], torque=values[indices])
        return system._with_acting(forces)

    def system_of(self, values: Floats) -> Any:
        """Return the system of a call, or a batch with one system for each member."""
        if values.ndim == 1:
            return self.system_at(values)
        return Batch([self.system_at(row) for row in values])

    def loops(self, method: Method, h: float, representation: Representation) -> Loops:
        """Return loops whose tables take any values of the inputs, of a scheme with fixed parts; h may be negative."""
        loops = loops_of_system(self.system_at(self.generic), method, h, representation)
        loops.writable = (self.written_into(loops, 0, method),)
        return loops

    def written_into(self, loops: Loops, k: int, method: Method) -> WritableTables:
        """Return the tables of loop k for any values; ValueError, naming the scheme, if inputs are no constants."""
        try:
            return self.writable(loops.compiled[k], loops.watches[k], *loops.varying(k))
        except NotWritable as reason:
            raise ValueError(f"{method} takes no inputs for {self.system.name}: {reason}") from None


class InputsOfMembers:
    """Inputs of a prepared run of a batch: those of its distinct systems, `each`, with default `values` (members, m).

    One reading of the arguments serves all: the inputs have the same `indices` in every system.
    """

    def __init__(self, batch: Batch, specification: Any) -> None:
        first, self.batch = Inputs(batch.first, specification), batch
        self._first, self.specification = first, first.specification
        if len(batch.axes) == 1:
            ((name, axis),) = batch.axes.items()
            first._leading = {**MEMBERS, name: None if axis.values is None else axis.values.tolist()}
        self.each = [first]
        for k, system in enumerate(batch.distinct[1:], start=1):
            with self._naming_member(k):
                self.each.append(first.of(system))
                self._check_shapes(self.each[k])
        self.indices, self.changing = first.indices, first.changing
        self.values = np.stack([one.values for one in self.each])[batch.owners]
        # Systems with other momenta than the first one, which torques act on.
        self._kinds = [] if all(_same_momenta(one.system, first.system) for one in self.each) else self.each

    @contextmanager
    def _naming_member(self, k: int) -> Iterator[None]:
        """Name the first member with system k in refusals."""
        try:
            yield
        except (TypeError, ValueError) as error:
            member = int(np.argmax(self.batch.owners == k))
            raise type(error)(f"member {member} of the batch: {error}") from error

    def _check_shapes(self, other: Inputs) -> None:
        for name, indices in self._first.indices.items():
            if not np.array_equal(other.indices[name], indices):
                raise ValueError(
                    f"{name} has the shape {other.indices[name].shape}, and {indices.shape} for member 0; give all "
                    "members torques of one shape"
                )

    def __repr__(self) -> str:
        return repr(self._first)

    def of(self, batch: Batch) -> InputsOfMembers:
        """Return the same inputs of other members."""
        return InputsOfMembers(batch, self.specification)

    def read(self, inputs: Mapping[str, Any]) -> Floats:
        """Return the values (members, m) with these inputs inserted, each of one shape for all or for each member."""
        values = self._first.read(inputs, self.values)
        if not self._kinds:
            self._first.check_moved(inputs, values)
        for k, one in enumerate(self._kinds):
            with self._naming_member(k):
                one.check_moved(inputs, values[self.batch.owners == k])
        return values

    def settled(self, method: Method) -> Method:
        """Return the scheme with its automatic choices fixed as for the default values, for any linear terms."""
        return _settled(method, [one.system for one in self.each], self._first.in_energy)

    def system_of(self, values: Floats) -> Batch:
        """Return the batch of a call; members with one system and the same values have one."""
        known, systems = dict[tuple[int, bytes], Any](), []
        for owner, row in zip(self.batch.owners.tolist(), values, strict=True):
            key = owner, row.tobytes()
            if key not in known:
                known[key] = self.each[owner].system_at(row)
            systems.append(known[key])
        return Batch(systems, self.batch.axes, self.batch.combined)

    def loops(self, method: Method, h: float, representations: Sequence[Representation]) -> Loops:
        """Return loops whose tables take any values of the inputs, of a scheme with fixed parts; h may be negative."""
        generic, owners = [one.system_at(one.generic) for one in self.each], self.batch.owners
        loops = loops_of_batch(Batch([generic[owner] for owner in owners]), method, h, representations)
        assert loops.owners is not None
        # The tables of a loop are those of the first of its systems.
        firsts, written = owners[np.unique(loops.owners, return_index=True)[1]].tolist(), list[WritableTables]()
        for number, k in enumerate(firsts):
            with self._naming_member(k):
                written.append(self.each[k].written_into(loops, number, method))
        loops.writable = tuple(written)
        return loops


def inputs_of(system: System | Batch, specification: Any) -> Inputs | InputsOfMembers:
    """Return the inputs of a run of one system or of a batch."""
    return InputsOfMembers(system, specification) if system.is_batch else Inputs(system, specification)


def _settled(method: Method, systems: Sequence[Any], coordinates: NDArray[np.int64]) -> Method:
    plain = [system.unforced for system in systems]
    return method.settled(plain, np.sort(coordinates).tolist()) if len(coordinates) else method


def _same_momenta(one: Any, other: Any) -> bool:
    kinds: Any = momenta_of(one.unforced), momenta_of(other.unforced)
    return kinds[0] is kinds[1] or np.array_equal(*kinds)


def _read_coordinates(value: Any, name: str, n: int) -> NDArray[np.int64]:
    what, numbers = f"the coordinates of {name}", None
    with suppress(TypeError):
        numbers = None if to_array(value, what).dtype.kind == "b" else read_numbers(value, what)
    if numbers is None or not numbers.size or numbers.ndim == 0 or np.any(numbers != np.floor(numbers)):
        raise TypeError(
            f"inputs has {short(value)} for {name}; give coordinates, whole numbers from 0 to {n - 1}, or True"
        )
    if np.any((numbers < 0) | (numbers >= n)):
        raise ValueError(f"inputs has {short(value)} for {name}; coordinates run from 0 to {n - 1}")
    return numbers.astype(np.int64)
