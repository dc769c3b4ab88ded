"""The figure of a phase error shows its lead, its line, and what is left."""

import re

import numpy as np
import pytest

from coadjoint.analysis.phase_drift import drift_of_series
from coadjoint.pictures.phase_drift import draw_phase_drift, with_error


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


def read_back(text: str) -> tuple[float, float, float]:
    """Return the value, the error, and the unit of the last digit, which both share."""
    value, error, power = re.fullmatch(r"\$\((-?[\d.]+) \\pm ([\d.]+)\) \\times 10\^\{(-?\d+)\}\$", text).groups()
    digits = [len(number.partition(".")[2]) for number in (value, error)]
    assert digits[0] == digits[1] and 1.0 <= max(abs(float(value)), float(error)) <= 10.0
    return float(value) * 10.0 ** int(power), float(error) * 10.0 ** int(power), 10.0 ** (int(power) - digits[0])


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("part", [1e-9, 1.3e-3, 0.0996, 0.97, 1.0, 4.1, 750.0, 1e12])
@pytest.mark.parametrize("size", [3.7e-14, 0.5, 2.2e9])
def test_a_value_has_two_digits_of_its_error_whichever_is_larger(size, part, sense) -> None:
    value, error, unit = read_back(with_error(sense * size, part * size))
    # The error has two digits before the unit: from 10 to 99 of it, or 100 if it is rounded up.
    assert 9.5 <= part * size / unit < 100.0
    assert abs(value - sense * size) <= 0.501 * unit and abs(error - part * size) <= 0.501 * unit


def test_values_and_errors_of_zero() -> None:
    assert read_back(with_error(0.0, 2.5e-7))[:2] == (0.0, pytest.approx(2.5e-7))
    assert read_back(with_error(-1.25e4, 0.0)) == (-1.25e4, 0.0, pytest.approx(1e-2))
    assert with_error(0.0, 0.0) == "$0$" and with_error(np.inf, 1.0) == "$inf$"


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_phase_error_without_a_slope_is_drawn_with_its_uncertainty(sense) -> None:
    t = sense * np.arange(400) * 0.5
    found = drift_of_series(t, np.cos(t))
    assert found.growth == "bounded" and abs(found.slope) < found.uncertainty
    lead, rest = found.plot().axes
    value, error, unit = read_back(lead.get_lines()[1].get_label().removeprefix("slope "))
    assert abs(value - found.slope) <= 0.501 * unit and abs(error - found.uncertainty) <= 0.501 * unit
    assert f"rms {found.deviation:.2g}," in rest.get_title() and f"t^{{{found.exponent:.2f}}}" in rest.get_title()
    own = draw_phase_drift(found, predicted=0.01 * sense).axes[0].get_lines()
    np.testing.assert_allclose(np.mean(own[2].get_ydata()), np.mean(own[1].get_ydata()), atol=1e-12)
