"""Damaged and hostile NetCDF and Zarr files: checksums, links, pickles and chunk lengths."""

import json
import os
import random
import shutil
import zlib
from contextlib import nullcontext

import h5py
import numpy as np
import pytest
from numcodecs import Blosc, Zstd

import coadjoint as co
from refusals import refused

CHECKSUM = "content_sha256"
BODY = co.systems.rigid_body(inertia=(1, 2, 2.5))
pytestmark = pytest.mark.filterwarnings(
    "ignore::zarr.errors.UnstableSpecificationWarning", "ignore:Consolidated metadata"
)


@pytest.fixture(scope="module")
def sol():
    return co.integrate(
        BODY, [(0.3, -1.0, 0.7), (0.1, 0.5, -0.2)], (0, 4), 0.125, observe={"q": co.Polynomial({(1, 1, 0): 2})}
    )


PACKED = {"x": {"zlib": True, "shuffle": True, "chunksizes": (7, 2, 3)}, "energy": {"zlib": True, "fletcher32": True}}
WRITERS = {
    "plain.nc": lambda ds, path: ds.to_netcdf(path, engine="h5netcdf"),
    "packed.nc": lambda ds, path: ds.to_netcdf(path, engine="h5netcdf", encoding=PACKED),
    "classic.nc": lambda ds, path: ds.to_netcdf(path, engine="scipy", format="NETCDF3_64BIT"),
    "second.zarr": lambda ds, path: ds.to_zarr(path, zarr_format=2),
    "third.zarr": lambda ds, path: ds.to_zarr(path, zarr_format=3),
}


@pytest.mark.thinned(4)
@pytest.mark.parametrize("name", WRITERS)
def test_checksum_is_independent_of_the_format(tmp_path, sol, name):
    WRITERS[name](sol.to_xarray(), tmp_path / name)
    found = co.load(tmp_path / name)
    assert found.attributes[CHECKSUM] == sol.to_xarray().attrs[CHECKSUM]
    assert np.array_equal(found.x, sol.x)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("name", ["plain.nc", "classic.nc", "second.zarr", "third.zarr"])
def test_changed_content_is_refused(tmp_path, sol, name):
    """Without the checksum attribute the content is read, unless its parts contradict each other."""
    changes = (
        (lambda ds: ds.assign(x=ds["x"].where(ds["time"] != 2.0, np.nextafter(ds["x"], 9.0))), None),
        (lambda ds: ds.assign_attrs(step=0.25), "0.125 is none at which the run saves"),
        (lambda ds: ds.assign_coords(component=["a", "b", "c"]), "component is ['a', 'b', 'c']"),
        (lambda ds: ds.isel(time=slice(0, 20)), None),
        (lambda ds: ds.assign(more=("time", np.zeros(ds.sizes["time"]))), None),
        (lambda ds: ds.drop_vars("observed_q"), None),
        (lambda ds: ds.assign(energy=ds["energy"].assign_attrs(long_name="power")), None),
    )
    for k, (change, contradiction) in enumerate(changes):
        dataset = change(sol.to_xarray())
        WRITERS[name](dataset, tmp_path / f"{k}{name}")
        with refused(ValueError, "checksum", CHECKSUM):
            co.load(tmp_path / f"{k}{name}")
        del dataset.attrs[CHECKSUM]
        WRITERS[name](dataset, tmp_path / f"without{k}{name}")
        with refused(ValueError, contradiction) if contradiction else nullcontext():
            np.testing.assert_array_equal(co.load(tmp_path / f"without{k}{name}").x, dataset["x"])


def replaced(file, name="energy", **options):
    values = file[name][()]
    del file[name]
    return file.create_dataset(name, data=None if "external" in options else values, **options)


def outside(file, path):
    replaced(file, shape=(33, 2), dtype="f8", external=[(path, 0, 528)])


def virtual(file, path):
    layout = h5py.VirtualLayout((33, 2), "f8")
    layout[:] = h5py.VirtualSource(path, "energy", (33, 2))
    del file["energy"]
    file.create_virtual_dataset("energy", layout)


def bomb(file, _):
    found = replaced(file, "x", chunks=(33, 2, 3), compression="gzip")
    found.id.write_direct_chunk((0, 0, 0), zlib.compress(bytes(2**26), 9))


def linked(file, link):
    del file["energy"]
    file["energy"] = link


HOSTILE = {
    "external link": (lambda file, path: linked(file, h5py.ExternalLink(path, "energy")), "is a link"),
    "soft link": (lambda file, path: linked(file, h5py.SoftLink("/x")), "is a link"),
    "external data": (lambda file, path: outside(file, path), "in other files"),
    "virtual data": (virtual, "in other files"),
    "bomb": (bomb, "another length"),
    "filter": (lambda file, path: replaced(file, compression="lzf"), "has the filters"),
    "group": (lambda file, path: file.create_group("more"), "is no variable"),
    "objects": (lambda file, path: file.create_dataset("o", data=np.zeros(2, "f8,i4")), "neither numbers nor text"),
}  # fmt: skip


@pytest.mark.thinned(3)
@pytest.mark.parametrize("kind", HOSTILE)
def test_hostile_hdf5_is_refused(tmp_path, sol, kind):
    change, message = HOSTILE[kind]
    for name in ("run.nc", "other.nc"):
        sol.to_xarray().to_netcdf(tmp_path / name, engine="h5netcdf")
    with h5py.File(tmp_path / "run.nc", "a") as file:
        change(file, str(tmp_path / "other.nc"))
    with refused(ValueError, message):
        co.load(tmp_path / "run.nc")


def edit(path, name, change):
    for file, keys in ((path / ".zmetadata", ("metadata", f"{name}/.zarray")), (path / name / ".zarray", ())):
        tree = json.loads(file.read_text())
        within = tree
        for key in keys:
            within = within[key]
        change(within)
        file.write_text(json.dumps(tree))


def zarr_link(path):
    (path / "x" / "0.0.0").rename(path.parent / "elsewhere")
    (path / "x" / "0.0.0").symlink_to(path.parent / "elsewhere")


def zarr_bomb(path):
    (path / "x" / "0.0.0").write_bytes(Blosc("zstd", 1).encode(np.zeros(2**22)))


def zstd_bomb(path):
    edit(path, "x", lambda about: about.update(compressor={"id": "zstd", "level": 1}))
    (path / "x" / "0.0.0").write_bytes(Zstd(1).encode(np.zeros(2**22)))


def path_as_name(path):
    tree = json.loads((path / ".zmetadata").read_text())
    tree["metadata"]["../other/.zarray"] = tree["metadata"]["x/.zarray"]
    (path / ".zmetadata").write_text(json.dumps(tree))


def change_array(change):
    """Change the metadata of an array, but not the index."""

    def changed(path):
        file = path / "x" / ".zarray"
        tree = json.loads(file.read_text())
        change(tree)
        file.write_text(json.dumps(tree))

    return changed


def change_both(**kwargs):
    return lambda path: edit(path, "x", lambda about: about.update(kwargs))


ZLIB = {"id": "zlib", "level": 1}
STORES = {
    "codec": (change_both(filters=[ZLIB]), "the codecs of"),
    "link": (zarr_link, "is a link"),
    "fifo": (lambda path: os.mkfifo(path / "x" / "0.0.1"), "is a link, or no file"),
    "blosc bomb": (zarr_bomb, "another length"),
    "zstd bomb": (zstd_bomb, "another length"),
    "chunk": (change_both(chunks=[2**28, 2, 3]), "larger than the array"),
    "name": (path_as_name, "no plain name"),
    "metadata": (lambda path: (path / ".zmetadata").write_text("[" * 10**5), "cannot be read"),
    "chunks in the array only": (change_array(lambda about: about.update(chunks=[33, 1, 3])), "contradict each other"),
    "codec in the array only": (change_array(lambda about: about.update(compressor=None)), "contradict each other"),
    "two packers": (change_both(filters=[{"id": "blosc"}], compressor={"id": "zstd"}), "the codecs of"),
    "objects": (change_both(dtype="|O"), "neither numbers nor text"),
    "end of the type": (change_both(dtype="<f8,<i4"), "neither numbers nor text"),
    "negative shape": (change_both(shape=[33, -2, 3]), "the shape of"),
    "fraction": (change_both(shape=[33, 2.0, 3]), "the shape of"),
}  # fmt: skip


@pytest.mark.thinned(4)
@pytest.mark.skipif(os.name == "nt", reason="links and FIFOs")
@pytest.mark.parametrize("kind", STORES)
def test_hostile_zarr_store_is_refused(tmp_path, sol, kind):
    change, message = STORES[kind]
    sol.to_xarray().to_zarr(tmp_path / "run.zarr", zarr_format=2)
    change(tmp_path / "run.zarr")
    with refused(ValueError, message):
        co.load(tmp_path / "run.zarr")


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", ["plain.nc", "packed.nc", "classic.nc", "second.zarr", "third.zarr"])
def test_random_damage_is_refused(tmp_path, sol, name):
    """Bytes are changed, cut or inserted: the run is read unchanged, or refused in one sentence."""
    WRITERS[name](sol.to_xarray(), tmp_path / name)
    for seed in range(12):
        rng, path = random.Random(f"{name} {seed}"), tmp_path / f"try{seed}{name}"
        (shutil.copytree if (tmp_path / name).is_dir() else shutil.copy)(tmp_path / name, path)
        file = rng.choice(sorted(one for one in path.rglob("*") if one.is_file())) if path.is_dir() else path
        content = bytearray(file.read_bytes())
        at = rng.randrange(len(content))
        how = rng.choice(["flip", "flip", "cut", "more"])
        if how == "flip":
            content[at] ^= 1 << rng.randrange(8)
        elif how == "cut":
            del content[at:]
        else:
            content[at:at] = rng.randbytes(5)
        file.write_bytes(content)
        try:
            assert np.array_equal(co.load(path).x, sol.x)
        except ValueError as refused:
            assert 10 < len(str(refused)) < 1000 and str(refused).isprintable(), seed


def test_number_of_zarr_texts_is_checked(tmp_path, sol):
    """Names of variable length, compressed or not, in both formats."""
    for number in (2, 3):
        path = tmp_path / f"{number}.zarr"
        dataset = sol.to_xarray()
        dataset = dataset.assign_coords(component=dataset["component"].astype(object))
        dataset.to_zarr(path, zarr_format=number)
        co.load(path)
        (chunk,) = (file for file in (path / "component").rglob("*") if file.name in ("0", "0.0"))
        about = json.loads((path / "component" / {2: ".zarray", 3: "zarr.json"}[number]).read_text())
        codecs = [each.get("id", each.get("name")) for each in about.get("codecs", [about.get("compressor")])]
        assert {2: "blosc", 3: "zstd"}[number] in codecs
        codec = {2: Blosc("lz4"), 3: Zstd(0)}[number]
        texts = bytes(codec.decode(chunk.read_bytes()))
        for other in (texts + b"\0", texts[:-1], (4).to_bytes(4, "little") + texts[4:], b""):
            chunk.write_bytes(codec.encode(other) if other else b"")
            with pytest.raises(ValueError):
                co.load(path)
