"""Attitudes of runs whose Hamiltonian is shifted by a Casimir."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

pytestmark = pytest.mark.thinned(3)


SHIFTED = {
    "so(3)": co.systems.rigid_body((1.0, 2.0, 3.0)),
    "so(4)": co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(np.linspace(0.5, 2, 6)), sign=-1),
    "so(5)": co.LiePoissonSystem(co.algebras.so(5), co.Quadratic(np.linspace(0.5, 2, 10))),
    "su(3)": co.LiePoissonSystem(co.algebras.su(3), co.Quadratic(np.linspace(0.5, 2, 8)), sign=-1),
    "sl(2)": co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic((0.5, 1.0, 0.3))),
    "e(3)": co.LiePoissonSystem(co.algebras.e(3), co.Quadratic((1, 0.5, 0.3, 0.2, 0.4, 0.9)), sign=-1),
    "A4,10": co.LiePoissonSystem(co.algebras.get("A4,10"), co.Quadratic((1.0, 0.5, 0.3, 0.4))),
    "three so(3)": co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), 3), co.Quadratic(np.linspace(0.5, 2, 9))),
}


def same_bits(one, other):
    """Compare bits, also the signs of zeros."""
    return one.shape == other.shape and one.tobytes() == other.tobytes()


def initial_elements(system, attitude, members=None):
    """Return group elements as a user might give them: rounded, with zeros of both signs, in Fortran order."""
    if attitude == "coadjoint":
        return "coadjoint", np.eye(system.dim)
    # The first generator moves few axes: the other entries are zeros, of which some are made negative.
    turns = [0.7] if members is None else np.linspace(0.3, 0.9, members)
    g = np.stack([expm(turn * system.representation[0]) for turn in turns])
    g[:, 0][g[:, 0] == 0.0] = -0.0
    g = g[0] if members is None else g
    return np.asfortranarray(g), g


@pytest.mark.parametrize("name", list(SHIFTED))
def test_elements_do_not_depend_on_saving_or_start_time(name):
    system = SHIFTED[name]
    attitude = initial_elements(system, "coadjoint" if system.representation is None else "representation")[0]
    x0 = 0.3 * np.random.default_rng(2).standard_normal((3, system.dim))

    def run(x, start, end, every):
        return co.integrate(system, x, (start, end), 0.1, attitude=attitude, save_every=every).attitude

    every = run(x0, 0.0, 3.0, 1)
    assert same_bits(run(x0, 0.0, 1.3, 5), every[[0, 5, 10, 13]])
    assert same_bits(run(x0[1], 1e6, 1e6 + 3.0, 7), every[[0, 7, 14, 21, 28, 30], 1])
    rebuilt = co.integrate(system, x0, (5.0, 2.0), 0.1, attitude=attitude, save_every=3)
    assert same_bits(co.results.rebuild(rebuilt.to_xarray()).attitude, rebuilt.attitude)
    assert same_bits(co.stepper(system, co.Splitting(), 0.1).group(x0[0], 7.0, attitude), every[1, 0])


@pytest.mark.parametrize("x0", [np.zeros(6), [0, 0, 0, 0, 0, 1.0], [1.0, 0, 0, 0, 0, 0]], ids=str)
def test_attitude_where_the_casimir_gradient_vanishes(x0):
    system = SHIFTED["so(4)"]
    sol = co.integrate(system, x0, (0, 4), 0.1, co.Splitting(order=4), attitude=True, save_every=10)
    plain = co.Splitting(order=4, parts="coordinates")
    other = co.integrate(system, x0, (0, 4), 0.1, plain, attitude=True, save_every=10)
    # A momentum along an axis stays, and turns by one frequency: every splitting is exact.
    assert np.abs(sol.attitude - other.attitude).max() <= 40 * 64 * U


@pytest.mark.parametrize("name", ["so(3)", "so(4)", "so(5)", "su(3)"])
def test_rotations_stay_orthogonal_over_long_times(name):
    """Three steps at a time of 3e9: the shift turns by 1e9 and the loop by three steps."""
    system, h = SHIFTED[name], 2.0**30
    x0 = np.random.default_rng(3).standard_normal(system.dim)
    g = co.integrate(system, x0, (0, 3 * h), h, attitude=True).attitude[-1]
    assert np.abs(g.T @ g - np.eye(len(g))).max() <= 3 * 20 * 8 * len(g) * U


@pytest.mark.parametrize(("sense", "end"), [(1.0, 1000), (-1.0, 1000), (1.0, -1000), (-1.0, -1000)])
@pytest.mark.parametrize("factors", [(1.0,), (1.0, 1e-6), (1e-6, 1.0)], ids=str)
def test_overflowing_attitude_is_an_error(factors, sense, end):
    """The momentum stays bounded; the group element is a boost that grows until it overflows."""
    g = co.algebras.get("so(2,1)")
    # The Casimir is x1^2 - x2^2 - x3^2.
    M = sense * (np.diag([1.0, -1.0, -1.0]) + np.diag([1e-3, 0.0, 0.0]))
    systems = [co.LiePoissonSystem(g, co.Quadratic(f * M)) for f in factors]
    system, x0 = (co.batch(systems) if len(factors) > 1 else systems[0]), np.array([0.1, 1.0, 0.2])
    near = co.integrate(system, x0, (0, end / 100), 0.1, attitude=True, save_every=10)
    assert np.isfinite(near.attitude).all()
    with refused(co.IntegrationError, "attitude at t = ", "shorter span") as raised:
        co.integrate(system, x0, (0, end), 0.1, attitude=True, save_every=10)
    partial = raised.value.partial
    sound = np.isfinite(partial.attitude).reshape(len(partial.t), -1).all(axis=1)
    assert np.isfinite(partial.x).all() and sound[:11].all() and not sound[-1]
    assert raised.value.time == partial.t[np.argmin(sound)]


def motion_of(system, x0, g0, kind, end):
    """Return the state and group element at times since the start, from x' = f(x), g' = -sign g rho(grad H(x))."""
    n, d = system.dim, len(g0)

    def field(t, y):
        x, g = y[:n], y[n:].reshape(d, d)
        slope = system.hamiltonian.gradient(x)
        A = system.algebra.coadjoint(slope) if kind == "coadjoint" else np.tensordot(slope, system.representation, 1)
        return np.append(system.vector_field(x), -system.sign * (g @ A))

    start = np.append(x0, g0)
    found = solve_ivp(field, (0.0, end), start, method="DOP853", rtol=1e-11, atol=1e-12, dense_output=True).sol
    return lambda t: (found(t)[:n], found(t)[n:].reshape(d, d))


def plane_event(motion, elapsed, **options):
    """Return an event at the time when a motion crosses the plane normal to it."""
    x, later = motion(elapsed)[0], motion(1.01 * elapsed)[0]
    w = (later - x) / np.linalg.norm(later - x)
    return co.Event(co.Quadratic(0.0, linear=w, constant=-float(w @ x)), **options)


# Over a time of 1, with frequencies of at most 1, the error of a scheme of order 4 is below h^4.
EVENT_STEP = 1 / 32
EVENT_ERROR = EVENT_STEP**4


@pytest.mark.thinned(9)
@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("t0", [0.0, 3.0, -40.0])
@pytest.mark.parametrize("name", list(SHIFTED))
def test_attitude_at_events_solves_its_equation(name, t0, way):
    system, method = SHIFTED[name], co.Splitting(order=4)
    kind = "coadjoint" if system.representation is None else "representation"
    x0 = 0.3 * np.random.default_rng(5).standard_normal((3, system.dim))
    attitude, starts = initial_elements(system, kind, 3)
    starts = np.broadcast_to(starts, (3, *starts.shape[-2:]))
    motions = [motion_of(system, x, g, kind, way) for x, g in zip(x0, starts, strict=True)]
    events = [plane_event(motion, way * part) for motion, part in zip(motions, (0.3, 0.9, 0.6), strict=True)]
    span = (t0, t0 + way)
    found = co.integrate(system, x0, span, EVENT_STEP, method, attitude=attitude, events=events).events
    assert {(m, m) for m in range(3)} <= set(zip(found.member.tolist(), found.which.tolist(), strict=True))
    for row, (member, t) in enumerate(zip(found.member, found.t, strict=True)):
        x, g = motions[member](t - t0)
        assert np.abs(found.x[row] - x).max() < EVENT_ERROR and np.abs(found.attitude[row] - g).max() < EVENT_ERROR
    last = plane_event(motions[1], way * 0.9, terminal=True)
    single = attitude if kind == "coadjoint" else attitude[1]
    ended = co.integrate(system, x0[1], span, EVENT_STEP, method, attitude=single, events=last)
    assert np.abs(ended.attitude[-1] - motions[1](ended.t[-1] - t0)[1]).max() < EVENT_ERROR


@pytest.mark.thinned(1)
@pytest.mark.parametrize("t0, way", [(3.0, 1.0), (-40.0, -1.0)])
def test_attitude_at_an_end_after_chosen_times(t0, way):
    """With `t_eval` the point at which an event ends the run is appended."""
    system, method = SHIFTED["so(3)"], co.Splitting(order=4)
    x0 = 0.6 * np.random.default_rng(5).standard_normal(3)
    motion = motion_of(system, x0, np.eye(3), "representation", way)
    last = plane_event(motion, way * 0.7, terminal=True)
    times = t0 + way * np.array([0.0, 0.11, 0.5, 0.9])
    sol = co.integrate(system, x0, (t0, t0 + way), EVENT_STEP, method, attitude=True, events=last, t_eval=times)
    assert len(sol.t) == 4 and abs(sol.t[-1] - (t0 + way * 0.7)) < 10 * EVENT_ERROR
    for t, x, g in zip(sol.t, sol.x, sol.attitude, strict=True):
        wanted = motion(t - t0)
        assert np.abs(x - wanted[0]).max() < EVENT_ERROR and np.abs(g - wanted[1]).max() < EVENT_ERROR
