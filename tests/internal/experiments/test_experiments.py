"""The experiments of Reich (1993) with a reduced setting, and self-tests of what is wrong."""

import dataclasses
import warnings

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint.experiments import selftest as checks
from coadjoint.experiments.reich1993 import reproduce
from coadjoint.experiments.reich1993 import statements as paper
from coadjoint.experiments.reich1993.figures import drift_figure
from coadjoint.experiments.reich1993.section5 import spiral_run

# Statements that are not simply confirmed; all others hold.
EXPECTED = {
    "flow_poisson": paper.LIMITED,  # the printed transpose is a misprint
    "stronger_than_energy": paper.FAILS,
    "no_dissipation": paper.FAILS,
    "example_3_1_gauss": paper.LIMITED,  # by two different matrices
    "spiral_parameter": paper.LIMITED,  # a > 1 is not needed
    "spiral_casimir": paper.LIMITED,  # the principal arctangent jumps
    "small_phase_errors": paper.LIMITED,  # to t = 2
    "oscillating_phase": paper.FAILS,
    "remark_6_1": paper.LIMITED,  # the adjoint is needed
}


def test_reproduction_has_all_verdicts_and_figures(tmp_path):
    lines = []

    def echo(line):
        lines.append(line)
        if len(lines) == 3:
            warnings.warn("a warning of another kind", UserWarning, stacklevel=1)

    with pytest.warns(UserWarning) as caught:
        rows, figures = reproduce(tmp_path / "new" / "folder", echo, phase_end=100.0, steps=10_000)
    # Warnings of large steps are lines of the table; any others are passed on.
    assert [str(warning.message) for warning in caught] == ["a warning of another kind"]
    assert len(lines) == 10
    keys = [row.key for row in rows]
    assert len(keys) == len(set(keys)) >= 45 and set(EXPECTED) <= set(keys)
    assert {row.key: row.verdict for row in rows} == {key: EXPECTED.get(key, paper.HOLDS) for key in keys}
    for row in rows:
        assert all(cell.strip() for cell in row) and "nan" not in row.measured
        assert any(character.isdigit() for character in row.measured), row.key
    order = ["flow_poisson", "lemma_3_1_order", "lemma_4_1_poisson", "figure_1", "figure_2", "runge_unacceptable"]
    assert sorted(order, key=keys.index) == order, "as in the paper"
    names = [path.name for path in figures]
    assert names == [*(f"figure{i}.png" for i in range(1, 6)), "modified_energies.png", "long_time.png"]
    for path in figures:
        assert path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 20_000
    table = (tmp_path / "new" / "folder" / "table.md").read_text(encoding="utf-8")
    assert table.count("\n| ") == len(rows) + 1
    assert "3 does not hold" in table
    large = [line for line in table.splitlines() if line.startswith("- the step ")]
    assert len(large) == len(set(large)) >= 5
    assert any("the step 0.1 is too large" in line and "runge2" in line for line in large)


@pytest.mark.parametrize(
    ("method", "energy", "casimir"),
    [(paper.COORDINATES, 3.7e-6, None), (paper.M_ORTHOGONAL, None, 5.5e-5)],
    ids=["fig1", "fig2"],
)
def test_drift_figures(method, energy, casimir):
    run = spiral_run(method)
    figure = drift_figure(run, 1, "scheme")
    for axes in figure.axes:
        dotted, solid = axes.lines
        assert (dotted.get_linestyle(), solid.get_linestyle()) == (":", "-")
        for line, size in ((dotted, energy), (solid, casimir)):
            largest = np.nanmax(np.abs(line.get_ydata()))
            # The reference has two digits; others are preserved to round-off: 8 u (5 flows) 2000 steps.
            assert largest == pytest.approx(size, rel=0.02) if size else largest <= 8 * 2.0**-53 * 5 * 2000
        assert axes.get_xlim() == (0.0, 20.0)
    assert figure.axes[1].get_yscale() == "log"
    assert "dotted" in figure.get_suptitle() and "solid" in figure.get_suptitle()


H = 0.1


def failing(check):
    return [found.what for found in check() if not found.passed]


@pytest.mark.parametrize("key", ["so(3)", "so(5)", "A3,7"])
def test_wrong_motion_is_detected(monkeypatch, key):
    right = checks.references()
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


@pytest.mark.parametrize(
    ("schemes", "method", "check", "begin"),
    [
        ("more_schemes", Runge(order=3), "orders", "order of Runge("),
        ("schemes", Runge(casimirs="all"), "certificates", "of 1 certificates fail"),
    ],
)
def test_wrong_orders_and_false_properties_are_detected(monkeypatch, schemes, method, check, begin):
    monkeypatch.setattr(checks, schemes, lambda: [method])
    monkeypatch.setattr(checks, "supported_systems", lambda method: {"so(3)": checks.systems()["so(3)"]})
    assert any(found.startswith(begin) for found in failing(getattr(checks, check)))


def step_off(x):
    return np.nextafter(x, 9.0)


@pytest.mark.parametrize(
    ("changed", "by", "methods", "check", "begin"),
    [
        ("threads", step_off, [co.Splitting()], "same_bits", ["bits alone"]),
        ("watch", step_off, [co.Splitting()], "same_bits", ["bits saved and watched or not"]),
        (None, lambda x: x * (1 + 1e-12), [co.Splitting(), co.GaussLegendre(2)], "interpreted_steps",
         ["compiled steps beside Python"]),
    ],
)  # fmt: skip
def test_different_bits_are_detected(monkeypatch, changed, by, methods, check, begin):
    def other(*given, **named):
        found = co.integrate(*given, **named)
        if changed is None or named.get(changed) in (2, False):
            found.x[-1] = by(found.x[-1])
        return found

    monkeypatch.setattr(checks, "integrate", other)
    monkeypatch.setattr(checks, "more_schemes", lambda: methods)
    assert [one.split(",")[0].split(":")[0] for one in failing(getattr(checks, check))] == begin


def test_differently_resumed_run_is_detected(monkeypatch):
    def other(path, t_end):
        system, method = checks.systems()["so(3)"], co.Splitting()
        x0 = np.array([checks.state_of(system, number) for number in range(2)])
        return co.integrate(system, x0 * (1 + 2e-16), (0, t_end), checks.STEP, method)

    monkeypatch.setattr("coadjoint.files.archives.resume.resume", other)
    monkeypatch.setattr(checks, "schemes", lambda: [co.Splitting()])
    assert failing(checks.resumed) == ["cut and resumed: 1"]


@pytest.mark.thinned(2)
@pytest.mark.parametrize("key", ["so(3)", "se(3)", "A3,7", "su(3)"])
def test_references_agree_with_power_series(key):
    """By the power series of x' = sign J(x) (M x + linear), in 30 digits."""
    system = checks.systems()[key]
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
        M, x = mpmath.matrix(M.tolist()), mpmath.matrix(checks.state_of(system).tolist())
        for _ in range(16):
            series, slopes = [x], []
            for p in range(24):
                slopes.append(M * series[p] + (mpmath.matrix(linear.tolist()) if p == 0 else mpmath.matrix(n, 1)))
                following = mpmath.matrix(n, 1)
                for k, i, j, c in terms:
                    following[i] += c * mpmath.fsum(series[q][k] * slopes[p - q][j] for q in range(p + 1))
                series.append(following / (p + 1))
            x = mpmath.matrix([mpmath.fsum(one[i] / mpmath.mpf(16) ** p for p, one in enumerate(series))
                               for i in range(n)])  # fmt: skip
        assert [float(value) for value in x] == list(checks.references()[key])
