"""Base class of forces, their noise, lists of them, and their rates and metrics: numbers, diagonals or matrices."""

from __future__ import annotations

import struct
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from itertools import accumulate
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.sampled_checks import sample_points
from coadjoint.keyword_hints import Abstract
from coadjoint.short_repr import record_repr, short
from coadjoint.systems.coordinates import check_moved, kinds_of
from coadjoint.systems.step_derivatives import LinearizedStep
from coadjoint.systems.time_spans import sample_time_of
from coadjoint.validation import as_tuples, read_finite, read_integer, read_nonnegative, set_fields, to_array

Plain = float | tuple[Any, ...]
Tangent = NDArray[np.float64] | LinearizedStep | None
"""Derivative of a flow by the state: a number, a diagonal, a matrix, or linear maps; None if no formula is known."""


class Noise(NamedTuple):
    """A noise: amplitude, seed, stream of the first member, and sets of commuting directions."""

    amplitude: float
    seed: int
    stream: int
    sets: tuple[tuple[int, ...], ...]


class SpinTerms(NamedTuple):
    """What a damping of spins has besides its metric, which is divided by the length of each spin: multiples (n,) of
    the Hamiltonian field that are added, and the coordinates of the spins, (spins, 3).
    """

    added: NDArray[np.float64]
    spins: NDArray[np.int64]

    def lengths(self, x: NDArray[Any]) -> NDArray[Any]:
        """Return the length of the spin of each coordinate, (n,); infinite for spins of length zero, and others."""
        found = np.full(x.shape, np.inf, dtype=x.dtype)
        lengths = np.sqrt(np.sum(x[self.spins] ** 2, axis=1, keepdims=True))
        found[self.spins] = np.where(lengths == 0.0, np.inf, lengths)
        return found


class ThermalNoise(NamedTuple):
    """The noise of a relaxation: the entries of a root of the stationary covariance, its seed and its first stream."""

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    values: NDArray[np.float64]
    seed: int
    stream: int


MEASURED = "attitude", "angular_velocity", "field"
"""What sampled laws may measure with noise: the order of the deviates, three each."""
OF_SAMPLE, OF_RUN = 2, 3  # parts of the deviates of measurements, as in ``forces/force.hpp``


class SampleNoise(NamedTuple):
    """The noise of a law that is sampled: its seed, the stream of the first member, and the period."""

    seed: int
    stream: int
    period: float

    def deviates(self, t: Any) -> NDArray[np.float64]:
        """Return the normal deviates of the sample at a time, followed by those that all samples have."""
        count, number = 3 * len(MEASURED), float(np.floor(t / self.period + 0.5))
        parts = (number, OF_SAMPLE), (0.0, OF_RUN)
        return np.concatenate([normal_deviates(self.seed, self.stream, *one, count) for one in parts])


class ForceReader(Protocol):
    """Interface that passes a force to the tables of the kernels."""

    def damping(self, rate: NDArray[Any], toward: NDArray[Any]) -> Any:
        """Register x' = -rate (x - toward); rate is a number, (n,) or (n, n)."""

    def constant(self, torque: NDArray[Any]) -> Any:
        """Register x' = torque, (n,)."""

    def function(self, torque: Callable[..., Any], arguments: str) -> Any:
        """Register x' = torque, a function of "t", "x" or "x, t"."""

    def on_orbit(
        self, metric: NDArray[Any], root: NDArray[Any], noise: Noise | None, spins: SpinTerms | None = None
    ) -> Any:
        """Register x' = sign J(x) (P sign J(x) grad H + amplitude L noise); P, L are numbers, (n,) or (n, n)."""

    def hamiltonian_noise(self, terms: Any, seed: int, stream: int, levels: int) -> Any:
        """Register x' = sum_b sign J(x) grad G_b o dB_b, with the `NoiseTerms` of G_b, on one side of each step."""

    def kicks(self, kicks: Any, seed: int, stream: int) -> Any:
        """Register additive noise by its `Kicks`, with the increments of a time at once."""

    def thermal(self, rate: NDArray[Any], noise: ThermalNoise | None) -> Any:
        """Register x' = -rate x with rates (n,), and the noise whose stationary covariance has the given root."""

    def flow(self, function: Callable[..., Any], noises: Sequence[SampleNoise] = ()) -> Any:
        """Register a flow, a function of (x, t, tau), and with noises also of the deviates of all."""

    def mode_rates(
        self, modes: Any, numbers: Any, rates: Any, changes: Any, rest: NDArray[Any] | None, buoyancy: Any
    ) -> Any:
        """Register c' = -rate (c - c of `rest`) for modes of matrices, by `LayerChange`; lists over diagonals."""

    def mode_noise(self, modes: Any, numbers: Any, amplitudes: Any, seed: int, stream: int, layer: int) -> Any:
        """Register noise of given amplitudes on modes of a matrix; lists over diagonals."""

    def on_matrix_orbit(self, system: Any, factor: float, noise: Noise | None) -> Any:
        """Register X' = factor [dual of [Y, X], X] with the stream Y, and noise in all directions of the algebra."""

    def matrix_noise(
        self, system: Any, elements: NDArray[Any], commuting: bool, seed: int, stream: int, levels: int
    ) -> Any:
        """Register X' = [sum of elements times white noise, X], on one side of each step."""

    def mode_transport(
        self, system: Any, modes: Any, numbers: Any, amplitudes: Any, seed: int, stream: int, levels: int
    ) -> Any:
        """Register the same for modes with white noise of given amplitudes; lists over diagonals."""

    def selective_decay(self, rate: float, system: Any) -> Any:
        """Register x' = rate [u, [u, x]], u = grad H, on vectors or on the vorticity of a system of matrices."""


class Force(Abstract):
    """A force, which acts in addition to the Hamiltonian: its flow and the invariants that it preserves.

    `LinearDamping`, `Torque`, `DoubleBracketDamping` and `HeatBath` are forces, and `OwnForce` makes one from a
    function. Derive custom forces from one of these classes or from this one.
    """

    casimirs: ClassVar[bool] = False
    """Whether every Casimir is preserved, to round-off."""

    reversible: ClassVar[bool] = True
    """Whether it can run backward in time, as schemes of order above two require in some substeps."""

    random: ClassVar[bool] = False
    """Whether it draws random numbers, for whole steps: a diffusion, which has no field, or noise of measurements."""

    around_steps: ClassVar[bool] = False
    """Whether it acts before or after a whole step, by its flows ``on_side``, and not within substeps of a scheme."""

    uses_energy: ClassVar[bool] = True
    """Whether its flow may depend on the Hamiltonian or another parameter of the system."""

    sampled: ClassVar[bool] = False
    """Whether it holds numbers in the state, evaluated by a law at the start of a step, before all flows."""

    selectors: ClassVar[tuple[str, ...]] = ()
    """Parameters that select among cases, by which runs are not differentiated although they are numbers."""

    named_values: ClassVar[tuple[str, ...]] = ()
    """Parameters that are pairs of names and numbers, by which runs are differentiated."""

    moves: ClassVar[tuple[str, ...]] = ("momentum",)
    """Kinds of the coordinates that it changes, see ``layout`` of `LiePoissonSystem`."""

    example: ClassVar[Mapping[str, Any]] = {}
    """Parameters of a force for the tests; those that are missing have their defaults."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        # A dataclass keeps a representation that its class has.
        cls.__repr__ = cls.__repr__  # type: ignore[method-assign]

    @property
    def label(self) -> str:
        """Name in balances and messages."""
        return type(self).__name__

    def __repr__(self) -> str:
        return record_repr(self) if is_dataclass(self) else self.label

    def _read(self, **readers: Callable[[Any, str], Any]) -> None:
        """Replace fields by what a function returns of each and of its name in messages, in their order."""
        for name, read in readers.items():
            set_fields(self, **{name: read(getattr(self, name), f"{name} of {type(self).__name__}")})

    def _require_seed(self) -> None:
        """Raise TypeError if the seed of a noise is not given."""
        if getattr(self, "seed", None) is None:
            name = type(self).__name__
            raise TypeError(f"{name} needs a seed, a whole number: runs with the same seed have the same noise")

    def _check_forward(self, tau: Any) -> None:
        """Raise ValueError if a noise is asked for a time backward."""
        if tau < 0.0 and not self.reversible:
            raise ValueError(f"{self.label} is a noise, which does not run backward")

    @abstractmethod
    def check(self, system: Any) -> None:
        """Raise an error if the force cannot act on a system.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.

        Raises
        ------
        ValueError, TypeError
            The force and the system do not match; the message names the mismatch.
        """

    def on_side(self, side: int) -> Any:
        """Return the flow before (0) or after (1) a step, of forces that act around steps."""
        raise NotImplementedError(f"{self.label} acts within steps")

    def preserves_poisson(self, system: Any) -> bool:
        """Whether its flow on a system is a Poisson map."""
        return False

    def preserves_energy(self, system: Any) -> bool:
        """Whether its flow on a system preserves the energy, to round-off."""
        return False

    def _needs_energy(self, system: Any) -> bool:
        """Return whether its flow depends on the Hamiltonian or another parameter of a system."""
        return self.uses_energy

    def _changed(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[np.bool_]:
        """Return which coordinates the force changes at a state, (n,)."""
        return np.asarray(self.field(system, x, t) != 0.0)

    def _check_kinds(self, system: Any) -> None:
        """Raise ValueError if the force changes coordinates of another kind than `moves`, at sample states."""
        kinds = None if system.has_matrices else kinds_of(system)
        if kinds is None:
            return
        fixed = ~np.isin(kinds, self.moves)
        for x in sample_states(system):
            try:
                with np.errstate(all="ignore"):
                    moved = fixed & self._changed(system, x, sample_time_of(self))
            except Exception:  # outside its domain a user function may raise anything
                continue
            check_moved(self.label, system, moved)

    @property
    def is_constant_torque(self) -> bool:
        """Whether it is a constant `torque`, which may be an input of runs."""
        return False

    def held_names(self, system: Any) -> tuple[str, ...]:
        """Return the names, without numbers, of what the force holds at the end of the state."""
        return ()

    def of_members_from(self, first: int) -> Force:
        """Return the force with the noise of the members of an ensemble from the number `first` on."""
        force: Any = self
        return replace(force, stream=force.stream + first) if self.random else self

    def check_steps(self, t0: float, h: float) -> None:
        """Raise ValueError if the force cannot act in steps of length h from time t0."""
        if h < 0.0 and not self.reversible:
            raise ValueError(f"{self.label} does not run backward, and t_span ends before it starts")

    @abstractmethod
    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        """Return the contribution of the force to x'.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.
        x : (n,) array
            The state.
        t : number
            The time.

        Returns
        -------
        (n,) array

        Raises
        ------
        TypeError
            The force is random.
        """

    @abstractmethod
    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        """Return the flow of the force alone over a time tau, computed in Python.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.
        x : (n,) array
            The state.
        t, tau : number
            Initial time and duration; a negative duration runs backward.

        Returns
        -------
        (n,) array
        """

    def flow_of_order(self, system: Any, x: NDArray[Any], t: Any, tau: Any, order: int) -> NDArray[Any]:
        """Return the flow in schemes of this order.

        By default it is `flow`, which must then be exact, or symmetric: undone by the flow over ``-tau``.

        Parameters
        ----------
        system, x, t, tau
            As for `flow`.
        order : int
            Order of the scheme, from 1 to 10.

        Returns
        -------
        (n,) array
        """
        return self.flow(system, x, t, tau)

    def tangent(self, system: Any, x: NDArray[Any], t: float, tau: float) -> Tangent:
        """Return the derivative of `flow` by the state, or None if no formula for it is known.

        Without a formula the flow is differentiated by complex steps if it supports complex numbers, else by
        differences with about nine digits.

        Parameters
        ----------
        system, x, t, tau
            As for `flow`.

        Returns
        -------
        ndarray, LinearizedStep or None
            A multiple of the unit matrix as a number, a diagonal, (n,), or a matrix, (n, n); or the flow with functions
            that apply its derivative and the transpose.
        """
        return None

    def scalings(self, system: Any) -> Mapping[str, tuple[Any, ...]]:
        """Return the derivatives of the coefficients of a flow on orbits by parameters, as the kernels read them.

        Of log v of the noise and of the damping, or of spins, whose directions have three coefficients, of log v of the
        noise, of the rates and of the multiples of the field: numbers, (n,), or (entries, n). Of matrices, the numbers
        by which the amplitude of the noise and the factor of the damping change.
        """
        return {}

    @abstractmethod
    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        """Describe the force to the compiled loops, in one of the forms that they support.

        Parameters
        ----------
        reader : ForceReader
            The receiver of the description.
        system : LiePoissonSystem or PoissonSystem
            The system.
        """

    def parameters(self) -> Mapping[str, Any]:
        """Return the parameters by name, from which a dataclass force can be constructed again."""
        if not is_dataclass(self):
            return {}
        return {field.name: getattr(self, field.name) for field in fields(self)}


MAX_SEED = 2**62


def read_nonnegatives(value: Any, what: str) -> Plain:
    """Validate a number, or a vector of numbers, which are zero or positive."""
    array = read_finite(value, what)
    if not array.ndim:
        return read_nonnegative(value, what)
    if array.ndim > 1 or not array.size:
        raise ValueError(f"{what} has the shape {array.shape}; give a number or a vector")
    if (array < 0.0).any():
        raise ValueError(f"{what} has the entry {array.min():g}; its numbers must be zero or positive")
    return as_tuples(array)  # type: ignore[no-any-return]


def read_seed(value: Any, what: str) -> int:
    """Validate the seed or the stream of a noise."""
    return read_integer(value, what, 0, MAX_SEED)


def normal_deviates(seed: int, stream: int, moment: float, part: int, count: int) -> NDArray[np.float64]:
    """Return `count` independent normal deviates, a pure function of seed, stream (0 to 2^63 - 1), time and part."""
    # By Philox4x64-10 and the inverse distribution function, as ``forces/random.hpp`` to round-off.
    from scipy.special import ndtri

    words = random_words(seed, stream, moment, part, count)
    size = -ndtri((np.asarray(words >> np.uint64(12), dtype=np.float64) + 0.5) * 2.0**-53)
    return np.asarray(np.where(words & np.uint64(1), -size, size))


def random_words(seed: int, stream: int, moment: float, part: int, count: int) -> NDArray[np.uint64]:
    """Return the random words of the deviates, 64 bits each."""
    (time_bits,) = struct.unpack("<Q", struct.pack("<d", moment + 0.0))
    # NumPy increments the counter before its first block.
    counter = (((part << 192) | (stream << 128) | (time_bits << 64)) - 1) % (1 << 256)
    words = np.random.Philox(key=seed, counter=counter).random_raw(-(-count // 4) * 4)
    return np.asarray(words[:count], dtype=np.uint64)


MAX_FORCES_TEXT = 240  # characters of the forces in a representation; longer lists are cut


def forces_on(system: Any, forces: Sequence[Any], new: int) -> tuple[Any, tuple[Any, ...]]:
    """Return a system with space in its state for what forces hold, and the forces, which can act on it."""
    for force in forces:
        if isinstance(force, Sequence) and any(isinstance(one, Force) for one in force):
            raise TypeError(f"with_forces was given {short(force)}, a list; give the forces: with_forces(*forces)")
        if not isinstance(force, Force):
            raise TypeError(f"a force is {short(force)}; it must be one of co.forces, such as LinearDamping(0.1)")
    held = [force.held_names(system) for force in forces]
    if any(held):
        starts = accumulate(map(len, held), initial=0)
        forces = [
            replace(force, first=first) if names else force
            for force, names, first in zip(forces, held, starts, strict=False)
        ]
        stems = [name for names in held for name in names]
        system = system.with_held(tuple(f"{name}{stems[: k + 1].count(name)}" for k, name in enumerate(stems)))
    for k, force in enumerate(forces):
        force.check(system)
        if k >= len(forces) - new:
            kinds = None if system.has_matrices else kinds_of(system)
            if kinds is not None and not np.isin(kinds, force.moves).any():
                raise ValueError(f"{force.label} acts on a {force.moves[0]}, and {system.name} has none")
            force._check_kinds(system)
    streams = [(force.seed, force.stream) for force in forces if force.random]
    if len(set(streams)) < len(streams):
        raise ValueError("two forces have the same seed and stream, and so the same noise; give each its own seed")
    return system, tuple(forces)


def labels_of(forces: Sequence[Force]) -> tuple[str, ...]:
    """Return the labels of forces, numbered from the second of a label on."""
    labels: list[str] = []
    for k, force in enumerate(forces):
        earlier = sum(other.label == force.label for other in forces[:k])
        labels.append(f"{force.label} {earlier + 1}" if earlier else force.label)
    return tuple(labels)


def forces_text(forces: Sequence[Force]) -> str:
    """Return the forces with their parameters; of many the names, and of more their number."""
    text = ", ".join(map(str, forces))
    if len(text) > MAX_FORCES_TEXT:
        text = ", ".join(force.label for force in forces)
    if len(text) > MAX_FORCES_TEXT:
        return ", ".join(short(force.label) for force in forces[:2]) + f", and {len(forces) - 2} more"
    return text


def read_matrix(argument: Any, what: str, dimensions: tuple[int, ...] = (0, 1, 2)) -> Plain:
    """Validate a number, a vector or a square matrix, and return it as floats in nested tuples."""
    array = read_finite(argument, what)
    square = array.ndim < 2 or array.shape[0] == array.shape[1]
    if array.ndim not in dimensions or not square or not array.size:
        shapes = " or ".join(("a number", "(n,)", "(n, n)")[k] for k in dimensions)
        raise ValueError(f"{what} has the shape {array.shape}; it must be {shapes}")
    plain: Plain = as_tuples(array)
    return plain


def read_state(argument: Any, what: str, number: bool = False) -> Any:
    """Validate a vector or a matrix state (with `number` also a scalar), and return it as nested tuples."""
    if isinstance(argument, Mapping) and argument.keys() == {"real", "imaginary"}:  # the form used in records
        argument = read_finite(argument["real"], what) + 1j * read_finite(argument["imaginary"], what)
    matrix = to_array(argument, what, "iufc")
    if matrix.ndim == 2 and matrix.shape[1] == 3 != matrix.shape[0] and matrix.size:  # one row for each body
        return as_tuples(read_finite(argument, what))
    if matrix.ndim not in (2, 3):
        return read_matrix(argument, what, (0, 1) if number else (1,))
    if matrix.shape[-2] != matrix.shape[-1] or not matrix.size or not np.isfinite(matrix).all():
        raise ValueError(f"{what} has the shape {matrix.shape}; a matrix must be (N, N), of finite numbers")
    return as_tuples(matrix.astype(complex if matrix.dtype.kind == "c" else float))


def check_state(argument: Any, what: str, system: Any) -> None:
    """Raise an error if a state does not belong to a system; a scalar must be zero for systems of matrices."""
    shape = np.shape(argument)
    if system.has_matrices:
        if shape or argument != 0.0:
            system.read(argument, what)
    elif len(shape) > 1:
        raise ValueError(f"{what} is a matrix; {system.name} needs ({system.dim},)")
    else:
        check_dimension(argument, what, system)


def state_vector(argument: Any, system: Any) -> NDArray[np.float64]:
    """Return a state as a vector of real numbers, (n,)."""
    if system.has_matrices and np.ndim(argument):
        return np.asarray(system.read(argument))
    return np.asarray(np.broadcast_to(np.asarray(argument, dtype=np.float64), (system.dim,)))


def sample_states(system: Any) -> list[NDArray[Any]]:
    """Return seeded sample states of different kinds, in the form in which user functions take them."""
    points = sample_points(system.dim)
    return [system.algebra.projected(system.from_vector(x)) for x in points] if system.has_matrices else points


def check_dimension(argument: Plain, what: str, system: Any) -> None:
    """Raise an error if a vector or matrix does not have the dimension of a system."""
    shape = np.shape(argument)
    if shape and shape[0] != system.dim:
        raise ValueError(f"{what} has the shape {shape}; {system.name} has dimension {system.dim}")


def apply_metric(matrix: Any, y: NDArray[Any]) -> NDArray[Any]:
    """Return the product of a number, a diagonal or a matrix with y."""
    return np.asarray(matrix) @ y if np.ndim(matrix) == 2 else np.asarray(matrix) * y
