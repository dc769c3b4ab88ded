"""Systems with any skew J(x), and known integrals: checked to be constant, observed, and stored."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

A = np.array([[0.0, 1.0, -2.0], [-1.0, 0.0, 0.5], [2.0, -0.5, 0.0]])


def lotka_volterra(x):
    return np.outer(x, x) * A


SUM = co.Separable({i: (lambda y: y - np.log(y), lambda y: 1 - 1 / y, lambda y: 1 / y**2) for i in range(3)})

# J(x) grad C = x_i sum_j A_ij v_j = 0 with A v = 0.
KERNEL = np.array([0.5, 2.0, 1.0])

LOG = co.Invariant(lambda x: KERNEL @ np.log(x), lambda x: KERNEL / x)


def test_field_energy_and_casimir():
    system = co.PoissonSystem(lotka_volterra, SUM, dim=3, casimirs={"C": LOG}, sign=-1)
    x = np.array([0.5, 1.5, 2.0])
    np.testing.assert_allclose(system.vector_field(x), -x * (A @ (x - 1)), rtol=1e-14)
    assert system.energy(x) == pytest.approx(np.sum(x - np.log(x)))
    assert system.casimirs["C"] is LOG
    assert system.algebra is None and system.representation is None and system.parameters is None
    with refused(TypeError, "derivative="):
        system.jacobian(x)
    with refused(TypeError, "closed form", "Poisson system"):
        system.exact(x, 1.0)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("seed", range(4))
def test_field_and_jacobian_of_random_brackets(seed, sign):
    """J_ij = x_i x_j B_ij + (Q x)_k, B and J skew, both at random: against its formula, and complex steps of it."""
    rng = np.random.default_rng(seed)
    B, Q = rng.uniform(-1.0, 1.0, (4, 4)), rng.uniform(-1.0, 1.0, (4, 4, 4))
    B, Q = B - B.T, Q - Q.transpose(1, 0, 2)

    def structure(x):
        return np.outer(x, x) * B + Q @ x

    def derivative(x):
        e = np.eye(4)
        return B[:, :, None] * (e[:, None, :] * x[None, :, None] + x[:, None, None] * e[None, :, :]) + Q

    M = rng.uniform(-1.0, 1.0, (4, 4))
    H = co.Quadratic(M + M.T, linear=rng.uniform(-1.0, 1.0, 4))
    system = co.PoissonSystem(structure, H, derivative=derivative, sign=sign, jacobi=False)
    x = rng.uniform(0.5, 1.5, 4) * rng.choice([-1.0, 1.0], 4)
    np.testing.assert_allclose(system.vector_field(x), sign * (structure(x) @ H.gradient(x)), rtol=1e-13, atol=1e-13)
    jacobian = system.jacobian(x)
    for i in range(4):
        column = np.imag(system.vector_field(x + 1e-30j * np.eye(4)[i])) / 1e-30
        np.testing.assert_allclose(jacobian[:, i], column, rtol=1e-13, atol=1e-13)


SO3 = co.algebras.so(3)

THIRD = co.Polynomial({(0, 0, 1): 1})

SYMMETRIC = co.Quadratic([0.3, 0.3, 0.7])


def body(**given):
    return co.LiePoissonSystem(SO3, SYMMETRIC, sign=-1, name="own", **given)


def test_they_are_read_only_and_may_be_observed():
    system = body(integrals={"x3": THIRD, "x3^2": co.Quadratic([0, 0, 2]), "cos": co.Invariant(lambda x: np.cos(x[2]))})
    assert list(system.integrals) == ["x3", "x3^2", "cos"] and system.integrals["x3"] == THIRD
    system.integrals.clear()
    assert len(system.integrals) == 3
    kept = {name: F for name, F in system.integrals.items() if name != "cos"}
    sol = co.integrate(system, (1.0, 0.5, 0.25), (0, 5), 0.5, co.Splitting(2), observe=kept)
    assert np.ptp(sol.observed["x3"]) == 0.0 and sol.observed["x3^2"][0] == 0.0625
    assert body().integrals == {}


def test_a_dataset_keeps_those_that_are_polynomials():
    cube = co.Polynomial({(0, 0, 3): 1})
    forms = {"x3": THIRD, "cube": cube, "x3^2": co.Quadratic([0, 0, 2])}
    sol = co.integrate(body(integrals={**forms, "f": lambda x: x[2]}), (1.0, 0.5, 0.25), (0, 1), 0.5, co.Splitting(2))
    dataset = sol.to_xarray()
    assert "integral: f" in str(dataset.attrs)
    again = co.results.rebuild(dataset).system
    assert list(again.integrals) == list(forms) and again.integrals["cube"] == cube
    assert again.integrals["x3^2"].value([0, 0, 2.0]) == 4.0


def test_energies_that_are_functions():
    H = co.Hamiltonian(lambda x: np.cosh(x[2]) + x[0] ** 2 + x[1] ** 2)
    assert co.LiePoissonSystem(SO3, H, integrals={"x3": THIRD}).integrals
    with refused(ValueError, "'x1'", "integral"):
        co.LiePoissonSystem(SO3, H, integrals={"x1": co.Polynomial({(1, 0, 0): 1})})
    cubic = co.Polynomial({(2, 0, 1): 1, (0, 2, 1): 1, (0, 0, 3): 0.1})
    assert co.LiePoissonSystem(SO3, cubic, integrals={"x3": THIRD}).integrals


def test_a_field_that_rests_at_time_zero_is_looked_at_later():
    turning = co.Hamiltonian(lambda x, t: t * x[0], lambda x, t: np.array([t, 0 * t, 0 * t]))
    with refused(ValueError, "'x3'", "integral"):
        co.LiePoissonSystem(SO3, turning, integrals={"x3": THIRD})
    assert co.LiePoissonSystem(SO3, turning, integrals={"x1": co.Polynomial({(1, 0, 0): 1})}).integrals


def test_casimirs_of_the_time_are_refused_and_observed_functions_of_it_recorded():
    def moving(x, t):
        return x[2] + t

    with refused(TypeError, "'C'", "Casimir", "(x, t)", "observe"):
        co.LiePoissonSystem(SO3, co.Quadratic([1.0, 1.0, 2.0]), casimirs={"C": moving})
    observe = {"plain": moving, "invariant": co.Invariant(moving)}
    sol = co.integrate(body(), (1.0, 0.5, 0.25), (0, 1), 0.5, observe=observe)
    for values in sol.observed.values():
        np.testing.assert_array_equal(values, sol.x[:, 2] + sol.t)


BRACKETS = {
    "Lotka-Volterra": (lambda x: np.outer(x, x) * A, lambda x: KERNEL @ np.log(np.abs(x))),
    "(1 + x1^2) so(3)": (lambda x: (1 + x[0] ** 2) * SO3.structure_matrix(x), lambda x: np.sqrt(x @ x)),
    "canonical": (lambda x: np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 0]]), lambda x: np.exp(x[2])),
}


@pytest.mark.parametrize("unit", [1e-7, 1.0, 1e30])
@pytest.mark.parametrize("name", BRACKETS)
def test_functions_are_checked_by_differences(name, unit):
    """Right Casimirs in three units and as products; with a foreign part of 10^-5 they are refused."""
    J, C = BRACKETS[name]

    def bracket(x):
        return unit * J(x)

    system = co.PoissonSystem(bracket, co.Quadratic(1.0), dim=3, casimirs={"C": C, "C^2": lambda x: unit * C(x) ** 2})
    assert list(system.casimirs) == ["C", "C^2"]
    with refused(ValueError, "'C'", "not a Casimir", "rate"):
        co.PoissonSystem(
            bracket, co.Quadratic(1.0), dim=3, casimirs={"C": lambda x: unit * (C(x) + 1e-5 * x[0] * x[1])}
        )
    jumps = {"angle": lambda x: np.floor(5 * C(x)), "nowhere": lambda x: np.log(-np.abs(x[0]))}
    assert len(co.PoissonSystem(bracket, co.Quadratic(1.0), dim=3, casimirs=jumps).casimirs) == 2


@pytest.mark.parametrize("unit", [1e-7, 1.0, 1e30])
def test_brackets_that_violate_the_jacobi_identity_warn(unit):
    """J u = b x u fulfils it if b . curl b = 0; here that is -x1 x3. By differences, and by derivatives."""

    def J(x):
        b = unit * np.array([x[0] * x[1], x[1], x[2]])
        return np.array([[0 * b[0], b[2], -b[1]], [-b[2], 0 * b[0], b[0]], [b[1], -b[0], 0 * b[0]]])

    def slope(x):
        return np.stack([(J(x + h) - J(x - h)) / 2 for h in np.eye(3)], axis=-1)  # J is quadratic

    for derivative in (None, slope):
        with pytest.warns(UserWarning, match="mine violates the Jacobi identity.*jacobi=False") as told:
            co.PoissonSystem(J, co.Quadratic(1.0), dim=3, derivative=derivative, name="mine")
        assert len(told) == 1 and told[0].filename == __file__
        system = co.PoissonSystem(J, co.Quadratic(1.0), dim=3, derivative=derivative, jacobi=False)
        assert not system.jacobi
    with refused(TypeError, "jacobi"):
        co.PoissonSystem(J, co.Quadratic(1.0), dim=3, jacobi="no")


@pytest.mark.parametrize("unit", [1e-7, 1.0, 1e30])
def test_integrals_and_casimirs_of_algebras_are_checked(unit):
    with refused(ValueError, "'f'", "integral", "rate"):
        co.LiePoissonSystem(SO3, co.Quadratic([0.3 * unit, 0.3 * unit, 0.7 * unit]), integrals={"f": lambda x: x[0]})
    given = {"f": lambda x: np.tanh(x[2]), "size": lambda x: x @ x}
    assert co.LiePoissonSystem(SO3, co.Quadratic([0.3 * unit, 0.3 * unit, 0.7 * unit]), integrals=given).integrals
    constants = [(0, 1, 2, unit), (1, 2, 0, unit), (2, 0, 1, unit)]
    with refused(ValueError, "'q'", "not a Casimir"):
        co.LieAlgebra(constants, dim=3, casimirs={"q": co.Polynomial("x1^2 + x2^2", dim=3)})
    assert co.LieAlgebra(constants, dim=3, casimirs={"q": co.Invariant(lambda x: np.cos(x @ x))}).casimirs_known
