"""Flows of free rigid bodies and bonds as operations of JAX: four rotations about fixed axes.

The formulas are those of the compiled flow: the addition theorem of Weierstrass functions over short pieces of time,
and a quadrature for the rotation about the momentum. The derivative by the momentum is that of the three components,
computed forward, so that the number of pieces may depend on the state.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from coadjoint.jax.sparse import sparse

# Nodes of the quadrature with five points, and the end; its weights.
NODES = (*(0.5 * (1.0 + x) for x in np.polynomial.legendre.leggauss(5)[0].tolist()), 1.0)
SHARES = tuple(0.5 * w for w in np.polynomial.legendre.leggauss(5)[1].tolist())
# The longest piece of time, in units of 1/(|z| max |a|), and the largest number of pieces of a flow.
PIECE = 0.125
MOST_PIECES = 65536
# Bodies with a smaller squared momentum are at rest.
REST = 1e-100
# The sine above which the rotation about the second axis counts as near a right angle.
UPRIGHT = 0.9
# Axes of the four rotations of a body.
AXES = (2, 0, 1, 2)


class BodyAngles:
    """Angles of the four rotations of each free body, or bond, of a part.

    A bond is a spherical body whose momentum is the sum of two. Body b has the angles 4 b to 4 b + 3.
    """

    def __init__(self, table: Mapping[str, Any], part: int) -> None:
        own = table["state_part"] == part
        names = ("state_angle", "state_row", "state_column", "state_value")
        entries = list(zip(*(table[name][own].tolist() for name in names), strict=True))
        bodies = []
        for body, share in enumerate(range(*table["share"][part : part + 2].tolist())):
            first = int(table["term_row"][share])
            rows = [slice(*table["entry"][row : row + 2].tolist()) for row in range(first + 1, first + 4)]
            generators = [{i: (j, value) for q, i, j, value in entries if q == 4 * body + a} for a in (1, 2, 3)]
            bodies.append(_body([table["column"][r] for r in rows], [table["weight"][r] for r in rows], generators))
        columns, bonds, moments, axes, self.scale = map(np.array, zip(*bodies, strict=True))
        self.moments, self.axes = jnp.asarray(moments), jnp.asarray(axes)
        # No part has both.
        self.quaternion = _bond_quaternion if bonds.all() else _body_quaternion
        # The momenta along the principal axes.
        factors = np.swapaxes(axes * self.scale[:, :, None], 1, 2)
        copies = 1 + bonds.astype(int)
        body, axis, copy, i = (k.ravel() for k in np.indices((len(bodies), 3, 2, 3)))
        used = copy < copies[body]
        body, axis, copy, i = body[used], axis[used], copy[used], i[used]
        n = int(table["dim"])
        self.momenta = sparse(3 * body + axis, columns[body, copy, i], factors[body, axis, i], (3 * len(bodies), n))

    def angles(self, tau: Any, x: Any) -> Any:
        """Return the angles of the flow over the time tau."""
        z = self.momenta.times(x).reshape(-1, 3)
        angles = jax.vmap(partial(rotations, self.quaternion), (None, 0, 0, 0))(
            jnp.asarray(tau), self.moments, self.axes, z
        )
        return (angles * self.scale[:, list(AXES)]).ravel()


def _body(columns: Any, weights: Any, generators: Any) -> tuple[Any, bool, Any, Any, Any]:
    """Return the coordinates (2, 3), whether it is a bond, principal moments and axes, and the scale of its elements.

    `generators` have the column and the value of the entry in each row. Times the scale, the elements have the
    brackets [1, 2] = 3, [2, 3] = 1, [3, 1] = 2.
    """
    used = sorted(set(np.concatenate(columns).tolist()))
    is_bond = len(used) == 6
    if is_bond:
        pairs = np.transpose(columns)
        triple = pairs[0].tolist()
    else:
        fixed = [[i for i in used if i not in generator] for generator in generators]
        triple = [one[0] if one else -1 for one in fixed]
        for a in (a for a in range(3) if triple[a] < 0):  # a body without energy along this axis
            triple[a] = generators[(a + 1) % 3][triple[(a + 2) % 3]][0]
        pairs = np.array([triple, triple])
    v = np.array([generators[a][triple[(a + 1) % 3]][1] for a in range(3)])
    scale = 1.0 / np.sqrt(v * np.roll(v, 1))
    scale[0] *= -np.sign(v.prod())
    if is_bond:
        moment = weights[0][0] / scale[0] ** 2
        return pairs, True, np.full(3, moment), np.eye(3), scale
    M = np.zeros((3, 3))
    for a in range(3):
        for column, weight in zip(columns[a].tolist(), weights[a].tolist(), strict=True):
            M[a, triple.index(column)] = weight
    moments, axes = np.linalg.eigh(M / np.outer(scale, scale))
    axes[:, 0] *= np.linalg.det(axes)
    return pairs, False, moments, axes, scale


def _bond_quaternion(tau: Any, moments: Any, z: Any) -> Any:
    """Return the quaternion of the rotation about z by the angle moment tau |z|."""
    vector = 0.5 * moments[0] * tau * z
    square = vector @ vector
    near = square < 1e-4  # where the terms that the series leave out are below the round-off
    half = jnp.sqrt(jnp.where(near, 1.0, square))
    sine = jnp.where(near, 1.0 - square / 6 * (1.0 - square / 20 * (1.0 - square / 42)), jnp.sin(half) / half)
    cosine = jnp.where(near, 1.0 - square / 2 * (1.0 - square / 12 * (1.0 - square / 30)), jnp.cos(half))
    return jnp.append(cosine, sine * vector)


def _after(q: Any, p: Any) -> Any:
    """Return the quaternion of the rotation q after p."""
    (a, b, c, d), (e, f, g, h) = q, p
    return jnp.stack(
        [
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g + c * e + d * f - b * h,
            a * h + d * e + b * g - c * f,
        ]
    )


def _body_quaternion(tau: Any, moments: Any, z: Any) -> Any:
    """Return the quaternion of a free body with momentum z along its principal axes; NaN for too many pieces."""
    differences = jnp.roll(moments, -1) - jnp.roll(moments, -2)
    reach = jnp.max(jnp.abs(differences)) * jnp.abs(tau) * jnp.sqrt(lax.stop_gradient(z @ z)) / PIECE
    count = jnp.clip(jnp.ceil(reach), 1.0, MOST_PIECES)

    def piece(state: Any) -> Any:
        k, z, total = state
        z, q = _piece(moments * (tau / count), differences * (tau / count), z)
        return k + 1.0, z, _after(q, total)

    start = 0.0, z, jnp.array([1.0, 0.0, 0.0, 0.0])
    total = lax.while_loop(lambda state: state[0] < count, piece, start)[2]
    return jnp.where(reach <= MOST_PIECES, total, jnp.nan)


def _piece(m: Any, a: Any, momentum: Any) -> tuple[Any, Any]:
    """Return the momentum after a short time, which is contained in m and a, and the quaternion of the rotation."""
    at_rest = momentum @ momentum < REST
    # The formulas below divide by the momentum; the series up to second order has the derivatives at rest.
    z = jnp.where(at_rest, 1.0, momentum)
    p = jnp.roll(a, -1) * jnp.roll(a, -2) * z * z
    middle = p.mean()
    e = middle - p
    c2, c3 = (e @ e) / 10, e.prod() / 7
    c4, c5 = c2 * c2 / 3, 3 / 11 * c2 * c3
    c6 = (2 * c2 * c4 + c3 * c3) / 13
    s = jnp.array(NODES)[:, None]
    square = s * s
    r = square**2 * (c2 + square * (c3 + square * (c4 + square * (c5 + square * c6))))
    cosm1 = r - square * middle
    below = square * p + cosm1
    root = below / (1.0 + jnp.sqrt(1.0 + below))
    j, k = jnp.roll(root, -1, axis=1), jnp.roll(root, -2, axis=1)
    across = s * a * jnp.roll(z, -1) * jnp.roll(z, -2)
    change = (z * (j * k + j + k - cosm1) + across * (1.0 + root)) / (1.0 + cosm1)
    length2 = z @ z
    rates = (change @ (m * z) + 2.0 * (m * z) @ z) / (change @ z + 2.0 * length2)
    change = change[-1]
    length = jnp.sqrt(length2)
    half = 0.5 * length * (jnp.array(SHARES) @ rates[:-1])
    whole = jnp.sqrt(1.0 - change @ change / (4.0 * length2))
    shortest = jnp.append(whole, jnp.cross(z, change) / (2.0 * length2 * whole))
    after = z + change
    q = _after(jnp.append(jnp.cos(half), jnp.sin(half) / length * after), shortest)
    rate = m * momentum
    turned = jnp.cross(rate, momentum)
    slowly = jnp.append(1.0 - rate @ rate / 8, 0.5 * (rate + 0.5 * m * turned))
    return jnp.where(at_rest, momentum + turned, after), jnp.where(at_rest, slowly, q)


def _rotations(quaternion: Any, tau: Any, moments: Any, axes: Any, z: Any) -> Any:
    """Return the angles of the flow of a momentum z along principal axes, about the axes 3, 1, 2 and 3."""
    q = quaternion(tau, moments, z)
    return _angles(jnp.append(q[0], axes @ q[1:]))


rotations = jax.custom_jvp(_rotations, nondiff_argnums=(0,))


@rotations.defjvp
def _rotations_jvp(quaternion: Any, values: Any, tangents: Any) -> Any:
    *others, z = values
    angles, slopes = jax.vmap(lambda v: jax.jvp(partial(_rotations, quaternion, *others), (z,), (v,)))(jnp.eye(3))
    return angles[0], tangents[-1] @ slopes


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
    total = jnp.array([1.0, 0.0, 0.0, 0.0])
    unit = np.eye(4)
    for angle, axis in zip(angles, AXES, strict=True):
        total = _after(jnp.cos(angle / 2) * unit[0] + jnp.sin(angle / 2) * unit[1 + axis], total)
    return angles + unit[0] * jnp.where(total @ q < 0.0, 2.0 * np.pi, 0.0)
