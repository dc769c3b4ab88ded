"""Inputs of prepared runs: names and shapes."""

import numpy as np
import pytest

import coadjoint as co
from own_schemes import Classical, Interpreted
from refusals import refused

pytestmark = pytest.mark.thinned(3)

U, STEP, SPANS = 2.0**-53, 0.0625, ((0.0, 0.5), (0.5, 0.0))


def spins(count):
    """A chain of spins with exchange and anisotropy, a field on each."""
    M = np.diag(np.tile([1.2, 1.4, 1.7], count))
    for s in range(count - 1):
        for k in range(3):
            M[3 * s + k, 3 * s + 3 + k] = M[3 * s + 3 + k, 3 * s + k] = -0.5
    return co.algebras.copies(co.algebras.so(3), count), M


def test_inputs_of_steps_in_python():
    """What the loops read from tables may be given; a step that is called in Python has the system in it."""
    x, linear = np.array([0.4, -0.3, 0.5]), np.array([0.1, 0.0, -0.4])
    body, N = co.systems.rigid_body((1, 2, 3)), np.array([0.2, 0.7, -0.1])
    with refused(ValueError, "Interpreted", "tables.whole"), pytest.warns(RuntimeWarning, match="Python calls"):
        co.prepare(body, Interpreted(), STEP, inputs=True)
    pushed = body.with_forces(co.forces.Torque((0, 0, 0)))
    ready = co.prepare(pushed, Interpreted(), STEP, inputs={"N": "Torque"})
    alone = co.integrate(body.with_forces(co.forces.Torque(N)), x, SPANS[0], STEP, Interpreted())
    assert np.array_equal(ready.run(x, SPANS[0], N=N).x, alone.x)
    pytest.importorskip("numba")
    changed = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 1 / 3], linear=linear), -1)
    run = co.prepare(body, Classical(), STEP, inputs=True).run(x, SPANS[0], linear=linear)
    assert np.array_equal(run.x, co.integrate(changed, x, SPANS[0], STEP, Classical()).x)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("method", [co.GaussLegendre(2), co.Splitting(order=2)], ids=str)
def test_functions_of_coordinates_keep_their_derivatives_beside_inputs(method):
    """Runs, their systems and tangents as those of the sum of the functions and the linear term."""
    H = co.Separable({0: (np.cosh, np.sinh, np.cosh), 2: (lambda y: y**4, lambda y: 4 * y**3, lambda y: 12 * y**2)})
    x, linear = np.array([0.4, -0.3, 0.5]), np.array([0.1, 0.2, -0.4])
    ready = co.prepare(co.LiePoissonSystem(co.algebras.so(3), H), method, STEP, inputs=True)
    run = ready.run(x, SPANS[0], linear=linear)
    field, h = run.system.vector_field, 2.0**-13
    near = [(field(x + d) - field(x - d)) / (2 * h) for d in h * np.eye(3)]
    np.testing.assert_allclose(run.system.jacobian(x), np.transpose(near), atol=1e-7)
    np.testing.assert_allclose(run.system.hamiltonian.hessian(x), np.diag([np.cosh(0.4), 0.0, 3.0]), rtol=1e-15)


def test_coefficients_that_other_terms_share_are_refused():
    """A linear coefficient that is the sum of several, and coordinates that squares of two terms contain."""
    piece = co.SplitHamiltonian([((0,), co.Quadratic(0.3, linear=[0.25]))])
    twice = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([0.5, 0.6, 0.7]) + piece)
    for method in (co.GaussLegendre(2), co.Taylor(6), co.Splitting(order=2)):
        with refused(ValueError, "takes no inputs", "offset", "neither inputs nor exact sums"):
            co.prepare(twice, method, STEP, inputs=True)
    co.prepare(twice, co.GaussLegendre(2), STEP, inputs=(1, 2))
    pieces = co.SplitHamiltonian([((0,), co.Quadratic(0.3)), ((1,), co.Quadratic(0.4))])
    coupled = co.Quadratic([[0.5, 0.1, 0.0], [0.1, 0.6, 0.0], [0.0, 0.0, 0.7]]) + pieces
    both = co.LiePoissonSystem(co.algebras.so(3), coupled)
    with refused(ValueError, "takes no inputs", "offset", "neither inputs nor exact sums"):
        co.prepare(both, co.Splitting(order=2, parts="coordinates"), STEP, inputs=True)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("method", [co.GaussLegendre(2), co.ExplicitRungeKutta()], ids=str)
@pytest.mark.parametrize("kind", ["quadratic", "polynomial", "separable", "split"])
def test_inputs_replace_the_linear_term_beside_pieces_that_have_their_own(kind, method):
    """Those of a piece stay, and are not counted twice."""
    x, linear = np.array([0.4, -0.3, 0.5]), np.array([0.2, -0.3])
    piece = co.SplitHamiltonian([((0,), co.Quadratic(0.3, linear=[0.25]))])
    first = {
        "quadratic": lambda: co.Quadratic([0.5, 0.6, 0.7], linear=[0.0, 0.1, 0.0]),
        "polynomial": lambda: co.Polynomial("0.3*x1^2 + 0.25*x2^4 + x1*x2*x3 + 0.1*x2", dim=3),
        "separable": lambda: co.Separable({1: (np.cosh, np.sinh, np.cosh)}),
        "split": lambda: co.SplitHamiltonian([((2,), co.Quadratic(0.4, linear=[0.15]))]),
    }[kind]()
    given = co.LiePoissonSystem(co.algebras.so(3), first + piece)
    run = co.prepare(given, method, STEP, inputs=(1, 2)).run(x, SPANS[0], linear=linear)
    own = {"quadratic": [0.0, 0.1, 0.0], "polynomial": [0.0, 0.1, 0.0], "split": [0.0, 0.0, 0.15]}.get(
        kind, np.zeros(3)
    )
    change = np.array([0.0, *linear]) - own
    wanted = co.LiePoissonSystem(co.algebras.so(3), first + piece + co.Quadratic(0.0, linear=change))
    np.testing.assert_allclose(run.x, co.integrate(wanted, x, SPANS[0], STEP, method).x, rtol=0, atol=1e-13)
    np.testing.assert_allclose(run.system.vector_field(x), wanted.vector_field(x), rtol=0, atol=16 * U)


def test_named_inputs_take_coordinates_in_any_shape():
    algebra, M = spins(3)
    chain, x = co.LiePoissonSystem(algebra, co.Quadratic(M, linear=np.full(9, 0.1))), np.linspace(0.3, 0.9, 9)
    ready = co.prepare(chain, co.Splitting(order=2), STEP, inputs={"ends": [[0, 1, 2], [8, 7, 6]], "middle": (4,)})
    ends = np.arange(6.0).reshape(2, 3) / 7
    linear = np.full(9, 0.1)
    linear[[0, 1, 2, 8, 7, 6]], linear[4] = ends.ravel(), -0.3
    sol = ready.run(x, SPANS[0], ends=ends, middle=[-0.3])
    changed = co.LiePoissonSystem(algebra, co.Quadratic(M, linear=linear))
    assert np.array_equal(sol.x, co.integrate(changed, x, SPANS[0], STEP, ready.method).x)
    assert sol.energy[-1] == pytest.approx(sol.system.energy(sol.x[-1]), rel=1e-13)
    several = ready.run(x, SPANS[0], ends=np.stack([ends, 2 * ends]), middle=[-0.3])
    assert np.array_equal(several.x[:, 0], sol.x)
    assert np.array_equal(several.x[:, 1], ready.run(x, SPANS[0], ends=2 * ends, middle=[-0.3]).x)


@pytest.mark.parametrize("name", ["satellite", "decorated_particles", "rigid_body", "heavy_top"])
def test_systems_of_runs_with_inputs_have_a_field_of_their_own(name):
    """Also if that of the system without them was computed before: products that cancel there are left out of it."""
    system = co.systems.get(name)
    x, linear = np.cos(1.0 + np.arange(system.dim)), np.sin(1.0 + np.arange(system.dim))
    if "z" in system.casimirs:
        x[np.argmax(np.abs(system.casimirs["z"].gradient(x)))] = 1.0  # where positions and momenta are canonical
    before = system.vector_field(x)
    run = co.prepare(system, co.GaussLegendre(2), 2.0**-9, inputs=True).run(x, (0.0, 2.0**-9), linear=linear)
    expected = run.system.sign * run.system.structure_matrix(x) @ run.system.hamiltonian.gradient(x)
    assert np.abs(run.system.vector_field(x) - expected).max() < 64 * U * np.abs(expected).max()
    assert np.array_equal(system.vector_field(x), before)


def test_a_quotient_by_a_tensor_is_no_ensemble():
    """One value for three coordinates and values for three members have the same shape with x0 for each member only."""
    tensor, k, x = np.array([[1.0, 0.1, 0.2], [0.1, 1.8, 0.3], [0.2, 0.3, 2.4]]), np.array([0.1, 0.2, 0.3]), np.ones(3)
    body = co.systems.rigid_body(tensor)
    ready = co.prepare(body, co.GaussLegendre(2), 0.1, inputs=True)
    step = co.stepper(body, co.GaussLegendre(2), 0.1, inputs=True)
    pushed = body.with_forces(co.forces.Torque((0, 0, 0)))
    torque = co.prepare(pushed, None, 0.1, inputs={"torque": "Torque"})
    calls = (
        (lambda x: ready.run(x, (0, 1), linear=-k / tensor), "linear"),
        (lambda x: ready.jvp(x, (0, 1), {"x0": x}, linear=-k / tensor), "linear"),
        (lambda x: step(x, linear=-k / tensor), "linear"),
        (lambda x: torque.run(x, (0, 1), torque=-k / tensor), "torque"),
    )
    for call, name in calls:
        with refused(ValueError, f"{name} has the shape (3, 3)", "one state", "(3,)"):
            call(x)
        call(np.ones((3, 3)))
    assert ready.run(x, (0, 1), linear=np.ones((4, 3))).x.shape == (11, 4, 3)
    both = co.prepare(pushed, None, 0.1, inputs={"bias": (0, 2), "torque": "Torque"})
    for given in ({}, {"bias": np.ones(2)}):
        with refused(ValueError, "torque has the shape (3, 3)", "one state"):
            both.run(x, (0, 1), torque=-k / tensor, **given)
    members = both.run(x, (0, 1), torque=-k / tensor, bias=np.ones((3, 2)))  # the shape of bias is no matrix
    assert members.x.shape == (11, 3, 3)
    one = co.prepare(body, None, 0.1, inputs={"bias": (1,)})
    assert one.run(x, (0, 1), bias=np.ones((1, 1))).x.shape == (11, 1, 3)


def of_inputs(name):
    """A prepared run with inputs, a state, and the values of all inputs for one call, or for two members."""
    linear = np.array([0.1, -0.2, 0.3])
    if name == "torque too":
        forced = co.systems.rigid_body().with_forces(co.forces.Torque((0, 0, 0)))
        inputs = {"thrust": "Torque", "linear": (0, 1, 2)}
        return (
            co.prepare(forced, co.Splitting(2), 0.1, inputs=inputs),
            (1, 0.2, 0.1),
            {"thrust": linear, "linear": linear},
        )
    system = {
        "gyrostat": lambda: co.systems.gyrostat((1, 2, 3), (0.1, 0.2, 0.3)),
        "heavy_top": co.systems.heavy_top,
        "body": lambda: co.systems.body((1.0, 2.0, 2.5)),
        "members": co.systems.rigid_body,
    }[name]()
    x0 = {"body": lambda: system.state(angular_velocity=(1, 0.2, 0.1)), "heavy_top": lambda: (1, 0.2, 0.1, 0, 0, 1)}
    value = np.stack([linear, 2 * linear]) if name == "members" else linear
    start = x0.get(name, lambda: (1, 0.2, 0.1))()
    return co.prepare(system, co.Splitting(2), 0.1, inputs={"field": (0, 1, 2)}), start, {"field": value}


@pytest.mark.parametrize("name", ["gyrostat", "heavy_top", "body", "members", "torque too"])
def test_stored_runs_with_inputs_have_the_attributes_of_their_system(name, tmp_path):
    """Loaded and rebuilt, also from an archive, they are bodies, whose velocity depends on the inputs."""
    ready, x0, values = of_inputs(name)
    sol = ready.run(x0, (0, 1), **values)
    sol.to_xarray().to_netcdf(tmp_path / "run.nc")
    loaded, again = co.load(tmp_path / "run.nc"), co.results.rebuild(sol.to_xarray())
    for other in (loaded, again):
        np.testing.assert_array_equal(other.x, sol.x)
        for attribute in ("angular_velocity", "angular_momentum"):
            np.testing.assert_array_equal(getattr(other, attribute), getattr(sol, attribute))
        first, original = other.system.of_member(0).unforced, sol.system.of_member(0).unforced
        assert type(first) is type(original) and first.parameters is None
    if name == "members":
        coordinates = sol.to_xarray().coords
        assert coordinates["swept_linear_1"].values.tolist() == [-0.2, -0.4]
    if name == "gyrostat":
        np.testing.assert_allclose(loaded.angular_velocity[0], x0 / np.array([1, 2, 3]) + values["field"], rtol=1e-15)
