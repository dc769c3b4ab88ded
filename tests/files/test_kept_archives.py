"""An archive of every version of the format is read, and gone on with to the bits of a run of today."""

import json
import zipfile

import numpy as np
import pytest
from kept_archives import BODY, CUT, EVERY, KEPT, RUNS, SPAN, STEP

import coadjoint as co
from coadjoint import cli
from coadjoint.files.archive_store import FORMAT, ArchiveError
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


@pytest.mark.parametrize("kept", FORMATS, indirect=True)
@pytest.mark.parametrize("name", RUNS)
def test_it_is_read_and_gone_on_with(kept, name):
    system, x0, method, options = RUNS[name]
    whole = co.integrate(system, x0, SPAN, STEP, method, save_every=EVERY, **options)
    found = co.open_archive(kept / f"{name}.zarr")
    count = CUT // EVERY + 1
    assert found.reached == CUT and not found.finished and np.array_equal(found.x, whole.x[:count])
    assert_same(co.resume(kept / f"{name}.zarr"), whole)


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
    said += "take a later version"
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
