"""Schemes of even order from a first-order one and its adjoint (Remark 6.1)."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import coadjoint as co
from coadjoint.analysis.fits import fit_order
from coadjoint.methods import even_order
from long import long_where

pytestmark = pytest.mark.thinned(3)

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


def served(base, sign):
    diagonal = getattr(base, "rotation", "exact") == "rational"
    return co.systems.rigid_body(inertia=(1, 2, 2.5)) if diagonal else full(sign)


@pytest.mark.thinned(12)
@pytest.mark.parametrize("jump", ["triple", "suzuki"])
@pytest.mark.parametrize("order", long_where([6], [2, 4, 6]))
@pytest.mark.parametrize("base", BASES, ids=str)
def test_the_order_is_the_first_power_of_the_field(base, order: int, jump: str) -> None:
    method = even_order(base, order, jump)
    assert method.order == order and method.symmetric
    assert len(method.fractions) == {"triple": 3, "suzuki": 5}[jump] ** (order // 2 - 1)
    found = co.modified_field(served(base, -1), method, order + 2 if order < 6 else order + 1)
    assert found.exact and found.first_error == order
    for k in range(1, found.order, 2):
        assert all(not F.monomials for F in found.terms[k]), "a symmetric scheme has even powers alone"


@pytest.mark.parametrize("base", BASES, ids=str)
def test_runs_have_the_order_and_keep_what_the_base_keeps(base) -> None:
    system = served(base, 1)
    x0, method = np.array([0.5, -0.75, 0.625]), even_order(base, 4)
    exact = co.integrate(system, x0, (0, 2), 0.01, co.GaussLegendre(6)).x[-1]
    steps = 0.25 / 2.0 ** np.arange(4)
    errors = [np.abs(co.integrate(system, x0, (0, 2), h, method).x[-1] - exact).max() for h in steps]
    assert fit_order(steps, errors, floor=1e-13).order == pytest.approx(4, abs=0.3)
    stepper = co.stepper(system, method, 0.25)
    back = co.stepper(system, method, -0.25)
    np.testing.assert_allclose(back(stepper(x0)), x0, atol=1e-13)
    if base.properties(system).casimirs == "all":
        assert co.integrate(system, x0, (0, 50), 0.25, method).drift()["|x|^2"] < 1e-13


@pytest.mark.thinned(12)
@pytest.mark.parametrize("base", [base for base in BASES if getattr(base, "rotation", "exact") == "exact"], ids=str)
@pytest.mark.parametrize("order", [2, 4])
def test_steps_of_a_driven_system_have_the_order_and_are_symmetric(base, order) -> None:
    spins = co.systems.spin_lattice("chain", 2, field=lambda t: (np.cos(3.0 * t), np.sin(3.0 * t), 0.2))
    x0, method = np.array([0.6, 0.0, 0.8, 0.0, 0.28, 0.96]), even_order(base, order)
    there, back = (co.stepper(spins, method, h) for h in (0.125, -0.125))
    np.testing.assert_allclose(back(there(x0, 0.7), 0.825), x0, rtol=0, atol=1e-13)
    exact = co.integrate(spins, x0, (0.5, 1.5), 1 / 64, co.GaussLegendre(6)).x[-1]
    steps = 1 / 2.0 ** np.arange(3, 7)
    errors = [np.abs(co.integrate(spins, x0, (0.5, 1.5), h, method).x[-1] - exact).max() for h in steps]
    assert fit_order(steps, errors, floor=1e-13).order == pytest.approx(order, abs=0.3)


def test_a_sweep_and_its_adjoint_are_the_splitting_of_order_2() -> None:
    assert even_order(co.Splitting(order=1), 2) == co.Splitting(order=2)
    # The two meet in the middle; the other way round the outer part is the last.
    system, x0 = full(-1), np.array([0.5, -0.75, 0.625])
    other = even_order(co.Splitting(order=1, adjoint=True), 2)
    halves = [co.Splitting(order=1, adjoint=True), co.Splitting(order=1)]
    x = x0
    for half in halves:
        x = half.step(system, x, 0.0, 0.125)
    np.testing.assert_allclose(other.step(system, x0, 0.0, 0.25), x, rtol=0, atol=1e-15)


def test_the_pair_of_euler_methods_is_the_trapezoidal_rule() -> None:
    system, x0, h = full(1), np.array([0.5, -0.75, 0.625]), 0.25
    end = even_order(Euler(), 2).step(system, x0, 0.0, h)
    residual = end - x0 - h / 2 * (system.vector_field(x0) + system.vector_field(end))
    np.testing.assert_allclose(residual, 0, atol=1e-15)


def test_what_has_no_adjoint_is_refused_by_name() -> None:
    for base in (co.RadauEnergy(1), co.ModifiedGaussLegendre(1), co.IteratedGaussLegendre(1), co.Taylor(1)):
        with pytest.raises(TypeError, match=r"the adjoint of .* is not known as a scheme"):
            even_order(base, 2)
    with pytest.raises(TypeError, match="has a processor"):
        even_order(co.Splitting(scheme="blanes_casas_murua6"), 8)
    with pytest.raises(ValueError, match="order is 3; from"):
        even_order(co.Splitting(order=1), 3)
    with pytest.raises(ValueError, match="it is even, and 6 or more"):
        even_order(co.GaussLegendre(3), 4)
    with pytest.raises(TypeError, match="give a scheme such as"):
        even_order("Splitting", 4)
    with pytest.raises(ValueError, match="jump"):
        even_order(co.Splitting(order=1), 4, "quintuple")
