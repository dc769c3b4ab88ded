"""Derivatives by parameters: of the computed map, or of the same scheme with one more part of size zero.

References are runs in 40 digits of systems with other parameters, and of splittings with a small part between the
flows; and the derivatives of the motion itself, by its variational equation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from derivative_cases import H, U, attitudes_of, element_for, fits, flow_schemes
from derivative_references import Kick, difference, difference_of_systems, exact, floats, reference_of
from scipy.integrate import solve_ivp

import coadjoint as co
from coadjoint.program.parts.decompose import decompose
from coadjoint.systems.parameters import parameters_of
from coadjoint.systems.registry import gallery_entry_of
from long import long_beyond
from verification.measures import five_errors, order_of, step_counts

EXACT, ADDED = "exact", "added part"
SPAN = (0.5, 0.5 + 2 * H)
TIMES = SPAN[0] + H * np.array([0.25, 2.0])


def dyadic(values):
    """Round to multiples of 2^-6: sums with multiples of 2^-10 times such numbers are floats."""
    return np.round(64 * np.asarray(values)) / 64


@dataclass(frozen=True)
class Family:
    """Systems on an algebra with the given constants, and the rules by which parameters are differentiated."""

    algebra: Any
    constants: dict[str, Any]
    rules: dict[str, str]
    sign: int = 1

    def system(self, **changed: Any) -> Any:
        constants = self.constants | changed
        if "monomials" in constants:
            values = constants.get("coefficients", np.array(list(self.monomials.values())))
            energy = co.Polynomial(dict(zip(self.monomials, values.tolist(), strict=True)))
        else:
            energy = co.Quadratic(constants["M"], linear=constants["linear"])
        return co.LiePoissonSystem(self.algebra, energy, sign=self.sign)

    @property
    def monomials(self) -> Any:
        return co.Polynomial(self.constants["monomials"]).monomials

    def gradient(self, name: str, w: np.ndarray) -> Callable[[Any], Any]:
        """Return the gradient of the change of the energy with a parameter."""
        if name == "M":
            return lambda x: w @ x if w.ndim == 2 else w * x
        if name == "linear":
            return lambda x: exact(w) if x.dtype == object else w
        change = co.Polynomial(dict(zip(self.monomials, w.tolist(), strict=True)))
        slopes = [change.derivative(i) for i in range(self.algebra.dim)]
        return lambda x: np.array([slope(x) for slope in slopes], dtype=x.dtype)

    def direction(self, name: str, rng: Any) -> np.ndarray:
        value = self.constants.get(name, list(self.constants.get("monomials", ())))
        w = dyadic(rng.uniform(-1.0, 1.0, np.shape(value)[: 2 if name == "M" else 1]))
        return (w + w.T) / 2 if w.ndim == 2 else w


def full(n, seed):
    B = np.random.default_rng(seed).uniform(-0.2, 0.2, (n, n))
    return dyadic(np.diag(np.linspace(0.5, 1.5, n)) + B + B.T)


def quadratic(algebra, M, linear, rules, sign=1):
    names = ("M", "linear")
    return Family(
        algebra,
        {name: np.array(value) for name, value in zip(names, (M, linear), strict=True)},
        dict(zip(names, rules, strict=True)),
        sign,
    )


def polynomial(algebra, monomials, rule, sign=1):
    return Family(algebra, {"monomials": monomials}, {"coefficients": rule}, sign)


SIX = (0.5, -0.25, 0.75, 0.25, 0.625, -0.375)
SUM = co.algebras.direct_sum(co.algebras.so(3), co.algebras.get("A3,2"))
MIXED = {(2, 0, 0): 0.5, (0, 2, 0): 0.25, (0, 0, 4): 0.125, (0, 3, 0): 0.25, (1, 0, 0): 0.5}
POTENTIAL = {
    **{tuple(2 * (i == j) for j in range(6)): 0.25 * (i + 1) for i in range(3)},
    (0, 0, 0, 1, 2, 0): 0.5,
    (0, 0, 0, 0, 1, 3): 0.25,
    (0, 0, 0, 0, 0, 1): -0.75,
}
FAMILIES = {
    # The square that a shift removes changes the factor of the Casimir.
    "so(3), diagonal": quadratic(co.algebras.so(3), (0.5, 1.25, 2.0), (0.25, -0.5, 0.125), (EXACT, EXACT), -1),
    "so(4), diagonal": quadratic(co.algebras.so(4), (0.5, 1.75, 0.75, 1.25, 1.0, 2.25), 6 * [0.0], (EXACT, ADDED), -1),
    "e(3), diagonal": quadratic(co.algebras.e(3), (1.0, 0.5, 0.25, 0.75, 1.25, 1.5), 6 * [0.0], (EXACT, ADDED)),
    "e(3), top": quadratic(co.algebras.e(3), (1.0, 0.5, 0.25, 0, 0, 0), (0, 0, 0, 0.5, 0.25, 1), (ADDED, EXACT), -1),
    "A4,7, diagonal": quadratic(co.algebras.get("A4,7"), (0.5, 1.5, 0.75, 0.25), SIX[:4], (EXACT, EXACT)),
    "A5,40, diagonal": quadratic(co.algebras.get("A5,40"), (0.5, 1.0, 0.75, 0.25, 1.5), 5 * [0.0], (EXACT, EXACT), -1),
    "so(3), full": quadratic(co.algebras.so(3), full(3, 1), SIX[:3], (ADDED, ADDED), -1),
    "sl(2), full": quadratic(co.algebras.sl(2), full(3, 2), SIX[:3], (ADDED, ADDED)),
    "A3,7, full": quadratic(co.algebras.A3_7(0.75), full(3, 3), 3 * [0.0], (ADDED, ADDED)),
    "so(3) + A3,2, full": quadratic(SUM, full(6, 4), SIX, (ADDED, ADDED), -1),
    "sl(2), polynomial": polynomial(co.algebras.sl(2), MIXED, EXACT),
    # In the Casimir x1^2 - x2^2 - x3^2 the square that a shift removes has the factor -1.
    "so(2,1), diagonal": quadratic(co.algebras.so(2, 1), (1.0, 0.5, 0.25), 3 * [0.0], (EXACT, ADDED)),
    "e(3), polynomial": polynomial(co.algebras.e(3), POTENTIAL, EXACT, -1),
}
OTHERS = (
    "Splitting processed",
    "Splitting 1",
    "Splitting 1 adjoint",
    "Splitting 2 compensated",
    "Composition of Splitting",
)


def cases_of_rules():
    """Pairs of a family and a scheme: the automatic parts with several schemes, the coordinates and rational ones."""
    found = [(name, "Splitting 2") for name in FAMILIES]
    found += [(name, OTHERS[k % len(OTHERS)]) for k, name in enumerate(FAMILIES)]
    found += [("so(3), diagonal", "Splitting 2 rational"), ("so(3), diagonal", "Splitting 2 free body")]
    return found + [("e(3), top", "Splitting 2 free body"), ("e(3), diagonal", "Splitting 4 rational")]


def started(name, scheme, seed=1):
    """Return a prepared run of a family, a state and an element."""
    family, n = FAMILIES[name], FAMILIES[name].algebra.dim
    kinds = attitudes_of(family.system())
    attitude = kinds[seed % len(kinds)]
    ready = co.prepare(family.system(), flow_schemes()[scheme], H, attitude=attitude)
    return ready, np.array(SIX[:n]), element_for(family.system(), attitude, seed)


def compare(found, expected, rounding):
    for one, other in zip((found.x, found.attitude), expected, strict=True):
        if one is not None:
            value = floats(other)
            assert np.abs(one - value).max() <= rounding * max(1.0, np.abs(value).max())


def assert_same_parts(ready, system):
    """A change of the parameter must not change the order of the parts, nor what is subtracted."""
    if ready.method.expanded.parts == "auto":
        first, second = (decompose(one, "auto").choice for one in (ready.system, system))
        assert first.order == second.order and [n for n, _ in first.shift] == [n for n, _ in second.shift]


@pytest.mark.thinned(1)
@pytest.mark.parametrize(("name", "scheme"), long_beyond(len(FAMILIES), cases_of_rules()))
def test_derivatives_by_parameters_agree_with_40_digits(name, scheme):
    """Exact ones with differences of systems, added parts with a small part between the flows."""
    family, k = FAMILIES[name], cases_of_rules().index((name, scheme))
    ready, x0, element = started(name, scheme, k)
    rng = np.random.default_rng(k)
    ends, times = (SPAN, TIMES) if k % 2 else (SPAN[::-1], TIMES[::-1])
    reference = reference_of(ready, x0, ends, {"t_eval": times}, element)
    for parameter in ready.parameters:
        w = family.direction(parameter, rng)
        sol, tangents = ready.jvp(x0, ends, {parameter: w}, t_eval=times, attitude=element)
        rounding = U * (sol.stats.evaluations + 4 * (x0.size + sol.x[0].size))
        if scheme == "Splitting 2":
            assert tangents.rule[parameter] == family.rules[parameter]
        if tangents.rule[parameter] == EXACT:
            value = ready.parameters[parameter]

            def at(step, parameter=parameter, w=w, value=value):
                system = family.system(**{parameter: value + step * w})
                assert_same_parts(ready, system)
                return reference(system=system)

            expected = difference_of_systems(at)
        else:
            gradient = family.gradient(parameter, w)
            expected = difference(lambda e, gradient=gradient: reference(kick=Kick(e, gradient)))
        compare(tangents, expected, rounding)


def variational_motion(family, parameter, w, x0, element, kind):
    """Return the derivatives of states and elements by a parameter at times, from x' = s J(x) grad H and its like.

    An element follows g' = -s g rho(grad H).
    """
    system, n, s, d = family.system(), len(x0), family.sign, len(element)
    change = family.gradient(parameter, w)
    units = np.eye(n)
    J_by_x = np.array([system.structure_matrix(unit) for unit in units])
    rho = system.representation if kind is True else np.array([system.algebra.coadjoint(unit) for unit in units])

    def field(t, y):
        x, dx = y[:n], y[n : 2 * n]
        g, dg = y[2 * n :].reshape(2, d, d)
        slope, of_slope = system.hamiltonian.gradient(x), system.hamiltonian.hessian(x) @ dx + change(x)
        J, dJ = np.tensordot(x, J_by_x, 1), np.tensordot(dx, J_by_x, 1)
        A, dA = np.tensordot(slope, rho, 1), np.tensordot(of_slope, rho, 1)
        moved = (J @ slope, dJ @ slope + J @ of_slope, -g @ A, -dg @ A - g @ dA)
        return s * np.concatenate([part.ravel() for part in moved])

    start = np.concatenate([x0, np.zeros(n), element.ravel(), np.zeros(d * d)])
    y = solve_ivp(field, (0.0, 1.0), start, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    return y[n : 2 * n], y[2 * n + d * d :].reshape(d, d)


@pytest.mark.thinned(5)
@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize(
    ("name", "parameter"), [(name, parameter) for name, family in FAMILIES.items() for parameter in family.rules]
)
def test_derivatives_by_parameters_have_the_order_of_the_scheme(name, parameter, order):
    """Of the state and of the attitude at the end, by both rules."""
    family, method = FAMILIES[name], co.Splitting(order=order)
    system, n = family.system(), family.algebra.dim
    kind = attitudes_of(system)[0] or "coadjoint"
    x0, element = 1.5 * np.array(SIX[:n]), element_for(system, kind, 3)
    w = family.direction(parameter, np.random.default_rng(n))
    of_x, of_element = variational_motion(family, parameter, w, x0, element, kind)

    def error(count):
        ready = co.prepare(system, method, 1.0 / count, attitude=kind, watch=False)
        _, tangents = ready.jvp(x0, (0, 1), {parameter: w}, count, attitude=element)
        return np.hypot(np.linalg.norm(tangents.x[-1] - of_x), np.linalg.norm(tangents.attitude[-1] - of_element))

    size = float(np.hypot(np.linalg.norm(of_x), np.linalg.norm(of_element)))
    # The reference has a tolerance of 1e-13 for each of its steps, which five errors must exceed.
    found = order_of(*five_errors(1.0, step_counts(order), 100 * size, error), 2)
    assert found.agrees_with(order), found


def ready_made():
    """Pairs of a ready-made system that splits and one of its arguments by which it can be differentiated."""
    for name in co.systems.names():
        system = co.systems.get(name)
        if fits(co.Splitting(), system):
            yield from ((name, parameter) for parameter in parameters_of(system) if parameter in system.parameters)


@pytest.mark.filterwarnings("ignore:.*principal moment")
@pytest.mark.thinned(4)
@pytest.mark.parametrize(("name", "parameter"), list(ready_made()))
def test_derivatives_by_parameters_of_ready_made_systems_agree_with_differences(name, parameter):
    """Runs of systems with other parameters: exact ones to rounding, added parts to the order of the scheme."""
    entry, step, span = gallery_entry_of(name), 1 / 64, (0.0, 0.5)
    system = co.systems.get(name)
    x0 = np.reshape(entry.start(), (-1, system.dim))[0]
    ready = co.prepare(system, co.Splitting(order=4), step, attitude="coadjoint", watch=False)
    value, rng = ready.parameters[parameter], np.random.default_rng(1)
    w = rng.uniform(0.5, 1.0, value.shape) * np.maximum(np.abs(value), 0.5)
    _, tangents = ready.jvp(x0, span, {parameter: w}, 16)

    def run(k):
        changed = value + k * 2.0**-9 * w
        given = {**system.parameters, parameter: changed if changed.ndim else float(changed)}
        other = co.prepare(co.systems.get(name, **given), ready.method, step, attitude="coadjoint", watch=False)
        return other.run(x0, span, 16)

    runs = {k: run(k) for k in (-3, -2, -1, 1, 2, 3)}
    for output in ("x", "attitude", "energy"):
        a = {k: getattr(one, output) for k, one in runs.items()}
        expected = (45 * (a[1] - a[-1]) - 9 * (a[2] - a[-2]) + a[3] - a[-3]) / (60 * 2.0**-9)
        # Sixth powers of 2^-9 are below the rounding of differences, some units over 2^-9: a run has 10^3 flows.
        bound = 1e-9 if tangents.rule[parameter] == EXACT else 10 * step**4
        assert np.abs(getattr(tangents, output) - expected).max() <= bound * max(1.0, np.abs(expected).max())


def test_derivatives_by_arguments_follow_those_by_coefficients():
    """M is the inverse of the inertia, and the linear term the lever."""
    inertia, lever = np.array([1.0, 2.0, 2.5]), np.array([0.25, -0.5, 1.0])
    top = co.systems.heavy_top(inertia=inertia, lever=lever)
    energy = co.Quadratic(np.append(1 / inertia, np.zeros(3)), linear=np.append(np.zeros(3), lever))
    own = co.LiePoissonSystem(co.algebras.e(3), energy, sign=-1)
    x0, method = np.array([1.0, -0.5, 1.5, 0.6, 0.0, 0.8]), co.Splitting(order=4)
    gradients = []
    for system in (top, own):
        sol, pullback = co.prepare(system, method, H).vjp(x0, (0, 4), 8)
        gradients.append(pullback(np.cos(np.arange(sol.x.size)).reshape(sol.x.shape)))
    by_argument, by_coefficient = gradients
    pairs = [(by_argument["lever"], by_coefficient["linear"][3:])]
    # M of the own system has entries without a part, so that it is another rule: both converge with h.
    pairs += [(by_argument["inertia"], -by_coefficient["M"][:3] / inertia**2)]
    for (one, other), bound in zip(pairs, (2.0**-42, 10 * H**4), strict=True):
        assert np.abs(one - other).max() <= bound * np.abs(other).max()


def test_coefficients_are_in_the_order_of_the_monomials():
    """A polynomial of the second degree is a `Quadratic`."""
    energy = co.Polynomial({(0, 0, 3): 0.5, (1, 0, 0): 0.25, (0, 2, 0): 1.0})
    ready = co.prepare(co.LiePoissonSystem(co.algebras.so(3), energy), co.Splitting(), H)
    assert ready.parameters["coefficients"].tolist() == list(energy.monomials.values())
    x0 = np.array([0.5, 0.25, -0.75])
    _, pullback = ready.vjp(x0, (0, 0))
    monomials = [np.prod(x0**exponents) for exponents in energy.monomials]
    assert np.allclose(pullback(energy=[1.0])["coefficients"], monomials, rtol=1e-15, atol=0)
    quadratic = co.LiePoissonSystem(co.algebras.so(3), co.Polynomial({(0, 2, 0): 1.0}))
    assert set(co.prepare(quadratic, co.Splitting(), H).parameters) == {"M", "linear"}


@pytest.mark.parametrize("span", [(0.2, 1.2), (1.2, 0.2)], ids=["forward", "backward"])
@pytest.mark.parametrize("method", [co.GaussLegendre(1), co.GaussLegendre(2), co.ExplicitRungeKutta("rk4")], ids=str)
def test_attitudes_of_runge_kutta_methods_depend_on_parameters(method, span):
    """The gradient of a number of the attitudes alone is that of tangents, which are differences of whole runs."""
    inertia, x0 = np.array([1.0, 1.7, 2.5]), np.array([0.4, -0.9, 0.6])
    direction, weights = np.array([0.5, -1.0, 0.7]), np.random.default_rng(3).standard_normal((11, 3, 3))

    def run(by):
        body = co.systems.rigid_body(inertia=inertia + by * direction)
        return co.integrate(body, x0, span, 0.1, method, attitude=True).attitude

    ready = co.prepare(co.systems.rigid_body(inertia=inertia), method, 0.1, attitude=True)
    _, tangents = ready.jvp(x0, span, {"inertia": direction})
    distance, by = 2.0**-10, (4 / 5, -1 / 5, 4 / 105, -1 / 280)
    differences = sum(w * (run(k * distance) - run(-k * distance)) / distance for k, w in enumerate(by, 1))
    np.testing.assert_allclose(tangents.attitude, differences, rtol=0, atol=2.0**-38)
    _, pullback = ready.vjp(x0, span)
    found = pullback(attitude=weights)["inertia"] @ direction
    assert abs(found) > 0.1
    assert found == pytest.approx(np.sum(weights * differences), abs=2.0**-34)
