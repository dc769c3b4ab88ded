"""The field, the energy and the Casimirs take arrays of states; field and energy with the bits that they have alone."""

from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co


def _driven():
    return co.LiePoissonSystem(
        co.algebras.so(3),
        co.Hamiltonian(
            lambda x, t: np.cosh(x[0]) + np.cos(t) * x[2], lambda x, t: np.array([np.sinh(x[0]), 0.0, np.cos(t)])
        ),
    )


def _curved():
    J = lambda x: (x @ x) * np.array([[0, x[2], -x[1]], [-x[2], 0, x[0]], [x[1], -x[0], 0]])  # noqa: E731
    return co.PoissonSystem(J, co.Quadratic([1.0, 2.0, 3.0]))


SYSTEMS = {
    "quadratic": lambda: co.systems.rigid_body((1, 2, 3)),
    "non-unimodular": co.systems.paper_a37,
    "cubic": lambda: co.LiePoissonSystem(
        co.algebras.get("A4_8"), co.Polynomial({(1, 1, 1, 0): 1.0, (0, 0, 0, 2): 0.5})
    ),
    "functions of time": _driven,
    "a function J": _curved,
    "forces": lambda: co.systems.heavy_top().with_forces(co.forces.LinearDamping(0.1), co.forces.Torque([0.1] * 6)),
    "tops": co.systems.kovalevskaya_top,
}


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("lead", [(5,), (4, 3), (3, 3), (2, 3, 2), (1,), (0,), (2, 0), (0, 3)])
def test_each_of_many_states_has_the_bits_that_it_has_alone(name, lead):
    system = SYSTEMS[name]()
    x = np.random.default_rng(3).normal(size=(*lead, system.dim))
    t = np.linspace(0.0, 2.0, lead[0])
    field, energy = system.vector_field(x, t), system.energy(x, t)
    assert field.shape == x.shape and energy.shape == lead
    for place in np.ndindex(*lead):
        assert (field[place] == system.vector_field(x[place], t[place[0]])).all()
        assert energy[place] == system.energy(x[place], t[place[0]])
    for casimir in system.casimirs.values():
        values = casimir(x)
        assert values.shape == lead
        for place in np.ndindex(*lead):
            # Polynomials of many states are summed monomial by monomial: some 20 terms of degree 4 at most.
            size = (1.0 + np.abs(x[place]).sum()) ** 4
            assert abs(values[place] - casimir(x[place])) <= 20 * 2.0**-53 * size


def test_one_time_serves_all_and_exact_numbers_stay_exact():
    system = _driven()
    x = np.random.default_rng(4).normal(size=(3, 3))
    assert (system.energy(x, 0.7) == [system.energy(row, 0.7) for row in x]).all()
    form = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1, 0.5, 0.25]), sign=-1)
    exact = form.vector_field(np.array([[Fraction(1), Fraction(2), Fraction(4)]] * 2))
    assert exact.dtype == object and exact.tolist() == [[Fraction(-2), Fraction(3), Fraction(-1)]] * 2


def test_states_and_times_that_do_not_fit():
    body = co.systems.rigid_body((1, 2, 3))
    with pytest.raises(
        ValueError, match=r"x has shape \(4, 2\); a point of this system has shape \(3,\), many have \(k, 3\)"
    ):
        body.vector_field(np.ones((4, 2)))
    with pytest.raises(ValueError, match=r"t has shape \(3,\); give one time, or one for each of 4 states"):
        body.energy(np.ones((4, 3)), np.zeros(3))


def test_a_quadratic_is_called_as_other_invariants_are():
    square = co.Quadratic([2.0, 2.0, 2.0])
    body = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1, 2, 3]), casimirs={"C": square})
    x = np.random.default_rng(5).normal(size=(4, 3))
    np.testing.assert_allclose(body.casimirs["C"](x), np.sum(x * x, axis=1), rtol=1e-15)
    assert body.casimirs["C"](x[0]) == square.value(x[0])


def test_matrices_stay_what_they_are():
    system = co.systems.matrix_body((1.0, 2.0, 3.0))
    W = np.zeros((3, 3))
    W[0, 1], W[1, 0] = 1.0, -1.0
    forced = system.with_forces(co.forces.LinearDamping(0.1))
    assert forced.vector_field(W).shape == (3, 3)
    assert system.energy(np.stack([W, W])).shape == (2,)
