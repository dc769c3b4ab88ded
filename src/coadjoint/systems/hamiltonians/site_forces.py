"""Lennard-Jones and Coulomb forces between sites of rigid molecules, with first and second derivatives."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.user_functions import (
    ALL_SHARES,
    bodies_of_shares,
    number_of_shares,
    shared,
)

Floats = npt.NDArray[np.float64]


class SiteTables(NamedTuple):
    """Kinds of molecules as tables: those of a kind follow each other, and so do the types of its sites.

    `molecules` and `types` are the numbers of each kind, and `places`, (all types, 3), from the centre of mass in the
    frame of the molecule. A pair of types at distance s has the energy ``qq (1/s + field s^2 - shift) + a/s^12 -
    b/s^6``, each constant (all types, all types). With a cutoff, the energy of two molecules is multiplied by a switch,
    which falls from 1 to 0 between two distances of their centres, `near` and `cutoff`, 0 without one; `box` has the
    periods, (3,), zero without any.
    """

    molecules: npt.NDArray[np.int64]
    types: npt.NDArray[np.int64]
    places: Floats
    qq: Floats
    a: Floats
    b: Floats
    box: Floats
    near: float = 0.0
    cutoff: float = 0.0
    field: float = 0.0
    shift: float = 0.0


FEW = 8
"""Number of terms that are added one by one."""


def site_forces(tables: SiteTables) -> Hamiltonian:
    """Return the energy of all pairs of molecules, of the entries of attitudes, (k, 3, 3), then positions, (k, 3)."""
    # Neighbours of a molecule are copied to rows of one array, at constant distances, so that loops over them are
    # compiled to vector instructions, which round as scalar ones. Every sum has a fixed order.
    molecules, types, places, qq, repulsion, attraction, box, near, cutoff, field, shift = tables
    kinds, count, periodic = len(molecules), int(molecules.sum()), bool(box.any())
    limited = cutoff > 0.0  # compiled into the machine code, which has the cutoff itself as data
    shares, bodies_of = number_of_shares(count), bodies_of_shares(count)
    begins, first_type = (np.concatenate([[0], np.cumsum(array)]) for array in (molecules, types))
    kind_of, first_r = np.repeat(np.arange(kinds), molecules), 9 * count
    # Sites are stored by type, for all molecules of its kind.
    first_site = np.concatenate([[0], np.cumsum(np.repeat(molecules, types))])
    size = int(first_site[-1])
    longest = int(molecules.max())
    # Of the neighbours of a kind: sites of a type, forces on them, those of one site; difference of centres, periods;
    # switch and its slope, and energy.
    X, Y, Z, FX, FY, FZ, GX, GY, GZ, CX, CY, CZ, PX, PY, PZ, W, D, E = (longest * row for row in range(18))

    def in_space(y: Any) -> Any:
        s = np.zeros(3 * size) + 0.0 * y[0]
        for kind in range(kinds):
            for one in range(first_type[kind], first_type[kind + 1]):
                for m in range(begins[kind], begins[kind + 1]):
                    site = first_site[one] + m - begins[kind]
                    for i in range(3):
                        turned = 0.0 * y[0]
                        for k in range(3):
                            turned += y[9 * m + 3 * i + k] * places[one, k]
                        s[size * i + site] = y[first_r + 3 * m + i] + turned
        return s

    def apart(y: Any, m: int, j: int) -> Any:
        """Return the difference of two centres, and the periods by which the second one is moved."""
        at, other = first_r + 3 * m, first_r + 3 * j
        dx, dy, dz = y[at] - y[other], y[at + 1] - y[other + 1], y[at + 2] - y[other + 2]
        if not periodic:
            return dx, dy, dz, 0.0, 0.0, 0.0
        # Not np.rint, which depends on the direction of rounding.
        px, py = box[0] * np.floor(dx / box[0] + 0.5), box[1] * np.floor(dy / box[1] + 0.5)
        pz = box[2] * np.floor(dz / box[2] + 0.5)
        return dx - px, dy - py, dz - pz, px, py, pz

    def switched(s: Any) -> Any:
        """Return the switch at a distance of centres, and its first and second derivatives."""
        if s <= near:
            return 1.0, 0.0, 0.0
        width = cutoff - near
        x = (s - near) / width
        left = x * (1.0 - x)
        value = 1.0 - x * x * x * (10.0 + x * (6.0 * x - 15.0))
        return value, -30.0 * left * left / width, -60.0 * left * (1.0 - 2.0 * x) / (width * width)

    def gathered(y: Any, m: int, kind: int, seen: Any, rows: Any) -> int:
        """Find the later molecules of a kind within the cutoff of one, and return their number."""
        n = 0
        for j in range(max(m + 1, begins[kind]), begins[kind + 1]):
            if limited:
                dx, dy, dz, px, py, pz = apart(y, m, j)
                square = dx * dx + dy * dy + dz * dz
                if square >= cutoff * cutoff:
                    continue
                distance = np.sqrt(square)
                value, slope, _ = switched(distance)
                rows[W + n], rows[D + n], rows[E + n] = value, slope / distance, 0.0
                rows[CX + n], rows[CY + n], rows[CZ + n] = dx, dy, dz
                rows[PX + n], rows[PY + n], rows[PZ + n] = px, py, pz
            seen[n] = j - begins[kind]
            n += 1
        return n

    def copied(s: Any, one: int, seen: Any, rows: Any, n: int) -> None:
        """Set the sites of a type in the neighbours, and no force on them."""
        for k in range(n):
            site = first_site[one] + seen[k]
            rows[X + k], rows[Y + k], rows[Z + k] = s[site], s[size + site], s[2 * size + site]
        for k in range(n if periodic else 0):
            rows[X + k] += rows[PX + k]
            rows[Y + k] += rows[PY + k]
            rows[Z + k] += rows[PZ + k]
        for k in range(n):
            rows[FX + k], rows[FY + k], rows[FZ + k] = 0.0, 0.0, 0.0

    def energies(rows: Any, n: int, x: Any, y: Any, z: Any, q: Any, a: Any, b: Any) -> None:
        for k in range(n):
            dx, dy, dz = x - rows[X + k], y - rows[Y + k], z - rows[Z + k]
            square = dx * dx + dy * dy + dz * dz
            u = 1.0 / square
            sixth = u * u * u
            rows[E + k] += q * (np.sqrt(u) + field * square - shift) + (a * sixth - b) * sixth

    def slopes(rows: Any, n: int, x: Any, y: Any, z: Any, q: Any, a: Any, b: Any) -> None:
        """Set the derivatives of the energies by a site, and add those by the neighbours."""
        for k in range(n):
            dx, dy, dz = x - rows[X + k], y - rows[Y + k], z - rows[Z + k]
            u = 1.0 / (dx * dx + dy * dy + dz * dz)
            bare = q * np.sqrt(u)
            if b > 0.0:
                sixth = u * u * u
                bare += (12.0 * a * sixth - 6.0 * b) * sixth
            g = 2.0 * field * q - bare * u if limited else -bare * u
            if limited:
                g *= rows[W + k]
            gx, gy, gz = g * dx, g * dy, g * dz
            rows[GX + k], rows[GY + k], rows[GZ + k] = gx, gy, gz
            rows[FX + k] -= gx
            rows[FY + k] -= gy
            rows[FZ + k] -= gz

    def added_up(rows: Any, n: int) -> Any:
        """Return the sums of the derivatives by a site, whose halves are added to each other again and again."""
        while n > FEW:
            half = (n + 1) // 2
            for k in range(n - half):
                rows[GX + k] += rows[GX + half + k]
                rows[GY + k] += rows[GY + half + k]
                rows[GZ + k] += rows[GZ + half + k]
            n = half
        fx, fy, fz = 0.0 * rows[0], 0.0 * rows[0], 0.0 * rows[0]
        for k in range(n):
            fx += rows[GX + k]
            fy += rows[GY + k]
            fz += rows[GZ + k]
        return fx, fy, fz

    def value(y: Any, share: Any = ALL_SHARES) -> Any:
        s, total, seen = in_space(y), 0.0 * y[0], np.zeros(longest, dtype=np.int64)
        rows, (begin, step) = np.zeros(18 * longest) + total, bodies_of(share)
        for m in range(begin, count - 1, step):
            own = kind_of[m]
            for kind in range(own, kinds):
                n = gathered(y, m, kind, seen, rows)
                for k in range(n):
                    rows[E + k] = 0.0
                for other in range(first_type[kind], first_type[kind + 1]):
                    copied(s, other, seen, rows, n)
                    for one in range(first_type[own], first_type[own + 1]):
                        at = first_site[one] + m - begins[own]
                        x, v, z = s[at], s[size + at], s[2 * size + at]
                        q, a, b = qq[one, other], repulsion[one, other], attraction[one, other]
                        energies(rows, n, x, v, z, q, a, b)
                for k in range(n):
                    total += rows[W + k] * rows[E + k] if limited else rows[E + k]
        return total

    def gradient(y: Any, share: Any = ALL_SHARES) -> Any:
        s, result, seen = in_space(y), 0.0 * y, np.zeros(longest, dtype=np.int64)
        begin, step = bodies_of(share)
        f, rows = 0.0 * s, np.zeros(18 * longest) + result[0]
        for m in range(begin, count - 1, step):
            own = kind_of[m]
            for kind in range(own, kinds):
                n = gathered(y, m, kind, seen, rows)
                for other in range(first_type[kind], first_type[kind + 1]):
                    copied(s, other, seen, rows, n)
                    for one in range(first_type[own], first_type[own + 1]):
                        at = first_site[one] + m - begins[own]
                        x, v, z = s[at], s[size + at], s[2 * size + at]
                        q, a, b = qq[one, other], repulsion[one, other], attraction[one, other]
                        slopes(rows, n, x, v, z, q, a, b)
                        fx, fy, fz = added_up(rows, n)
                        f[at] += fx
                        f[size + at] += fy
                        f[2 * size + at] += fz
                        if limited:
                            energies(rows, n, x, v, z, q, a, b)
                    for i in range(3):
                        for k in range(n):
                            f[size * i + first_site[other] + seen[k]] += rows[FX + longest * i + k]
                for k in range(n if limited else 0):  # the slope of the switch acts on the centres
                    pull, j = rows[E + k] * rows[D + k], begins[kind] + seen[k]
                    for i in range(3):
                        result[first_r + 3 * m + i] += pull * rows[CX + longest * i + k]
                        result[first_r + 3 * j + i] -= pull * rows[CX + longest * i + k]
        for kind in range(kinds):
            for one in range(first_type[kind], first_type[kind + 1]):
                for m in range(begins[kind], begins[kind + 1]):
                    for i in range(3):
                        force = f[size * i + first_site[one] + m - begins[kind]]
                        result[first_r + 3 * m + i] += force
                        for k in range(3):
                            result[9 * m + 3 * i + k] += force * places[one, k]
        return result

    def added(slope: Any, second: Any, d: Any, lever: Any, g: Any, h: Any, factor: Any) -> None:
        """Add derivatives of a function of |p|, p_i = d_i = sum of lever and coordinates, for those of two bodies."""
        # `g` is its derivative over |p|, and `h` that of `g`; second derivatives are multiplied by a factor.
        for c in range(24):
            i, one = c % 12 // 4, lever[c // 12, c % 4]
            slope[c] += g * d[i] * one
            for e in range(24):
                j, other = e % 12 // 4, lever[e // 12, e % 4]
                second[c, e] += factor * h * d[i] * one * d[j] * other
                if i == j:
                    second[c, e] += factor * g * one * other

    def hessian(y: Any) -> Any:
        s, result = in_space(y), np.outer(0.0 * y, y)
        d, lever, centre = np.zeros(3) + result[0, 0], np.zeros((2, 4)), np.zeros((2, 4))
        centre[0, 3] = lever[0, 3] = 1.0
        centre[1, 3] = lever[1, 3] = -1.0
        for m in range(count):
            for j in range(m + 1, count):
                dx, dy, dz, px, py, pz = apart(y, m, j)
                distance = np.sqrt(dx * dx + dy * dy + dz * dz)
                if limited and cutoff <= distance:
                    continue
                energy = 0.0 * distance
                slope, second = np.zeros(24) + energy, np.zeros((24, 24)) + energy
                for one in range(first_type[kind_of[m]], first_type[kind_of[m] + 1]):
                    for other in range(first_type[kind_of[j]], first_type[kind_of[j] + 1]):
                        at = first_site[one] + m - begins[kind_of[m]]
                        there = first_site[other] + j - begins[kind_of[j]]
                        d[0] = s[at] - (s[there] + px)
                        d[1] = s[size + at] - (s[size + there] + py)
                        d[2] = s[2 * size + at] - (s[2 * size + there] + pz)
                        for k in range(3):
                            lever[0, k], lever[1, k] = places[one, k], -places[other, k]
                        q, a, b = qq[one, other], repulsion[one, other], attraction[one, other]
                        square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
                        u = 1.0 / square
                        bare, sixth = q * np.sqrt(u), u * u * u
                        energy += bare + q * (field * square - shift) + (a * sixth - b) * sixth
                        g = 2.0 * field * q - (bare + (12.0 * a * sixth - 6.0 * b) * sixth) * u
                        h = (3.0 * bare + (168.0 * a * sixth - 48.0 * b) * sixth) * u * u
                        added(slope, second, d, lever, g, h, 1.0)
                if limited:
                    weight, first, again = switched(distance)
                    for c in range(24):
                        for e in range(24):
                            second[c, e] *= weight
                    d[0], d[1], d[2] = dx, dy, dz
                    along, first = np.zeros(24) + 0.0 * energy, first / distance
                    added(along, second, d, centre, first, (again - first) / distance**2, energy)
                    second += np.outer(along, slope) + np.outer(slope, along)
                for c in range(24):
                    row = first_r + 3 * (m, j)[c // 12] + c % 12 // 4
                    if c % 4 < 3:
                        row = 9 * (m, j)[c // 12] + 3 * (c % 12 // 4) + c % 4
                    for e in range(24):
                        column = first_r + 3 * (m, j)[e // 12] + e % 12 // 4
                        if e % 4 < 3:
                            column = 9 * (m, j)[e // 12] + 3 * (e % 12 // 4) + e % 4
                        result[row, column] += second[c, e]
        return result

    energy = Hamiltonian(shared(value, shares), shared(gradient, shares), hessian)
    energy.dim = 12 * count  # bound without a check of the derivatives, which takes minutes for many molecules
    return energy
