"""The plain reading of programs: group elements in 40 digits, whole numbers, number types."""

import dataclasses
import math
from fractions import Fraction

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint.program.interpreter import Interpreter
from coadjoint.program.numbers import array_of, convert, roundoff
from coadjoint.program.table import build_program
from drawn_matrices import wide

pytestmark = pytest.mark.thinned(3)

DIGITS = 40


SKEWED = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, -1.0, 1.0]])


def driven():
    """Polynomials in the coordinates, explicit in the time; pure arithmetic, so that any number type serves."""
    a = (lambda y, t: y * y * (1 + t * t) / 2, lambda y, t: y * (1 + t * t), lambda y, t: 1 + t * t)
    b = (lambda y: y**4 / 4 + y, lambda y: y**3 + 1, lambda y: 3 * y * y)
    return co.Separable({0: a, 1: b, 2: (lambda y: y * y / 4, lambda y: y / 2, lambda y: 0.5 + 0 * y)})


SYSTEMS = {
    "e(3) diagonal": (co.algebras.e(3), co.Quadratic([1.0, 0.5, 0.25, 0.5, 1.5, 0.75], linear=[0, 0, 0, 0.5, 0, 1.0])),
    "so(4) full": (co.algebras.so(4), co.Quadratic(wide(6, 1))),
    "sl(2) full": (co.algebras.sl(2), co.Quadratic(wide(3, 2), linear=[0.25, 0, -0.5])),
    "A3,7": (co.algebras.get("A3,7", a=1.75), co.Quadratic([1.0, 2.0, 0.25])),
    "Heisenberg": (co.algebras.heisenberg(2), co.Quadratic(wide(5, 3))),
    "so(3) other basis": (co.algebras.change_of_basis(co.algebras.so(3), SKEWED), co.Quadratic(wide(3, 4))),
    "quartic on so(3)": (
        co.algebras.so(3),
        co.Polynomial({(4, 0, 0): 0.25, (0, 3, 0): 0.5, (0, 0, 2): 1.0, (1, 0, 0): 1.0}),
    ),
    "driven sl(2)": (co.algebras.sl(2), driven()),
}


def setup(name, method):
    s = co.LiePoissonSystem(*SYSTEMS[name], sign=-1 if name == "so(4) full" else 1)
    x = np.array([mpmath.mpf(v) for v in np.linspace(-0.5, 0.75, s.dim)])
    return s, Interpreter(build_program(s, method, number=mpmath.mpf)), x


def size(values):
    return max(abs(v) for v in np.ravel(values))


@pytest.mark.thinned(5)
@pytest.mark.parametrize("carried", ["coadjoint", "own"])
@pytest.mark.parametrize("name", ["e(3) diagonal", "so(4) full", "sl(2) full", "A3,7", "driven sl(2)"])
def test_group_element_carries_the_momentum(name, carried):
    """K x constant; with another representation rho(Ad) intertwines: g rho(K^T v) g^-1 = rho(v)."""
    with mpmath.workdps(DIGITS):
        s, _, x = setup(name, co.Splitting())
        h = mpmath.mpf("0.25")

        def run(representation, size_of):
            read = Interpreter(build_program(s, co.Splitting(order=2), group=representation, number=mpmath.mpf))
            unit = np.array([[mpmath.mpf(int(i == j)) for j in range(size_of)] for i in range(size_of)])
            return read.steps(x, h, 3, group=unit)

        y, K = run("coadjoint", s.dim)
        assert size(K @ y - x) <= mpmath.mpf(10) ** -35 * (1 + size(K)) * (1 + size(y))
        if carried == "own":
            rho = s.representation
            _, g = run(rho, rho.shape[1])
            for i in range(s.dim):
                moved = sum(K[i, k] * rho[k] for k in range(s.dim))
                assert size(g @ moved - rho[i] @ g) <= mpmath.mpf(10) ** -35 * (1 + size(K)) * (1 + size(g))


def test_whole_numbers_are_numbers():
    """An integer state is a state, not a request for integer arithmetic."""
    s = co.LiePoissonSystem(*SYSTEMS["e(3) diagonal"])
    read = Interpreter(build_program(s, co.Splitting()))
    given = np.array([1, 0, -1, 2, 1, 0])
    assert np.array_equal(read.steps(given, 0.1, 3), read.steps(given.astype(float), 0.1, 3))
    assert given.tolist() == [1, 0, -1, 2, 1, 0]


def test_no_steps_is_the_identity():
    s = co.LiePoissonSystem(*SYSTEMS["sl(2) full"])
    x = np.array([1.0, 2.0, 3.0])
    assert np.array_equal(Interpreter(build_program(s, co.Splitting())).steps(x, 0.1, 0), x)


def test_a_tangent_needs_second_derivatives():
    s = co.LiePoissonSystem(co.algebras.sl(2), co.Separable({0: (math.cosh, math.sinh), 2: (math.cosh, math.sinh)}))
    read = Interpreter(build_program(s, co.Splitting()))
    with pytest.raises(TypeError, match="hessian"):
        read.steps(np.ones(3), 0.1, 1, tangent=np.eye(3))


def test_number_types_without_elementary_functions_are_refused():
    from fractions import Fraction

    s = co.LiePoissonSystem(*SYSTEMS["e(3) diagonal"])
    with pytest.raises(TypeError, match="the number type Fraction is not supported"):
        Interpreter(build_program(s, co.Splitting(), number=Fraction))


def test_roundoff_is_half_the_gap_above_one():
    assert roundoff(float) == 2.0**-53
    assert roundoff(Fraction) == 0
    with mpmath.workdps(40):
        assert roundoff(mpmath.mpf) == mpmath.mpf(2) ** -mpmath.mp.prec


@dataclasses.dataclass(frozen=True)
class SweepAndAdjoint(co.methods.FlowMethod):
    """A sweep over 0.1 h and its adjoint over 0.9 h, of one moment; in 53 bits the floats 0.1 and 0.9 add up to 1."""

    order, explicit, symmetric = 1, True, False

    def properties(self, system):
        return co.Splitting().properties(system)

    def sweeps(self, number=float):
        return [co.methods.Sweep(k == 0, number(c), number(0.5)) for k, c in enumerate((0.1, 0.9))]


@pytest.mark.parametrize("scheme", [co.Splitting(scheme="suzuki4"), SweepAndAdjoint()], ids=str)
def test_steps_in_more_digits_do_not_use_the_numbers_of_fewer(scheme):
    """Coefficients of 50 digits, and sums of coefficients, against the sweeps one after the other."""
    s, sweep = co.LiePoissonSystem(*SYSTEMS["e(3) diagonal"]), {k: co.Splitting(order=1, adjoint=not k) for k in (0, 1)}

    def step_of(method, h):
        return method.step(s, x, mpmath.mpf(0), h)

    x = np.array([mpmath.mpf(v) for v in np.linspace(-0.5, 0.75, s.dim)], dtype=object)
    step_of(scheme, mpmath.mpf(0.125))
    with mpmath.workdps(40):
        end = step_of(scheme, mpmath.mpf(0.125))
        for each in scheme.sweeps(mpmath.mpf):
            x = step_of(sweep[each.forward], each.coefficient * mpmath.mpf(0.125))
        assert max(abs(end - x)) < 1e-38


@pytest.mark.parametrize("value", [0.1, 3, Fraction(1, 3), np.float64(0.1), np.int64(7)])
def test_values_reach_the_number_type_without_a_detour(value):
    with mpmath.workdps(40):
        exact = Fraction(value.item() if isinstance(value, np.generic) else value)
        got = convert(mpmath.mpf, value)
        assert abs(got - mpmath.mpf(exact.numerator) / exact.denominator) <= abs(got) * roundoff(mpmath.mpf)
        assert convert(mpmath.mpf, "0.1") != mpmath.mpf(0.1)
    assert convert(float, value) == float(exact)


def test_arrays_are_float64_or_objects():
    assert array_of(float, [Fraction(1, 4), 2]).dtype == np.float64
    exact = array_of(Fraction, np.array([0.5, 2.0]))
    assert exact.dtype == object and list(exact) == [Fraction(1, 2), Fraction(2)]
