"""Output files: complete or absent, with early refusal of invalid targets."""

import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from pathlib import Path

import numpy as np
import pytest
import xarray
from matplotlib.figure import Figure

import coadjoint
from coadjoint.files.datasets.content_checksum import with_checksum
from coadjoint.files.datasets.writers import MAX_CACHED_BYTES, PAGE_BYTES, DeferredErrorFile
from coadjoint.files.output.atomic_output import OutputAbandoned, PendingOutput
from coadjoint.files.output.output_files import OutputError, check_target, write_dataset, write_figure
from coadjoint.optional_packages import MissingPackageError

pytestmark = pytest.mark.thinned(3)

ENGINE = {".nc": "h5netcdf", ".zarr": "zarr"}
SMALL = xarray.Dataset({"x": ("time", np.arange(3.0))}, {"time": [0.0, 1.0, 2.0]}, {"about": "three numbers"})
# The last variable exceeds the memory cache of a file that cannot be written.
LARGE = SMALL.assign(y=("point", np.arange(2.0 * MAX_CACHED_BYTES / 8)))

# A limit of file sizes: writes beyond it fail as on a full disk.
LIMITED = """
import os, resource, sys
import numpy as np, xarray
from coadjoint.files.output.output_files import write_dataset
dataset = xarray.open_dataset(sys.argv[1], engine="h5netcdf").load()
target = sys.argv[2]
for limit in map(int, sys.argv[3:]):
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    try:
        write_dataset(dataset, target)
    except OSError as error:
        print(error.strerror)
    assert sorted(os.listdir(".")) == ["given.nc", target], os.listdir(".")
"""


@pytest.mark.long
@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
@pytest.mark.parametrize("dataset", [SMALL, LARGE], ids=["small", "large"])
def test_full_disk_preserves_the_old_file(tmp_path, suffix, dataset):
    write_dataset(dataset, tmp_path / "given.nc")
    write_dataset(xarray.Dataset({"old": ("time", [1.0])}), tmp_path / f"run{suffix}")
    # Sizes at which the beginning or the end of a file is cut; a store can have one byte.
    size = (tmp_path / "given.nc").stat().st_size if suffix == ".nc" else 100
    limits = [str(int(part * (size - 1))) for part in (0.01, 0.1, 0.5, 0.9)]
    command = [sys.executable, "-c", LIMITED, "given.nc", f"run{suffix}", *limits]
    environment = {**os.environ, "PYTHONPATH": str(Path(coadjoint.__file__).parents[1])}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == ["File too large"] * len(limits)
    with xarray.open_dataset(tmp_path / f"run{suffix}", engine=ENGINE[suffix]) as stored:
        assert list(stored) == ["old"]


@pytest.mark.parametrize("name", ["run.nc", "run.zarr"])
def test_replacement_is_atomic(tmp_path, monkeypatch, name):
    target, engine = tmp_path / name, ENGINE[Path(name).suffix]
    write_dataset(xarray.Dataset({"x": ("time", np.arange(3.0))}), target)
    write_dataset(xarray.Dataset({"y": ("time", np.arange(4.0))}), target)

    @contextmanager
    def full(self):
        raise OSError("no space left on device")
        yield

    with monkeypatch.context() as patch:
        patch.setattr(PendingOutput, "writing", full)
        with pytest.raises(OSError, match="no space left"):
            write_dataset(xarray.Dataset(), target)
    with xarray.open_dataset(target, engine=engine) as stored:
        assert list(stored) == ["y"]
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_deferred_error_file_reads_its_writes(tmp_path):
    rng = np.random.default_rng(1)
    wanted, broken = bytearray(), False

    @contextmanager
    def failing_from_the_middle_on():
        if broken:
            raise OSError("no space left")
        yield

    file = DeferredErrorFile(tmp_path / "image", failing_from_the_middle_on)
    for turn in range(200):
        broken = turn >= 100
        at, length = int(rng.integers(0, 4 * PAGE_BYTES)), int(rng.integers(1, 2 * PAGE_BYTES))
        piece = rng.bytes(length)
        wanted.extend(bytes(max(0, at + length - len(wanted))))
        wanted[at : at + length] = piece
        assert file.seek(at) == at and file.write(piece) == length and file.tell() == at + length
        assert file.seek(0, os.SEEK_END) == len(wanted)
        at = int(rng.integers(0, len(wanted)))
        file.seek(at)
        assert file.read(PAGE_BYTES) == wanted[at : at + PAGE_BYTES]
    file.seek(0)
    file.write(b"1" * (MAX_CACHED_BYTES + 1))  # dropped, so that memory is bounded
    assert file.seek(0) == 0 and file.read(len(wanted)) == wanted
    assert file.truncate(10) == 10 and file.seek(0) == 0 and file.read() == wanted[:10]
    with pytest.raises(OSError, match="no space left"):
        file.close()


def test_partial_reads_and_writes_are_continued(tmp_path, monkeypatch):
    real = os.pwrite, os.pread
    monkeypatch.setattr(os, "pwrite", lambda file, piece, at: real[0](file, piece[:1000], at))
    monkeypatch.setattr(os, "pread", lambda file, length, at: real[1](file, min(length, 700), at))
    write_dataset(LARGE.isel(point=slice(5000)), tmp_path / "run.nc")
    monkeypatch.undo()
    with xarray.open_dataset(tmp_path / "run.nc", engine="h5netcdf") as found:
        xarray.testing.assert_identical(found.load(), with_checksum(LARGE.isel(point=slice(5000))))
    with DeferredErrorFile(tmp_path / "image", nullcontext) as file:
        monkeypatch.setattr(os, "pread", lambda file, length, at: real[1](file, min(length, 700), at))
        assert file.write(bytes(range(256)) * 10) == 2560 and file.seek(0) == 0
        assert file.read() == bytes(range(256)) * 10


def test_abandoned_output_is_not_written(tmp_path):
    with PendingOutput(tmp_path / "run.nc") as unfinished:
        unfinished.abandon()
        with pytest.raises(OutputAbandoned), unfinished.writing():
            pass
    assert list(tmp_path.iterdir()) == []


def test_abandoning_waits_for_the_current_write(tmp_path):
    with PendingOutput(tmp_path / "run.nc") as unfinished, ThreadPoolExecutor(1) as pool:
        begun, ended = threading.Event(), threading.Event()

        def write():
            with unfinished.writing():
                begun.set()
                # `abandon` must wait for this; a file created later would remain.
                assert not abandoned.wait(timeout=0.2)
                unfinished.path.write_text("a piece")
                ended.set()

        abandoned = threading.Event()
        written = pool.submit(write)
        assert begun.wait(timeout=60)
        unfinished.abandon()
        abandoned.set()
        assert ended.is_set() and written.exception(timeout=60) is None
    assert list(tmp_path.iterdir()) == []


def thesis(store):
    (store / "thesis.tex").write_text("precious")
    return "thesis.tex"


def beside_the_numbers(store):
    (store / "x" / "notes.txt").write_text("precious")
    return "x/notes.txt"


def empty_folder(store):
    (store / "drafts").mkdir()
    return "drafts/"


def link(store):
    (store / "link").symlink_to(store.parent)
    return "link"


def another_variable(store):
    xarray.Dataset({"mine": ("time", [1.0, 2.0, 3.0])}).to_zarr(store, mode="a", zarr_format=2, consolidated=True)
    return ".zattrs"


@pytest.mark.parametrize("add", [thesis, beside_the_numbers, empty_folder, link, another_variable])
def test_store_with_other_content_is_not_replaced(tmp_path, add):
    target = tmp_path / "run.zarr"
    write_dataset(SMALL, target)
    write_dataset(SMALL, target)
    found = add(target)
    before = sorted(target.rglob("*"))
    with pytest.raises(OutputError) as refused:
        write_dataset(SMALL, target)
    assert str(refused.value).startswith(f"{target}: holds {found}, ")
    assert sorted(target.rglob("*")) == before
    assert [path.name for path in tmp_path.iterdir()] == ["run.zarr"]


@pytest.mark.parametrize("there", ["nothing", "a file", "an empty folder", "a store", "itself"])
def test_link_at_the_store_path_is_not_followed(tmp_path, there):
    """Its target is unchanged; only a link to a store of the library is replaced."""
    target, behind = tmp_path / "run.zarr", tmp_path / "behind"
    target.symlink_to(target if there == "itself" else behind)
    if there == "a file":
        behind.write_text("precious")
    elif there == "an empty folder":
        behind.mkdir()
    elif there == "a store":
        write_dataset(SMALL, tmp_path / "behind.zarr")
        (tmp_path / "behind.zarr").rename(behind)
    before = sorted((path, path.is_symlink()) for path in tmp_path.rglob("*"))
    with pytest.raises(OutputError if there != "a store" else OSError):
        check_target(target)
        write_dataset(SMALL, target)
    assert sorted((path, path.is_symlink()) for path in tmp_path.rglob("*")) == before


@pytest.mark.parametrize("version", [2, 3])
def test_store_of_another_program_is_not_replaced(tmp_path, version):
    target = tmp_path / "run.zarr"
    SMALL.to_zarr(target, zarr_format=version, consolidated=version == 2)
    with pytest.raises(OutputError, match="coadjoint did not write"):
        check_target(target)


def test_folder_with_a_store_marker_is_not_replaced(tmp_path):
    target = tmp_path / "run.zarr"
    target.mkdir()
    (target / "zarr.json").write_text("{}")
    (target / "thesis.tex").write_text("precious")
    with pytest.raises(OutputError, match=r"holds thesis\.tex"):
        write_dataset(SMALL, target)
    assert (target / "thesis.tex").read_text() == "precious"


@pytest.mark.parametrize("index", ['{"coadjoint_files": 3}', "[" * 10**5, '{"coadjoint_files": [[]]}', "[]", "\xff"])
def test_store_with_a_damaged_index_is_not_replaced(tmp_path, index):
    target = tmp_path / "run.zarr"
    write_dataset(SMALL, target)
    (target / ".zmetadata").write_text(index, encoding="latin-1")
    with pytest.raises(OutputError, match="coadjoint did not write"):
        check_target(target)


@pytest.mark.parametrize("suffix", [".nc", ".zarr", ".png"])
def test_long_names_are_refused_early(tmp_path, suffix):
    suffixes = (".nc", ".zarr", ".png")
    with pytest.raises(OutputError, match=r"cannot be written \(File name too long\); give a shorter name"):
        check_target(tmp_path / f"{'a' * 256}{suffix}", suffixes)
    longest = tmp_path / f"{'a' * (255 - len(suffix))}{suffix}"
    assert check_target(longest, suffixes) == longest
    with pytest.raises(OutputError, match=r"File name too long|does not exist"):
        check_target(tmp_path / "/".join(["b" * 200] * 30) / f"a{suffix}", suffixes)
    assert list(tmp_path.iterdir()) == []


def test_longest_names_are_written(tmp_path):
    for suffix in ENGINE:
        write_dataset(SMALL, tmp_path / f"{'é' * ((255 - len(suffix)) // 2)}{suffix}")
    write_figure(Figure(), tmp_path / f"{'é' * 125}.svg")
    assert len(list(tmp_path.iterdir())) == 3


def test_null_byte_in_a_name_is_refused(tmp_path):
    with pytest.raises(OutputError, match=r"cannot be written \(.*embedded null (byte|character)"):
        check_target("a\0b.nc")


@pytest.mark.parametrize(
    ("suffix", "package", "extra"),
    [(".nc", "h5py", "io"), (".zarr", "zarr", "io"), (".png", "matplotlib", "plot")],
)
def test_missing_package_is_named(tmp_path, monkeypatch, suffix, package, extra):
    find = __import__("importlib.util").util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == package else find(name))
    suffixes = (".png", ".svg") if suffix == ".png" else (".nc", ".zarr")
    with pytest.raises(MissingPackageError) as refused:
        check_target(tmp_path / f"run{suffix}", suffixes)
    assert f"the package {package}," in str(refused.value) and f'"coadjoint[{extra}]"' in str(refused.value)


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="open descriptors are not listed")
@pytest.mark.parametrize("name", ["run.nc", "run.zarr"])
@pytest.mark.parametrize("full", [False, True])
def test_output_descriptors_are_closed(tmp_path, monkeypatch, name, full):
    write_dataset(SMALL, tmp_path / f"first{Path(name).suffix}")
    before = len(os.listdir("/proc/self/fd"))

    @contextmanager
    def failing(self):
        raise OSError("no space left on device")
        yield

    if full:
        monkeypatch.setattr(PendingOutput, "writing", failing)
        with pytest.raises(OSError, match="no space left"):
            write_dataset(SMALL, tmp_path / name)
    else:
        write_dataset(SMALL, tmp_path / name)
    assert len(os.listdir("/proc/self/fd")) == before


def test_deferred_error_file_positions(tmp_path):
    with DeferredErrorFile(tmp_path / "image", nullcontext) as file:
        file.write(b"0123456789")
        assert file.seek(-3, os.SEEK_CUR) == 7 and file.read() == b"789" and file.tell() == 10
        assert file.seek(-4, os.SEEK_END) == 6 and file.read(2) == b"67"
        assert file.seek(1, os.SEEK_CUR) == 9 and file.seek(2) == 2 and file.truncate() == 2
        assert file.seek(0, os.SEEK_END) == 2 and file.truncate(4) == 4
        assert file.seek(0) == 0 and file.read() == b"01\0\0" and file.seek(9) == 9 and file.read() == b""
    assert (tmp_path / "image").read_bytes() == b"01\0\0"
