"""Initial state of a run: momenta of all members, and the group element if an attitude is computed."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.representation import (
    are_rotations,
    automorphism_violation,
    expected_elements,
    group_element_violation,
    group_elements,
    rotation_block,
)
from coadjoint.labels import MEMBERS, STATE_DIMENSIONS, by_labels, is_xarray
from coadjoint.memory import check_available_memory
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.program.generators import group_side
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.batch import Axis, Batch, axis_coordinates, check_axis_name, with_state_axes
from coadjoint.systems.coordinates import coordinate_names, states_by_label
from coadjoint.systems.registry import check_units, has_units
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_system
from coadjoint.validation import FLOAT64, SMALL_SIZE, are_finite, read_numbers, to_array

BYTES_PER_MEMBER = 100
"""Memory for a member of a family, besides its state."""


class Start(NamedTuple):
    """Initial momenta (members, n) and group elements (members, d, d); `single` means no axis of members."""

    momenta: NDArray[np.float64]
    groups: NDArray[np.float64]
    representation: Representation
    single: bool
    system: Any

    @property
    def carried(self) -> str | None:
        """Matrices of the group element: "representation", "coadjoint", or None."""
        return matrices_of(self.representation)


def matrices_of(representation: Representation) -> str | None:
    """Name the matrices of a group element: "representation", "coadjoint", or None."""
    if representation is None:
        return None
    return "coadjoint" if isinstance(representation, str) else "representation"


def start_without_groups(system: Any, momenta: NDArray[np.float64], single: bool = False) -> Start:
    """Return the start of validated momenta (members, n) without group elements."""
    return Start(momenta, _no_groups(len(momenta)), None, single, system)


def start_of(system: System | Batch, method: Method, x0: Any, attitude: Any) -> Start:
    """Validate x0 and attitude, as in `integrate`, for a system and a scheme; return copies."""
    check_system(system)
    momenta, single = momenta_of(system, x0)
    return with_group(system, momenta, single, representations_of(system, method, attitude)[0], attitude)


def momenta_of(system: System | Batch, x0: Any) -> tuple[NDArray[np.float64], bool]:
    """Validate x0, (n,) or (members, n); return a copy (members, n), and whether it is a single state."""
    size = vector_size(system)
    if size is not None:
        return vectors_of(states_by_label(system, x0, "x0"), system)
    momenta, single = any_momenta_of(system, x0)
    if system.is_batch:
        for k, one in enumerate(system.distinct):
            if has_units(one.unforced):
                check_units(one.unforced, momenta[system.owners == k])
    else:
        check_units(system.unforced, momenta)
    return momenta, single


def any_momenta_of(system: System | Batch, x0: Any) -> tuple[NDArray[np.float64], bool]:
    """Return `momenta_of`, also for states that begin no motion: forces may have moved a coordinate that is 1."""
    x0 = states_by_label(system, x0, "x0")
    if system.has_matrices:
        rows = system.unforced.read(x0)
        if not len(rows):
            raise ValueError(f"x0 has the shape {np.shape(x0)}; an ensemble needs at least one member")
        return rows.reshape(-1, system.dim), rows.ndim == 1
    momenta = read_numbers(x0, "x0")
    n, shape = system.dim, system.shape
    if len(shape) > 1:
        if momenta.shape[-len(shape) :] != shape or momenta.ndim > len(shape) + 1:
            raise ValueError(f"x0 has the shape {momenta.shape}; it must be {shape} or (members, {str(shape)[1:]}")
        momenta = momenta.reshape(*momenta.shape[: -len(shape)], n)
    if system.is_batch:
        if momenta.shape not in ((n,), (len(system), n)):
            raise ValueError(
                f"x0 has the shape {momenta.shape}; a batch of {len(system)} members needs ({len(system)}, {n}), "
                f"or ({n},) for all of them{_held_hint(system, momenta)}"
            )
        momenta = np.array(np.broadcast_to(momenta, (len(system), n)), order="C")
    return _checked(momenta, system, x0)


def _held_hint(system: Any, momenta: NDArray[np.float64]) -> str:
    """Return a hint for states that were made before forces with numbers in the state were added."""
    held = getattr(system.of_member(0), "held", 0)
    if not held or not momenta.ndim or momenta.shape[-1] != system.dim - held:
        return ""
    return f", of which forces hold the last {held}: make it by system.state(...) after with_forces"


def vector_size(system: Any) -> int | None:
    """Return the dimension of a system of which any vector is a state, and that all members share; otherwise None."""
    is_other = system.is_batch or len(system.shape) > 1 or system.has_matrices
    return None if is_other or has_units(system.unforced) else int(system.dim)


def vectors_of(x0: Any, system: Any) -> tuple[NDArray[np.float64], bool]:
    """Return what `momenta_of` returns for a system whose states are vectors."""
    n = system.dim
    if type(x0) is np.ndarray and x0.dtype is FLOAT64 and x0.shape == (n,) and n <= SMALL_SIZE:
        # The short way of the most frequent case; numbers with a finite sum are finite.
        momenta = x0.copy()
        if math.isfinite(sum(momenta.tolist())):
            return momenta[None], True
    return _checked(read_numbers(x0, "x0"), system, x0)


def _checked(momenta: NDArray[np.float64], system: Any, x0: Any) -> tuple[NDArray[np.float64], bool]:
    """Validate a copy of the numbers of x0; return it as (members, n), and whether it was a single state."""
    n = system.dim
    if momenta.ndim not in (1, 2) or momenta.shape[-1] != n:
        hint = "; np.ravel(x0) makes one state of its numbers" if momenta.size == n else _held_hint(system, momenta)
        raise ValueError(f"x0 has the shape {momenta.shape}; it must be ({n},) or (members, {n}){hint}")
    if not are_finite(momenta):
        raise ValueError("x0 contains NaN or infinity; every component must be finite")
    if momenta.ndim == 1:
        return momenta[None], True
    if not len(momenta):
        raise ValueError(f"x0 has the shape {np.shape(x0)}; an ensemble needs at least one member")
    return np.ascontiguousarray(momenta), False


def combined(system: Any, x0: Any) -> tuple[Any, Any]:
    """Return a batch with named axes and x0 as members, every system with every state; others unchanged."""
    check_system(system)
    if not system.is_batch or system.combined:
        return system, x0
    shape, axes, dims = system[0].shape, system.axes, x0.dims if is_xarray(x0) else None
    if dims is None:
        states = to_array(states_by_label(system, x0, "x0"), "x0", "iufc")
    else:
        of_state = STATE_DIMENSIONS[len(shape) - 1]
        dims = [dim for dim in dims if dim not in (*of_state, "part")]
        states = by_labels(x0, "x0", of_state, {"component": coordinate_names(system)})
    lengths = tuple(axis.length for axis in axes.values())
    leading = states.ndim - len(shape)
    if leading < 0 or states.shape[leading:] != shape:
        raise ValueError(f"x0 has the shape {states.shape}; each state must be of shape {shape}, its last dimensions")
    if dims is not None:
        names = tuple(map(str, dims))
    elif leading <= 1:
        names = ("member",)[:leading]
    elif leading == len(axes) + 1 and states.shape[: len(axes)] == lengths:
        names = (*axes, "member")
    else:
        raise ValueError(
            f"x0 has the shape {states.shape}; give states for all systems, (k, {str(shape)[1:]}, for each of them, "
            f"{(*lengths, 'k', *shape)}, or an xarray.DataArray whose dimensions have names"
        )
    new: dict[str, Axis] = {}
    for name, length in zip(names, states.shape, strict=False):
        values = axis_coordinates(x0.coords[name].values) if dims is not None and name in x0.coords else None
        if name not in axes:
            check_axis_name(name, new)
            new[name] = Axis(length, values)
            continue
        own = axes[name].values
        if length != axes[name].length or (values is not None and own is not None and not np.array_equal(values, own)):
            raise ValueError(f"x0 has other values of {name} than the batch; give those of the batch, in its order")
    all_lengths = (*lengths, *(axis.length for axis in new.values()))
    members = math.prod(all_lengths)
    if not members:
        raise ValueError(f"x0 has the shape {states.shape}; an ensemble needs at least one member")
    check_available_memory(
        BYTES_PER_MEMBER * members + 3 * states.itemsize * members * math.prod(shape), f"a family of {members} members"
    )
    order = [name for name in (*axes, *new) if name in names]
    states = states.transpose(*(names.index(name) for name in order), *range(leading, states.ndim))
    sizes = [length if name in names else 1 for name, length in zip((*axes, *new), all_lengths, strict=True)]
    states = np.broadcast_to(states.reshape(*sizes, *shape), (*all_lengths, *shape))
    return with_state_axes(system, new), states.reshape(members, *shape)


def is_attitude_kind(attitude: Any) -> bool:
    """Whether an argument `attitude` is a flag or a name, and not an initial group element."""
    return isinstance(attitude, bool | np.bool_ | str)


def read_attitude(attitude: Any, system: Any) -> Any:
    """Return a flag or a name unchanged, and group elements, rotations or quaternions as a new array of elements."""
    if is_attitude_kind(attitude):
        return attitude
    representation = system.of_member(0).representation
    size = 0 if representation is None else np.shape(representation)[-1]
    attitude = by_labels(attitude, "attitude", STATE_DIMENSIONS[1], MEMBERS)
    return group_elements(attitude, size, rotation_block(representation))


def with_group(
    system: System | Batch, momenta: NDArray[np.float64], single: bool, representation: Any, attitude: Any
) -> Start:
    """Return the start of a run from validated momenta (members, n) and one of `representations_of`."""
    if representation is None:
        return start_without_groups(system, momenta, single)
    size, coadjoint = group_side(system.dim, representation), matrices_of(representation) == "coadjoint"
    initial = read_attitude(attitude, system)
    if is_attitude_kind(initial):
        units = unit_groups(size) if len(momenta) == 1 else np.tile(unit_groups(size), (len(momenta), 1, 1))
        return Start(momenta, units, representation, single, system)
    if initial.shape not in ((size, size), (len(momenta), size, size)):
        if system.unforced.has_attitude:
            raise ValueError(
                f"attitude has the shape {initial.shape}; the attitude of {system.name} is part of its state: give it "
                f"to {system.name}.state, and leave attitude out"
            )
        raise ValueError(
            f"attitude has the shape {initial.shape}; the representation of {system.name} needs "
            f"{expected_elements(size, rotation_block(representation))}"
        )
    if not are_finite(initial):
        raise ValueError("attitude contains NaN or infinity; every entry must be finite")
    if coadjoint or not are_rotations(initial, representation):
        if not _surely_regular(initial) and np.any(_ranks(initial) < size):
            raise ValueError("attitude is a singular matrix; a group element has an inverse")
        _check_elements(system, initial.reshape(-1, size, size), representation)
    shared = initial.ndim == 2 and len(momenta) > 1
    groups = np.tile(initial, (len(momenta), 1, 1)) if shared else np.ascontiguousarray(initial).reshape(-1, size, size)
    return Start(momenta, groups, representation, single, system)


def _check_elements(system: System | Batch, groups: NDArray[np.float64], representation: Any) -> None:
    if matrices_of(representation) == "coadjoint":
        violation = automorphism_violation(groups, system.unforced.algebra.structure_matrix)
    else:
        violation = group_element_violation(groups, representation)
    if violation is not None:
        raise ValueError(f"attitude is no element of the group of {system.of_member(0).name}: {violation}")


@lru_cache(maxsize=4)
def _no_groups(members: int) -> NDArray[np.float64]:
    """Return the cached group elements of a run without an attitude: an array without entries."""
    return np.zeros((members, 0, 0))


@lru_cache(maxsize=4)
def unit_groups(size: int) -> NDArray[np.float64]:
    """Return the cached unit element, (1, d, d); starts are read-only, so that runs may share it."""
    return np.eye(size)[None]


def _surely_regular(matrices: NDArray[np.float64]) -> bool:
    """Whether determinants prove that no matrix is singular, in a tenth of the time of a rank."""
    # With entries <= 1 the least singular value is >= |det| / d^(d-1); det is accurate to 2^(d-1) d^(d+2) roundings.
    d = matrices.shape[-1]
    largest = max(map(abs, matrices.ravel().tolist())) if matrices.size <= SMALL_SIZE else 0.0
    if largest == 0.0:
        return False
    smallest = min(map(abs, np.linalg.det(matrices.reshape(-1, d, d) / largest).tolist()))
    return smallest > (2.0 * d) ** (d + 2) * UNIT_ROUNDOFF


def _ranks(matrices: NDArray[np.float64]) -> NDArray[np.int64]:
    # Scaling preserves the rank, and keeps the squares of the entries from overflowing.
    size = np.max(np.abs(matrices), axis=(-2, -1), keepdims=True)
    return np.asarray(np.linalg.matrix_rank(matrices / np.where(size > 0.0, size, 1.0)), dtype=np.int64)


def representations_of(system: System | Batch, method: Method, attitude: Any) -> tuple[Representation, ...]:
    """Return the representation of the group element, (n, d, d), "coadjoint" or None, for each member."""
    if system.is_batch:
        of_systems = [_read_representation(member, method, attitude) for member in system.distinct]
        representations = tuple(of_systems[owner] for owner in system.owners.tolist())
    else:
        representations = (_read_representation(system, method, attitude),)
    shapes = [getattr(representation, "shape", ()) for representation in representations]
    other = next((m for m, shape in enumerate(shapes) if shape != shapes[0]), None)
    if other is not None:
        raise ValueError(
            f"member {other} of the batch has a representation of shape {shapes[other]} and member 0 of {shapes[0]}; "
            "an attitude needs matrices of one size"
        )
    return representations


def _read_representation(system: System, method: Method, attitude: Any) -> Representation:
    flag = attitude if is_attitude_kind(attitude) else True
    if flag in (False,):
        return None
    if system.algebra is None:
        raise ValueError(f"{system.name} has no Lie algebra, so it moves no group element; use attitude=False")
    if flag not in (True, "coadjoint"):
        raise ValueError(
            f"attitude is {short(attitude)}; it must be True, False, 'coadjoint' or an initial group element"
        )
    if flag != "coadjoint" and system.representation is None:
        raise ValueError(
            f"{system.name} has no representation for an attitude; give representation=, or use attitude='coadjoint'"
        )
    representation: Representation = "coadjoint" if flag == "coadjoint" else np.asarray(system.representation)
    method.check_attitude(system, representation)
    return representation
