"""Archives of every format version are read, and resumed to the bits of a run of today.

Products of matrices depend on BLAS: such archives of another machine are read to round-off, and not resumed if their
first step has other bits.
"""

import json
import re
import zipfile

import numpy as np
import pytest
from reference_archives import BODY, CUT, EVERY, FOLDER, RUNS, SPAN, STEP

import coadjoint as co
from coadjoint import cli
from coadjoint.files.archives.reading import FORMAT, ArchiveError
from coadjoint.rounding import UNIT_ROUNDOFF
from verification.test_archived_runs import assert_same

FORMATS, X0 = range(1, FORMAT + 1), RUNS["members"][1]


@pytest.fixture
def folder(tmp_path, request):
    with zipfile.ZipFile(FOLDER / f"format_{request.param}.zip") as archives:
        archives.extractall(tmp_path)
    return tmp_path


def test_every_format_has_archives():
    """`python files/reference_archives.py` writes the archives of a new format."""
    assert {path.name for path in FOLDER.iterdir()} == {f"format_{number}.zip" for number in FORMATS}


@pytest.mark.sensitive
@pytest.mark.parametrize("folder", FORMATS, indirect=True)
@pytest.mark.parametrize("name", [name for name in RUNS if name != "matrix"])
def test_vector_runs_resume_to_the_same_bits(folder, name):
    system, x0, method, options = RUNS[name]
    expected = co.integrate(system, x0, SPAN, STEP, method, save_every=EVERY, **options)
    found = co.open_archive(folder / f"{name}.zarr")
    count = CUT // EVERY + 1
    assert found.reached == CUT and not found.finished and np.array_equal(found.x, expected.x[:count])
    assert_same(co.resume(folder / f"{name}.zarr"), expected)


@pytest.mark.sensitive
@pytest.mark.parametrize("folder", FORMATS, indirect=True)
def test_matrix_runs_are_read_to_round_off(folder):
    system, x0, method, options = RUNS["matrix"]
    expected = co.integrate(system, x0, SPAN, STEP, method, save_every=EVERY, **options)
    found = co.open_archive(folder / "matrix.zarr")
    assert found.reached == CUT and not found.finished and len(found.x) == CUT // EVERY + 1
    tolerance = rounding_of_steps(system, x0, method, expected)
    assert_close(found, expected, tolerance)
    same = np.array_equal(found.x, expected.x[: len(found.x)])
    try:
        resumed = co.resume(folder / "matrix.zarr")
    except ArchiveError as error:
        assert not same and re.search(r"matrix\.zarr: .*differs in bits", str(error))
    else:
        # The first step is compared; later ones may differ even so.
        assert_close(resumed, expected, tolerance)
        assert not same or np.array_equal(resumed.x, expected.x)


def rounding_of_steps(system, x0, method, expected):
    """Bound the effect of another order of summation in matrix products on a state of size one.

    A product of matrices of N rows has an error of 2N round-offs, which grows as a small change of the initial state.
    """
    steps, rows, small = round((SPAN[1] - SPAN[0]) / STEP), x0.shape[-1], 2.0**-26
    assert np.abs(x0).max() <= 1.0
    growth = 1.0
    for seed in range(4):
        near = x0 + small * system.random(seed=seed)
        moved = co.integrate(system, near, SPAN, STEP, method, save_every=EVERY).x - expected.x
        growth = max(growth, np.abs(moved).max() / np.abs(near - x0).max())
    return 8 * 2 * rows * steps * UNIT_ROUNDOFF * growth


def assert_close(found, expected, tolerance):
    count, rows = len(found.x), expected.x.shape[-1]
    assert np.array_equal(found.t, expected.t[:count]) and found.x.dtype == expected.x.dtype
    assert np.abs(found.x - expected.x[:count]).max() <= tolerance
    # Of matrices of size one the energy and traces of up to N-th powers change by at most 4 N times as much.
    assert np.abs(found.energy - expected.energy[:count]).max() <= 4 * rows * tolerance
    assert list(found.casimirs) == list(expected.casimirs)
    for name, values in expected.casimirs.items():
        assert np.abs(found.casimirs[name] - values[:count]).max() <= 4 * rows * tolerance, name


@pytest.mark.parametrize("folder", FORMATS, indirect=True)
def test_ensembles_in_blocks_are_read(folder):
    found = co.open_archive(folder / "blocks.zarr")
    expected = co.integrate(BODY, X0, SPAN, STEP)
    assert found.finished and np.array_equal(found.x, expected.x) and np.array_equal(found.energy, expected.energy)


@pytest.mark.parametrize("name", ["vector", "blocks"])
@pytest.mark.parametrize("folder", [FORMAT], indirect=True)
def test_later_formats_are_refused(folder, capsys, name):
    path = folder / f"{name}.zarr"
    root = json.loads((path / "zarr.json").read_text())
    root["attributes"]["archive_format"] = FORMAT + 1
    (path / "zarr.json").write_text(json.dumps(root))
    before = {file: file.read_bytes() for file in path.rglob("*") if file.is_file()}
    for call in (co.open_archive, co.resume, lambda path: co.ensemble(BODY, X0, SPAN, STEP, archive=path)):
        with pytest.raises(
            ArchiveError, match=rf"format {FORMAT + 1}, .*up to {FORMAT}; install a later version"
        ) as error:
            call(path)
    assert cli.main(["resume", str(path)]) == 2
    assert capsys.readouterr().err == f"{error.value}\n"
    assert {file: file.read_bytes() for file in path.rglob("*") if file.is_file()} == before
