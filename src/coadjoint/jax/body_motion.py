"""The exact motion of free rigid bodies as operations of JAX, in the precision of its arguments.

On momenta z with z' = z cross M z the motion over a short time s is
    z(s) = (adj(C) z + s C (z cross M z))/D,    C^2 = s^2 (P(s) - E),    D = s^2 (P(s) - p),
with the tensor E = (z . N z) N + |z|^2 (N^2 - tr N^2/3) of the part N of M without trace, 3 p = |z|^2 tr N^2/2 - 3
|N z|^2, and the Weierstrass function P, whose roots are the eigenvalues of E. On principal axes these are the
formulas of the compiled flow; on any axes the tensor need not be diagonalized, which has no derivatives if moments are
equal. Functions of E have three coefficients, those of 1, E and E^2.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_derivatives import SymbolicZero

from coadjoint.jax.primitives import unrounded
from coadjoint.jax.stage_steps import sparse

# The sine above which the rotation about the second axis counts as near a right angle.
UPRIGHT = 0.9
# Axes of the four rotations of a body.
AXES = (2, 0, 1, 2)


Angles = tuple[Callable[[Any], Any], Callable[[Any, Any, Any, Any, Any], Any]]
"""The constants of a part from the numbers of its table, and angles of its flow, of these, params of the energy, tau,
a state and a time."""


def body_angles(table: Mapping[str, Any], part: int) -> Angles:
    """Return angles 4 b to 4 b + 3 of body b of a part; a bond is a spherical body of one inertia with two momenta."""
    own = table["state_part"] == part
    names = ("state_angle", "state_row", "state_column", "state_value")
    entries = list(zip(*(table[name][own].tolist() for name in names), strict=True))
    shares = range(*table["share"][part : part + 2].tolist())
    columns, scales, cells = [], [], []
    for body, share in enumerate(shares):
        first = int(table["term_row"][share])
        weights = [range(*table["entry"][row : row + 2].tolist()) for row in range(first + 1, first + 4)]
        generators = [{i: (j, value) for q, i, j, value in entries if q == 4 * body + a} for a in (1, 2, 3)]
        pairs, scale = _coordinates([table["column"][list(row)].tolist() for row in weights], generators)
        columns.append(pairs)
        scales.append(scale)
        # The entries of the inverse inertia in the scaled basis: number, weight, and factor.
        if _is_bond(pairs):
            cells.append((body, 0, weights[0][0], scale[0] ** -2))
            continue
        for a, row in enumerate(weights):
            for e in row:
                b = pairs[0].index(int(table["column"][e]))
                if (a, b) in PAIRS:
                    cells.append((body, PAIRS.index((a, b)), e, 1.0 / (scale[a] * scale[b])))
    is_bond = all(map(_is_bond, columns))  # no part has both
    of_axes = np.array(scales)
    owner, cell, index, factor = map(np.array, zip(*cells, strict=True))
    index = len(table["offset"]) + index
    shape = len(columns), 6 if cell.max() > 2 else 3
    # The momenta in the scaled basis.
    body, axis, copy = (k.ravel() for k in np.indices((len(columns), 3, 2 if is_bond else 1)))
    place, n = np.array(columns)[body, copy, axis], int(table["dim"])
    momenta = sparse(3 * body + axis, place, of_axes[body, axis], (3 * len(columns), n))

    def constants(numbers: Any) -> Any:
        return jnp.zeros(shape).at[owner, cell].set(factor * numbers[index])

    def at(inverse_inertia: Any, params: Any, tau: Any, x: Any, t: Any) -> Any:
        z = momenta.times(x).reshape(-1, 3)
        quaternion = _bond_quaternion if is_bond else _body_quaternion
        angles = jax.vmap(lambda m, z: _angles(quaternion(m, z)))(tau * inverse_inertia, z)
        return (angles * of_axes[:, list(AXES)]).ravel()

    return constants, at


def _is_bond(pairs: Any) -> bool:
    return len(pairs) > 1


def _coordinates(columns: Any, generators: Any) -> tuple[list[list[int]], Any]:
    """Return the three coordinates of a body, or of both spins of a bond, and the scale of its elements."""
    # Times the scale, the elements have the brackets [1, 2] = 3, [2, 3] = 1, [3, 1] = 2.
    used = sorted({column for row in columns for column in row})
    if len(used) == 6:
        pairs = np.transpose(columns).tolist()
        triple = pairs[0]
    else:
        fixed = [[i for i in used if i not in generator] for generator in generators]
        triple = [one[0] if one else -1 for one in fixed]
        for a in (a for a in range(3) if triple[a] < 0):  # a body without energy along this axis
            triple[a] = generators[(a + 1) % 3][triple[(a + 2) % 3]][0]
        pairs = [triple]
    v = np.array([generators[a][triple[(a + 1) % 3]][1] for a in range(3)])
    scale = 1.0 / np.sqrt(v * np.roll(v, 1))
    scale[0] *= -np.sign(v.prod())
    return pairs, scale


def _bond_quaternion(m: Any, z: Any) -> Any:
    vector = 0.5 * m[0] * z
    square = vector @ vector
    near = square < 1e-4  # where the terms that the series leave out are below the round-off
    half = jnp.sqrt(jnp.where(near, 1.0, square))
    sine = jnp.where(near, 1.0 - square / 6 * (1.0 - square / 20 * (1.0 - square / 42)), jnp.sin(half) / half)
    cosine = jnp.where(near, 1.0 - square / 2 * (1.0 - square / 12 * (1.0 - square / 30)), jnp.cos(half))
    return jnp.append(cosine, sine * vector)


def _body_quaternion(m: Any, z: Any) -> Any:
    """Return the quaternion that rotates the momentum of a free body to that at the end, by z' = M z cross z."""
    r = motion(z, -m)[1]
    return jnp.append(r[0], -r[1:])


def _angles(q: Any) -> Any:
    """Return the angles of a unit quaternion as rotations about the third, first, second and third axis."""
    w, x, y, z = q
    tilt, size = 2.0 * (w * y - x * z), w * w + x * x + y * y + z * z
    a, b = 2.0 * (y * z + w * x), (w * w + z * z) - (x * x + y * y)
    upright = jnp.abs(tilt) > UPRIGHT * size

    def chosen(if_upright: Any, otherwise: Any) -> Any:
        return jnp.where(upright, if_upright, otherwise)

    # The length of a vector that is not zero in either case.
    level = jnp.sqrt(a * a + chosen(tilt, b) ** 2)
    angles = jnp.array(
        [
            jnp.arctan2(chosen(a, 0.0), chosen(tilt, 1.0)),
            jnp.arctan2(chosen(0.0, a), chosen(1.0, b)),
            jnp.arctan2(chosen(level, tilt), chosen(b, level)),
            jnp.arctan2(
                chosen(2.0 * (y * z - w * x), 2.0 * (x * y + w * z)),
                chosen(2.0 * (x * z + w * y), (w * w + x * x) - (y * y + z * z)),
            ),
        ]
    )
    # Of the two quaternions of the rotation it must be this one, where a block turns by half the angle.
    unit = np.eye(4)
    total = tuple(unit[0])
    for angle, axis in zip(angles, AXES, strict=True):
        total = after(tuple(jnp.cos(angle / 2) * unit[0] + jnp.sin(angle / 2) * unit[1 + axis]), total)
    return angles + unit[0] * jnp.where(jnp.stack(total) @ q < 0.0, 2.0 * np.pi, 0.0)


# The largest number of pieces of a motion that is not divided by its period; and of one of a thin body on other than
# principal axes, whose E has lost more than `MOST_LOST`: the square of the spread of moments times |z|, over E.
MOST_PIECES, MOST_OF_THIN = 64, 65536
MOST_LOST = 2.0**10
# The largest motion of the momentum, in radians, and the least separation of the two largest eigenvalues of E, over the
# largest one, with which the period is resolved.
LARGEST_ANGLE = {np.dtype(np.float64): 2.0**30, np.dtype(np.float32): 2.0**20}
LEAST_GAP = 2.0**-60
# Newton steps by which an attitude is made orthonormal: enough for lengths from 0.8 to 1.2.
CORRECTIONS = 5
Vector = tuple[Any, ...]
"""Vectors, quaternions, and symmetric tensors: the entries of `PAIRS`, or of a diagonal one the first three."""

# Rows and columns of the entries of a symmetric tensor.
PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
# Coefficients of sqrt(1 - x), from that of x on.
ROOT = tuple(-abs(math.prod((0.5 - i) / (i + 1) for i in range(k))) for k in range(1, 9))


# Of each precision: the longest piece of time, over the spread of moments times |z|, and nodes and weights of Lobatto's
# rule, whose first node is 0.
QUADRATURES: Mapping[Any, tuple[float, tuple[float, ...], tuple[float, ...]]] = {
    np.dtype(np.float64): (
        0.1875,
        (0.5 - math.sqrt(3 / 28), 0.5, 0.5 + math.sqrt(3 / 28), 1.0),
        (1 / 20, 49 / 180, 16 / 45, 49 / 180, 1 / 20),
    ),
    np.dtype(np.float32): (
        0.5,
        (0.5 - math.sqrt(1 / 20), 0.5 + math.sqrt(1 / 20), 1.0),
        (1 / 12, 5 / 12, 5 / 12, 1 / 12),
    ),
}


def checked_step(x: Any, A: Any, inertia: Any, h: Any) -> Any:
    """Validate shapes and types, and take a `step`."""
    given = {"x": x, "A": A, "inertia": inertia, "h": h}
    given = {name: unrounded(name, value) for name, value in given.items() if value is not None}
    shapes = {"x": ((3,),), "A": ((3, 3),), "inertia": ((3,), (3, 3)), "h": ((),)}
    for name, value in given.items():
        if value.shape not in shapes[name]:
            raise ValueError(
                f"{name} of co.jax.free_body has the shape {value.shape}; it must be "
                f"{' or '.join(map(str, shapes[name]))}; apply jax.vmap for several bodies"
            )
    kind = jnp.result_type(*given.values())
    kind = jnp.result_type(float) if jnp.issubdtype(kind, jnp.integer) else kind
    if kind not in QUADRATURES:
        raise TypeError(f"co.jax.free_body was given numbers of {kind}; give float32 or float64")
    return _compiled_step(*(given[name].astype(kind) if name in given else None for name in shapes))


def step(x: Any, A: Any, inertia: Any, h: Any) -> Any:
    """Return the momentum, and the attitude unless it is None, after a time h."""
    if inertia.ndim == 1:
        m = jnp.where(inertia == 0.0, 0.0, 1.0 / jnp.where(inertia == 0.0, 1.0, inertia))
    else:
        m = jnp.stack(inverse(inertia))
    x, r = motion(x, h * m)
    if A is None:
        return x
    rows = [_plus(row, _turned(r, row)) for row in A]
    product = partial(jnp.matmul, precision="highest")

    def corrected(_: Any, A: Any) -> Any:
        return A - 0.5 * product(A, product(A.T, A) - jnp.eye(3, dtype=A.dtype))

    return x, lax.fori_loop(0, CORRECTIONS, corrected, jnp.array(rows))


_compiled_step = jax.jit(step)


def motion(x: Any, m: Any) -> tuple[Any, Any]:
    """Return the momentum, and the quaternion of the rotation from the axes at the end to those at the start.

    `m`: the inverse inertia times the time, its diagonal (3,) or all entries (6,) of `PAIRS`.
    """
    # A power of two, on which the result does not depend.
    largest = lax.stop_gradient(jnp.max(jnp.abs(x)))
    scale = jnp.ldexp(jnp.ones_like(largest), jnp.where(largest == 0.0, 0, jnp.frexp(largest)[1] - 1))
    found = _motion(x / scale, m * scale)
    return found[:3] * scale, found[3:]


def differentiated_forward(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function from vectors to a vector whose derivatives, of any order and mode, are computed forward."""
    # For loops whose number of rounds depends on the arguments, through which there is no reverse mode.
    differentiable = jax.custom_jvp(function)

    def rule(values: Any, tangents: Any) -> Any:
        used = [k for k, tangent in enumerate(tangents) if type(tangent) is not SymbolicZero]

        def with_slopes(*values: Any) -> Any:
            def of_used(*some: Any) -> Any:
                given = dict(zip(used, some, strict=True))
                return function(*(given.get(k, value) for k, value in enumerate(values)))

            some = [values[k] for k in used]
            unit = np.eye(sum(one.size for one in some))
            starts = np.cumsum([one.size for one in some])[:-1]
            directions = [jnp.asarray(d, values[0].dtype) for d in np.split(unit, starts, axis=1)]
            found, slopes = jax.vmap(lambda *along: jax.jvp(of_used, tuple(some), along), out_axes=(None, 0))(
                *directions
            )
            return jnp.append(found, slopes)

        along = jnp.concatenate([tangents[k] for k in used])
        both = differentiated_forward(with_slopes)(*values)
        size = len(both) // (1 + len(along))
        return both[:size], (along[:, None] * both[size:].reshape(-1, size)).sum(axis=0)

    differentiable.defjvp(rule, symbolic_zeros=True)
    return differentiable


@differentiated_forward
def _motion(momentum: Any, m: Any) -> Any:
    """Return momentum and quaternion, (7,); NaN beyond `LARGEST_ANGLE`."""
    z, M = tuple(momentum), tuple(m)
    mean = (M[0] + M[1] + M[2]) / 3
    N = (*(entry - mean for entry in M[:3]), *M[3:])
    # At least the spread of the moments, and at most 1.2 times that.
    spread = jnp.sqrt(2 * (dot(N[:3], N[:3]) + 2 * dot(N[3:], N[3:])))
    if len(M) == 3:  # the part without trace would lose small differences and moments of thin bodies
        N, mean = M, 0.0 * mean
    piece, most = QUADRATURES[momentum.dtype][0], LARGEST_ANGLE[momentum.dtype]
    reach = lax.stop_gradient(spread * jnp.sqrt(dot(z, z)))
    E, *_ = _of_motion(N, z)
    size = lax.stop_gradient(dot(E[:3], E[:3]) + 2 * dot(E[3:], E[3:]))
    is_long = reach > MOST_PIECES * piece
    if len(M) > 3:
        is_long &= reach**2 <= MOST_LOST * jnp.sqrt(size)
        most = jnp.where(is_long, most, MOST_OF_THIN * piece)
    one = jnp.ones_like(reach)
    speed, period = _period(E, is_long)
    turns = lax.stop_gradient(jnp.where(speed > MOST_PIECES * piece, jnp.floor(1 / period + 0.5), 0.0))
    reach = jnp.where(is_long, speed, reach) / piece

    rest = jnp.where(turns > 0.0, 1.0 - turns * period, 1.0)
    needed = jnp.ceil(lax.stop_gradient(reach * jnp.stack([period, jnp.abs(rest)])))
    counts = jnp.where(jnp.stack([turns, one]) > 0.0, jnp.maximum(1.0, needed), 0.0)

    def pieces(_: Any, time_and_count: Any) -> Any:
        time, count = time_and_count
        *short, part = (entry * time / jnp.maximum(count, 1.0) for entry in (*N, mean))

        def next_piece(state: Any) -> Any:
            k, z, total = state
            z, r = _piece(tuple(short), part, z)
            return k + 1.0, z, after(total, r)

        start = 0.0 * one, z, (one, 0.0 * one, 0.0 * one, 0.0 * one)
        return None, lax.while_loop(lambda state: state[0] < count, next_piece, start)[1:]

    # The period and the rest, both from the start, in one loop, which is compiled once.
    _, (ends, totals) = lax.scan(pieces, None, (jnp.stack([period, rest]), counts))
    whole, *vector = (entry[0] for entry in totals)
    # Over whole periods the body rotates about its momentum: a power of a unit complex number, by squares.
    length = jnp.sqrt(jnp.where(is_long, dot(z, z), one))
    along = dot(vector, z) / length
    size = jnp.sqrt(whole * whole + along * along)

    def squared_number(state: Any) -> Any:
        left, cosine, sine, whole, about = state
        odd = left % 2.0 == 1.0
        product = whole * cosine - about * sine, whole * sine + about * cosine
        square, twice = cosine * cosine - sine * sine, 2 * cosine * sine
        by = 1.5 - 0.5 * (square * square + twice * twice)
        chosen = (jnp.where(odd, a, b) for a, b in zip(product, (whole, about), strict=True))
        return jnp.floor(left / 2.0), square * by, twice * by, *chosen

    power = turns, whole / size, along / size, one, 0.0 * one
    *_, whole, about = lax.while_loop(lambda state: state[0] > 0.0, squared_number, power)
    total = after((whole, *(about * entry / length for entry in z)), tuple(entry[1] for entry in totals))
    return jnp.where(reach * piece <= most, jnp.stack([*(entry[1] for entry in ends), *total]), jnp.nan)


def _of_motion(N: Vector, z: Vector) -> tuple[Vector, Any, Vector]:
    """Return E, p and z cross N z, for a tensor without trace, or from the differences of principal moments."""
    if len(N) == 3:
        a = tuple(N[i - 1] - N[i - 2] for i in range(3))
        own = tuple((a[i - 2] * z[i]) * (a[i - 1] * z[i]) for i in range(3))
        p = (own[0] + own[1] + own[2]) / 3
        return tuple(p - entry for entry in own), p, tuple(a[i] * (z[i - 2] * z[i - 1]) for i in range(3))
    w, length2, NN = times(N, z), dot(z, z), squared(N)
    energy, half = dot(w, z), 0.5 * (NN[0] + NN[1] + NN[2])
    E = tuple(energy * n + length2 * nn for n, nn in zip(N, NN, strict=True))
    E = (*(entry - 2 / 3 * half * length2 for entry in E[:3]), *E[3:])
    return E, (length2 * half - 3 * dot(w, w)) / 3, cross(z, w)


def _period(E: Vector, is_long: Any) -> tuple[Any, Any]:
    """Return the largest rate of the momentum, and its period, for motions that are long; 1 for others."""
    # e1 >= e2 >= e3 are the roots of x^3 - q x - d. The period, 2 pi over the arithmetic-geometric mean of the roots of
    # e1 - e3 and e1 - e2, depends on e1 alone, which has derivatives where e2 = e3, for symmetric bodies.
    q = (dot(E[:3], E[:3]) + 2 * dot(E[3:], E[3:])) / 2
    d = dot(row(E, 0), cross(row(E, 1), row(E, 2)))
    moving = is_long & (q > 0.0)
    q, d = jnp.where(moving, q, 3.0), jnp.where(moving, d, 2.0)
    radius = lax.stop_gradient(jnp.sqrt(q / 3))
    angle = jnp.arccos(jnp.clip(lax.stop_gradient(d) / (2 * radius**3), -1.0, 1.0))
    e = 2 * radius * jnp.cos(angle / 3) * (1 + 2.0**-20)  # from above

    def newton(e: Any, q: Any, d: Any) -> Any:
        slope = 3 * e * e - q
        gap = LEAST_GAP * radius * radius
        return e - jnp.where(slope > gap, (e * e * e - q * e - d) / jnp.where(slope > gap, slope, 1.0), 0.0)

    e = lax.fori_loop(0, 40, lambda _, e: newton(e, lax.stop_gradient(q), lax.stop_gradient(d)), e)
    e = lax.fori_loop(0, 3, lambda _, e: newton(e, q, d), e)  # for derivatives of up to seventh order
    product = 3 * e * e - q
    resolved = product > LEAST_GAP * radius * radius
    root = jnp.sqrt(jnp.where(resolved, product, LEAST_GAP * radius * radius))
    mean = 0.5 * jnp.sqrt(3 * e + 2 * root)
    other = jnp.sqrt(root)
    means = lax.fori_loop(0, 8, lambda _, two: (0.5 * (two[0] + two[1]), jnp.sqrt(two[0] * two[1])), (mean, other))
    mean = means[0]
    speed = jnp.sqrt(2 * jnp.sqrt(lax.stop_gradient(q)))  # at least the root of e1 - e3
    period = 2 * np.pi / mean
    # Beside the separatrix the period has no derivative that is resolved.
    period = jnp.where(resolved, period, lax.stop_gradient(period) + 0.0 * jnp.sqrt(0.0 * q))
    return jnp.where(moving, speed, 0.0), period


def _piece(N: Vector, mean: Any, momentum: Vector) -> tuple[Vector, Vector]:
    """Return momentum and quaternion after a short time, which is contained in N and the mean moment."""
    _, later_nodes, (first, *weights) = QUADRATURES[momentum[0].dtype]
    at_rest = (momentum[0] == 0.0) & (momentum[1] == 0.0) & (momentum[2] == 0.0)
    # The rotation divides by the momentum; at rest the series up to second order has the derivatives.
    z = tuple(jnp.where(at_rest, 1.0, entry) for entry in momentum)
    w, length2, (E, p, v) = times(N, z), dot(z, z), _of_motion(N, z)
    energy = dot(w, z)
    c0 = (dot(E[:3], E[:3]) + 2 * dot(E[3:], E[3:])) / 10
    determinant = dot(row(E, 0), cross(row(E, 1), row(E, 2)))
    c1 = determinant / 7
    c2, c3 = c0 * c0 / 3, c0 * c1 * (3 / 11)
    c4 = (2 * c0 * c2 + c1 * c1) / 13
    vectors = (z, times(E, z), times(E, times(E, z)), v, times(E, v), times(E, times(E, v)))

    def at(state: Any, node: Any) -> Any:
        (angle, _), (s, weight) = state, node
        square = s * s
        r = square * square * (c0 + square * (c1 + square * (c2 + square * (c3 + square * c4))))
        less = r - square * p  # D - 1
        # C - 1 = e0 + e1 E + e2 E^2 from sqrt(1 + r) sqrt(1 - t E), by Horner's rule; E^3 = 5 c0 E + determinant.
        t = square / (1 + r)
        e0 = e1 = e2 = jnp.zeros_like(t)
        for coefficient in reversed(ROOT):
            e0, e1, e2 = t * (determinant * e2), t * (e0 + coefficient + 5 * c0 * e2), t * e1
        root = jnp.sqrt(1 + r)
        e0, e1, e2 = r / (1 + root) + root * e0, root * e1, root * e2
        # adj(C) - 1 = tr e - e + adj(e), and adj(e) = e^2 - e tr e + ((tr e)^2 - tr e^2)/2.
        trace = 3 * e0 + 10 * c0 * e2
        d0 = e0 * e0 + 2 * determinant * e1 * e2
        d1 = 2 * e0 * e1 + e2 * (10 * c0 * e1 + determinant * e2)
        d2 = 2 * e0 * e2 + e1 * e1 + 5 * c0 * e2 * e2
        more = 1 + trace
        a0 = trace + 0.5 * (trace * trace - (3 * d0 + 10 * c0 * d2)) + d0 - more * e0 - less
        factors = (a0, d1 - more * e1, d2 - more * e2, s + s * e0, s * e1, s * e2)
        change = tuple(dot(factors, column) / (1 + less) for column in zip(*vectors, strict=True))
        rate = (2 * energy + dot(change, w)) / (2 * length2 + dot(change, z))
        return (angle + weight * rate, change), None

    nodes = jnp.asarray(later_nodes, z[0].dtype), jnp.asarray(weights, z[0].dtype)
    # A loop, since XLA would otherwise compute all functions of E again for each component.
    (angle, change), _ = lax.scan(at, (mean + first * energy / length2, z), nodes)
    length, end = jnp.sqrt(length2), _plus(z, change)
    sine, cosine = jnp.sin(0.5 * length * angle) / length, jnp.cos(0.5 * length * angle)
    # About the new momentum, and then from it to the old one by the shortest rotation.
    whole = jnp.sqrt(1 - dot(change, change) / (4 * length2))
    shortest = tuple(entry / (2 * length2 * whole) for entry in cross(change, z))
    r = after((whole, *shortest), (cosine, *(sine * entry for entry in end)))
    # At rest.
    w = tuple(n + mean * entry for n, entry in zip(times(N, momentum), momentum, strict=True))
    v = cross(momentum, w)
    slowly = (0.5 * b + 0.25 * (c + mean * a) for a, b, c in zip(v, w, times(N, v), strict=True))
    end = tuple(jnp.where(at_rest, a, b) for a, b in zip(_plus(momentum, v), end, strict=True))
    return end, tuple(jnp.where(at_rest, a, b) for a, b in zip((1 - dot(w, w) / 8, *slowly), r, strict=True))


def after(r: Vector, p: Vector) -> Vector:
    """Return the product of quaternions, the rotation r after p."""
    (a, *u), (b, *v) = r, p
    return (a * b - dot(u, v), *(a * y + b * x + c for x, y, c in zip(u, v, cross(u, v), strict=True)))


def _turned(r: Any, v: Any) -> Vector:
    """Return the change of a vector by the inverse of the rotation of a quaternion."""
    across = cross(v, r[1:])
    return tuple(2 * (r[0] * a + b) for a, b in zip(across, cross(across, r[1:]), strict=True))


def _plus(u: Any, v: Any) -> Vector:
    return tuple(a + b for a, b in zip(u, v, strict=True))


def dot(u: Any, v: Any) -> Any:
    """Return the scalar product."""
    return sum(a * b for a, b in zip(u, v, strict=True))


def cross(u: Any, v: Any) -> Vector:
    """Return the cross product."""
    return tuple(u[i - 2] * v[i - 1] - u[i - 1] * v[i - 2] for i in range(3))


def row(T: Vector, i: int) -> Vector:
    """Return a row of a symmetric tensor."""
    off = T[3:] or (0.0, 0.0, 0.0)
    return tuple(T[i] if i == j else off[3 - i - j] for j in range(3))


def times(T: Vector, v: Vector) -> Vector:
    """Return the product of a symmetric tensor and a vector."""
    return tuple(dot(row(T, i), v) for i in range(3)) if len(T) > 3 else tuple(map(operator.mul, T, v))


def squared(T: Vector) -> Vector:
    """Return the square of a symmetric tensor."""
    return tuple(dot(row(T, i), row(T, j)) for i, j in PAIRS) if len(T) > 3 else tuple(map(operator.mul, T, T))


def inverse(S: Any) -> Vector:
    """Return the inverse of the symmetric part of a matrix (3, 3)."""
    T = tuple(0.5 * (S[i, j] + S[j, i]) for i, j in PAIRS)
    cofactors = [cross(row(T, (i + 1) % 3), row(T, (i + 2) % 3)) for i in range(3)]
    size = dot(row(T, 0), cofactors[0])
    return tuple(cofactors[i][j] / size for i, j in PAIRS)
