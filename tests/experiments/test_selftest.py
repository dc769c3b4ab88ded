"""Self-test checks: they pass without the extras, and fail where something is wrong."""

import dataclasses

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint import cli
from coadjoint.experiments.selftest import checks, run, subjects
from coadjoint.experiments.selftest.findings import Finding
from core_only import run_with_the_core
from long import long_beyond


@pytest.mark.long
@pytest.mark.parametrize(
    ("chosen", "least", "words"),
    [
        (run.CHECKS, 31, ("order of Kahan", "Poisson bracket", "Casimirs", "bits alone")),
        ((checks.motions, checks.resumed), 4, ()),
    ],
    ids=["all", "some"],
)
def test_command_prints_one_line_per_check(monkeypatch, capsys, chosen, least, words):
    monkeypatch.setattr(run, "CHECKS", chosen)
    assert cli.main(["selftest"]) == 0
    *lines, last = capsys.readouterr().out.splitlines()
    assert len(lines) >= least and all(line.startswith("ok ") and len(line) < 200 for line in lines)
    assert f"{len(lines)} checks, 0 failed, 0 skipped" in last
    for what in ("motion on su(3)", "cut and resumed: ", *words):
        assert any(what in line for line in lines), what


# All checks, or the first and the last of them.
EACH = long_beyond(1, ["run.CHECKS = run.CHECKS[::5]", ""])


@pytest.mark.long
@pytest.mark.parametrize("chosen", EACH, ids=["few", "all"])
def test_skipped_checks_are_named_without_extras(chosen):
    code = f"""
from coadjoint.experiments.selftest import run
{chosen}
found = list(run.selftest())
print([str(one) for one in found if not one.passed], [one.skipped for one in found if one.skipped])
"""
    done = run_with_the_core(code)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == """[] ['xarray is not installed: pip install "coadjoint[io]"']"""


@pytest.mark.long
@pytest.mark.parametrize("chosen", EACH, ids=["few", "all"])
def test_command_needs_only_its_own_extra(chosen):
    # click, and what pydantic brings; no xarray, no Numba, no mpmath.
    also = ("click", "pydantic", "pydantic_core", "annotated_types", "typing_extensions", "typing_inspection")
    code = f"""
from coadjoint import cli
from coadjoint.experiments.selftest import run
{chosen}
raise SystemExit(cli.main(['selftest']))
"""
    done = run_with_the_core(code, also=also)
    assert (done.returncode, done.stderr) == (0, "")
    *lines, last = done.stdout.splitlines()
    assert lines[-1] == f'skip  {"cut and resumed":42}  xarray is not installed: pip install "coadjoint[io]"'
    assert f"{len(lines)} checks, 0 failed, 1 skipped" in last


@pytest.mark.parametrize(
    "found", [Finding("a", 2.0, 1.0), Finding("a", float("nan"), 1.0), Finding("a", 3.4, 3.5, "", True)]
)
def test_exit_status_is_1_if_a_check_fails(monkeypatch, capsys, found):
    monkeypatch.setattr(run, "CHECKS", (lambda: [Finding("good", 0.0, 1.0), found],))
    assert cli.main(["selftest", "--quiet"]) == 1
    assert capsys.readouterr().out == f"{found}\n"
    assert str(found).startswith("FAIL")


def test_skipped_checks_do_not_fail(monkeypatch, capsys):
    monkeypatch.setattr(run, "CHECKS", (lambda: [Finding("a", skipped="no such package")],))
    assert cli.main(["selftest"]) == 0
    assert "skip  a " in capsys.readouterr().out


def test_check_that_raises_has_failed(monkeypatch, capsys):
    def broken():
        yield Finding("begun", 0.0, 1.0)
        raise KeyError("x")

    monkeypatch.setattr(run, "CHECKS", (broken, lambda: [Finding("good", 0.0, 1.0)]))
    assert cli.main(["selftest"]) == 1
    output = capsys.readouterr().out
    assert (
        "KeyError" in output and "ok    begun" in output and "ok    good" in output and "3 checks, 1 failed" in output
    )


def failing(check):
    return [found.what for found in check() if not found.passed]


@pytest.mark.parametrize("key", ["so(3)", "so(5)", "A3,7"])
def test_wrong_motion_is_detected(monkeypatch, key):
    right = subjects.references()
    monkeypatch.setattr(checks, "references", lambda: {key: right[key] * (1 + 1e-11)})
    assert failing(checks.motions) == [f"motion on {key}"]


@dataclasses.dataclass(frozen=True)
class Runge(co.methods.StepMethod):
    """Of order 2, and preserves no Casimir, whatever is declared."""

    explicit, symmetric = True, False
    order: int = 2
    casimirs: str = "none"

    def properties(self, system):
        return co.methods.Properties(poisson=False, energy=False, casimirs=self.casimirs, attitude="none")

    def step(self, system, x, t, h):
        return x + h * system.vector_field(x + h / 2 * system.vector_field(x, t), t)


@pytest.mark.long
def test_wrong_order_is_detected(monkeypatch):
    monkeypatch.setattr(checks, "more_schemes", lambda: [Runge(order=3)])
    monkeypatch.setattr(checks, "supported_systems", lambda method: {"so(3)": subjects.systems()["so(3)"]})
    (found,) = failing(checks.orders)
    assert found.startswith("order of Runge(")


@pytest.mark.long
def test_false_property_is_detected(monkeypatch):
    monkeypatch.setattr(checks, "schemes", lambda: [Runge(casimirs="all")])
    monkeypatch.setattr(checks, "supported_systems", lambda method: {"so(3)": subjects.systems()["so(3)"]})
    found = {one.what: one for one in checks.certificates() if not one.passed}
    assert "Casimirs, 1 times" in found and "Casimir |x|^2" in found["of 1 certificates fail"].where


@pytest.mark.parametrize("what", ["threads", "watch"])
def test_different_bits_are_detected(monkeypatch, what):
    def other(*given, **named):
        found = co.integrate(*given, **named)
        if named.get(what) in (2, False):
            found.x[-1] = np.nextafter(found.x[-1], 9.0)
        return found

    monkeypatch.setattr(checks, "integrate", other)
    monkeypatch.setattr(checks, "more_schemes", lambda: [co.Splitting()])
    assert [one.split(",")[0].split(":")[0] for one in failing(checks.same_bits)] == [
        "bits alone" if what == "threads" else "bits saved and watched or not"
    ]


def test_kernels_that_differ_from_python_are_detected(monkeypatch):
    def other(*given, **named):
        found = co.integrate(*given, **named)
        found.x[-1] *= 1 + 1e-12
        return found

    monkeypatch.setattr(checks, "integrate", other)
    monkeypatch.setattr(checks, "more_schemes", lambda: [co.Splitting(), co.GaussLegendre(2)])
    assert failing(checks.interpreted_steps) == ["compiled steps beside Python: 10"]


def test_differently_resumed_run_is_detected(monkeypatch):
    def other(path, t_end):
        system, method = subjects.systems()["so(3)"], co.Splitting()
        x0 = np.array([subjects.state_of(system, number) for number in range(2)])
        return co.integrate(system, x0 * (1 + 2e-16), (0, t_end), checks.STEP, method)

    monkeypatch.setattr("coadjoint.files.archives.resume.resume", other)
    monkeypatch.setattr(checks, "schemes", lambda: [co.Splitting()])
    assert failing(checks.resumed) == ["cut and resumed: 1"]


@pytest.mark.thinned(2)
@pytest.mark.parametrize("key", ["so(3)", "se(3)", "A3,7", "su(3)"])
def test_references_agree_with_power_series(key):
    """By the power series of x' = sign J(x) (M x + linear), in 30 digits."""
    system = subjects.systems()[key]
    n, H, origin = system.dim, system.hamiltonian, np.zeros(system.dim)
    linear = np.asarray(H.gradient(origin))
    M = np.array([np.asarray(H.gradient(one)) - linear for one in np.eye(n)]).T
    # sign J(x)_ij = sum_k x_k J[k, i, j]
    J = system.sign * np.array([system.structure_matrix(one) for one in np.eye(n)])
    np.testing.assert_allclose(
        np.einsum("kij,k,j->i", J, np.ones(n), M @ np.ones(n) + linear), system.vector_field(np.ones(n)), atol=1e-12
    )
    terms = [(int(k), int(i), int(j), mpmath.mpf(float(J[k, i, j]))) for k, i, j in np.argwhere(J)]
    with mpmath.workdps(30):
        x = [mpmath.mpf(float(value)) for value in subjects.state_of(system)]
        for _ in range(16):
            series = [x]
            for p in range(24):
                u = [
                    [
                        mpmath.fsum(mpmath.mpf(float(M[i, j])) * series[q][j] for j in range(n) if M[i, j])
                        + (mpmath.mpf(float(linear[i])) if q == 0 else 0)
                        for i in range(n)
                    ]
                    for q in range(p + 1)
                ]
                following = [mpmath.mpf(0)] * n
                for k, i, j, c in terms:
                    following[i] += c * mpmath.fsum(series[q][k] * u[p - q][j] for q in range(p + 1))
                series.append([value / (p + 1) for value in following])
            x = [mpmath.fsum(series[p][i] / mpmath.mpf(16) ** p for p in range(25)) for i in range(n)]
        assert [float(value) for value in x] == list(subjects.references()[key])
