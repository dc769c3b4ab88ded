"""Output of the command: complete or absent, and never in the place of what it did not write."""

import os
from pathlib import Path

import pytest
import xarray

import coadjoint as co
from command import command
from configuration_files import READY_MADE
from guards import bounded_work

ENGINE = {".nc": "h5netcdf", ".zarr": "zarr"}
# A run of more than an hour, if it is not refused.
LONG = READY_MADE.replace("[0, 1]\nstep = 0.1", "[0, 1e10]\nstep = 0.1\nsave_every = 100000000000")


@pytest.fixture
def output(files):
    """Run a file with an option of output, or refuse it; return the error."""
    files.write(READY_MADE)

    def call(target, option="--out", refused=True):
        files.write(LONG if refused else READY_MADE)
        with bounded_work():
            found = command(files.capsys, "run", "run.toml", option, target, "--quiet")
        assert (found.status, found.out) == (2 if refused else 0, "") and found.err.count("\n") == refused, found
        return found.err

    return call


def tree():
    return sorted((str(path), path.is_symlink()) for path in Path().rglob("*"))


@pytest.mark.parametrize("suffix", ENGINE)
def test_the_last_run_is_the_output(files, output, suffix):
    for end in (1, 2):
        files.write(READY_MADE, ("[0, 1]", f"[0, {end}]"))
        assert command(files.capsys, "run", "run.toml", "--out", f"run{suffix}", "--quiet").status == 0
    assert {path.name for path in Path().iterdir()} == {f"run{suffix}", "run.toml"}
    assert co.load(f"run{suffix}").t[-1] == 2.0


MINE = xarray.Dataset({"mine": ("place", [1.0, 2.0, 3.0])})
# What is added to a store, and the name that the message has.
CONTENTS = {
    "thesis.tex": lambda store: (store / "thesis.tex").write_text("precious"),
    "notes.txt": lambda store: (store / "x" / "notes.txt").write_text("precious"),
    "drafts": lambda store: (store / "drafts").mkdir(),
    "link": lambda store: (store / "link").symlink_to(store.parent),
    "another variable": lambda store: MINE.to_zarr(store, mode="a", zarr_format=2, consolidated=True),
    "damaged index": lambda store: (store / ".zmetadata").write_text("[" * 10**5),
    "another index": lambda store: (store / ".zmetadata").write_text('{"coadjoint_files": [[]]}'),
}


@pytest.mark.parametrize("name", CONTENTS)
def test_a_store_with_other_content_is_not_replaced(output, name):
    output("run.zarr", refused=False)
    CONTENTS[name](Path("run.zarr"))
    before, error = tree(), output("run.zarr")
    assert "run.zarr: " in error and (name in error or " " in name) and tree() == before


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.filterwarnings("ignore")
def test_a_store_of_another_program_is_not_replaced(output, version):
    xarray.Dataset({"x": ("time", [1.0, 2.0])}).to_zarr("run.zarr", zarr_format=version, consolidated=version == 2)
    before = tree()
    assert "run.zarr: " in output("run.zarr") and tree() == before
    Path("other.zarr").mkdir()
    (Path("other.zarr") / "zarr.json").write_text("{}")
    assert "other.zarr: " in output("other.zarr")


@pytest.mark.skipif(os.name == "nt", reason="links")
@pytest.mark.parametrize("there", ["nothing", "a file", "an empty folder", "itself"])
def test_a_link_in_the_place_of_a_store_is_not_followed(output, there):
    Path("run.zarr").symlink_to("run.zarr" if there == "itself" else "behind")
    if there == "a file":
        Path("behind").write_text("precious")
    elif there == "an empty folder":
        Path("behind").mkdir()
    before = tree()
    assert "run.zarr: " in output("run.zarr") and tree() == before


@pytest.mark.parametrize("suffix", [".nc", ".zarr", ".png"])
def test_names_have_the_length_that_the_disk_allows(files, output, suffix):
    option = "--figure" if suffix == ".png" else "--out"
    before = tree()
    assert "File name too long" in output(f"{'a' * 256}{suffix}", option)
    output("/".join(["b" * 200] * 30) + f"/a{suffix}", option)
    assert tree() == before
    longest = f"{'é' * ((255 - len(suffix)) // 2)}{suffix}"
    output(longest, option, refused=False)
    assert Path(longest).exists()


@pytest.mark.parametrize(
    ("option", "target", "said"),
    [
        ("--out", "run.csv", ".nc or .zarr"),
        ("--out", "", ".nc or .zarr"),
        ("--figure", "run.bmp", ".png, .pdf or .svg"),
        ("--figure", "", ".png, .pdf or .svg"),
        ("--movie", "run.avi", ".mp4 or .gif"),
        ("--movie", "", ".mp4 or .gif"),
        ("--out", "no/run.nc", "the folder no does not exist"),
        ("--figure", "no/a.png", "the folder no does not exist"),
        ("--movie", "no/a.gif", "the folder no does not exist"),
        ("--archive", "no/run.zarr", "no does not exist"),
        ("--archive", "", "archive is ''"),
        ("--archive", "held", "exists"),
        ("--out", "held.nc", "is a folder"),
        ("--out", "held.zarr", "exists"),
    ],
)
def test_targets_are_refused_before_the_run(output, option, target, said):
    """As options, and as keys of the file, by `run` and by `check`."""
    for name in ("held", "held.nc", "held.zarr"):
        Path(name).mkdir()
        (Path(name) / "thesis.tex").write_text("precious")
    before = tree()
    error = output(target, option)
    assert said in error and tree() == before


@pytest.mark.parametrize("key", ["file", "figure", "movie", "archive"])
@pytest.mark.parametrize("target", ["a.txt", "none/a"])
def test_targets_of_a_file_are_refused_by_run_and_check(files, key, target):
    suffix = {"file": ".nc", "figure": ".png", "movie": ".gif", "archive": ".zarr"}[key]
    name = target if target == "a.txt" and key != "archive" else f"none/a{suffix}"
    lines = [files.refused(f'{LONG}[output]\n{key} = "{name}"\n', by=by) for by in ("run", "check")]
    assert lines[0] == lines[1] and lines[0].startswith(f"output.{key}: ")


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="nobody can create files in /proc")
def test_a_folder_that_cannot_be_written_is_refused(output):
    assert "/proc/run.zarr: cannot be written (" in output("/proc/run.zarr")
