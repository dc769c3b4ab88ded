"""Content of archives is bound to its run and place: working directories, replaced runs, damaged and moved content."""

import os
import pickle
import shutil
import zipfile
from pathlib import Path

import fsspec
import numpy as np
import pytest
from storing import at_write

import coadjoint as co
from hostile_archives import BODY, HIDDEN, ROOT, SPAN, STEP, X, archives, begin
from long import long_beyond
from refusals import refused
from same_runs import check_same

NAMES = ("vector", "members", "finished", "blocks")
MANY = np.multiply.outer([1.0, 0.5, 0.2], X)
pytestmark = pytest.mark.usefixtures("no_fsync")


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    folder = tmp_path_factory.mktemp("identity") / "base"
    assert tuple(archives(folder)) == NAMES
    return folder


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A working directory, beside another one in which the same name is another run."""
    for name, x0 in (("here", X), ("there", (0.1, 0.9, 0.4))):
        (tmp_path / name).mkdir()
        sol = co.integrate(BODY, x0, SPAN, STEP, archive=tmp_path / name / "run.zarr")
        sol.to_xarray().to_netcdf(tmp_path / name / "run.nc")
        shutil.make_archive(str(tmp_path / name / "run"), "zip", tmp_path / name / "run.zarr")
    monkeypatch.chdir(tmp_path / "here")
    return co.integrate(BODY, X, SPAN, STEP)


OPENINGS = {
    "path": lambda: co.open_archive("run.zarr"),
    "load": lambda: co.load(Path("run.zarr")),
    "resumed": lambda: co.resume("run.zarr", 5.0),
    "new": lambda: co.integrate(BODY, X, SPAN, STEP, archive="new.zarr"),
    "ensemble": lambda: co.integrate_ensemble(BODY, [X, X], SPAN, STEP, archive="new.zarr"),
    "dataset": lambda: co.load("run.nc"),
    "local URL": lambda: co.open_archive(f"file://{os.getcwd()}/run.zarr"),
    "mapping": lambda: co.open_archive(fsspec.get_mapper("run.zarr")),
    "packed": lambda: co.open_archive("zip://::run.zip"),
}


@pytest.mark.parametrize("copied", [lambda sol: sol, lambda sol: pickle.loads(pickle.dumps(sol))], ids=["", "pickled"])
@pytest.mark.parametrize("opening", OPENINGS)
def test_solutions_are_those_of_the_directory_in_which_they_were_opened(here, monkeypatch, opening, copied):
    sol = OPENINGS[opening]()
    data = pickle.dumps(sol)
    monkeypatch.chdir("../there")
    for found in (copied(sol), pickle.loads(data)):
        x = found.x[:, 0] if opening == "ensemble" else found.x
        assert np.array_equal(x[: len(here.x)], here.x)
        assert opening == "packed" or Path(found.path).is_absolute()


@pytest.mark.parametrize("count", [1, 20])
def test_the_directory_may_change_during_a_run(here, count):
    with at_write(lambda name: True, count, lambda: os.chdir("/")):
        sol = co.integrate(BODY, X, SPAN, STEP, archive="moving.zarr")
    assert os.getcwd() == "/" and np.array_equal(sol.x, here.x)


def other_run(name, path):
    """Write another run in place of an archive."""
    shutil.rmtree(path)
    if name == "blocks":
        co.integrate_ensemble(BODY, 0.5 * MANY, SPAN, STEP, archive=path, members_per_block=2)
    else:
        begin(path, x0=0.5 * MANY if name == "members" else (0.1, 0.9, 0.4))


@pytest.mark.parametrize("name", NAMES)
def test_an_archive_that_was_replaced_is_not_mixed_with_the_new_one(base, tmp_path, name):
    path = tmp_path / "run.zarr"
    shutil.copytree(base / name, path)
    sol = co.open_archive(path)
    data, kept, energy = sol.to_xarray(), pickle.dumps(sol), sol.energy
    other_run(name, path)
    assert not np.array_equal(co.open_archive(path).energy, energy)
    for read in (lambda: sol.x, lambda: data["x"][-1].values, lambda: sol.x0, lambda: pickle.loads(kept)):
        with refused(ValueError, path, "another run has taken the place"):
            read()
    shutil.rmtree(path)
    for read in (lambda: sol.x, lambda: data["energy"][0].values, lambda: pickle.loads(kept)):
        with refused(ValueError, path, "there is no archive"):
            read()


@pytest.mark.parametrize("name", ["vector", "members", "damped", "blocks"])
def test_replaced_archives_of_format_1_are_noticed(tmp_path, name):
    """They have no checksums of contents; the run is told by its first step."""
    with zipfile.ZipFile(Path(__file__).parent / "reference_archives" / "format_1.zip") as held:
        held.extractall(tmp_path)
    path = tmp_path / f"{name}.zarr"
    sol = co.open_archive(path)
    assert np.isfinite(sol.energy).all()
    other_run(name, path)
    with refused(ValueError, path, "another run has taken the place"):
        _ = sol.x


# Damaged metadata.


def attributes_and_values(sol):
    return sol.attributes, sol.to_xarray().load().to_dict()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", long_beyond(1, range(8)))
def test_a_flipped_bit_of_the_root_is_noticed(base, tmp_path, name, seed):
    """Each digit of the attributes, and any bits; those that xarray alone reads change nothing."""
    path, rng = tmp_path / "run.zarr", np.random.default_rng(seed)
    shutil.copytree(base / name, path)
    raw, expected = (path / ROOT).read_bytes(), repr(attributes_and_values(co.open_archive(path)))
    end = raw.index(b'"consolidated_metadata"')
    digits = [k for k in range(end) if raw[k : k + 1].isdigit()]
    refusals, chosen = 0, [*rng.choice(digits, 60, replace=False), *rng.choice(len(raw), 40, replace=False)]
    for at in chosen:
        (path / ROOT).write_bytes(raw[:at] + bytes([raw[at] ^ 1 << rng.integers(7)]) + raw[at + 1 :])
        try:
            found = co.open_archive(path)
        except ValueError:
            refusals += 1
        else:
            assert repr(attributes_and_values(found)) == expected, raw[at - 20 : at + 20]
    assert refusals >= 60


@pytest.mark.parametrize("flip", range(3))
def test_a_flipped_bit_of_a_marker_is_noticed(base, tmp_path, flip):
    """Its members are computed again."""
    path = tmp_path / "run.zarr"
    shutil.copytree(base / "blocks", path)
    marker = path / HIDDEN / "block-000000"
    raw = bytearray(marker.read_bytes())
    raw[(70, 100, len(raw) - 30)[flip]] ^= 1
    marker.write_bytes(raw)
    with refused(ValueError, path, "block-000000 is damaged"):
        _ = co.open_archive(path).x
    assert np.array_equal(co.resume(path).x, co.integrate(BODY, MANY, SPAN, STEP).x)


# Intact content at the wrong place.


def exchanged(one, other):
    content = one.read_bytes()
    shutil.copy(other, one)
    other.write_bytes(content)


def of_another_run(name, *chunks):
    """Take chunks of a run that differs in its start."""

    def change(path):
        other = path.with_name("other.zarr")
        shutil.copytree(path, other)
        other_run(name, other)
        for chunk in chunks:
            shutil.copy(other / chunk, path / chunk)

    return change


MISPLACED = {
    "energy and Casimir": ("finished", lambda p: exchanged(p / "energy/c.0", p / "casimir_x_2/c.0"), "energy/c.0"),
    "time": ("vector", lambda p: exchanged(p / "energy/c.0", p / "time/c.0"), "time/c.0"),
    "x of another run": ("vector", of_another_run("vector", "x/c.0.0"), "x/c.0.0"),
    "start of another run": ("members", of_another_run("members", "x0/c.0.0"), "x0/c.0.0"),
    "drift of another run": ("vector", of_another_run("vector", "drift/c.0.0"), "drift/c.0.0"),
    "names": ("vector", lambda p: shutil.copy(p / "invariant/c.0", p / "component/c.0"), "component/c.0"),
    "blocks": ("blocks", lambda p: shutil.copy(p / "x/c.0.1.0", p / "x/c.0.0.0"), "x/c.0.0.0"),
    "block of another run": ("blocks", of_another_run("blocks", "x/c.0.0.0"), "x/c.0.0.0"),
    "drifts of another run": ("blocks", of_another_run("blocks", "drift/c.0.0.0"), "drift/c.0.0.0"),
    "marker of another block": (
        "blocks",
        lambda p: shutil.copy(p / HIDDEN / "block-000000", p / HIDDEN / "block-000001"),
        "block-000001",
    ),
    "marker of another run": ("blocks", of_another_run("blocks", f"{HIDDEN}/block-000000"), "block-000000"),
}


@pytest.mark.parametrize("case", MISPLACED)
def test_intact_content_at_another_place_is_damage(base, tmp_path, case):
    name, change, named = MISPLACED[case]
    path = tmp_path / "run.zarr"
    shutil.copytree(base / name, path)
    change(path)
    with refused(ValueError, path, f"{named} is damaged"):
        co.open_archive(path).to_xarray().load()


def test_chunks_of_other_times_are_damage(tmp_path):
    """Also an earlier version of the same chunk, with fewer points."""
    path, body = tmp_path / "run.zarr", co.systems.rigid_body((1, 2, 2.5))
    many = np.random.default_rng(1).standard_normal((171, 3))
    co.integrate(body, many, (0, 1), STEP, archive=path)
    early = (path / "x" / "c.0.0.0").read_bytes()
    sol = co.resume(path, 260.0)
    assert len(list((path / "x").glob("c.*"))) == 3 and np.isfinite(sol.x).all()
    for content, name in ((early, "x/c.0.0.0"), ((path / "x/c.0.0.0").read_bytes(), "x/c.1.0.0")):
        whole = (path / name).read_bytes()
        (path / name).write_bytes(content)
        with refused(ValueError, f"{name} is damaged"):
            _ = co.open_archive(path).x
        (path / name).write_bytes(whole)
    assert np.array_equal(co.open_archive(path).x, sol.x)


def test_points_beyond_the_last_commit_are_not_shown(base, tmp_path):
    """Those of a block that is being computed; its marker says how many there are."""
    path = tmp_path / "run.zarr"
    co.integrate_ensemble(BODY, MANY, SPAN, STEP, archive=path, members_per_block=1)
    (path / HIDDEN / "block-000001").unlink()
    found = co.open_archive(path)
    assert (
        found.status.tolist() == [1, 0, 1] and np.isnan(found.x[:, 1]).all() and not np.isnan(found.x[:, [0, 2]]).any()
    )
    check_same(co.resume(path), co.integrate(BODY, MANY, SPAN, STEP))


def test_archives_are_read_while_they_grow(tmp_path):
    """Opened at every step, and while the next ones are written."""
    path = tmp_path / "run.zarr"
    begin(path, until=3, attitude="coadjoint")
    for until in (5, 13, 14, None):
        earlier = co.open_archive(path)
        sol = co.resume(path, until=until)
        earlier.to_xarray().load()
        sol.check_complete()
    check_same(sol, co.integrate(BODY, X, SPAN, STEP, co.GaussLegendre(2), save_every=2, attitude="coadjoint"))
