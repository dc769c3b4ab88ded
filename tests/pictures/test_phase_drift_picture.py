"""The figure of a phase error shows its lead, its line, and what is left."""

import numpy as np
import pytest

from coadjoint.analysis.phase_drift import drift_of_series
from coadjoint.pictures.phase_drift import draw_phase_drift


@pytest.fixture(scope="module")
def drift():
    t = np.arange(500) * 0.5
    return drift_of_series(t, 2.0 + 0.01 * t + 0.1 * np.cos(t))


def test_lines_are_the_series_and_its_line(drift) -> None:
    lead, rest = drift.plot().axes
    measured, line = lead.get_lines()
    assert np.array_equal(measured.get_ydata(), drift.lead)
    assert np.ptp(np.diff(line.get_ydata())) < 1e-12 and line.get_ydata()[0] == pytest.approx(drift.intercept)
    assert rest.get_lines()[0].get_ydata() == pytest.approx(drift.lead - line.get_ydata())
    assert "linear" in lead.get_title() and "0.036) \\times 10^{-3}" in line.get_label()
    assert lead.get_ylabel() == "lead [unit of time]"


def test_a_predicted_slope_is_drawn_beside(drift) -> None:
    own = draw_phase_drift(drift, predicted=0.011).axes[0].get_lines()[2]
    assert np.diff(own.get_ydata()) / np.diff(drift.t) == pytest.approx(0.011)
    assert "0.011" in own.get_label()


def test_radians_are_named() -> None:
    t = np.arange(50.0)
    assert draw_phase_drift(drift_of_series(t, t, "radians")).axes[0].get_ylabel() == "lead [rad]"
