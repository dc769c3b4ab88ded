"""`coadjoint selftest` and `coadjoint reproduce`, and printed numbers of Reich (1993)."""

import pytest

import coadjoint as co
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
    for what in (
        "motion on su(3)",
        "cut and resumed: ",
        "order of Kahan",
        "Poisson bracket",
        "Casimirs",
        "bits alone",
    ):
        assert any(what in line for line in lines), what


@pytest.mark.long
def test_checks_that_need_an_extra_are_skipped_by_name():
    done = run_with_the_core(
        "import runpy; sys.argv = ['coadjoint', 'selftest']; runpy.run_module('coadjoint')", also=CLICK
    )
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


def test_exact_attitudes_of_the_paper():
    """References to 12 digits, from a closed form in 40-digit arithmetic; the state is near the separatrix."""
    start = (1.0, 10.0, 1.0)
    exact = co.systems.paper_rigid_body().exact(start, 10.0, attitude=True)[1]  # its masses 1/3 are rounded
    assert exact[0, 0] == pytest.approx(0.0720212720707, abs=1e-12)
    body = co.systems.rigid_body(inertia=(1, 2, 3)).exact(start, 10.0, attitude=True)[1]
    assert body[0, 0] == pytest.approx(-0.404281810695, abs=1e-12)


def test_second_hamiltonian_is_the_printed_polynomial():
    m1, m2, m3 = 1.0, 0.5, 1.0 / 3.0
    method = co.Splitting(order=2, parts="coordinates")
    found = co.modified_hamiltonian(co.systems.paper_rigid_body(), method, order=4).terms[2].monomials
    expected = {
        (2, 2, 0): m1**2 * m2 - m1**2 * m3 - 2 * m1 * m2**2 + 2 * m1 * m2 * m3 - m2**2 * m3,
        (2, 0, 2): -(m1**2) * m2 + m1**2 * m3 + 2 * m1 * m2 * m3 - 2 * m1 * m3**2 + 2 * m2 * m3**2,
        (0, 2, 2): 2 * m1 * m2**2 - 4 * m1 * m2 * m3 + 2 * m1 * m3**2 + m2**2 * m3 - 2 * m2 * m3**2,
    }
    for exponents, value in expected.items():
        assert 24 * found[exponents] == pytest.approx(value, abs=64 * 2.0**-53)
    assert all(abs(value) <= 64 * 2.0**-53 for exponents, value in found.items() if exponents not in expected)
