"""Programs in `examples/`."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.mark.parametrize(
    "name",
    [
        "earth_and_moon",
        "fit_a_log",
        "kalman_filter",
        "own_energy",
        "relative_equilibria",
        pytest.param("learned_network", marks=pytest.mark.long),
    ],
)
def test_programs_that_check_their_results(name, capsys):
    runpy.run_path(str(EXAMPLES / f"{name}.py"))
    assert capsys.readouterr().out


@pytest.mark.parametrize("kind", ["decaying", pytest.param("forced", marks=pytest.mark.long)])
def test_jets_of_planets_fall_with_the_latitude(kind, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["planetary_jets.py", "48", kind])
    runpy.run_path(str(EXAMPLES / "planetary_jets.py"), run_name="__main__")
    assert capsys.readouterr().out


def test_the_least_effort_without_bias_is_that_of_a_double_integrator():
    steps, program = 20, runpy.run_path(str(EXAMPLES / "least_effort.py"))
    expected = 12 * program["I"][2] ** 2 * (np.pi / 2) ** 2 / program["T"] ** 3 * steps**2 / (steps**2 - 1)
    assert abs(program["effort"](np.zeros(3), steps) - expected) < 1e-10 * expected
