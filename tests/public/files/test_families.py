"""Families: parameters and initial states in one call, with named dimensions, on threads, workers and in archives."""

import numpy as np
import pytest
import xarray

import coadjoint as co

SPAN, STEP = (0.0, 1.0), 0.125
THIRDS, ENERGIES = [2.5, 2.75, 3.0], [0.5, 1.0]


def body(third):
    return co.systems.rigid_body(inertia=(1.0, 2.0, third))


def family():
    return co.batch(body, third=THIRDS)


def states(*shape, seed=1):
    return np.random.default_rng(seed).standard_normal((*shape, 3))


def labelled(*names, **coordinates):
    lengths = {"third": 3, "energy": 2, "member": 5, "component": 3}
    return xarray.DataArray(states(*(lengths[name] for name in names[:-1])), dims=names, coords=coordinates)


X0 = labelled("energy", "member", "component", energy=ENERGIES)


def alone(third, x):
    return co.integrate(body(third), x, SPAN, STEP)


def check_against_single_runs(dataset):
    """Every combination has the bits of its run alone."""
    assert dict(dataset["x"].sizes) == {"time": 9, "third": 3, "energy": 2, "member": 5, "component": 3}
    for third in THIRDS:
        for energy in ENERGIES:
            part = dataset.sel(third=third, energy=energy)
            for member in range(5):
                run = alone(third, X0.sel(energy=energy).values[member])
                np.testing.assert_array_equal(part["x"][:, member], run.x)
                np.testing.assert_array_equal(part["energy_values"][:, member], run.energy)
                np.testing.assert_array_equal(part["casimir_x_2"][:, member], run.casimirs["|x|^2"])


RUNS = {
    "in memory": lambda path: co.integrate(family(), X0, SPAN, STEP),
    "three threads": lambda path: co.integrate(family(), X0, SPAN, STEP, threads=3),
    "archive": lambda path: co.integrate(family(), X0, SPAN, STEP, archive=path),
    "blocks": lambda path: co.integrate_ensemble(family(), X0, SPAN, STEP, members_per_block=7, archive=path),
}


@pytest.mark.parametrize("run", RUNS)
def test_every_system_runs_from_every_state(run, tmp_path):
    check_against_single_runs(RUNS[run](tmp_path / "run.zarr").to_xarray())


def test_plain_arrays_of_states():
    """States for all systems have the axis `member`; those for each have the axes in front; one state has none."""
    x0 = states(4)
    shared = co.integrate(family(), x0, SPAN, STEP).to_xarray()
    assert shared["x"].dims == ("time", "third", "member", "component")
    np.testing.assert_array_equal(shared["x"].sel(third=2.75)[:, 3], alone(2.75, x0[3]).x)
    own = states(3, 4)
    each = co.integrate(family(), own, SPAN, STEP).to_xarray()
    np.testing.assert_array_equal(each["x"].sel(third=3.0)[:, 1], alone(3.0, own[2, 1]).x)
    one = co.integrate(family(), x0[0], SPAN, STEP).to_xarray()
    assert one["x"].dims == ("time", "third", "component")
    # Three states for three systems are nine members, not three.
    assert co.integrate(family(), x0[:3], SPAN, STEP).x.shape == (9, 9, 3)


def test_states_named_after_an_axis_of_the_batch_belong_to_its_systems():
    x0 = labelled("member", "third", "component", third=THIRDS)
    sol = co.integrate(family(), x0, SPAN, STEP)
    dataset = sol.to_xarray()
    assert dataset["x"].dims == ("time", "third", "member", "component")
    np.testing.assert_array_equal(dataset["x"].sel(third=2.75)[:, 4], alone(2.75, x0.values[4, 1]).x)


def test_data_have_all_axes_whatever_their_values():
    """Only coordinates are over fewer axes; no member fails, and all states are the same."""
    dataset = co.integrate(family(), np.ones((2, 3)), SPAN, STEP).to_xarray()
    assert dataset["failed"].dims == ("third", "member") and dataset["swept_inertia_2"].dims == ("third",)
    assert all({"third", "member"} <= set(data.dims) for data in dataset.data_vars.values())


def test_a_coordinate_keeps_axes_of_one_value():
    """Numbers that differ along axes without coordinates are over these, and over an axis of a single value."""
    batch = co.batch(lambda pair, last: body(pair[1]), pair=[(2.0, 2.5), (2.0, 3.0)], last=[1])
    dataset = co.integrate(batch, states(4), SPAN, STEP).to_xarray()
    assert dataset["swept_inertia_2"].dims == ("pair", "last")
    assert dataset["swept_inertia_2"].values.tolist() == [[2.5], [3.0]]


def test_two_axes_of_parameters():
    both = co.batch(lambda second, third: co.systems.rigid_body((1, second, third)), second=[2.25, 2.0], third=THIRDS)
    dataset = co.integrate(both, (0.1, 1.0, 0.2), SPAN, STEP).to_xarray()
    assert dataset["x"].dims == ("time", "second", "third", "component")
    assert dataset["swept_inertia_1"].dims == ("second",) and dataset["swept_inertia_2"].dims == ("third",)
    run = co.integrate(co.systems.rigid_body((1, 2.25, 3.0)), (0.1, 1.0, 0.2), SPAN, STEP)
    np.testing.assert_array_equal(dataset["x"].sel(second=2.25, third=3.0), run.x)


@pytest.mark.parametrize("suffix", ["nc", "zarr", "archive"])
def test_families_are_read_back_and_repeated(suffix, tmp_path):
    path = tmp_path / f"run.{suffix}"
    sol = co.integrate(family(), X0, SPAN, STEP, archive=path if suffix == "archive" else None)
    dataset = sol.to_xarray()
    if suffix == "nc":
        dataset.to_netcdf(path, engine="h5netcdf")
    elif suffix == "zarr":
        dataset.to_zarr(path, zarr_format=2)
    loaded = co.load(path)
    np.testing.assert_array_equal(loaded.x, sol.x)
    assert loaded.drift() == sol.drift() and len(loaded.system) == 30
    check_against_single_runs(loaded.to_xarray())
    again = co.results.rebuild(loaded.to_xarray())
    np.testing.assert_array_equal(again.x, sol.x)
    check_against_single_runs(again.to_xarray())


def test_an_archive_of_a_family_is_resumed(tmp_path):
    path = tmp_path / "run.zarr"
    co.integrate(family(), X0, SPAN, STEP, archive=path)
    longer = co.resume(path, t_end=2.0)
    whole = co.integrate(family(), X0, (0.0, 2.0), STEP)
    np.testing.assert_array_equal(longer.to_xarray()["x"], whole.to_xarray()["x"])
    np.testing.assert_array_equal(co.results.rebuild(xarray.open_zarr(path).load()).x, whole.x)


SELECTIONS = {
    "reversed": (slice(None), slice(None, None, -1), slice(None), slice(None, None, -2)),
    "one combination": (3, 2, 1, 4),
    "one member": (slice(None), slice(None), slice(None), 2),
    "one energy": (slice(None), slice(0, 2), 1, slice(1, 4)),
    "lists": (slice(None), [2, 0], [1], slice(None)),
    "nothing along the first axis": (slice(None), slice(1, 1), 0, slice(None)),
    "nothing along the last axis": (3, slice(None), slice(None), slice(4, 2)),
    "an empty list": (slice(None), slice(None), [], slice(None)),
}


@pytest.mark.parametrize("selection", SELECTIONS)
def test_parts_of_an_archived_family_are_read(selection, tmp_path):
    sol = co.integrate_ensemble(family(), X0, SPAN, STEP, members_per_block=4, archive=tmp_path / "run.zarr")
    lazy, whole = (sol.to_xarray()["x"], sol.x.reshape(9, 3, 2, 5, 3))
    expected = xarray.DataArray(whole, dims=lazy.dims)[SELECTIONS[selection]].values
    np.testing.assert_array_equal(lazy[SELECTIONS[selection]].values, expected)


def test_nothing_of_an_archived_family_has_the_types_of_all_of_it(tmp_path):
    dataset = co.integrate(family(), X0, SPAN, STEP, archive=tmp_path / "run.zarr").to_xarray()
    nothing = dataset.isel(third=slice(0, 0))
    for name in ("x", "failed"):
        values = nothing[name].values
        assert values.dtype == dataset[name].dtype and values.shape == nothing[name].shape
    assert (~nothing["failed"].values).all()


def test_forces_are_parameters_too():
    damped = co.batch(
        lambda rate: co.systems.rigid_body((1, 2, 3)).with_forces(co.forces.LinearDamping(rate)), rate=[0.125, 0.5]
    )
    x0 = states(40)
    dataset = co.integrate(damped, x0, SPAN, STEP).to_xarray()
    own = co.systems.rigid_body((1, 2, 3)).with_forces(co.forces.LinearDamping(0.5))
    np.testing.assert_array_equal(dataset["x"].sel(rate=0.5)[:, 37], co.integrate(own, x0[37], SPAN, STEP).x)


def run(x0):
    return lambda: co.integrate(family(), x0, SPAN, STEP)


@pytest.mark.parametrize("count", [1, 31, 32, 70])
def test_repeated_systems_in_any_order_are_the_runs_alone(count):
    """Systems with many members share tables, those with few have columns; both have the bits of single runs."""
    bodies = [body(third) for third in (2.5, 2.75, 2.875, 3.0)]
    rng = np.random.default_rng(count)
    order = rng.permutation(np.repeat([0, 1, 2], [count, 3, 40]).tolist() + [3])
    x0 = rng.standard_normal((len(order), 3))
    sol = co.integrate(co.batch([bodies[k] for k in order]), x0, SPAN, STEP, attitude=True)
    for k, one in enumerate(bodies):
        run = co.integrate(one, x0[order == k], SPAN, STEP, attitude=True)
        np.testing.assert_array_equal(sol.x[:, order == k], run.x)
        np.testing.assert_array_equal(sol.attitude[:, order == k], run.attitude)
        np.testing.assert_array_equal(sol.drift()["energy"].members[order == k], run.drift()["energy"].members)
    again = co.results.rebuild(sol.to_xarray())
    np.testing.assert_array_equal(again.x, sol.x)


def test_noise_of_repeated_systems_differs_by_member():
    spins = co.systems.spin_lattice("chain", 2)
    noisy = spins.with_forces(co.forces.HeatBath(0.5, temperature=1.0, seed=3))
    x0 = np.tile(np.random.default_rng(4).standard_normal(6), (70, 1))
    wanted = co.integrate(noisy, x0, SPAN, STEP).x
    found = co.integrate(co.batch([noisy] * 70), x0, SPAN, STEP).x
    np.testing.assert_array_equal(found, wanted)
    blocks = co.integrate_ensemble(co.batch([noisy] * 70), x0, SPAN, STEP, members_per_block=33)
    np.testing.assert_array_equal(blocks.x, wanted)
    assert len(np.unique(found[-1, :, 0])) == 70


def test_coordinates_have_the_values_that_were_given():
    """Thirds and large integers are neither single precision nor short."""
    assert co.batch(lambda kind: body(kind()), kind=[lambda: 2.5, lambda: 3.0]).axes["kind"].values is None
    values = {"third": [2.1, 2.7], "number": [2**40 + 1, -3], "flag": [True, False], "text": ["a", "bc"]}
    batch = co.batch(lambda third, number, flag, text: body(third), **values)
    dataset = co.integrate(batch, (0.1, 1.0, 0.2), SPAN, STEP).to_xarray()
    for name, wanted in values.items():
        assert dataset[name].values.tolist() == wanted


@pytest.mark.parametrize("dims", [("run", "a", "b"), ("b", "run", "a"), ("b", "a", "run")], ids=str)
def test_dimensions_of_states_in_any_order(dims):
    """All of one length, so that their order alone tells them apart."""
    family = co.batch(lambda a, b: co.systems.rigid_body((1, 2, a + b)), a=[2.0, 2.25], b=[0.25, 0.5])
    x0 = xarray.DataArray(np.random.default_rng(0).standard_normal((2, 2, 2, 3)), dims=(*dims, "component"))
    begun = co.integrate(family, x0, (0, 1), 0.1).to_xarray().x.isel(time=0)
    np.testing.assert_array_equal(begun.transpose(*dims, "component"), x0)
