"""The 62 algebras of dimension 2 to 5: constants, invariants, parameters, and what runs see of them."""

import itertools
import math
import pickle
from fractions import Fraction

import numpy as np
import pytest
from classification import FORMS, rows
from flint import fmpq, fmpq_mat
from lie_algebras import constants_of, known_casimirs

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

pytestmark = pytest.mark.thinned(1)

ROWS = rows()
LABELS = [" ".join([name, *(f"{key}={value}" for key, value in chosen.items())]) for name, chosen in ROWS]
each_row = pytest.mark.parametrize(("name", "parameters"), ROWS, ids=LABELS)


def test_there_are_62():
    names = [f"A{n}_{k}" for n, count in {2: 1, 3: 9, 4: 12, 5: 40}.items() for k in range(1, count + 1)]
    assert list(FORMS) == names and {name for name, _ in ROWS} == set(names)
    assert {name for name in co.algebras.names() if name.startswith("A")} == set(names)


@each_row
def test_the_catalogue_has_the_algebra_of_the_classification(name, parameters):
    """Constants in a second typing, each rounded once."""
    c = FORMS[name](**parameters)
    g = co.algebras.get(name, **parameters)
    assert np.array_equal(constants_of(g), c.astype(float))
    assert g == co.algebras.get(name.replace("_", ","), **parameters)
    double = np.einsum("ijm,mkl->ijkl", c, c)
    assert not np.any(double + double.transpose(2, 0, 1, 3) + double.transpose(1, 2, 0, 3))


@pytest.mark.parametrize("value", [0.1, 1 / 3, 2.0**-40, -0.7071067811865476, np.float64(0.3), np.float32(0.1), 1e-300])
def test_a_float_is_the_rational_number_that_it_is(value):
    """No simpler fraction is put in its place: the constants are those of this very number."""
    c = constants_of(co.algebras.get("A4_9", b=value))
    assert c[2, 3, 2] == float(value) and c[0, 3, 0] == float(1 + Fraction(float(value)))


@each_row
def test_invariants_are_casimirs_and_all_of_them(name, parameters):
    """Polynomials exactly, others to round-off; with the derivatives of their values; independent."""
    c, g = FORMS[name](**parameters), co.algebras.get(name, **parameters)
    known, rng = known_casimirs(g).values(), np.random.default_rng(1)
    for sign in (1, -1):
        x = np.array([Fraction(int(v), 16) for v in rng.integers(8, 25, g.dim)], dtype=object) * sign
        structure_matrix = np.tensordot(c, x, axes=1)
        assert fmpq_mat([[fmpq(v.numerator, v.denominator) for v in row] for row in structure_matrix]).rank() == (
            g.generic_rank()
        )
        floats = x.astype(float)
        slopes = []
        for casimir in known:
            slope = casimir.gradient(floats)
            slopes.append(slope)
            if isinstance(casimir, co.Polynomial):
                assert not np.any(structure_matrix @ casimir.gradient(x))
            bound = 2**8 * U * (1 + np.abs(slope).max()) * (1 + np.abs(structure_matrix).max())
            assert np.abs(g.structure_matrix(floats) @ slope).max() <= g.dim * bound
            h = 2.0**-17  # truncation h^2 f'''/6, with f''' of the order of its size times 100, and round-off u f/h
            found = [(casimir(floats + e) - casimir(floats - e)) / (2 * h) for e in h * np.eye(g.dim)]
            size = 100 * (1 + np.abs(slope).max()) * (1 + abs(casimir(floats)))
            assert np.abs(found - slope).max() <= size * (h**2 + U / h)
        assert len(known) == g.dim - g.generic_rank() == (np.linalg.matrix_rank(slopes) if slopes else 0)


@each_row
def test_representations_are_faithful(name, parameters):
    rho = co.algebras.get(name, **parameters).representation
    if rho is not None:  # its commutators were checked at construction
        assert np.linalg.matrix_rank(rho.reshape(len(rho), -1)) == len(rho)
    centre_and_no_abelian_ideal = {"A4_8", "A4_10", *(f"A5_{k}" for k in (3, 4, 5, 6, 22, 29, 38, 39))}
    degenerate = {("A5_19", 0), ("A5_20", 0), ("A5_25", 0), ("A5_26", 0), ("A5_28", 0), ("A5_30", -1)}
    first = next(iter(parameters.values()), None)
    assert (rho is None) == (name in centre_and_no_abelian_ideal or (name, first) in degenerate)


def test_invariants_in_compiled_loops():
    """Values at a state that stays, and no number where a form is undefined, as in Python."""
    undefined = 0
    for name, parameters in ROWS:
        g = co.algebras.get(name, **parameters)
        own = {key: c for key, c in known_casimirs(g).items() if not isinstance(c, co.Polynomial)}
        if not own:
            continue
        still = co.LiePoissonSystem(co.LieAlgebra([], dim=g.dim), co.Quadratic(np.ones(g.dim)), casimirs=own)
        x = np.random.default_rng(3).uniform(0.5, 1.5, g.dim)
        points = np.array([x, -x, np.zeros(g.dim), *(x * (np.arange(g.dim) != i) for i in range(g.dim))])
        run = co.integrate(still, points, (0.0, 1.0), 1.0, co.Splitting(order=2))
        for key, casimir in own.items():
            expected = casimir(points)
            assert np.isfinite(expected[:2]).all() and math.isnan(expected[2])
            size = 1 + np.nanmax(np.abs(expected))
            np.testing.assert_allclose(run.casimirs[key], [expected] * 2, rtol=0, atol=2**8 * U * size)
            for point, value in zip(points, expected, strict=True):
                assert np.isnan(casimir.gradient(point)).all() == math.isnan(value)
            undefined += np.isnan(expected[3:]).sum()
    assert undefined > 50


def test_runs_unwrap_angles_and_report_what_is_undefined():
    g = co.algebras.get("A4,6", a=2.0, b=0.0)
    key = "log|x1| - a*atan2(x3, x2)"
    system = co.LiePoissonSystem(g, co.Quadratic([0.0, 0.0, 0.0, 1.0], linear=[0.0, 0.0, 0.0, 1.0]))
    x0 = np.array([1.0, 1.0, 0.5, 0.25])  # turns (x2, x3) by 1.25 each unit of time: more than 20 times
    sol = co.integrate(system, x0, (0.0, 128.0), 2.0**-5, co.Splitting(order=2))
    casimir = known_casimirs(g)[key]
    # x1 grows or decays by exp(+-320): its logarithm and the unwrapped angle stay known to u times their size
    assert casimir.period == 4 * math.pi and np.ptp(casimir(sol.x)) > 20 * casimir.period
    turning = sol.casimirs[key]
    assert np.abs(turning - turning[0]).max() <= 4096 * 64 * U * 320
    undefined = co.LiePoissonSystem(co.algebras.get("A3,5", a=0.5), co.Quadratic([1.0, 0.5, 0.25]))
    sol = co.integrate(undefined, [1.0, 0.0, 1.0], (0.0, 1.0), 0.125, co.Splitting(order=2))
    assert np.isnan(sol.casimirs["log|x2| - a*log|x1|"]).all()
    assert math.isnan(sol.drift()["log|x2| - a*log|x1|"]) and np.isfinite(sol.energy).all()


def test_an_angle_jumps_by_its_period():
    casimir = known_casimirs(co.algebras.A3_7(-2.0))["log C"]
    assert abs(casimir([-1.0, 1e-300, 0.0]) - casimir([-1.0, -1e-300, 0.0])) == casimir.period
    again = pickle.loads(pickle.dumps(casimir))
    assert again([2.0, 1.0, 3.0]) == casimir([2.0, 1.0, 3.0]) and again.period == casimir.period


@pytest.mark.parametrize("sine", [-2.0, 0.0, 2.0])
@pytest.mark.parametrize("cosine", [-3.0, 0.0, 3.0])
def test_angles_on_the_axes(sine, cosine):
    """In Python and in compiled loops; both zero, there is no angle."""
    casimir = known_casimirs(co.algebras.A3_7(0.5))["log C"]
    r2 = sine**2 + cosine**2
    wanted = math.log(r2) - math.atan2(sine, cosine) if r2 else math.nan
    point = np.array([cosine, sine, 1.0])
    still = co.LiePoissonSystem(co.LieAlgebra([], dim=3), co.Quadratic(1.0), casimirs={"C": casimir})
    recorded = co.integrate(still, point, (0.0, 1.0), 0.5).casimirs["C"]
    np.testing.assert_allclose([casimir(point), *recorded], wanted, rtol=0, atol=8 * U)


def test_two_angles():
    """A5,17 with p = q = 0 is two oscillators: their phases are comparable only where the ratio is rational."""
    key = "atan2(x4, x3) - s*atan2(x2, x1)"
    phase = known_casimirs(co.algebras.get("A5,17", p=0, q=0, s=2 / 3))[key]
    assert phase.period == pytest.approx(2 * math.pi / 3, rel=4 * U)
    for a, b in itertools.product((-1e-9, 1e-9), repeat=2):  # both angles at their branch: multiples of the period
        jump = (phase([-1.0, a, -1.0, b, 0.0]) - phase([-1.0, 1e-9, -1.0, 1e-9, 0.0])) / phase.period
        assert abs(jump - round(jump)) < 1e-8
    # A common period has a denominator of at most 1000.
    for s, known in ((math.sqrt(2), False), (Fraction(1, 1000), True), (Fraction(1, 1001), False)):
        assert (key in known_casimirs(co.algebras.get("A5,17", p=0, q=0, s=s))) is known


def test_known_names_coincide():
    assert co.algebras.get("A3,8") == co.algebras.sl(2)
    assert co.algebras.get("A3,9") == co.algebras.so(3) == co.algebras.su(2)
    assert np.array_equal(co.algebras.get("A3,9").representation, co.algebras.so(3).representation)
    assert co.algebras.get("A3,7", a=0) == co.algebras.get("A3,6")
    assert co.algebras.get("A3,7", a=np.float32(0.5)) == co.algebras.A3_7(Fraction(1, 2))
    assert co.algebras.low_dimensional("A4_9", b=0.5) == co.algebras.get("A4_9", b=0.5)


OUTSIDE = {
    "A3_5": [{"a": 0}, {"a": 1}, {"a": -1}],
    "A4_2": [{"a": 0}],
    "A4_5": [{"a": 0, "b": 1}, {"a": 1, "b": 0}, {"a": 2, "b": 1}, {"a": 1, "b": -2}],
    "A4_6": [{"a": 0, "b": 1}, {"a": 1, "b": -1e-300}],
    "A4_9": [{"b": -1}, {"b": 2}],
    "A4_11": [{"a": 0}],
    "A5_7": [{"a": 1, "b": 1, "c": 0}],
    "A5_8": [{"c": 0}, {"c": 2}],
    "A5_9": [{"b": 1, "c": 0}, {"b": 1, "c": 2}],
    "A5_13": [{"a": 1, "p": 0, "s": 0}, {"a": -2, "p": 0, "s": 1}],
    "A5_15": [{"a": 1.5}],
    "A5_18": [{"p": -1}],
    "A5_24": [{"eps": 0}, {"eps": 2}],
    "A5_33": [{"a": 0, "b": 0}],
}


@pytest.mark.parametrize("name", OUTSIDE)
def test_parameters_outside_of_the_range_are_refused(name):
    for parameters in OUTSIDE[name]:
        with refused(ValueError, name, "needs", next(iter(parameters))):
            co.algebras.get(name.replace("_", ","), **parameters)


@pytest.mark.parametrize("value", [1, 2.0, 0.5, Fraction(1, 3), -2 / 7, 0.1, 1e-7, 123456.789, 1.0 + 2.0**-40, -1e300])
def test_names_have_the_numbers_that_make_the_algebra(value):
    for name, parameters in (("A3_7", ("a",)), ("A5_33", ("a", "b")), ("A4_2", ("a",))):
        given = dict(zip(parameters, (value, -3), strict=False))
        g = co.algebras.get(name, **given)
        head, _, numbers = g.name.rstrip(")").partition("(")
        read = {key: float(text) for key, _, text in (part.partition("=") for part in numbers.split(", "))}
        assert head == name and list(read) == list(parameters) and co.algebras.get(head, **read) == g
