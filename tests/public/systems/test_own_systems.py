"""Systems and terms of one's own: a bracket without a table, states that are matrices, and the protocol alone."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from refusals import refused

FunctionTerm = co.systems.FunctionTerm
RNG = np.random.default_rng(20)
KNOWN = co.systems.rigid_body(inertia=(1, 2, 3))


class OwnBody(co.System):
    """What a system needs, and nothing more."""

    name, sign, dim = "own body", -1, 3
    algebra, hamiltonian, casimirs = KNOWN.algebra, KNOWN.hamiltonian, KNOWN.casimirs


@pytest.mark.parametrize("method", [co.Splitting(order=4), co.GaussLegendre(2), co.Taylor(8)], ids=str)
def test_structure_constants_suffice(method):
    """Schemes need structure constants, not a class: the run of a user-defined system has the same bits."""
    for attitude in (False, "coadjoint"):
        run = {"x0": (0.1, 1.0, 0.1), "t_span": (0, 2), "step": 0.1, "method": method, "attitude": attitude}
        own, known = (co.integrate(system, **run) for system in (OwnBody(), KNOWN))
        assert np.array_equal(own.x, known.x) and np.array_equal(own.energy, known.energy)
        assert attitude is False or np.array_equal(own.attitude, known.attitude)
    own = OwnBody()
    own.algebra = None
    with refused(ValueError, "own body", "Lie algebra"):
        co.integrate(own, (0.1, 1.0, 0.1), (0, 1), 0.1, co.Splitting())


def squared_length(x):
    """J(x) = |x|^2 hat(x), not linear in x."""
    return (x[0] ** 2 + x[1] ** 2 + x[2] ** 2) * np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])


class OwnBracket(co.System):
    """A bracket by a function; without one only J(x) in Python."""

    name, sign, dim, hamiltonian = "own bracket", 1, 3, co.Quadratic([1.0, 0.5, 0.3])

    def __init__(self, function):
        self.structure_function = function


class OwnMatrix(OwnBracket):
    structure_function = None

    def __init__(self):
        pass

    def structure_matrix(self, x):
        return squared_length(x)


@dataclasses.dataclass(frozen=True)
class Midpoint(co.methods.StepMethod):
    order, explicit, symmetric = 2, True, False

    def properties(self, system):
        return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")

    def step(self, system, x, t, h):
        return x + h * system.vector_field(x + h / 2 * system.vector_field(x, t), t + h / 2)


@pytest.mark.parametrize("method", [co.GaussLegendre(2), Midpoint()], ids=str)
def test_a_structure_function_suffices(method):
    """The run has the bits of the `PoissonSystem` by the same function."""
    known = co.PoissonSystem(squared_length, OwnBracket.hamiltonian)
    run = {"x0": (0.1, 1.0, 0.1), "t_span": (0, 2), "step": 0.1, "method": method}
    own = co.integrate(OwnBracket(squared_length), **run)
    assert np.array_equal(own.x, co.integrate(known, **run).x)


@pytest.mark.filterwarnings("ignore:the steps of Midpoint")
def test_a_structure_matrix_in_python_suffices_for_steps_in_python():
    run = {"x0": (0.1, 1.0, 0.1), "t_span": (0, 2), "step": 0.1}
    found, known = (co.integrate(one, **run, method=Midpoint()) for one in (OwnMatrix(), OwnBracket(squared_length)))
    np.testing.assert_allclose(found.x, known.x, rtol=0, atol=1e-14)
    with refused(TypeError, "own bracket", "structure_function", "StepMethod"):
        co.integrate(OwnMatrix(), **run, method=co.GaussLegendre(2))


class SkewMatrices:
    """so(N) as matrices: a bracket, and no structure constants."""

    def __init__(self, N):
        self.dim, self.basis = N * N, [f"x{i}{j}" for i in range(N) for j in range(N)]

    def bracket(self, A, B):
        return A @ B - B @ A


class MatrixBody(co.System):
    """X' = [X, A(X)], A(X)_ij = w_ij X_ij, for a skew matrix X."""

    sign = 1

    def __init__(self, weights):
        N = len(weights)
        self.shape, self.dim, self.name = (N, N), N * N, f"a body of {N} x {N}"
        self.algebra, self.weights = SkewMatrices(N), weights
        self.hamiltonian = co.Quadratic(weights.ravel())
        self.casimirs = {"|X|^2": co.Quadratic(2.0 * np.ones(N * N))}

    def hamiltonian_field(self, x, t=0.0):
        X = np.reshape(x, self.shape)
        return self.algebra.bracket(X, self.weights * X).ravel()

    def energy(self, x, t=0.0):
        return 0.5 * float(np.sum(self.weights * np.reshape(x, self.shape) ** 2))


@dataclasses.dataclass(frozen=True)
class Isospectral(co.methods.StepMethod):
    """X -> Q^T X Q with Q the Cayley map of h A at the midpoint: all eigenvalues are kept."""

    order, explicit, symmetric = 2, False, False

    def properties(self, system):
        return co.methods.Properties(poisson=False, energy=False, casimirs="all", attitude="none")

    def step(self, system, x, t, h):
        X = np.reshape(x, system.shape)
        one, middle = np.eye(len(X)), X + h / 2 * np.reshape(system.vector_field(x), system.shape)
        A = system.weights * middle
        Q = np.linalg.solve(one - h / 2 * A, one + h / 2 * A)
        return (Q.T @ X @ Q).ravel()


def skew(N):
    half = RNG.standard_normal((N, N))
    return (half - half.T) / 2


def body(N):
    half = RNG.uniform(0.5, 2.0, (N, N))
    return MatrixBody((half + half.T) / 2)


@pytest.mark.filterwarnings("ignore:the steps of Isospectral")
def test_matrices_without_structure_constants():
    system = body(7)
    X = np.stack([skew(7), 0.5 * skew(7)])
    sol = co.integrate(system, X, (0, 2), 0.02, Isospectral(), save_every=50, threads=2)
    assert sol.x.shape == (3, 2, 7, 7) and sol.energy.shape == (3, 2)
    assert np.array_equal(sol.x[0], X)
    for m in range(2):
        alone = co.integrate(system, X[m], (0, 2), 0.02, Isospectral(), save_every=50)
        assert alone.x.shape == (3, 7, 7) and np.array_equal(alone.x, sol.x[:, m])
        before, after = (np.sort(np.linalg.eigvals(found).imag) for found in (X[m], alone.x[-1]))
        assert np.max(np.abs(before - after)) < 1e-12
    assert sol.drift(relative=False)["|X|^2"] < 1e-11 and 1e-8 < sol.drift(relative=False)["energy"] < 1e-1
    assert abs(sol.energy[0, 0] - system.energy(X[0])) < 1e-12
    assert Isospectral().work(system).cost(1.0, 1.0) > 0.0


class Springs:
    """A term of one's own: an energy that is a square and the function of one coordinate."""

    piece, constant, degree, called, differentiable, form = None, 0.0, None, True, True, None
    multiplications = 2

    def __init__(self, square, function):
        self.parts = (square, function)

    def couplings(self):
        for part in self.parts:
            yield from part.couplings()

    def placed(self, where, n, piece):
        return Springs(*(part.placed(where, n, piece) for part in self.parts))

    def describe_to(self, reader):
        return [part.describe_to(reader) for part in self.parts][-1]


class SpringEnergy:
    """A Hamiltonian of one's own with one such term: that of a known one, H = x1^2 / 2 + cosh x2."""

    timed = False

    def __init__(self, known):
        self.dim, self.value, self.gradient, self.hessian = known.dim, known.value, known.gradient, known.hessian
        square = co.Quadratic([0.0, 1.0] + [0.0] * (self.dim - 2)).terms()[0]
        self.kept = (Springs(square, FunctionTerm(np.array([2]), np.cosh, np.sinh, np.cosh, scalar=True)),)

    def bind(self, n):
        return self

    def terms(self):
        return self.kept


@pytest.mark.parametrize("algebra", [co.algebras.so(3), co.algebras.e(3), co.algebras.get("A4,10")], ids=repr)
@pytest.mark.parametrize("method", [co.Splitting(order=4), co.GaussLegendre(2), co.ExplicitRungeKutta("rk4")], ids=str)
def test_a_term_of_ones_own_is_what_it_gives_itself_as(algebra, method):
    n = algebra.dim
    square = (lambda y: 0.5 * y * y, lambda y: y, lambda y: 1.0)
    known = co.Separable({1: square, 2: (np.cosh, np.sinh, np.cosh)}).bind(n)
    own, other = (co.LiePoissonSystem(algebra, H) for H in (SpringEnergy(known), known))
    x0 = 0.3 * np.cos(np.arange(n) + 1.0)
    found, expected = (co.integrate(system, x0, (0, 2), 0.05, method) for system in (own, other))
    # Parts in another order have another error of the scheme, which is below the bound of order four.
    assert np.max(np.abs(found.x - expected.x)) < 1e-5
    assert np.max(np.abs(found.x[-1] - x0)) > 1e-2
    assert np.max(np.abs(found.energy - expected.energy)) < 1e-5


@pytest.mark.filterwarnings("ignore:the steps of Isospectral")
def test_matrices_with_forces():
    """Viscosity that differs by entry, and forcing, for states without structure constants; orbits need these."""
    system, X = body(4), skew(4)
    drag = np.abs(skew(4)).ravel()
    forced = system.with_forces(co.forces.LinearDamping(drag), co.forces.Torque(0.1 * skew(4).ravel()))

    exact = solve_ivp(lambda t, x: forced.vector_field(x), (0, 1), X.ravel(), rtol=1e-11, atol=1e-12).y[:, -1]
    coarse, fine = (co.integrate(forced, X, (0, 1), h, Isospectral()) for h in (2**-6, 2**-7))
    errors = [np.max(np.abs(found.x[-1].ravel() - exact)) for found in (coarse, fine)]
    assert coarse.x.shape == (65, 4, 4) and 3.0 < errors[0] / errors[1] < 5.0
    assert fine.balance(relative=False)["|X|^2"] < 1e-12 < 1e-2 < abs(fine.work["LinearDamping"]["|X|^2"][-1])
    with refused(ValueError, "structure constants", "a body of 4 x 4"):
        system.with_forces(co.forces.DoubleBracketDamping(0.1))


def test_the_dataset_of_a_class_of_ones_own_names_it():
    """Its class cannot be stored: the numbers are, and what repeats the run says so."""
    sol = co.integrate(OwnBody(), (0.1, 1.0, 0.1), (0, 1), 0.1, co.Splitting())
    dataset = sol.to_xarray()
    assert np.array_equal(dataset.x.values, sol.x) and "OwnBody" in dataset.attrs["not_stored"]
    with refused(ValueError, "own body", "OwnBody"):
        co.results.rebuild(dataset)
    repeated = co.integrate(**co.results.solution_inputs(dataset, system=OwnBody()))
    assert np.array_equal(repeated.x, sol.x)


@pytest.mark.parametrize("name", ["torus_euler", "sphere_euler", "reduced_mhd", "matrix_body"])
def test_jacobians_of_matrices_are_the_derivatives_of_their_fields(name):
    """By central differences along the algebra: the fields are quadratic, so that only rounding is left."""
    system = co.systems.get(name, **({} if name == "matrix_body" else {"N": 5}))
    x, *units = system.to_vector(
        system.algebra.projected(
            system.from_vector(np.vstack([np.random.default_rng(2).standard_normal(system.dim), np.eye(system.dim)]))
        )
    )
    expected = [(system.vector_field(x + u) - system.vector_field(x - u)) / 2 for u in units]
    np.testing.assert_allclose(np.array(units) @ system.jacobian(x).T, expected, rtol=0, atol=1e-12)
