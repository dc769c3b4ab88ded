"""Arrays of xarray and tables of pandas: used by their names and labels, or refused, never taken by position."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest

import coadjoint as co
from fuzz.calls import ENTRIES, call
from fuzz.values import HOSTILE
from refusals import refused

xarray, pd = pytest.importorskip("xarray"), pytest.importorskip("pandas")
S = co.systems
BODY, TORUS, X = S.rigid_body((1, 2, 3)), S.torus_euler(5), np.array([0.1, 1.0, 0.2])
NAMES, NINE = ["x1", "x2", "x3"], np.arange(9.0).reshape(3, 3) + 1.0
READY = co.prepare(BODY, co.Splitting(), 0.1, inputs=True, attitude=True)
RUN = co.integrate(BODY, X, (0, 2), 0.1, attitude=True)


def with_foreign_labels(array):
    """Return an array with labels that no axis has, in the order from the last, and without labels; and as a table."""
    axes = [f"d{k}" for k in range(array.ndim)]
    labels = {axis: [f"l{i}" for i in reversed(range(n))] for axis, n in zip(axes, array.shape, strict=True)}
    yield xarray.DataArray(array, labels, axes)
    if array.ndim == 1:
        yield pd.Series(array, labels["d0"])
    else:
        yield xarray.DataArray(array, dims=axes)
    if array.ndim == 2:
        yield pd.DataFrame(array, labels["d0"])


@pytest.mark.parametrize("name", ENTRIES)
def test_labels_that_mean_nothing_are_refused_by_every_public_function(name):
    function, known = ENTRIES[name]
    for parameter, value in known.items():
        try:
            array = np.asarray(value)
        except ValueError:  # a ragged list
            continue
        if array.dtype.kind not in "iufc" or array.ndim < 1 or array.size < 2:
            continue
        for labelled in with_foreign_labels(array):
            with warnings.catch_warnings(), pytest.raises((TypeError, ValueError)) as caught:
                warnings.simplefilter("ignore")
                call(function, {**known, parameter: labelled})
                pytest.fail(f"{parameter} is accepted as {type(labelled).__name__}")
            assert "\n" not in str(caught.value), parameter


RANDOM = np.random.default_rng(0)
SPINS = RANDOM.standard_normal((2, 4, 3))
STATES = {
    "a body": (BODY, NINE),
    "a top": (S.heavy_top(), RANDOM.standard_normal((2, 6))),
    "an attitude": (S.body((1, 2, 3)), np.stack([S.body((1, 2, 3)).state(angular_velocity=w) for w in NINE])),
    "spins": (S.spin_lattice("ring", 4), (SPINS / np.linalg.norm(SPINS, axis=-1, keepdims=True)).reshape(2, 12)),
    "a fluid": (TORUS, np.stack([TORUS.random(seed) for seed in (1, 2)])),
    "a planet": (S.sphere_euler(4, rotation=2.0), np.stack([S.sphere_euler(4).random(seed) for seed in (1, 2, 3, 4)])),
    "two fields": (S.reduced_mhd(5, "torus"), np.stack([np.stack([TORUS.random(s), TORUS.random(3)]) for s in (1, 2)])),
}


@pytest.mark.parametrize("name", STATES)
def test_states_are_used_by_their_labels(name):
    """Those of a dataset with its axes and coordinates in another order; an axis of members may be anywhere."""
    system, x0 = STATES[name]
    sol = co.integrate(system, x0, (0, 0.02), 0.01)
    last = sol.to_xarray(grid=False).x.isel(time=-1)
    shuffled = last.transpose(*reversed(last.dims))
    if "component" in last.dims:
        shuffled = shuffled.isel(component=np.roll(np.arange(system.dim), 1))
    for given in (shuffled, shuffled.rename(member="sample"), shuffled.assign_coords(member=range(len(x0)))):
        np.testing.assert_array_equal(co.integrate(system, given, (0, 0.01), 0.01).x0, sol.x[-1])
    np.testing.assert_array_equal(system.energy(shuffled), system.energy(sol.x[-1]))
    np.testing.assert_array_equal(system.vector_field(shuffled.isel(member=1)), system.vector_field(sol.x[-1][1]))
    backward = shuffled.isel(member=slice(None, None, -1)).assign_coords(member=range(len(x0))[::-1])
    np.testing.assert_array_equal(co.integrate(system, backward, (0, 0.01), 0.01).x0, sol.x[-1])


def test_a_square_of_components_and_members_is_not_transposed():
    square = xarray.DataArray(NINE, dims=("component", "member"))
    wanted = NINE.T
    assert np.array_equal(co.integrate(BODY, square, (0, 0.1), 0.1).x0, wanted)
    assert np.array_equal(READY.run(square, (0, 0.1)).x0, wanted)
    assert np.array_equal(co.integrate_ensemble(BODY, square, (0, 0.1), 0.1, threads=1).x0, wanted)
    batch = co.batch([S.rigid_body((1, 2, third)) for third in (2.25, 2.5, 3)])
    members = square.assign_coords(member=[2, 0, 1], component=["x2", "x3", "x1"])
    assert np.array_equal(co.integrate(batch, square, (0, 0.1), 0.1).x0, wanted)
    assert np.array_equal(co.integrate(batch, members, (0, 0.1), 0.1).x0, wanted[[1, 2, 0]][:, [2, 0, 1]])
    family = co.batch(lambda third: S.rigid_body((1, 2, third)), third=[2.25, 2.5, 3])
    of_axis = square.rename(member="third").assign_coords(component=["x2", "x3", "x1"])
    assert np.array_equal(co.integrate(family, of_axis, (0, 0.1), 0.1).x0, wanted[:, [2, 0, 1]])
    assert BODY.energy(square) == pytest.approx([BODY.energy(x) for x in wanted], rel=1e-15)


def test_tables_are_used_by_their_columns():
    table = RUN.to_pandas()
    shuffled = table[["x3", "x1", "x2"]]
    assert np.array_equal(co.integrate(BODY, shuffled, (0, 0.1), 0.1).x0, RUN.x)
    assert np.array_equal(co.integrate(BODY, shuffled.iloc[-1], (0, 0.1), 0.1).x0, RUN.x[-1])
    assert np.array_equal(BODY.energy(shuffled), BODY.energy(RUN.x))
    plain = pd.DataFrame(NINE)
    assert np.array_equal(co.integrate(BODY, plain, (0, 0.1), 0.1).x0, NINE)
    for wrong in (table, shuffled.rename(columns={"x1": "a"}), shuffled.assign(x4=1.0), shuffled[["x1", "x1", "x2"]]):
        with refused(ValueError, "x0", "labels", "component", "x1"):
            co.integrate(BODY, wrong, (0, 0.1), 0.1)


def test_attitudes_and_inputs_are_used_by_their_labels():
    data, order = RUN.to_xarray(), [2, 0, 1]
    attitude = data.attitude.isel(time=-1).transpose()
    linear = xarray.DataArray([0.3, 0.1, 0.2], {"component": ["x3", "x1", "x2"]}, ("component",))
    found = READY.run(X, (0, 1), attitude=attitude, linear=linear)
    wanted = READY.run(X, (0, 1), attitude=RUN.attitude[-1], linear=[0.1, 0.2, 0.3])
    assert np.array_equal(found.attitude, wanted.attitude) and np.array_equal(found.x, wanted.x)
    of_members = xarray.DataArray(NINE, {"member": order}, ("component", "member"))
    wanted = READY.run(NINE, (0, 1), linear=NINE.T[np.argsort(order)])
    assert np.array_equal(READY.run(NINE, (0, 1), linear=of_members).x, wanted.x)
    torque = co.prepare(BODY.with_forces(co.forces.Torque((0, 0, 0))), co.Splitting(), 0.1, inputs={"push": "Torque"})
    assert np.array_equal(torque.run(X, (0, 1), push=linear).x, torque.run(X, (0, 1), push=[0.1, 0.2, 0.3]).x)
    some = co.prepare(BODY, co.Splitting(), 0.1, inputs={"few": [2, 0]})
    assert np.array_equal(some.run(X, (0, 1), few=linear[:2]).x, some.run(X, (0, 1), few=[0.3, 0.1]).x)


def test_measurements_of_a_fit_are_used_by_their_labels():
    ready, data = co.prepare(BODY, co.Splitting(), 0.1, attitude=True), RUN.to_xarray()
    guess, unknown, sigma = X + 0.01, {"x0": True}, {"x": 1e-6, "attitude": 1e-6}
    measured = {"x": RUN.x, "attitude": RUN.attitude}
    plain = co.fit(ready, guess, (0, 2), measured, unknown, sigma=sigma)
    shuffled = data.isel(component=[2, 0, 1], time=slice(None, None, -1)).transpose("column", "component", ...)
    by_label = {"x": shuffled.x, "attitude": shuffled.attitude}
    of_table = {"x": RUN.to_pandas()[["x2", "x1", "x3"]], "attitude": RUN.attitude}
    for given in (by_label, of_table):
        found = co.fit(ready, guess, (0, 2), given, unknown, sigma=sigma)
        assert np.array_equal(found.values["x0"], plain.values["x0"])
    np.testing.assert_allclose(plain.values["x0"], X, rtol=0, atol=1e-9)
    with refused(ValueError, "measured x", "labels", "time"):
        late = {"x": shuffled.x.assign_coords(time=shuffled.time + 0.1)}
        co.fit(ready, guess, (0, 2), late, unknown, sigma=sigma)


WRONG = {
    "dimensions": (xarray.DataArray(NINE, dims=("a", "b")), ("'a'", "component", "to_numpy")),
    "one dimension": (xarray.DataArray(X, dims="member"), ("'member'", "component")),
    "twice": (xarray.DataArray(X, {"component": ["x1", "x1", "x2"]}, ("component",)), ("labels", "x1")),
    "labels": (xarray.DataArray(X, {"component": ["m1", "m2", "m3"]}, ("component",)), ("labels", "m1", "x1")),
    "members": (xarray.DataArray(NINE, {"member": [5, 6, 7]}, ("member", "component")), ("labels", "member", "0, 1")),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_states_with_other_labels_are_refused(case):
    given, named = WRONG[case]
    step = co.stepper(BODY, co.Splitting(), 0.1)
    for run in (lambda x: co.integrate(BODY, x, (0, 1), 0.1), lambda x: READY.run(x, (0, 1)), step):
        with refused(ValueError, "x", *named):
            run(given)


def test_many_labels_and_labels_with_units():
    """The time is proportional to the number of labels; of a quantity the unit would be lost."""
    order = np.random.default_rng(0).permutation(30_000)
    many = xarray.DataArray(X + 1e-6 * order[:, None], {"member": order}, ("member", "component"))
    assert np.array_equal(BODY.energy(many[:3].drop_vars("member")), BODY.energy(many.values[:3]))
    started = co.prepare(BODY, co.Splitting(), 0.1, watch=False).run(many, (0, 0.1)).x0
    assert np.array_equal(started, X + 1e-6 * np.arange(30_000)[:, None])
    with refused(TypeError, "units"):
        co.Quadratic(SimpleNamespace(dims=("k",), coords={}, data=HOSTILE["a quantity"]))


def test_arrays_of_jax_have_no_labels():
    jax = pytest.importorskip("jax")
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    solution = co.jax.solution(co.prepare(BODY, co.Splitting(), 0.1), (0, 1))
    labelled = pd.Series(X, NAMES)
    for wrong in (
        lambda: solution(labelled),
        lambda: co.jax.free_body(labelled, np.eye(3), np.array([1.0, 2, 3]), 0.1),
    ):
        with refused(TypeError, "x", "labels", "to_numpy"):
            wrong()
    jax.config.update("jax_enable_x64", before)


def test_labels_that_say_nothing_else_are_accepted():
    """Those of a coordinate itself, 0, 1, 2, ..., names by default, and the labels of one point of a dataset."""
    times = RUN.to_xarray().time[::5]
    assert co.integrate(BODY, X, (0, 2), 0.1, t_eval=times).t.tolist() == times.values.tolist()
    for same in (pd.Series([1.0, 2.0, 3.0]), xarray.DataArray([1.0, 2.0, 3.0], {"k": [0, 1, 2]}, ("k",))):
        assert co.Quadratic(same).gradient(np.ones(3)).tolist() == [1.0, 2.0, 3.0]
    assert co.Quadratic(xarray.DataArray(np.diag(X))).gradient(np.ones(3)).tolist() == X.tolist()
    thirds = xarray.DataArray([2.5, 3.0], {"third": [2.5, 3.0]})
    assert len(co.batch(lambda third: S.rigid_body((1, 2, third)), third=thirds)) == 2
