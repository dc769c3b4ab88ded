"""Lennard-Jones and Coulomb forces between sites of rigid molecules, with first and second derivatives."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.user_functions import callable_from_compiled

Floats = npt.NDArray[np.float64]


class SiteTables(NamedTuple):
    """Molecules in order as tables; sites of equal type have the same place in a molecule and the same constants.

    `starts` are the first sites of molecules, (molecules + 1,), `types` those of sites, and `places`, (types, 3),
    are from the centre of mass in the frame of the molecule. A pair of types at distance s has the energy ``qq (1/s +
    field s^2 - shift) + a/s^12 - b/s^6``, each constant (types, types). With a cutoff, the energy of two molecules is
    multiplied by a switch, which falls from 1 to 0 between two distances of their centres, `near` and `cutoff`, 0
    without one; `box` has the periods, (3,), zero without any.
    """

    starts: npt.NDArray[np.int64]
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


def site_forces(tables: SiteTables) -> Hamiltonian:
    """Return the energy of all pairs of molecules, of the entries of attitudes, (k, 3, 3), then of positions, (k, 3).

    The sites of later molecules within the cutoff are copied to the rows of one array, at constant distances, so that
    loops over them are compiled to vector instructions, which round as scalar ones. Every sum has a fixed order.
    """
    starts, types, places, qq, repulsion, attraction, box, near, cutoff, field, shift = tables
    count, size, periodic = len(starts) - 1, len(types), bool(box.any())
    owners, first_r = np.repeat(np.arange(count), np.diff(starts)), 9 * count
    # Of neighbours: place, constants of the pair, energy, slope, force, switch and its slope, difference of centres.
    X, Y, Z, QQ, A, B, E, G, FX, FY, FZ, W, D, CX, CY, CZ = (size * row for row in range(16))

    def in_space(y: Any) -> Any:
        s = np.zeros(3 * size) + 0.0 * y[0]
        for site in range(size):
            m, one = owners[site], types[site]
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

    sites, separation, switch = (callable_from_compiled(f) for f in (in_space, apart, switched))

    def gathered(y: Any, s: Any, m: int, seen: Any, rows: Any) -> int:
        """Copy the sites of later molecules within the cutoff of one, and return their number."""
        n = 0
        for j in range(m + 1, count):
            dx, dy, dz, px, py, pz = separation(y, m, j)
            value, slope = 1.0, 0.0
            if cutoff > 0.0:
                square = dx * dx + dy * dy + dz * dz
                if square >= cutoff * cutoff:
                    continue
                distance = np.sqrt(square)
                value, first, _ = switch(distance)
                slope = first / distance
            for site in range(starts[j], starts[j + 1]):
                rows[X + n], rows[Y + n], rows[Z + n] = s[site] + px, s[size + site] + py, s[2 * size + site] + pz
                rows[CX + n], rows[CY + n], rows[CZ + n] = dx, dy, dz
                rows[W + n], rows[D + n], rows[E + n] = value, slope, 0.0
                rows[FX + n], rows[FY + n], rows[FZ + n] = 0.0, 0.0, 0.0
                seen[n] = site
                n += 1
        return n

    def paired(site: int, seen: Any, rows: Any, n: int) -> None:
        one = types[site]
        for k in range(n):
            other = types[seen[k]]
            rows[QQ + k], rows[A + k], rows[B + k] = qq[one, other], repulsion[one, other], attraction[one, other]

    def energies(rows: Any, n: int, x: Any, y: Any, z: Any) -> None:
        for k in range(n):
            dx, dy, dz = x - rows[X + k], y - rows[Y + k], z - rows[Z + k]
            square = dx * dx + dy * dy + dz * dz
            u = 1.0 / square
            sixth = u * u * u
            coulomb = rows[QQ + k] * (np.sqrt(u) + field * square - shift)
            rows[E + k] += coulomb + (rows[A + k] * sixth - rows[B + k]) * sixth

    def slopes(rows: Any, n: int, x: Any, y: Any, z: Any) -> None:
        """Set the derivatives of energies by the distance over the distance."""
        for k in range(n):
            dx, dy, dz = x - rows[X + k], y - rows[Y + k], z - rows[Z + k]
            u = 1.0 / (dx * dx + dy * dy + dz * dz)
            sixth = u * u * u
            bare = rows[QQ + k] * np.sqrt(u) + (12.0 * rows[A + k] * sixth - 6.0 * rows[B + k]) * sixth
            rows[G + k] = rows[W + k] * (2.0 * field * rows[QQ + k] - bare * u)

    def reactions(rows: Any, n: int, x: Any, y: Any, z: Any) -> None:
        for k in range(n):
            g = rows[G + k]
            rows[FX + k] -= g * (x - rows[X + k])
            rows[FY + k] -= g * (y - rows[Y + k])
            rows[FZ + k] -= g * (z - rows[Z + k])

    def actions(rows: Any, n: int, x: Any, y: Any, z: Any) -> Any:
        fx, fy, fz = 0.0 * x, 0.0 * x, 0.0 * x
        for k in range(n):
            g = rows[G + k]
            fx += g * (x - rows[X + k])
            fy += g * (y - rows[Y + k])
            fz += g * (z - rows[Z + k])
        return fx, fy, fz

    gather, set_pair, add_energies = (callable_from_compiled(f) for f in (gathered, paired, energies))
    set_slopes, add_reactions, sum_actions = (callable_from_compiled(f) for f in (slopes, reactions, actions))

    def value(y: Any) -> Any:
        s, total, seen = sites(y), 0.0 * y[0], np.zeros(size, dtype=np.int64)
        rows = np.zeros(16 * size) + total
        for m in range(count - 1):
            n = gather(y, s, m, seen, rows)
            for site in range(starts[m], starts[m + 1]):
                set_pair(site, seen, rows, n)
                add_energies(rows, n, s[site], s[size + site], s[2 * size + site])
            for k in range(n):
                total += rows[W + k] * rows[E + k]
        return total

    def gradient(y: Any) -> Any:
        s, result, seen = sites(y), 0.0 * y, np.zeros(size, dtype=np.int64)
        f, rows = 0.0 * s, np.zeros(16 * size) + result[0]
        for m in range(count - 1):
            n = gather(y, s, m, seen, rows)
            for site in range(starts[m], starts[m + 1]):
                x, v, z = s[site], s[size + site], s[2 * size + site]
                set_pair(site, seen, rows, n)
                set_slopes(rows, n, x, v, z)
                add_reactions(rows, n, x, v, z)
                fx, fy, fz = sum_actions(rows, n, x, v, z)
                f[site] += fx
                f[size + site] += fy
                f[2 * size + site] += fz
                if near < cutoff:
                    add_energies(rows, n, x, v, z)
            for k in range(n):
                site = seen[k]
                pull = rows[E + k] * rows[D + k]  # the slope of the switch acts on the centres
                for i in range(3):
                    f[size * i + site] += rows[FX + size * i + k]
                    result[first_r + 3 * m + i] += pull * rows[CX + size * i + k]
                    result[first_r + 3 * owners[site] + i] -= pull * rows[CX + size * i + k]
        for site in range(size):
            m = owners[site]
            for i in range(3):
                result[first_r + 3 * m + i] += f[size * i + site]
                for k in range(3):
                    result[9 * m + 3 * i + k] += f[size * i + site] * places[types[site], k]
        return result

    def added(slope: Any, second: Any, d: Any, lever: Any, g: Any, h: Any, factor: Any) -> None:
        """Add derivatives of a function of |p|, p_i = d_i = sum of lever and coordinates, for those of two bodies.

        `g` is its derivative over |p|, and `h` that of `g`; second derivatives are multiplied by a factor.
        """
        for c in range(24):
            i, one = c % 12 // 4, lever[c // 12, c % 4]
            slope[c] += g * d[i] * one
            for e in range(24):
                j, other = e % 12 // 4, lever[e // 12, e % 4]
                second[c, e] += factor * h * d[i] * one * d[j] * other
                if i == j:
                    second[c, e] += factor * g * one * other

    add_second = callable_from_compiled(added)

    def hessian(y: Any) -> Any:
        s, result = sites(y), np.outer(0.0 * y, y)
        d, lever, centre = np.zeros(3) + result[0, 0], np.zeros((2, 4)), np.zeros((2, 4))
        centre[0, 3] = lever[0, 3] = 1.0
        centre[1, 3] = lever[1, 3] = -1.0
        for m in range(count):
            for j in range(m + 1, count):
                dx, dy, dz, px, py, pz = separation(y, m, j)
                distance = np.sqrt(dx * dx + dy * dy + dz * dz)
                if 0.0 < cutoff <= distance:
                    continue
                energy = 0.0 * distance
                slope, second = np.zeros(24) + energy, np.zeros((24, 24)) + energy
                for site in range(starts[m], starts[m + 1]):
                    for near_site in range(starts[j], starts[j + 1]):
                        one, other = types[site], types[near_site]
                        d[0] = s[site] - (s[near_site] + px)
                        d[1] = s[size + site] - (s[size + near_site] + py)
                        d[2] = s[2 * size + site] - (s[2 * size + near_site] + pz)
                        for k in range(3):
                            lever[0, k], lever[1, k] = places[one, k], -places[other, k]
                        q, a, b = qq[one, other], repulsion[one, other], attraction[one, other]
                        square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
                        u = 1.0 / square
                        bare, sixth = q * np.sqrt(u), u * u * u
                        energy += bare + q * (field * square - shift) + (a * sixth - b) * sixth
                        g = 2.0 * field * q - (bare + (12.0 * a * sixth - 6.0 * b) * sixth) * u
                        h = (3.0 * bare + (168.0 * a * sixth - 48.0 * b) * sixth) * u * u
                        add_second(slope, second, d, lever, g, h, 1.0)
                if cutoff > 0.0:
                    weight, first, again = switch(distance)
                    for c in range(24):
                        for e in range(24):
                            second[c, e] *= weight
                    d[0], d[1], d[2] = dx, dy, dz
                    along, first = np.zeros(24) + 0.0 * energy, first / distance
                    add_second(along, second, d, centre, first, (again - first) / distance**2, energy)
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

    energy = Hamiltonian(value, gradient, hessian)
    energy.dim = 12 * count  # bound without a check of the derivatives, which takes minutes for many molecules
    return energy
