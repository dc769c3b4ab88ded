"""The error of a step, by two half steps: its size against exact motions, and the warning of too large steps."""

import dataclasses
import math
import pickle
import warnings

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

WARNED, FASTEST = 0.02, 0.4
"""Largest error without a warning, and the weight of the fastest step, as docs/accuracy.md states them."""

BODY, X0 = co.systems.rigid_body(inertia=(1, 2, 3)), np.array([0.3, 1.0, 0.2])
TOP, TOP_X0 = co.systems.heavy_top(), np.array([1.0, 0.0, 2.0, 0.1, 0.0, 1.0])
SEVEN = co.LiePoissonSystem(co.algebras.so(4), co.Quadratic([1.0, 0.5, 0.3, 0.8, 0.2, 0.6]))


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


def test_changes_are_those_of_half_a_step_where_a_whole_one_returns():
    """After a whole turn of a spin the state is the same again, but not after half of it."""
    spin = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([0.0, 0.0, 0.0], linear=[0.0, 0.0, 1.0]))
    sol = co.integrate(spin, (1.0, 0.0, 0.3), (0, 20 * np.pi), 2 * np.pi, co.GaussLegendre(8))
    assert sol.step_error() < 1e-3


def test_at_rest_there_is_none():
    assert co.integrate(BODY, (0.0, 0.0, 2.0), (0, 1), 0.1).step_error() == 0.0
    assert co.integrate(BODY, (0.0, 0.0, 0.0), (0, 1), 0.1).step_error() == 0.0


@pytest.mark.parametrize(("share", "warned"), [(0.98, False), (1.02, True)])
def test_near_equilibria_the_error_of_the_whole_run_counts(share, warned):
    """Aligned spins are at rest, and all that a step changes is error: 2 percent of the state are too much."""
    h, x0 = 0.01, np.tile([1.0, 2.0, 3.0], 16)
    lattice = co.systems.spin_lattice("square", (4, 4), periodic=True)
    method = co.Splitting(order=2)
    whole, halves = (co.integrate(lattice, x0, (0, h), h / k, method, save_every=k).x[-1] for k in (1, 2))
    error = 4 / 3 * np.linalg.norm(whole - halves) / np.linalg.norm(x0)
    steps = int(share * 0.02 / error)
    assert steps > 100
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always", co.LargeStepWarning)
        sol = co.integrate(lattice, x0, (1, 1 + steps * h), h, method, save_every=steps)
    assert sol.step_error() > 0.9
    assert len(found) == warned
    if warned:
        assert "take a step of about 0.003" in str(found[0].message)  # an error of a tenth


@pytest.mark.parametrize(("amplitude", "warned"), [(0.0, False), (1e-9, False), (1e-4, True)])
def test_small_motions_near_equilibria_are_judged_as_others(amplitude, warned):
    """Waves of spins are lost in the error of a step, however short the run; at rest there is no motion to lose."""
    lattice, h = co.systems.spin_lattice("square", (4, 4), periodic=True), 0.02
    x0 = np.tile([1.0, 2.0, 3.0], 16) + amplitude * np.random.default_rng(1).standard_normal(48)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always", co.LargeStepWarning)
        sol = co.integrate(lattice, x0, (0, 5 * h), h, co.Splitting(order=2))
    assert sol.step_error() > 0.1
    assert len(found) == warned


def test_rounding_does_not_count():
    """Near an equilibrium the change in a step is no larger than rounding."""
    assert co.integrate(BODY, (1e-15, 0.0, 2.0), (0, 1), 0.01).step_error() == 0.0


@pytest.mark.parametrize("as_batch", [False, True])
def test_the_worst_member_counts(as_batch):
    if as_batch:
        bodies = [co.systems.rigid_body(inertia=(1.0, 2.0, third)) for third in (1.2, 2.0, 2.9)]
        errors = [co.integrate(body, X0, (3, 11), 0.1).step_error() for body in bodies]
        assert co.integrate(co.batch(bodies), X0, (3, 11), 0.1).step_error() == max(errors)
        return
    states = np.array([X0, 3 * X0, 0.5 * X0])
    runs = [co.integrate(BODY, x, (0, 8), 0.1) for x in states]
    assert co.integrate(BODY, states, (0, 8), 0.1).step_error() == max(run.step_error() for run in runs)
    assert runs[1].step_error() > 2 * runs[0].step_error()


def test_of_driven_systems_at_the_times_of_the_points():
    """A field that is switched on after the first tenth of the run."""

    def field(t):
        return 0.0, 0.0, 40.0 / (1.0 + np.exp(-50.0 * (t - 4.0)))

    spin = co.systems.spin_lattice("chain", 1, field=field)
    early = co.integrate(spin, (0.6, 0.0, 0.8), (0, 2), 0.1, co.GaussLegendre(1))
    late = co.integrate(spin, (0.6, 0.0, 0.8), (0, 10), 0.1, co.GaussLegendre(1))
    assert early.step_error() < 1e-3 < 0.1 < late.step_error()


@pytest.mark.parametrize("x0", [(1e-3, 1.0, 1e-3), [(1.0, 0.2, 0.5), (1e-3, 1.0, 1e-3)]], ids=["one", "members"])
def test_of_a_file_is_that_of_the_run(x0, tmp_path):
    """The motion starts slowly, so that the start alone would give another error."""
    sol = co.integrate(BODY, x0, (5, -35), 0.8, co.Splitting(order=2))
    sol.to_xarray().to_netcdf(tmp_path / "run.nc")
    assert co.load(tmp_path / "run.nc").step_error() == sol.step_error()


def test_of_matrices_forces_archives_and_read_runs(tmp_path):
    fluid = co.systems.sphere_euler(N=5)
    W = fluid.matrices(np.random.default_rng(1).normal(size=fluid.dim))
    coarse, fine = (co.integrate(fluid, W, (0, 2), h).step_error() for h in (0.1, 0.05))
    assert 3.0 < coarse / fine < 5.0  # order two, relative to a change of order one
    damped = BODY.with_forces(co.forces.LinearDamping(0.1))
    coarse, fine = (co.integrate(damped, X0, (0, 2), h).step_error() for h in (0.1, 0.05))
    assert 3.0 < coarse / fine < 5.0
    # Of archives only the start is measured.
    stored = co.integrate(BODY, X0, (0, 20), 0.1, archive=tmp_path / "run.zarr")
    assert stored.step_error() == pytest.approx(error_of_step(BODY, [X0], co.Splitting(), 0.1), rel=0.15)


@pytest.mark.parametrize("system, x0", [(BODY, X0), (TOP, TOP_X0), (SEVEN, np.arange(1.0, 7.0) / 4)])
def test_the_warning_comes_just_above_the_threshold_and_not_below(system, x0):
    """The step is bisected until the errors of two neighbouring ones lie on both sides."""
    low, high = 1e-3, 4.0
    for _ in range(40):
        middle = (low * high) ** 0.5
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", co.LargeStepWarning)
            error = co.integrate(system, x0, (0, 20 * middle), middle).step_error()
        low, high = (middle, high) if error <= WARNED else (low, middle)
    assert high < 1.01 * low
    with warnings.catch_warnings():
        warnings.simplefilter("error", co.LargeStepWarning)
        co.integrate(system, x0, (0, 20 * low), low)
    with pytest.warns(co.LargeStepWarning, match="too large.*take a step of about") as caught:
        co.integrate(system, x0, (0, 20 * high), high)
    assert len(caught) == 1 and caught[0].filename == __file__


@pytest.mark.parametrize("method", [co.Splitting(), co.Taylor(order=4), co.GaussLegendre(1)])
def test_the_step_suggested_follows_the_motion(method):
    with pytest.warns(co.LargeStepWarning) as caught:
        co.integrate(TOP, TOP_X0, (0, 24), 0.75, method)
    step = float(str(caught[0].message).rpartition(" ")[2])
    steps = round(24 / step)
    assert 1e-4 < co.integrate(TOP, TOP_X0, (0, 24), 24 / steps, method).step_error() < WARNED / 2


def test_long_runs_at_small_steps_do_not_warn():
    """The error of a long run may be large, by its phase, where each step is small."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", co.LargeStepWarning)
        sol = co.integrate(TOP, TOP_X0, (0, 400), 0.04, save_every=100)
    assert sol.step_error() < 1e-3


def test_own_steps_and_accuracy_need_no_test():
    taylor = co.Taylor(tolerance=1e-6)
    with warnings.catch_warnings():
        warnings.simplefilter("error", co.LargeStepWarning)
        sol = co.integrate(TOP, TOP_X0, (0, 10), 10.0, taylor)
        co.integrate(TOP, TOP_X0, (0, 10), accuracy=1e-3)
    with refused(TypeError, "steps"):
        sol.step_error()


@pytest.mark.parametrize(
    "options", [{}, {"attitude": True}, {"inputs": {"field": (0, 1, 2)}}], ids=["plain", "attitude", "inputs"]
)
def test_the_first_run_of_a_prepared_one_warns(options):
    """Copies and later runs do not."""
    prepared = co.prepare(BODY, co.Splitting(), 2.0, **options)
    twin = pickle.loads(pickle.dumps(prepared))
    with pytest.warns(co.LargeStepWarning, match="the step 2 is too large for this motion") as caught:
        sol = prepared.run(X0, (0, 20))
    assert len(caught) == 1 and caught[0].filename == __file__
    assert sol.step_error() == pytest.approx(twin.run(X0, (0, 20)).step_error())
    with warnings.catch_warnings():
        warnings.simplefilter("error", co.LargeStepWarning)
        again = prepared.run(X0, (0, 20))
        twin.run(X0, (0, 20))
        co.prepare(BODY, co.Splitting(), 0.1, **options).run(X0, (0, 20))
        co.prepare(BODY, accuracy=1e-6, x0=X0, t_span=(0, 20)).run(X0, (0, 20))
    np.testing.assert_array_equal(again.x, sol.x)


def test_a_failed_run_leaves_the_warning_to_the_next():
    """The setup of the failed run is cached, but no step was compared."""
    prepared = co.prepare(BODY, co.GaussLegendre(1), 2.0)
    with pytest.raises(co.IntegrationError, match="a number overflowed"):
        prepared.run(1e300 * X0, (0, 20))
    with pytest.warns(co.LargeStepWarning, match="the step 2 is too large for this motion") as caught:
        prepared.run(X0, (0, 20))
    assert len(caught) == 1 and caught[0].filename == __file__


def test_warnings_of_ensembles_name_a_member():
    states = np.array([X0, 0.1 * X0, 10 * X0])
    with pytest.warns(co.LargeStepWarning, match="too large for the motion of member 2: "):
        co.integrate(BODY, states, (0, 4), 0.4)


def test_ensembles_in_blocks_warn_once(tmp_path):
    states = np.tile(0.1 * X0, (9, 1))
    states[7] = 10 * X0
    options = {"archive": tmp_path / "many.zarr", "members_per_block": 2}
    with pytest.warns(co.LargeStepWarning, match="too large for the motion of member 7: ") as caught:
        many = co.integrate_ensemble(BODY, states, (0, 4), 0.4, **options)
    assert len([one for one in caught if one.category is co.LargeStepWarning]) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error", co.LargeStepWarning)
        again = co.integrate_ensemble(BODY, states, (0, 4), 0.4, **options)
        co.integrate_ensemble(BODY, states[:7], (0, 4), 0.4)
    np.testing.assert_array_equal(again.x, many.x)
    with warnings.catch_warnings(), pytest.raises(co.LargeStepWarning):
        warnings.simplefilter("error", co.LargeStepWarning)
        co.integrate_ensemble(BODY, states, (0, 4), 0.4, archive=tmp_path / "refused.zarr")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", co.LargeStepWarning)
        np.testing.assert_array_equal(co.resume(tmp_path / "refused.zarr").x, many.x)


def kepler():
    J = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])

    def energy(x):
        return 0.5 * (x[2] ** 2 + x[3] ** 2) - (x[0] ** 2 + x[1] ** 2) ** -0.5

    return co.PoissonSystem(lambda x: J, co.Hamiltonian(energy), dim=4, name="kepler")


def orbit(eccentricity):
    """The state at the apocentre of an orbit with the period 2 pi."""
    return np.array([1 + eccentricity, 0.0, 0.0, ((1 - eccentricity) / (1 + eccentricity)) ** 0.5])


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("every", [1, 13])
def test_the_fastest_step_is_found_at_every_or_between_saved_points(every, sense):
    """A pericentre in one of 120 steps, by 0.4 of the error of that step against the motion in small steps."""
    system, x0, count = kepler(), orbit(0.9), 120
    span, step, method = (0, sense * 2 * np.pi), 2 * np.pi / count, co.GaussLegendre(2)
    with pytest.warns(co.LargeStepWarning, match="too large for this motion"):
        sol = co.integrate(system, x0, span, step, method, save_every=every)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", co.LargeStepWarning)
        states = co.integrate(system, x0, span, step, method).x
    k = int(np.argmax(np.linalg.norm(np.diff(states, axis=0), axis=1)))
    exact = co.integrate(system, states[k], (0, sense * step), step / 256, co.GaussLegendre(4)).x[-1]
    error = np.linalg.norm(states[k + 1] - exact) / np.linalg.norm(exact - states[k])
    assert sol.step_error() == pytest.approx(FASTEST * error, rel=0.35)
    ends = [co.integrate(system, orbit(0.9), (0, 2 * np.pi), 2 * np.pi / n, method).x[-1] for n in (count, 6400)]
    assert np.linalg.norm(ends[0] - ends[1]) > 0.1


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("every", [1, 13])
def test_the_fastest_step_of_a_driven_run_is_repeated_at_its_time(every, sense):
    """A field that turns a spin in a few of 120 steps, away from saved points; the angle is that of a midpoint rule."""
    h, angle = sense * 0.1, 1.5

    def field(t):
        return 0.0, 0.0, angle / 0.1 * np.exp(-(((t - 58.5 * h) / 0.1) ** 2))

    spin = co.systems.spin_lattice("chain", 1, field=field)
    with pytest.warns(co.LargeStepWarning, match="too large for this motion"):
        sol = co.integrate(spin, (0.6, 0.0, 0.8), (0, 120 * h), 0.1, co.GaussLegendre(1), save_every=every)
    # The step turns by 2 atan(angle / 2), the field by its integral.
    turned, exact = 2 * np.arctan(angle / 2), angle * np.pi**0.5 * math.erf(0.5)
    error = np.sin((turned - exact) / 2) / np.sin(exact / 2)
    assert sol.step_error() == pytest.approx(FASTEST * abs(error), rel=0.35)


@pytest.mark.parametrize("periods", [1, 3])
@pytest.mark.parametrize("sense", [1, -1])
def test_passages_between_equal_saved_points_are_found(periods, sense):
    """Saved once a period, at the apocentre, states do not show the pericentre; nor do the two ends of one period."""
    run, count = ((0, sense * periods * 2 * np.pi), 2 * np.pi / 120, co.GaussLegendre(2)), 120
    with pytest.warns(co.LargeStepWarning, match="too large for this motion"):
        sol = co.integrate(kepler(), orbit(0.9), *run, save_every=count)
    with pytest.warns(co.LargeStepWarning):
        every = co.integrate(kepler(), orbit(0.9), (0, sense * 2 * np.pi), *run[1:])
    assert len(sol.t) == 1 + periods
    assert sol.step_error() == pytest.approx(every.step_error(), rel=1e-9 if periods == 1 else 0.3)
    with warnings.catch_warnings():
        warnings.simplefilter("error", co.LargeStepWarning)
        co.integrate(kepler(), orbit(0.3), *run, save_every=count)


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("every", [1, 60, 400])
def test_members_that_an_event_has_ended_are_judged_as_single_runs(every, sense):
    """The pericentre, after the end, does not count; a member that still moves towards its own does."""
    system, halfway = kepler(), co.Event(lambda x, t: x[0] ** 2 + x[1] ** 2 - 1.5, terminal=True)
    run = (0, sense * 2 * np.pi), 2 * np.pi / 400, co.GaussLegendre(2)
    with warnings.catch_warnings():
        warnings.simplefilter("error", co.LargeStepWarning)
        alone = co.integrate(system, orbit(0.95), *run, save_every=every, events=halfway)
        sol = co.integrate(system, [orbit(0.95), orbit(0.92)], *run, save_every=every, events=halfway)
    assert sense * alone.t[-1] < np.pi
    assert max(sol.step_error(), alone.step_error()) < 1e-4
    states = [orbit(0.95), orbit(0.9)]
    outside = co.Event(lambda x, t: x[0] ** 2 + x[1] ** 2 - 3.7, terminal=True)  # only the first goes so far
    with pytest.warns(co.LargeStepWarning, match="too large for the motion of member 1: "):
        co.integrate(system, states, run[0], 2 * np.pi / 120, run[2], save_every=every, events=outside)


def test_ended_members_of_a_driven_ensemble_take_no_later_steps():
    """A field that grows strong long after the members have been ended."""

    def field(t):
        return 0.0, 0.0, 1.0 + 40.0 / (1.0 + np.exp(-50.0 * (t - 4.0)))

    spin, end = co.systems.spin_lattice("chain", 1, field=field), co.Event("S1[1]", terminal=True)
    run = (0, 10), 0.1, co.GaussLegendre(1)
    with warnings.catch_warnings():
        warnings.simplefilter("error", co.LargeStepWarning)
        sol = co.integrate(spin, [(0.6, 0.0, 0.8), (0.0, -0.6, 0.8)], *run, events=end)
    assert np.nanmax(sol.events.ends(2)) < 3.5 and sol.step_error() < 1e-3


@pytest.mark.parametrize("as_batch", [False, True])
def test_the_member_with_the_fastest_passage_is_named(as_batch):
    states = np.array([orbit(0.1), orbit(0.3), orbit(0.9), orbit(0.5)])
    system = co.batch([kepler() for _ in states]) if as_batch else kepler()
    run = (0, 2 * np.pi), 2 * np.pi / 120, co.GaussLegendre(2)
    with pytest.warns(co.LargeStepWarning, match="too large for the motion of member 2: "):
        sol = co.integrate(system, states, *run)
    with pytest.warns(co.LargeStepWarning, match="too large for this motion: "):
        assert co.integrate(kepler(), states[2], *run).step_error() == sol.step_error()
    with warnings.catch_warnings():
        warnings.simplefilter("error", co.LargeStepWarning)
        co.integrate(kepler(), states[[0, 1, 3]], *run)


def test_errors_of_half_steps_do_not_end_runs():
    """A scheme of the user that refuses other steps than one; `step_error` raises what it raises."""

    @dataclasses.dataclass(frozen=True)
    class OneStep(co.methods.StepMethod):
        order, explicit, symmetric, compiles = 1, True, False, False

        def properties(self, system):
            return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")

        def step(self, system, x, t, h):
            if h != 0.25:
                raise LookupError("no table for this step")
            return x + h * system.vector_field(x, t)

    for sol in (co.integrate(BODY, X0, (0, 1), 0.25, OneStep()), co.prepare(BODY, OneStep(), 0.25).run(X0, (0, 1))):
        assert sol.x.shape == (5, 3)
        with pytest.raises(LookupError, match="no table for this step"):
            sol.step_error()


def test_steps_with_forces_of_the_time_are_repeated_at_their_times():
    def pushing(t):
        return np.array([0.0, 0.0, 30.0 * np.sin(20.0 * t) if t > 1.5 else 0.0])

    pushed = co.systems.rigid_body(inertia=(1, 2, 2.5)).with_forces(co.forces.Torque(pushing))
    x0, span = np.array([1.0, 0.2, 0.5]), (1.0, 11.0)
    with pytest.warns(co.LargeStepWarning):
        alone = co.integrate(pushed, x0, span, 0.2, co.Splitting(order=2))
    with pytest.warns(co.LargeStepWarning):
        in_batch = co.integrate(co.batch([pushed]), x0[None], span, 0.2, co.Splitting(order=2))
    assert alone.step_error() == in_batch.step_error() > 0.02


def test_the_first_run_with_inputs_is_judged_with_their_values():
    body, x0 = co.systems.rigid_body(inertia=(1, 2, 2.5)), np.array([1.0, 0.2, 0.5])
    slow, fast = (0.0, 0.0, 0.0), (1.0, -2.0, 3.0)
    errors: dict[tuple[float, ...], set[float]] = {slow: set(), fast: set()}
    for order in ((slow, fast), (fast, slow)):
        ready = co.prepare(body, co.GaussLegendre(1), 0.3, inputs={"rotor": (0, 1, 2)})
        for values in order:
            with warnings.catch_warnings(record=True) as found:
                warnings.simplefilter("always", co.LargeStepWarning)
                errors[values].add(ready.run(x0, (0, 6), rotor=values).step_error())
            assert len(found) == (values == order[0] == fast)
    assert len(errors[slow]) == len(errors[fast]) == 1 and max(errors[fast]) > 0.05 > 10 * max(errors[slow])
