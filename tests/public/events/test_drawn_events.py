"""Random events, and events within steps of Taylor series, against closed forms."""

import numpy as np
import pytest

import coadjoint as co

PLANE = co.LieAlgebra.from_brackets(3, {(2, 0): {1: 1.0}, (2, 1): {0: -1.0}})
TURNING = co.LiePoissonSystem(PLANE, co.Quadratic(0.0, linear=[0.0, 0.0, 1.0]), sign=1)  # x1 = r sin, x2 = -r cos
U = 2.0**-53
METHODS = [
    co.Splitting(order=2),
    co.GaussLegendre(6),
    co.ExplicitRungeKutta(),
    co.Taylor(order=20),
    co.Taylor(tolerance=1e-15),
    co.Composition(co.Splitting(order=2), (0.3, 0.4, 0.3)),
]
DRAWS = 30
# g is curved away from zero over a crossing pair's step and its two neighbours: these are within a quarter turn.
LARGEST_STEP = np.pi / 8
# Crossings are drawn at least this far, in steps, from a grid point, from each other, and from the end of the span.
APART = 0.01


def event_at(phase, half, radius, **options):
    """Return the event g = r cos(theta - phase) - r cos(half), where theta is the angle of the motion."""
    w = [np.sin(phase), -np.cos(phase), 0.0]
    return co.Event(co.Quadratic(0.0, linear=w, constant=-radius * np.cos(half)), **options)


def crossings_of(start, span, events, phases, halves):
    """Return rows (time, event, direction) from the closed form, in the order of the run, up to a terminal event."""
    t0, t1 = span
    way, rows = np.sign(t1 - t0), []
    for e, (phase, half) in enumerate(zip(phases, halves, strict=True)):
        for side in (-1, 1):
            for turn in range(-3, 4):
                t = t0 + phase + side * half + 2 * np.pi * turn - start
                if 0.0 < way * (t - t0) <= way * (t1 - t0):
                    rows.append((t, e, int(-side * way)))
    rows.sort(key=lambda row: way * row[0])
    counted, seen = [], [0] * len(events)
    for t, e, direction in rows:
        event = events[e]
        if event.direction not in (0, direction) or (event.count is not None and seen[e] >= event.count):
            continue
        seen[e] += 1
        counted.append((t, e, direction))
        if event.terminal and seen[e] == event.until:
            break
    return counted


def draw(rng):
    """Return step, span, starts, events with their angles, and options; None where points are close."""
    h, steps = float(rng.uniform(0.2, 1.0)) * LARGEST_STEP, int(rng.integers(1, 8))
    t0, way = float(rng.choice([0.0, 1.5, -2.0])), int(rng.choice([-1, 1]))
    starts = rng.uniform(0.0, 2 * np.pi, (1, 1, 3, 11)[rng.integers(4)])
    events, phases, halves = [], [], []
    for _ in range(int(rng.integers(1, 4))):
        # The middle of a pair, in steps from the start of the first member: half of them in the first or the last step.
        middle = (0.5, steps - 0.5, rng.uniform(0.0, steps), rng.uniform(0.0, steps))[rng.integers(4)]
        half = h * float(rng.uniform(0.05, 0.45)) if rng.random() < 0.7 else float(rng.uniform(0.1, 3.0))
        options = {
            "direction": int(rng.integers(-1, 2)),
            "count": (None, None, 1, 2)[rng.integers(4)],
            "terminal": bool(rng.random() < 0.3),
            "name": f"e{len(events)}",
        }
        phases.append(starts[0] + way * h * (middle + 0.02 * rng.uniform(-1.0, 1.0)))
        halves.append(half)
        events.append(event_at(phases[-1], half, 2.0, **options))
    span = (t0, t0 + way * steps * h)
    free = [co.Event(0, name=f"e{k}") for k in range(len(events))]
    for start in starts:
        times = [abs(t - t0) / h for t, _, _ in crossings_of(start, (t0, span[1] + way * h), free, phases, halves)]
        points = np.sort(np.concatenate([times, np.arange(steps + 1)]))
        if np.min(np.diff(points)) < APART:
            return None
    given = {"save_every": int(rng.choice([1, 2, 100])), "watch": bool(rng.integers(2))}
    if rng.random() < 0.3:
        given = {"t_eval": t0 + way * h * np.sort(rng.uniform(0.0, steps, 3))}
    return h, span, starts, events, phases, halves, given


@pytest.mark.thinned(2)
@pytest.mark.parametrize("method", METHODS, ids=str)
def test_random_events_match_the_closed_form(method):
    rng, pairs_at_the_end = np.random.default_rng(70), 0
    substeps = 32 if isinstance(method, co.ExplicitRungeKutta) else 1  # its error is then below the tolerance
    for _ in range(DRAWS):
        drawn = None
        while drawn is None:
            drawn = draw(rng)
        h, span, starts, events, phases, halves, given = drawn
        x0 = 2.0 * np.stack([np.sin(starts), -np.cos(starts), 0.0 * starts], axis=1)
        x0 = x0 if len(starts) > 1 else x0[0]
        found = co.integrate(TURNING, x0, span, h / substeps, method, events=events, **given).events
        for m, start in enumerate(starts):
            exact = crossings_of(start, span, events, phases, halves)
            mine = np.flatnonzero(found.member == m)
            assert [(int(found.which[i]), int(found.direction[i])) for i in mine] == [row[1:] for row in exact]
            assert np.allclose(found.t[mine], [row[0] for row in exact], rtol=0.0, atol=1e-6 * h)
            pairs_at_the_end += sum(abs(span[1] - t) < h for t, _, _ in exact) >= 2
    assert pairs_at_the_end > DRAWS // 8


@pytest.mark.thinned(6)
@pytest.mark.parametrize("method", METHODS, ids=str)
@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("steps", [1, 2, 9])
def test_crossings_just_inside_and_outside_the_span(method, way, steps):
    """A pair in the last step, of which the second lies 2e-6 of a step before or after the end."""
    h = LARGEST_STEP / 8
    for shift, count in ((-2e-6, 2), (2e-6, 1)):
        second = way * h * (steps + shift)
        half = 0.3 * h
        phase = second - way * half
        event = event_at(phase, half, 2.0)
        found = co.integrate(TURNING, (0.0, -2.0, 0.0), (0.0, way * h * steps), h, method, events=event).events
        assert len(found) == count
        if count == 2:
            assert abs(found.t[-1] - second) < 1e-6 * h


START = np.array([np.cos(-0.7), np.sin(-0.7), 0.0])  # x1 = cos(t - 0.7), x2 = sin(t - 0.7)
SERIES = co.Taylor(order=30, projected=False)
X1, X2 = (co.Polynomial.variable(i, 3) for i in range(2))
QUARTIC = 4 * X1 * X2 * (X1 * X1 - X2 * X2)  # sin(4 a) at the angle a


def angles(h, event, end, method=SERIES, **options):
    """Return the angles t - 0.7 at which an event is found with steps h."""
    assert np.allclose(TURNING.vector_field(START), [-START[1], START[0], 0.0])
    found = co.integrate(TURNING, START, (0, end), h, method, events=event, **options).events
    return found.t - 0.7, found.direction


@pytest.mark.parametrize("h", [0.5, 1.5, 3.0])
def test_series_find_all_crossings_of_a_product(h):
    """With h = 3 four zeros lie in a step."""
    a, direction = angles(h, co.Event(QUARTIC), 9.0)
    want = np.arange(np.ceil(-0.7 / (np.pi / 4)), 8.3 / (np.pi / 4)) * np.pi / 4
    assert len(a) == len(want)
    # Steps of the series round some thirty sums, and times have the round-off of 9.
    assert abs(a - want).max() < 512 * U * 9
    assert (direction == np.where(np.rint(want / (np.pi / 4)) % 2 == 0, 1, -1)).all()


@pytest.mark.parametrize("width", [0.3, 1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("h", [0.5, 2.0])
def test_series_resolve_close_pairs(width, h):
    event = co.Event(co.Polynomial({(1, 0, 0): 1.0, (0, 0, 0): -np.cos(width)}))
    a, direction = angles(h, event, 8.0)
    want = np.array([-width, width, 2 * np.pi - width, 2 * np.pi + width])
    assert len(a) == 4 and direction.tolist() == [1, -1, 1, -1]
    assert abs(a - want).max() < 256 * U * 8 / np.sin(width)
    missed = co.Event(co.Polynomial({(1, 0, 0): 1.0, (0, 0, 0): -1.0 - 1e-12}))
    assert len(angles(h, missed, 8.0)[0]) == 0
