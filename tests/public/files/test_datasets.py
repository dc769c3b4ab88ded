"""Variables, attributes and coordinates of datasets of solutions."""

import json

import numpy as np
import pytest
from stored_systems import MATRICES, SPHERE

import coadjoint as co
from long import long_beyond
from served import state_of

X = (1.0, 0.1, 0.5)


def test_variables_and_attributes():
    sol = co.integrate(
        co.systems.rigid_body(), X, (0.0, 2.0), 0.1, observe={"x1 x2": co.Polynomial({(1, 1, 0): 1})}, attitude=True
    )
    dataset = sol.to_xarray()
    sizes = {"time": 21, "component": 3, "invariant": 2, "tenth": 10, "row": 3, "column": 3, "axis": 3}
    sizes["component_of_quaternion"] = 4
    assert dict(dataset.sizes) == sizes
    assert dataset["component"].values.tolist() == ["x1", "x2", "x3"]
    assert dataset.coords["component_of_quaternion"].values.tolist() == ["x", "y", "z", "w"]
    assert dataset["x"].dims == ("time", "component")
    assert dataset["attitude"].dims == ("time", "row", "column")
    np.testing.assert_allclose(abs((dataset["quaternion"] * sol.rotation.as_quat()).sum(axis=1)), 1.0, rtol=1e-14)
    assert dataset["casimir_x_2"].attrs["long_name"] == "|x|^2"
    np.testing.assert_array_equal(dataset["casimir_x_2"], sol.casimirs["|x|^2"])
    np.testing.assert_array_equal(dataset["observed_x1_x2"], sol.x[:, 0] * sol.x[:, 1])
    np.testing.assert_array_equal(dataset["drift"].sel(invariant="energy"), sol.drift(relative=False)["energy"].tenths)
    assert json.loads(dataset.attrs["system"]) == {"name": "rigid_body", "parameters": {"inertia": [1.0, 2.0, 3.0]}}
    assert json.loads(dataset.attrs["method"])["name"] == "Splitting"
    assert dataset.attrs["coadjoint_version"] == co.__version__
    assert json.loads(dataset.attrs["t_span"]) == [0.0, 2.0]
    assert "not_stored" not in dataset.attrs


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_quaternions_do_not_jump_in_several_turns(sense):
    """A body about its third axis, at the rate 1: half of the angle, from the attitude 1 on."""
    body = co.systems.rigid_body((1.0, 2.0, 2.5))
    sol = co.integrate(body, (0.0, 0.0, 2.5 * sense), (3.0, 33.0), 0.25, attitude=True)
    half = 0.5 * sense * (sol.t - 3.0)
    wanted = np.stack([0.0 * half, 0.0 * half, np.sin(half), np.cos(half)], axis=1)
    np.testing.assert_allclose(sol.to_xarray()["quaternion"], wanted, rtol=0, atol=1e-12)


def test_names_differing_in_symbols_are_distinct():
    algebra = co.LieAlgebra([(0, 1, 2, 1.0)], dim=3)
    z = co.Polynomial({(0, 0, 1): 1})
    system = co.LiePoissonSystem(algebra, co.Quadratic(1.0), casimirs={"z+": z, "z-": 2 * z, "*": 3 * z})
    dataset = co.integrate(system, X, (0.0, 1.0), 0.1).to_xarray()
    names = {name: dataset[name].attrs["long_name"] for name in dataset if name.startswith("casimir")}
    assert names == {"casimir_z": "z+", "casimir_z_2": "z-", "casimir_unnamed": "*"}


@pytest.mark.parametrize("seed", long_beyond(1, range(4)))
def test_many_similar_names_keep_their_values(seed, tmp_path):
    """Random names of few letters, in a dataset and in an archive."""
    rng = np.random.default_rng(seed)
    drawn = {"".join(rng.choice(["z", "_2", "+", " ", "_3"], rng.integers(1, 4))) for _ in range(40)}
    names = ["z", "z+", "z_2", "z*", "z ", *sorted(drawn - {"z", "z+", "z_2", "z*", "z "})]
    rng.shuffle(names)
    observe = {name: co.Polynomial({(1, 0, 0): k + 1}) for k, name in enumerate(names)}
    casimirs = {name: co.Polynomial({(0, 0, 1): k + 1}) for k, name in enumerate(names)}
    system = co.LiePoissonSystem(co.LieAlgebra([(0, 1, 2, 1.0)], dim=3), co.Quadratic(1.0), casimirs=casimirs)
    sol = co.integrate(system, X, (0.0, 0.5), 0.1, observe=observe, archive=tmp_path / "run.zarr")
    for dataset in (sol.to_xarray(), co.open_archive(tmp_path / "run.zarr").to_xarray()):
        for kind, coordinate in (("observed", 0), ("casimir", 2)):
            found = {values.attrs["long_name"]: values for key, values in dataset.items() if key.startswith(kind + "_")}
            assert list(found) == names
            for k, name in enumerate(names):
                np.testing.assert_allclose(found[name], (k + 1) * sol.x[:, coordinate], rtol=1e-15)


# Parameters in which the systems of a batch differ.

CONSTANTS = np.array([2.5, 3.0, 4.0])
BODIES = co.batch([co.systems.rigid_body(inertia=(2, 3, c)) for c in CONSTANTS])
STATES = np.array([(1.0, 0.2, 0.1), (0.3, 1.0, 0.1), (0.1, 0.2, 1.0)])


def test_equal_and_unknown_parameters_are_omitted():
    alike = co.batch([co.systems.rigid_body(inertia=(2, 3, 4))] * 3)
    plain = co.batch([co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1, 2, c])) for c in CONSTANTS])
    for system in (alike, plain, BODIES[0]):
        dataset = co.integrate(system, STATES, (0, 1), 0.1).to_xarray()
        assert not any(str(name).startswith("swept") for name in dataset.coords)


@pytest.mark.parametrize("name", ["sphere", "body", "two layers"])
@pytest.mark.parametrize("members", [1, 3])
def test_matrices_have_rows_columns_layers_and_parts(name, members):
    system = MATRICES[name]
    x0 = state_of(system) if members == 1 else np.array([state_of(system, m) for m in range(members)])
    sol = co.integrate(system, x0, (0.25, 1.0), 0.125, co.IsospectralGauss(2), save_every=2)
    dataset = sol.to_xarray()
    parts = ("part",) if np.iscomplexobj(x0) else ()
    member = ("member",) if members > 1 else ()
    layers = ("layer",) if len(system.shape) == 3 else ()
    assert dataset["x"].dims == ("time", *member, *layers, "row", "column", *parts)
    assert dataset["x0"].dims == dataset["x"].dims[1:] and "component" not in dataset.coords
    x = dataset["x"].sel(part="real") + 1j * dataset["x"].sel(part="imaginary") if parts else dataset["x"]
    assert np.array_equal(x, sol.x) and dataset.attrs["watch"] == 0
    vectors = co.integrate(SPHERE.in_numbers, SPHERE.to_vector(state_of(SPHERE)), (0.0, 1.0), 0.25)
    assert vectors.x.shape == (5, 32) and vectors.to_xarray()["x"].dims == ("time", "component")
    assert np.array_equal(co.results.rebuild(vectors.to_xarray()).x, vectors.x)


BLOCKS = {
    "so": [("so", 4)],
    "su": [("su", 3)],
    "gl": [("gl", 3)],
    "blocks of su": [("su", 3), ("su", 2)],
    "blocks of gl": [("gl", 2), ("gl", 3)],
}


@pytest.mark.thinned(5)
@pytest.mark.parametrize("name", BLOCKS)
@pytest.mark.parametrize("members", [1, 2])
def test_balances_are_those_of_their_invariants(name, members, tmp_path):
    """What a force changes is no error: Casimirs that it changes without recorded work have no balance."""
    algebras = [co.MatrixAlgebra(*one) for one in BLOCKS[name]]
    algebra = algebras[0] if len(algebras) == 1 else co.MatrixAlgebra.sum(*algebras)
    drawn = np.random.default_rng(4).standard_normal((members, algebra.N, algebra.N)) * (1 + 1j * algebra.complex)
    x0 = algebra.projected(drawn)
    # A multiple of the state moves nothing; the stream is a function, which is not stored.
    system = co.MatrixSystem(algebra, lambda W: 0.5 * W).with_forces(co.forces.LinearDamping(0.25))
    run = system, x0[0] if members == 1 else x0, (0.25, 1.25), 0.125
    sol, archived = co.integrate(*run), co.integrate(*run, archive=tmp_path / "run.zarr")
    sol.to_xarray().to_netcdf(tmp_path / "run.nc")
    changes, accounted = sol.change(relative=False), sol.work["LinearDamping"]
    for found in (sol, archived, co.load(tmp_path / "run.nc"), co.load(tmp_path / "run.nc", system=system)):
        balance = found.balance(relative=False)
        assert list(balance) == [one for one in changes if one in accounted]
        stored = found.to_xarray()["balance"]
        for one in changes:
            tenths = stored.sel(invariant=one)
            if one not in balance:
                assert np.isnan(tenths).all()
                continue
            np.testing.assert_array_equal(tenths, balance[one].tenths)
            # Sums of some ten products of numbers below 4, to powers up to the third.
            assert balance[one] < 2.0**-53 * 10 * 4**3 * 8
    assert max(changes.values()) > 0.1


@pytest.mark.parametrize("attitude", [False, True])
def test_events_and_times_of_output_are_variables(attitude):
    events = [co.Event("x2"), co.Event(co.Polynomial({(2, 0, 0): 1, (0, 0, 0): -0.125}), count=2, terminal=True)]
    sol = co.integrate(co.systems.rigid_body(), X, (0, 40), 0.125, attitude=attitude, events=events)
    dataset = sol.to_xarray()
    assert np.array_equal(dataset["event_time"], sol.events.t) and np.array_equal(dataset["event_x"], sol.events.x)
    assert ("event_attitude" in dataset) == attitude
    times = np.array([0.33, 0.5, 1.77])
    sol = co.integrate(co.systems.rigid_body(), [X, X[::-1]], (0, 2), 0.1, attitude=True, t_eval=times)
    dataset = sol.to_xarray()
    assert np.array_equal(dataset["time"], times) and np.array_equal(dataset["x0"], sol.x0)
    assert np.array_equal(dataset["attitude0"], sol.attitude0)


OBSERVED = {
    "polynomial": co.Polynomial("x1^2 - x2/3", dim=3),
    "form": co.Quadratic(2.0),
    "formula": co.formula("a*sin(x1)", dim=3, parameters={"a": 2.0}),
    "sum": co.formula("sin(x1)", dim=3) / 2 + co.Polynomial("x1^3", dim=3),
}


def test_observed_formulas_are_stored_and_observed_again(tmp_path):
    """As are events of them; functions of Python alone are named as not stored."""
    body, x0 = co.systems.rigid_body(), (1.0, 0.2, -0.3)
    observe = {**OBSERVED, "function": lambda x: x[0]}
    events = [co.Event(OBSERVED["formula"], name="crossing")]
    sol = co.integrate(body, x0, (0, 2), 0.1, observe=observe, events=events)
    dataset = sol.to_xarray()
    assert dataset.attrs["not_stored"] == "functions are not stored: observed: function"
    again = co.results.rebuild(dataset)
    assert list(again.observed) == list(OBSERVED)
    x = sol.x
    values = (x[:, 0] ** 2 - x[:, 1] / 3, (x**2).sum(axis=1), 2 * np.sin(x[:, 0]), np.sin(x[:, 0]) / 2 + x[:, 0] ** 3)
    for name, expected in zip(OBSERVED, values, strict=True):
        np.testing.assert_array_equal(again.observed[name], sol.observed[name])
        np.testing.assert_allclose(sol.observed[name], expected, rtol=1e-14, atol=1e-15)
    np.testing.assert_array_equal(again.events.t, sol.events.t)
    co.integrate(body, x0, (0, 1), 0.1, observe=OBSERVED, archive=tmp_path / "run.zarr")
    archived = co.resume(tmp_path / "run.zarr", t_end=2.0)
    assert "not_stored" not in archived.attributes
    for name in OBSERVED:
        np.testing.assert_array_equal(archived.observed[name], sol.observed[name])
