"""Datasets of solutions: content, files, and rebuilding of runs to the same bits."""

import json
from fractions import Fraction

import numpy as np
import pytest
import scipy.linalg
import xarray

import coadjoint as co
from coadjoint.files.datasets.export import dataset_of, mark_failed, rebuild, solution_inputs
from coadjoint.files.datasets.variables import parameters_of
from coadjoint.files.output.output_files import write_dataset

X = (1.0, 0.1, 0.5)


def own_system(hamiltonian=None, **kwargs):
    algebra = co.LieAlgebra.from_brackets(
        3, {(0, 1): {1: 2.0}, (0, 2): {2: -2.0}, (1, 2): {0: 1.0}}, basis=("h", "e", "f"), name="mine"
    )
    full = [[2.0, 0.3, 0.1], [0.3, 1.5, -0.2], [0.1, -0.2, 1.0]]
    casimirs = {"x1*x1/4": co.Polynomial({(2, 0, 0): 0.25, (0, 1, 1): 1})}
    H = co.Quadratic(full, linear=[0.1, 0.0, 0.0]) if hamiltonian is None else hamiltonian
    return co.LiePoissonSystem(algebra, H, sign=-1, casimirs=casimirs, name="own", **kwargs)


QUARTIC = co.Polynomial({(4, 0, 0): 0.1, (2, 0, 0): Fraction(1, 3), (0, 2, 0): 1, (0, 0, 2): 0.25})
PIECES = co.SplitHamiltonian([((0,), co.Quadratic(1.5)), ((1,), co.Polynomial({(3,): 0.1})), ((2,), co.Quadratic(2.0))])


BODY = co.systems.rigid_body()
RUNS = {
    "ready made": lambda: co.integrate(BODY, X, (0.0, 2.0), 0.1, co.Splitting(order=4), save_every=3),
    "backward": lambda: co.integrate(co.systems.paper_a37(), X, (1.0, -1.0), 0.1, attitude="coadjoint", watch=False),
    "attitude": lambda: co.integrate(co.systems.paper_rigid_body(), X, (0.0, 2.0), 0.1, attitude=True),
    "turned": lambda: co.integrate(
        co.systems.rigid_body(), X, (0.0, 2.0), 0.1, attitude=[[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    ),
    "own": lambda: co.integrate(own_system(), X, (0.0, 2.0), 0.1, co.Splitting(order=2, parts="auto")),
    "polynomial": lambda: co.integrate(own_system(QUARTIC), X, (0.0, 2.0), 0.1),
    "pieces": lambda: co.integrate(own_system(PIECES), X, (0.0, 0.5), 0.1),
    "represented": lambda: co.integrate(
        co.LiePoissonSystem(co.algebras.e(3), co.Quadratic([1, 1, 0.5, 0, 0, 0], linear=[0, 0, 0, 0, 0, 1.5]), sign=-1),
        [(0.1, 0, 2, 0, 0.6, 0.8), (0.2, 0, 1, 0, 0.8, 0.6)], (0.0, 1.0), 0.1, attitude=True,
    ),
    "implicit": lambda: co.integrate(BODY, [X, X[::-1]], (0.0, 2.0), 0.1, co.GaussLegendre(stages=2)),
}  # fmt: skip


@pytest.mark.thinned(18)
@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
@pytest.mark.parametrize("name", RUNS)
def test_rebuilt_runs_have_the_same_bits(name, suffix, tmp_path):
    first = RUNS[name]()
    dataset = dataset_of(first)
    path = tmp_path / f"run{suffix}"
    write_dataset(dataset, path)
    with xarray.open_dataset(path, engine={".nc": "h5netcdf", ".zarr": "zarr"}[suffix]) as read:
        xarray.testing.assert_identical(read.load(), dataset)
        again = rebuild(read)
    for actual, others in ((again.x, first.x), (again.t, first.t), (again.energy, first.energy)):
        np.testing.assert_array_equal(actual, others)
    np.testing.assert_array_equal(again.drift()["energy"].tenths, first.drift()["energy"].tenths)
    if first.attitude is not None:
        np.testing.assert_array_equal(again.attitude, first.attitude)
    assert (again.method, again.step, again.save_every, again.watched) == (
        first.method, first.step, first.save_every, first.watched
    )  # fmt: skip


def test_variables_and_attributes():
    sol = co.integrate(
        co.systems.rigid_body(), X, (0.0, 2.0), 0.1, observe={"x1 x2": co.Polynomial({(1, 1, 0): 1})}, attitude=True
    )
    dataset = sol.to_xarray()
    assert dict(dataset.sizes) == {"time": 21, "component": 3, "invariant": 2, "tenth": 10, "row": 3, "column": 3}
    assert dataset["component"].values.tolist() == ["x1", "x2", "x3"]
    assert dataset["x"].dims == ("time", "component")
    assert dataset["attitude"].dims == ("time", "row", "column")
    assert dataset["casimir_x_2"].attrs["long_name"] == "|x|^2"
    np.testing.assert_array_equal(dataset["casimir_x_2"], sol.casimirs["|x|^2"])
    np.testing.assert_array_equal(dataset["observed_x1_x2"], sol.x[:, 0] * sol.x[:, 1])
    np.testing.assert_array_equal(dataset["drift"].sel(invariant="energy"), sol.drift(relative=False)["energy"].tenths)
    assert json.loads(dataset.attrs["system"]) == {"name": "rigid_body", "parameters": {"inertia": [1.0, 2.0, 3.0]}}
    assert json.loads(dataset.attrs["method"])["name"] == "Splitting"
    assert dataset.attrs["coadjoint_version"] == co.__version__
    assert json.loads(dataset.attrs["t_span"]) == [0.0, 2.0]
    assert dataset.attrs["not_stored"] == "functions are not stored: observed: x1 x2"


def test_ensembles_have_members():
    dataset = RUNS["implicit"]().to_xarray()
    assert dataset["x"].dims == ("time", "member", "component")
    assert dataset["drift"].dims == ("member", "invariant", "tenth")
    assert dataset["failed"].values.tolist() == [False, False]


def test_names_differing_in_symbols_are_distinct():
    algebra = co.LieAlgebra([(0, 1, 2, 1.0)], dim=3)
    z = co.Polynomial({(0, 0, 1): 1})
    system = co.LiePoissonSystem(algebra, co.Quadratic(1.0), casimirs={"z+": z, "z-": 2 * z, "*": 3 * z})
    dataset = co.integrate(system, X, (0.0, 1.0), 0.1).to_xarray()
    names = {name: dataset[name].attrs["long_name"] for name in dataset if name.startswith("casimir")}
    assert names == {"casimir_z": "z+", "casimir_z_2": "z-", "casimir_unnamed": "*"}


@pytest.mark.thinned(2)
@pytest.mark.parametrize("seed", range(4))
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


def test_casimir_functions_are_not_rebuilt():
    system = co.LiePoissonSystem(co.algebras.A3_7(2.0), co.Quadratic([1.0, 2.0, 0.01]))
    sol = co.integrate(system, X, (0.0, 1.0), 0.1)
    dataset = sol.to_xarray()
    assert dataset.attrs["not_stored"] == "functions are not stored: casimir: log C"
    again = rebuild(dataset)
    np.testing.assert_array_equal(again.x, sol.x)
    assert list(again.casimirs) == []


@pytest.mark.parametrize("attitude", [True, "coadjoint"])
def test_attitudes_of_equal_size_are_rebuilt(attitude):
    sol = co.integrate(co.systems.paper_a37(), X, (0.0, 1.0), 0.1, attitude=attitude)
    np.testing.assert_array_equal(rebuild(sol.to_xarray()).attitude, sol.attitude)


def element_of(system):
    """Return a coadjoint matrix other than the unit matrix."""
    return scipy.linalg.expm(system.algebra.coadjoint([0.1, 0.25, 0.4]))


TURNED, A37 = co.batch([co.systems.rigid_body((1, 2, c)) for c in (2.5, 3.0)]), co.systems.paper_a37()
PAIR = np.stack([element_of(BODY), np.eye(3)])
OWN_ELEMENTS = {
    "one": (BODY, co.Splitting(order=4), X, (0.0, 1.0), element_of(BODY), {}),
    "own algebra": (A37, None, X, (0.0, 1.0), element_of(A37), {"t_eval": [0.03, 0.5]}),
    "members": (BODY, co.GaussLegendre(2), [X, X[::-1]], (1.0, -1.0), PAIR, {"save_every": 3}),
    "shared": (BODY, co.Taylor(), [X, X[::-1]], (2.5, 3.0), element_of(BODY), {}),
    "batch": (TURNED, None, X, (1.0, 0.0), PAIR, {}),
    "event": (BODY, None, X, (0.0, 20.0), element_of(BODY), {"events": co.Event("x1", terminal=True)}),
    "force": (BODY.with_forces(co.forces.LinearDamping(0.1)), None, X, (0.0, 1.0), element_of(BODY), {}),
}  # fmt: skip


@pytest.mark.thinned(4)
@pytest.mark.parametrize("name", OWN_ELEMENTS)
def test_initial_coadjoint_matrix_is_rebuilt(name, tmp_path):
    system, method, x0, span, element, options = OWN_ELEMENTS[name]
    sol = co.prepare(system, method, 0.05, attitude="coadjoint").run(x0, span, attitude=element, **options)
    dataset = dataset_of(sol)
    again = rebuild(dataset)
    for part in ("t", "x", "attitude", "attitude0", "energy"):
        np.testing.assert_array_equal(getattr(again, part), getattr(sol, part))
    assert (again.carried, again.t_span, again.save_every) == (sol.carried, sol.t_span, sol.save_every)
    with pytest.raises(ValueError, match=r"coadjoint matrix, .*`rebuild`"):
        solution_inputs(dataset)
    write_dataset(dataset, tmp_path / "run.nc")
    read = co.load(tmp_path / "run.nc")
    np.testing.assert_array_equal(read.attitude0, sol.attitude0)
    if name != "batch":
        found, wanted = (one.at(np.mean(sol.t[:2])) for one in (read, sol))
        np.testing.assert_array_equal(found.attitude, wanted.attitude)


GROWING = co.LiePoissonSystem(co.LieAlgebra([(0, 1, 1, 1.0)], dim=2), co.Quadratic(0.0, linear=[1.0, 0.0]), sign=-1)


def test_failed_run_is_rebuilt_to_the_same_failure():
    members = [(1.0, 1.0), (1.0, 0.0)]
    with pytest.raises(co.IntegrationError) as first:
        co.integrate(GROWING, members, (0.0, 1000.0), 1.0, save_every=500)
    dataset = mark_failed(first.value.partial.to_xarray(), first.value)
    assert dataset["failed"].values.tolist() == [True, False]
    assert dataset["x"].sel(member=1).notnull().all()
    assert dataset["x"].sel(member=0).isnull().any(dim="component").values.tolist() == [False, False, True]
    with pytest.raises(co.IntegrationError) as again:
        rebuild(dataset)
    assert again.value.step == first.value.step == dataset.attrs["failed_step"] == 710


def test_span_of_a_run_that_failed_at_once():
    with pytest.raises(co.IntegrationError) as failure:
        co.integrate(GROWING, (1.0, 1.0), (0.0, 1000.0), 1.0, save_every=1000)
    assert solution_inputs(dataset_of(failure.value.partial))["t_span"] == (0.0, 1000.0)


# Parameters in which the systems of a batch differ.

CONSTANTS = np.array([2.5, 3.0, 4.0])
BODIES = co.batch([co.systems.rigid_body(inertia=(2, 3, c)) for c in CONSTANTS])
STATES = np.array([(1.0, 0.2, 0.1), (0.3, 1.0, 0.1), (0.1, 0.2, 1.0)])


@pytest.mark.parametrize(("run", "options"), [(co.integrate, {}), (co.ensemble, {"members_per_block": 2})])
def test_swept_parameters_of_archives(tmp_path, run, options):
    run(BODIES, STATES, (0, 1), 0.1, archive=tmp_path / "run.zarr", **options)
    found = co.open_archive(tmp_path / "run.zarr").to_xarray()
    assert "swept_inertia_2" in found.coords and np.array_equal(found["swept_inertia_2"], CONSTANTS)


def test_equal_and_unknown_parameters_are_omitted():
    alike = co.batch([co.systems.rigid_body(inertia=(2, 3, 4))] * 3)
    plain = co.batch([co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1, 2, c])) for c in CONSTANTS])
    for system in (alike, plain, BODIES[0]):
        assert parameters_of(system) == {}


def test_swept_parameters_of_forced_bodies():
    forced = co.batch([body.with_forces(co.forces.LinearDamping(0.1)) for body in BODIES])
    ((_, numbers, attributes),) = parameters_of(forced).values()
    assert np.array_equal(numbers, CONSTANTS) and attributes == {"long_name": "system.parameters.inertia[2]"}
