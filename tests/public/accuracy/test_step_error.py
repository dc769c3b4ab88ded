"""The error of a step, by two half steps: its size against exact motions, and the warning of too large steps."""

import math
import pickle
import warnings

import numpy as np
import pytest

import coadjoint as co
from long import long_beyond

OVER_RUN, FASTEST = 0.05, 0.4
"""Largest error over a run without a warning, and the weight of the fastest step, as docs/accuracy.md states them."""
BODY, X0 = co.systems.rigid_body(inertia=(1, 2, 3)), np.array([0.3, 1.0, 0.2])
TOP, TOP_X0 = co.systems.heavy_top(), np.array([1.0, 0.0, 2.0, 0.1, 0.0, 1.0])
SEVEN = co.LiePoissonSystem(co.algebras.so(4), co.Quadratic([1.0, 0.5, 0.3, 0.8, 0.2, 0.6]))


def told(call):
    """Return the result of a call, and what its warnings of large steps say; each names the line of the caller."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        result = call()
    found = [one for one in found if one.category is co.LargeStepWarning]
    assert all(one.filename == __file__ for one in found)
    return result, [str(one.message) for one in found]


def warned(call, subject="this motion"):
    """Return the result of a call that warns once, of this motion or that of a member."""
    result, (message,) = told(call)
    assert f"too large for {subject}: " in message
    return result


def quiet(call):
    """Return the result of a call that does not warn."""
    result, messages = told(call)
    assert messages == []
    return result


def error_of_step(body, states, method, h):
    """Return the error of a step from the states, relative to the change of the state, root mean square."""
    after = np.array([co.integrate(body, x, (0, h), abs(h), method).x[-1] for x in states])
    exact = np.array([body.exact(x, h) for x in states])
    return np.linalg.norm(after - exact) / np.linalg.norm(exact - states)


@pytest.mark.parametrize("h", [0.25, -0.25])
@pytest.mark.parametrize(
    "method", [co.Splitting(), co.Splitting(order=4), co.GaussLegendre(1), co.Taylor(order=4), co.Kahan()]
)
def test_it_is_the_error_of_a_step(method, h):
    """Against the closed form; the estimate by half steps lacks terms of the next order."""
    sol = co.integrate(BODY, X0, (0, 40 * h), abs(h), method)
    points = sol.x[[0, 8, 16, 24, 32]]
    assert sol.step_error() == pytest.approx(error_of_step(BODY, points, method, h), rel=0.15)


@pytest.mark.parametrize("span", [(3.0, 7.0), (3.0, -1.0)])
def test_with_forces_it_is_that_of_steps_in_the_direction_of_the_run(span):
    """Against fine steps; with a damping steps forward and backward differ."""
    damped, h = BODY.with_forces(co.forces.LinearDamping(0.15)), 0.4
    sol = co.integrate(damped, X0, span, h, co.Splitting())
    forward = np.sign(span[1] - span[0])
    ends = [
        [co.integrate(damped, x, (t, t + forward * h), h / fine, co.Splitting()).x[-1] for fine in (1, 128)]
        for x, t in zip(sol.x[::2][:5], sol.t[::2][:5], strict=True)
    ]
    after, exact = np.swapaxes(ends, 0, 1)
    assert sol.step_error() == pytest.approx(
        np.linalg.norm(after - exact) / np.linalg.norm(exact - sol.x[::2][:5]), rel=0.15
    )


def test_where_a_state_rests_or_returns():
    """After a whole turn of a spin the state is the same again, but not after half of it. Rounding does not count."""
    spin = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([0.0, 0.0, 0.0], linear=[0.0, 0.0, 1.0]))
    run = (1.0, 0.0, 0.3), (0, 20 * np.pi), 2 * np.pi, co.GaussLegendre(8)
    for every in (1, 5):
        assert quiet(lambda every=every: co.integrate(spin, *run, save_every=every)).step_error() < 1e-3
    for x0, step in (((0.0, 0.0, 2.0), 0.1), ((0.0, 0.0, 0.0), 0.1), ((1e-15, 0.0, 2.0), 0.01)):
        assert co.integrate(BODY, x0, (0, 1), step).step_error() == 0.0


ALIGNED, LATTICE = np.tile([1.0, 2.0, 3.0], 16), co.systems.spin_lattice("square", (4, 4), periodic=True)


@pytest.mark.parametrize(("share", "warns"), [(0.98, False), (1.02, True)])
def test_near_equilibria_the_error_of_the_whole_run_counts(share, warns):
    """Aligned spins are at rest, and all that a step changes is error: 5 percent of the state are too much."""
    h, method = 0.01, co.Splitting(order=2)
    whole, halves = (co.integrate(LATTICE, ALIGNED, (0, h), h / k, method, save_every=k).x[-1] for k in (1, 2))
    error = 4 / 3 * np.linalg.norm(whole - halves) / np.linalg.norm(ALIGNED)
    steps = int(share * OVER_RUN / error)
    assert steps > 100
    sol, found = told(lambda: co.integrate(LATTICE, ALIGNED, (1, 1 + steps * h), h, method, save_every=steps))
    assert np.isnan(sol.step_error()) and len(found) == warns
    assert not warns or "take a step of about 0.002" in found[0]  # an error of 0.2 percent


@pytest.mark.parametrize(("amplitude", "warns"), [(0.0, False), (1e-9, False), (1e-4, True)])
def test_small_motions_near_equilibria_are_judged_as_others(amplitude, warns):
    """Waves of spins are lost in the error of a step, however short the run; at rest there is no motion to lose."""
    x0 = ALIGNED + amplitude * np.random.default_rng(1).standard_normal(48)
    sol, found = told(lambda: co.integrate(LATTICE, x0, (0, 0.1), 0.02, co.Splitting(order=2)))
    assert np.isnan(sol.step_error()) == (not warns) and len(found) == warns


def test_the_worst_member_counts():
    states = np.array([X0, 3 * X0, 0.5 * X0])
    errors = [co.integrate(BODY, x, (0, 8), 0.1).step_error() for x in states]
    assert co.integrate(BODY, states, (0, 8), 0.1).step_error() == max(errors) == errors[1] > 2 * errors[0]
    bodies = [co.systems.rigid_body(inertia=(1.0, 2.0, third)) for third in (1.2, 2.0, 2.9)]
    errors = [co.integrate(body, X0, (3, 11), 0.1).step_error() for body in bodies]
    assert co.integrate(co.batch(bodies), X0, (3, 11), 0.1).step_error() == max(errors)


def test_of_matrices_forces_and_archives(tmp_path):
    fluid = co.systems.sphere_euler(N=5)
    W = fluid.matrices(np.random.default_rng(1).normal(size=fluid.dim))
    damped = BODY.with_forces(co.forces.LinearDamping(0.1))
    for system, x0 in ((fluid, W), (damped, X0)):
        coarse, fine = (co.integrate(system, x0, (0, 2), h).step_error() for h in (0.1, 0.05))
        assert 3.0 < coarse / fine < 5.0  # order two, relative to a change of order one
    # Of long runs in archives only the start is measured, and no state is read.
    stored = co.integrate(BODY, X0, (0, 200), 0.1, archive=tmp_path / "run.zarr")
    assert stored.step_error() == pytest.approx(error_of_step(BODY, [X0], co.Splitting(), 0.1), rel=0.15)
    short = co.integrate(BODY, X0, (0, 20), 0.1, archive=tmp_path / "short.zarr", save_every=7)
    assert short.step_error() == co.integrate(BODY, X0, (0, 20), 0.1).step_error()


@pytest.mark.parametrize("count", [8, 1200])
@pytest.mark.parametrize("shift", [0.0, 0.1])
def test_with_samples_only_whole_steps_are_measured(count, shift):
    """A law that is sampled in the middle of a step would act on a state that it never sees."""
    law = co.forces.Sampled(co.forces.Pointing(0.5, 2.4), period=0.5)
    body = co.systems.body((4.0, 5.5, 7.2)).with_forces(co.forces.Torque((0.012, -0.02, 0.009)), law)
    x0, span = body.state([0.1, 0.1, 0.7, 0.7]), (3.0, 3.0 + 0.25 * count)
    times = np.linspace(3.0, 5.0, 9)[:-1] + shift
    sol = co.integrate(body, x0, span, 0.25, t_eval=times)
    assert sol.step_error() < 2.0 * co.integrate(body, x0, (3.0, 5.0), 0.25).step_error() < 0.01


@pytest.mark.parametrize("system, x0", [(BODY, X0), (TOP, TOP_X0), (SEVEN, np.arange(1.0, 7.0) / 4)])
def test_the_warning_comes_just_above_the_threshold_and_not_below(system, x0):
    """The step is bisected until one of two neighbouring ones warns; the errors of both are 5 percent of the motion.

    By half steps the error is known up to terms of the next order.
    """
    low, high = 1e-3, 4.0
    for _ in range(24):
        middle = (low * high) ** 0.5
        found = told(lambda step=middle: co.integrate(system, x0, (0, 20 * step), step))[1]
        low, high = (low, middle) if found else (middle, high)
    fine = co.integrate(system, x0, (0, 20 * low), low / 8, co.GaussLegendre(4), save_every=8).x
    size = np.repeat(np.linalg.norm(fine.reshape(len(fine), -1, 3), axis=2).max(axis=0), 3) if system is TOP else 1.0
    errors, motion = (co.integrate(system, x0, (0, 20 * low), low).x - fine) / size, (fine - x0) / size
    ratio = np.linalg.norm(errors, axis=1).max() / np.linalg.norm(motion, axis=1).max()
    assert ratio == pytest.approx(OVER_RUN, rel=0.25)


@pytest.mark.parametrize("method", [co.Splitting(), co.Taylor(order=4), co.GaussLegendre(1)])
def test_the_step_suggested_follows_the_motion(method):
    _, (message,) = told(lambda: co.integrate(TOP, TOP_X0, (0, 24), 0.75, method))
    steps = round(24 / float(message.rpartition(" ")[2]))
    assert 1e-4 < co.integrate(TOP, TOP_X0, (0, 24), 24 / steps, method).step_error() < 0.01


@pytest.mark.parametrize(
    "options", [{}, {"attitude": True}, {"inputs": {"field": (0, 1, 2)}}], ids=["plain", "attitude", "inputs"]
)
def test_the_first_run_of_a_prepared_one_warns(options):
    """Copies and later runs do not."""
    prepared = co.prepare(BODY, co.Splitting(), 4.0, **options)
    twin = pickle.loads(pickle.dumps(prepared))
    sol = warned(lambda: prepared.run(X0, (0, 20)))
    assert sol.step_error() == pytest.approx(quiet(lambda: twin.run(X0, (0, 20))).step_error())
    np.testing.assert_array_equal(quiet(lambda: prepared.run(X0, (0, 20))).x, sol.x)
    quiet(lambda: co.prepare(BODY, co.Splitting(), 0.1, **options).run(X0, (0, 20)))
    quiet(lambda: co.prepare(BODY, accuracy=1e-6, x0=X0, t_span=(0, 20)).run(X0, (0, 20)))


def test_ensembles_in_blocks_warn_once(tmp_path):
    states = np.tile(0.1 * X0, (9, 1))
    states[7] = 10 * X0
    warned(lambda: co.integrate(BODY, states, (0, 4), 0.4), "the motion of member 7")
    given, options = ((0, 4), 0.4), {"archive": tmp_path / "many.zarr", "members_per_block": 2}
    many = warned(lambda: co.integrate_ensemble(BODY, states, *given, **options), "the motion of member 7")
    np.testing.assert_array_equal(quiet(lambda: co.integrate_ensemble(BODY, states, *given, **options)).x, many.x)
    quiet(lambda: co.integrate_ensemble(BODY, states[:7], *given))
    with warnings.catch_warnings(), pytest.raises(co.LargeStepWarning):
        warnings.simplefilter("error", co.LargeStepWarning)
        co.integrate_ensemble(BODY, states, *given, archive=tmp_path / "refused.zarr")
    np.testing.assert_array_equal(told(lambda: co.resume(tmp_path / "refused.zarr"))[0].x, many.x)


def test_of_blocks_the_member_that_lost_its_energy_is_named(tmp_path):
    """Neither in the first block, nor first in its own."""
    states = np.tile([1e-3, 2e-3, 1e-3], (8, 1))
    states[5] = 2.0, 0.5, 1.5
    given = BODY, states, (0.0, 400.0), 0.5, co.ExplicitRungeKutta()
    warned(
        lambda: co.integrate_ensemble(*given, members_per_block=2, archive=tmp_path / "lost.zarr"),
        "the motion of member 5",
    )


def kepler():
    J = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])

    def energy(x):
        return 0.5 * (x[2] ** 2 + x[3] ** 2) - (x[0] ** 2 + x[1] ** 2) ** -0.5

    return co.PoissonSystem(lambda x: J, co.Hamiltonian(energy), dim=4, name="kepler")


KEPLER, STEP, GAUSS = kepler(), 2 * np.pi / 120, co.GaussLegendre(2)


def orbit(eccentricity):
    """The state at the apocentre of an orbit with the period 2 pi."""
    return np.array([1 + eccentricity, 0.0, 0.0, ((1 - eccentricity) / (1 + eccentricity)) ** 0.5])


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize(("every", "periods"), [(1, 1), (13, 1), (120, 1), (120, 3)])
def test_the_fastest_step_is_found_at_every_or_between_saved_points(every, periods, sense):
    """A pericentre in one of 120 steps, by 0.4 of the error of that step against the motion in small steps.

    Every 120th point is an apocentre, and saved points are equal.
    """
    run = ((0, sense * periods * 2 * np.pi), STEP, GAUSS)
    sol = warned(lambda: co.integrate(KEPLER, orbit(0.9), *run, save_every=every))
    quiet(lambda: co.integrate(KEPLER, orbit(0.3), *run, save_every=every))
    states = told(lambda: co.integrate(KEPLER, orbit(0.9), (0, sense * 2 * np.pi), *run[1:]))[0].x
    k = int(np.argmax(np.linalg.norm(np.diff(states, axis=0), axis=1)))
    exact = co.integrate(KEPLER, states[k], (0, sense * STEP), STEP / 256, co.GaussLegendre(4)).x[-1]
    error = np.linalg.norm(states[k + 1] - exact) / np.linalg.norm(exact - states[k])
    assert sol.step_error() == pytest.approx(FASTEST * error, rel=0.35)


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("every", [1, 13])
def test_the_fastest_step_of_a_driven_run_is_repeated_at_its_time(every, sense):
    """A field that turns a spin in a few of 120 steps, away from saved points; the angle is that of a midpoint rule."""
    h, angle = sense * 0.1, 1.5

    def field(t):
        return 0.0, 0.0, angle / 0.1 * np.exp(-(((t - 58.5 * h) / 0.1) ** 2))

    spin, given = co.systems.spin_lattice("chain", 1, field=field), ((0, 120 * h), 0.1, co.GaussLegendre(1))
    sol = warned(lambda: co.integrate(spin, (0.6, 0.0, 0.8), *given, save_every=every))
    # The step turns by 2 atan(angle / 2), the field by its integral.
    turned, exact = 2 * np.arctan(angle / 2), angle * np.pi**0.5 * math.erf(0.5)
    error = np.sin((turned - exact) / 2) / np.sin(exact / 2)
    assert sol.step_error() == pytest.approx(FASTEST * abs(error), rel=0.35)


@pytest.mark.parametrize("every", [1, 120])
@pytest.mark.parametrize("as_batch", [False, True])
def test_the_member_with_the_fastest_passage_is_named(as_batch, every):
    states = np.array([orbit(0.1), orbit(0.3), orbit(0.9), orbit(0.5)])
    system, run = co.batch([kepler() for _ in states]) if as_batch else KEPLER, ((0, 2 * np.pi), STEP, GAUSS)
    sol = warned(lambda: co.integrate(system, states, *run, save_every=every), "the motion of member 2")
    alone = warned(lambda: co.integrate(KEPLER, states[2], *run, save_every=every))
    assert alone.step_error() == sol.step_error()
    quiet(lambda: co.integrate(KEPLER, states[[0, 1, 3]], *run, save_every=every))


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("every", [1, 60, 400])
def test_members_that_an_event_has_ended_are_judged_as_single_runs(every, sense):
    """The pericentre, after the end, does not count; a member that still moves towards its own does."""
    halfway, outside = (
        co.Event(lambda x, t, r=r: x[0] ** 2 + x[1] ** 2 - r, terminal=True)
        for r in (1.5, 3.7)  # only the orbit of the eccentricity 0.95 goes as far as 3.7
    )
    run, options = ((0, sense * 2 * np.pi), 2 * np.pi / 400, GAUSS), {"save_every": every, "events": halfway}
    alone = quiet(lambda: co.integrate(KEPLER, orbit(0.95), *run, **options))
    sol = quiet(lambda: co.integrate(KEPLER, [orbit(0.95), orbit(0.92)], *run, **options))
    assert sense * alone.t[-1] < np.pi and max(sol.step_error(), alone.step_error()) < 1e-4
    states, options["events"] = [orbit(0.95), orbit(0.9)], outside
    warned(lambda: co.integrate(KEPLER, states, run[0], STEP, GAUSS, **options), "the motion of member 1")


def test_steps_with_forces_of_the_time_are_repeated_at_their_times():
    def pushing(t):
        return np.array([0.0, 0.0, 30.0 * np.sin(20.0 * t) if t > 1.5 else 0.0])

    pushed = co.systems.rigid_body(inertia=(1, 2, 2.5)).with_forces(co.forces.Torque(pushing))
    x0, given = np.array([1.0, 0.2, 0.5]), ((1.0, 11.0), 0.2, co.Splitting(order=2))
    alone, in_batch = (
        warned(lambda system=system, x=x, of=of: co.integrate(system, x, *given), of)
        for system, x, of in ((pushed, x0, "this motion"), (co.batch([pushed]), x0[None], "the motion of member 0"))
    )
    assert alone.step_error() == in_batch.step_error() > 0.02


@pytest.mark.parametrize("forward", long_beyond(1, [True, False]))
@pytest.mark.parametrize(("rate", "h"), long_beyond(1, [(1e-4, 0.25), (1e-3, 0.5), (1e-7, 0.1)]))
def test_a_slow_ramp_of_a_controlled_attitude_is_not_warned_of(rate, h, forward):
    """On the ramp the momentum is at rest, and all that it changes is error; its start is over in a few steps."""

    def ramp(t):
        c, s = np.cos(rate * t), np.sin(rate * t)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    law = co.forces.Pointing(0.5, 2.4, ramp, rate=(0, 0, rate) if forward else (0, 0, 0))
    body = co.systems.body((4.0, 5.5, 7.2)).with_forces(law)
    ends = [
        quiet(lambda k=k: co.integrate(body, body.state(angular_velocity=(0, 0, rate)), (0, 200), h / k)).x[-1]
        for k in (1, 4)
    ]
    assert np.abs(ends[0] - ends[1])[3:].max() < 1e-4 * 200 * rate  # of the angle that it turns by


@pytest.mark.parametrize(("h", "warns"), [(0.1, True), (0.05, False)])
def test_a_law_that_is_known_in_the_run_alone_is_judged_in_it(h, warns):
    last = 150.0 + 1e-9

    def growing(t):
        return np.array([0.003 * t, 0.0, 0.01 * t]) if t <= last else np.full(3, np.nan)

    system = co.systems.rigid_body((1.0, 2.0, 3.0)).with_forces(co.forces.Torque(growing))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        co.integrate(system, (0.1, 0.2, 1.0), (0.0, 150.0), h, co.Splitting(order=2))
    assert [one.category for one in caught] == [co.LargeStepWarning] * warns
