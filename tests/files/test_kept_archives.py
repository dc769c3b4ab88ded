"""An archive of every version of the format is read, and continued to the bits of a run of today. Where BLAS multiplies
matrices, the archive of another machine is read to round-off, and not continued.
"""

import json
import zipfile

import numpy as np
import pytest
from kept_archives import BODY, CUT, EVERY, KEPT, RUNS, SPAN, STEP

import coadjoint as co
from coadjoint import cli
from coadjoint.files.archives.store import FORMAT, ArchiveError
from coadjoint.rounding import UNIT_ROUNDOFF
from verification.test_archived_runs import assert_same

FORMATS = range(1, FORMAT + 1)


@pytest.fixture
def kept(tmp_path, request):
    with zipfile.ZipFile(KEPT / f"format_{request.param}.zip") as archives:
        archives.extractall(tmp_path)
    return tmp_path


def test_no_version_is_missing():
    """`python files/kept_archives.py` writes those of a new one."""
    assert {path.name for path in KEPT.iterdir()} == {f"format_{number}.zip" for number in FORMATS}


@pytest.mark.sensitive
@pytest.mark.parametrize("kept", FORMATS, indirect=True)
@pytest.mark.parametrize("name", [name for name in RUNS if name != "matrix"])
def test_a_run_of_vectors_is_read_and_continued_to_the_same_bits(kept, name):
    system, x0, method, options = RUNS[name]
    whole = co.integrate(system, x0, SPAN, STEP, method, save_every=EVERY, **options)
    found = co.open_archive(kept / f"{name}.zarr")
    count = CUT // EVERY + 1
    assert found.reached == CUT and not found.finished and np.array_equal(found.x, whole.x[:count])
    assert_same(co.resume(kept / f"{name}.zarr"), whole)


@pytest.mark.sensitive
@pytest.mark.parametrize("kept", FORMATS, indirect=True)
def test_a_run_of_matrices_is_read_to_round_off(kept):
    """The bits of its steps depend on the BLAS of the machine that wrote the archive; with other bits it ends there."""
    system, x0, method, options = RUNS["matrix"]
    whole = co.integrate(system, x0, SPAN, STEP, method, save_every=EVERY, **options)
    found = co.open_archive(kept / "matrix.zarr")
    assert found.reached == CUT and not found.finished and len(found.x) == CUT // EVERY + 1
    assert_close(found, whole, rounding_of_steps(system, x0, method, whole))
    if np.array_equal(found.x, whole.x[: len(found.x)]):
        assert_same(co.resume(kept / "matrix.zarr"), whole)
    else:
        with pytest.raises(ArchiveError, match=r"matrix\.zarr: .* other bits"):
            co.resume(kept / "matrix.zarr")


def rounding_of_steps(system, x0, method, whole):
    """Return what steps whose products are summed in another order may do to a state of size one.

    A step has some products of matrices of N rows, wrong by 2N round-offs each. To the end such an error grows as
    much as a small change of the initial state does.
    """
    steps, rows, small = round((SPAN[1] - SPAN[0]) / STEP), x0.shape[-1], 2.0**-26
    assert np.abs(x0).max() <= 1.0
    growth = 1.0
    for seed in range(4):
        near = x0 + small * system.random(seed=seed)
        moved = co.integrate(system, near, SPAN, STEP, method, save_every=EVERY).x - whole.x
        growth = max(growth, np.abs(moved).max() / np.abs(near - x0).max())
    return 8 * 2 * rows * steps * UNIT_ROUNDOFF * growth


def assert_close(found, whole, tolerance):
    count, rows = len(found.x), whole.x.shape[-1]
    assert np.array_equal(found.t, whole.t[:count]) and found.x.dtype == whole.x.dtype
    assert np.abs(found.x - whole.x[:count]).max() <= tolerance
    # Of matrices of size one the energy and traces of up to N-th powers change by at most 4 N times as much.
    assert np.abs(found.energy - whole.energy[:count]).max() <= 4 * rows * tolerance
    assert list(found.casimirs) == list(whole.casimirs)
    for name, values in whole.casimirs.items():
        assert np.abs(found.casimirs[name] - values[:count]).max() <= 4 * rows * tolerance, name


@pytest.mark.parametrize("kept", FORMATS, indirect=True)
def test_an_ensemble_in_blocks_is_read(kept):
    found = co.open_archive(kept / "blocks.zarr")
    whole = co.integrate(BODY, RUNS["members"][1], SPAN, STEP)
    assert found.finished and np.array_equal(found.x, whole.x) and np.array_equal(found.energy, whole.energy)


@pytest.mark.parametrize("name", ["vector", "blocks"])
@pytest.mark.parametrize("kept", [FORMAT], indirect=True)
def test_a_later_version_is_refused_in_one_sentence(kept, capsys, name):
    """Whoever asks, and nothing in the archive is changed."""
    path = kept / f"{name}.zarr"
    root = json.loads((path / "zarr.json").read_text())
    root["attributes"]["archive_format"] = FORMAT + 1
    (path / "zarr.json").write_text(json.dumps(root))
    before = {file: file.read_bytes() for file in path.rglob("*") if file.is_file()}
    said = f"{path}: is an archive of format {FORMAT + 1}, and this version of coadjoint reads formats up to {FORMAT}; "
    said += "install a later version"
    for ask in (co.open_archive, co.resume):
        with pytest.raises(ArchiveError) as refused:
            ask(path)
        assert str(refused.value) == said
    with pytest.raises(ArchiveError) as refused:
        co.ensemble(BODY, RUNS["members"][1], SPAN, STEP, archive=path)
    assert str(refused.value) == said
    assert cli.main(["resume", str(path)]) == 2
    assert capsys.readouterr().err == f"{said}\n"
    assert {file: file.read_bytes() for file in path.rglob("*") if file.is_file()} == before
