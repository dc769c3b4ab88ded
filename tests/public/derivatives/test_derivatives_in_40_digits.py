"""Derivatives of splittings of sums of functions of one coordinate, against their flows in 40 digits.

The flow of H_i(x_i) is x -> exp(tau H_i'(x_i) L_i) x with J(x) e_i = L_i x on every algebra, as it does not move x_i;
the attitude is multiplied by exp(-tau H_i'(x_i) rho_i).
"""

import mpmath
import numpy as np
import pytest

import coadjoint as co
from rounding import UNIT_ROUNDOFF

DIGITS, SMALL, H = 40, mpmath.mpf(10) ** -15, 0.125
ALGEBRAS = {
    "so(3)": (co.algebras.so(3), -1),
    "sl(2)": (co.algebras.sl(2), 1),
    "A3,7": (co.algebras.A3_7(0.75), -1),
    "A4,7": (co.algebras.get("A4,7"), 1),
    "A5,40": (co.algebras.get("A5,40"), -1),
    "e(3)": (co.algebras.e(3), 1),
}
SCHEMES = {
    "order 1": co.Splitting(order=1, parts="coordinates"),
    "adjoint": co.Splitting(order=1, parts="coordinates", adjoint=True),
    "order 2": co.Splitting(order=2, parts="coordinates"),
    "compensated": co.Splitting(order=2, parts="coordinates", compensated=True),
    "order 4": co.Splitting(order=4, parts="coordinates"),
    "processed": co.Splitting(scheme="blanes_casas_murua6", parts="coordinates"),
}
CASES = [
    ("so(3)", "order 1"),
    ("so(3)", "order 4"),
    ("sl(2)", "compensated"),
    ("sl(2)", "processed"),
    pytest.param("A3,7", "processed", marks=pytest.mark.long),
    ("A3,7", "order 2"),
    ("A4,7", "adjoint"),
    ("A5,40", "order 4"),
    ("e(3)", "compensated"),
]


def exact(values):
    values = np.asarray(values)
    return np.array([mpmath.mpf(v) for v in values.ravel().tolist()], dtype=object).reshape(values.shape)


def exponential(matrix, vectors):
    """Return exp(matrix) @ vectors by its series; angles are below one."""
    term, k = vectors, 0
    while np.abs(term).max() > SMALL**2 / 10**6:
        k += 1
        term = matrix @ term / k
        vectors = vectors + term
    return vectors


class Reference:
    """A run of a splitting with parts that are the coordinates."""

    def __init__(self, algebra, sign, method, t0, backward, number_of_steps, part):
        n = algebra.dim
        units = np.eye(n)
        J = np.array([algebra.structure_matrix(unit) for unit in units])
        self.actions = [exact(J[:, :, i].T) for i in range(n)]
        self.rho = [exact(algebra.coadjoint(unit)) for unit in units]
        self.sign, self.steps, self.t0 = sign, number_of_steps, t0
        self.h = mpmath.mpf(-H if backward else H)
        self.part = part * self.h
        self.kernel, self.processor = (
            self.flows(sweeps(mpmath.mpf), n) for sweeps in (method.sweeps, method.processor)
        )

    @staticmethod
    def flows(sweeps, n):
        return [(i, s.coefficient) for s in sweeps for i in (range(n) if s.forward else reversed(range(n)))]

    def apply(self, flows, x, g, h, slope):
        for i, coefficient in flows:
            angle = self.sign * coefficient * h * slope(i, x[i])
            x, g = exponential(angle * self.actions[i], x), exponential(-angle * self.rho[i].T, g.T).T
        return x, g

    def process(self, x, g, h, way, slope):
        return self.apply([(i, way * c) for i, c in self.processor][::way], x, g, h, slope)

    def __call__(self, x, g, slope):
        """Return states and attitudes after whole steps, and a part of a step later."""
        x, g = self.process(x, g, self.h, -1, slope)
        for _ in range(self.steps):
            x, g = self.apply(self.kernel, x, g, self.h, slope)
        found = [self.process(x, g, self.h, 1, slope)]
        x, g = self.process(*found[0], self.part, -1, slope)
        found.append(self.process(*self.apply(self.kernel, x, g, self.part, slope), self.part, 1, slope))
        return tuple(np.array(column) for column in zip(*found, strict=True))


def difference(function):
    """Return the derivatives at zero, with an error of the size 1e-30."""
    with mpmath.workdps(DIGITS):
        above, below = function(SMALL), function(-SMALL)
        return [((a - b) / (2 * SMALL)).astype(float) for a, b in zip(above, below, strict=True)]


@pytest.mark.parametrize(("name", "scheme"), CASES)
def test_derivatives_have_the_digits_of_the_reference(name, scheme):
    """By states, attitudes, moments and linear terms, and by coefficients of powers."""
    (algebra, sign), method = ALGEBRAS[name], SCHEMES[scheme]
    n, backward, t0 = algebra.dim, len(name) % 2 == 0, 0.5
    rng = np.random.default_rng(n)
    x0, M, b = rng.uniform(0.3, 0.8, n), rng.uniform(0.5, 1.5, n), rng.uniform(0.1, 0.5, n)
    cubes = {tuple(3 * (i == k) for k in range(n)): float(b[i]) for i in range(n)}
    times = t0 + (-H if backward else H) * np.array([2.0, 2.25])
    span = (t0, t0 + (-3 if backward else 3) * H)
    reference = Reference(algebra, sign, method, t0, backward, 2, 0.25)
    start = exponential(sum(v * r for v, r in zip(x0, reference.rho, strict=True)) / 4, exact(np.eye(n))).astype(float)
    for energy in (co.Quadratic(M, linear=b), co.Polynomial(cubes)):
        ready = co.prepare(co.LiePoissonSystem(algebra, energy, sign=sign), method, H, attitude="coadjoint")
        along = {key: rng.standard_normal(value.shape) for key, value in ready.parameters.items()}
        along |= {"x0": rng.standard_normal(n), "attitude0": rng.standard_normal((n, n))}
        powers = [p.index(3) for p in energy.monomials] if "coefficients" in along else None

        def run(by, along=along, powers=powers):
            moved = {key: by * exact(direction) for key, direction in along.items()}
            if powers is None:
                moments, linear = M + moved["M"], b + moved["linear"]
                slope = lambda i, y: moments[i] * y + linear[i]  # noqa: E731
            else:
                slope = lambda i, y: 3 * (b[i] + moved["coefficients"][powers.index(i)]) * y * y  # noqa: E731
            x, g = reference(exact(x0) + moved["x0"], exact(np.eye(n)), slope)
            return x, (exact(start) + moved["attitude0"]) @ g

        sol, tangents = ready.jvp(x0, span, along, t_eval=times, attitude=start)
        assert set(tangents.rule.values()) == {"exact"}
        rounding = 8 * UNIT_ROUNDOFF * (sol.stats.evaluations + n * n)
        for found, wanted in zip((tangents.x, tangents.attitude), difference(run), strict=True):
            assert np.abs(found - wanted).max() <= rounding * max(1.0, np.abs(wanted).max())


def test_the_time_of_a_crossing_follows_the_closed_form():
    """A body that spins about a symmetry axis with the rate w crosses x1 = 0 at a quarter turn, pi / (2 w)."""
    body = co.systems.rigid_body(inertia=(1.0, 1.0, 2.0))
    ready = co.prepare(body, co.Splitting(order=8), 0.05)
    # x1 + i x2 turns with the rate x3 (1/I1 - 1/I3) = x3/2.
    sol, tangents = ready.jvp([1.0, 0.0, 1.0], (0.0, 5.0), {"x0": np.eye(3)}, events=co.Event("x1"))
    np.testing.assert_allclose(sol.events.t, [np.pi], rtol=0, atol=1e-13)
    np.testing.assert_allclose(tangents.events["t"], [[0.0, -2.0, -np.pi]], rtol=0, atol=1e-11)


@pytest.mark.parametrize("energy", [co.Quadratic(0.0), co.Quadratic([2.0, 2.0, 2.0]), co.Quadratic(np.zeros((3, 3)))])
def test_systems_at_rest_have_derivatives(energy):
    """Of a Casimir as energy no part remains: x' = J(x) grad G alone."""
    system = co.LiePoissonSystem(co.algebras.so(3), energy, sign=-1)
    x0, w = np.array([0.3, 1.0, 0.2]), np.array([0.5, -0.25, 1.0])
    _, tangents = co.prepare(system, co.Splitting(order=4), H).jvp(x0, (0, 8 * H), {"linear": w}, save_every=8)
    assert np.abs(tangents.x[-1] - 8 * H * np.cross(x0, w)).max() <= 200 * UNIT_ROUNDOFF


def test_gradients_of_preserved_quantities_are_those_at_the_start():
    """The enstrophy of a fluid and the energy of a body do not change, whatever the run."""
    sphere = co.systems.sphere_euler(4, rotation=0.3)
    ready = co.prepare(sphere, co.IsospectralGauss(1), 0.0625, observe={"e": lambda W: float(np.sum(np.abs(W) ** 2))})
    x0 = sphere.random(4)
    sol, pullback = ready.vjp(x0, (0.0, 0.25))
    gradient = pullback(observed={"e": np.ones(len(sol.t))})["x0"]
    np.testing.assert_allclose(gradient, 2 * len(sol.t) * x0, rtol=0, atol=1e-7)
    body, x0 = co.systems.rigid_body((1.0, 2.0, 2.5)), np.array([0.3, 1.0, 0.2])
    _, pullback = co.prepare(body, co.GaussLegendre(2), 0.25).vjp(x0, (0.5, 20.5), 80)
    np.testing.assert_allclose(pullback(energy=[0.0, 1.0])["x0"], body.hamiltonian.gradient(x0), rtol=0, atol=1e-11)
