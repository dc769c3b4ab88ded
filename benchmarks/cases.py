"""The systems that are timed: each with its initial state, step, and the arguments of the C program that takes the same
steps.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np

import coadjoint as co
from coadjoint.program.table import build_flow_table

METHOD = co.Splitting(order=2, parts="coordinates")


@dataclass(frozen=True)
class Case:
    """One system and the C program of the same steps; `arguments` are its arguments after the step."""

    title: str
    program: str
    system: Any
    x0: tuple[float, ...]
    step: float
    arguments: Callable[[Case], list[float]]
    attitude: bool = False

    def integrate(self, steps: int, watch: bool = False, method: Any = METHOD) -> Any:
        """Take the steps in coadjoint; only the end is saved."""
        span = (0.0, steps * self.step)
        return co.integrate(
            self.system, self.x0, span, self.step, method, save_every=steps, attitude=self.attitude, watch=watch
        )

    def c_arguments(self, steps: int) -> list[str]:
        """Return what the C program is called with."""
        return [str(steps), *(repr(float(value)) for value in [self.step, *self.arguments(self)])]

    def end(self, solution: Any) -> np.ndarray:
        """Return the final state in the order in which the C program prints it."""
        group = solution.attitude[-1].ravel() if self.attitude else []
        return np.concatenate([solution.x[-1], group])


def diagonal(case: Case) -> list[float]:
    return [*np.diag(case.system.hamiltonian.hessian(np.array(case.x0))), *case.x0]


def diagonal_and_linear(case: Case) -> list[float]:
    x0 = np.array(case.x0)
    return [*np.diag(case.system.hamiltonian.hessian(x0)), *case.system.hamiltonian.gradient(0.0 * x0), *x0]


def squares(case: Case) -> list[float]:
    """Return state, and for each completed square of the program its weighted form, frequency, D and D^2."""
    program = build_flow_table(case.system, METHOD)
    values = [*case.x0]
    for part, term in zip(program.parts, program.share, strict=False):
        coordinates, form = part.forms[0]
        row = program.terms.row[term]
        entries = slice(program.terms.entry[row], program.terms.entry[row + 1])
        l, weighted = np.zeros(3), np.zeros(3)
        l[list(coordinates)] = [float(value) for value in form]
        weighted[program.terms.column[entries]] = program.terms.weight[entries]
        D = case.system.algebra.coadjoint(l)
        DD = D @ D
        values += [*weighted, np.sqrt(-0.5 * np.trace(DD)), *D.ravel(), *DD.ravel()]
    return values


def inverse(matrix: list[list[Fraction]]) -> list[list[Fraction]]:
    """Invert a 3 x 3 matrix of fractions by cofactors."""

    def cofactor(i: int, j: int) -> Fraction:
        a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
        return matrix[a][c] * matrix[b][d] - matrix[a][d] * matrix[b][c]

    determinant = sum(matrix[0][j] * cofactor(0, j) for j in range(3))
    return [[cofactor(j, i) / determinant for j in range(3)] for i in range(3)]


def random_change(seed: int) -> list[list[Fraction]]:
    """Return 3 x 3 eighths, between -1 and 1, with a condition number below 5."""
    draw = random.Random(seed)
    while True:
        change = [[Fraction(draw.randint(-8, 8), 8) for _ in range(3)] for _ in range(3)]
        if np.linalg.cond(np.array(change, dtype=float)) < 5.0:
            return change


def rigid_body_in_random_basis(seed: int = 7) -> tuple[Any, tuple[float, ...]]:
    """Return the paper's rigid body in the basis e'_i = sum_a A_ia e_a, its M full, and the initial state (1, 10, 1)
    there.
    """
    A = random_change(seed)
    B = inverse(A)
    original = co.systems.paper_rigid_body()
    constants = np.zeros((3, 3, 3))
    exact = {(i, j, k): Fraction(0) for i, j, k in product(range(3), repeat=3)}
    for a, b, c, value in zip(*original.algebra.triples, strict=True):
        for i, j, k in exact:
            pair = A[i][a] * A[j][b] - A[i][b] * A[j][a]
            exact[i, j, k] += pair * Fraction(float(value)) * B[c][k]
    for place, value in exact.items():
        constants[place] = float(value)
    masses = (Fraction(1), Fraction(1, 2), Fraction(1, 3))
    M = [[sum(B[a][i] * masses[a] * B[a][j] for a in range(3)) for j in range(3)] for i in range(3)]
    system = co.LiePoissonSystem(
        co.LieAlgebra(constants, name="so(3), random basis"),
        co.Quadratic(np.array(M, dtype=object)),
        name="random basis",
    )
    x0 = tuple(float(A[i][0] + 10 * A[i][1] + A[i][2]) for i in range(3))
    return system, x0


def cases() -> dict[str, Case]:
    body, start = co.systems.paper_rigid_body(), (1.0, 10.0, 1.0)
    fluid = co.LiePoissonSystem(
        co.algebras.get("e(3)"),
        co.Quadratic([1.0, 0.75, 0.5, 0.9, 0.7, 0.4], linear=[0.1, 0.2, -0.1, 0.3, -0.2, 0.25]),
        name="body in a fluid",
    )
    turned, turned_start = rigid_body_in_random_basis()
    return {
        "a": Case("rigid body", "rigid_body", body, start, 0.1, diagonal),
        "b": Case("rigid body with attitude", "rigid_body_attitude", body, start, 0.1, diagonal, attitude=True),
        "c": Case("e(3), six parts", "kirchhoff", fluid, (0.6, -0.4, 1.0, 0.3, 0.8, -0.5), 0.1, diagonal_and_linear),
        "d": Case("so(3), random basis", "random_basis", turned, turned_start, 0.1, squares),
    }
