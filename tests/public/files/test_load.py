"""Loading runs from NetCDF, Zarr and archives: orders of names, given systems, files of others."""

import json
import os
import pickle
import shutil
from pathlib import Path

import h5py
import numcodecs
import numpy as np
import pytest
import xarray

import coadjoint as co
from command import command
from refusals import refused
from same_runs import same_bits

pytestmark = [
    pytest.mark.filterwarnings("ignore::zarr.errors.UnstableSpecificationWarning"),
    pytest.mark.filterwarnings("ignore:Consolidated metadata"),
]

X = (1.0, 0.1, 0.5)
BODY = co.systems.rigid_body()
P = co.Polynomial({(1, 1, 0): 1})
RUNS = {
    "one member": lambda: co.integrate(BODY, X, (0.0, 2.0), 0.1, co.Splitting(order=4), save_every=3),
    "observed": lambda: co.integrate(BODY, X, (0.0, 2.0), 0.1, observe={"a b": P}),
}
WAYS = {
    "to_netcdf": lambda sol, path: sol.to_xarray().to_netcdf(path, engine="h5netcdf"),
    "to_netcdf alone": lambda sol, path: sol.to_xarray().to_netcdf(path),
    "to_zarr": lambda sol, path: sol.to_xarray().to_zarr(path),
}


def test_casimirs_and_observed_quantities_are_loaded_in_the_order_of_the_run(tmp_path):
    """Files list arrays by their labels, of which the tenth comes before the second."""
    free, names = co.LieAlgebra([], dim=3), ["z", "b 1", "a", "C", *(f"{k} y" for k in range(12, 0, -1))]
    values = {name: co.Polynomial({(1, 0, 0): k + 1, (0, 1, 1): 1}) for k, name in enumerate(names)}
    system = co.LiePoissonSystem(free, co.Quadratic([1.0, 2.0, 3.0]), casimirs=values)
    sol = co.integrate(system, X, (0, 1), 0.25, observe=values, archive=tmp_path / "archive")
    for name, way in {**WAYS, "archive": None}.items():
        path = tmp_path / name
        if way is not None:
            way(sol, path)
            path = next(each for each in tmp_path.iterdir() if each.stem == path.stem and each != tmp_path / "archive")
        found = co.load(path)
        assert list(found.casimirs) == list(found.observed) == names, name
        assert list(found.initial) == list(found.drift()) == ["energy", *names], name
        casimirs, observed, initial = found.casimirs, found.observed, found.initial
        for k, label in enumerate(names):
            expected = (k + 1) * X[0] + X[1] * X[2]
            for number in (casimirs[label][0], observed[label][0], initial[label]):
                assert number == pytest.approx(expected, rel=1e-14), (name, label)
        if path.name != "archive":
            path.unlink() if path.is_file() else shutil.rmtree(path)


def test_other_files_are_refused(tmp_path):
    (tmp_path / "a.txt").write_text("nothing", encoding="utf-8")
    (tmp_path / "empty.nc").touch()
    (tmp_path / "folder").mkdir()
    (tmp_path / "cut.nc").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    (tmp_path / "cdf.nc").write_bytes(b"CDF\x01" + bytes(3))
    with h5py.File(tmp_path / "other.nc", "w") as file:
        file["x"] = np.ones(3)
    xarray.Dataset({"x": ("time", np.ones(3))}).to_zarr(tmp_path / "other.zarr")
    sol = RUNS["one member"]()
    sol.to_xarray().drop_vars("x0").to_netcdf(tmp_path / "less.nc", engine="h5netcdf")
    said = {
        "none.nc": "No such file",
        "folder": "holds no run",
        "other.zarr": "holds no run",
        "less.nc": "holds no run",
    }
    names = ("a.txt", "empty.nc", "cut.nc", "cdf.nc", "other.nc", "x" * 3000, *said)
    for name in names:
        with refused(ValueError, said.get(name, "")) as caught:
            co.load(tmp_path / name)
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 1000, name
    for wrong in (None, 3, b"a.nc", ["a.nc"]):
        with refused(TypeError, "path"):
            co.load(wrong)


class CreatingFolder:
    """An object that creates a folder when it is unpickled."""

    def __init__(self, folder):
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder),)


@pytest.mark.thinned(12)
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "codecs",
    [
        {"filters": [{"id": "pickle"}], "compressor": None},
        {"filters": [{"id": "vlen-utf8"}, {"id": "pickle"}], "compressor": None, "dtype": "|O", "fill_value": ""},
        {"filters": [{"id": "vlen-utf8"}], "compressor": {"id": "pickle"}, "dtype": "|O", "fill_value": ""},
    ],
)
@pytest.mark.parametrize("consolidated", [True, False])
@pytest.mark.parametrize("name", ["x", "time"])
def test_pickled_codecs_are_not_executed(tmp_path, monkeypatch, codecs, consolidated, name):
    """Whatever numcodecs allows; xarray reads coordinates when it opens a dataset."""
    monkeypatch.setattr("numcodecs.pickles.ALLOW_UNSAFE_PICKLE_DECODE", True, raising=False)
    assert pickle.loads(numcodecs.Pickle().encode([1])) == [1]
    path, run = tmp_path / "run.zarr", tmp_path / "run"
    RUNS["one member"]().to_xarray().to_zarr(path, zarr_format=2, consolidated=consolidated)
    metadata = json.loads((path / name / ".zarray").read_text()) | codecs
    (path / name / ".zarray").write_text(json.dumps(metadata))
    if consolidated:
        expected = json.loads((path / ".zmetadata").read_text())
        expected["metadata"][f"{name}/.zarray"] = metadata
        (path / ".zmetadata").write_text(json.dumps(expected))
    for chunk in (path / name).glob("[0-9]*"):
        chunk.write_bytes(pickle.dumps(CreatingFolder(run)))
    with pytest.raises(ValueError, match=r"is stored by pickle|cannot be read as a dataset"):
        co.load(path)
    assert not run.exists()


class Energy:
    """An energy that depends on the time."""

    def __call__(self, x, t):
        return 0.5 * (x[0] ** 2 + 2 * x[1] ** 2 + 3 * x[2] ** 2) + t * x[0]


class Slope:
    def __call__(self, x, t):
        return np.array([x[0] + t, 2 * x[1], 3 * x[2]])


def driven():
    return co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(Energy(), Slope()))


@pytest.mark.parametrize("x0", [X, [X, X[::-1], (0.5, -0.5, 0.25)]], ids=["one member", "three members"])
@pytest.mark.parametrize("span", [(7.5, 9.5), (7.5, 5.5)])
def test_initial_energy_uses_the_initial_time(tmp_path, x0, span):
    """Also if the first saved time is later, with a system given to `load`."""
    times = 7.5 + np.sign(span[1] - 7.5) * np.array([0.4, 1.3])
    sol = co.integrate(BODY, x0, span, 0.125, t_eval=times)
    sol.to_xarray().to_netcdf(tmp_path / "run.nc")
    found, states = co.load(tmp_path / "run.nc", driven()), np.asarray(x0)
    wanted = 0.5 * states**2 @ [1.0, 2.0, 3.0] + 7.5 * states[..., 0]
    # Sums of a few terms below 10, in any order.
    np.testing.assert_allclose(found.initial["energy"], wanted, rtol=0, atol=1e-14)
    assert np.shape(found.initial["energy"]) == np.shape(sol.initial["energy"])
    np.testing.assert_allclose(found.initial["|x|^2"], np.sum(states**2, axis=-1), rtol=0, atol=1e-14)
    assert list(found.initial) == list(sol.initial)


def test_changing_the_dataset_leaves_the_solution(tmp_path):
    sol = RUNS["observed"]()
    sol.to_xarray().to_netcdf(tmp_path / "run.nc")
    found = co.load(tmp_path / "run.nc")
    assert found.observed["a b"] is found.observed["a b"] and found.casimirs["|x|^2"] is found.casimirs["|x|^2"]
    dataset = found.to_xarray()
    dataset["more"] = ("time", np.zeros(len(sol.t)))
    dataset.attrs["watch"] = 0
    del dataset["energy"]
    assert (
        same_bits(found.energy, sol.energy)
        and "more" not in found.to_xarray()
        and found.to_xarray().attrs["watch"] == 1
    )


def test_a_run_beyond_memory_is_refused(tmp_path):
    """By the size that its arrays declare, of which no byte is stored."""
    RUNS["one member"]().to_xarray().to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    with h5py.File(tmp_path / "run.nc", "a") as file:
        file.create_dataset("more", (10**15,), "f8", chunks=(10**6,))
    with refused(ValueError, "run.nc", "needs about"):
        co.load(tmp_path / "run.nc")


FLUID = co.systems.sphere_euler(4)
CONFIGURED = """
[system]
name = "rigid_body"
parameters = { inertia = [1.0, 2.0, 2.5] }
[initial]
x = "pipe.npy"
[run]
t_span = [0.0, 1.0]
step = 0.125
"""
PIPES = {
    "a run": ("pipe.nc", lambda pipe: co.load(pipe)),
    "a state": ("pipe.npy", lambda pipe: FLUID.from_file(pipe)),
    "a field": ("pipe.nc", lambda pipe: FLUID.from_file(pipe)),
    "a step": ("pipe.cpp", lambda pipe: co.methods.compile_step(pipe)),
    "a header": ("pipe.h", lambda pipe: co.export_c(co.prepare(BODY, co.Splitting(), 0.1), pipe)),
}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes")
@pytest.mark.parametrize("case", PIPES)
def test_pipes_are_refused_without_waiting(tmp_path, monkeypatch, case):
    name, use = PIPES[case]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.toml").write_text(CONFIGURED)
    (tmp_path / name).parent.mkdir(exist_ok=True)
    os.mkfifo(name)
    with refused((ValueError, OSError), name, "no regular file"):
        use(tmp_path / name)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes")
@pytest.mark.parametrize("name", ["pipe.npy", "out.zarr/.zmetadata"])
def test_a_configured_run_does_not_wait_for_pipes(tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.toml").write_text(CONFIGURED)
    (tmp_path / "out.zarr").mkdir()
    (tmp_path / "out.zarr" / ".zgroup").touch()
    np.save("pipe.npy", X)
    (tmp_path / name).unlink(missing_ok=True)
    os.mkfifo(name)
    done = command(capsys, "run", "run.toml", "--out", "out.zarr")
    assert done.status == 2 and done.err.count("\n") == 1 and Path(name).parts[0] in done.err
