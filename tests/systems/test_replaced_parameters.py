"""Systems with other values of their parameters, and the derivatives of their energies."""

import numpy as np
import pytest
import scipy.sparse

import coadjoint as co
from coadjoint.systems.parameters import parameters_at, parameters_of, with_parameters

ALGEBRA = co.algebras.so(3)
FULL = np.array([[1.0, 0.2, 0.0], [0.2, 0.5, 0.1], [0.0, 0.1, 0.4]])
QUARTIC = co.Polynomial({(4, 0, 0): 0.25, (0, 2, 0): 0.5, (0, 0, 2): 1.0, (1, 1, 0): 0.1})
NAMES = ("heavy_top", "kirchhoff_body", "lagrange_top", "manakov_top", "riccati", "rigid_body", "spin_lattice", "toda")


def system_on_so3(H):
    return co.LiePoissonSystem(ALGEBRA, H, sign=-1, name="mine", integrals={"H": H})


def band(n):
    """A sparse matrix above the largest dense one, and its stored entries."""
    return scipy.sparse.diags_array([np.full(n - 1, 0.1), np.ones(n), np.full(n - 1, 0.1)], offsets=(-1, 0, 1)).tocsr()


def get(name):
    return co.systems.get(name, **({"inertia": (1.0, 2.0, 2.5)} if name == "rigid_body" else {}))


@pytest.mark.parametrize("name", NAMES)
def test_ready_made_systems_are_made_by_their_functions(name):
    system = get(name)
    values = {key: np.asarray(1.0625 * one.value) for key, one in parameters_of(system).items()}
    changed, x = with_parameters(system, values), np.cos(np.arange(system.dim))
    if set(values) <= set(system.parameters):
        made = co.systems.get(name, **(system.parameters | values))
        assert changed.parameters == made.parameters
        assert np.array_equal(changed.vector_field(x), made.vector_field(x))
    found = parameters_at(system, values)
    for key, one in parameters_of(changed).items():
        assert np.array_equal(one.value, found[key].value)
        assert np.array_equal(one.energy().at(x), found[key].energy().at(x))


@pytest.mark.parametrize("M", [[1.0, 0.5, 0.4], FULL], ids=["diagonal", "full"])
def test_matrix_and_linear_part_are_replaced(M):
    system = system_on_so3(co.Quadratic(M, linear=[0.0, 0.1, 0.0], constant=2.0))
    values = {"M": 1.5 * np.array(M), "linear": np.array([0.5, 0.0, 0.25])}
    changed = with_parameters(system, values)
    own, x = co.Quadratic(values["M"], values["linear"], 2.0), np.array([1.0, 2.0, 0.5])
    assert changed.energy(x) == own(x) and np.array_equal(changed.hamiltonian.gradient(x), own.gradient(x))
    assert (changed.name, changed.sign, changed.algebra) == ("mine", -1, ALGEBRA)
    assert changed.integrals == {} and changed.parameters is None
    assert system.energy(x) == co.Quadratic(M, [0.0, 0.1, 0.0], 2.0)(x)
    only = with_parameters(system, {"linear": values["linear"]})
    assert np.array_equal(only.hamiltonian.gradient(x), co.Quadratic(M, values["linear"]).gradient(x))


def test_symmetric_part_of_a_matrix_counts():
    system = system_on_so3(co.Quadratic(FULL))
    changed = with_parameters(system, {"M": FULL + np.array([[0.0, 0.5, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])})
    assert np.array_equal(changed.hamiltonian.hessian(np.zeros(3))[0], [1.0, 0.5 * (0.7 + 0.2), 0.0])


def test_stored_entries_of_a_large_matrix_are_replaced():
    n, M = 129, band(129)
    system = co.LiePoissonSystem(co.algebras.copies(ALGEBRA, n // 3), co.Quadratic(M), casimirs={})
    value = parameters_of(system)["M"].value
    assert value.shape == (3 * n - 2,)
    changed = with_parameters(system, {"M": 2.0 * value})
    assert abs(changed.hamiltonian.hessian(np.zeros(n)) - 2.0 * M.toarray()).max() == 0.0
    # An entry alone counts with its symmetric part, as in smaller matrices.
    moved = value.copy()
    moved[1] += 0.5
    hessian = with_parameters(system, {"M": moved}).hamiltonian.hessian(np.zeros(n))
    assert M.toarray()[0, 1] == 0.1 and hessian[0, 1] == hessian[1, 0] == 0.5 * (0.6 + 0.1)


def test_coefficients_are_replaced_in_the_order_of_the_monomials():
    system = system_on_so3(QUARTIC)
    values, x = np.array([2.0, 0.0, 3.0, 0.5]), np.array([1.0, 2.0, 0.5])
    changed = with_parameters(system, {"coefficients": values})
    monomials = dict(zip(system.hamiltonian.polynomial.monomials, values.tolist(), strict=True))
    assert changed.energy(x) == co.Polynomial(monomials, dim=3)(x)


@pytest.mark.parametrize(
    ("H", "values"),
    [
        (co.Quadratic(FULL, linear=[0.1, 0.0, 0.2]), {"M": np.diag([1.0, 0.5, 0.4]), "linear": np.zeros(3)}),
        (QUARTIC, {"coefficients": np.zeros(4)}),
    ],
    ids=["quadratic", "polynomial"],
)
def test_derivatives_by_coefficients_that_are_zero_remain(H, values):
    """The energy is linear in these parameters: its difference for a unit of an entry is the derivative."""
    system, x = system_on_so3(H), np.array([1.0, 2.0, 0.5])
    found = parameters_at(system, values)
    energy = with_parameters(system, values).energy(x)
    for name, value in values.items():
        assert found[name].value.shape == value.shape
        for k, derivative in zip(np.ndindex(value.shape), found[name].energy().at(x), strict=True):
            unit = np.zeros_like(value)
            unit[k] = 1.0
            moved = with_parameters(system, values | {name: value + unit}).energy(x)
            assert abs(moved - energy - derivative) < 8 * 2.0**-53 * (abs(moved) + abs(energy))


@pytest.mark.parametrize(
    ("system", "values", "message"),
    [
        (co.systems.rigid_body((1, 2, 3)), {"inertia": np.array([1.0, -2.0, 3.0])}, "inertia"),
        (system_on_so3(co.Quadratic(FULL)), {"M": np.full((3, 3), np.nan)}, "M"),
    ],
    ids=["builder", "Hamiltonian"],
)
def test_refused_values_are_named(system, values, message):
    with pytest.raises(ValueError, match=message):
        with_parameters(system, values)


@pytest.mark.parametrize("n", [127, 128, 129])
def test_matrices_are_parameters_with_all_entries_up_to_a_dimension(n):
    commuting = co.LieAlgebra.from_brackets(n, {})
    M = parameters_of(co.LiePoissonSystem(commuting, co.Quadratic(band(n)), casimirs={}))["M"]
    assert M.value.shape == ((n, n) if n <= 128 else (3 * n - 2,))


def test_derivatives_of_coefficients_are_exact():
    """H = x.x / (2 I) has the derivative -x.x / (2 I^2), and one linear in a parameter its coefficients."""
    inertia = np.array([1.0, 2.0, 2.5])
    found = parameters_of(co.systems.heavy_top(inertia=inertia, lever=(0.1, 0.2, 1.0)))
    by_inertia, by_lever = found["inertia"].energy(), found["lever"].energy()
    assert by_inertia.quadratic.tolist() == [[0, 0], [1, 1], [2, 2]] and not len(by_inertia.linear)
    np.testing.assert_allclose(by_inertia.quadratic_factor, -0.5 / inertia**2, rtol=1e-13, atol=0)
    assert by_lever.linear.tolist() == [3, 4, 5] and not len(by_lever.quadratic)
    np.testing.assert_allclose(by_lever.linear_factor, by_lever.linear_factor[0], rtol=4 * 2.0**-53, atol=0)
