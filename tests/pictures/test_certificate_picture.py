"""Figures of certificates and of phase errors."""

import re
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from drawn_runs import BODY, data

import coadjoint as co
from coadjoint.analysis.phase_drift import drift_of_series
from coadjoint.pictures.certificate import FAIL_COLOUR, PASS_COLOUR, UNDECIDED_COLOUR, draw_certificate
from coadjoint.pictures.phase_drift import draw_phase_drift, with_error


@pytest.mark.long
def test_every_panel_is_drawn(tmp_path):
    for method in (co.Splitting(), co.Taylor(12), lambda x, h: x + h * BODY.vector_field(x)):
        found = co.certify(BODY, method, (0.3, 1.0, 0.2), 0.1, steps=60)
        figure = found.plot()
        figure.savefig(tmp_path / "certificate.png", dpi=50)
        errors, _, invariants, verdicts = figure.axes
        shown = np.sort(errors.lines[0].get_xdata())
        assert np.allclose(shown, np.sort(found["order"].evidence["steps"]))
        assert len(invariants.lines) == 2
        written = [text.get_text() for text in verdicts.texts]
        assert all(row.verdict in written for row in found.rows)
        assert ("nothing declared" if not found.declares else "passed") in figure.get_suptitle()


def test_what_could_not_be_measured_is_said():
    figure = co.certify(BODY, co.Splitting(), (1.0, 0.0, 0.0), 0.1, steps=20).plot()
    assert [text.get_text() for text in figure.axes[0].texts] == ["every state rests"]


def row(key, evidence=None, **given):
    """Return a row of a certificate as data."""
    told = {"what": key, "declared": "yes", "claimed": True, "verdict": "holds", "reason": "", "value": None}
    return SimpleNamespace(key=key, evidence=evidence or {}, **{**told, **given})


def certificate(rows, **given):
    subject = {"system": {"name": "a $body"}, "scheme": {"shown": "of mine"}, "step": -0.25}
    return SimpleNamespace(**{"rows": rows, "subject": subject, "passed": True, "declares": True, **given})


STEPS = np.array([0.4, 0.2, 0.1, 0.05])


@pytest.mark.parametrize("of", ["of single steps", "of the run"])
def test_errors_defects_and_deviations_are_the_evidence(of):
    errors, rounding = 3.0 * STEPS**2, np.array([1e-15, 2e-15, 4e-15, 9e-15])
    fitted = {"fitted steps": STEPS[1:], "fitted errors": 5.0 * STEPS[1:] ** 3, "fitted of": of}
    times = -np.array([0.0, 0.5, 1.5, 4.0])
    deviations = np.array([[0.0, 0.0], [3.0, -4.0], [0.0, 0.0], [1.0, 7.0]])
    rows = [
        row("order", {"steps": STEPS, "errors": errors, "round-off": rounding, **fitted}, value=2.0),
        row("symmetry", {"steps": STEPS, "defects": STEPS**3, "slope": 3.0}, verdict="fails"),
        row("reversibility"),
        row("poisson", {"steps": STEPS, "defects": STEPS**5, "slope": 4.96}, verdict="not decided"),
        row("energy", {"times": times, "deviations": deviations}, verdict="not decided", claimed=False),
        row("casimir |x|^2", {"times": times, "deviations": 0.5 * deviations}),
    ]
    figure = draw_certificate(certificate(rows))
    convergence, defects, invariants, verdicts = figure.axes
    np.testing.assert_array_equal(data(convergence.lines[0]), [STEPS, errors])
    np.testing.assert_array_equal(data(convergence.lines[1]), [STEPS, rounding])
    alone = of == "of single steps"
    slope = {line.get_label(): line for line in convergence.lines}[f"$h^{{{3.0 if alone else 2.0:.2f}}}$"]
    wanted = 5.0 * STEPS[-1] ** 3 * (STEPS[1:] / STEPS[-1]) ** (3.0 if alone else 2.0)
    np.testing.assert_allclose(data(slope), [STEPS[1:], wanted], rtol=1e-12)
    singles = [line for line in convergence.lines if line.get_label() == "error of a step"]
    assert len(singles) == alone and all(np.array_equal(line.get_ydata(), 5.0 * STEPS[1:] ** 3) for line in singles)
    assert set(convergence.lines[-1].get_xdata()) == {0.25}
    for axes in (convergence, defects, invariants):
        assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    for line, power, label in zip(
        defects.lines, (3, 5), ("step back, $h^{3.0}$", "Poisson bracket, $h^{5.0}$"), strict=True
    ):
        np.testing.assert_array_equal(data(line), [STEPS, STEPS**power])
        assert line.get_label() == label
    sizes = np.array([12.5**0.5, np.nan, 5.0])
    for line, part, label in zip(invariants.lines, (1.0, 0.5), ("$H$", "$|x|^2$"), strict=True):
        np.testing.assert_allclose(data(line), [[0.5, 1.5, 4.0], part * sizes], rtol=1e-15)
        assert line.get_label() == label
    texts = {text.get_text(): text for text in verdicts.texts}
    heights = [texts[each.key].get_position()[1] for each in rows]
    assert all(high > low for high, low in pairwise(heights)) and 0.0 < heights[-1] < heights[0] < 1.0
    shades = {(text.get_text(), text.get_position()[1]): text.get_color() for text in verdicts.texts}
    found = [shades[each.verdict, height] for each, height in zip(rows, heights, strict=True)]
    assert found == [PASS_COLOUR, FAIL_COLOUR, PASS_COLOUR, FAIL_COLOUR, UNDECIDED_COLOUR, PASS_COLOUR]
    assert figure.get_suptitle() == r"a \$body,  of mine,  step -0.25:  passed"


@pytest.mark.parametrize(
    ("passed", "declares", "said"),
    [(False, True, "not passed"), (True, True, "passed"), (True, False, "nothing declared")],
)
def test_certificates_without_measurements(passed, declares, said):
    rows = [row("order", reason="every state rests"), row("symmetry"), row("reversibility"), row("poisson")]
    still = {"times": [0.0, 1.0], "deviations": np.zeros((2, 3))}
    for more, text in (([], "no invariant is followed"), ([row("energy", still)], "no deviation in any bit")):
        figure = draw_certificate(certificate([*rows, *more], passed=passed, declares=declares))
        texts = [[found.get_text() for found in axes.texts] for axes in figure.axes[:3]]
        assert texts == [["every state rests"], ["no defect above round-off"], [text]]
        assert figure.get_suptitle().endswith(f":  {said}")


def test_lines_are_the_series_and_its_line() -> None:
    t = np.arange(500) * 0.5
    drift = drift_of_series(t, 2.0 + 0.01 * t + 0.1 * np.cos(t))
    lead, _ = drift.plot().axes
    _, line = lead.get_lines()
    assert line.get_ydata()[0] == pytest.approx(drift.intercept)
    assert "linear" in lead.get_title() and "0.036) \\times 10^{-3}" in line.get_label()
    assert lead.get_ylabel() == "lead [unit of time]"
    assert "0.011" in draw_phase_drift(drift, predicted=0.011).axes[0].get_lines()[2].get_label()
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
