"""Figures of certificates, phase errors, modified energies and sections, read back from their artists."""

from __future__ import annotations

import numpy as np
import pytest
from drawn_runs import BODY, T0, data

import coadjoint as co
from refusals import refused

X = (0.3, 1.0, 0.2)
METHODS = {"splitting": co.Splitting(), "Taylor": co.Taylor(12), "own": lambda x, h: x + h * BODY.vector_field(x)}
SERIES = ("steps", "errors")


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("step", [0.1, -0.1])
def test_certificates_show_their_evidence_and_verdicts(name, step):
    found = co.certify(BODY, METHODS[name], X, step, steps=30)
    figure = found.plot()
    errors, defects, invariants, verdicts = figure.axes
    order = found["order"].evidence
    np.testing.assert_array_equal(data(errors.lines[0]), [order["steps"], order["errors"]])
    assert set(errors.lines[-1].get_xdata()) == {0.1} and errors.get_xscale() == errors.get_yscale() == "log"
    (fitted,) = (line for line in errors.lines if line.get_linestyle() == "--")
    slopes = [np.polyfit(*np.log(points), 1)[0] for points in (data(fitted), [order[f"fitted {k}"] for k in SERIES])]
    # A line beside its points: their slope changes by less than half an order from the larger to the smaller steps.
    assert abs(slopes[0] - slopes[1]) < 0.5 and fitted.get_ydata()[-1] == order["fitted errors"][-1]
    measured = [
        row for key in ("symmetry", "reversibility", "poisson") for row in [found[key]] if "defects" in row.evidence
    ]
    shown = {tuple(line.get_ydata()) for line in defects.lines}
    assert {tuple(row.evidence["defects"]) for row in measured} <= shown
    followed = [row for row in found.rows if "deviations" in row.evidence]
    for line, row in zip(invariants.lines, followed, strict=True):
        deviations = np.asarray(row.evidence["deviations"], dtype=float)
        sizes = np.sqrt(np.mean(deviations.reshape(len(deviations), -1) ** 2, axis=1))
        known = np.isfinite(line.get_ydata())
        np.testing.assert_allclose(line.get_ydata()[known], sizes[-len(known) :][known], rtol=1e-12)
    written = [text.get_text() for text in verdicts.texts]
    assert all(row.verdict in written for row in found.rows)
    said = "nothing declared" if not found.failures and name == "own" else "passed" if found.passed else "not passed"
    assert figure.get_suptitle().endswith(said)


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("growth", ["linear", "bounded"])
def test_a_phase_error_is_drawn_with_its_line_and_what_is_left(sense, growth):
    t = sense * np.arange(500) * 0.5
    drift = co.analysis.drift_of_series(t, np.cos(t) + (2.0 + 0.01 * t if growth == "linear" else 0.0))
    lead, rest = drift.plot().axes
    size = np.abs(drift.lead).max()
    line = np.polyval(np.polyfit(drift.t, drift.lead, 1), drift.t)
    np.testing.assert_array_equal(data(lead.lines[0]), [drift.t, drift.lead])
    np.testing.assert_allclose(lead.lines[1].get_ydata(), line, rtol=0, atol=1e-9 * size)
    np.testing.assert_allclose(rest.lines[0].get_ydata(), drift.lead - line, rtol=0, atol=1e-9 * size)
    assert lead.get_ylabel() == "lead [unit of time]" and ("linear" in lead.get_title()) == (growth == "linear")
    assert "\\pm" in lead.lines[1].get_label()
    radians = co.analysis.drift_of_series(t, t, "radians").plot().axes[0]
    assert radians.get_ylabel() == "lead [rad]"


def test_modified_energies_are_drawn_for_each_order_and_thinned_in_step():
    run = co.integrate(BODY, (0.1, 1.0, 0.2), (T0, T0 - 1100.0), 0.1)
    (axes,) = co.plotting.draw_modified_energy(run, (4, 6)).axes
    for line, series in zip(axes.lines, (run.energy, run.modified_energy(4), run.modified_energy(6)), strict=True):
        own = np.abs(series - series[0])
        np.testing.assert_array_equal(data(line), [run.t[::3], np.where(own > 0.0, own, np.nan)[::3]])
    assert axes.get_yscale() == "log" and axes.get_xlabel() == "time $t$"
    assert len({line.get_color() for line in axes.lines}) == 3
    with refused(TypeError, "Solution"):
        co.plotting.draw_modified_energy(run.system)
