"""Every run is read back as it was stored, by every store."""

import copy
import pickle

import numpy as np
import pytest
import xarray
from storing import (
    BODY,
    PAIRS,
    RUNS,
    STEP,
    STORES,
    T0,
    X,
    by_archive,
    by_ensemble,
    by_netcdf,
    by_pieces,
    cut,
    run,
    whole,
)

import coadjoint as co
from guards import open_descriptors
from hostile_archives import edit_attributes
from refusals import refused
from same_runs import PARTS, check_same

pytestmark = [
    pytest.mark.usefixtures("no_fsync"),
    pytest.mark.filterwarnings("ignore:the stream .* is called in Python:RuntimeWarning"),
    pytest.mark.filterwarnings("ignore::zarr.errors.UnstableSpecificationWarning"),
    pytest.mark.filterwarnings("ignore:Consolidated metadata"),
]


def fields_of(sol, x0):
    """Return the fields of all members at their initial states, and at several times."""
    systems = sol.system if hasattr(sol.system, "__getitem__") else [sol.system]
    states = x0 if sol.failed is not None else [x0]
    return [systems[m % len(systems)].vector_field(state, T0 + m) for m, state in enumerate(states)]


@pytest.mark.thinned(12)
@pytest.mark.parametrize(("store", "name"), PAIRS)
def test_stored_run_equals_the_run(store, name, tmp_path):
    wanted, found = run(name), STORES[store](name, tmp_path)
    # Functions that are observed are not stored.
    left_out = ("observed",) if store == "rebuilt" else ()
    check_same(found, wanted, left_out=left_out, work=store != "pieces")
    assert found.x.dtype == wanted.x.dtype
    if name != "batch with noise":  # which has no field, and no state between two steps
        for own, read in zip(fields_of(wanted, wanted.x0), fields_of(found, wanted.x0), strict=True):
            np.testing.assert_array_equal(read, own)
    if name not in ("start left out", "batch with noise"):
        between = T0 + (wanted.t[-1] - T0) * 0.6180339
        again = found.at(between)
        np.testing.assert_array_equal(again.x, wanted.at(between).x)
    if store in ("archive", "pieces", "ensemble", "workers"):
        data, expected = found.to_xarray().load(), wanted.to_xarray(grid=False)
        for variable, values in expected.variables.items():
            assert data[variable].dims == values.dims and data[variable].attrs == values.attrs
            np.testing.assert_array_equal(data[variable].values, values.values, err_msg=variable)


def test_members_that_are_run_in_another_order_resume_in_their_own(tmp_path):
    found = STORES["pieces"]("interleaved batch", tmp_path)
    check_same(found, run("interleaved batch"), work=False)


def test_every_part_is_covered():
    derived = {
        "system", "stats", "events", "choice", "error_estimate", "step_error", "rotation", "to_pandas", "t_eval",
        "drift", "balance", "change", "modified_energy", "spectrum", "at", "to_xarray", "plot", "movie",
        "positions", "velocities", "to_ovf", "angular_velocity", "angular_momentum", "in_space",
    }  # fmt: skip
    public = {name for name in dir(run("one body")) if not name.startswith("_")}
    assert public == {*PARTS} | derived


@pytest.mark.parametrize("name", RUNS)
def test_dataset_matches_the_solution(name):
    sol = run(name)
    data = sol.to_xarray()
    np.testing.assert_array_equal(data["time"], sol.t)
    assert list(data["invariant"].values) == ["energy", *sol.casimirs]
    np.testing.assert_array_equal(data["tenth"], np.arange(1, 11))
    for kind, series in (("casimir_", sol.casimirs), ("observed_", sol.observed)):
        named = {v.attrs["long_name"]: v.values for label, v in data.variables.items() if label.startswith(kind)}
        np.testing.assert_equal(named, dict(series))
    for index, account in enumerate(data["account"].values) if sol.work else ():
        force, _, invariant = str(account).rpartition(": ")
        np.testing.assert_array_equal(data["work"][..., index], sol.work[force][invariant])
    names = {"drift": sol.change} if not sol.work else {"change": sol.change, "balance": sol.balance}
    for label, drifts in names.items():
        for index, invariant in enumerate(data["invariant"].values):
            drift = drifts(relative=False).get(str(invariant))
            found = data[label].isel(invariant=index)
            np.testing.assert_array_equal(found, np.full_like(found, np.nan) if drift is None else drift.tenths)
        over = "over every step" if sol.watched else "over the saved points"
        assert data[label].attrs["long_name"].endswith(f"in each tenth of the run, {over}")
    if name.startswith("batch"):
        swept = [label for label in data.coords if str(label).startswith("swept_")]
        assert swept, "parameters in which members differ are coordinates"
        for label in swept:
            index = int(str(label).rpartition("_")[2])
            wanted = [each.unforced.parameters["inertia"][index] for each in sol.system]
            np.testing.assert_array_equal(data[label], wanted)
    if "part" in data.dims:
        np.testing.assert_array_equal(data["x"].isel(part=0), sol.x.real)
        np.testing.assert_array_equal(data["x"].isel(part=1), sol.x.imag)


@pytest.mark.thinned(3)
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", ["one body", "members", "matrices"])
@pytest.mark.parametrize("store", ["archive", "ensemble", "dataset"])
def test_archives_follow_cf_conventions(tmp_path, name, store):
    """All numbers have units and long names, and dimensions with names have coordinates; xarray reads them."""
    path = tmp_path / "run.zarr"
    if store == "ensemble" and name != "one body":
        co.integrate_ensemble(**RUNS[name], archive=path)
    elif store == "archive":
        co.integrate(**RUNS[name], archive=path)
    with xarray.open_zarr(path) if path.exists() else run(name).to_xarray() as found:
        assert found.attrs["Conventions"] == "CF-1.11"
        for label, variable in found.variables.items():
            assert variable.attrs["long_name"], label
            of_axis = {"latitude": "degrees_north", "longitude": "degrees_east"}
            of_axis |= dict.fromkeys(("eastward", "northward"), "radian")  # of a torus of circumference 2 pi
            expected = of_axis.get(label, "1") if variable.dtype.kind == "f" else None
            assert variable.attrs.get("units") == expected, label
        assert found["time"].dims == ("time",) and found["time"].dtype == "float64"
        assert set(found.dims) - set(found.coords) <= {"member", "row", "column", "axis"}
        assert found["x"].dims[0] == "time" and found["energy"].dims == found["x"].dims[: found["energy"].ndim]
        for label, variable in run(name).to_xarray(grid=False).variables.items():
            np.testing.assert_array_equal(found[label].values, variable.values, err_msg=label)


def test_opened_archive_is_a_snapshot(tmp_path):
    found = cut(tmp_path / "run.zarr", attitude=True)
    assert isinstance(found, co.Solution) and found.path == tmp_path / "run.zarr"
    assert (found.reached, found.finished) == (5, False) and "step 5 of 16" in repr(found)
    again = pickle.loads(pickle.dumps(found))
    assert np.array_equal(again.attitude, found.attitude) and again.reached == 5
    resumed = co.resume(tmp_path / "run.zarr")
    assert "finished" in repr(resumed) and resumed.finished
    check_same(resumed, whole(attitude=True))
    assert found.x.shape == (3, 3) and found.to_xarray().sizes["time"] == 3
    assert np.array_equal(found.at(0.3).x, whole(attitude=True).at(0.3).x)


def test_indexing_equals_numpy_indexing(tmp_path):
    """Slices in both directions, single entries and lists, by the lazy arrays of xarray over several chunks."""
    steps, rng = 150000, np.random.default_rng(1)
    co.integrate(BODY, X, (0, STEP), STEP, archive=tmp_path / "run.zarr")
    found = co.resume(tmp_path / "run.zarr", steps * STEP).to_xarray()["x"]
    assert len(list((tmp_path / "run.zarr" / "x").glob("c.*"))) == 3
    x = co.integrate(BODY, X, (0, steps * STEP), STEP).x
    for _ in range(60):
        first, last = rng.integers(-steps - 9, steps + 9, 2)
        rows = [
            slice(first, last, int(rng.choice([1, 2, 70000, -1, -3]))),
            int(rng.integers(-steps, steps)),
            list(rng.integers(0, steps, 4)),
        ]
        if rows[0].step < 0 and not len(x[rows[0]]):
            continue  # fails in xarray
        key = (rows[rng.integers(3)], [slice(None), slice(None, None, -1), 1, [2, 0]][rng.integers(4)])
        assert np.array_equal(found[key].values, x[key[0]][..., key[1]]), key


def test_seconds_of_earlier_calls_are_added(tmp_path):
    path, seconds = tmp_path / "run.zarr", 1e6
    cut(path)
    edit_attributes(path, seconds=seconds)
    assert seconds <= co.resume(path, until=9).stats.seconds < 2 * seconds
    assert seconds <= co.resume(path).stats.seconds == co.open_archive(path).stats.seconds < 2 * seconds


def test_descriptors_are_closed(tmp_path):
    """After a run, an interruption, a continuation, a refusal and a read."""
    co.integrate(BODY, X, (0, 2), STEP, archive=tmp_path / "first.zarr").to_xarray().load()
    co.integrate_ensemble(BODY, [X], (0, 2), STEP, archive=tmp_path / "one.zarr")
    before = len(open_descriptors())
    cut(tmp_path / "run.zarr")
    with refused(ValueError, "system", "0.3636"):
        co.resume(tmp_path / "run.zarr", system=co.systems.rigid_body(inertia=(1, 2, 2.75)))
    for ends in ({"until": 9}, {}, {"t_end": 3.0}, {"t_end": 3.0}):
        found = co.resume(tmp_path / "run.zarr", **ends)
    with refused(ValueError, "t_end", "2"):
        co.resume(tmp_path / "run.zarr", 2.0)
    co.integrate_ensemble(BODY, [X] * 3, (0, 2), STEP, archive=tmp_path / "many.zarr", members_per_block=1)
    with refused(ValueError, "x0"):
        co.integrate_ensemble(BODY, [X] * 4, (0, 2), STEP, archive=tmp_path / "many.zarr")
    co.resume(tmp_path / "many.zarr").to_xarray().load()
    found.to_xarray().load()
    assert found.finished and len(open_descriptors()) == before


# Copies of runs whose system is given, since its functions are not stored.


class Weighted:
    """Entries times weights, picklable."""

    def __init__(self, weights):
        self.weights = weights


class Stream(Weighted):
    def __call__(self, W):
        return self.weights * W


class Energy(Weighted):
    def __call__(self, W):
        return 0.5 * float(np.sum(self.weights * np.abs(W) ** 2))


def of_matrices(kind, size, seed):
    """Return a system of Python functions, and an initial state."""
    rng = np.random.default_rng(seed)
    algebra, weights = co.MatrixAlgebra(kind, size), rng.uniform(0.5, 1.5, (size, size))
    weights = weights + weights.T
    np.fill_diagonal(weights, 1.0)  # traces stay zero
    W = algebra.projected(0.5 * rng.standard_normal((size, size)) + (0.5j * np.eye(size, k=1) if kind == "su" else 0))
    return co.MatrixSystem(algebra, Stream(weights), energy=Energy(weights)), W


COPIES = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda found: pickle.loads(pickle.dumps(found)),
    "copy of a copy": lambda found: copy.copy(pickle.loads(pickle.dumps(found))),
}
FILES = {"archive": by_archive, "pieces": by_pieces, "ensemble": by_ensemble, "netcdf": by_netcdf}


@pytest.mark.thinned(9)
@pytest.mark.parametrize("store", FILES)
@pytest.mark.parametrize(("kind", "size"), [("so", 4), ("su", 3)])
def test_copies_keep_the_given_functions(tmp_path, monkeypatch, store, kind, size):
    """States between the saved ones use them; without functions these are refused."""
    system, x0 = of_matrices(kind, size, 1)
    several = store == "ensemble"
    states = np.multiply.outer([1.0, 0.5, -0.25], x0) if several else x0
    span, method, path = (0.5, 2.5), co.IsospectralGauss(2), tmp_path / "run.zarr"
    options = {"save_every": 3, "archive": path}
    if store == "netcdf":
        path = tmp_path / "run.nc"
        co.integrate(system, states, span, STEP, method, save_every=3).to_xarray().to_netcdf(path, engine="h5netcdf")
    elif several:
        co.integrate_ensemble(system, states, span, STEP, method, **options, members_per_block=2)
    else:
        co.integrate(system, states, (0.5, 1.0), STEP, method, **options)
        with pytest.warns(UserWarning, match="without an object of Stream, an object of Energy"):
            co.resume(path, 2.5, system=system, until=None if store == "archive" else 7)
    found = co.load(path, system=system)
    between = 0.5 * (found.t[0] + found.t[-1]) + 0.03
    for how, copied in COPIES.items():
        again = copied(co.load(path, system=system))
        assert type(again) is type(found) and again.path == path, how
        np.testing.assert_array_equal(again.system.vector_field(x0), system.vector_field(x0), err_msg=how)
        assert again.system.energy(x0) == system.energy(x0)
        np.testing.assert_array_equal(again.at(between).x, found.at(between).x, err_msg=how)
        for part in ("t", "x", "energy", "x0"):
            np.testing.assert_array_equal(getattr(again, part), getattr(found, part), err_msg=f"{how}: {part}")
        assert again.stats == found.stats and again.drift() == found.drift()
        with refused(ValueError, "functions are not stored"):
            _ = copied(co.load(path)).system


def test_copies_of_runs_with_an_accuracy_have_their_error():
    """Whether it was computed before the copy was made or not, and for each member."""
    x0 = np.array([1.0, 0.2, 0.5])
    for states in (x0, np.multiply.outer([1.0, 0.5, -0.25], x0)):
        sol = co.integrate(BODY, states, (0, 2), accuracy=1e-6)
        before = {how: copied(sol) for how, copied in COPIES.items()}
        error = sol.error_estimate()
        assert np.shape(error) == states.shape[:-1] and np.all(np.asarray(error) <= 1e-6)
        for how, copied in COPIES.items():
            for again in (before[how], copied(sol), copied(before[how])):
                np.testing.assert_array_equal(again.error_estimate(), error, err_msg=how)
                assert again.choice == sol.choice and again.drift() == sol.drift()
    given = co.integrate(BODY, x0, (0, 2), STEP)
    assert copy.copy(given).error_estimate() == given.error_estimate()


@pytest.mark.parametrize("store", FILES)
def test_given_system_comes_before_the_stored_one(tmp_path, store):
    FILES[store]("batch", tmp_path)
    (path,) = tmp_path.iterdir()
    other = co.batch([co.systems.rigid_body((1.0, 2.0, third)) for third in (2.25, 2.75, 1.5)])
    for copied in COPIES.values():
        given, rebuilt = copied(co.load(path, system=other)), copied(co.load(path))
        for m in range(3):
            np.testing.assert_array_equal(given.system[m].vector_field(X), other[m].vector_field(X))
            wanted = RUNS["batch"]["system"][m].vector_field(X)
            np.testing.assert_array_equal(rebuilt.system[m].vector_field(X), wanted)
