"""Events in configuration files and datasets."""

from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.configuration.construction import ConfigurationError
from coadjoint.files.configuration.loading import load
from coadjoint.files.datasets.export import rebuild

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X0 = (0.1, 1.0, 0.1)
LINES = """
system = {name = "rigid_body", parameters = {inertia = [1, 2, 3]}}
initial = {x = [0.1, 1.0, 0.1]}
method = {name = "Splitting", order = 4}
run = {t_span = [0, 40], step = 0.125}
[events.flip]
g = "x2"
[events.far]
g = "x1^2 - 0.125"
direction = 1
terminal = true
count = 2
"""


def written(tmp_path, lines):
    path = tmp_path / "body.toml"
    path.write_text(lines)
    return load(path)


def test_events_of_a_configuration(tmp_path):
    sol = written(tmp_path, LINES).integrate()
    far = co.Polynomial({(2, 0, 0): 1, (0, 0, 0): -0.125})
    events = [co.Event("x2", name="flip"), co.Event(far, 1, 2, True, "far")]
    same = co.integrate(BODY, X0, (0, 40), 0.125, co.Splitting(order=4), events=events)
    assert sol.events.names == ("flip", "far")
    assert np.array_equal(sol.events.t, same.events.t) and np.array_equal(sol.x, same.x)
    assert len(sol.events["far"]) == 2 and sol.t[-1] == sol.events["far"].t[-1]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('g = "x2"', 'g = "y2"', "events.flip"),
        ('g = "x2"', "g = 3", "events.flip"),
        ("direction = 1", "direction = 2", "events.far"),
        ("count = 2", "count = 0", "events.far.count"),
        ("terminal = true", "terminall = true", "events.far.terminall: unknown key; did you mean 'terminal'"),
    ],
)
def test_invalid_events_have_the_key(tmp_path, old, new, message):
    with pytest.raises(ConfigurationError, match=message):
        written(tmp_path, LINES.replace(old, new)).integrate()


@pytest.mark.parametrize("attitude", [False, True])
def test_run_with_events_is_rebuilt(attitude):
    events = [co.Event("x2"), co.Event(co.Polynomial({(2, 0, 0): 1, (0, 0, 0): -0.125}), count=2, terminal=True)]
    sol = co.integrate(BODY, X0, (0, 40), 0.125, attitude=attitude, events=events)
    dataset = sol.to_xarray()
    again = rebuild(dataset)
    assert np.array_equal(again.t, sol.t) and np.array_equal(again.x, sol.x) and again.t_span == sol.t_span
    for name in ("t", "x", "which", "direction"):
        assert np.array_equal(getattr(again.events, name), getattr(sol.events, name))
    assert np.array_equal(dataset["event_time"], sol.events.t) and np.array_equal(dataset["event_x"], sol.events.x)
    assert ("event_attitude" in dataset) == attitude


@pytest.mark.parametrize("linear", [0.0, Fraction(1, 3)])
def test_quadratic_events_are_stored(linear):
    """Their coefficients are preserved; fractions stay exact."""
    arguments = co.Quadratic([1, 0, 0], linear=[0, linear, 0], constant=-Fraction(1, 8) if linear else -0.125)
    events = [co.Event(arguments, name="far"), co.Event("x2", count=2, terminal=True)]
    sol = co.integrate(BODY, X0, (0, 40), 0.125, events=events)
    dataset = sol.to_xarray()
    again = rebuild(dataset)
    assert "not_stored" not in dataset.attrs and again.events.names == sol.events.names
    assert len(sol.events["far"]) > 1 and isinstance(again.events.asked[0].g, co.Quadratic)
    for name in ("t", "x", "which", "direction"):
        assert np.array_equal(getattr(again.events, name), getattr(sol.events, name))
    dataset.attrs["events"] = dataset.attrs["events"].replace('"kind"', '"sort"')
    with pytest.raises(ValueError, match=r"events.*kind"):
        rebuild(dataset)


def test_event_functions_are_not_stored():
    """A run that such an event may have ended is not rebuilt."""
    options = {"t_span": (0, 40), "step": 0.125}
    seen = co.integrate(BODY, X0, events=co.Event(lambda x: x[1], name="mine"), **options)
    assert "event: mine" in seen.to_xarray().attrs["not_stored"]
    assert np.array_equal(rebuild(seen.to_xarray()).x, seen.x)
    ended = co.integrate(BODY, X0, events=co.Event(lambda x: x[1], name="mine", terminal=True), **options)
    with pytest.raises(ValueError, match="ended by an event, and mine"):
        rebuild(ended.to_xarray())


@pytest.mark.thinned(4)
@pytest.mark.parametrize("terminal", [False, True])
@pytest.mark.parametrize("first", [True, False])
def test_loaded_crossings_have_their_names(tmp_path, first, terminal):
    actual = co.Event(lambda x: x[0] - 0.25, name="mine", count=3, terminal=terminal)
    events = [actual, co.Event("x2")] if first else [co.Event("x2"), actual]
    sol = co.integrate(BODY, [X0, (0.2, 1.0, 0.1)], (0.5, 40.5), 0.125, events=events)
    sol.to_xarray().to_netcdf(tmp_path / "body.nc")
    loaded = co.load(tmp_path / "body.nc")
    assert loaded.events.names == sol.events.names
    for name in sol.events.names:
        assert len(sol.events[name]) > 1 and np.array_equal(loaded.events[name].t, sol.events[name].t)
    assert np.array_equal(loaded.events.ends(2), sol.events.ends(2), equal_nan=True)
    asked = loaded.events.asked[loaded.events.names.index("mine")]
    assert (asked.count, asked.terminal, asked.direction) == (3, terminal, 0)
    with pytest.raises(ValueError, match="not stored"):
        asked.g(np.ones(3), 0.0)
