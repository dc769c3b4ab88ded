"""Values for every public parameter, and what is seen of an object afterwards: for tests of what a record keeps.

Parameters are read off signatures, so that a new one is under test without an edit. Where none of the values fits it,
the test says so.
"""

import inspect
from fractions import Fraction

import numpy as np

import coadjoint as co
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.split_hamiltonian import SplitHamiltonian

X = (0.3, -0.2, 0.5)

# Not so(3): its constants are the same in every order of the axes.
SL2 = co.LieAlgebra.from_brackets(3, {(0, 1): {1: 2.0}, (0, 2): {2: -2.0}, (1, 2): {0: 1.0}})
ADJOINT = np.array([np.column_stack([SL2.bracket(u, v) for v in np.eye(3)]) for u in np.eye(3)])
DOUBLED = np.kron(np.eye(2), ADJOINT)
FULL = [[2.0, 0.3, 0.1], [0.3, 1.5, -0.2], [0.1, -0.2, 1.0]]
C = co.Polynomial({(2, 0, 0): Fraction(1, 4), (0, 1, 1): 1})

PLAIN = (
    True, False, 1, 2, 3, 4, 6, 8, 16, -1, 0.75, 1e-6, "gradient", "rational", "suzuki4", "coordinates", "runge2",
    "mine", [[0, 1], [2]], [[2], [1], [0]], {"order": [1, 0], "shift": {"|x|^2": 0.25}}, [0.25, 0.5, 0.25], [0.5, 0.5],
    {"name": "GaussLegendre", "stages": 3}, {"lattice": "square", "shape": [1, 1]}, {"name": "Splitting", "order": 4},
    [[1.5, [0, 0, 0]], [0.75, [2, 0, 0]]], [[0.5, [0, 0, 0]], [0.25, [4, 0, 0]], [1.0, [0, 2, 2]]],
)  # fmt: skip
"""What a configuration file can say as well."""

VALUES = (
    *PLAIN, FULL, [0.3, -0.2, 0.7], [Fraction(1, 3), Fraction(2, 7), Fraction(5)], Fraction(1, 3), 2.5,
    ("h", "e", "f"), ADJOINT, DOUBLED, {"C": C}, {"C": 2 * C, "D": C}, {"Q": Quadratic.from_polynomial(4.0 * C)},
    {"Q": Quadratic.from_polynomial(Fraction(1, 3) * C)},
    {(3, 0, 0): 0.1, (0, 1, 1): Fraction(1, 3), (0, 0, 0): 2}, {(2, 0, 0): Fraction(1, 3), (0, 1, 1): 1},
    [((0,), Quadratic(1.5, constant=0.5)), ((1,), co.Polynomial({(3,): 0.1})), ((2,), Quadratic(2.0, [0.3]))],
)  # fmt: skip

# What is given where a parameter has no default.
GIVEN = {
    "LieAlgebra": {"constants": SL2.triples, "dim": 3},
    "LiePoissonSystem": {"algebra": SL2, "hamiltonian": Quadratic(FULL)},
    "Quadratic": {"M": FULL},
    "Polynomial": {"monomials": {(2, 0, 0): 0.5, (0, 1, 2): 1.25}},
    "SplitHamiltonian": {"pieces": [((i,), Quadratic(1.0 + i)) for i in range(3)]},
}
# What a parameter needs beside it.
WITH = {("Splitting", "adjoint"): {"order": 1}}


def parameters(made):
    return list(inspect.signature(made).parameters)


def variants(make, given, parameter, same, values=VALUES, most=4):
    """Objects made with other values of one parameter; fails where no value is accepted and makes a difference."""
    first, found = make(**given), []
    for value in values:
        try:
            other = make(**{**given, parameter: value})
        except (ValueError, TypeError):
            continue
        if not any(same(other, one) for one in (first, *found)):
            found.append(other)
    assert found, f"no value of {parameter} is tried; add one to VALUES"
    return found[:most]


def numbers(value):
    """A number or array with the kinds of its numbers, which a record keeps: 1/3 is no 0.333..., and 1 no 1.0."""
    entries = np.asarray(value).ravel().tolist()
    return entries, [type(entry) for entry in entries]


EXACT_POINTS = [np.array([Fraction(k + 1, 7), Fraction(2 - k, 3), Fraction(k, 5)]) for k in range(3)]


def seen_of_hamiltonian(H):
    """Kind, coordinates of pieces, and the value, slope and curvature in exact numbers, the constant in them."""
    points = [x[: H.dim] for x in EXACT_POINTS]
    looks = [numbers(look(x)) for x in points for look in (H.value, H.gradient, H.hessian)]
    inner = [seen_of_hamiltonian(piece) for piece in H.pieces] if isinstance(H, SplitHamiltonian) else []
    return type(H).__name__, H.dim, H.timed, repr(H), getattr(H, "coordinates", None), looks, inner


def quadratic_by_hand(M, linear=(0.0, 0.0, 0.0), constant=0.0):
    """The value of a quadratic Hamiltonian at X, and how far rounding may take it: the absolute terms, 64 u of them."""
    matrix = np.asarray(M, dtype=float)
    matrix = matrix if matrix.ndim == 2 else np.diag(np.broadcast_to(matrix, 3))
    terms = [*(0.5 * np.outer(X, X) * matrix).ravel(), *np.multiply(X, np.asarray(linear, float)), float(constant)]
    return sum(terms), 64 * 2.0**-53 * sum(map(abs, terms))


def seen_of_algebra(g):
    columns = [column.tolist() for column in g.triples]
    rho = None if g.representation is None else g.representation.tolist()
    return g.dim, g.basis, g.name, columns, rho, seen_of_casimirs(g.casimirs_known)


def seen_of_casimirs(casimirs):
    return [
        (name, type(c).__name__, repr(c), [numbers(look) for x in EXACT_POINTS for look in looks_at(c, x)])
        for name, c in casimirs.items()
        if isinstance(c, co.Polynomial | Quadratic)
    ]


def looks_at(casimir, x):
    value = casimir.value(x) if isinstance(casimir, Quadratic) else casimir(x)
    return value, casimir.gradient(x)


def seen_of(system):
    rho = None if system.representation is None else system.representation.tolist()
    hamiltonian = seen_of_hamiltonian(system.hamiltonian)
    casimirs = seen_of_casimirs(system.casimirs), seen_of_casimirs(system.integrals)
    return (
        system.sign,
        system.name,
        system.parameters,
        system.layout,
        rho,
        casimirs,
        seen_of_algebra(system.algebra),
        hamiltonian,
    )
