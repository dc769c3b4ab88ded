"""The gyrostat: by hand, in closed form, and without rotors."""

import numpy as np
import pytest
from motions import FULL, ORDERS, U, assert_integrals, by_hand, errors, turned

import coadjoint as co


@pytest.mark.parametrize("inertia", [(1.0, 2.0, 2.75), FULL])
def test_gyrostat_by_hand(inertia):
    k, x0 = np.array([0.3, -0.4, 0.8]), np.array([1.0, 0.5, -0.7])
    tensor = np.diag(inertia) if np.ndim(inertia) == 1 else inertia
    system = co.systems.gyrostat(inertia, k)

    def field(x):
        return np.cross(x, np.linalg.solve(tensor, x - k))

    np.testing.assert_allclose(system.vector_field(x0), field(x0), rtol=0, atol=8 * U)
    assert system.energy(x0) == pytest.approx(0.5 * (x0 - k) @ np.linalg.solve(tensor, x0 - k), rel=32 * U)
    assert system.sign == -1 and system.integrals == {} and list(system.casimirs) == ["|x|^2"]
    coarse, fine = errors(system, x0, by_hand(field, x0, 5.0), 5.0, 0.05, co.Splitting(order=2))
    assert 3.0 < coarse / fine < 5.4
    with pytest.raises(TypeError, match="no closed form"):
        system.exact(x0, 1.0)


def test_without_rotors_it_is_the_rigid_body():
    x = np.array([1.0, 0.5, -0.7])
    np.testing.assert_array_equal(
        co.systems.gyrostat(FULL, (0, 0, 0)).vector_field(x), co.systems.rigid_body(FULL).vector_field(x)
    )


@pytest.mark.thinned(2)
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    ("inertia", "rotors"), [((2, 2, 3), (0, 0, 0.7)), ((2, 2, 2), (0.3, -0.4, 0.8)), ((2, 2, 1), (0, 0, 0))]
)
def test_symmetric_gyrostat_in_closed_form(order, inertia, rotors):
    inertia, k, x0 = turned(order, np.array(inertia, float), np.array(rotors, float), [1.0, 0.5, -0.7])
    system = co.systems.gyrostat(inertia, k)
    first = co.systems.rigid_body((1, 2, 3)).exact((0.3, 0.4, 0.5), 1.0, attitude=True)[1]
    h = 2.0**-17  # the error of the central difference is about h^2, 6e-11, and u / h, 1.5e-11
    t = np.array([0.0, 1.3 - h, 1.3, 1.3 + h])
    x, A = system.exact(x0, t, attitude=first)
    np.testing.assert_allclose(x[0], x0, rtol=0, atol=4 * U)
    np.testing.assert_allclose(A @ x[..., None], np.broadcast_to((first @ x0)[:, None], (4, 3, 1)), rtol=0, atol=32 * U)
    omega = (x[2] - k) / inertia
    hat = np.array([[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]])
    np.testing.assert_allclose((A[3] - A[1]) / (2 * h), A[2] @ hat, rtol=0, atol=1e-9)
    np.testing.assert_allclose((x[3] - x[1]) / (2 * h), np.cross(x[2], omega), rtol=0, atol=1e-9)
    run = co.integrate(system, x0, (0.0, 3.0), 0.05, co.Splitting(order=6), attitude=first)
    np.testing.assert_allclose(run.x[-1], system.exact(x0, 3.0), rtol=0, atol=1e-10)
    np.testing.assert_allclose(run.attitude[-1], system.exact(x0, 3.0, attitude=first)[1], rtol=0, atol=1e-10)
    assert assert_integrals(system, list(system.integrals), rounded=rotors[1] != 0) >= 2 and len(system.integrals) == 1
    assert system.exact(x0, -2.0).shape == (3,)
    with pytest.raises(ValueError, match="t has shape"):
        system.exact(x0, [[1.0]])
    with pytest.raises(ValueError, match="x0 has shape"):
        system.exact((1, 2), 1.0)
    with pytest.raises(ValueError, match="attitude has shape"):
        system.exact(x0, 1.0, attitude=np.eye(2))


S = co.systems
WRONG = [
    (S.gyrostat, {"rotors": (1, 2)}, "rotors has shape"),
    (S.gyrostat, {"inertia": (1, 0, 2)}, r"inertia\[1\] is 0"),
    (S.gyrostat, {"rotors": (1e200, 0, 0)}, r"the energy of the rotors, \[1e\+200, 0.0, 0.0\], leaves the range"),
    (S.gyrostat, {"inertia": FULL, "rotors": (1e200, 1e200, 0)}, "the energy of the rotors, .*, leaves the range"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "given", "message"), WRONG)
def test_wrong_parameters(make, given, message):
    with pytest.raises(ValueError, match=message):
        make(**given)
