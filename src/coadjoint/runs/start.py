"""The state at the start of a run: momenta of all members, and the group element where an attitude is asked for."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.group_elements import are_rotations, why_no_automorphism, why_no_element
from coadjoint.given import FEW, are_finite, read_numbers
from coadjoint.memory import check_room
from coadjoint.methods.attitude import check_attitude
from coadjoint.methods.base import Method
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.batch import Batch
from coadjoint.systems.kinds import System, check_system, shape_of, unforced
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.wording import short

Representation = NDArray[np.float64] | str | None


class Start(NamedTuple):
    """Initial momenta (members, n), group elements (members, d, d), and how they were given.

    `representation` is what the elements are in; of a batch, what those of its first member are in. `shape` is that of
    a state.
    """

    momenta: NDArray[np.float64]
    groups: NDArray[np.float64]
    representation: Representation
    single: bool
    shape: tuple[int, ...]

    @property
    def carried(self) -> str | None:
        """In which matrices the group element is: "representation", "coadjoint", or None where there is none."""
        if self.representation is None:
            return None
        return "coadjoint" if isinstance(self.representation, str) else "representation"


def start_of(system: System | Batch, method: Method, x0: Any, attitude: Any) -> Start:
    """Check the initial state and the attitude.

    Parameters
    ----------
    system : LiePoissonSystem, PoissonSystem or Batch
        The system.
    method : Method
        The scheme; it refuses an attitude that it cannot keep.
    x0 : array_like, shape (n,) or (members, n)
        Initial momentum.
    attitude : bool, "coadjoint", or array_like of shape (d, d) or (members, d, d)
        What to carry beside the momentum.

    Returns
    -------
    Start
        Copies.

    Raises
    ------
    ValueError
        Naming what does not fit.
    """
    check_system(system)
    momenta, single = momenta_of(system, x0)
    return with_group(system, momenta, single, representations_of(system, method, attitude)[0], attitude)


def momenta_of(system: System | Batch, x0: Any) -> tuple[NDArray[np.float64], bool]:
    """Return initial momenta (members, n), and whether one state was given for one system.

    Parameters
    ----------
    system : LiePoissonSystem, PoissonSystem or Batch
        The system; of a batch every member has its own state, or all have the same one.
    x0 : array_like, shape (n,) or (members, n)
        Initial momentum.

    Returns
    -------
    momenta : ndarray, shape (members, n)
        A copy.
    single : bool

    Raises
    ------
    ValueError
        Of another shape, empty, or not finite.
    """
    plain = unforced(system)
    if isinstance(plain, MatrixSystem):
        rows = plain.read(x0)
        if not len(rows):
            raise ValueError(f"x0 has the shape {np.shape(x0)}; an ensemble needs at least one member")
        return rows.reshape(-1, system.dim), rows.ndim == 1
    momenta = read_numbers(x0, "x0")
    n, shape = system.dim, shape_of(system)
    if len(shape) > 1:
        if momenta.shape[-len(shape) :] != shape or momenta.ndim > len(shape) + 1:
            raise ValueError(f"x0 has the shape {momenta.shape}; it must be {shape} or (members, {str(shape)[1:]}")
        momenta = momenta.reshape(*momenta.shape[: -len(shape)], n)
    single = momenta.ndim == 1
    if isinstance(system, Batch):
        if momenta.shape not in ((n,), (len(system), n)):
            raise ValueError(
                f"x0 has the shape {momenta.shape}; a batch of {len(system)} members needs ({len(system)}, {n}), "
                f"or ({n},) for all of them"
            )
        momenta, single = np.array(np.broadcast_to(momenta, (len(system), n)), order="C"), False
    if momenta.ndim not in (1, 2) or momenta.shape[-1] != n:
        one = "; np.ravel(x0) makes one state of its numbers" if momenta.size == n else ""
        raise ValueError(f"x0 has the shape {momenta.shape}; it must be ({n},) or (members, {n}){one}")
    if not are_finite(momenta):
        raise ValueError("x0 contains NaN or infinity; every component must be finite")
    if momenta.ndim == 1:
        momenta = momenta[None]
    if not len(momenta):
        raise ValueError(f"x0 has the shape {np.shape(x0)}; an ensemble needs at least one member")
    return np.ascontiguousarray(momenta), single


def with_group(
    system: System | Batch, momenta: NDArray[np.float64], single: bool, representation: Any, attitude: Any
) -> Start:
    """Return the start of a run from checked momenta and a checked representation.

    Parameters
    ----------
    system : LiePoissonSystem, PoissonSystem or Batch
        For messages, and its dimension.
    momenta : ndarray, shape (members, n)
        Initial momenta.
    single : bool
        Whether the solution has no axis of members.
    representation : ndarray of shape (n, d, d), "coadjoint", or None
        From `representations_of`.
    attitude : bool, "coadjoint", or array_like of shape (d, d) or (members, d, d)
        The initial element, the unit where it is no array.

    Returns
    -------
    Start

    Raises
    ------
    ValueError
        The initial element has another shape, is not finite, singular, or no element of the group.
    """
    if representation is None:
        return Start(momenta, np.zeros((len(momenta), 0, 0)), None, single, shape_of(system))
    size = system.dim if isinstance(representation, str) else representation.shape[1]
    if len(momenta) * size**2 > FEW:
        check_room(8 * (len(momenta) + 2) * size**2, f"the group elements of {len(momenta)} members, {size} x {size},")
    if isinstance(attitude, bool | np.bool_ | str):
        units = _unit(size) if len(momenta) == 1 else np.tile(_unit(size), (len(momenta), 1, 1))
        return Start(momenta, units, representation, single, shape_of(system))
    initial = read_numbers(attitude, "attitude")
    if initial.shape not in ((size, size), (len(momenta), size, size)):
        raise ValueError(
            f"attitude has the shape {initial.shape}; the representation of {system.name} needs ({size}, {size})"
        )
    if not are_finite(initial):
        raise ValueError("attitude contains NaN or infinity; every entry must be finite")
    if isinstance(representation, str) or not are_rotations(initial, representation):
        if not _surely_regular(initial) and np.any(_ranks(initial) < size):
            raise ValueError("attitude is a singular matrix; a group element has an inverse")
        _check_elements(system, initial.reshape(-1, size, size), representation)
    shared = initial.ndim == 2 and len(momenta) > 1
    groups = np.tile(initial, (len(momenta), 1, 1)) if shared else np.ascontiguousarray(initial).reshape(-1, size, size)
    return Start(momenta, groups, representation, single, shape_of(system))


def _check_elements(system: System | Batch, groups: NDArray[np.float64], representation: Any) -> None:
    first: Any = system[0] if isinstance(system, Batch) else system
    if isinstance(representation, str):
        why = why_no_automorphism(groups, unforced(first).algebra.structure_matrix)
    else:
        why = why_no_element(groups, representation)
    if why is not None:
        raise ValueError(f"attitude is no element of the group of {first.name}: {why}")


@lru_cache(maxsize=4)
def _unit(size: int) -> NDArray[np.float64]:
    """Return one unit element. Nobody writes to the start of a run, so that many runs may share it."""
    return np.eye(size)[None]


def _surely_regular(matrices: NDArray[np.float64]) -> bool:
    """Return whether determinants tell that no matrix is singular, in a tenth of the time that a rank takes.

    With entries of at most 1 singular values are at most d. The least is then |det| / d^(d - 1) or more, and a rank
    counts those above 2 d^2 round-offs. A determinant is right to 2^(d - 1) d^(d + 2) round-offs. Both are far below.
    """
    d = matrices.shape[-1]
    largest = max(map(abs, matrices.ravel().tolist())) if matrices.size <= FEW else 0.0
    if largest == 0.0:
        return False
    least = min(map(abs, np.linalg.det(matrices.reshape(-1, d, d) / largest).tolist()))
    return least > (2.0 * d) ** (d + 2) * UNIT_ROUNDOFF


def _ranks(matrices: NDArray[np.float64]) -> NDArray[np.int64]:
    # A multiple has the same rank, and the squares of its entries do not overflow.
    size = np.max(np.abs(matrices), axis=(-2, -1), keepdims=True)
    return np.asarray(np.linalg.matrix_rank(matrices / np.where(size > 0.0, size, 1.0)), dtype=np.int64)


def representations_of(system: System | Batch, method: Method, attitude: Any) -> tuple[Representation, ...]:
    """Return what the group element of each system is carried in, one for a system and one for each of a batch.

    Parameters
    ----------
    system : LiePoissonSystem, PoissonSystem or Batch
        The system.
    method : Method
        The scheme.
    attitude : bool, "coadjoint", or array_like
        What was asked for.

    Returns
    -------
    tuple of (ndarray of shape (n, d, d), "coadjoint", or None)

    Raises
    ------
    ValueError
        There is none, the scheme cannot keep it, or the members of a batch have matrices of different sizes.
    """
    if not isinstance(system, Batch):
        return (_representation(system, method, attitude),)
    found = tuple(_representation(member, method, attitude) for member in system)
    shapes = [getattr(representation, "shape", ()) for representation in found]
    other = next((m for m, shape in enumerate(shapes) if shape != shapes[0]), None)
    if other is not None:
        raise ValueError(
            f"member {other} of the batch has a representation of shape {shapes[other]} and member 0 of {shapes[0]}; "
            "an attitude needs matrices of one size"
        )
    return found


def _representation(system: System, method: Method, attitude: Any) -> Representation:
    if isinstance(attitude, bool | np.bool_) and not attitude:
        return None
    if system.algebra is None:
        raise ValueError(f"{system.name} has no Lie algebra, so it moves no group element; use attitude=False")
    if isinstance(attitude, str) and attitude != "coadjoint":
        raise ValueError(
            f"attitude is {short(attitude)}; it must be True, False, 'coadjoint' or an initial group element"
        )
    if not isinstance(attitude, str) and system.representation is None:
        raise ValueError(
            f"{system.name} has no representation for an attitude; give representation=, or use attitude='coadjoint'"
        )
    representation = attitude if isinstance(attitude, str) else np.asarray(system.representation)
    check_attitude(method, system, representation)
    return representation
