"""The intermediate-axis flip, as the README shows it: its picture, and its period by elliptic integrals."""

import importlib.util
from pathlib import Path

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint.analysis.periods import period
from coadjoint.pictures.kinds.components import flip_times
from coadjoint.runs.example_run import run_example

ROOT = Path(__file__).parents[2]


def half_period(inertia, x0):
    """Return 2 K(k) / lambda, after which the middle component has changed its sign, to 30 digits.

    By the axes sorted: with a, b, c such that b is the middle one and the motion goes around c.
    """
    with mpmath.workdps(30):
        m = sorted((1 / mpmath.mpf(moment) for moment in inertia), reverse=True)
        order = np.argsort(inertia)
        x = [mpmath.mpf(float(x0[i])) for i in order]
        energy2, size2 = sum(k * v * v for k, v in zip(m, x, strict=True)), sum(v * v for v in x)
        a, b, c = (m[2], m[1], m[0]) if energy2 > m[1] * size2 else (m[0], m[1], m[2])
        rate2 = (b - c) * (a * size2 - energy2)
        k2 = (a - b) * (energy2 - c * size2) / rate2
        return float(2 * mpmath.ellipk(k2) / mpmath.sqrt(rate2))


@pytest.mark.thinned(4)
@pytest.mark.parametrize(
    ("inertia", "x0"),
    [
        ((1, 2, 3), (0.01, 1.0, 0.01)),
        ((1, 2, 3), (0.03, 1.0, 0.01)),
        ((1, 2, 3), (0.01, -1.0, 0.05)),
        ((3.0, 1.0, 2.2), (0.02, -0.01, 1.3)),
    ],
)
def test_the_flip_comes_after_half_the_period_of_the_elliptic_functions(inertia, x0):
    body = co.systems.rigid_body(inertia)
    middle = int(np.argsort(inertia)[1])
    wanted = half_period(inertia, x0)
    run = co.integrate(body, x0, (0.0, 128.0), 2.0**-5, co.GaussLegendre(4))
    times = flip_times(body.vector_field, run.t, run.x, middle)
    assert len(times) >= 3
    # The cubic between two points misses by h^4 x'''' / 384 over the slope at the flip; all rates are below one.
    np.testing.assert_allclose(np.diff(times), wanted, rtol=0, atol=2.0**-20 / 16)
    # The other components have the period, or half of it; both are whole numbers of flips.
    flipped = period(body.vector_field, x0).time / wanted
    assert flipped == pytest.approx(2.0, abs=1e-9)


def test_the_picture_says_the_time_between_flips():
    run = run_example("rigid_body")
    assert run.system.parameters == {"inertia": (1.0, 2.0, 3.0)}
    _, components, orbit, axis = run.plot().axes
    (said,) = [text.get_text() for text in components.texts if text.get_text()]
    wanted = half_period((1, 2, 3), run.x[0])
    # Splitting of order 4 at the step 0.05: its phase is late by about 1e-5 of the time, measured beside 2 K / lambda
    assert said.startswith("$x_{2}$ changes sign after ")
    assert float(said.rpartition(" ")[2]) == pytest.approx(wanted, rel=1e-4)
    assert orbit.name == "3d" and axis.get_title() == "body axis 2 in space"
    start = next(line for line in axis.lines if line.get_label() == "start")
    height = float(np.ravel(start.get_ydata())[0])
    assert height > 0.9, "the axis begins near the momentum, which points up"
    # and goes down: A^T of the momentum has its middle component reversed
    assert run.x[:, 1].min() < -0.99 * np.linalg.norm(run.x[0])


def test_the_readme_shows_what_is_drawn(tmp_path):
    specification = importlib.util.spec_from_file_location("draw_flip", ROOT / "docs" / "draw_flip.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    first = readme.index("![")
    assert readme[first:].partition("(")[2].startswith("docs/intermediate_axis_flip.png)")
    assert module.PICTURE.stat().st_size > 20_000 and module.PICTURE.name == "intermediate_axis_flip.png"
    assert [axes.get_title() for axes in module.draw().axes][-1] == "body axis 2 in space"
