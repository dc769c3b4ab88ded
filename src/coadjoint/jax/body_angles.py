"""Flows of free bodies and bonds in a table, as four rotations about fixed axes, as operations of JAX."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from coadjoint.jax.body_motion import PAIRS, after, motion
from coadjoint.jax.stage_steps import sparse

# The sine above which the rotation about the second axis counts as near a right angle.
UPRIGHT = 0.9
# Axes of the four rotations of a body.
AXES = (2, 0, 1, 2)


Angles = tuple[Callable[[Any], Any], Callable[[Any, Any, Any, Any], Any]]
"""The constants of a part from the numbers of its table, and angles of its flow, of these, tau, a state and a time."""


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

    def at(inverse_inertia: Any, tau: Any, x: Any, t: Any) -> Any:
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
