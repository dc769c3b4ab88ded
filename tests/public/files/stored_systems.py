"""Systems of every kind of record, and their comparison."""

from fractions import Fraction

import numpy as np

import coadjoint as co
from served import state_of

SO3, FREE = co.algebras.so(3), co.LieAlgebra([], dim=3, name="free")
# Not so(3): its constants are the same in every order of the axes.
SL2 = co.LieAlgebra.from_brackets(
    3, {(0, 1): {1: 2.0}, (0, 2): {2: -2.0}, (1, 2): {0: 1.0}}, basis=("h", "e", "f"), name="mine"
)
ADJOINT = np.array([np.column_stack([SL2.bracket(u, v) for v in np.eye(3)]) for u in np.eye(3)])
FULL = [[2.0, 0.3, 0.1], [0.3, -1.5, -0.2], [0.1, -0.2, 1.0]]
Q = co.Quadratic(FULL, [0.1, -0.2, 0.3], 0.5)
P = co.Polynomial({(4, 0, 0): Fraction(1, 3), (0, 1, 1): 1, (0, 0, 0): 1.25})
SPLIT = co.SplitHamiltonian([((2, 0), co.Quadratic([1.0, 2.0])), ((1,), co.Polynomial({(3,): 0.5}))])
PIECES = co.SplitHamiltonian(
    [((0,), co.Quadratic(1.5, constant=2.0)), ((1,), co.Polynomial({(3,): 0.1})), ((2,), co.Quadratic(2.0, [0.3]))]
)
CASIMIR = {"C": co.Polynomial({(2, 0, 0): Fraction(1, 4), (0, 1, 1): 1})}
FORMULA = "a*x1^2/2 + (x2 + x3)^2/b + cos(x1) + 1/(2 + x2*x3)"
BODY = co.systems.rigid_body((1.0, 2.0, 2.5))
WEIGHTS = np.add.outer(np.arange(1.0, 5.0), np.arange(1.0, 5.0))
SPHERE, TORUS = co.systems.sphere_euler(N=4), co.systems.torus_euler(N=3)
G, Weights = co.MatrixAlgebra, co.systems.Weights
INVERSE = type(co.systems.get("reduced_mhd", N=3, surface="sphere").second_stream)


def own(hamiltonian, algebra=SO3, **options):
    return co.LiePoissonSystem(algebra, hamiltonian, name="own", **options)


VECTORS = {
    "ready made": BODY,
    "a number": own(co.Quadratic(1.5, constant=0.75)),
    "a diagonal": own(co.Quadratic([1.0, 2.0, 4.0]), sign=-1),
    "a matrix": own(Q, SL2, sign=-1, casimirs=CASIMIR),
    "a linear part": own(co.Quadratic(0.0, [0.1, 0.2, 0.3])),
    "exact numbers": own(co.Quadratic([Fraction(1, 3), Fraction(1, 2), Fraction(2)])),
    "a polynomial": own(P, SL2, casimirs={"C": 2 * CASIMIR["C"], "D": CASIMIR["C"]}),
    "a quadratic Casimir": own(P, SL2, casimirs={"C": co.Quadratic([[0.5, 0, 0], [0, 0, 1.0], [0, 1.0, 0]])}),
    "integrals": own(co.Quadratic([1.0, 1.0, 2.0]), integrals={"J": co.Polynomial({(0, 0, 1): 1})}),
    "a quadratic integral": own(co.Quadratic([1.0, 1.0, 2.0]), integrals={"J": co.Quadratic([0.0, 0.0, 1.0])}),
    "pieces": own(PIECES, FREE),
    "pieces of two": own(SPLIT, FREE),
    "pieces in another order": own(co.SplitHamiltonian([((2, 0, 1), Q)]), FREE),
    "pieces of pieces": own(co.SplitHamiltonian([((0, 1, 2), co.SplitHamiltonian([((0, 1, 2), Q)]))]), FREE),
    "pieces and a form": own(SPLIT + Q, FREE),
    "pieces and a polynomial": own(SPLIT + P, FREE),
    "a sum": own(P + Q),
    "a formula": own(2 * co.formula(FORMULA, 3, parameters={"a": 1.5, "b": 4}) + co.Quadratic([1.0, 2.0, 3.0])),
    "pieces of formulas": own(
        co.SplitHamiltonian([((0,), "x1^3 + sin(x1)"), ((1, 2), co.formula("cos(p*q)", basis=("p", "q")))]), FREE
    ),
    "a representation": own(Q, SL2, representation=ADJOINT),
    "a larger representation": own(Q, SL2, representation=np.kron(np.eye(2), ADJOINT)),
    "a layout": own(Q, layout={"lattice": "square", "shape": [1, 1]}),
    "a name of a ready-made system": co.LiePoissonSystem(SL2, Q, name="rigid_body"),
    "an unusual name": co.LiePoissonSystem(SL2, Q, name="é's, of 3"),
    "forces": BODY.with_forces(co.forces.LinearDamping(0.1), co.forces.Torque((0.0, 0.1, 0.0))),
    "forces of own": own(Q).with_forces(co.forces.LinearDamping((0.1, 0.2, 0.3))),
    "a batch": co.batch([own(Q), own(2 * P)]),
    "a batch of ready made": co.batch([BODY, co.systems.rigid_body((1.0, 2.0, 2.75))]),
}
MATRICES = {
    "sphere": SPHERE,
    "torus": TORUS,
    "body": co.systems.matrix_body((1.0, 2.0, 4.0)),
    "weights": co.MatrixSystem(G("gl", 4), Weights(WEIGHTS), np.diag([1.0, -0.5, 0.25, 0.0]), energy_sign=-1, powers=2),
    "signature": co.MatrixSystem(G("so", 4, 1), Weights(WEIGHTS), name="lorentz"),
    "unitary": co.MatrixSystem(G("u", 4), Weights(WEIGHTS), 1j * np.diag([1.0, 2.0, 0.5, 0.0]), name="u's, of 4"),
    "blocks": co.MatrixSystem(G.sum(G("so", 2), G("u", 2)), Weights(WEIGHTS), powers=1),
    "solve": co.MatrixSystem(
        G("su", 4), co.systems.DiagonalSolve(SPHERE.stream.main, SPHERE.stream.beside, -0.5)
    ),
    "two layers": co.TwoLayerSystem(G("u", 4), Weights(WEIGHTS), Weights(2.0 * WEIGHTS), energy_sign=-1, powers=2),
    "passive": co.TwoLayerSystem(G("su", 4), SPHERE.stream),
    "currents": co.TwoLayerSystem(G("su", 4), SPHERE.stream, INVERSE(SPHERE.stream), name="currents"),
    "circulants": co.MatrixSystem(G("su", 3), co.systems.Circulants(2.0 * TORUS.stream.spectrum)),
}  # fmt: skip
SYSTEMS = VECTORS | MATRICES


def is_matrix(system):
    return len(getattr(system, "shape", (1,))) > 1


def start(system):
    """Return an initial state of a system, or one for each system of a batch."""
    if isinstance(system, co.System):
        x = state_of(system) if is_matrix(system) else np.cos(np.arange(1.0, system.dim + 1.0))
        if not is_matrix(system) and "z" in system.casimirs:  # positions and momenta are canonical where it is 1
            x[np.argmax(abs(system.casimirs["z"].gradient(0 * x)))] = 1.0
        elif system.name == "point_vortices":  # on the sphere, at unit vectors
            x = (x.reshape(-1, 3) / np.linalg.norm(x.reshape(-1, 3), axis=1, keepdims=True)).ravel()
        return x
    return np.array([start(one) for one in system])


def read_back(system):
    """Return a system that was stored in the dataset of a run of no steps."""
    first = system if is_matrix(system) or hasattr(system, "hamiltonian") else None
    method = co.IsospectralGauss() if first is not None and is_matrix(first) else co.GaussLegendre(2)
    dataset = co.integrate(system, start(system), (0.0, 0.0), 0.125, method).to_xarray()
    return co.results.solution_inputs(dataset)["system"]


def numbers(value):
    """Return entries and their types, which a record preserves: 1/3 is not 0.333..., and 1 is not 1.0."""
    entries = np.asarray(value).ravel().tolist()
    return entries, [type(entry) for entry in entries]


EXACT_POINTS = [np.array([Fraction(k + 1, 7), Fraction(2 - k, 3), Fraction(k, 5)]) for k in range(3)]


def described(system):
    """Return everything of a system on which its motion, energy and invariants depend."""
    if not (hasattr(system, "hamiltonian") or is_matrix(system)):
        return [described(one) for one in system]
    if system.forces:
        return described(system.unforced), system.forces
    x = start(system)
    found = [type(system), system.dim, system.name, system.parameters, system.energy(x)]
    found += [system.vector_field(x).tolist(), list(system.casimirs), list(system.integrals)]
    if is_matrix(system):
        return [*found, system.algebra, system.energy_sign, system.powers]
    for invariant in (system.hamiltonian, *system.casimirs.values(), *system.integrals.values()):
        value = getattr(invariant, "value", invariant)
        found += [type(invariant), repr(invariant), value(x), invariant.gradient(x).tolist()]
        if isinstance(invariant, co.Quadratic | co.Polynomial) and system.dim == 3:
            found += [numbers(value(y)) for y in EXACT_POINTS]
    rho = None if getattr(system, "representation", None) is None else system.representation.tolist()
    algebra = (
        (None,)
        if getattr(system, "algebra", None) is None
        else (system.algebra, system.algebra.basis, system.algebra.name)
    )
    return [*found, system.sign, getattr(system, "layout", None), rho, *algebra, system.structure_matrix(x).tolist()]
