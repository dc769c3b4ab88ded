"""The verb `act`: exp(theta D) of one part on vectors side by side (a state, or the rows of a group element)."""

from __future__ import annotations

import math
from typing import Any

from coadjoint.kernels.arithmetic import entire_pair, fma, rational_rotation, shortfall, sine_and_cosine_minus_one
from coadjoint.kernels.compiling import inlined
from coadjoint.program.blocks import CUBIC_HEADER, Kind

SCALE, ROTATE, PLANE, SHEAR, CUBIC = (
    int(kind) for kind in (Kind.SCALE, Kind.ROTATE, Kind.PLANE, Kind.SHEAR, Kind.CUBIC)
)

# Rotations by tan(phi/2) := half the angle: the same blocks, with another sine and cosine.
RATIONAL = 8
RATIONAL_ROTATE, RATIONAL_CUBIC = ROTATE + RATIONAL, CUBIC + RATIONAL

MOST_SUBSTEPS = 1.0e6


@inlined
def add(vectors: Any, errors: Any, place: int, increment: float, compensated: bool) -> None:
    """Add an increment to a component; with compensation what rounding lost is kept and added the next time."""
    old = vectors[place]
    if compensated:
        increment += errors[place]
        new = old + increment
        kept = new - old
        errors[place] = (old - (new - kept)) + (increment - kept)
        vectors[place] = new
    else:
        vectors[place] = old + increment


@inlined
def add_owing(vectors: Any, errors: Any, place: int, increment: float, owed: float) -> None:
    """Add an increment with compensation; keep besides what the increment owes and what adding the error to it lost.

    The next rotation does not wait for any of that.
    """
    old, error = vectors[place], errors[place]
    whole = increment + error
    new = old + whole
    kept = new - old
    # Where the error is the larger of the two, the increment is so small that what their sum loses does not matter.
    errors[place] = (old - (new - kept)) + (whole - kept) + ((increment - whole) + error) + owed
    vectors[place] = new


@inlined
def _angle(single: bool, lone: float, theta: Any, place: int) -> float:
    """Return the only angle, from its register, or one of several, from memory."""
    return lone if single else theta[place]


@inlined
def act(
    action: Any,
    part: int,
    tau: float,
    single: bool,
    lone: float,
    theta: Any,
    vectors: Any,
    errors: Any,
    lanes: int,
    compensated: bool,
    corrected: bool,
    room: Any,
) -> None:
    """Move `lanes` vectors by exp(tau sum theta_a D_a) of one part; component i of vector l stands at i*lanes + l.

    A part with a single angle has it in `lone`, not in theta[0]: an angle that passes through memory delays the step.
    `compensated` keeps what adding an increment loses; `corrected` also what the increment itself owes, so that no
    rounding keeps its sign.
    Every kind of block is written once, as an increment, so that compensation and the accuracy of small angles are the
    same for all uses.
    """
    for run in range(action.run[part], action.run[part + 1]):
        kind = action.kind[run]
        repeat = action.repeat[run]
        angle = action.angle[run]
        index = action.place[run]
        constant = action.constant[run]
        if kind == ROTATE or kind == RATIONAL_ROTATE:
            for q in range(action.angles[run]):
                phi = _angle(single, lone, theta, angle + q) * (tau * action.constants[constant + q])
                sine, lowered = sine_and_cosine_minus_one(phi) if kind == ROTATE else rational_rotation(phi)
                short = shortfall(sine, -lowered, 1.0) if corrected else 0.0
                for _ in range(repeat):
                    i, j = action.indices[index] * lanes, action.indices[index + 1] * lanes
                    index += 2
                    for lane in range(lanes):
                        a, b = vectors[i + lane], vectors[j + lane]
                        forth, back = sine * a, sine * b
                        if corrected:
                            # The rotation of the errors, the rounding of a product, and the shortfall.
                            e, f = errors[i + lane], errors[j + lane]
                            first = fma(lowered, e, -fma(sine, f, fma(sine, b, -back))) - short * a
                            second = fma(lowered, f, fma(sine, e, fma(sine, a, -forth))) - short * b
                            add_owing(vectors, errors, i + lane, fma(lowered, a, -back), first)
                            add_owing(vectors, errors, j + lane, fma(lowered, b, forth), second)
                        else:
                            add(vectors, errors, i + lane, fma(lowered, a, -back), compensated)
                            add(vectors, errors, j + lane, fma(lowered, b, forth), compensated)
        elif kind == SHEAR:
            for q in range(action.angles[run]):
                turn = tau * _angle(single, lone, theta, angle + q)
                for _ in range(repeat):
                    i, j = action.indices[index] * lanes, action.indices[index + 1] * lanes
                    factor = turn * action.constants[constant]
                    index += 2
                    constant += 1
                    for lane in range(lanes):
                        moved = factor * vectors[j + lane]
                        if corrected:
                            owed = fma(factor, errors[j + lane], fma(factor, vectors[j + lane], -moved))
                            add_owing(vectors, errors, i + lane, moved, owed)
                        else:
                            add(vectors, errors, i + lane, moved, compensated)
        elif kind == SCALE:
            for q in range(action.angles[run]):
                factor = math.expm1(_angle(single, lone, theta, angle + q) * (tau * action.constants[constant + q]))
                for _ in range(repeat):
                    i = action.indices[index] * lanes
                    index += 1
                    for lane in range(lanes):
                        add(vectors, errors, i + lane, factor * vectors[i + lane], compensated)
        elif kind == PLANE:
            for q in range(action.angles[run]):
                turn = tau * _angle(single, lone, theta, angle + q)
                _plane(action, index, constant, repeat, turn, vectors, errors, lanes, compensated)
                index += 2 * repeat
                constant += 4
        elif kind == CUBIC or kind == RATIONAL_CUBIC:
            turn = tau * _angle(single, lone, theta, angle)
            _cubic(action, run, turn, vectors, errors, lanes, compensated, corrected, room)
        else:
            turn = tau * _angle(single, lone, theta, angle)
            _series(action, run, turn, vectors, errors, lanes, compensated, room)


@inlined
def _plane(
    action: Any,
    index: int,
    constant: int,
    repeat: int,
    theta: float,
    vectors: Any,
    errors: Any,
    lanes: int,
    compensated: bool,
) -> None:
    """exp(theta B) = e^(theta mean) (C + S N), N = B - mean, N^2 = delta: entire in delta theta^2, of either sign."""
    mean, half = action.constants[constant], action.constants[constant + 1]
    upper, lower = action.constants[constant + 2], action.constants[constant + 3]
    delta = fma(half, half, upper * lower)
    s, c = entire_pair(theta * theta * delta)
    # Not from expm1 alone: where the mean decays and cosh grows, what 1 + expm1 lost would be amplified.
    scale = math.exp(theta * mean)
    diagonal = fma(scale, c, math.expm1(theta * mean))
    s = scale * (theta * s)
    for _ in range(repeat):
        i, j = action.indices[index] * lanes, action.indices[index + 1] * lanes
        index += 2
        for lane in range(lanes):
            a, b = vectors[i + lane], vectors[j + lane]
            add(vectors, errors, i + lane, fma(diagonal, a, s * fma(half, a, upper * b)), compensated)
            add(vectors, errors, j + lane, fma(diagonal, b, s * fma(lower, a, -(half * b))), compensated)


@inlined
def apply_block(
    action: Any, run: int, values: int, source: Any, start: int, factor: float, target: Any, stop: int, lanes: int
) -> None:
    """Target = factor D source on one CUBIC or SERIES block, both in the block's own coordinates (the verb `apply`)."""
    width = action.width[run]
    starts = action.place[run] + width
    columns = starts + width + 1
    for k in range(width):
        low, high = action.indices[starts + k], action.indices[starts + k + 1]
        for lane in range(lanes):
            total = 0.0
            for entry in range(low, high):
                j = action.indices[columns + entry] * lanes
                total = fma(action.constants[values + entry], source[start + j + lane], total)
            target[stop + k * lanes + lane] = factor * total


@inlined
def _gather(action: Any, run: int, vectors: Any, lanes: int, room: Any) -> None:
    for k in range(action.width[run]):
        i = action.indices[action.place[run] + k] * lanes
        for lane in range(lanes):
            room[k * lanes + lane] = vectors[i + lane]


@inlined
def _cubic(
    action: Any,
    run: int,
    theta: float,
    vectors: Any,
    errors: Any,
    lanes: int,
    compensated: bool,
    corrected: bool,
    room: Any,
) -> None:
    """D^3 = lam D: exp(theta D) = 1 + S D + C D^2, Rodrigues' formula where lam < 0 and its hyperbolic kin where lam >
    0.
    """
    constant = action.constant[run]
    lam, root = action.constants[constant], action.constants[constant + 1]
    values = constant + CUBIC_HEADER
    squares = values + action.entries[run]
    rests = squares + action.entries[run]
    starts = action.place[run] + action.width[run]
    columns = starts + action.width[run] + 1
    length = action.width[run] * lanes
    # Rows of D and D^2 are summed in registers, while the processor still works on the sine.
    _gather(action, run, vectors, lanes, room)
    if action.kind[run] == RATIONAL_CUBIC:
        s, c = rational_rotation(root * theta)
    elif lam < 0.0:
        s, c = sine_and_cosine_minus_one(root * theta)
    else:
        half = math.sinh(0.5 * root * theta)
        s, c = math.sinh(root * theta), 2.0 * half * half
    # What the constants lost by rounding is paid back: it would stretch every step alike.
    s = fma(s, action.constants[constant + 2], s * action.constants[constant + 3])
    c = fma(c, action.constants[constant + 4], c * action.constants[constant + 5])
    if corrected:
        # D (D x) and not D^2 x: the rounding of the entries of D^2 always pulls the same way.
        apply_block(action, run, values, room, 0, 1.0, room, length, lanes)
        apply_block(action, run, values, room, length, 1.0, room, 2 * length, lanes)
        short = shortfall(s, c, -lam)
        for k in range(action.width[run]):
            i = action.indices[action.place[run] + k] * lanes
            for lane in range(lanes):
                first, second = room[length + k * lanes + lane], room[2 * length + k * lanes + lane]
                add_owing(vectors, errors, i + lane, fma(s, first, c * second), short * second)
        return
    for k in range(action.width[run]):
        i = action.indices[action.place[run] + k] * lanes
        for lane in range(lanes):
            first, second, rest = 0.0, 0.0, 0.0
            for entry in range(action.indices[starts + k], action.indices[starts + k + 1]):
                v = room[action.indices[columns + entry] * lanes + lane]
                first = fma(action.constants[values + entry], v, first)
                second = fma(action.constants[squares + entry], v, second)
                rest = fma(action.constants[rests + entry], v, rest)
            second += rest
            add(vectors, errors, i + lane, fma(s, first, c * second), compensated)


@inlined
def _series(
    action: Any, run: int, theta: float, vectors: Any, errors: Any, lanes: int, compensated: bool, room: Any
) -> None:
    """Sum theta^k D^k / k!: finite where D is nilpotent, else in substeps of norm at most 1."""
    constant = action.constant[run]
    length = action.width[run] * lanes
    needed = abs(theta) * action.constants[constant]
    # No step of an integration needs more; near a blow-up it would run for ever: no number, so that the run stops.
    h = theta / max(1.0, math.ceil(needed)) if needed <= MOST_SUBSTEPS else math.nan
    substeps = max(1, math.ceil(needed)) if needed <= MOST_SUBSTEPS else 1
    for _ in range(substeps):
        _gather(action, run, vectors, lanes, room)
        for place in range(length):
            room[2 * length + place] = 0.0
        here, there = 0, length
        for k in range(1, action.degree[run] + 1):
            apply_block(action, run, constant + 1, room, here, h / k, room, there, lanes)
            for place in range(length):
                room[2 * length + place] += room[there + place]
            here, there = there, here
        for k in range(action.width[run]):
            i = action.indices[action.place[run] + k] * lanes
            for lane in range(lanes):
                add(vectors, errors, i + lane, room[2 * length + k * lanes + lane], compensated)
