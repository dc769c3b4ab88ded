"""Values of public parameters and comparable properties of objects, for tests of records.

Parameters come from signatures, so that new ones are tested as well; a test fails if no value here fits a parameter.
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
"""Values that a configuration file can contain."""

VALUES = (
    *PLAIN, FULL, [0.3, -0.2, 0.7], [Fraction(1, 3), Fraction(2, 7), Fraction(5)], Fraction(1, 3), 2.5,
    ("h", "e", "f"), ADJOINT, DOUBLED, {"C": C}, {"C": 2 * C, "D": C}, {"Q": Quadratic.from_polynomial(4.0 * C)},
    {"Q": Quadratic.from_polynomial(Fraction(1, 3) * C)},
    {(3, 0, 0): 0.1, (0, 1, 1): Fraction(1, 3), (0, 0, 0): 2}, {(2, 0, 0): Fraction(1, 3), (0, 1, 1): 1},
    [((0,), Quadratic(1.5, constant=0.5)), ((1,), co.Polynomial({(3,): 0.1})), ((2,), Quadratic(2.0, [0.3]))],
)  # fmt: skip

# Arguments for parameters without a default.
REQUIRED = {
    "LieAlgebra": {"constants": SL2.triples, "dim": 3},
    "LiePoissonSystem": {"algebra": SL2, "hamiltonian": Quadratic(FULL)},
    "Quadratic": {"M": FULL},
    "Polynomial": {"monomials": {(2, 0, 0): 0.5, (0, 1, 2): 1.25}},
    "SplitHamiltonian": {"pieces": [((i,), Quadratic(1.0 + i)) for i in range(3)]},
}
# Other arguments that a parameter requires.
ALSO_REQUIRED = {("Splitting", "adjoint"): {"order": 1}}


def parameters(function):
    return list(inspect.signature(function).parameters)


def variants(make, arguments, parameter, same, values=VALUES, most=4):
    """Return distinct objects for other values of a parameter; fail if no value changes the object."""
    first, found = make(**arguments), []
    for value in values:
        try:
            other = make(**{**arguments, parameter: value})
        except (ValueError, TypeError):
            continue
        if not any(same(other, one) for one in (first, *found)):
            found.append(other)
    assert found, f"no value of {parameter} is tried; add one to VALUES"
    return found[:most]


def numbers(value):
    """Return entries and their types, which a record preserves: 1/3 is not 0.333..., and 1 is not 1.0."""
    entries = np.asarray(value).ravel().tolist()
    return entries, [type(entry) for entry in entries]


EXACT_POINTS = [np.array([Fraction(k + 1, 7), Fraction(2 - k, 3), Fraction(k, 5)]) for k in range(3)]


def hamiltonian_properties(H):
    """Return type, coordinates of pieces, and exact values of the Hamiltonian, its gradient and Hessian."""
    points = [x[: H.dim] for x in EXACT_POINTS]
    values = [numbers(function(x)) for x in points for function in (H.value, H.gradient, H.hessian)]
    inner = [hamiltonian_properties(piece) for piece in H.pieces] if isinstance(H, SplitHamiltonian) else []
    return type(H).__name__, H.dim, H.timed, repr(H), getattr(H, "coordinates", None), values, inner


def quadratic_reference(M, linear=(0.0, 0.0, 0.0), constant=0.0):
    """Return the value of a quadratic Hamiltonian at X and a bound of its rounding, 64 u of the absolute terms."""
    matrix = np.asarray(M, dtype=float)
    matrix = matrix if matrix.ndim == 2 else np.diag(np.broadcast_to(matrix, 3))
    terms = [*(0.5 * np.outer(X, X) * matrix).ravel(), *np.multiply(X, np.asarray(linear, float)), float(constant)]
    return sum(terms), 64 * 2.0**-53 * sum(map(abs, terms))


def algebra_properties(g):
    columns = [column.tolist() for column in g.triples]
    rho = None if g.representation is None else g.representation.tolist()
    return g.dim, g.basis, g.name, columns, rho, casimir_properties(g.casimirs_known)


def casimir_properties(casimirs):
    return [
        (name, type(c).__name__, repr(c), [numbers(value) for x in EXACT_POINTS for value in value_and_gradient(c, x)])
        for name, c in casimirs.items()
        if isinstance(c, co.Polynomial | Quadratic)
    ]


def value_and_gradient(casimir, x):
    value = casimir.value(x) if isinstance(casimir, Quadratic) else casimir(x)
    return value, casimir.gradient(x)


def system_properties(system):
    rho = None if system.representation is None else system.representation.tolist()
    hamiltonian = hamiltonian_properties(system.hamiltonian)
    casimirs = casimir_properties(system.casimirs), casimir_properties(system.integrals)
    return (
        system.sign,
        system.name,
        system.parameters,
        system.layout,
        rho,
        casimirs,
        algebra_properties(system.algebra),
        hamiltonian,
    )
