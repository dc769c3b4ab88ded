"""Families of matrix algebras and names of the catalogue: dimensions, ranks, matrices, Killing forms, refusals."""

from fractions import Fraction

import numpy as np
import pytest
from lie_algebras import INDEFINITE, constants_of, known_casimirs

import coadjoint as co
from refusals import refused

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


@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_signs_that_are_all_alike_are_those_of_rotations(n):
    so = co.algebras.so
    for g in (so(0, n), so(n, 0), get(f"so(0,{n})"), get("so(p,q)", p=n, q=0)):
        assert g == so(n) and g.name == f"so({n})" and known_casimirs(g) == known_casimirs(so(n))
        assert np.array_equal(g.representation, so(n).representation)


@pytest.mark.parametrize(
    ("name", "parameters", "error", "named"),
    [
        ("so4", {}, ValueError, ["'so4'", "'so(4)'"]),
        ("nonsense", {}, ValueError, ["'nonsense'"]),
        ("so(n)", {}, ValueError, ["'n'"]),
        ("A3_7", {}, ValueError, ["'a'"]),
        ("A3_7", {"a": 1.0, "b": 2.0}, ValueError, ["'b'", "takes: a"]),
        ("A3_7", {"a": "x"}, TypeError, ["'x'"]),
        ("A3_7", {"a": float("nan")}, ValueError, ["nan"]),
        ("so(4)", {"n": 4}, ValueError, ["'n'"]),
        ("sp(3)", {}, ValueError, ["even", "3"]),
        ("so(0,1)", {}, ValueError, ["p of so(p, q)", "0"]),
        ("so(p,q)", {"p": 3}, ValueError, ["'q'"]),
        ("su(2,1)", {}, ValueError, ["'su(2,1)'"]),
        ("A5-23", {"b": 1}, ValueError, ["'A5-23'"]),
        ("A5,41", {}, ValueError, ["'A5,41'"]),
        ("so(0)", {}, ValueError, ["0"]),
        (3, {}, TypeError, ["string"]),
    ],
)
def test_wrong_names_and_parameters_are_refused(name, parameters, error, named):
    with refused(error, *named):
        get(name, **parameters)


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


def test_numbers_of_casimirs_are_exact():
    x = np.array([Fraction(k, 7) for k in range(1, 7)])
    assert known_casimirs(co.algebras.e(3))["m.p"](x) == x[:3] @ x[3:]


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
