"""The catalogue: families of matrix algebras, the 62 algebras of dimension 2 to 5, names, parameters, invariants."""

import gc
import itertools
import math
import pickle
import weakref
from fractions import Fraction

import numpy as np
import pytest
from classification import FORMS, rows
from flint import fmpq, fmpq_mat
from lie_algebras import INDEFINITE, constants_of, known_casimirs

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

pytestmark = pytest.mark.thinned(1)

get = co.algebras.get

# name, dimension, number of Casimirs, semisimple
FAMILIES = [
    *((f"gl({n})", n * n, n, False) for n in (1, 2, 3)),
    *((f"sl({n})", n * n - 1, n - 1, True) for n in (2, 3, 4)),
    *((f"so({n})", n * (n - 1) // 2, n // 2, n > 2) for n in (2, 3, 4, 5, 6, 7)),
    *((f"so({p},{q})", (p + q) * (p + q - 1) // 2, (p + q) // 2, True) for p, q in INDEFINITE),
    *((f"su({n})", n * n - 1, n - 1, True) for n in (2, 3, 4)),
    *((f"u({n})", n * n, n, False) for n in (1, 2, 3)),
    *((f"sp({2 * n})", n * (2 * n + 1), n, True) for n in (1, 2, 3)),
    *((f"e({n})", n * (n + 1) // 2, (n + 1) // 2, False) for n in (2, 3, 4, 5)),
    *((f"heisenberg({n})", 2 * n + 1, 1, False) for n in (1, 2, 3)),
]


@pytest.mark.parametrize(("name", "dim", "casimirs", "semisimple"), FAMILIES, ids=str)
def test_families(name, dim, casimirs, semisimple):
    g = get(name)
    assert g.dim == dim and dim - g.generic_rank() == casimirs
    c = constants_of(g)
    assert (np.linalg.matrix_rank(np.einsum("iab,jba->ij", c, c)) == dim) == semisimple


def test_matrices_are_those_that_the_names_say():
    rng = np.random.default_rng(5)

    def element(name):
        g = get(name)
        return np.tensordot(rng.integers(-5, 6, g.dim).astype(float), g.representation, axes=1)

    signs, x = np.diag([1.0, 1.0, 1.0, -1.0]), element("so(3,1)")
    assert np.array_equal(x.T @ signs, -signs @ x)
    turn, x = np.kron([[0.0, 1.0], [-1.0, 0.0]], np.eye(3)), element("sp(6)")
    assert np.array_equal(x.T @ turn, -turn @ x)
    for name in ("su(3)", "u(3)"):
        x = element(name)
        assert np.array_equal(x.T, -x)  # anti-Hermitian
        assert np.array_equal(x @ turn, turn @ x)  # complex linear
    assert np.trace(element("su(3)")[:3, 3:]) == 0.0  # trace of the imaginary part
    assert np.trace(element("sl(4)")) == 0.0 and not element("e(3)")[3].any()


def test_conventions():
    pauli = np.array([[[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]]])
    spin = -0.5j * pauli
    assert np.array_equal(get("su(2)").representation, np.block([[spin.real, -spin.imag], [spin.imag, spin.real]]))
    assert get("su(2)") == get("so(3)") and get("se(4)") == get("e(4)")
    assert get("sl(2)").basis == ("e1", "e2", "e3")
    assert get("sl(2)").representation[1].tolist() == [[0.5, 0.0], [0.0, -0.5]]
    assert np.array_equal(get("gl(3)").representation.reshape(9, 9), np.eye(9))
    rotation, translation = get("e(4)").representation[0], get("e(4)").representation[6:]
    assert rotation[0, 1] == 1.0 and rotation[1, 0] == -1.0
    assert np.array_equal(translation[:, :4, 4], np.eye(4))
    x = np.array([1.0, 2.0, -3.0, 5.0, 0.5, 4.0])
    matrix = np.tensordot(x, get("so(4)").representation, 1)
    assert abs(known_casimirs(get("so(4)"))["Pfaffian"](x) ** 2 - np.linalg.det(matrix)) < 1e-9


def test_large_algebras_leave_out_what_is_large():
    """An algebra has matrices of at most 2^24 numbers, and known Casimirs of at most 2^22 exponents."""
    so60 = get("so(60)")
    assert so60.representation.shape == (1770, 60, 60)
    assert list(known_casimirs(so60)) == ["|x|^2"] and len(known_casimirs(so60)["|x|^2"].monomials) == 1770
    assert get("heisenberg(10000)").representation is None
    # Copies of so(3): n of them have 3 n x (3 n)^2 numbers, and |x|^2 of each 3 x 3 n exponents.
    for count, known in ((682, True), (683, False)):
        assert bool(known_casimirs(co.algebras.copies(get("so(3)"), count))) is known
    for count, known in ((85, True), (86, False)):
        assert (co.algebras.copies(get("so(3)"), count).representation is not None) is known


def test_names_and_get():
    algebras = co.algebras
    same = {
        "so(3)": algebras.so(3), "so(7)": get("so(n)", n=7), "e(3)": algebras.e(3), "sl(2)": algebras.sl(2),
        "heisenberg": algebras.heisenberg(1), "heisenberg(2)": get("heisenberg", n=2), "sp(4)": get("sp(2n)", n=2),
        "so(3, 1)": get("so(p,q)", p=3, q=1), "so(3,1)": algebras.so(3, 1), "su(3)": algebras.su(3),
    }  # fmt: skip
    for name, g in same.items():
        assert get(name) == g
    assert get("A3,7", a=0.5) == get("A3_7", a=0.5) == algebras.A3_7(0.5) and algebras.A3_7(0.5).name == "A3_7(a=0.5)"
    for family, dim in {"e": 6, "gl": 9, "heisenberg": 7, "se": 6, "sl": 8, "so": 3, "su": 8, "u": 9}.items():
        assert get(f"{family}(3)") == get(f"{family}(n)", n=3) and get(f"{family}(3)").dim == dim
        assert f"{family}(n)" in algebras.names()
    assert {"so(p,q)", "sp(2n)"} < set(algebras.names()) and list(algebras.names()) == sorted(algebras.names())
    assert set(algebras.__all__) <= set(dir(algebras))
    assert get("A3,8") == algebras.sl(2) and get("A3,9") == algebras.so(3) == algebras.su(2)
    assert np.array_equal(get("A3,9").representation, algebras.so(3).representation)
    assert get("A3,7", a=0) == get("A3,6") and get("A3,7", a=np.float32(0.5)) == algebras.A3_7(Fraction(1, 2))
    assert algebras.low_dimensional("A4_9", b=0.5) == get("A4_9", b=0.5)


@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_signs_that_are_all_alike_are_those_of_rotations(n):
    so = co.algebras.so
    for g in (so(0, n), so(n, 0), get(f"so(0,{n})"), get("so(p,q)", p=n, q=0)):
        assert g == so(n) and g.name == f"so({n})" and known_casimirs(g) == known_casimirs(so(n))
        assert np.array_equal(g.representation, so(n).representation)


def test_equal_arguments_give_one_algebra_as_long_as_it_is_in_use():
    for build, arguments in (
        (co.algebras.so, (11,)),
        (co.algebras.so, (5, 2)),
        (co.algebras.heisenberg, (17,)),
        (co.algebras.A3_7, (0.609375,)),
    ):
        g = build(*arguments)
        assert build(*arguments) is g
        used = weakref.ref(g)
        del g
        gc.collect()
        assert used() is None
    assert co.algebras.so(4) is not co.algebras.so(3, 1)
    assert co.algebras.A3_7(0.5) != co.algebras.A3_7(0.25)
    three = co.algebras.so(3)  # while it is in use, what is equal to 3 is still refused
    with refused(ValueError, "whole number", "3.0"):
        co.algebras.so(3.0)
    assert three == co.algebras.get("so(3)")


def test_invariants():
    ratio = co.Invariant(lambda x: x[1] / x[0], period=2)
    assert (ratio.gradient, ratio.period) == (None, 2.0)
    states = np.random.default_rng(0).uniform(1, 2, (2, 3, 2))
    for some in (states, states[0], states[:, 0], states[:, :1], states[:0], states[..., ::-1]):
        assert ratio(some).tolist() == (some[..., 1] / some[..., 0]).tolist()
    assert ratio(states[0].tolist()).tolist() == ratio(states[0]).tolist() and ratio([2, 1]) == 0.5
    assert repr(ratio).endswith(", period=2)") and "period" not in repr(co.Invariant(abs))
    with pytest.raises(AttributeError):
        ratio.period = 1.0
    for arguments, error, named in (
        ((3,), TypeError, "value"),
        ((abs, 3), TypeError, "gradient"),
        ((abs, None, -1.0), ValueError, "-1.0"),
        ((abs, None, float("nan")), ValueError, "nan"),
        ((abs, None, "x"), TypeError, "'x'"),
    ):
        with refused(error, named):
            co.Invariant(*arguments)


def test_moments():
    """Degrees up to 100, even ones; the determinant up to degree 10, and names with a comma from degree 10."""
    moments = co.systems.vlasov_moments
    for degree, known in ((4, True), (10, True), (12, False)):
        algebra = moments(degree).algebra
        assert ("catalecticant" in known_casimirs(algebra)) is known
        assert any("," in name for name in algebra.basis) is (degree >= 10)
    for degree, named in ((5, "even"), (101, "100"), (102, "100"), (0, "0")):
        with refused(ValueError, "degree", named):
            moments(degree)


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


@pytest.mark.parametrize("value", [1, 2.0, 0.5, Fraction(1, 3), -2 / 7, 0.1, 1e-7, 123456.789, 1.0 + 2.0**-40, -1e300])
def test_names_have_the_numbers_that_make_the_algebra(value):
    for name, parameters in (("A3_7", ("a",)), ("A5_33", ("a", "b")), ("A4_2", ("a",))):
        given = dict(zip(parameters, (value, -3), strict=False))
        g = co.algebras.get(name, **given)
        head, _, numbers = g.name.rstrip(")").partition("(")
        read = {key: float(text) for key, _, text in (part.partition("=") for part in numbers.split(", "))}
        assert head == name and list(read) == list(parameters) and co.algebras.get(head, **read) == g
