"""Inertia of bodies, wheels and gyros: validation, correctly rounded inverses, symmetry, and warnings."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.long_operations import warn_caller
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.bodies.mass_properties import MassProperties
from coadjoint.validation import (
    as_tuples,
    check_finite,
    is_real,
    read_finite,
    read_list,
    read_number,
    read_numbers,
    read_positive,
)

MIN_MOMENT = 2.0**-1022  # smallest normal number: below it the inverse overflows


def read_inertia(inertia: Any, what: str = "inertia", centred: bool = True) -> npt.NDArray[np.float64]:
    """Return positive principal moments, (3,), or a tensor, (3, 3), which `inverse_of` finds positive definite."""
    # Without `centred` it is about another point than the centre of mass, or not of the body alone.
    if not centred and isinstance(inertia, MassProperties):
        raise TypeError(
            f"{what} is that about the centre of mass of {inertia.frame or 'a body'}; give the tensor that the system "
            "takes: about a fixed point it is the body's about(point), and a fluid adds to it"
        )
    array = _read_moments_or_tensor(inertia, what)
    return positive_moments(array, what) if array.ndim == 1 else array


def _read_moments_or_tensor(inertia: Any, what: str) -> npt.NDArray[np.float64]:
    """Validate moments, a tensor, or the mass properties of a body, of which it is the tensor in their frame."""
    if isinstance(inertia, MassProperties):
        diagonal = principal(inertia.inertia)
        inertia = inertia.inertia if diagonal is None else diagonal
    array = read_numbers(inertia, what)
    if array.shape not in ((3,), (3, 3)):
        raise ValueError(f"{what} has shape {array.shape}; give three principal moments, or a symmetric (3, 3)")
    check_finite(array, what)
    return array


def read_vector(values: npt.ArrayLike, what: str, n: int = 3) -> npt.NDArray[np.float64]:
    """Validate a vector of n finite numbers; `what` is its name in messages."""
    vector = read_finite(values, what)
    if vector.shape != (n,):
        raise ValueError(f"{what} has shape {vector.shape}; give {n} finite numbers")
    return vector


def principal(M: npt.NDArray[np.float64]) -> npt.NDArray[np.float64] | None:
    """Return the diagonal of an inertia or its inverse, or None if it is not diagonal."""
    if M.ndim == 1:
        return M
    return np.diag(M) if np.array_equal(M, np.diag(np.diag(M))) else None


def axis_of_symmetry(M: npt.NDArray[np.float64], vector: npt.NDArray[np.float64]) -> npt.NDArray[np.float64] | None:
    """Return the coordinate axis of symmetry, a unit vector, of an inverse inertia and a vector, or None."""
    m = principal(M)
    if m is None:
        return None
    for c in (2, 0, 1):
        a, b = (c + 1) % 3, (c + 2) % 3
        if m[a] == m[b] and vector[a] == vector[b] == 0.0:
            return np.eye(3)[c]
    if m[0] == m[1] == m[2]:
        scaled = np.ldexp(vector, -int(np.frexp(np.abs(vector).max())[1]))
        return scaled / np.sqrt((scaled**2).sum())
    return None


def momentum_along(axis: npt.NDArray[np.float64] | None, letter: str, n: int) -> dict[str, Polynomial]:
    """Return the momentum along an axis of symmetry by name, as an integral in n coordinates; empty without an axis."""
    if axis is None:
        return {}
    components = axis.tolist()
    name = f"{letter}{components.index(1.0) + 1}" if 1.0 in components else f"{letter} along the axis"
    return {
        name: sum((v * Polynomial.variable(i, n) for i, v in enumerate(components) if v), 0 * Polynomial.variable(0, n))
    }


def positive_moments(moments: npt.NDArray[np.float64], what: str) -> npt.NDArray[np.float64]:
    """Return moments that are positive and have finite inverses; raise ValueError for the first that does not."""
    for i, moment in enumerate(moments.tolist()):
        index = f"[{i}]" if len(moments) > 1 else ""
        if moment <= 0.0:
            raise ValueError(f"{what}{index} is {moment:g}; every principal moment must be positive")
        if moment < MIN_MOMENT:
            raise ValueError(f"{what}{index} is {moment:g}, and its inverse overflows; take larger units")
    return moments


def read_moment(size: float, what: str, least_ratio: float = 1.0) -> float:
    """Return a positive moment; `least_ratio` is that of the smallest moment to it."""
    value = read_number(size, what)
    for moment in (value, value * least_ratio):
        positive_moments(np.array([moment]), what)
    return value


def check_symmetric_matrix(matrix: npt.NDArray[np.float64], what: str) -> None:
    """Raise ValueError if a matrix is asymmetric by more than 64 u of its largest entry, with the entry."""
    with np.errstate(over="ignore"):
        asymmetry = np.abs(matrix - matrix.T)
    if asymmetry.max() > 64 * UNIT_ROUNDOFF * np.abs(matrix).max():
        i, j = (int(q) for q in np.unravel_index(np.argmax(asymmetry), matrix.shape))
        raise ValueError(f"{what} is not symmetric: {matrix[i, j]:g} and {matrix[j, i]:g} at [{i}, {j}] and [{j}, {i}]")


def inverse_of(matrix: npt.NDArray[Any], what: str) -> npt.NDArray[Any]:
    """Return the inverse of moments, or of a small positive definite matrix, correctly rounded by exact arithmetic."""
    # So it has the same bits on every machine, unlike LAPACK's. An imaginary part is a change to first order.
    if matrix.ndim == 1:
        return 1.0 / matrix
    if matrix.dtype.kind == "c":
        return with_change(inverse_of(matrix.real, what), matrix.imag)
    check_symmetric_matrix(matrix, what)
    n = len(matrix)
    unit = [[Fraction(int(i == j)) for j in range(n)] for i in range(n)]
    q = [[Fraction(float(matrix[min(i, j), max(i, j)])) for j in range(n)] + unit[i] for i in range(n)]
    for c in range(n):
        # Without pivoting the pivots are those of L D L^T, all positive if the matrix is positive definite.
        if q[c][c] <= 0:
            raise ValueError(
                f"{what} {short(matrix.tolist())} is not positive definite; every principal moment must be positive"
            )
        q[c] = [entry / q[c][c] for entry in q[c]]
        for i in range(n):
            if i != c and q[i][c]:
                q[i] = [entry - q[i][c] * pivot for entry, pivot in zip(q[i], q[c], strict=True)]
    try:
        return np.array([[float(entry) for entry in row[n:]] for row in q])
    except OverflowError:
        raise ValueError(f"{what} {short(matrix.tolist())} has an inverse that overflows; take larger units") from None


def with_change(inverse: npt.NDArray[np.float64], change: npt.NDArray[np.float64]) -> npt.NDArray[np.complex128]:
    """Return the inverse of a matrix plus i times a small change, to first order, from the inverse of the matrix."""
    return np.asarray(inverse - 1j * np.einsum("ij,jk,kl->il", inverse, change, inverse))


def read_in_range(value: Any, what: str, zero: bool = False) -> float:
    """Return a positive number whose inverse is finite, or zero if that is allowed; `what` is its name in messages."""
    if zero and read_number(value, what) == 0.0:
        return 0.0
    number = read_positive(value, what)
    if not MIN_MOMENT <= number <= 1.0 / MIN_MOMENT:
        raise ValueError(
            f"{what} is {number:g}, and its inverse leaves the range of float64; take units in which it is between "
            f"{MIN_MOMENT:g} and {1.0 / MIN_MOMENT:g}"
        )
    return number


@np.errstate(all="ignore")
def check_products(what: str, products: Callable[[], npt.ArrayLike]) -> None:
    """Raise ValueError if a product of positive numbers, not finite or below `MIN_MOMENT`, has left float64."""
    for product in np.ravel(np.asarray(products(), dtype=np.float64)).tolist():
        if not MIN_MOMENT <= product <= 1.0 / MIN_MOMENT:
            raise ValueError(f"{what} have products ({product:g}) that leave the range of float64; change units")


ROUNDING_TOLERANCE = 64 * UNIT_ROUNDOFF  # relative tolerance for rounded input
_QUADRATIC_FORM_HINT = "for another quadratic form use co.LiePoissonSystem(co.algebras.{}, co.Quadratic(...), sign=-1)"


def warn_unphysical_inertia(inertia: npt.ArrayLike, algebra: str | None = "so(3)", what: str = "inertia") -> None:
    """Warn if a principal moment exceeds the sum of the other two by more than round-off (equal in a flat body)."""
    # `algebra` is the one suggested for a quadratic form, None for bodies only.
    array = np.asarray(inertia, dtype=np.float64)
    tensor = np.diag(array) if array.ndim == 1 else array
    # Scaling keeps the ratios of the moments, and their sum does not overflow.
    scaled = tensor / np.abs(tensor).max()
    moments = np.diag(scaled) if array.ndim == 1 else np.linalg.eigvalsh(scaled)
    if 2.0 * moments.max() - moments.sum() > ROUNDING_TOLERANCE * moments.sum():
        text = f"{what}: a principal moment exceeds the sum of the other two, which no body has"
        hint = "" if algebra is None else f"; {_QUADRATIC_FORM_HINT.format(algebra)}"
        warn_caller(text + hint, UserWarning)


def warn_negative_mass(second_moments: npt.NDArray[np.float64]) -> None:
    """Warn if a second moment of the mass, (n,) principal or (n, n), is negative by more than round-off."""
    principal = second_moments if second_moments.ndim == 1 else np.linalg.eigvalsh(second_moments)
    if principal.min() < -ROUNDING_TOLERANCE * np.abs(principal).max():
        hint = _QUADRATIC_FORM_HINT.format(f"so({len(principal)})")
        warn_caller(f"inertia: a second moment of the mass is negative, which no body has; {hint}", UserWarning)


Floats = npt.NDArray[np.float64]

ROD_TOLERANCE = 64 * UNIT_ROUNDOFF
"""Relative deviation below which a tensor counts as that of a rod: its square is a multiple of it."""


class BodyInertia(NamedTuple):
    """The inertia of a body as given, as a tensor, and its inverse, (3,) or (3, 3), on directions that rotate it."""

    # `rotating` is the projection on these directions for a rod or a point, and None for other bodies.

    given: Any
    tensor: Floats
    inverse: Floats
    rotating: Floats | None = None
    source: MassProperties | None = None
    """The body from a file, which has a mass, and may have higher moments."""

    @property
    def inverse_matrix(self) -> Floats:
        """The inverse as a matrix, (3, 3)."""
        return np.diag(self.inverse) if self.inverse.ndim == 1 else self.inverse

    @property
    def anisotropic(self) -> Floats:
        """The tensor without its isotropic part: the trace is zero, and the moments of a ball vanish exactly."""
        return np.asarray(anisotropic_part(self.tensor), dtype=np.float64)


def anisotropic_part(tensor: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a tensor without its isotropic part, real or complex, from differences of its moments."""
    result = tensor.copy()
    for i in range(3):
        a, b, c = (tensor[j, j] for j in (i, (i + 1) % 3, (i + 2) % 3))
        result[i, i] = ((a - b) + (a - c)) / 3.0
    return result


def read_body_inertia(inertia: Any, what: str = "inertia") -> BodyInertia:
    """Validate principal moments or a tensor; the moment along a rod, and all those of a point, may be zero."""
    array, source = _read_moments_or_tensor(inertia, what), inertia if isinstance(inertia, MassProperties) else None
    if not array.any():
        return BodyInertia(as_tuples(array), np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3)), source)
    inverse, rotating = (_inverse_moments if array.ndim == 1 else _inverse_tensor)(array, what)
    warn_unphysical_inertia(array, None, what)
    tensor = np.diag(array) if array.ndim == 1 else np.triu(array) + np.triu(array, 1).T
    return BodyInertia(as_tuples(array), tensor, inverse, rotating, source)


def read_bodies(inertias: Any, masses: Any, usual: tuple[float, ...]) -> tuple[tuple[BodyInertia, ...], Floats]:
    """Validate the inertia and the mass of each of several bodies; bodies from files have theirs."""
    found = read_inertias(inertias)
    if masses is None:
        own = [None if one.source is None else one.source.mass for one in found]
        missing = [k for k, mass in enumerate(own) if mass is None]
        if missing and len(missing) < len(own):
            raise ValueError(f"masses is missing, and inertias[{missing[0]}] has no mass of its own; give all masses")
        return found, read_masses(usual if missing else own, found)
    given = read_masses(masses, found)
    for k, one in enumerate(found):
        check_own_mass(one, float(given[k]), f"masses[{k}]", f"inertias[{k}]")
    return found, given


def check_own_mass(inertia: BodyInertia, mass: float, what: str, whose: str = "inertia") -> None:
    """Raise ValueError if a body from a file has another mass than is given."""
    own = None if inertia.source is None else inertia.source.mass
    if own is not None and abs(mass - own) > ROUNDING_TOLERANCE * own:
        raise ValueError(f"{what} is {mass:g}, and {whose} has the mass {own:g}; give this one")


def read_masses(masses: Any, inertias: Any) -> Floats:
    """Validate one positive mass for each body."""
    m = read_finite(masses, "masses")
    if m.shape != (len(inertias),):
        raise ValueError(f"masses has shape {m.shape}, and inertias {len(inertias)} bodies; give one mass for each")
    for k, value in enumerate(m.tolist()):
        read_in_range(value, f"masses[{k}]")
    return m


def read_inertias(inertias: Any) -> tuple[BodyInertia, ...]:
    """Validate the inertia of each of several bodies, with the number of the one that is wrong."""
    rule = "give one inertia for each body, such as [(1, 2, 2.5), (1, 1, 1)]"
    listed = read_list(inertias, "inertias", rule)
    if not listed or any(map(is_real, listed)):
        raise ValueError(f"inertias is {short(inertias)}; {rule}")
    return tuple(read_body_inertia(entry, f"inertias[{k}]") for k, entry in enumerate(listed))


def inverse_of_moving(inertia: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the inverse of moments, zero where they are, or of a tensor, of a point or no rod; also complex."""
    if inertia.ndim == 2 and inertia.real.any():
        return inverse_of(inertia, "inertia")
    inverse = np.zeros_like(inertia)
    moving = inertia.real != 0.0
    inverse[moving] = 1.0 / inertia[moving]
    return inverse


def _inverse_moments(moments: Floats, what: str) -> tuple[Floats, Floats | None]:
    zero = np.flatnonzero(moments == 0.0)
    if not len(zero):
        return 1.0 / positive_moments(moments, what), None
    others = np.delete(moments, zero)
    # The mass of a body without a moment about an axis lies on that axis.
    if len(zero) > 1 or others[0] != others[1]:
        raise ValueError(
            f"{what}[{zero[0]}] is 0, as that of a rod along this axis, but the other moments are "
            f"{' and '.join(f'{m:g}' for m in np.delete(moments, zero[0]).tolist())}; those of a rod are equal"
        )
    positive_moments(others, what)
    inverse = np.zeros(3)
    inverse[moments != 0.0] = 1.0 / others
    return inverse, np.diag((moments != 0.0).astype(np.float64))


def _inverse_tensor(tensor: Floats, what: str) -> tuple[Floats, Floats | None]:
    check_symmetric_matrix(tensor, what)
    size = tensor.trace() / 2
    with np.errstate(all="ignore"):
        scaled = tensor / size if size else tensor
        defect = np.abs(np.einsum("ij,jk->ik", scaled, scaled) - scaled).max()
    # A rod with the direction n has the tensor I (1 - n n), whose square is I times itself.
    if size > 0 and defect <= ROD_TOLERANCE:
        positive_moments(np.array([size]), what)
        return np.asarray(scaled / size), scaled
    return inverse_of(tensor, what), None


GYRO_TOLERANCE = 1e-9
"""Largest relative difference of the two momenta of a gyro, and of their angle from a right one, that is rounding."""


# Wheels, (m, 3), are moments times axes, and gyros, (g, 2, 3), two momenta each. A state carries the momentum of
# each wheel about its axis, then the cosine and the sine of each gimbal angle.
NO_WHEELS, NO_GYROS = np.zeros((0, 3)), np.zeros((0, 2, 3))


def names_of_rotors(wheels: Floats, gyros: Floats) -> tuple[str, ...]:
    """Return the names of the numbers that the state carries."""
    gimbals = tuple(f"{name}{k + 1}" for k in range(len(gyros)) for name in ("cos", "sin"))
    return (*(f"k{i + 1}" for i in range(len(wheels))), *gimbals)


def read_rotors(wheels: Any, gyros: Any, inertia: BodyInertia) -> tuple[Floats, Floats]:
    """Validate wheels and gyros of a body."""
    turning, steering = read_finite(wheels, "wheels"), read_finite(gyros, "gyros")
    turning = turning.reshape(0, 3) if turning.shape == (0,) else turning
    steering = steering.reshape(0, 2, 3) if steering.shape == (0,) else steering
    if turning.ndim != 2 or turning.shape[1] != 3:
        raise ValueError(f"wheels has shape {turning.shape}; give (m, 3), of each wheel its moment times its axis")
    if steering.ndim != 3 or steering.shape[1:] != (2, 3):
        raise ValueError(
            f"gyros has shape {steering.shape}; give (g, 2, 3), of each gyro its momentum at the gimbal angles 0 and "
            "90 degrees"
        )
    for what, array in (("wheels", turning), ("gyros", steering)):
        zero = np.argwhere(~array.any(axis=-1))
        if len(zero):
            raise ValueError(f"{what}[{zero[0, 0]}] has a vector that is zero; leave it out")
    for k, (first, second) in enumerate(steering):
        a, b = moments_of_wheels(steering[k])
        if abs(a - b) > GYRO_TOLERANCE * a or abs((first * second).sum()) > GYRO_TOLERANCE * a * b:
            raise ValueError(
                f"gyros[{k}] is {short(steering[k].tolist())}; its momenta at the gimbal angles 0 and 90 degrees must "
                "be orthogonal and of equal length"
            )
    if len(turning) + len(steering) and inertia.rotating is not None:
        raise ValueError("inertia is that of a rod, which carries no wheels or gyros; give three positive moments")
    if len(turning):
        without_wheels(inertia.tensor, turning)
    return turning, steering


def without_wheels(tensor: npt.NDArray[Any], wheels: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the inverse of an inertia tensor without the moments of the wheels about their axes; real or complex."""
    inner = tensor - np.einsum("mi,mj->ij", wheels / moments_of_wheels(wheels)[:, None], wheels)
    try:
        return inverse_of(inner, "inertia")
    except ValueError:
        raise ValueError(
            "the moments of wheels exceed inertia; it is that of the body with its wheels, locked"
        ) from None


def energy_with_rotors(
    tensor: npt.NDArray[Any], wheels: npt.NDArray[Any], gyros: npt.NDArray[Any], first: int, dim: int
) -> npt.NDArray[Any]:
    """Return the matrix of the energy of body and rotors, whose numbers in the state begin at `first`."""
    # With the momentum L of all and R y of the rotors, ``(L - R y) . M (L - R y) / 2`` and that of the wheels, y^2 over
    # twice the moment, y the momentum about the axis in space.
    M, R = without_wheels(tensor, wheels), momenta_of_rotors(wheels, gyros)
    matrix = np.zeros((dim, dim), dtype=np.result_type(M, R))
    crossed = np.einsum("ij,qj->iq", M, R)
    end, count = first + len(R), len(wheels)
    matrix[:3, :3] = M
    matrix[:3, first:end], matrix[first:end, :3] = -crossed, -crossed.T
    matrix[first:end, first:end] = np.einsum("pi,iq->pq", R, crossed)
    matrix[range(first, first + count), range(first, first + count)] += 1.0 / moments_of_wheels(wheels)
    return matrix


def moments_of_wheels(wheels: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the moment of inertia of each wheel about its axis, (m,)."""
    return np.asarray(np.sqrt((wheels * wheels).sum(axis=-1)))


def momenta_of_rotors(wheels: npt.NDArray[Any], gyros: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the momentum in the body frame for a unit of each number that the state carries, (m + 2 g, 3)."""
    return np.concatenate([wheels / moments_of_wheels(wheels)[:, None], gyros.reshape(-1, 3)])
