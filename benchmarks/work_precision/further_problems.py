"""Further systems: motions that calm down, linger or wander, and spans from 20 steps to a hundred thousand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import log
from typing import Any

import numpy as np

import coadjoint as co
from work_precision.problems import SEED, STATES, Field, Problem, on_spheres, rigid_body, scattered, top, weighted_sum

# A motion of this length, in radians of the largest frequency, takes series of order 16 some 20 steps.
BRIEF = 20.0
FROM_SEPARATRIX = 1e-6
TURNS_BETWEEN_FALLS = 100


def quadratic_field(algebra: Any, m: Sequence[float], sign: float = 1.0) -> Field:
    """Return x' = sign J(x) M x with a diagonal M as sums of different products, as a textbook writes them."""
    found: list[dict[tuple[int, int], float]] = [{} for _ in range(algebra.dim)]
    for a, b, d, value in zip(*(part.tolist() for part in algebra.triples), strict=True):
        for row, other, signed in ((a, b, sign * value), (b, a, -sign * value)):
            pair = (min(d, other), max(d, other))
            found[row][pair] = found[row].get(pair, 0.0) + signed * m[other]

    def field(x: Sequence[Any]) -> list[Any]:
        return [weighted_sum([(value, x[p] * x[q]) for (p, q), value in row.items()]) for row in found]

    return field


def open_toda_chain() -> Problem:
    """Five particles that meet and fly apart: a_i' = a_i (b_(i+1) - b_i), b_i' = 2 (a_i^2 - a_(i-1)^2)."""
    n = 5

    def field(x: Sequence[Any]) -> list[Any]:
        b, a = x[:n], x[n:]
        squares = [2.0 * (value * value) for value in a]
        moved = [squares[0], *(squares[i] - squares[i - 1] for i in range(1, n - 1)), (-2.0 * a[-1]) * a[-1]]
        return [*moved, *(a[i] * (b[i + 1] - b[i]) for i in range(n - 1))]

    drawn = scattered(2 * n - 1)
    states = np.concatenate([0.5 * drawn[:, :n], 0.5 * np.exp(0.5 * drawn[:, n:])], axis=1)
    return Problem("open Toda chain", co.systems.toda(n), field, states, 40.0, 4.0)


def near_separatrix() -> Problem:
    """The body of `rigid_body`, started so near its separatrix that it rests at the middle axis for long."""
    body = rigid_body()
    s = np.random.default_rng(SEED).normal(size=STATES)
    far = np.stack([np.sqrt(1.0 / 3.0) / np.cosh(s), np.tanh(s), np.sqrt(2.0 / 3.0) / np.cosh(s)], axis=1)
    # On the separatrix the energy is that of the middle axis: |x|^2 / 4.
    return replace(body, name="body near its separatrix", states=far + [FROM_SEPARATRIX, 0.0, 0.0], span=400.0)


def sleeping_top() -> Problem:
    """A symmetric top, upright but for 1e-6, that spins a little too slowly to stay so: it falls and comes back.

    With equal moments 1 and the weight 1 it is stable for a spin above 2; below, it falls at the rate
    sqrt(1 - spin^2 / 4), and from 1e-6 a fall takes 2 log(4e6) over that rate.
    """
    slow = 2.0 * log(4.0 / FROM_SEPARATRIX)
    # rate * time = slow, and time = turns * 2 pi / 2.
    rate = slow / (TURNS_BETWEEN_FALLS * np.pi)
    spin = 2.0 * np.sqrt(1.0 - rate**2)
    found = top("sleeping top", (1.0, 1.0, 0.75), (0.0, 0.0, 1.0), TURNS_BETWEEN_FALLS * np.pi)
    tilted = FROM_SEPARATRIX * scattered(4)
    states = np.column_stack([spin * tilted[:, 0], spin * tilted[:, 1], np.full(STATES, spin), tilted[:, 2:]])
    return replace(found, states=np.column_stack([states, np.ones(STATES)]), rate=2.0)


def kirchhoff_body() -> Problem:
    """A body in a fluid, H = sum a_i L_i^2 / 2 + sum c_i p_i^2 / 2, in Clebsch's case.

    The sum of (c_2 - c_3) / a_1 and of what follows by turning the indices is 0, which makes it integrable.
    """
    m = (1.0, 0.5, 0.25, 2.0, 1.5, 0.5)
    algebra = co.algebras.get("e(3)")
    system = co.LiePoissonSystem(algebra, co.Quadratic(m), sign=-1, name="Kirchhoff body")
    return Problem("Kirchhoff body", system, quadratic_field(algebra, m, -1.0), 0.5 * scattered(6), 5e3, 3.0)


def vlasov_moments() -> Problem:
    """Moments x_ij = <q^i p^j> up to degree 4 of a beam, H = x02 / 2 + x20 / 2 + x20^2 / 8 + x40 / 64.

    x_ij' = i x_(i-1)(j+1) - j sum over k of k dV/dx_k0 x_(i+k-1)(j-1), and no moments above degree 4.
    """
    powers = [(2, 0), (1, 1), (0, 2), (4, 0), (3, 1), (2, 2), (1, 3), (0, 4)]
    system = co.systems.vlasov_moments(4, "1/2*x20 + 1/8*x20^2 + 1/64*x40")

    def field(x: Sequence[Any]) -> list[Any]:
        place = {power: x[k] for k, power in enumerate(powers)}
        moved = []
        for i, j in powers:
            terms = []
            if i:
                terms.append((float(i), place[i - 1, j + 1]))
            if j:
                inward = place[i + 1, j - 1]
                terms += [(-float(j), inward), (-0.5 * j, place[2, 0] * inward)]
                if (i + 3, j - 1) in place:
                    terms.append((-j / 16.0, place[i + 3, j - 1]))
            moved.append(weighted_sum(terms))
        return moved

    # Beams of particles at points: a positive distribution has these moments.
    rng = np.random.default_rng(SEED)
    q, p = rng.normal(size=(2, STATES, 16))
    states = np.stack([np.mean(q**i * (0.5 * p) ** j, axis=1) for i, j in powers], axis=1)
    return Problem("Vlasov moments", system, field, states, 100.0, 6.0)


def five_dimensional_body() -> Problem:
    """Manakov's top on so(5), w_ab = (a + b) L_ab for a, b of 1/4, 1/2, ..., 5/4: ten coordinates, integrable."""
    n = 5
    algebra = co.algebras.so(n)
    planes = [(a, b) for a in range(n) for b in range(a + 1, n)]
    m = [0.25 * (a + b + 2) for a, b in planes]
    system = co.LiePoissonSystem(algebra, co.Quadratic(m), name="so(5)")
    return Problem("so(5)", system, quadratic_field(algebra, m), on_spheres(scattered(10)), 500.0, 1.0)


def solvable() -> Problem:
    """Two commuting random matrices act on four coordinates, [f, e_i] = sum over k of A_ki e_k; the energy is definite.

    Energy keeps the motion bounded, and it comes to rest where the algebra is not unimodular.
    """
    rng = np.random.default_rng(SEED)
    A = rng.integers(-4, 5, size=(4, 4)) / 4.0
    brackets: dict[tuple[int, int], dict[int, float]] = {}
    for which, matrix in enumerate((A, A @ A)):
        for i in range(4):
            brackets[4 + which, i] = {k: float(matrix[k, i]) for k in range(4) if matrix[k, i]}
    algebra = co.LieAlgebra.from_brackets(6, brackets, name="solvable")
    m = [1.0, 0.5, 2.0, 1.0, 0.5, 1.0]
    system = co.LiePoissonSystem(algebra, co.Quadratic(m), name="solvable, random")
    return Problem("solvable, random", system, quadratic_field(algebra, m), 0.5 * scattered(6), 40.0, 8.0)


def brief(problem: Problem) -> Problem:
    """Return the first 20 steps or so of a problem."""
    return replace(problem, name=f"{problem.name}, brief", span=BRIEF / problem.rate)


def further_problems() -> dict[str, Problem]:
    """Return the further systems by their short names, brief spans of some of them and of the rigid body."""
    found = {
        "chain": open_toda_chain(),
        "separatrix": near_separatrix(),
        "sleeping": sleeping_top(),
        "kirchhoff": kirchhoff_body(),
        "moments": vlasov_moments(),
        "so5": five_dimensional_body(),
        "solvable": solvable(),
    }
    # A hundred thousand steps of order 24.
    found["long-body"] = replace(rigid_body(), name="rigid body, long", span=2e5)
    brief_ones = {"body": rigid_body(), **{name: found[name] for name in ("chain", "kirchhoff", "so5")}}
    return {**found, **{f"brief-{name}": brief(problem) for name, problem in brief_ones.items()}}
