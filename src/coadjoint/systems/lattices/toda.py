"""The Toda lattice in Flaschka's variables, open and periodic."""

from __future__ import annotations

import math
from collections import Counter
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.constants import check_algebra_memory
from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.short_repr import short
from coadjoint.systems.closed_forms.closed_form import move_state
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_integer

Floats = npt.NDArray[np.float64]

MAX_POLYNOMIAL_SITES = 64  # largest number of sites with dense polynomial invariants
MAX_SITES_WITH_ALL_TRACES = 8  # largest number of sites with all traces; for more only those of L^3 and L^4
MAX_PRECISION_BITS = 2**20
FLASCHKA = {"b": ("momentum", "1/time"), "a": ("position", "1/time")}  # an a depends on the distance of two particles


def _names(missing_bonds: int, dim: int) -> tuple[str, ...]:
    """Return b1, b2, ..., a1, a2, ... for `dim` coordinates."""
    n = (dim + missing_bonds) // 2
    return (*(f"b{i + 1}" for i in range(n)), *(f"a{i + 1}" for i in range(dim - n)))


def _position(i: int, x: Any) -> Any:
    """Return the position of a particle relative to the centre of all, in units of 1/beta and for A beta = exp(4) m."""
    bonds = x.shape[-1] // 2
    gaps = 4.0 - 2.0 * np.log(2.0 * np.abs(x[..., bonds + 1 :]))
    positions = np.concatenate([np.zeros_like(gaps[..., :1]), np.cumsum(gaps, axis=-1)], axis=-1)
    return positions[..., i] - positions.mean(axis=-1)


def _particles(dim: int) -> dict[str, Any]:
    """Return the positions of at most eight particles as functions of the state."""
    return {f"q{i + 1}": partial(_position, i) for i in range(min(8, (dim + 1) // 2))}


def _sampled_velocities(dim: int) -> range:
    return range(0, dim // 2, max(1, dim // 16))


def _compressed_ring() -> Floats:
    """Return a ring of 48 sites at rest, compressed around one of them."""
    a = 0.5 + 0.35 * np.exp(-0.25 * (np.arange(48) - 11.5) ** 2)
    return np.concatenate([np.zeros(48), a])


@ready_made(
    coordinates=FLASCHKA,
    gallery_entry=GalleryEntry(
        x0=(-0.8, 0.1, -0.2, 0.9, 0.4, 0.35, 0.45),
        t_span=(0.0, 12.0),
        step=0.02,
        caption="Four particles that repel each other meet, and fly apart: all a go to zero, and the b to the "
        "eigenvalues of the matrix L, sorted. Below, the particles as they move about their centre.",
        components=Picture("components", quantity="state"),
        pictures=(Picture("components", functions=_particles, quantity="position of the particles"),),
        coordinates=partial(_names, 1),
        quantity="state",
    ),
)
def toda(sites: int = 4) -> LiePoissonSystem:
    """Return the open Toda lattice in Flaschka's variables, with its exact solution by QR.

    Particles of mass m on a line; neighbours at the distance r_i repel each other with the energy ``(A/beta) exp(-beta
    r_i)``. Then ``b_i = -beta p_i / (2 m)`` and ``a_i = sqrt(A beta / m) exp(-beta r_i / 2) / 2`` satisfy
    ``b_i' = 2 (a_i^2 - a_(i-1)^2)``, ``a_i' = a_i (b_(i+1) - b_i)``, in which all constants are scaled into the state.
    The particles disperse: every a_i tends to zero, and the b_i to the eigenvalues of L, the largest first. Sign +1,
    ``H = tr L^2 / 2 = sum b_i^2 / 2 + sum a_i^2``, with the brackets ``{a_i, b_i} = -a_i``, ``{a_i, b_(i+1)} = a_i``
    (four times the canonical ones, for which H is beta^2 / (4 m) times the energy). The b commute, and so do the a: a
    splitting has two parts for any length.

    Parameters
    ----------
    sites : int
        Number n of particles, two or more.

    Returns
    -------
    LiePoissonSystem
        State ``(b_1, ..., b_n, a_1, ..., a_(n-1))``, all per unit of time. Casimir: the total momentum, ``tr L``, L the
        symmetric tridiagonal matrix with diagonal b and off-diagonal a. Integrals: the traces of powers of L, 3 to n up
        to 8 sites, 3 and 4 up to 64. ``exact(x0, t)`` in closed form.

    Raises
    ------
    ValueError
        `sites` is not an integer, or less than two.

    Notes
    -----
    Flaschka, Phys. Rev. B 9, 1924 (1974); Symes, Physica D 4, 275 (1982): with ``exp(t L(0)) = Q R`` the lattice is at
    ``L(t) = Q^T L(0) Q``. The group element has no meaning for the particles.

    Examples
    --------
    >>> system = toda(sites=3)
    >>> system.vector_field([1.0, 0.0, -1.0, 0.5, 0.25])
    array([ 0.5  , -0.375, -0.125, -0.5  , -0.25 ])
    >>> late = system.exact([1.0, 0.0, -1.0, 0.5, 0.25], 40.0)
    >>> L = [[1.0, 0.5, 0.0], [0.5, 0.0, 0.25], [0.0, 0.25, -1.0]]
    >>> bool(np.allclose(late[:3], np.linalg.eigvalsh(L)[::-1], atol=1e-14))
    True
    """
    return _lattice(read_integer(sites, "sites", 2), ring=False)


@ready_made(
    coordinates=FLASCHKA,
    gallery_entry=GalleryEntry(
        x0=_compressed_ring,
        t_span=(0.0, 60.0),
        step=0.05,
        caption="A ring of 48 sites, pressed together around one of them: two waves run apart, break up into "
        "solitons, which go through each other on the far side and come out as they were.",
        pictures=(
            Picture(
                "space-time",
                sites=lambda dim: range(dim // 2, dim),
                label="$a_i$",
                title="$a_i$, large where two particles are close",
            ),
        ),
        components=Picture("components", chosen=_sampled_velocities, quantity="velocity $b_i$"),
        parameters={"sites": 48},
        coordinates=partial(_names, 0),
        quantity="state",
    ),
)
def toda_ring(sites: int = 4) -> LiePoissonSystem:
    """Return the periodic Toda lattice in Flaschka's variables.

    As `toda`, with one more bond, a_n between the last particle and the first: ``b_1' = 2 (a_1^2 - a_n^2)``, and
    ``a_n' = a_n (b_1 - b_n)``. The motion is bounded. Sign +1, H = sum b_i^2 / 2 + sum a_i^2.

    Parameters
    ----------
    sites : int
        Number n of particles, two or more.

    Returns
    -------
    LiePoissonSystem
        State ``(b_1, ..., b_n, a_1, ..., a_n)``, all per unit of time. Casimirs: the total momentum, ``tr L``, and the
        product of the a_i, which determines the length of the ring (beyond 64 sites its logarithm, because the product
        underflows). Integrals: as for `toda`, L with a_n in the corners.

    Raises
    ------
    ValueError
        `sites` is not an integer, or less than two.

    Notes
    -----
    Toda, Theory of Nonlinear Lattices (1989). The solution in theta functions (Kac and van Moerbeke 1975) is omitted.

    Examples
    --------
    >>> system = toda_ring(sites=3)
    >>> system.vector_field([1.0, 0.0, -1.0, 0.5, 0.25, 1.0])
    array([-1.5  , -0.375,  1.875, -0.5  , -0.25 ,  2.   ])
    >>> list(system.casimirs)
    ['tr L', 'product of a']
    """
    return _lattice(read_integer(sites, "sites", 2), ring=True)


def _lattice(n: int, ring: bool) -> LiePoissonSystem:
    name = "toda_ring" if ring else "toda"
    bonds = n if ring else n - 1
    check_algebra_memory(f"{name}({short(n)})", n + bonds, 2 * bonds)
    left = np.arange(bonds)
    right = (left + 1) % n
    rows = np.concatenate([left, right])
    constants = np.concatenate([np.ones(bonds), -np.ones(bonds)])
    a = np.concatenate([n + left, n + left])
    # [e_b, e_a] = +-e_a, the b before the a
    algebra = LieAlgebra(np.column_stack([rows, a, a, constants]), dim=n + bonds, name=f"{name}({n})")
    casimirs: dict[str, Any] = {"tr L": Quadratic(np.zeros(n + bonds), linear=np.repeat([1.0, 0.0], [n, bonds]))}
    if ring and n <= MAX_POLYNOMIAL_SITES:
        casimirs["product of a"] = Polynomial({(0,) * n + (1,) * n: 1})
    elif ring:
        casimirs["log of the product of a"] = Invariant(_log_product, _log_product_gradient)
    return LiePoissonSystem(
        algebra,
        Quadratic(np.repeat([1.0, 2.0], [n, bonds])),
        casimirs=casimirs,
        name=name,
        parameters={"sites": n},
        exact=None if ring else partial(move_state, name, 2 * n - 1, partial(open_lattice, n)),
        integrals=traces(n, ring),
    )


def _log_product(x: Any) -> Any:
    total = 0.0
    for i in range(len(x) // 2, len(x)):
        total += math.log(abs(x[i]))
    return total


def _log_product_gradient(x: Any) -> Any:
    result = np.zeros(len(x))
    for i in range(len(x) // 2, len(x)):
        result[i] = 1.0 / x[i]
    return result


def traces(n: int, ring: bool) -> dict[str, Polynomial]:
    """Return traces of powers of L, independent integrals besides H and the Casimirs, as polynomials in the b and a."""
    # The trace of L^k is the sum over closed walks of k steps on the lattice of the product of entries of L.
    if n > MAX_POLYNOMIAL_SITES:
        return {}
    bonds = n if ring else n - 1
    steps: list[list[tuple[int, int]]] = [[(i, i)] for i in range(n)]
    for i in range(bonds):
        j = (i + 1) % n
        steps[i].append((j, n + i))
        steps[j].append((i, n + i))
    highest = n if n <= MAX_SITES_WITH_ALL_TRACES else 4
    totals = [Counter[tuple[int, ...]]() for _ in range(highest + 1)]
    for start in range(n):
        walks = Counter[tuple[int, tuple[int, ...]]]({(start, ()): 1})
        for k in range(1, highest + 1):
            extended = Counter[tuple[int, tuple[int, ...]]]()
            for (site, path), count in walks.items():
                for neighbour, coordinate in steps[site]:
                    extended[neighbour, tuple(sorted((*path, coordinate)))] += count
            walks = extended
            totals[k].update({path: count for (site, path), count in walks.items() if site == start})
    dim = n + bonds
    return {
        f"tr L^{k}": Polynomial({tuple(path.count(i) for i in range(dim)): c for path, c in totals[k].items()})
        for k in range(3, highest + 1)
    }


def open_lattice(n: int, start: Floats, times: Floats) -> Floats:
    """Return the states (k, 2 n - 1) of the open lattice at given times, correct to all digits."""
    # With ``exp(t L) = Q R``, ``exp(2 t L) = R^T R`` and ``L(t) = R L R^-1``: R by Cholesky in ball arithmetic.
    return np.array([_state_at(n, start, time) for time in times.tolist()]).reshape(-1, 2 * n - 1)


def _state_at(n: int, start: Floats, time: float) -> Floats:
    """Return the state at one time; the precision is increased until the balls are smaller than float64 rounding."""
    from flint import arb, ctx

    size = float(np.abs(start).max())
    if time == 0.0 or size == 0.0:
        return start.copy()
    exponent_bits = 12.0 * math.log2(math.e) * size * abs(time)  # |L| <= 3 size, and exp(2 t L) has both signs of it
    if not exponent_bits < MAX_PRECISION_BITS / 4:
        raise ValueError(
            f"t is {time:g}, too long for the closed form from so large a state; integrate, or start later"
        )
    bits = 96 + int(exponent_bits / 8)  # usually sufficient, otherwise doubled
    while bits <= MAX_PRECISION_BITS:
        with ctx.workprec(bits):
            state = _by_cholesky(n, [arb(v) for v in start.tolist()], arb(time))
            tolerance = 2.0**-60 * size
            accurate = all(q.is_exact() or q.rel_accuracy_bits() > 60 for q in state[n:])
            if state and all(q.rad() < tolerance for q in state[:n]) and accurate:
                return np.array([float(q.mid()) for q in state])
        bits *= 2
    raise ValueError(f"t is {time:g}, too long for the closed form from this state; integrate, or start later")


def _by_cholesky(n: int, x: list[Any], time: Any) -> list[Any]:
    """Return the state as balls; empty if the precision is insufficient for a pivot."""
    from flint import arb_mat

    b, a = x[:n], x[n:]
    L = [[0 * time] * n for _ in range(n)]
    for i in range(n):
        L[i][i] = 2 * time * b[i]
        if i:
            L[i - 1][i] = L[i][i - 1] = 2 * time * a[i - 1]
    rest = arb_mat(L).exp().tolist()
    pivots, beside = [], []
    for i in range(n):
        row = rest[i]
        pivot = row[i]
        if not pivot > 0:
            return []
        pivots.append(pivot)
        ratios = [row[j] / pivot for j in range(i + 1, n)]  # R_ij / R_ii
        beside.append(ratios[0] if ratios else 0)
        for j in range(i + 1, n):
            lower, factor = rest[j], ratios[j - i - 1]
            for k in range(j, n):
                lower[k] -= factor * row[k]
    late_b = [b[i] + (a[i] * beside[i] if i < n - 1 else 0) - (a[i - 1] * beside[i - 1] if i else 0) for i in range(n)]
    late_a = [a[i] * (pivots[i + 1] / pivots[i]).sqrt() for i in range(n - 1)]
    return [*late_b, *late_a]
