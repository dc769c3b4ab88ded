"""The picture of modified energies."""

from __future__ import annotations

import numpy as np
import pytest

import coadjoint as co
from coadjoint.pictures.modified_energy import draw_modified_energy


def test_lines_are_the_deviations(tmp_path):
    system = co.systems.rigid_body(inertia=(1, 2, 3))
    run = co.integrate(system, (1.0, 0.2, 0.1), t_span=(0, 10), step=0.1)
    figure = draw_modified_energy(run, orders=(4, 6))
    (axes,) = figure.axes
    assert axes.get_yscale() == "log" and axes.get_xlabel() == "time $t$"
    for line, values in zip(axes.lines, (run.energy, run.modified_energy(4), run.modified_energy(6)), strict=True):
        shown, expected = line.get_ydata(), np.abs(values - values[0])
        assert np.array_equal(shown[expected > 0], expected[expected > 0]) and np.isnan(shown[0])
    figure.savefig(tmp_path / "picture.png")
    with pytest.raises(TypeError, match="must be a Solution"):
        draw_modified_energy(system)
