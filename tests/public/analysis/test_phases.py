"""Phases: angles between attitudes, leads of motions shifted by known amounts, lines through series, verdicts."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

attitude_angle = co.analysis.attitude_angle
twist = co.analysis.twist
precession_error = co.analysis.precession_error
line_drift = co.analysis.line_drift
drift_of_series = co.analysis.drift_of_series
phase_error = co.analysis.phase_error

X0 = (1.0, 0.2, 0.5)
BODY = co.systems.rigid_body(inertia=(1, 2, 3))
COORDINATES = co.Splitting(order=2, parts="coordinates")


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 0.3, 1.5, 3.0, np.pi - 1e-7, np.pi])
def test_angle_of_a_known_rotation(angle: float):
    axis = np.array([1.0, -2.0, 2.0]) / 3.0
    first = Rotation.from_rotvec([0.3, -0.4, 1.1])
    second = first * Rotation.from_rotvec(angle * axis)
    # Products of 3 x 3 matrices round each entry by a few u, and the arctangent does not magnify that.
    assert attitude_angle(first.as_matrix(), second.as_matrix()) == pytest.approx(angle, abs=32 * U)


@pytest.mark.parametrize("size", [1.0, 1e-200, 1e200])
def test_twist_and_precession_against_vectors_and_quaternions(size: float):
    """Of drawn pairs in two leading axes; the axis has any length, and is not changed."""
    rng = np.random.default_rng(8)
    A, B = Rotation.random(12, random_state=1), Rotation.random(3, random_state=2)
    first, second = A.as_matrix().reshape(4, 3, 3, 3), B.as_matrix()
    unit = rng.normal(size=3)
    unit /= np.linalg.norm(unit)
    axis = size * 3.0 * unit
    given = axis.copy()
    ahead, turned = precession_error(first, second, axis), twist(first, second, axis)
    assert np.array_equal(axis, given) and ahead.shape == turned.shape == (4, 3)
    for i, j in np.ndindex(4, 3):
        between = A[3 * i + j] * B[j].inv()
        assert ahead[i, j] == pytest.approx(between.as_rotvec() @ unit, abs=64 * U)
        x, y, z, w = between.as_quat()
        wanted = 2.0 * np.arctan2(unit @ (x, y, z), w)
        assert np.remainder(turned[i, j] - wanted + 1.0, 2 * np.pi) == pytest.approx(1.0, abs=64 * U)
        assert precession_error(second[j], first[i, j], axis) == pytest.approx(-ahead[i, j], abs=64 * U)
        assert attitude_angle(first[i, j], second[j]) == pytest.approx(between.magnitude(), abs=64 * U)
    assert type(twist(np.eye(3), second[0], axis)) is type(precession_error(np.eye(3), second[0], axis)) is float


@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.6, -0.8, 0.0), (1.0, -2.0, 2.0)])
def test_half_turns_about_the_axis_and_across_it(direction: tuple[float, float, float]):
    """At pi the sign is arbitrary; nearby it is that of the angle, to the round-off of the matrices."""
    axis = np.array(direction) / np.linalg.norm(direction)
    across = np.cross(axis, (0.0, 1.0, 0.0) if abs(axis[1]) < 0.5 else (1.0, 0.0, 0.0))
    across /= np.linalg.norm(across)
    half, over = (2.0 * np.outer(n, n) - np.eye(3) for n in (axis, across))
    near = [Rotation.from_rotvec(angle * axis).as_matrix() for angle in (np.pi - 1e-7, 1e-7 - np.pi)]
    assert abs(precession_error(over, np.eye(3), axis)) < 32 * U
    for angle in (precession_error, twist):
        assert abs(angle(half, np.eye(3), axis)) == pytest.approx(np.pi, abs=32 * U)
        both = angle(np.stack([half, *near]), np.eye(3), axis)
        assert both[1:] == pytest.approx([np.pi - 1e-7, 1e-7 - np.pi], abs=32 * U)
        turned = Rotation.from_rotvec([0.3, -0.4, 1.1]).as_matrix()
        assert abs(angle(half @ turned, turned, axis)) == pytest.approx(np.pi, abs=64 * U)


def test_phase_of_a_driven_motion_follows_its_field_at_each_time():
    spin = co.systems.spin_lattice("chain", 1, field=lambda t: (0.9 * np.cos(2.0 * t), 0.9 * np.sin(2.0 * t), -1.0))
    better = co.integrate(spin, (0.6, 0.0, 0.8), (1.0, 9.0), 1 / 64, co.Splitting(order=6))
    t, lead = np.linspace(2.0, 8.0, 9), 0.01
    found = phase_error(spin, better.x[0], t, better.at(t + lead).x, better)
    # The interpolation of the run is right to its own bound, 2^-30 of the largest state, which moves by about 1 a time.
    assert found == pytest.approx(np.full(9, lead), abs=2.0**-28)


@pytest.fixture(scope="module")
def run():
    return co.integrate(BODY, X0, (0.0, 500.0), 0.1, COORDINATES, save_every=7, attitude=True)


def test_a_lead_of_many_periods_is_followed():
    t = np.linspace(0.0, 2000.0, 600)
    lead = 0.05 * t + 0.1 * np.sin(0.3 * t)  # in the end a hundred, some seven periods
    assert phase_error(BODY, X0, t, BODY.exact(X0, t + lead)) == pytest.approx(lead, abs=1e-9)
    assert phase_error(BODY, X0, -t, BODY.exact(X0, lead - t)) == pytest.approx(lead, abs=1e-9)


def test_references_of_every_kind_agree(run):
    reference = co.integrate(BODY, X0, (0.0, 510.0), 0.05, co.GaussLegendre(6), save_every=4)
    by_form = co.phase_drift(run)
    by_function = co.phase_drift(run, lambda t: BODY.exact(X0, t))
    by_run = co.phase_drift(run, reference)
    # The reference of order 12 has h^12 of error a unit of time, and less round-off than that.
    assert by_function.lead == pytest.approx(by_form.lead, abs=1e-12)
    assert by_run.lead == pytest.approx(by_form.lead, abs=1e-11)
    assert by_run.slope == pytest.approx(by_form.slope, abs=1e-12)


def test_attitudes_ahead_by_a_known_angle(run):
    drift = co.phase_drift(run, of="attitude")
    assert drift.unit == "radians" and drift.growth == "linear"
    good = co.integrate(BODY, X0, (0.0, 500.0), 0.1, co.GaussLegendre(6), save_every=7, attitude=True)
    assert co.phase_drift(run, good, of="attitude").slope == pytest.approx(drift.slope, rel=1e-7)
    # A body that also turns about its momentum: H - c |x|^2 / 2 has the same motion of x.
    c, m = 0.02, 1.0 / np.array([1.0, 2.0, 3.0])
    turning = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(m + c), sign=-1)
    ahead = co.integrate(turning, X0, (0.0, 500.0), 0.1, co.GaussLegendre(6), save_every=7, attitude=True)
    found = co.phase_drift(ahead, good, of="attitude")
    assert found.slope == pytest.approx(c * np.linalg.norm(X0), abs=1e-9), "several turns, followed"


@pytest.mark.parametrize(
    ("series", "growth"),
    [
        (lambda t: 1e-3 * t + 0.1 * np.cos(2 * t), "linear"),
        (lambda t: 0.1 * np.cos(2 * t) + 5.0, "bounded"),
        (lambda t: 1e-5 * t**2 + 1e-3 * np.cos(2 * t), "faster"),
        (lambda t: 1e-5 * t**2 + 1.0 * t, "linear"),
        (lambda t: 0.01 * t**1.5, "faster"),
        (lambda t: 0.0 * t, "bounded"),
    ],
)
def test_verdicts(series, growth):
    t = np.arange(2000) * 0.25
    drift = drift_of_series(t, series(t))
    assert drift.growth == growth
    assert str(drift).startswith(growth)
    assert drift_of_series(-t, series(t)).growth == growth


def test_verdicts_on_random_walks():
    t = np.arange(2000) * 0.25
    steps = np.random.default_rng(7).normal(size=(2000, 100))
    walks = [drift_of_series(t, walk).growth for walk in np.cumsum(steps, axis=0).T]
    phases = [drift_of_series(t, walk).growth for walk in np.cumsum(np.cumsum(steps, axis=0), axis=0).T]
    assert walks.count("faster") == 0 and walks.count("linear") < 15 and walks.count("wandering") > 60
    # A walk that happens to go nearly straight cannot be told from a line.
    assert phases.count("faster") > 75 and phases.count("bounded") == 0


def test_a_line_of_either_sign_is_as_early_as_its_motion():
    """The saved states are those of a clock that is ahead by 1e-3 of the time: of each line by 1e-3 w t, w > 0.

    The signal is real or complex, with the frequency of either sign; of one run, or of members.
    """
    sense = -1.0
    run = co.integrate(BODY, np.array([X0, (1.2, 0.1, 0.4)]), (5.0, 5.0 + sense * 400.0), 0.1, save_every=4)
    ahead = run.t - 5.0 + 1e-3 * sense * np.abs(run.t - 5.0)
    right = [co.frequencies(run.t, np.asarray(BODY.exact(x, run.t - 5.0))[:, 1], 1).frequency[0] for x in run.x[0]]
    for m, x in enumerate(run.x[0].copy()):
        run.x[:, m] = BODY.exact(x, ahead)
    for signal in (1, lambda x: x[..., 1], lambda x: x[..., 1] + 0.5j * x[..., 1]):
        for w in (right[0], -right[0]):
            drifts = line_drift(run, w, signal=signal)
            assert drifts[0].slope == pytest.approx(1e-3 * right[0], rel=1e-4)
            assert drifts[0].unit == "radians" and drifts[0].growth == "linear"
    assert line_drift(run, right[1], signal=1)[1].slope == pytest.approx(1e-3 * right[1], rel=1e-4)
    # A function is asked for the times of the run themselves.
    given = line_drift(run, right[0], lambda t: np.asarray(BODY.exact(X0, t - 5.0)), signal=1)[0]
    assert given.slope == pytest.approx(1e-3 * right[0], rel=1e-4)
    assert given.lead == pytest.approx(line_drift(run, right[0], signal=1)[0].lead, abs=1e-9)
    # Middles of the windows: half of the span, from the first to the last.
    assert given.t[[0, -1]] == pytest.approx(5.0 + sense * np.array([100.0, 300.0]), abs=0.5)
    assert given.lead == pytest.approx(1e-3 * right[0] * (given.t - 5.0), abs=1e-4)


def test_one_reference_serves_all_members():
    span = (0.0, 200.0)
    one, ensemble = (co.integrate(BODY, x0, span, 0.1, COORDINATES, save_every=4) for x0 in (X0, [X0, X0]))
    better = co.integrate(BODY, X0, span, 0.1, co.GaussLegendre(4), save_every=4)
    w = co.frequencies(better, 1, count=1).frequency[0]
    alone, both = (line_drift(some, w, better, signal=1) for some in (one, ensemble))
    for drift in both:
        assert drift.slope == pytest.approx(alone.slope, rel=1e-9)
    leads = [co.phase_drift(ensemble, better)[m].lead for m in (0, 1)]
    assert np.array_equal(leads[0], leads[1]) and np.array_equal(leads[0], co.phase_drift(one, better).lead)
    with refused(ValueError, "other members"):
        line_drift(ensemble, w, co.integrate(BODY, [X0] * 3, span, 0.1, save_every=4), signal=1)
    with refused(TypeError, "signal", "energy"):
        line_drift(one, w, signal="energy")
    with refused(ValueError, "takes 501 of 501"):
        line_drift(one, w, width=200.0)


@pytest.mark.parametrize("referenced", [False, True])
def test_the_lead_of_an_attitude_does_not_depend_on_the_frame_in_space(referenced: bool):
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    found = []
    for first in (np.eye(3), turn):
        run, good = (
            co.integrate(BODY, X0, (4.0, 104.0), 0.1, method, save_every=5, attitude=first)
            for method in (COORDINATES, co.GaussLegendre(6))
        )
        found.append(co.phase_drift(run, good if referenced else None, of="attitude"))
    assert found[1].lead == pytest.approx(found[0].lead, abs=1e-11) and np.ptp(found[0].lead) > 1e-4


@pytest.mark.parametrize("unit", ["time", "radians"])
def test_points_without_a_lead_are_left_out_with_their_times(unit: str):
    rng = np.random.default_rng(3)
    t = -7.0 - np.cumsum(rng.uniform(0.1, 2.0, 60))
    lead = 3.0 + 0.02 * t
    missing = rng.permutation(60)[:20]
    lead[missing] = np.nan
    drift = drift_of_series(t, lead, unit)
    kept = np.setdiff1d(np.arange(60), missing)
    assert np.array_equal(drift.t, t[kept]) and np.array_equal(drift.lead, lead[kept])
    assert drift.slope == pytest.approx(0.02, rel=1e-10) and drift.intercept == pytest.approx(3.0, rel=1e-10)
    assert drift.unit == unit and ("rad" in str(drift)) == (unit == "radians")
    assert drift.growth == "linear" and "40 points" in repr(drift)
    with refused(ValueError, "15 points have a lead"):
        drift_of_series(t[kept][:15], lead[kept][:15])


@pytest.mark.parametrize("of", ["momentum", "attitude"])
@pytest.mark.parametrize("t0, sense", [(0.0, 1), (7.3, -1)])
def test_members_that_events_have_ended_have_the_drift_up_to_there(t0, sense, of):
    """That of the run alone, which ends there; the member that goes on is not changed."""
    flip = co.Event(1, terminal=True)
    x0 = sense * np.array([(0.1, 1.0, 0.1), (0.2, 1.0, 0.3), (1.0, 0.2, 0.5)])
    run = (t0, t0 + sense * 20), 0.05, co.Splitting(order=2, parts="coordinates")
    options = {"save_every": 3, "events": flip, "attitude": True}
    found = co.phase_drift(co.integrate(BODY, x0, *run, **options), of=of)
    assert len({len(drift.t) for drift in found}) > 1
    for drift, x in zip(found, x0, strict=True):
        alone = co.integrate(BODY, x, *run, **options)
        wanted = co.phase_drift(alone, of=of)
        # The run alone has the end itself as its last point.
        count = len(drift.t)
        assert count in (len(wanted.t), len(wanted.t) - 1)
        np.testing.assert_array_equal(drift.t, wanted.t[:count])
        np.testing.assert_allclose(drift.lead, wanted.lead[:count], rtol=0, atol=1e-10)


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("several", [False, True])
def test_a_reference_run_is_interpolated_between_its_saved_times(several, sense):
    """On an uneven grid, for each member its own; beyond its ends there is no lead."""
    starts = np.array([[1.0, 2.0, 0.5], [0.3, -1.0, 0.4]])
    starts, span = starts if several else starts[1], (3.0, 3.0 + sense * 10.0)
    saved = 3.0 + sense * np.sort(np.random.default_rng(4).permutation(200)[:120]) / 20.0
    run = co.integrate(BODY, starts, span, 0.05, co.GaussLegendre(4), t_eval=saved)
    t = 3.0 + sense * np.sort(np.random.default_rng(5).uniform(0.0, 10.0, 50))
    late = co.integrate(BODY, starts, span, 0.05, co.GaussLegendre(4), t_eval=t)
    drifts = co.phase_drift(late, run)
    inside = np.sum((t >= min(saved)) & (t <= max(saved)))
    for drift in drifts if several else [drifts]:
        # The interpolation is right to its own bound, 2^-30 of the largest state, which moves by about its size a time.
        assert np.abs(drift.lead).max() < 2.0**-26 and len(drift.t) == inside


SAMPLES = 1000
T = np.arange(SAMPLES) * 0.1


def test_a_line_is_found_to_rounding():
    line = drift_of_series(T, 0.3 * T - 7.0)
    assert line.slope == pytest.approx(0.3, abs=1e-14) and line.intercept == pytest.approx(-7.0, abs=1e-12)
    assert 0.0 < line.uncertainty < 1e-14


def uneven(samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return drawn times and a series about a line, with noise and an oscillation, far from the origin."""
    rng = np.random.default_rng(samples)
    t = 1000.0 + np.cumsum(rng.uniform(0.05, 1.0, samples))
    return t, 40.0 - 0.3 * t + np.cos(0.2 * t) + rng.normal(0.0, 0.3, samples)


@pytest.mark.parametrize("samples", [16, 61, 768])
def test_the_line_is_that_of_least_squares_on_uneven_times(samples: int):
    t, values = uneven(samples)
    line = drift_of_series(t, values)
    slope, intercept = np.polynomial.Polynomial.fit(t, values, 1).convert().coef[::-1]
    assert line.slope == pytest.approx(slope, rel=1e-10) and line.intercept == pytest.approx(intercept, rel=1e-10)
    assert line.deviation == pytest.approx(np.sqrt(np.mean((values - slope * t - intercept) ** 2)), rel=1e-10)


@pytest.mark.parametrize("kind", ["noise", "walk"])
def test_scales_and_added_lines_change_only_what_they_must(kind: str):
    t, values = uneven(768)
    values = np.cumsum(values - values.mean()) if kind == "walk" else values
    line = drift_of_series(t, values)
    assert (line.exponent > 0.2) == (kind == "walk"), "with and without the spread of the pieces"
    for unit, factor, slope, shift in ((1.0, -3.0, 0.0, 5.0), (-0.01, 1e4, 7.0, 0.0), (50.0, 0.5, -2.0, 1e3)):
        other = drift_of_series(unit * t + shift, factor * values + slope * t - 8.0)
        # Sums of 768 products of values up to 1e3 that lose three digits to the mean: some 1e-9 at the most.
        assert other.slope == pytest.approx((factor * line.slope + slope) / unit, rel=1e-8)
        assert other.uncertainty == pytest.approx(abs(factor / unit) * line.uncertainty, rel=1e-8)
        assert other.deviation == pytest.approx(abs(factor) * line.deviation, rel=1e-8)
        assert other.slow_deviation == pytest.approx(abs(factor) * line.slow_deviation, rel=1e-8)
        assert other.exponent == pytest.approx(line.exponent, abs=1e-8)
    # 768 samples are whole blocks of each number: from the end they are the same ones.
    back = drift_of_series(-t[::-1], values[::-1])
    assert back.slope == pytest.approx(-line.slope, rel=1e-8)
    for name in ("uncertainty", "deviation", "slow_deviation", "exponent"):
        assert getattr(back, name) == pytest.approx(getattr(line, name), rel=1e-8), name


def test_slow_deviations_are_those_of_means_over_a_64th_of_the_span():
    """The last block is as long as the others: a parabola without its line, averaged over 12 samples each."""
    t = np.arange(768.0)
    line = drift_of_series(t, t**2)
    means_t, means = t.reshape(64, 12).mean(axis=1), (t**2).reshape(64, 12).mean(axis=1)
    rest = means - np.polyval(np.polyfit(means_t, means, 1), means_t)
    assert line.slow_deviation == pytest.approx(np.sqrt(np.sum(rest**2) / 62), rel=1e-10)
    jump = drift_of_series(t, np.where(t >= 756, 1.0, 0.0)).slow_deviation
    assert jump == pytest.approx(drift_of_series(t, np.where(t < 12, 1.0, 0.0)).slow_deviation, rel=1e-10)
