"""The 62 algebras of dimension 2 to 5: every constant and every invariant, exactly; ranges; what runs see of them."""

import itertools
import math
import pickle
from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.exact.elimination import Span
from coadjoint.algebra.families.low_dimensional import (
    entries,
    exact_constants,
    formulas,
    parameters_of,
    read_parameters,
)
from coadjoint.algebra.polynomials.polynomial import Polynomial

U = 2.0**-53  # unit round-off

# parameters inside the ranges: rational ones, and those where terms of the invariants vanish
CHOSEN = {
    "A3_5": [{"a": Fraction(1, 3)}, {"a": Fraction(-1, 2)}],
    "A3_7": [{"a": 2}, {"a": Fraction(-1, 3)}, {"a": 0}],
    "A4_2": [{"a": 3}, {"a": Fraction(-2, 5)}, {"a": 1}],
    "A4_5": [{"a": Fraction(1, 2), "b": Fraction(-1, 3)}, {"a": -1, "b": 1}, {"a": 1, "b": 1}],
    "A4_6": [{"a": 2, "b": Fraction(1, 2)}, {"a": Fraction(-1, 3), "b": 0}],
    "A4_9": [{"b": Fraction(1, 2)}, {"b": 1}, {"b": 0}, {"b": Fraction(-2, 3)}],
    "A4_11": [{"a": 2}, {"a": Fraction(1, 7)}],
    "A5_7": [{"a": Fraction(1, 2), "b": Fraction(-1, 3), "c": Fraction(1, 5)}, {"a": -1, "b": 1, "c": -1}],
    "A5_8": [{"c": Fraction(1, 2)}, {"c": -1}],
    "A5_9": [{"b": Fraction(1, 2), "c": -2}, {"b": 1, "c": 1}],
    "A5_11": [{"c": Fraction(1, 2)}, {"c": 1}],
    "A5_13": [{"a": Fraction(1, 2), "p": Fraction(1, 3), "s": 2}, {"a": -1, "p": 0, "s": Fraction(-1, 3)}],
    "A5_14": [{"p": Fraction(1, 3)}, {"p": 0}],
    "A5_15": [{"a": Fraction(1, 2)}, {"a": 0}, {"a": 1}],
    "A5_16": [{"p": Fraction(1, 3), "s": 2}, {"p": 0, "s": -1}],
    "A5_17": [
        {"p": Fraction(1, 3), "q": Fraction(-1, 2), "s": 2},
        {"p": Fraction(1, 3), "q": 0, "s": Fraction(-3, 7)},
        {"p": 0, "q": Fraction(1, 5), "s": 1},
        {"p": 0, "q": 0, "s": Fraction(2, 3)},
    ],
    "A5_18": [{"p": Fraction(1, 3)}, {"p": 0}],
    "A5_19": [{"a": 3, "b": Fraction(1, 2)}, {"a": 0, "b": 1}, {"a": 1, "b": -2}],
    "A5_20": [{"a": 3}, {"a": 0}, {"a": 1}],
    "A5_23": [{"b": Fraction(1, 2)}, {"b": 2}],
    "A5_24": [{"eps": 1}, {"eps": -1}],
    "A5_25": [{"p": Fraction(1, 3), "b": Fraction(1, 2)}, {"p": 0, "b": 1}],
    "A5_26": [{"p": Fraction(1, 3), "eps": 1}, {"p": 0, "eps": -1}],
    "A5_28": [{"a": 3}, {"a": 0}, {"a": 1}],
    "A5_30": [{"a": 3}, {"a": 0}, {"a": -1}, {"a": 1}],
    "A5_32": [{"a": 3}, {"a": 0}],
    "A5_33": [{"a": Fraction(1, 2), "b": 3}, {"a": 0, "b": -1}, {"a": 1, "b": 0}],
    "A5_34": [{"a": Fraction(1, 2)}, {"a": 0}],
    "A5_35": [{"a": Fraction(1, 2), "b": 3}, {"a": 0, "b": -1}, {"a": 1, "b": 0}],
}
CASES = [(name, chosen) for name in entries() for chosen in CHOSEN.get(name, [{}])]


def label(value):
    return value if isinstance(value, str) else ",".join(f"{key}={v}" for key, v in value.items())


def everything(name, chosen):
    """Return n, the exact constants as an (n, n, n) array of Fractions, and the formulas."""
    exact = read_parameters(name, chosen)
    n = entries()[name]["dim"]
    c = np.full((n, n, n), Fraction(0), dtype=object)
    for (i, j), bracket in exact_constants(name, exact).items():
        for exponents, value in bracket.monomials.items():
            c[i, j, exponents.index(1)], c[j, i, exponents.index(1)] = value, -value
    return n, c, formulas(name, exact)


def rational_point(rng, n):
    pairs = zip(rng.integers(1, 60, n).tolist(), rng.integers(1, 9, n).tolist(), strict=True)
    return np.array([Fraction(a, b) for a, b in pairs], dtype=object) * (rng.integers(0, 2, n) * 2 - 1)


def rank(rows):
    kept = []
    for row in rows:
        vector = {i: value for i, value in enumerate(row) if value}
        try:
            Span([*kept, vector])
        except ValueError:
            continue
        kept.append(vector)
    return len(kept)


def test_there_are_62():
    dims = [entry["dim"] for entry in entries().values()]
    assert [dims.count(n) for n in (2, 3, 4, 5)] == [1, 9, 12, 40]
    numbered = {2: 1, 3: 9, 4: 12, 5: 40}
    assert list(entries()) == [f"A{n}_{k}" for n, count in numbered.items() for k in range(1, count + 1)]
    assert {name for name in entries() if parameters_of(name)} == set(CHOSEN)


@pytest.mark.thinned(6)
@pytest.mark.parametrize(("name", "chosen"), CASES, ids=label)
def test_constants_are_those_of_a_lie_algebra_exactly(name, chosen):
    n, c, _ = everything(name, chosen)
    double = np.tensordot(c, c, axes=(2, 0))  # c_ij^m c_mk^l
    cyclic = double + double.transpose(2, 0, 1, 3) + double.transpose(1, 2, 0, 3)
    assert np.all(cyclic == 0)
    g = co.algebras.get(name, **chosen)
    assert g == co.algebras.get(name.replace("_", ","), **chosen)
    dense = np.zeros((n, n, n))
    i, j, k, value = g.triples
    dense[i, j, k], dense[j, i, k] = value, -value
    assert np.array_equal(dense, c.astype(float))  # each constant is the nearest float


@pytest.mark.parametrize(("name", "chosen"), CASES, ids=label)
def test_invariants_are_casimirs_exactly_and_all_of_them(name, chosen):
    n, c, found = everything(name, chosen)
    rng = np.random.default_rng(1)
    ranks, gradients = [], []
    for _ in range(3):
        x = rational_point(rng, n)
        structure = np.tensordot(c, x, axes=1)
        slopes = [formula.gradient(x) for formula in found.values()]
        for slope in slopes:
            assert all(structure @ slope == 0)
        ranks.append(rank(structure))
        gradients.append(rank(slopes))
    assert len(found) == max(gradients) == n - max(ranks)
    g = co.algebras.get(name, **chosen)
    assert list(g.casimirs_known) == list(found)


@pytest.mark.thinned(3)
@pytest.mark.parametrize(("name", "chosen"), CASES, ids=label)
def test_values_stay_along_the_group_and_agree_with_the_gradients(name, chosen):
    from scipy.linalg import expm

    g = co.algebras.get(name, **chosen)
    rng = np.random.default_rng(2)
    for sign in (1.0, -1.0):
        x = sign * rng.uniform(0.5, 1.5, g.dim)
        u = rng.uniform(-0.3, 0.3, g.dim)
        # orders of expm and of the product: error below 2^6 u of |exp| |x|, in every step
        moved = [expm(s * g.coadjoint(u)) @ x for s in np.linspace(0.0, 4.0, 9)]
        for casimir in g.casimirs_known.values():
            values = np.array([float(casimir(y)) for y in moved])
            period = getattr(casimir, "period", 0.0)
            change = np.diff(values)
            if period:
                change -= period * np.round(change / period)
            slopes = [np.abs(casimir.gradient(y)).max() for y in moved]
            sizes = [np.abs(expm(s * g.coadjoint(u))).sum() * np.abs(x).max() for s in np.linspace(0.0, 4.0, 9)]
            bound = 2**6 * U * max(a * b for a, b in zip(slopes, sizes, strict=True)) + 2**6 * U * np.abs(values).max()
            assert np.abs(np.cumsum(change)).max() <= g.dim * bound
            if not isinstance(casimir, Polynomial):
                exact = casimir.formula.gradient(np.array([Fraction(v) for v in x])).astype(float)
                assert np.abs(casimir.gradient(x) - exact).max() <= 2**8 * U * (1 + np.abs(exact).max())
                h = 2.0**-17  # truncation h^2 f'''/6, with f''' of the order of its size times 100, and round-off u f/h
                step = h * np.eye(g.dim)
                slope = [(casimir(x + e) - casimir(x - e)) / (2 * h) for e in step]
                size = 100 * (1 + np.abs(exact).max()) * (1 + abs(casimir(x)))
                assert np.abs(slope - exact).max() <= size * (h**2 + U / h)


@pytest.mark.long
def test_invariants_compile_and_are_nan_where_undefined():
    """One of every shape: what Numba sees differs only in the numbers."""
    from numba import njit

    from coadjoint.kernels.functions.compiled_functions import CompiledFunction

    seen, undefined = set(), 0
    for name, chosen in CASES:
        g = co.algebras.get(name, **chosen)
        for key, casimir in g.casimirs_known.items():
            if isinstance(casimir, Polynomial):
                continue
            nowhere = np.zeros(g.dim)
            assert math.isnan(casimir(nowhere)) and np.isnan(casimir.gradient(nowhere)).all()
            x = np.random.default_rng(3).uniform(0.5, 1.5, g.dim)
            for i in range(g.dim):
                point = x * (np.arange(g.dim) != i)
                # a form vanishes exactly where the exact gradient divides by zero
                try:
                    casimir.formula.gradient(np.array([Fraction(v) for v in point]))
                    assert math.isfinite(casimir(point))
                except ZeroDivisionError:
                    undefined += 1
                    assert math.isnan(casimir(point)) and np.isnan(casimir.gradient(point)).all()
            shape = tuple(term.kind for term in casimir.formula.terms)
            if shape in seen:
                continue
            seen.add(shape)
            value, gradient = njit(casimir.value), njit(casimir.gradient)
            CompiledFunction(value, g.dim, 1, scalar=False, flat=False, timed=False, what=key)
            size = 1 + sum(abs(float(term.weight)) for term in casimir.formula.terms)
            assert abs(value(x) - casimir(x)) <= 2**8 * U * size
            assert np.abs(gradient(x) - casimir.gradient(x)).max() <= 2**10 * U * size
            assert math.isnan(value(nowhere)) and np.isnan(gradient(nowhere)).all()
    assert len(seen) >= 8 and undefined > 50


def test_runs_unwrap_angles_and_report_what_is_undefined():
    g = co.algebras.get("A4,6", a=2.0, b=0.0)
    system = co.LiePoissonSystem(g, co.Quadratic([0.0, 0.0, 0.0, 1.0], linear=[0.0, 0.0, 0.0, 1.0]))
    x0 = np.array([1.0, 1.0, 0.5, 0.25])  # turns (x2, x3) by 1.25 each unit of time: more than 20 times
    sol = co.integrate(system, x0, t_span=(0.0, 128.0), step=2.0**-5, method=co.Splitting(order=2))
    turning = sol.casimirs["log|x1| - a*atan2(x3, x2)"]
    jumps = [g.casimirs_known["log|x1| - a*atan2(x3, x2)"](x) for x in sol.x]
    period = 4 * math.pi
    # x1 grows or decays by exp(+-320): its logarithm and the unwrapped angle stay known to u times their size
    assert np.ptp(jumps) > 20 * period
    assert np.abs(turning - turning[0]).max() <= 4096 * 64 * U * 320
    undefined = co.LiePoissonSystem(co.algebras.get("A3,5", a=0.5), co.Quadratic([1.0, 0.5, 0.25]))
    sol = co.integrate(undefined, [1.0, 0.0, 1.0], t_span=(0.0, 1.0), step=0.125, method=co.Splitting(order=2))
    assert np.isnan(sol.casimirs["log|x2| - a*log|x1|"]).all()
    assert math.isnan(sol.drift()["log|x2| - a*log|x1|"]) and np.isfinite(sol.energy).all()


def test_known_names_coincide():
    assert co.algebras.get("A3,8") == co.algebras.sl(2)
    assert co.algebras.get("A3,9") == co.algebras.so(3) == co.algebras.su(2)
    assert np.array_equal(co.algebras.get("A3,9").representation, co.algebras.so(3).representation)
    assert co.algebras.get("A3,7", a=0) == co.algebras.get("A3,6")
    assert co.algebras.get("A3,7", a=np.float32(0.5)) == co.algebras.A3_7(Fraction(1, 2))
    assert repr(co.algebras.get("A5,13", a=0.5, p=1 / 3, s=2)) == (
        "LieAlgebra('A5_13(a=0.5, p=0.3333333333333333, s=2)', dim=5: [e1, e5] = e1, [e2, e5] = 0.5 e2, "
        "[e3, e5] = 0.333333 e3 - 2 e4, [e4, e5] = 2 e3 + 0.333333 e4)"
    )


@pytest.mark.parametrize(("name", "chosen"), CASES, ids=label)
def test_representations_are_faithful(name, chosen):
    rho = co.algebras.get(name, **chosen).representation
    if rho is not None:  # its commutators were checked at construction
        assert rank([[Fraction(v) for v in matrix.ravel()] for matrix in rho]) == len(rho)
    centre_and_no_abelian_ideal = {"A4_8", "A4_10", *(f"A5_{k}" for k in (3, 4, 5, 6, 22, 29, 38, 39))}
    degenerate = {("A5_19", 0), ("A5_20", 0), ("A5_25", 0), ("A5_26", 0), ("A5_28", 0), ("A5_30", -1)}
    first = next(iter(chosen.values()), None)
    assert (rho is None) == (name in centre_and_no_abelian_ideal or (name, first) in degenerate)


def test_two_angles():
    """A5,17 with p = q = 0 is two oscillators: their phases are comparable only where the ratio is rational."""
    commensurable = co.algebras.get("A5,17", p=0, q=0, s=2 / 3).casimirs_known
    assert commensurable["atan2(x4, x3) - s*atan2(x2, x1)"].period == pytest.approx(2 * math.pi / 3, rel=4 * U)
    assert list(co.algebras.get("A5,17", p=0, q=0, s=math.sqrt(2)).casimirs_known) == ["x1^2 + x2^2", "x3^2 + x4^2"]
    phase = commensurable["atan2(x4, x3) - s*atan2(x2, x1)"]
    for a, b in itertools.product((-1e-9, 1e-9), repeat=2):  # both angles at their branch: multiples of the period
        jump = (phase([-1.0, a, -1.0, b, 0.0]) - phase([-1.0, 1e-9, -1.0, 1e-9, 0.0])) / phase.period
        assert abs(jump - round(jump)) < 1e-8


def test_invariants_can_be_sent_to_another_process():
    casimir = co.algebras.get("A4,6", a=2.0, b=0.5).casimirs_known["log|x1| - a*atan2(x3, x2)"]
    again = pickle.loads(pickle.dumps(casimir))
    assert again([2.0, 1.0, 3.0, 0.0]) == casimir([2.0, 1.0, 3.0, 0.0]) and again.period == casimir.period
