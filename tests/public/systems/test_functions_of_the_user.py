"""Functions and Hamiltonians of the user: which wrong derivatives are found, wherever they are."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

FunctionTerm = co.systems.FunctionTerm

W = np.array([0.7, -1.3, 0.4, 2.1, -0.6])


def value(x):
    return np.sum(W * np.cos(x)) + x[0] * x[3] ** 2


def gradient(x):
    return -W * np.sin(x) + np.array([x[3] ** 2, 0 * x[0], 0 * x[0], 2 * x[0] * x[3], 0 * x[0]])


def hessian(x):
    found = np.diag(-W * np.cos(x))
    found[0, 3] += 2 * x[3]
    found[3, 0] += 2 * x[3]
    found[3, 3] += 2 * x[0]
    return found


def spoiled(function, place, by):
    """The function with one of its numbers changed: added to, or with the other sign."""

    def wrong(x):
        found = np.array(function(x))
        found[place] = found[place] + by if by else -found[place]
        return found

    return wrong


@pytest.mark.parametrize("by", [0.0, 1e-6, -1e-6])
@pytest.mark.parametrize("k", range(5))
def test_a_wrong_number_in_a_derivative_is_found_wherever_it_is(k, by):
    co.Hamiltonian(value, gradient, hessian).bind(5)
    with refused(ValueError, "gradient", "value"):
        co.Hamiltonian(value, spoiled(gradient, k, by), hessian).bind(5)
    for j in range(5):
        if by or (j, k) in {(j, j), (0, 3), (3, 0)}:
            with refused(ValueError, "hessian", "gradient"):
                co.Hamiltonian(value, gradient, spoiled(hessian, (j, k), by)).bind(5)


def skew(x):
    return np.array([[0 * x[0], x[2], -x[1]], [-x[2], 0 * x[0], x[0] * x[1]], [x[1], -x[0] * x[1], 0 * x[0]]])


def skew_slope(x):
    d = np.zeros((3, 3, 3))
    d[0, 1, 2], d[0, 2, 1], d[1, 2, 0], d[1, 2, 1] = 1.0, -1.0, x[1], x[0]
    return d - d.transpose(1, 0, 2)


@pytest.mark.parametrize("place", list(np.ndindex(3, 3, 3)), ids=str)
def test_a_wrong_derivative_of_a_bracket_is_found_wherever_it_is(place):
    H = co.Quadratic([1.0, 2.0, 3.0])
    co.PoissonSystem(skew, H, derivative=skew_slope, jacobi=False)
    with refused(ValueError, "derivative", "structure_matrix"):
        co.PoissonSystem(skew, H, derivative=spoiled(skew_slope, place, 1e-6))
    if place[2] == 0:
        i, j, _ = place
        with refused(ValueError, "structure_matrix", "skew"):
            co.PoissonSystem(spoiled(skew, (i, j), 1e-9), H)


class Own:
    """H = x1 x2^2 + cosh(x3) as a class: every part of it may be replaced."""

    timed = False

    def __init__(self, n=None, **changed):
        self.dim, self.changed = n, changed

    def bind(self, n):
        return Own(self.changed.get("dim", n), **self.changed)

    def value(self, x, t=0.0):
        return x[0] * x[1] ** 2 + np.cosh(x[2])

    def gradient(self, x, t=0.0):
        found = np.array([x[1] ** 2, 2 * x[0] * x[1], np.sinh(x[2])])
        return self.changed.get("gradient", lambda found: found)(found)

    def hessian(self, x, t=0.0):
        o = 0 * x[0]
        found = np.array([[o, 2 * x[1], o], [2 * x[1], 2 * x[0], o], [o, o, np.cosh(x[2])]])
        return self.changed.get("hessian", lambda found: found)(found)

    def terms(self):
        def form(y):
            return y[1] * y[0] ** 2

        def slope(y):
            return np.array([2 * y[0] * y[1], y[0] ** 2])

        # The first two coordinates in the other order, and the third as a number.
        both = FunctionTerm(np.array([1, 0]), form, slope, None)
        third = FunctionTerm(np.array([2]), np.cosh, np.sinh, np.cosh, scalar=True)
        return self.changed.get("terms", lambda *terms: terms)(both, third)


def with_entry(place, by):
    def change(found):
        found[place] += by
        return found

    return change


def test_a_class_whose_parts_agree_is_taken():
    x = np.array([0.5, -0.7, 1.1])
    system = co.LiePoissonSystem(co.algebras.so(3), Own())
    H = system.hamiltonian
    np.testing.assert_allclose(system.vector_field(x), np.cross(H.gradient(x), x), rtol=0, atol=2.0**-50)


LINE = co.Quadratic(0.0, linear=[0.0, 1e-9, 0.0]).terms()


@pytest.mark.parametrize(
    ("changed", "error", "named"),
    [
        ({"dim": 4}, ValueError, ("bind(3)", "Own", "dimension 4")),
        ({"terms": lambda *terms: (*terms, 3.0)}, TypeError, ("Own.terms()", "3.0")),
        ({"gradient": with_entry(0, 1e-6)}, ValueError, ("Own.gradient", "Own.value")),
        ({"gradient": with_entry(2, -1e-6)}, ValueError, ("Own.gradient", "Own.value")),
        ({"hessian": with_entry((1, 2), 1e-6)}, ValueError, ("Own.hessian", "Own.gradient")),
        ({"terms": lambda *terms: terms[:1]}, ValueError, ("Own.terms()", "Own.gradient", "component 2")),
        ({"terms": lambda *terms: (*terms, terms[1])}, ValueError, ("component 2",)),
        ({"terms": lambda *terms: (*terms, *LINE)}, ValueError, ("component 1",)),
    ],
)
def test_a_class_whose_parts_contradict_each_other_is_refused(changed, error, named):
    with refused(error, *named):
        co.LiePoissonSystem(co.algebras.so(3), Own(**changed))


F = co.forces
BODY = co.systems.rigid_body((1.0, 2.0, 3.0))
UP = np.array([0.0, 0.0, 0.3])


def named(arguments, value="UP"):
    """Return a function with arguments of these names."""
    return eval(f"lambda {arguments}: {value}", {"np": np, "UP": UP})


@pytest.mark.parametrize("name", ["t", "time"])
def test_the_argument_of_a_torque_is_the_time_by_its_name(name):
    """The impulse of 0.3 t^2 over a time of 2, where a state would give another one."""
    system = BODY.with_forces(F.Torque(named(name, f"np.array([0.0, 0.0, 0.9 * {name} * {name}])")))
    x, method = np.array([0.0, 0.0, 1.0]), co.methods.Forced(co.Splitting())
    assert method.step(system, x, 0.0, 2.0)[2] == pytest.approx(1.0 + 0.3 * 8.0, abs=1e-14)
    assert system.vector_field(x, 2.0)[2] == pytest.approx(3.6, abs=1e-14)


@pytest.mark.parametrize("name", ["x", "y", "state", "momentum", "L"])
def test_the_argument_of_a_torque_is_the_state_by_its_name(name):
    system = BODY.with_forces(F.Torque(named(name, f"0.5 * {name}")))
    np.testing.assert_array_equal(system.vector_field([0.0, 0.0, 2.0], 7.0), [0.0, 0.0, 1.0])


@pytest.mark.parametrize("name", ["tau", "T", "s", "_", "u", "value"])
def test_an_argument_of_a_torque_that_may_be_either_is_refused_with_both_spellings(name):
    with refused(TypeError, "torque", f"({name})", "t if it is the time", "x if it is the state"):
        F.Torque(named(name))
    assert BODY.with_forces(F.Torque(named(f"t, {name}=1.0"))).vector_field([0.0, 0.0, 2.0])[2] == 0.3


def path(t):
    return np.array([1.0 + 0.1 * t, 0.0, 0.3 * t])


def test_values_of_functions_are_checked_as_constants_are():
    turning = "np.array([[np.cos(t), -np.sin(t), 0], [np.sin(t), np.cos(t), 0], [0, 0, 1.0]])"
    assert callable(F.Pointing(1.0, 1.0, attitude=named("t", turning)).attitude)
    mirrored = turning.replace("-np.sin(t)", "np.sin(t)")
    for wrong in ("1.1 * np.eye(3)", "np.diag([1.0, 1.0, -1.0])", mirrored):
        with refused(ValueError, "attitude", "no rotation", "0.625"):
            F.Pointing(1.0, 1.0, attitude=named("t", wrong))
    with refused(ValueError, "attitude", "(3, 3)"):
        F.Pointing(1.0, 1.0, attitude=named("t", "np.array([0.0, 0.0, 0.0, 1.0])"))
    with refused(ValueError, "position", "zero"):
        F.GravityGradient(1.0, named("t", "np.zeros(3)"))
    # Names that are not known stand at their places, and the values tell.
    with refused(ValueError, "B of MagneticDipole", "0.625", "subscript"):
        F.MagneticDipole((1, 0, 0), named("a, b", "np.array([a[0], b, 0.0])"), path)
    with refused(ValueError, "B of MagneticDipole", "(3,)"):
        F.MagneticDipole((1, 0, 0), named("t, r", "r[:2]"), path)
    sat = co.systems.body((1.0, 2.0, 2.5))
    magnet = sat.with_forces(F.MagneticDipole((1, 0, 0), named("a, b", "np.array([b[0], a, b[2]])"), path))
    # At t = 2 the field is (1.2, 2, 0.6): the torque is (1, 0, 0) x B.
    np.testing.assert_allclose(magnet.vector_field(sat.state(), 2.0)[:3], (0.0, -0.6, 2.0), rtol=0, atol=1e-15)
