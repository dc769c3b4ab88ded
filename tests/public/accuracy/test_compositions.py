"""Compositions and `even_order` (Remark 6.1): order conditions and steps."""

import dataclasses

import numpy as np
import pytest

import coadjoint as co
from digests.schemes_under_test import EXAMPLES, witnesses
from long import long_where
from rounding import UNIT_ROUNDOFF

pytestmark = pytest.mark.thinned(3)

C1 = 1 / (2 - 2 ** (1 / 3))
YOSHIDA = (C1, 1 - 2 * C1, C1)
S = 1 / (4 - 4 ** (1 / 3))
SUZUKI = (S, S, 1 - 4 * S, S, S)
D1 = 1 / (2 - 2 ** (1 / 5))
SIX_FROM_FOUR = (D1, 1 - 2 * D1, D1)
STRANG = co.Splitting(order=2)
NOTHING = co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")


@dataclasses.dataclass(frozen=True)
class Euler(co.methods.RungeKuttaMethod):
    order, explicit, symmetric, solver = 1, True, False, "explicit"

    def properties(self, system):
        return NOTHING

    def coefficients(self, number=float):
        one = np.array([number(1)])
        return co.methods.Coefficients(0 * one, one, 0 * one[None], one)


@dataclasses.dataclass(frozen=True)
class ThereAndBack(co.methods.FlowMethod):
    """Sweeps of unequal lengths, of first order."""

    order, explicit, symmetric = 1, True, False

    def properties(self, system):
        return co.methods.Properties(poisson=True, energy=False, casimirs="all", attitude="every representation")

    def sweeps(self, number=float):
        return [
            co.methods.Sweep(True, number(0.75), number(0.0)),
            co.methods.Sweep(False, number(0.25), number(0.75)),
        ]


BASES = [
    co.Splitting(order=1),
    co.Splitting(order=1, adjoint=True),
    co.Splitting(order=1, rotation="rational", parts="coordinates"),
    ThereAndBack(),
    Euler(),
    co.ExplicitRungeKutta("runge2"),
    co.GaussLegendre(1),
]


def full(sign: int) -> co.LiePoissonSystem:
    M = np.array([[1.0, 0.25, 0.125], [0.25, 0.5, -0.25], [0.125, -0.25, 2.0]])
    return co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M), sign=sign)


@pytest.mark.thinned(12)
@pytest.mark.parametrize("jump", ["triple", "suzuki"])
@pytest.mark.parametrize("order", long_where([6], [2, 4, 6]))
@pytest.mark.parametrize("base", BASES, ids=str)
def test_the_order_is_the_first_power_of_the_field(base, order: int, jump: str) -> None:
    method = co.methods.even_order(base, order, jump)
    assert method.order == order and method.symmetric
    assert len(method.fractions) == {"triple": 3, "suzuki": 5}[jump] ** (order // 2 - 1)
    rational = getattr(base, "rotation", "exact") == "rational"
    system = co.systems.rigid_body(inertia=(1, 2, 2.5)) if rational else full(-1)
    found = co.modified_field(system, method, order + 2 if order < 6 else order + 1)
    assert found.exact and found.first_error == order
    for k in range(1, found.order, 2):
        assert all(not F.monomials for F in found.terms[k]), "a symmetric scheme has even powers alone"


def test_a_sweep_and_its_adjoint_are_the_splitting_of_order_2() -> None:
    assert co.methods.even_order(co.Splitting(order=1), 2) == co.Splitting(order=2)
    # The two meet in the middle; the other way round the outer part is the last.
    system, x0 = full(-1), np.array([0.5, -0.75, 0.625])
    other = co.methods.even_order(co.Splitting(order=1, adjoint=True), 2)
    halves = [co.Splitting(order=1, adjoint=True), co.Splitting(order=1)]
    x = x0
    for half in halves:
        x = half.step(system, x, 0.0, 0.125)
    np.testing.assert_allclose(other.step(system, x0, 0.0, 0.25), x, rtol=0, atol=1e-15)


def test_the_mirror_image_of_rational_rotations_is_rational_too() -> None:
    system, x0 = full(-1), np.array([0.5, -0.75, 0.625])
    halves = [
        co.Splitting(order=1, adjoint=adjoint, rotation="rational", parts="coordinates") for adjoint in (True, False)
    ]
    x = x0
    for half in halves:
        x = half.step(system, x, 0.0, 0.125)
    pair = co.methods.even_order(halves[0], 2)
    np.testing.assert_allclose(pair.step(system, x0, 0.0, 0.25), x, rtol=0, atol=1e-15)
    exact = co.methods.even_order(co.Splitting(order=1, adjoint=True, parts="coordinates"), 2)
    assert np.max(np.abs(exact.step(system, x0, 0.0, 0.25) - x)) > 1e-6


def test_the_pair_of_euler_methods_is_the_trapezoidal_rule() -> None:
    system, x0, h = full(1), np.array([0.5, -0.75, 0.625]), 0.25
    end = co.methods.even_order(Euler(), 2).step(system, x0, 0.0, h)
    residual = end - x0 - h / 2 * (system.vector_field(x0) + system.vector_field(end))
    np.testing.assert_allclose(residual, 0, atol=1e-15)


DRIVEN = co.LiePoissonSystem(
    co.algebras.so(3),
    co.Quadratic([1.0, 0.5, 0.4])
    + co.Separable({i: (lambda y, t: np.sin(3.0 * t) * y, lambda y, t: np.sin(3.0 * t) + 0.0 * y) for i in (0, 2)}),
)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("h", [0.25, -0.25])
@pytest.mark.parametrize("base", [*BASES[1:2], *BASES[3:6]], ids=str)
def test_the_second_half_undoes_the_base_backward_in_time(base, h):
    """By the definition of the adjoint, with an energy of the time, alone and composed."""
    x, t, pair = np.array([0.5, -0.75, 0.625]), 0.375, co.methods.even_order(base, 2)
    for step in (pair.step, co.Composition(pair, (1.0,)).step, lambda _, x, t, h: co.stepper(DRIVEN, pair, h)(x, t)):
        end = step(DRIVEN, x, t, h)
        middle = base.step(DRIVEN, end, t + h, -h / 2)
        np.testing.assert_allclose(middle, base.step(DRIVEN, x, t, h / 2), rtol=0, atol=64 * UNIT_ROUNDOFF)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("base", [one for one in EXAMPLES if one.symmetric], ids=str)
def test_compositions_of_compositions_take_the_substeps_in_turn(base):
    inner, outer, h, t = (0.375, 0.25, 0.375), (1.25, -0.5, 0.25), 0.25, 0.5
    case = witnesses(base)[0]
    nested = co.Composition(co.Composition(base, inner), outer)
    fractions = [c * f for c in outer for f in inner]
    wanted, time = np.asarray(case.x0), t
    for fraction in fractions:
        wanted, time = co.stepper(case.system, base, fraction * h)(wanted, time), time + fraction * h
    bound = 4096 * len(base.fractions) * UNIT_ROUNDOFF * np.abs(wanted).max()
    for method in (nested, co.Composition(base, fractions)):
        for step in (co.stepper(case.system, method, h), lambda x, t, m=method: m.step(case.system, x, t, h)):
            np.testing.assert_allclose(step(np.asarray(case.x0), t), wanted, rtol=0, atol=bound)


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    ("coefficients", "base", "order"),
    [
        ((1.0,), STRANG, 2),
        ((0.5, 0.5), STRANG, 2),
        ((0.25, 0.75), STRANG, 2),
        (YOSHIDA, STRANG, 4),
        (SUZUKI, STRANG, 4),
        (SIX_FROM_FOUR, co.Splitting(order=4), 6),
        (SIX_FROM_FOUR, co.Composition(STRANG, YOSHIDA), 6),
        (YOSHIDA, co.Splitting(order=4), 4),
        ((YOSHIDA[1], YOSHIDA[0], YOSHIDA[0]), STRANG, 3),  # not a palindrome: the even condition fails as well
        ((1.3512071920, -1.7024143840, 1.3512071920), STRANG, 2),  # conditions hold to rounding, or not at all
    ],
)
def test_order_from_the_conditions(coefficients, base, order):
    method = co.Composition(base, coefficients)
    assert method.order == order and method.explicit
    assert method.symmetric == (coefficients == coefficients[::-1])
    assert not co.Composition(co.GaussLegendre(1), coefficients).explicit


@pytest.mark.thinned(1)
@pytest.mark.parametrize(("factor", "order"), [(0.5, 4), (-0.5, 4), (2.0, 2), (-2.0, 2)])
def test_a_condition_holds_to_rounding(factor, order):
    """That of a triple jump, 2 a^3 + (1 - 2 a)^3 = 0, is missed by a part of 24 u times the largest cube."""
    off = factor * 24 * UNIT_ROUNDOFF * (2 * C1 - 1) ** 3
    a = C1 + off / (6.0 * C1**2 - 6.0 * (1.0 - 2.0 * C1) ** 2)
    assert co.Composition(STRANG, (a, 1.0 - 2.0 * a, a)).order == order


def equal(count, base=STRANG):
    return co.Composition(base, (1.0 / count,) * count)


def jump(total):
    """Return a symmetric triple jump whose absolute coefficients add up to `total`."""
    a = (total + 1.0) / 4.0
    return co.Composition(STRANG, (a, 1.0 - 2.0 * a, a))


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    "make",
    [
        lambda: co.Composition(STRANG, (1.0, -1.0 + 2.0**-49, 1.0)),  # 4 u for each, times their absolute sum: 36 u
        lambda: equal(1000, equal(1)),
        lambda: equal(25, equal(40)),
        lambda: jump(999.0),
    ],
)
def test_coefficients_within_the_limits(make):
    make()
