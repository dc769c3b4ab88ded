"""Functions in H that are sums of functions of commuting coordinates: found, split and described."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.program.parts.split import separated_functions

RNG = np.random.default_rng(53)


def full(n):
    M = RNG.standard_normal((n, n))
    return M @ M.T + n * np.eye(n)


FULL3, FULL6 = full(3), full(6)


def on_so3(x):
    return x[0] ** 2 / 2 + np.cos(x[1]) + x[2] ** 4 / 4


def on_e3(x):
    """A full quadratic form, a function of one momentum, one of all positions, which commute, and constants."""
    form = sum(FULL6[i, j] * x[i] * x[j] for i in range(6) for j in range(6)) / 2
    return form + 3 - 0.5 * (np.sin(x[2]) + 1) + np.exp(x[3] * x[4] / 4) * x[5]


def on_so4(x):
    return (x[0] + 2 * x[5]) ** 2 / 2 - (np.cosh(x[0]) - x[1] * x[4]) / 3 + np.sqrt(1 + x[5] ** 2) + x[2] * x[3]


def on_solvable(x):
    return -np.log(1 + x[0] ** 2) + x[3] * (x[3] - 1) / 2 + np.tanh(x[1]) / 2 - (-x[2]) ** 2


def of_time(x, t):
    return x[0] ** 2 / 2 + np.cos(t) * np.sin(x[1]) + x[2] * np.exp(-t) + t**2


CASES = {
    "so(3)": (co.algebras.so(3), on_so3, -1, (0.3, 0.5, 0.8)),
    "e(3)": (co.algebras.se(3), on_e3, -1, (0.1, -0.2, 0.3, 0.4, 0.2, -0.5)),
    "so(4)": (co.algebras.so(4), on_so4, 1, (0.3, -0.4, 0.5, 0.2, 0.1, 0.6)),
    "solvable": (co.algebras.get("A4,9", b=0.5), on_solvable, 1, (0.3, 0.7, -0.2, 0.4)),
    "in time": (co.algebras.so(3), of_time, -1, (0.3, 0.5, 0.8)),
}


def system_of(name):
    algebra, H, sign, x = CASES[name]
    return co.LiePoissonSystem(algebra, H, sign=sign), np.array(x)


@pytest.mark.parametrize("name", CASES)
def test_the_summands_add_up(name):
    system, x = system_of(name)
    (terms,) = separated_functions(system).values()
    brackets = {(i, j) for i, j, _, _ in zip(*system.algebra.triples, strict=True)}
    for t in (0.0, 0.7):
        gradient = np.zeros(system.dim)
        for term in terms:
            if term.called:
                y = x[term.coordinates]
                gradient[term.coordinates] += term.gradient(*((y, t) if term.timed else (y,)))
                assert not brackets & {(i, j) for i in term.coordinates for j in term.coordinates}
            else:
                gradient += term.polynomial.gradient(x)
        assert np.abs(gradient - system.hamiltonian.gradient(x, t)).max() < 2.0**-46


@pytest.mark.parametrize("name", CASES)
def test_splittings_have_their_order_and_keep_the_casimirs(name):
    system, x = system_of(name)
    reference = co.integrate(system, x, (0.0, 1.0), 1 / 64, co.GaussLegendre(6)).x[-1]
    for order in (2, 4):
        ends = [co.integrate(system, x, (0.0, 1.0), h, co.Splitting(order=order)) for h in (1 / 32, 1 / 64)]
        errors = [np.abs(sol.x[-1] - reference).max() for sol in ends]
        # The ratio of a scheme of order p is 2^p (1 + O(h)).
        assert order - 0.5 < np.log2(errors[0] / errors[1]) < order + 0.5, errors
        drift = ends[0].drift()
        assert all(drift[casimir] < 2.0**-40 for casimir in system.casimirs)


def test_given_derivatives_do_not_matter():
    system = co.LiePoissonSystem(
        co.algebras.so(3),
        co.Hamiltonian(on_so3, lambda x: np.array([x[0], -np.sin(x[1]), x[2] ** 3])),
        sign=-1,
    )
    derived, x = system_of("so(3)")
    ends = [co.integrate(s, x, (0, 1), 0.1, co.Splitting(order=4)).x for s in (system, derived)]
    np.testing.assert_array_equal(*ends)


def test_the_same_splitting_as_that_of_the_written_sum():
    system, x = system_of("so(3)")
    written = co.LiePoissonSystem(
        co.algebras.so(3),
        co.Polynomial("x1^2/2 + x3^4/4", dim=3)
        + co.Separable({1: (np.cos, lambda y: -np.sin(y), lambda y: -np.cos(y))}),
        sign=-1,
    )
    ends = [co.integrate(s, x, (0, 10), 0.1, co.Splitting(order=4)).x for s in (system, written)]
    assert np.abs(ends[0] - ends[1]).max() < 2.0**-44


def test_multiples_and_sums():
    algebra = co.algebras.so(4)
    x = np.array(CASES["so(4)"][3])
    H = 2 * co.Hamiltonian(on_so4) + co.Quadratic(np.arange(1.0, 7.0))
    system = co.LiePoissonSystem(algebra, H)
    ends = [
        co.integrate(system, x, (0, 1), 1 / 64, scheme).x[-1] for scheme in (co.Splitting(order=6), co.GaussLegendre(5))
    ]
    assert np.abs(ends[0] - ends[1]).max() < 1e-8
    assert len(separated_functions(system)) == 1


def test_what_was_found_is_described():
    text = str(co.Splitting().describe(system_of("so(3)")[0]))
    assert "a function in H is the sum of a polynomial of x1, x3 and a function of x2\n" in text
    assert co.Splitting().describe(co.systems.rigid_body()).found == ()
    named = co.LiePoissonSystem(
        co.LieAlgebra.from_brackets(3, {(0, 1): {2: 1}}, basis=("q", "p", "z")), lambda x: np.cos(x[0]) + np.sin(x[1])
    )
    assert co.Splitting().describe(named).found == ("the sum of a function of q and a function of p",)


@pytest.mark.parametrize(
    ("H", "why"),
    [
        (lambda x: np.cos(x[0] * x[1]), "a function in it couples x1 and x2, which do not commute; give H"),
        (lambda x: x[2] + np.exp(x[0]) * x[1], "a function in it couples x1 and x2, which do not commute; give H"),
        (lambda x: (x[0] * x[1]) ** 2, r"its monomial x1\^2\*x2\^2 couples x1 and x2, which do not commute; give H"),
        (
            co.Hamiltonian(lambda x: abs(x[0]) + x[1], lambda x: np.array([np.sign(x[0]), 1.0, 0.0])),
            r"a function in it depends on x1 and x2, which do not commute, and cannot be taken apart \(it takes an "
            r"absolute value, which has a kink\); give H",
        ),
    ],
)
def test_other_functions_are_refused_with_the_reason(H, why):
    system = co.LiePoissonSystem(co.algebras.so(3), H)
    for _ in range(2):
        with pytest.raises(ValueError, match=why) as refused:
            co.Splitting().describe(system)
        assert "\n" not in str(refused.value)
    assert isinstance(co.integrate(system, (0.3, 0.2, 0.9), (0, 0.1), 0.05).method, co.GaussLegendre)


def test_a_function_that_is_another_one_when_recorded_is_refused():
    H = co.Hamiltonian(
        lambda x: x[0] ** 2 + x[1] if x.dtype == object else np.sin(x[0] * x[1]),
        lambda x: np.array([x[1], x[0], 0.0]) * np.cos(x[0] * x[1]),
    )
    system = co.LiePoissonSystem(co.algebras.so(3), H)
    with pytest.raises(ValueError, match=r"cannot be taken apart \(it is another function where its operations are"):
        co.Splitting().describe(system)


def test_a_function_of_commuting_coordinates_stays_one_function():
    """High powers of differences are not multiplied out."""
    system = co.LiePoissonSystem(co.algebras.se(3), lambda x: (x[3] - x[4]) ** 12 + np.cos(x[5]) + x[0])
    (terms,) = separated_functions(system).values()
    assert [(term.called, *map(list, term.couplings())) for term in terms] == [
        (False, [0]),
        (True, [3, 4]),
        (True, [5]),
    ]


def test_repeated_doubling_is_counted_once():
    def H(x):
        y = np.cos(x[0])
        for _ in range(60):
            y = y + y
        return y * 2.0**-60 + np.sin(x[1]) + x[2] - x[2]

    (terms,) = separated_functions(co.LiePoissonSystem(co.algebras.so(3), H)).values()
    assert len(terms) == 2
    assert terms[0].gradient(np.array([0.5]))[0] == pytest.approx(-np.sin(0.5), rel=2.0**-50)
