"""Inputs of batches: each member has its own system and its own values; and inputs of final states."""

import pickle

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(3)

STEP, FORWARD, BACKWARD = 0.0625, (0.0, 1.0), (1.5, 0.5)
RNG = np.random.default_rng(5)
TENSOR = np.array([[1.0, 0.1, 0.2], [0.1, 1.8, 0.3], [0.2, 0.3, 2.4]])
BODY = co.systems.rigid_body((1, 2, 3))


def pushed(third, torque=(0, 0, 0), rate=0.1):
    """A body with friction and a torque."""
    return co.systems.rigid_body((2, 2.5, third)).with_forces(co.forces.LinearDamping(rate), co.forces.Torque(torque))


# Systems, and inputs with the shape of their values.
BATCHES = {
    "coefficients": ([co.systems.rigid_body((2, 2.5, third)) for third in (2.5, 2.75, 3, 3.5)], True, {"linear": (3,)}),
    # Of these the first and the last are one system, and no two have parts of the same form.
    "other structures": (
        [BODY, co.systems.rigid_body(TENSOR), co.systems.rigid_body((1, 1, 2)), BODY],
        {"rotors": (0, 2)},
        {"rotors": (2,)},
    ),
    "one of some": ([co.systems.heavy_top((2, 2.5, k), (0, 0.1, 1)) for k in (2, 3)], (4,), {"linear": (1,)}),
    "torques": (
        [pushed(2.5), pushed(3, (0.1, 0, 0)), pushed(3, rate=0.3)],
        {"thrust": "Torque", "rotors": (0, 1, 2)},
        {"thrust": (3,), "rotors": (3,)},
    ),
    "more than lanes": ([co.systems.rigid_body((2, 2.5, 2.5 + k / 64)) for k in range(40)], True, {"linear": (3,)}),
}
SCHEMES = {
    "flows": co.Splitting(),
    "composed": co.Splitting(order=4),
    "coordinates": co.Splitting(order=2, parts="coordinates"),
    "Runge-Kutta": co.GaussLegendre(2),
    "explicit": co.ExplicitRungeKutta(),
    "Taylor": co.Taylor(6),
    "tables of each": co.ReversibleSteps(co.Splitting(order=2)),
}


def drawn(name):
    """Return the batch, states, inputs, and values for all members, for each of them, or for some inputs."""
    systems, inputs, shapes = BATCHES[name]
    x = RNG.uniform(0.3, 0.9, (len(systems), systems[0].dim))
    common = {key: RNG.uniform(-0.3, 0.3, shape) for key, shape in shapes.items()}
    each = {key: RNG.uniform(-0.3, 0.3, (len(systems), *shape)) for key, shape in shapes.items()}
    first = next(iter(shapes))
    return co.batch(systems), x, inputs, [common, each, {first: each[first]}, {**common, first: each[first]}]


def of_member(values, shapes, m):
    """Return the values of one member."""
    return {key: value[m] if value.ndim > len(shapes[key]) else value for key, value in values.items()}


@pytest.mark.parametrize("span", [FORWARD, BACKWARD], ids=["forward", "backward"])
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", BATCHES)
@pytest.mark.thinned(6)
def test_members_have_the_bits_of_systems_with_their_values(name, scheme, span):
    """Those of the batch with the values written in, of each member prepared alone, and of any threads."""
    batch, x, inputs, calls = drawn(name)
    ready = co.prepare(batch, SCHEMES[scheme], STEP, inputs=inputs, threads=1)
    several = co.prepare(batch, SCHEMES[scheme], STEP, inputs=inputs, threads=2)
    alone = {m: co.prepare(batch[m], SCHEMES[scheme], STEP, inputs=inputs) for m in (0, 1, len(batch) - 1)}
    for start in (x, x[0]):
        for values in (*calls, {}):
            sol = ready.run(start, span, **values)
            if values or scheme != "coordinates":  # there, a part is left out where a coefficient is zero
                again = co.integrate(sol.system, start, span, STEP, sol.method)
                assert np.array_equal(sol.x, again.x) and np.array_equal(sol.energy, again.energy)
            assert np.array_equal(several.run(start, span, **values).x, sol.x)
            assert np.array_equal(ready.end(start, span, **values), sol.x[-1])
            for m, one in alone.items():
                own = np.broadcast_to(start, x.shape)[m], span
                assert np.array_equal(one.run(*own, **of_member(values, BATCHES[name][2], m)).x, sol.x[:, m])
                assert np.array_equal(one.end(*own, **of_member(values, BATCHES[name][2], m)), sol.x[-1, m])


def test_parts_are_those_for_the_inputs_of_the_first_member():
    """Where the parts of members differ, a scheme that is stored with the run has one rule for all."""
    batch = co.batch([co.systems.gyrostat((2, 3, 4 + k / 2), (0.1, 0.5 * k, 0.3)) for k in range(3)])
    ready = co.prepare(batch, co.Splitting(order=4), STEP, inputs=True)
    assert ready.method.parts.at == (-0.1 / 2, 0.0, -0.3 / 4) and ready.method.parts.linear == (0, 1, 2)
    x, values = RNG.normal(size=(2, 3, 3))
    sol = ready.run(x, FORWARD, linear=values)
    for m in range(3):
        one = co.prepare(batch[m], ready.method, STEP, inputs=True)
        assert np.array_equal(one.run(x[m], FORWARD, linear=values[m]).x, sol.x[:, m])
    assert str(ready.method.parts) == str(co.prepare(batch, ready.method, STEP, inputs=True).method.parts)
    rebuilt = co.results.rebuild(sol.to_xarray())
    assert np.array_equal(rebuilt.x, sol.x) and rebuilt.method == sol.method
    assert np.array_equal(ready.run(x, FORWARD).x, co.integrate(batch, x, FORWARD, STEP, ready.method).x)
    for parts in ({"linear": [0], "at": [0.1, 0.2]}, {"linear": [0], "at": [0.1], "order": [0, 1]}, {"linear": [0]}):
        with refused(ValueError, "parts has", "at"):
            co.Splitting(parts=parts)


@pytest.mark.parametrize("scheme", ["flows", "Runge-Kutta"])
def test_parts_of_a_batch_and_copies(scheme):
    """Members that are taken out, with their noise, and pickles."""
    heated = [
        co.systems.rigid_body((2, 2.5, 3 + k / 4)).with_forces(
            co.forces.HeatBath(0.1, 0.2, seed=3), co.forces.Torque((0, 0, 0))
        )
        for k in range(3)
    ]
    for systems, name in ((heated, "Torque"), (BATCHES["coefficients"][0][:3], (0, 1, 2))):
        ready = co.prepare(co.batch(systems), SCHEMES[scheme], STEP, inputs={"u": name})
        x, u = RNG.uniform(0.3, 0.9, (2, 3, 3))
        sol = ready.run(x, FORWARD, u=u)
        assert np.array_equal(sol.x, co.integrate(sol.system, x, FORWARD, STEP, sol.method).x)
        assert np.array_equal(ready.among(1, 3).run(x[1:], FORWARD, u=u[1:]).x, sol.x[:, 1:])
        assert np.array_equal(pickle.loads(pickle.dumps(ready)).run(x, FORWARD, u=u).x, sol.x)
    some = [2, 0, 2]
    assert np.array_equal(ready.sampled(np.array(some)).run(x[some], FORWARD, u=u[some]).x, sol.x[:, some])
    one = co.prepare(heated[0], SCHEMES[scheme], STEP, inputs={"u": "Torque"})
    assert np.array_equal(one.among(1, 3).run(x[1:], FORWARD, u=u[1:]).x, one.run(x, FORWARD, u=u).x[:, 1:])


@pytest.mark.parametrize("scheme", ["flows", "Runge-Kutta"])
def test_gradients_by_shared_inputs_add_up_over_starts(scheme):
    """Of one system from several starts; inputs of each start have gradients of their own."""
    ready = co.prepare(pushed(3), SCHEMES[scheme], STEP, inputs={"thrust": "Torque"})
    rng = np.random.default_rng(7)
    x, u = rng.uniform(0.3, 0.9, (3, 3)), rng.uniform(-0.3, 0.3, 3)
    sol, pullback = ready.vjp(x, FORWARD, thrust=u)
    weights = rng.normal(size=sol.x.shape)
    of_each = [ready.vjp(x[m], FORWARD, thrust=u)[1](x=weights[:, m])["inputs"]["thrust"] for m in range(3)]
    np.testing.assert_allclose(pullback(x=weights)["inputs"]["thrust"], sum(of_each), rtol=1e-12)
    _, pullback = ready.vjp(x, FORWARD, thrust=np.tile(u, (3, 1)))
    np.testing.assert_allclose(pullback(x=weights)["inputs"]["thrust"], of_each, rtol=1e-12)


def test_labelled_values_have_the_order_of_members():
    xarray = pytest.importorskip("xarray")
    batch, x, inputs, (_, each, *_) = drawn("coefficients")
    order, names = [2, 0, 3, 1], ["x2", "x3", "x1"]
    ready = co.prepare(batch, None, STEP, inputs=inputs)
    shuffled = each["linear"][order][:, [1, 2, 0]]
    labelled = xarray.DataArray(shuffled.T, {"member": order, "component": names}, ("component", "member"))
    assert np.array_equal(ready.run(x, FORWARD, linear=labelled).x, ready.run(x, FORWARD, **each).x)
    family = co.batch(lambda third: co.systems.rigid_body((2, 2.5, third)), third=[2.5, 2.75, 3.0, 3.5])
    of_axis = labelled.rename(member="third").assign_coords(third=np.array([2.5, 2.75, 3.0, 3.5])[order])
    sol = co.prepare(family, None, STEP, inputs=inputs).run(x, FORWARD, linear=of_axis)
    assert np.array_equal(sol.x, ready.run(x, FORWARD, **each).x) and sol.to_xarray().x.dims[1] == "third"
    with refused(ValueError, "linear", "labels", "m1"):
        ready.run(x, FORWARD, linear=labelled.assign_coords(component=["m1", "m2", "m3"]))


def test_wrong_inputs_of_batches_are_refused_by_name():
    batch, x, _, _ = drawn("torques")
    ready = co.prepare(batch, None, STEP, inputs={"thrust": "Torque"})
    for shape in ((2,), (2, 3), (4, 3), (3, 2), (1, 3), (3, 3, 3), ()):
        for call in (ready.run, ready.end, lambda *given, **inputs: ready.jvp(*given, {"x0": x}, **inputs)):
            with refused(ValueError, f"thrust has the shape {shape}", "(3,)", "(3, 3)"):
                call(x, FORWARD, thrust=np.ones(shape))
    with refused(ValueError, "thrust", "NaN"):
        ready.end(x, FORWARD, thrust=np.full((3, 3), np.nan))
    with refused(ValueError, "rotor", "thrust"):
        ready.end(x, FORWARD, rotor=np.ones(3))
    with refused(TypeError, "'thrust'", "without inputs"):
        co.prepare(BODY, None, STEP).end(x[0], FORWARD, thrust=np.ones(3))
    called = co.systems.rigid_body((1, 2, 3)).with_forces(co.forces.LinearDamping(0.1), co.forces.Torque(np.sin))
    with refused(TypeError, "member 1 of the batch", "thrust", "constant"):
        co.prepare(co.batch([batch[0], called]), None, STEP, inputs={"thrust": "Torque"})
    function = co.LiePoissonSystem(co.algebras.so(3), lambda x: x @ x + x[0] * x[1], -1)
    with refused(TypeError, "member 2 of the batch", "linear term"):
        co.prepare(co.batch([BODY, BODY, function]), co.GaussLegendre(2), STEP, inputs=True)
    twice = co.Quadratic([0.5, 0.6, 0.7]) + co.SplitHamiltonian([((0,), co.Quadratic(0.3, linear=[0.25]))])
    with refused(ValueError, "member 1 of the batch", "takes no inputs", "offset"):
        tangled = co.batch([BODY, co.LiePoissonSystem(co.algebras.so(3), twice, -1)])
        co.prepare(tangled, co.GaussLegendre(2), STEP, inputs=True)


def test_a_failing_member_leaves_the_others():
    """A linear term that overflows at the end of one member."""
    batch, x, inputs, _ = drawn("coefficients")
    values = np.zeros((4, 3))
    values[2] = 1e200
    ready = co.prepare(batch, co.ExplicitRungeKutta(), STEP, inputs=inputs)
    with pytest.raises(co.IntegrationError) as caught:
        ready.run(x, FORWARD, linear=values)
    rest = [0, 1, 3]
    kept = co.prepare(co.batch([batch[m] for m in rest]), co.ExplicitRungeKutta(), STEP, inputs=inputs)
    assert np.array_equal(caught.value.partial.x[:, rest], kept.run(x[rest], FORWARD, linear=values[rest]).x)
    with pytest.raises(co.IntegrationError):
        ready.end(x, FORWARD, linear=values)


@pytest.mark.parametrize("scheme", ["flows", "Runge-Kutta"])
@pytest.mark.parametrize("name", ["coefficients", "other structures", "torques"])
def test_derivatives_by_inputs_of_members(name, scheme):
    """By central differences, by the other mode, and bit for bit those of each member alone."""
    batch, x, inputs, (*_, values) = drawn(name)
    count, shapes, short = len(batch), BATCHES[name][2], (0.0, 0.25)
    ready = co.prepare(batch, SCHEMES[scheme], STEP, inputs=inputs)
    along = {key: RNG.normal(size=value.shape) for key, value in values.items()}
    move = RNG.normal(size=x.shape)
    sol, tangents = ready.jvp(x, short, {"x0": move, "inputs": along}, **values)
    h = 2.0**-17
    near = [
        ready.run(x + by * move, short, **{key: value + by * along[key] for key, value in values.items()})
        for by in (-h, h)
    ]
    for part in ("x", "energy"):
        before, after = (getattr(one, part) for one in near)
        found = getattr(tangents, part)
        # The error of the difference: h^2 / 6 times a third derivative, and the round-off of the states over h.
        np.testing.assert_allclose(found, (after - before) / (2 * h), rtol=0, atol=1e3 * (h**2 + 2.0**-53 / h))
    pulled, pullback = ready.vjp(x, short, **values)
    weights = RNG.normal(size=sol.x.shape)
    gradient = pullback(x=weights)
    pairs = [(gradient["x0"], move), *((gradient["inputs"][key], along[key]) for key in along)]
    expected = sum(np.vdot(one, other) for one, other in pairs)
    # Derivatives of steps in Python are central differences of order 8, of about twelve digits.
    assert np.vdot(weights, tangents.x) == pytest.approx(expected, abs=1e-10 * np.abs(weights * tangents.x).sum())
    assert np.array_equal(sol.x, pulled.x) and np.array_equal(sol.x, ready.run(x, short, **values).x)
    totals = {key: np.zeros(shape) for key, shape in shapes.items()}
    for m in range(count):
        one = co.prepare(batch[m], SCHEMES[scheme], STEP, inputs=inputs)
        alone, pull = one.vjp(x[m], short, **of_member(values, shapes, m))
        by = pull(x=weights[:, m])
        assert np.array_equal(alone.x, sol.x[:, m]) and np.array_equal(by["x0"], gradient["x0"][m])
        for parameter in ready.parameters:
            assert np.array_equal(by[parameter], gradient[parameter][m])
        for key, value in values.items():
            totals[key] += by["inputs"][key]
            if value.ndim > len(shapes[key]):
                assert np.array_equal(by["inputs"][key], gradient["inputs"][key][m])
    for key, value in values.items():
        if value.ndim == len(shapes[key]):
            np.testing.assert_allclose(gradient["inputs"][key], totals[key], rtol=1e-13)
    for wrong in ({"inputs": {"other": 1.0}}, {"inputs": {key: np.ones((7, 7)) for key in values}}):
        with refused(ValueError, next(iter(wrong["inputs"]))):
            ready.jvp(x, short, wrong, **values)
