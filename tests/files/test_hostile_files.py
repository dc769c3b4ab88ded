"""Files of strangers and damaged files: checked by the sum over their content, and by what HDF5 and Zarr may do."""

import json
import os
import random
import shutil

import h5py
import numpy as np
import pytest
import xarray
from numcodecs import Blosc, Pickle, Zstd

import coadjoint as co
from coadjoint.files.content_checksum import CHECKSUM, checksum_of
from coadjoint.files.loaded_solution import LoadError
from coadjoint.files.output import write_dataset

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
    "own.nc": write_dataset,
    "own.zarr": write_dataset,
    "second.zarr": lambda ds, path: ds.to_zarr(path, zarr_format=2),
    "third.zarr": lambda ds, path: ds.to_zarr(path, zarr_format=3),
}


@pytest.mark.parametrize("name", WRITERS)
def test_the_sum_does_not_depend_on_how_the_content_is_written(tmp_path, sol, name):
    WRITERS[name](sol.to_xarray(), tmp_path / name)
    found = co.load(tmp_path / name)
    assert found.attributes[CHECKSUM] == sol.to_xarray().attrs[CHECKSUM] == checksum_of(found.dataset)
    assert np.array_equal(found.x, sol.x)


@pytest.mark.parametrize("name", ["plain.nc", "classic.nc", "second.zarr", "third.zarr"])
def test_what_was_changed_after_it_was_written_is_refused(tmp_path, sol, name):
    """Each kind of change through xarray; without the attribute the same is read, as files of earlier versions are."""
    changes = (
        lambda ds: ds.assign(x=ds["x"].where(ds["time"] != 2.0, np.nextafter(ds["x"], 9.0))),
        lambda ds: ds.assign_attrs(step=0.25),
        lambda ds: ds.assign_coords(component=["a", "b", "c"]),
        lambda ds: ds.isel(time=slice(0, 20)),
        lambda ds: ds.assign(more=("time", np.zeros(ds.sizes["time"]))),
        lambda ds: ds.drop_vars("observed_q"),
        lambda ds: ds.assign(energy=ds["energy"].assign_attrs(long_name="power")),
    )
    for k, change in enumerate(changes):
        dataset = change(sol.to_xarray())
        WRITERS[name](dataset, tmp_path / f"{k}{name}")
        with pytest.raises(
            LoadError, match=f"its content does not match its check sum.*remove its attribute {CHECKSUM}"
        ):
            co.load(tmp_path / f"{k}{name}")
        del dataset.attrs[CHECKSUM]
        WRITERS[name](dataset, tmp_path / f"without{k}{name}")
        assert co.load(tmp_path / f"without{k}{name}").x.shape[1:] == (2, 3)


def test_a_flipped_bit_of_a_number_is_noticed(tmp_path, sol):
    sol.to_xarray().to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    with h5py.File(tmp_path / "run.nc") as file:
        at = file["x"].id.get_offset()
    content = bytearray((tmp_path / "run.nc").read_bytes())
    content[at + 100] ^= 1
    (tmp_path / "run.nc").write_bytes(content)
    with pytest.raises(LoadError, match="check sum"):
        co.load(tmp_path / "run.nc")


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
    import zlib

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
    "bomb": (bomb, "has a chunk of another length than declared"),
    "filter": (lambda file, path: replaced(file, compression="lzf"), "has the filters"),
    "group": (lambda file, path: file.create_group("more"), "is no variable"),
    "objects": (lambda file, path: file.create_dataset("o", data=np.zeros(2, "f8,i4")), "neither numbers nor text"),
}  # fmt: skip


@pytest.mark.parametrize("kind", HOSTILE)
def test_hdf5_refers_to_nothing_and_is_as_long_as_it_says(tmp_path, sol, kind):
    change, said = HOSTILE[kind]
    for name in ("run.nc", "other.nc"):
        sol.to_xarray().to_netcdf(tmp_path / name, engine="h5netcdf")
    with h5py.File(tmp_path / "run.nc", "a") as file:
        change(file, str(tmp_path / "other.nc"))
    with pytest.raises(LoadError, match=said):
        co.load(tmp_path / "run.nc")


class Sentinel:
    unpickled = False

    def __reduce__(self):
        return setattr, (Sentinel, "unpickled", True)


def edit(path, name, change):
    for file, place in ((path / ".zmetadata", ("metadata", f"{name}/.zarray")), (path / name / ".zarray", ())):
        tree = json.loads(file.read_text())
        within = tree
        for key in place:
            within = within[key]
        change(within)
        file.write_text(json.dumps(tree))


def pickled(path):
    edit(path, "component", lambda about: about.update(dtype="|O", filters=[{"id": "pickle"}], compressor=None))
    (path / "component" / "0").write_bytes(Pickle().encode(np.array([Sentinel()] * 3, dtype=object)))


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


ZLIB = {"id": "zlib", "level": 1}
STORES = {
    "pickle": (pickled, "is stored by pickle"),
    "codec": (lambda path: edit(path, "x", lambda about: about.update(filters=[ZLIB])), "the codecs of"),
    "link": (zarr_link, "is a link"),
    "fifo": (lambda path: os.mkfifo(path / "x" / "0.0.1"), "is a link, or no file"),
    "blosc bomb": (zarr_bomb, "another length"),
    "zstd bomb": (zstd_bomb, "another length"),
    "chunk": (lambda path: edit(path, "x", lambda about: about.update(chunks=[2**28, 2, 3])), "larger than the array"),
    "name": (path_as_name, "no plain name"),
    "metadata": (lambda path: (path / ".zmetadata").write_text("[" * 10**5), "cannot be read"),
}  # fmt: skip


@pytest.mark.skipif(os.name == "nt", reason="links and FIFOs")
@pytest.mark.parametrize("kind", STORES)
def test_a_zarr_store_refers_to_nothing_and_unpickles_nothing(tmp_path, sol, kind):
    change, said = STORES[kind]
    write_dataset(sol.to_xarray(), tmp_path / "run.zarr")
    change(tmp_path / "run.zarr")
    with pytest.raises(LoadError, match=said):
        co.load(tmp_path / "run.zarr")
    assert not Sentinel.unpickled


@pytest.mark.parametrize("name", ["plain.nc", "packed.nc", "classic.nc", "own.zarr", "third.zarr"])
def test_damaged_anywhere(tmp_path, sol, name):
    """Bytes are changed, cut or put in: the same run is read, or one sentence says why not."""
    WRITERS[name](sol.to_xarray(), tmp_path / name)
    for seed in range(15):
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


def test_a_file_of_an_archive_has_its_sum_as_well(tmp_path):
    found = co.integrate(BODY, (0.3, -1.0, 0.7), (0, 4), 0.125, archive=tmp_path / "archive.zarr")
    write_dataset(found.to_xarray(), tmp_path / "run.nc")
    with xarray.open_dataset(tmp_path / "run.nc", engine="h5netcdf") as dataset:
        assert dataset.attrs[CHECKSUM] == checksum_of(dataset)
    assert np.array_equal(co.load(tmp_path / "run.nc").x, found.x)
