"""Derivatives of runs of systems of matrices: forward against backward, and against differences of order 8 of runs."""

import dataclasses

import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra.families.matrix_algebra import MatrixAlgebra
from coadjoint.methods.protocol.linearized import linearized
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.matrices.streams import Weights
from coadjoint.systems.matrices.two_layer_system import TwoLayerSystem
from coadjoint.systems.parameters import with_parameters

H = 0.0625
WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
DISTANCE = 2.0**-9
# Differences of runs of some ten steps, whose stages are solved to 64 roundings, over the distance.
DIFFERENCE_ERROR = 2.0**11 * UNIT_ROUNDOFF / DISTANCE

SYMMETRIC = np.array([[0.2, 1.0, 0.5], [1.0, 0.3, 0.7], [0.5, 0.7, 0.9]])
OFF_DIAGONAL = SYMMETRIC - np.diag(np.diag(SYMMETRIC))
SPHERE, TORUS = co.systems.sphere_euler(4, rotation=0.3), co.systems.torus_euler(5)


def turned(W, t):
    return (1.0 + 0.5 * t) * OFF_DIAGONAL * W


CASES = {
    "sphere, midpoint": (SPHERE, co.IsospectralGauss(1)),
    "sphere, three stages": (SPHERE, co.IsospectralGauss(3)),
    "sphere, composed": (SPHERE, co.Composition(co.IsospectralGauss(1), (0.75, -0.5, 0.75))),
    "sphere, commutator-free": (co.systems.sphere_euler(3, rotation=0.3), co.CommutatorFree()),
    "torus": (TORUS, co.IsospectralGauss(2)),
    "torus by lines": (TORUS, co.LineSplitting(4)),
    "torus by composed lines": (TORUS, co.Composition(co.LineSplitting(2), (0.75, -0.5, 0.75))),
    "body": (co.systems.matrix_body((1.0, 2.0, 3.0, 4.0)), co.IsospectralGauss(2)),
    "two layers": (co.systems.reduced_mhd(4), co.IsospectralGauss(2)),
    "two layers on the torus": (co.systems.reduced_mhd(3, "torus"), co.IsospectralGauss(1)),
    "passive layer": (co.systems.passive_scalar(3, "torus"), co.IsospectralGauss(1)),
    "own layers": (
        TwoLayerSystem(MatrixAlgebra("u", 3), Weights(SYMMETRIC), Weights(SYMMETRIC[::-1, ::-1])),
        co.IsospectralGauss(2),
    ),
    "gl": (MatrixSystem(MatrixAlgebra("gl", 3), Weights(SYMMETRIC)), co.IsospectralGauss(2)),
    "function on sl": (MatrixSystem(MatrixAlgebra("sl", 3), lambda W: OFF_DIAGONAL * W), co.IsospectralGauss(2)),
    "function on sp": (MatrixSystem(MatrixAlgebra("sp", 2), lambda W: W - W.T), co.IsospectralGauss(2)),
    "function of time on so": (MatrixSystem(MatrixAlgebra("so", 3), turned), co.IsospectralGauss(2)),
    "numbers": (SPHERE.in_numbers, co.IsospectralGauss(1)),
}
SPANS = {
    "forward": ((0.5, 0.5 + 7 * H), {"save_every": 3}),
    "backward": ((-1.0, -1.0 - 4 * H), {"t_eval": -1.0 - H * np.array([0.0, 0.25, 1.0, 2.75, 4.0])}),
}


def drawn(system, rng, members=()):
    rows = rng.standard_normal((*members, system.dim))
    return system.states(system.to_vector(system.algebra.projected(system.from_vector(rows))))


def real_sum(first, second):
    return float(np.sum(np.real(np.conj(first) * second)))


def functional(outputs, cotangents):
    return sum(real_sum(one, getattr(outputs, name)) for name, one in cotangents.items())


def assert_derivatives(system, method, span, error=DIFFERENCE_ERROR, members=()):
    rng, (ends, points) = np.random.default_rng(7), SPANS[span]
    ready, x0 = co.prepare(system, method, H), drawn(system, rng, members)
    plain = ready.run(x0, ends, **points)
    directions = {"x0": drawn(system, rng, members)}
    directions |= {name: rng.standard_normal(value.shape) for name, value in ready.parameters.items()}
    sol, pullback = ready.vjp(x0, ends, **points)
    again, tangents = ready.jvp(x0, ends, directions, **points)
    for one in (sol, again):
        assert np.array_equal(one.x, plain.x) and np.array_equal(one.energy, plain.energy)
    assert tangents.x.shape == sol.x.shape and tangents.energy.shape == sol.energy.shape
    cotangents = {"x": rng.standard_normal(sol.x.shape), "energy": rng.standard_normal(sol.energy.shape)}
    if np.iscomplexobj(sol.x):
        cotangents["x"] = cotangents["x"] + 1j * rng.standard_normal(sol.x.shape)
    gradient = pullback(**cotangents)
    assert {name: value.shape for name, value in gradient.items()} == {k: np.shape(v) for k, v in directions.items()}
    products = {name: real_sum(gradient[name], direction) for name, direction in directions.items()}
    backward, forward = sum(products.values()), functional(tangents, cotangents)
    size = sum(float(np.sum(np.abs(gradient[name]) * np.abs(directions[name]))) for name in directions)
    assert abs(backward - forward) <= max(2.0**12 * UNIT_ROUNDOFF, error * DISTANCE) * size

    def moved(by):
        values = {name: value + by * directions[name] for name, value in ready.parameters.items()}
        other = co.prepare(with_parameters(system, values) if values else system, method, H)
        return functional(other.run(x0 + by * directions["x0"], ends, **points), cotangents)

    found = sum(w * (moved(k * DISTANCE) - moved(-k * DISTANCE)) / DISTANCE for k, w in enumerate(WEIGHTS, 1))
    assert abs(backward - found) <= error * size


@pytest.mark.parametrize(
    ("name", "span"), [(name, list(SPANS)[k % 2]) for k, name in enumerate(CASES)] + [("sphere, midpoint", "backward")]
)
def test_derivatives_are_those_of_runs(name, span):
    assert_derivatives(*CASES[name], span)


def test_derivatives_of_an_ensemble_are_those_of_runs():
    assert_derivatives(SPHERE, co.IsospectralGauss(1), "forward", members=(2,))


def test_nonlinear_streams_are_differentiated_by_differences():
    system = MatrixSystem(
        MatrixAlgebra("gl", 3), lambda W: W.T @ W @ W.T / 8, energy=lambda W: np.sum((W @ W.T) ** 2) / 32
    )
    # Central differences of order 2 have nine digits.
    assert_derivatives(system, co.IsospectralGauss(2), "forward", error=1e-7)


@dataclasses.dataclass(frozen=True)
class OwnStep(co.methods.StepMethod):
    """The explicit midpoint rule on matrices, with its tangent."""

    order, explicit, symmetric, compiles = 2, True, False, False

    def properties(self, system):
        return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")

    def step(self, system, x, t, h):
        return x + h * system.vector_field(x + h / 2 * system.vector_field(x, t), t + h / 2)

    def tangent(self, system, x, t, h):
        def slope(y, along):
            # The field is quadratic.
            return (system.vector_field(y + along) - system.vector_field(y - along)) / 2

        units = system.to_vector(system.algebra.projected(system.from_vector(np.eye(system.dim))))
        middle = x + h / 2 * system.vector_field(x, t)
        columns = [u + h * slope(middle, u + h / 2 * slope(x, u)) for u in units]
        return self.step(system, x, t, h), np.stack(columns, axis=1)


def test_an_own_scheme_is_differentiated_by_its_tangent():
    body = co.systems.matrix_body((1.0, 2.0, 3.0, 4.0))
    assert_derivatives(body, OwnStep(), "forward")
    assert_derivatives(body, OwnStep(), "backward")


def test_members_have_the_derivatives_of_single_runs():
    rng, method = np.random.default_rng(3), co.LineSplitting()
    ready, x0, direction = co.prepare(TORUS, method, H), drawn(TORUS, rng, (3,)), drawn(TORUS, rng, (3,))
    sol, tangents = ready.jvp(x0, (0.0, 4 * H), {"x0": direction[..., None]})
    _, pullback = ready.vjp(x0, (0.0, 4 * H))
    gradient = pullback(sol.x)["x0"]
    for m in range(3):
        alone, one = ready.jvp(x0[m], (0.0, 4 * H), {"x0": direction[m]})
        assert np.array_equal(tangents.x[:, m, ..., 0], one.x) and np.array_equal(tangents.energy[:, m, 0], one.energy)
        _, pullback = ready.vjp(x0[m], (0.0, 4 * H))
        assert np.array_equal(gradient[m], pullback(alone.x)["x0"])


@pytest.mark.parametrize("name", ["sphere, three stages", "torus by lines", "two layers", "function on sp"])
def test_the_derivative_of_a_step_is_its_matrix(name):
    system, method = CASES[name]
    rng = np.random.default_rng(5)
    x, rows, row = system.to_vector(drawn(system, rng)), rng.standard_normal((3, system.dim)), np.arange(system.dim)
    end, matrix = method.tangent(system, x, 0.5, H)
    step = linearized(method, system, x, 0.5, H)
    tolerance = {"rtol": 0, "atol": 2.0**8 * UNIT_ROUNDOFF * system.dim}
    np.testing.assert_array_equal(step.end, end)
    np.testing.assert_allclose(step.tangents(rows), rows @ matrix.T, **tolerance)
    np.testing.assert_allclose(step.cotangent(row), row @ matrix, **tolerance)


def test_large_matrices_need_no_derivative_with_all_entries():
    """A matrix of derivatives of 7200 numbers would take 400 MB, several times over."""
    system = co.systems.sphere_euler(60)
    rng = np.random.default_rng(2)
    x0, direction = 0.1 * drawn(system, rng), drawn(system, rng)
    ready = co.prepare(system, co.IsospectralGauss(1), 0.01)
    sol, pullback = ready.vjp(x0, (0.0, 0.02))
    gradient = pullback(sol.x)["x0"]
    _, tangents = ready.jvp(x0, (0.0, 0.02), {"x0": direction})
    product = real_sum(gradient, direction)
    size = float(np.sum(np.abs(gradient) * np.abs(direction)))
    assert abs(product - real_sum(sol.x, tangents.x)) <= 2.0**12 * UNIT_ROUNDOFF * size


def test_gradients_of_observed_functions_of_matrices():
    def enstrophy(W):
        return float(np.sum(np.abs(W) ** 2))

    ready = co.prepare(SPHERE, co.IsospectralGauss(1), H, observe={"enstrophy": enstrophy})
    x0 = drawn(SPHERE, np.random.default_rng(4))
    sol, pullback = ready.vjp(x0, (0.0, 4 * H))
    # It is preserved.
    gradient = pullback(observed={"enstrophy": np.ones(len(sol.t))})
    np.testing.assert_allclose(gradient["x0"], 2 * len(sol.t) * x0, rtol=0, atol=1e-7)


def test_directions_and_cotangents_of_other_forms_are_refused():
    ready, x0 = co.prepare(SPHERE, co.IsospectralGauss(1), H), drawn(SPHERE, np.random.default_rng(4))
    with pytest.raises(ValueError, match=r"the direction x0.* is not a matrix of su\(4\): it must be skew-Hermitian"):
        ready.jvp(x0, (0.0, H), {"x0": np.eye(4)})
    with pytest.raises(ValueError, match=r"direction x0 has the shape \(32,\); it must be \(4, 4\)"):
        ready.jvp(x0, (0.0, H), {"x0": np.ones(32)})
    _, pullback = ready.vjp(x0, (0.0, H))
    with pytest.raises(ValueError, match=r"x has the shape \(4, 4\)"):
        pullback(x0)
    body = co.systems.matrix_body((1.0, 2.0, 3.0))
    _, pullback = co.prepare(body, co.IsospectralGauss(1), H).vjp(np.zeros((3, 3)), (0.0, H))
    with pytest.raises(TypeError, match="real"):
        pullback(1j * np.ones((2, 3, 3)))


def test_matrices_that_exceed_the_memory_are_refused_before_they_are_allocated(monkeypatch):
    from coadjoint import memory

    ready, x0 = co.prepare(SPHERE, co.IsospectralGauss(1), H), drawn(SPHERE, np.random.default_rng(4))
    monkeypatch.setattr(memory, "available", lambda: 2**27)
    monkeypatch.setattr(memory, "UNCHECKED_BYTES", 0)
    ready.jvp(x0, (0.0, H), {"x0": np.repeat(x0[..., None], 1000, axis=-1)})
    with pytest.raises(ValueError, match="derivatives of a step along 50000 directions"):
        ready.jvp(x0, (0.0, H), {"x0": np.repeat(x0[..., None], 50000, axis=-1)})
