"""`coadjoint selftest` and `coadjoint reproduce`."""

import pytest

from command import command
from core_only import run_with_the_core

# click, and what pydantic brings; no xarray, no Numba, no mpmath.
CLICK = ("click", "pydantic", "pydantic_core", "annotated_types", "typing_extensions", "typing_inspection")


@pytest.mark.long
def test_every_check_is_a_line(capsys):
    status, out, _ = command(capsys, "selftest")
    *lines, last = out.splitlines()
    assert status == 0 and len(lines) >= 31 and all(line.startswith("ok ") and len(line) < 200 for line in lines)
    assert f"{len(lines)} checks, 0 failed, 0 skipped" in last
    for what in ("motion on su(3)", "cut and resumed: ", "order of Kahan", "Poisson bracket", "Casimirs", "bits alone"):
        assert any(what in line for line in lines), what


@pytest.mark.long
def test_checks_that_need_an_extra_are_skipped_by_name():
    program = "import runpy; sys.argv = ['coadjoint', 'selftest']; runpy.run_module('coadjoint', run_name='__main__')"
    done = run_with_the_core(program, also=CLICK)
    assert (done.returncode, done.stderr) == (0, "")
    *lines, last = done.stdout.splitlines()
    assert lines[-1] == f'skip  {"cut and resumed":42}  xarray is not installed: pip install "coadjoint[io]"'
    assert f"{len(lines)} checks, 0 failed, 1 skipped" in last


@pytest.mark.long
def test_reproduction_writes_a_table_and_figures(capsys, tmp_path):
    status, out, _ = command(capsys, "reproduce", "--out", tmp_path / "new" / "folder")
    assert status == 0 and out
    names = {path.name for path in (tmp_path / "new" / "folder").iterdir()}
    assert {*(f"figure{i}.png" for i in range(1, 6)), "modified_energies.png", "long_time.png"} <= names
