"""The gravity field of homogeneous polyhedra in closed form, and their mutual gravity with points and other bodies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.systems.hamiltonians.hamiltonian import FunctionOfConstants
from coadjoint.systems.hamiltonians.mutual_gravity import (
    by_complex_steps,
    constants_of_gravity,
    fourth_order_terms,
    gravity_functions,
    sum_of,
)
from coadjoint.systems.user_functions import ALL_SHARES, bodies_of_shares, number_of_shares

Numbers = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

FLAT = 2.0**-40
"""Largest entry of the tensors of an edge, relative to unit normals, that is what rounding leaves between two triangles
of one plane."""
ROW, COLUMN = (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)
"""Rows and columns of the six entries of a symmetric tensor."""
EDGE, FACE = 19, 13
"""Numbers of an edge: its ends, its length and two symmetric tensors; of a face: its corners, its normal and twice its
area."""
PLACE = ((0, 1, 2), (1, 3, 4), (2, 4, 5))
"""Where the entries of a symmetric tensor are among the six."""
FAR = 500.0
"""Distance, relative to the size of a polyhedron, from which on it is of second order: 1e-9 of the attraction are there
both the rounding of the full field, which grows as the square of the distance, and what is left out."""
BELOW = "a body is on or below the surface of a polyhedron, whose field is known outside of it"


class Polyhedron(NamedTuple):
    """Volume and largest distance of a polyhedron from its origin, and a table of its edges and faces."""

    volume: float
    size: float
    edges: Floats
    faces: Floats

    @property
    def constants(self) -> Floats:
        """The numbers as the compiled function reads them; lengths are relative to the size."""
        counts = [len(self.edges), len(self.faces), self.size, self.volume / self.size**3]
        return np.concatenate([counts, self.edges.ravel(), self.faces.ravel()])


def polyhedron(points: Floats, triangles: Integers, volume: float) -> Polyhedron:
    """Return the table of a closed surface of triangles, (m, 3), which are counter-clockwise seen from outside."""
    # An edge has E = sum of n m over its faces, m outward in the face, and the sum of n n, signed by the direction in
    # which a face passes it. Both vanish between triangles of one plane, whose edge is left out.
    size = float(np.sqrt((points * points).sum(axis=1)).max())
    y = points / size
    corners = y[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.sqrt((normals * normals).sum(axis=1))
    normals /= np.where(doubled > 0.0, doubled, 1.0)[:, None]
    first, second = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    along, n = y[second] - y[first], np.repeat(normals, 3, axis=0)
    outward = np.cross(along / np.sqrt((along * along).sum(axis=1))[:, None], n)
    forward = np.where(first < second, 1.0, -1.0)
    keys, inverse = np.unique(np.sort([first, second], axis=0), axis=1, return_inverse=True)
    tensors = np.zeros((keys.shape[1], 2, 3, 3))
    np.add.at(tensors[:, 0], inverse, n[:, :, None] * outward[:, None, :])
    np.add.at(tensors[:, 1], inverse, forward[:, None, None] * n[:, :, None] * n[:, None, :])
    bent = np.abs(tensors).max(axis=(1, 2, 3)) > FLAT
    (p, q), pairs = y[keys[:, bent]], tensors[bent]
    symmetric = (0.5 * (pairs + pairs.swapaxes(2, 3)))[:, :, ROW, COLUMN].reshape(-1, 12)
    lengths = np.sqrt(((p - q) ** 2).sum(axis=1))
    edges = np.concatenate([p, q, lengths[:, None], symmetric], axis=1)
    faces = np.concatenate([corners.reshape(-1, 9), normals, doubled[:, None]], axis=1)
    return Polyhedron(volume, size, edges, faces)


def polyhedron_gravity(
    coordinates: Any, masses: Numbers, anisotropic: Numbers, gravity: Any, shapes: Sequence[Polyhedron | None]
) -> FunctionOfConstants:
    """Return the mutual gravity of bodies of which some are polyhedra, and the others of second order."""
    # Of a polyhedron P and another body X it is ``m_X U(w) - D_X : (second derivatives of U)/2``, U the full field of
    # P: all orders of P, and the mass and the second moments of X. Of two polyhedra it is the sum of both, without the
    # mass and second moments of both, which would count twice: terms of third order of both are left out.
    count = len(masses)
    places, tables, end = [], [], 1 + 12 * count
    for shape in shapes:
        places.append(0.0 if shape is None else float(end))
        tables.append(np.zeros(0) if shape is None else shape.constants)
        end += len(tables[-1])
    constants = np.concatenate([constants_of_gravity(masses, anisotropic, gravity), places, *tables])
    value, gradient, hessian = _functions(count, sum(shape is not None for shape in shapes))
    return FunctionOfConstants(coordinates, constants, value, gradient, hessian, number_of_shares(count))


@lru_cache(maxsize=64)
def _functions(count: int, polyhedra: int) -> tuple[Callable[..., Any], ...]:
    """Return V and its derivatives as functions of y and of the constants, for any of the bodies as `polyhedra`."""
    axes, D_at, squares_at, places_at = 9 * count, 1 + count, 1 + 10 * count, 1 + 11 * count
    bodies_of = bodies_of_shares(count)
    pair = gravity_functions(2, 2, False)
    if polyhedra > 1:
        pair = sum_of(pair, fourth_order_terms(2, ellipsoids=False))
    pair_value, pair_gradient = pair[:2]

    def alone(y: Any, constants: Any, i: int, j: int) -> Any:
        """Return the coordinates and the constants of two bodies."""
        x, c = np.zeros_like(y[:24]), np.zeros_like(constants[:23])
        c[0] = constants[0]
        for n in range(2):
            k = i if n == 0 else j
            c[1 + n], c[21 + n] = constants[1 + k], constants[squares_at + k]
            for e in range(9):
                x[9 * n + e], c[3 + 9 * n + e] = y[9 * k + e], constants[D_at + 9 * k + e]
            for a in range(3):
                x[18 + 3 * n + a] = y[axes + 3 * k + a]
        return x, c

    def placed(y: Any, constants: Any, one: int, other: int, at: int) -> Any:
        """Return R between the centres in space, and of another body in the frame of a polyhedron its position w, B D
        with its attitude B and anisotropic inertia D, and B D B^T by its entries, those beside the diagonal doubled;
        and whether it is near enough for the full field, and has an anisotropic inertia.
        """
        R, w, q = np.zeros_like(y[:3]), np.zeros_like(y[:3]), np.zeros_like(y[:6])
        B, BD = np.zeros_like(y[:9]), np.zeros_like(y[:9])
        for a in range(3):
            R[a] = y[axes + 3 * other + a] - y[axes + 3 * one + a]
        for b in range(3):
            for a in range(3):
                w[b] += y[9 * one + 3 * a + b] * R[a]
                for c in range(3):
                    B[3 * b + c] += y[9 * one + 3 * a + b] * y[9 * other + 3 * a + c]
        extended = False
        for c in range(3):
            for d in range(3):
                entry = constants[D_at + 9 * other + 3 * d + c]
                extended = extended or entry != 0.0
                for b in range(3):
                    BD[3 * b + c] += B[3 * b + d] * entry
        for n in range(6):
            times = 1.0 if ROW[n] == COLUMN[n] else 2.0
            for c in range(3):
                q[n] += times * BD[3 * ROW[n] + c] * B[3 * COLUMN[n] + c]
        reach = FAR * constants[at + 2].real
        near = w[0].real ** 2 + w[1].real ** 2 + w[2].real ** 2 <= reach * reach
        return R, w, BD, q, near, extended

    def field(w: Any, q: Any, m: Any, extended: bool, constants: Any, at: int) -> Any:
        """Return ``f = m U - q.H/2``, df/dw and H of the field U of a polyhedron of unit mass, by the table `at`."""
        # Werner and Scheeres, Celest. Mech. Dyn. Astron. 65, 313 (1997). Of an edge L is the integral of 1/r, and of a
        # face `angle` the solid angle. The derivative of H has those of both; of an angle it is a sum over edges.
        edges, faces = int(constants[at].real), int(constants[at + 1].real)
        size, begin = constants[at + 2], at + 4 + EDGE * edges
        of_edge = constants[at + 4 : begin].reshape(edges, EDGE)
        of_face = constants[begin : begin + FACE * faces].reshape(faces, FACE)
        zero = 0.0 * w[0]
        g, T, H = np.zeros_like(w), np.zeros_like(w), np.zeros_like(q)
        x, y, z = w[0] / size, w[1] / size, w[2] / size
        U, turns = zero, 0.0 * x.real
        for k in range(edges):
            ax, ay, az = of_edge[k, 0] - x, of_edge[k, 1] - y, of_edge[k, 2] - z
            bx, by, bz = of_edge[k, 3] - x, of_edge[k, 4] - y, of_edge[k, 5] - z
            a, b = np.sqrt(ax * ax + ay * ay + az * az), np.sqrt(bx * bx + by * by + bz * bz)
            length = of_edge[k, 6]
            rest = a + b - length
            if rest.real <= 0.0:
                raise ValueError(BELOW)
            L = np.log1p(2.0 * length / rest)
            gx = (of_edge[k, 7] * ax + of_edge[k, 8] * ay + of_edge[k, 9] * az) * L
            gy = (of_edge[k, 8] * ax + of_edge[k, 10] * ay + of_edge[k, 11] * az) * L
            gz = (of_edge[k, 9] * ax + of_edge[k, 11] * ay + of_edge[k, 12] * az) * L
            U += 0.5 * (ax * gx + ay * gy + az * gz)
            g[0] -= gx
            g[1] -= gy
            g[2] -= gz
            if extended:
                bent, tilt = zero, zero
                for n in range(6):
                    H[n] += of_edge[k, 7 + n] * L
                    bent += q[n] * of_edge[k, 7 + n]
                    tilt += q[n] * of_edge[k, 13 + n]
                across = 0.5 * rest * (a + b + length)  # a b + the scalar product
                bent, tilt = bent * length / across, tilt * (a + b) / (a * b * across)
                T[0] += bent * (ax / a + bx / b) - tilt * (ay * bz - az * by)
                T[1] += bent * (ay / a + by / b) - tilt * (az * bx - ax * bz)
                T[2] += bent * (az / a + bz / b) - tilt * (ax * by - ay * bx)
        for k in range(faces):
            ax, ay, az = of_face[k, 0] - x, of_face[k, 1] - y, of_face[k, 2] - z
            bx, by, bz = of_face[k, 3] - x, of_face[k, 4] - y, of_face[k, 5] - z
            cx, cy, cz = of_face[k, 6] - x, of_face[k, 7] - y, of_face[k, 8] - z
            nx, ny, nz = of_face[k, 9], of_face[k, 10], of_face[k, 11]
            a, b = np.sqrt(ax * ax + ay * ay + az * az), np.sqrt(bx * bx + by * by + bz * bz)
            c = np.sqrt(cx * cx + cy * cy + cz * cz)
            h = nx * ax + ny * ay + nz * az
            triple = h * of_face[k, 12]
            below = a * b * c + a * (bx * cx + by * cy + bz * cz) + b * (ax * cx + ay * cy + az * cz)
            below += c * (ax * bx + ay * by + az * bz)
            both = np.sqrt(triple * triple + below * below)
            if below.real > 0.0:
                angle = 4.0 * np.arctan(triple / (both + below))
            elif triple.real != 0.0:
                angle = 4.0 * np.arctan((both - below) / triple)
            else:
                raise ValueError(BELOW)
            turns += angle.real
            pull = h * angle
            U -= 0.5 * h * pull
            g[0] += nx * pull
            g[1] += ny * pull
            g[2] += nz * pull
            if extended:
                H[0] -= nx * nx * angle
                H[1] -= nx * ny * angle
                H[2] -= nx * nz * angle
                H[3] -= ny * ny * angle
                H[4] -= ny * nz * angle
                H[5] -= nz * nz * angle
        if turns >= 1.0:  # 4 pi inside, and 0 outside; states that are not finite have no finite field
            raise ValueError(BELOW)
        unit = 1.0 / (size * constants[at + 3])
        f = m * U * unit
        for a in range(3):
            g[a] = m * g[a] * unit / size
        if extended:
            unit = unit / (size * size)
            for n in range(6):
                H[n] = H[n] * unit
                f -= 0.5 * q[n] * H[n]
            for a in range(3):
                g[a] -= 0.5 * T[a] * unit / size
        return f, g, H

    def value(y: Any, constants: Any, share: Any = ALL_SHARES) -> Any:
        begin, step = bodies_of(share)
        total = 0.0 * y[0]
        for i in range(begin, count, step):
            for j in range(i):
                times = 1.0
                for one, other in ((i, j), (j, i)):
                    at = int(constants[places_at + one].real)
                    if at == 0:
                        continue
                    _, w, _, q, near, extended = placed(y, constants, one, other, at)
                    if not near:
                        continue
                    times -= 1.0
                    f, _, _ = field(w, q, constants[1 + other], extended, constants, at)
                    total -= constants[0] * constants[1 + one] * f
                if times != 0.0:
                    x, c = alone(y, constants, i, j)
                    total += times * pair_value(x, c)
        return total

    def gradient(y: Any, constants: Any, share: Any = ALL_SHARES) -> Any:
        begin, step = bodies_of(share)
        result = np.zeros_like(y)
        for i in range(begin, count, step):
            for j in range(i):
                times = 1.0
                for one, other in ((i, j), (j, i)):
                    at = int(constants[places_at + one].real)
                    if at == 0:
                        continue
                    R, w, BD, q, near, extended = placed(y, constants, one, other, at)
                    if not near:
                        continue
                    times -= 1.0
                    _, g, H = field(w, q, constants[1 + other], extended, constants, at)
                    factor = -constants[0] * constants[1 + one]
                    for a in range(3):
                        push = 0.0 * factor
                        for b in range(3):
                            push += factor * y[9 * one + 3 * a + b] * g[b]
                            result[9 * one + 3 * a + b] += factor * R[a] * g[b]
                        result[axes + 3 * other + a] += push
                        result[axes + 3 * one + a] -= push
                    if extended:
                        for b in range(3):
                            for c in range(3):
                                # The derivative by B = A_one^T A_other, of -H:(B D B^T)/2.
                                slope = 0.0 * factor
                                for d in range(3):
                                    slope -= factor * H[PLACE[b][d]] * BD[3 * d + c]
                                for a in range(3):
                                    result[9 * one + 3 * a + b] += slope * y[9 * other + 3 * a + c]
                                    result[9 * other + 3 * a + c] += slope * y[9 * one + 3 * a + b]
                if times != 0.0:
                    x, c = alone(y, constants, i, j)
                    slopes = pair_gradient(x, c)
                    for n in range(2):
                        k = i if n == 0 else j
                        for e in range(9):
                            result[9 * k + e] += times * slopes[9 * n + e]
                        for a in range(3):
                            result[axes + 3 * k + a] += times * slopes[18 + 3 * n + a]
        return result

    return value, gradient, by_complex_steps(gradient)
