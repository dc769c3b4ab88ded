"""Algebras of bodies with their attitudes in the state: so(3) on three copies of R^3, and centres in space."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, lru_cache, partial

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.classical import so
from coadjoint.algebra.families.phase_space import heisenberg
from coadjoint.algebra.families.products import copies, direct_sum, semidirect
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.system_checks import KnownInvariants

PER_BODY = 12  # L, and the three space axes seen from the body
AXES = ("X", "Y", "Z")
MAX_RECORDED_BODIES = 64
"""Largest number of bodies whose axes are recorded as Casimirs in every run."""


@cache
def attitude_algebra() -> LieAlgebra:
    """Return so(3) acting on X, Y, Z, the space axes seen from the body; its matrices are (6, 6), rotations first."""
    rotations = so(3).representation
    assert rotations is not None
    action = np.zeros((3, 9, 9))
    for k in range(3):
        action[:, 3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = rotations
    g = semidirect(so(3), action)
    matrices = np.zeros((PER_BODY, 6, 6))
    matrices[:3, :3, :3] = rotations
    for k in range(3):
        matrices[range(3 + 3 * k, 6 + 3 * k), range(3), 3 + k] = 1.0
    basis = tuple(f"{letter}{i}" for letter in ("L", *AXES) for i in (1, 2, 3))
    return LieAlgebra(
        np.column_stack([*g.triples]), dim=PER_BODY, basis=basis, name="so(3) ⋉ R^(3 x 3)", representation=matrices
    )


@lru_cache(maxsize=16)
def with_carried(g: LieAlgebra, names: tuple[str, ...]) -> LieAlgebra:
    """Return an algebra of body with further coordinates that commute with all: motion carries them unchanged."""
    if not names:
        return g
    assert g.representation is not None
    matrices = np.zeros((g.dim + len(names), *g.representation.shape[1:]))
    matrices[: g.dim] = g.representation
    label = f"{g.name} + R^{len(names)}"
    return LieAlgebra._from_valid(g.triples, len(matrices), (*g.basis, *names), label, matrices, {})


@lru_cache(maxsize=16)
def bodies_algebra(count: int) -> LieAlgebra:
    """Return the algebra of (L, X, Y, Z) of each body, the momenta p and positions r of all centres, and z."""
    # With the body sign, -1, the bracket z = [p, r] makes ``r' = dH/dp``.
    g = direct_sum(copies(attitude_algebra(), count), heisenberg(3 * count))
    numbered = range(1, count + 1)
    basis = (
        *(f"{name}[{body}]" for body in numbered for name in attitude_algebra().basis),
        *(f"{letter}{i}[{body}]" for letter in ("p", "r") for body in numbered for i in (1, 2, 3)),
        "z",
    )
    name = f"{count} so(3) ⋉ R^(3 x 3) + heisenberg({3 * count})"
    return LieAlgebra._from_valid(g.triples, g.dim, basis, name, None, {})


def axis_products(count: int, dim: int, alone: bool = False) -> dict[str, Quadratic]:
    """Return the products of the space axes of each body, which are Casimirs; none of more than 64 bodies."""
    found = {}
    for body in range(count if count <= MAX_RECORDED_BODIES else 0):
        for a in range(3):
            for b in range(a, 3):
                pairs = [(_axis(body, a, i), _axis(body, b, i), 1.0 + (a == b)) for i in range(3)]
                label = f"{AXES[a]}.{AXES[b]}"
                found[label if alone or dim == PER_BODY else f"{label} [{body + 1}]"] = _form(dim, pairs)
    return found


def momentum_in_space(count: int, dim: int, alone: bool = False, turning: bool = True) -> KnownInvariants:
    """Return the components in space of the total momentum, and if `turning` the angular one, sum of A L + r x p."""
    # They are integrals at the states of bodies, where z = 1 and the axes are orthonormal, and not at others.
    found: dict[str, Callable[[], Quadratic]] = {}
    positions = dim > PER_BODY and not alone
    for axis in range(3) if positions else ():
        linear = np.zeros(dim)
        linear[PER_BODY * count + axis : (PER_BODY + 3) * count : 3] = 1.0
        found[f"total p{axis + 1}"] = partial(_quadratic, dim, [], linear)
    for axis in range(3) if turning else ():
        pairs = [(PER_BODY * body + i, _axis(body, axis, i), 1.0) for body in range(count) for i in range(3)]
        second, third = (axis + 1) % 3, (axis + 2) % 3
        for body in range(count) if positions else ():
            p, r = PER_BODY * count + 3 * body, (PER_BODY + 3) * count + 3 * body
            pairs += [(p + third, r + second, 1.0), (p + second, r + third, -1.0)]
        found[f"total L{axis + 1}"] = partial(_form, dim, pairs)
    return KnownInvariants(found)


def central_coordinate(dim: int) -> Quadratic:
    """Return the Casimir z, the last coordinate."""
    linear = np.zeros(dim)
    linear[-1] = 1.0
    return _quadratic(dim, [], linear)


def _axis(body: int, axis: int, component: int) -> int:
    return PER_BODY * body + 3 + 3 * axis + component


def _form(dim: int, pairs: list[tuple[int, int, float]]) -> Quadratic:
    """Return the quadratic function with M_ij = M_ji = value for pairs (i, j, value)."""
    both = {(i, j): value for i, j, value in pairs} | {(j, i): value for i, j, value in pairs}
    return _quadratic(dim, sorted((i, j, value) for (i, j), value in both.items()), np.zeros(dim))


def _quadratic(dim: int, entries: list[tuple[int, int, float]], linear: npt.NDArray[np.float64]) -> Quadratic:
    rows, columns = (np.array([entry[k] for entry in entries], dtype=np.int64) for k in (0, 1))
    values = np.array([entry[2] for entry in entries], dtype=np.float64)
    return Quadratic.from_entries(dim, rows, columns, values, linear, 0.0)
