"""Derivatives by initial states and attitudes agree with those of the plain interpreter in 40 digits."""

from __future__ import annotations

import numpy as np
import pytest
from derivative_cases import H, U, attitudes_of, element_for, fits, flow_schemes, with_each_once
from derivative_references import difference, exact, floats, reference_of

import coadjoint as co
from coadjoint.program.parts.decompose import decompose
from coadjoint.runs.derivatives import attitudes
from verification.systems_under_test import cases

pytestmark = pytest.mark.thinned(1)


def tilted(y, t):
    return 0.5 * y * y * (1 + 0.25 * t) + 0.125 * y**3


def tilted_slope(y, t):
    return y * (1 + 0.25 * t) + 0.375 * y * y


def tilted_curvature(y, t):
    return 1 + 0.25 * t + 0.75 * y


def bent(y):
    return y[0] * y[1] ** 2 + 0.25 * y[2] ** 4


def bent_gradient(y):
    return np.array([y[1] ** 2, 2 * y[0] * y[1], y[2] ** 3])


def bent_hessian(y):
    zero = 0 * y[0]
    return np.array([[zero, 2 * y[1], zero], [2 * y[1], 2 * y[0], zero], [zero, zero, 3 * y[2] ** 2]])


def systems():
    """Systems and states; functions of users consist of sums and products, for numbers of all kinds."""
    named = [name for name in cases() if not {"split", "driven", "separable"} & set(name.split())]
    found = {name: (cases()[name].system, cases()[name].x0 / 2) for name in named}
    pieces = [((i,), co.Quadratic(m)) for i, m in enumerate((1.0, 0.5, 0.4))]
    pieces.append(((3, 4, 5), co.Hamiltonian(bent, bent_gradient, bent_hessian)))
    six = np.array([0.5, -0.25, 0.75, 0.3, 0.6, -0.4])
    full = np.diag([0.5, 0.75, 1.0, 1.25, 1.5, 0.6]) + 0.1
    sum_of_two = co.algebras.direct_sum(co.algebras.so(3), co.algebras.get("A3,2"))
    return found | {
        "e(3), function": (co.LiePoissonSystem(co.algebras.e(3), co.SplitHamiltonian(pieces), sign=-1), six),
        "sl(2), in time": (
            co.LiePoissonSystem(
                co.algebras.sl(2), co.Separable(dict.fromkeys(range(3), (tilted, tilted_slope, tilted_curvature)))
            ),
            six[:3],
        ),
        "A5,40": (co.LiePoissonSystem(co.algebras.get("A5,40"), co.Quadratic(full[:5, :5]), sign=-1), six[:5]),
        "so(3) + A3,2": (co.LiePoissonSystem(sum_of_two, co.Quadratic(full)), six),
        "spins": (co.systems.spin_lattice("chain", 2, exchange=0.75, field=(0.5, 0.0, 0.25)), six),
    }


# In 40 digits the series of dense matrices take a minute for schemes of many flows.
DENSE = "so(4), full, another basis"
PAIRS = [
    (s, name)
    for s, method in flow_schemes().items()
    for name, (one, _) in systems().items()
    if fits(method, one) and (name != DENSE or method.order <= 2)
]
SPAN = (0.5, 0.5 + 2 * H)
TIMES = SPAN[0] + H * np.array([0.25, 2.0])


def test_energies_are_shifted_and_not():
    """By quadratic Casimirs, whose flow is a factor of the attitude that depends on the initial state."""
    assert {bool(decompose(one, "auto").shift) for one, _ in systems().values()} == {True, False}


def compare(found, expected, rounding):
    """Compare arrays of the shape of the states or attitudes, up to round-off of the largest number."""
    value = floats(expected)
    assert np.abs(found - value).max() <= rounding * max(1.0, np.abs(value).max())


@pytest.mark.parametrize(("scheme", "name"), with_each_once(PAIRS, 16))
def test_derivatives_by_states_and_attitudes_agree_with_40_digits(scheme, name):
    system, x0 = systems()[name]
    k = PAIRS.index((scheme, name))
    attitude = attitudes_of(system)[k % len(attitudes_of(system))]
    ready, element = co.prepare(system, flow_schemes()[scheme], H, attitude=attitude), element_for(system, attitude, k)
    ends, times = (SPAN, TIMES) if k % 3 else (SPAN[::-1], TIMES[::-1])
    rng = np.random.default_rng(k)
    points = {"t_eval": times}
    directions = {"x0": rng.standard_normal(system.dim)}
    if element is not None:
        directions["attitude0"] = rng.standard_normal(element.shape)
    reference = reference_of(ready, x0, ends, points, element)
    for name, direction in directions.items():
        v = exact(direction)
        if name == "x0":
            of_x, of_attitude = difference(lambda e, v=v: reference(x=exact(x0) + v * e))
        else:
            of_x, of_attitude = difference(lambda e, v=v: reference(A=exact(element) + v * e))
        sol, tangents = ready.jvp(x0, ends, {name: direction}, **points, attitude=element)
        # A unit for each flow, and for each product of the sums of products of matrices.
        rounding = U * (sol.stats.evaluations + 4 * (system.dim + sol.x[0].size))
        compare(tangents.x, of_x, rounding)
        if of_attitude is not None:
            compare(tangents.attitude, of_attitude, rounding)


@pytest.mark.parametrize("count", [1, 9])
def test_exponentials_in_blocks_are_those_one_by_one(monkeypatch, count):
    """The unshifted element is the unit one; with many directions those of a basis are combined."""
    ready = co.prepare(co.systems.rigid_body((1, 2, 3)), co.Splitting(), H, attitude=True)
    x0, rng, found = np.array([0.3, 1.0, 0.2]), np.random.default_rng(1), []
    directions = {"x0": rng.standard_normal((3, count)), "inertia": rng.standard_normal((3, count))}
    for largest in (2, 3):
        monkeypatch.setattr(attitudes, "LARGEST_BLOCK", largest)
        found.append(ready.jvp(x0, (0.0, 1.0), directions)[1].attitude)
    each = [ready.jvp(x0, (0.0, 1.0), {name: v[:, k] for name, v in directions.items()})[1] for k in range(count)]
    for other in (found[1], np.stack([one.attitude for one in each], axis=-1)):
        np.testing.assert_allclose(found[0], other, rtol=0, atol=2**6 * U * np.abs(found[0]).max())


# Rotations of four and more blocks by one angle, and parts of eight and more angles.
LARGE = {
    "so(6)": co.LiePoissonSystem(co.algebras.so(6), co.Quadratic(np.linspace(1, 3, 15))),
    "su(4), in coordinates": co.LiePoissonSystem(co.algebras.su(4), co.Quadratic(np.linspace(1, 3, 15))),
    "spins": co.systems.spin_lattice(shape=10, field=(0.1, 0.2, 0.3)),
    "quartic spins": co.LiePoissonSystem(
        co.algebras.copies(co.algebras.so(3), 10),
        co.Polynomial({tuple(4 * int(i == k) for i in range(30)): 0.1 for k in range(30)}),
    ),
}


@pytest.mark.parametrize("members", [1, 9])
@pytest.mark.parametrize("name", LARGE)
def test_tangents_keep_the_momentum_in_space_in_large_representations(name, members):
    """Where A x = x0, dA x + A dx = dx0."""
    system, rng = LARGE[name], np.random.default_rng(6)
    method = co.Splitting(parts="coordinates") if "in coordinates" in name else co.Splitting()
    x0, direction = rng.standard_normal((2, members, system.dim))
    ready = co.prepare(system, method, 0.0625, attitude="coadjoint")
    sol, tangents = ready.jvp(x0, (0, 0.25), {"x0": direction})
    rotated, moved = (
        np.einsum("pmij,pmj->pmi", *pair) for pair in ((tangents.attitude, sol.x), (sol.attitude, tangents.x))
    )
    np.testing.assert_allclose(rotated + moved, np.broadcast_to(direction, sol.x.shape), rtol=0, atol=1e-11)
