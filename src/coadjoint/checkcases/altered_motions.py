"""Motions of the body of a check-case by other laws, many at once: those of common mistakes, and fitted numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import combinations, permutations, product
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.representation import quaternion_matrix
from coadjoint.checkcases.check_case import ATTITUDE, RATES, BodyModel, Columns

Floats = npt.NDArray[np.float64]
Field = Callable[[float, Floats], Floats]
"""Derivative of rates and quaternion, or of the rates alone, from both: seven numbers, or (7, m) of m laws."""

RELATIVE_TOLERANCE = 1e-12  # of DOP853, near the least that it takes
MOTION_ACCURACY = 1e-9  # relative, of these motions: what is left below it is no further mistake
MAX_EVALUATIONS = 30_000  # of the field, three seconds or some 400 radians; later samples are left out
LEAST_ROWS = 4
SIMPLE_FACTORS = {1 / 3: "a third of", 0.5: "half of", 2.0: "twice", 3.0: "three times"}


class Law(NamedTuple):
    """Numbers of the law by which a body moves, ``I w' = g (I w + k) x w + N`` and ``q' = (r q w + l w q)/2``.

    `torque` is the matrix from the torque of the case to N, which is then turned by the attitude, from the body to
    space, where `turned` is 1, and back where it is -1. A stack of m laws has a last axis of m in every field.
    """

    inertia: Floats
    rates: Floats
    rotors: Floats
    torque: Floats = np.eye(3)
    turned: Any = 0.0
    gyroscopic: Any = 1.0
    right: Any = 1.0
    left: Any = 0.0


class Alteration(NamedTuple):
    """A law with a mistake, its sentence, and its kind: of one kind, the first of those with equal motions counts."""

    kind: str
    sentence: str
    law: Law


class FittedNumber(NamedTuple):
    """A number of a law that may be another multiple, within bounds, and the sentence for a factor."""

    kind: str
    law: Callable[[float], Law]
    sentence: Callable[[float], str]
    bounds: tuple[float, float] = (0.5, 2.0)


def law_of(body: BodyModel) -> Law:
    """Return the law of the case itself."""
    return Law(body.inertia, body.rates, body.rotors)


def cross(a: Floats, b: Floats) -> Floats:
    """Return the vector product of components (3,) or (3, m)."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def apply(matrix: Floats, v: Floats) -> Floats:
    """Return the product of a matrix (3, 3) or (3, 3, m) with components (3,) or (3, m)."""
    return np.asarray((matrix * v).sum(axis=1))


def quaternion_product(q: Floats, v: Floats, order: float = 1.0) -> Floats:
    """Return the quaternion product q (0, v), scalar first, or (0, v) q for an order of -1."""
    a, b, c, d = q
    x, y, z = v
    return np.array(
        [
            -b * x - c * y - d * z,
            a * x + order * (c * z - d * y),
            a * y + order * (d * x - b * z),
            a * z + order * (b * y - c * x),
        ]
    )


def matrix_of(q: Floats) -> Floats:
    """Return the rotation matrix of a quaternion, scalar first, of any norm: (3, 3) or (3, 3, m)."""
    return quaternion_matrix(*(q / np.sqrt((q * q).sum(axis=0))))


def velocity_field(body: BodyModel, law: Law, held: list[Floats] | None = None) -> Field:
    """Return the derivative of the rates; `held` contains the torque of the case, if it is constant for a period."""
    # The rates about an axis without a moment are constant.
    inverse: Any = np.moveaxis(np.linalg.pinv(np.moveaxis(law.inertia, (0, 1), (-2, -1))), (-2, -1), (0, 1))
    is_turned = bool(np.any(law.turned))

    def velocity(t: float, y: Floats) -> Floats:
        w = y[:3]
        moment = law.gyroscopic * cross(apply(law.inertia, w) + law.rotors, w)
        if body.torque is not None:
            given = body.torque(t, y[3:], w, law.inertia) if held is None else held[0]
            given = apply(law.torque, given)
            if is_turned:
                A = matrix_of(y[3:])
                back = (A * given[:, None]).sum(axis=0)
                given = np.where(law.turned > 0.0, apply(A, given), np.where(law.turned < 0.0, back, given))
            moment = moment + given
        return apply(inverse, moment)

    return velocity


def motion_field(body: BodyModel, law: Law, held: list[Floats] | None = None) -> Field:
    """Return the derivative of rates and quaternion."""
    velocity, is_reversed = velocity_field(body, law, held), bool(np.any(law.left))

    def field(t: float, y: Floats) -> Floats:
        q, w = y[3:], y[:3]
        slope = 0.5 * law.right * quaternion_product(q, w)
        if is_reversed:
            slope = slope + 0.5 * law.left * quaternion_product(q, w, -1.0)
        return np.concatenate([velocity(t, y), slope])

    return field


def motions(body: BodyModel, laws: Sequence[Law], times: Floats, size: float) -> list[Columns]:
    """Return the columns of the motions by several laws, at the first times, as far as they are reached.

    `size` is that of the rates, rad/s.
    """
    from scipy.integrate import DOP853

    m = len(laws)
    law = Law(*(np.stack(np.broadcast_arrays(*each), axis=-1) for each in zip(*laws, strict=True)))
    y = np.concatenate([law.rates, np.repeat(body.attitude[:, None], m, axis=1)])
    scale: Any = np.repeat([size or 1.0] * 3 + [1.0] * 4, m)
    held: list[Floats] = []
    field = motion_field(body, law, None if body.period is None else held)

    def flat(t: float, values: Floats) -> Floats:
        slope = field(t, values.reshape(7, m)).ravel()
        if not np.isfinite(slope).all():
            raise FloatingPointError  # DOP853 does not end at numbers that are not finite
        return slope

    values = np.empty((len(times), 7, m))
    reached = int(np.searchsorted(times, 0.0, side="right"))
    values[:reached] = y
    t, pieces, evaluations = 0.0, 0, 0
    with np.errstate(all="ignore"), suppress(FloatingPointError):
        while reached < len(times) and evaluations < MAX_EVALUATIONS:
            pieces += 1
            end = float(times[-1])
            if body.period is not None and body.torque is not None:
                end = min(end, pieces * body.period)
                held[:] = [body.torque(t, y[3:], y[:3], law.inertia)]
            solver = DOP853(
                flat, t, y.ravel(), end, rtol=RELATIVE_TOLERANCE, atol=RELATIVE_TOLERANCE * scale, vectorized=False
            )
            while solver.status == "running" and evaluations + solver.nfev < MAX_EVALUATIONS:
                solver.step()
                until = int(np.searchsorted(times, solver.t, side="right"))
                if until > reached:
                    values[reached:until] = solver.dense_output()(times[reached:until]).T.reshape(-1, 7, m)
                    reached = until
            if solver.status != "finished":
                break
            evaluations += solver.nfev
            t, y = end, solver.y.reshape(7, m)
    found = values[:reached]
    found[:, 3:] /= np.sqrt((found[:, 3:] ** 2).sum(axis=1, keepdims=True))
    return [dict(zip((*RATES.columns, *ATTITUDE.columns), found[:, :, k].T, strict=True)) for k in range(m)]


def alterations(body: BodyModel) -> Iterator[Alteration]:
    """Yield the laws of common mistakes, simpler ones first."""
    law = law_of(body)
    yield from _torques(body, law)
    if body.rotors.any():
        yield Alteration("rotor", "the rotor is left out", law._replace(rotors=np.zeros(3)))
        yield Alteration("rotor", "the momentum of the rotor has the opposite sign", law._replace(rotors=-body.rotors))
        for matrix, _ in _exchanges():
            k = matrix @ body.rotors
            sentence = f"the momentum of the rotor is ({_numbers(k)}), not ({_numbers(body.rotors)}) kg m^2/s"
            yield Alteration("rotor", sentence, law._replace(rotors=k))
    for sentence, tensor in _tensors(body):
        if _is_tensor(tensor):
            yield Alteration("tensor", sentence, law._replace(inertia=tensor))
    missing = "the gyroscopic torque w x I w is missing"
    missing += ": the rates are constant" if body.is_free else ""
    yield Alteration("gyroscopic", missing, law._replace(gyroscopic=0.0))
    opposite = "the gyroscopic torque has the opposite sign, w x I w for (I w) x w"
    yield Alteration("gyroscopic", opposite, law._replace(gyroscopic=-1.0))
    order = "the quaternion is multiplied in the wrong order, q' = (0, w) q/2: rates of the body are taken for those "
    yield Alteration("kinematics", f"{order}in space", law._replace(right=0.0, left=1.0))
    half = "the half of q' = q (0, w)/2 is missing: the attitude turns twice as fast as the rates"
    yield Alteration("kinematics", half, law._replace(right=2.0))


def _torques(body: BodyModel, law: Law) -> Iterator[Alteration]:
    if body.torque is None:
        return
    zero = np.zeros((3, 3))
    free = "" if body.rotors.any() else ": the samples are the motion of the free body"
    yield Alteration("torque", f"the torque is missing{free}", law._replace(torque=zero))
    yield Alteration("torque", "the torque has the opposite sign", law._replace(torque=-np.eye(3)))
    for factor, words in SIMPLE_FACTORS.items():
        sentence = f"the torque is {words} that of the case"
        yield Alteration("torque", sentence, law._replace(torque=factor * np.eye(3)))
    for turned, sentence in (
        (-1.0, "the torque acts along the axes of space, with its components of the body"),
        (1.0, "the torque acts along the axes of the body, with its components in space"),
    ):
        yield Alteration("axes of the torque", sentence, law._replace(turned=turned))
    for matrix, names in _exchanges():
        sentence = f"the axes of the torque are exchanged: x, y, z hold {names}"
        yield Alteration("axes of the torque", sentence, law._replace(torque=matrix))


def _exchanges() -> Iterator[tuple[Floats, str]]:
    """Yield exchanges of axes with signs, fewer signs first, without plus and minus one, and their names."""
    signs = sorted(product((1.0, -1.0), repeat=3), key=lambda each: -sum(each))
    for sign, order in product(signs, permutations(range(3))):
        if order != (0, 1, 2) or len(set(sign)) > 1:
            names = ", ".join(f"{'' if s > 0 else '-'}{'xyz'[k]}" for k, s in zip(order, sign, strict=True))
            yield np.array(sign)[:, None] * np.eye(3)[list(order)], names


def _tensors(body: BodyModel) -> Iterator[tuple[str, Floats]]:
    inertia, R = body.inertia, body.principal_axes
    diagonal = np.diag(np.diag(inertia))
    if np.abs(inertia - diagonal).max() > 0.0:
        yield "the products of inertia have the opposite sign", 2.0 * diagonal - inertia
        yield "the products of inertia are left out", diagonal
        if R is not None:
            moments = np.diag(R.T @ inertia @ R)
            turned = R.T @ (moments[:, None] * R)
            yield "the tensor is transposed: its principal axes are turned the other way", turned
            yield "the tensor is that of the principal axes, without their rotation", np.diag(moments)
    if body.is_free and np.linalg.matrix_rank(inertia) == 3:
        yield "the inverse of the tensor was taken for it", np.asarray(np.linalg.inv(inertia), dtype=np.float64)
    for i, j in combinations(range(3), 2):
        if inertia[i, j]:
            other = inertia.copy()
            other[i, j] = other[j, i] = -inertia[i, j]
            yield f"the product of inertia I_{'xyz'[i]}{'xyz'[j]} has the opposite sign", other
    for order in list(permutations(range(3)))[1:]:
        named = ", ".join("xyz"[k] for k in order)
        yield f"the moments are exchanged: x, y, z have those of {named}", inertia[np.ix_(order, order)]


def _is_tensor(tensor: Floats) -> bool:
    moments = np.linalg.eigvalsh(tensor)
    return bool(moments[0] > 0.0 and moments[0] + moments[1] >= moments[2] * (1.0 - 1e-12))


def fitted_numbers(body: BodyModel) -> Iterator[FittedNumber]:
    """Yield the numbers of a case that a simulator may have with other values."""
    law, I = law_of(body), body.inertia
    if body.torque is not None:
        yield FittedNumber(
            "torque",
            lambda s: law._replace(torque=s * np.eye(3)),
            lambda s: f"the torque is {s:.6g} times as large",
            (-10.0, 10.0),
        )
    if body.rotors.any():
        yield FittedNumber(
            "rotor",
            lambda s: law._replace(rotors=s * body.rotors),
            lambda s: f"the momentum of the rotor is {s:.6g} times as large",
            (-10.0, 10.0),
        )
    parts = [(f"moment of inertia about {'xyz'[k]}", I[k, k] * np.diag(np.eye(3)[k])) for k in range(3)]
    if body.principal_axes is not None:
        R = body.principal_axes
        moments = np.diag(R.T @ I @ R)
        parts += [(f"principal moment {k + 1}", moments[k] * np.outer(R[:, k], R[:, k])) for k in range(3)]
    for i, j in combinations(range(3), 2):
        unit = np.zeros((3, 3))
        unit[i, j] = unit[j, i] = I[i, j]
        parts.append((f"product of inertia I_{'xyz'[i]}{'xyz'[j]}", unit))
    for name, part in parts:
        value = float(np.trace(part)) or float(part.sum() / 2.0)
        if value:
            yield FittedNumber(name, _with_part(law, part), _part_sentence(name, value))


def _with_part(law: Law, part: Floats) -> Callable[[float], Law]:
    return lambda factor: law._replace(inertia=law.inertia + (factor - 1.0) * part)


def _part_sentence(name: str, value: float) -> Callable[[float], str]:
    def sentence(factor: float) -> str:
        change = f"{abs(factor - 1.0) * 100.0:.4g} % {'larger' if factor > 1.0 else 'smaller'}"
        return f"the {name} is {change}: {factor * value:.6g}, not {value:.6g} kg m^2"

    return sentence


def _numbers(vector: Floats) -> str:
    return ", ".join(f"{float(v) + 0.0:.6g}" for v in vector)
