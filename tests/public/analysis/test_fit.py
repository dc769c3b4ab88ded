"""Fits of parameters and initial values, against Euler's equations by SciPy and the scatter of noisy fits."""

import itertools
import re
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import coadjoint as co
from drawn_matrices import full
from long import long_beyond
from refusals import refused

INERTIA, X0 = np.array([1.0, 2.0, 2.5]), np.array([1.0, 0.2, 0.5])
A0 = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
SPAN, EVERY, SIGMA = (1.0, 21.0), 10, 0.01
UNKNOWN = {"inertia": (0, 2), "x0": True, "attitude0": True}
SCHEME = co.Splitting(order=4)


def body(inertia=INERTIA):
    return co.prepare(co.systems.rigid_body(inertia=inertia), SCHEME, step=0.05, attitude=True)


def by_euler(z, t):
    """Attitudes of a free body with changed inertia, momentum and initial attitude, by SciPy."""
    moments = INERTIA + np.array([z[0], 0.0, z[1]])
    start = Rotation.from_rotvec(z[5:]).as_matrix() @ A0

    def field(t, y):
        velocity = y[:3] / moments
        hat = np.cross(velocity, np.eye(3)).T  # hat @ v = velocity x v
        return np.concatenate([np.cross(y[:3], velocity), (y[3:].reshape(3, 3) @ hat).ravel()])

    y0 = np.concatenate([X0 + z[2:5], start.ravel()])
    end = solve_ivp(field, (t[0], t[-1]), y0, method="DOP853", t_eval=t, rtol=1e-11, atol=1e-12)
    return end.y[3:].T


def fitted(measured, **options):
    ready = body(INERTIA * [1.1, 1.0, 0.95])
    return co.fit(ready, X0 * 1.05, SPAN, measured, UNKNOWN, EVERY, sigma={"attitude": SIGMA}, attitude=A0, **options)


@pytest.fixture(scope="module")
def exact():
    return body().run(X0, SPAN, EVERY, attitude=A0)


def test_measurements_without_noise(exact):
    """Round-off of a sum of 369 squares of 1e-14 / sigma; the covariance is that of the true Jacobian."""
    found = fitted({"attitude": exact.attitude})
    np.testing.assert_allclose(found.values["inertia"], INERTIA, rtol=1e-10)
    np.testing.assert_allclose(found.values["x0"], X0, rtol=1e-10)
    np.testing.assert_allclose(found.values["attitude0"], A0, atol=1e-11)
    assert np.abs(found.residuals).max() < 1e-9
    np.testing.assert_array_equal(found.solution.t, exact.t)


def test_covariance_against_differences_of_euler_equations(exact):
    """The scheme has an error of 1e-6, and a central difference one of 1e-11 / 1e-4."""
    found, step = fitted({"attitude": exact.attitude}), 1e-4
    np.testing.assert_allclose(by_euler(np.zeros(8), exact.t), exact.attitude.reshape(-1, 9), atol=1e-5)
    columns = [(by_euler(step * e, exact.t) - by_euler(-step * e, exact.t)).ravel() / (2 * step) for e in np.eye(8)]
    J = np.transpose(columns) / (np.sqrt(2) * SIGMA)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(J.T @ J), rtol=1e-3, atol=1e-8)
    assert [name for name, _ in found.unknowns] == ["inertia"] * 2 + ["x0"] * 3 + ["attitude0"] * 3
    np.testing.assert_array_equal(found.standard_deviation("x0"), np.sqrt(np.diag(found.covariance)[2:5]))


@pytest.mark.parametrize("count", [6, pytest.param(100, marks=pytest.mark.long)])
def test_coverage_of_the_covariance(exact, count):
    """The means of chi-squared variables of 8, and of 3 * 41 - 8 degrees of freedom, within 4 standard deviations."""
    rng, squares, sums, degrees = np.random.default_rng(11), [], [], 3 * len(exact.t) - 8
    for _ in range(count):
        noise = Rotation.from_rotvec(SIGMA * rng.standard_normal((len(exact.t), 3))).as_matrix()
        found = fitted({"attitude": exact.attitude @ noise})
        turned = Rotation.from_matrix(found.values["attitude0"] @ A0.T).as_rotvec()
        error = np.concatenate([(found.values["inertia"] - INERTIA)[[0, 2]], found.values["x0"] - X0, turned])
        squares.append(error @ np.linalg.solve(found.covariance, error))
        sums.append(np.sum(found.residuals**2))
    assert abs(np.mean(squares) - 8) < 4 * np.sqrt(2 * 8 / count)
    assert abs(np.mean(sums) - degrees) < 4 * np.sqrt(2 * degrees / count)


def test_states_of_a_heavy_top():
    """In e(3), with a standard deviation for each coordinate, backward in time."""
    x0, lever = np.array([0.3, 0.2, 1.0, 0.6, 0.0, 0.8]), np.array([0.75, 0.5, 1.0])
    run = co.prepare(co.systems.heavy_top(lever=lever), co.GaussLegendre(2), step=0.05)
    guess = co.prepare(co.systems.heavy_top(lever=lever + 0.05), co.GaussLegendre(2), step=0.05)
    times, deviations = np.linspace(2.0, -1.5, 12), np.array([0.01, 0.02, 0.01, 0.1, 0.1, 0.05])
    span, exact = (2.0, -2.0), run.run(x0, (2.0, -2.0), t_eval=times).x
    unknown = {"lever": True, "x0": (0, 1, 2)}
    found = co.fit(guess, x0 + np.eye(6)[1] / 20, span, {"x": exact}, unknown, t_eval=times, sigma={"x": deviations})
    np.testing.assert_allclose(found.values["lever"], lever, rtol=1e-9)
    np.testing.assert_allclose(found.values["x0"], x0, atol=1e-10)
    np.testing.assert_array_equal(found.solution.t, times)
    np.testing.assert_allclose(found.solution.x, exact, atol=1e-9)


@pytest.mark.parametrize("algebra", [co.algebras.so(4), co.algebras.get("A5,40")], ids=["so(4)", "A5,40"])
def test_residuals_are_measured_minus_fitted_values(algebra):
    """In units of the standard deviations, in the order of the measurements."""
    rng, n = np.random.default_rng(3), algebra.dim
    ready = co.prepare(co.LiePoissonSystem(algebra, co.Quadratic(np.linspace(0.5, 1.0, n))), SCHEME, 0.05)
    x0, deviations = rng.uniform(0.2, 0.6, n), rng.uniform(0.005, 0.02, n)
    exact = ready.run(x0, (0, 2), 4).x
    measured = exact + deviations * rng.standard_normal(exact.shape)
    found = co.fit(ready, x0, (0, 2), {"x": measured}, {"x0": True}, 4, sigma={"x": deviations})
    wanted = ((measured - found.solution.x) / deviations).ravel()
    np.testing.assert_allclose(found.residuals, wanted, rtol=0, atol=1e-10)


def test_several_trajectories_are_those_of_single_runs_together():
    """Two states and two initial attitudes, and the moments that they share."""
    starts, attitudes = np.array([X0, [0.2, -0.9, 0.4]]), np.array([A0, A0.T])
    exact = body().run(starts, SPAN, EVERY, attitude=attitudes)
    measured, sigma = {"attitude": exact.attitude, "x": exact.x}, {"attitude": SIGMA, "x": 0.02}
    unknown = {"inertia": (0, 2), "x0": (0, 1, 2, 4), "attitude0": (0, 2, 3, 4, 5)}
    turned = (
        Rotation.from_rotvec([0.02, 0.0, -0.01]).as_matrix() @ A0,
        Rotation.from_rotvec([0.01, 0.02, 0]).as_matrix() @ A0.T,
    )
    guess = starts + [[0.05, -0.02, 0.01], [0.0, 0.03, 0.0]]
    ready = body(INERTIA * [1.1, 1.0, 0.95])
    found = co.fit(ready, guess, SPAN, measured, unknown, EVERY, sigma=sigma, attitude=np.array(turned))
    np.testing.assert_allclose(found.values["inertia"], INERTIA, rtol=1e-9)
    np.testing.assert_allclose(found.values["x0"], starts, atol=1e-10)
    np.testing.assert_allclose(found.values["attitude0"], attitudes, atol=1e-10)
    np.testing.assert_allclose(found.solution.x, exact.x, atol=1e-9)
    np.testing.assert_allclose(found.solution.attitude, exact.attitude, atol=1e-9)
    deviations = np.zeros(6)
    deviations[[0, 2, 3, 4, 5]] = np.sqrt(np.diag(found.covariance)[6:])
    np.testing.assert_array_equal(found.standard_deviation("attitude0"), deviations.reshape(2, 3))
    # What each run tells of its own unknowns adds up.
    information = np.zeros((11, 11))
    for m, x, axes, columns in ((0, (0, 1, 2), (0, 2), [0, 1, 2, 3, 4, 6, 7]), (1, (1,), True, [0, 1, 5, 8, 9, 10])):
        own = {"inertia": (0, 2), "x0": x, "attitude0": axes}
        alone = {name: values[:, m] for name, values in measured.items()}
        single = co.fit(ready, guess[m], SPAN, alone, own, EVERY, sigma=sigma, attitude=turned[m])
        information[np.ix_(columns, columns)] += np.linalg.inv(single.covariance)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(information), rtol=1e-6, atol=1e-14)


def moved_matrix(M, numbers, by):
    """Return a matrix with these entries and their mirror images moved."""
    moved = M.copy()
    for k, change in zip(numbers, by, strict=True):
        i, j = divmod(k, len(M))
        moved[i, j] += change
        moved[j, i] = moved[i, j]
    return moved


@pytest.mark.parametrize(("algebra", "casimirs"), long_beyond(1, [(co.algebras.so(3), 1), (co.algebras.so(4), 2)]))
def test_symmetric_matrices_are_fitted_by_their_upper_triangles(algebra, casimirs):
    """The known M from exact data, except for one entry for each Casimir, which the message counts."""
    n, rng = algebra.dim, np.random.default_rng(11)
    M, starts = full(n, 3), rng.standard_normal((3, n))

    def ready(M):
        return co.prepare(co.LiePoissonSystem(algebra, co.Quadratic(M)), SCHEME, step=0.05)

    run, sigma = ((0, 4), 4), {"x": 0.01}
    measured = {"x": ready(M).run(starts, *run).x}
    upper = [int(k) for k in np.flatnonzero(np.triu(np.ones((n, n))))]
    with refused(ValueError, "M", f"{casimirs} of {casimirs}", "Casimir") as caught:
        co.fit(ready(M), starts, run[0], measured, {"M": True}, run[1], sigma=sigma)
    omitted = [int(k) for k in re.findall(r"number (\d+)", str(caught.value))]
    assert len(omitted) == casimirs and set(omitted) < set(upper)
    chosen = [k for k in upper if k not in omitted]
    guess = moved_matrix(M, chosen, 0.05 * rng.standard_normal(len(chosen)))
    # Numbers below the diagonal, and both, are the same unknowns.
    mirrors = [n * (k % n) + k // n for k in chosen]
    found, lower = (
        co.fit(ready(guess), starts, run[0], measured, {"M": numbers}, run[1], sigma=sigma)
        for numbers in (chosen, mirrors + chosen[:2])
    )
    np.testing.assert_allclose(found.values["M"], M, atol=1e-9)
    np.testing.assert_array_equal(found.values["M"], found.values["M"].T)
    assert found.unknowns == lower.unknowns == tuple(("M", k) for k in chosen)
    np.testing.assert_array_equal(found.covariance, lower.covariance)
    h = 1e-5
    ends = [[ready(moved_matrix(M, [k], [by])).run(starts, *run).x.ravel() for by in (h, -h)] for k in chosen]
    J = np.array([after - before for after, before in ends]).T / (2 * h * sigma["x"])
    np.testing.assert_allclose(found.covariance, np.linalg.inv(J.T @ J), rtol=1e-4, atol=1e-6 * found.covariance.max())
    deviation = found.standard_deviation("M")
    np.testing.assert_array_equal(deviation.ravel()[chosen], np.sqrt(np.diag(found.covariance)))
    np.testing.assert_array_equal(deviation, deviation.T)
    assert np.count_nonzero(np.triu(deviation)) == len(chosen)
    with refused(ValueError, "x0 was not fitted", "M"):
        found.standard_deviation("x0")


@pytest.mark.parametrize(
    ("name", "unknown", "words"),
    [
        ("angular_velocity", {"inertia": True, "x0": True}, "inertia and x0; omit"),  # a common scale
        ("angular_momentum", {"inertia": True}, "inertia (in 1 of 1 free directions H changes by a Casimir"),
    ],
)
def test_what_rates_and_momenta_leave_free_is_refused(name, unknown, words):
    """Also where the Jacobian has central differences, with errors above the round-off."""
    ready = co.prepare(co.systems.rigid_body(INERTIA), SCHEME, 0.05)
    measured = getattr(ready.run(X0, SPAN, EVERY), name)
    with refused(ValueError, words):
        co.fit(ready, X0, SPAN, {name: measured}, unknown, EVERY, sigma={name: SIGMA})


def test_rates_determine_a_small_moment_beside_large_ones():
    """Differences by a moment of a thousandth are taken in units of itself: the fit ends at the exact values."""
    inertia, x0 = np.array([0.01, 100.0, 100.005]), np.array([0.003, 20.0, 10.0])
    measured = co.prepare(co.systems.rigid_body(inertia), SCHEME, 0.05).run(x0, SPAN, EVERY).angular_velocity
    ready = co.prepare(co.systems.rigid_body(inertia * (1.02, 1.0, 1.0)), SCHEME, 0.05)
    unknown, name = {"inertia": (0,)}, "angular_velocity"
    found = co.fit(ready, x0, SPAN, {name: measured}, unknown, EVERY, sigma={name: 1e-4})
    step = 2.0**-10 * inertia[0]
    of_moment = [
        co.prepare(co.systems.rigid_body(inertia + [side * step, 0, 0]), SCHEME, 0.05).run(x0, SPAN, EVERY)
        for side in (1.0, -1.0)
    ]
    column = (of_moment[0].angular_velocity - of_moment[1].angular_velocity) / (2.0 * step * 1e-4)
    # The deviation is 1 / |column|; second differences of the comparison are below (2^-10)^2 times a few.
    assert found.standard_deviation("inertia")[0] == pytest.approx(1.0 / np.linalg.norm(column), rel=1e-4)
    np.testing.assert_allclose(found.values["inertia"], inertia, rtol=1e-9)


@pytest.mark.parametrize("entries", [False, None, (True, False, True), np.array([True, False, True])])
def test_unknown_entries_are_numbers_and_no_mask(entries):
    with refused(TypeError, "unknown of inertia", "True for all", "numbers of some", "leave out"):
        co.fit(body(), X0, (0.0, 1.0), {"x": np.zeros((11, 3))}, {"inertia": entries}, sigma={"x": SIGMA})


def test_fewer_measurements_than_unknowns_are_refused():
    ready = co.prepare(co.systems.heavy_top(), SCHEME, step=0.1)
    measured, sigma = {"x": np.zeros((1, 6))}, {"x": 1.0}
    with refused(ValueError, "6 numbers were measured for 12 unknowns"):
        unknown = {"x0": True, "lever": True, "inertia": True}
        co.fit(ready, np.ones(6), (0, 1), measured, unknown, t_eval=[1.0], sigma=sigma)
    end = ready.run(np.ones(6), (0, 1)).x[-1:]
    found = co.fit(ready, 1.01 * np.ones(6), (0, 1), {"x": end}, {"x0": True}, t_eval=[1.0], sigma=sigma)
    np.testing.assert_allclose(found.values["x0"], np.ones(6), rtol=1e-10)


@pytest.mark.parametrize(
    ("measured", "sigma", "named"),
    [
        ({}, {}, ("measured is {}", "'x'", "numbers")),
        (np.zeros((11, 3)), {"x": SIGMA}, ("measured is", "mapping", "numbers")),
        ({"attitude": np.zeros((11, 3, 3))}, SIGMA, ("sigma is 0.01", "'attitude'", "standard deviations")),
    ],
)
def test_what_is_no_mapping_is_named(measured, sigma, named):
    with refused(TypeError, *named):
        co.fit(body(), X0, (0.0, 1.0), measured, {"x0": True}, sigma=sigma)


@pytest.mark.filterwarnings("ignore:inertia:UserWarning")
def test_trial_steps_outside_of_the_parameters_are_shortened():
    """The first step of Gauss and Newton leads to a negative moment of inertia, which the system refuses."""
    ready = body(INERTIA * [1.0, 2.0, 1.0])
    measured = {"x": body().run(X0, (0.0, 4.0), 4).x}
    found = co.fit(ready, X0, (0.0, 4.0), measured, {"inertia": (1, 2)}, 4, sigma={"x": SIGMA})
    np.testing.assert_allclose(found.values["inertia"], INERTIA, rtol=1e-8)


GYRO = {"angular_velocity": 0.002}


def bodies_with_rates():
    """A body, a top, a gyrostat, and bodies with attitudes in their states; each with a state."""
    S = co.systems
    free, orbiting = S.body((1.0, 1.7, 2.6)), S.satellite_on_orbit(((1, 0.1, 0), (0.1, 1.7, 0.2), (0, 0.2, 2.6)), 0.8)
    tensor = S.rigid_body([[1.0, 0.1, 0.2], [0.1, 2.0, 0.3], [0.2, 0.3, 2.5]])
    return {
        "tensor": (tensor, X0),
        "top": (S.heavy_top((1.0, 1.7, 2.6), (0.1, 0.2, 1.0)), np.array([0.5, 0.2, 1.0, 0.6, 0.0, 0.8])),
        "gyrostat": (S.gyrostat((1.0, 1.7, 2.6), (0.1, 0.2, 1.0)), X0),
        "body": (free, free.state(angular_velocity=(0.3, 0.2, 0.5))),
        "orbit": (orbiting, orbiting.state(angular_velocity=(0.3, 0.2, 0.5))),
    }


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", bodies_with_rates())
def test_gyroscopes_determine_what_they_measure(name):
    """The fit of exact rates is exact, and its covariance is that of differences of runs."""
    system, x0 = bodies_with_rates()[name]
    ready = co.prepare(system, SCHEME, step=0.05)
    rates = ready.run(x0, (0, 8), 4).angular_velocity
    # A symmetric matrix has entries 0 to 2, 4, 5 and 8; the first sets the unit of momentum.
    shape = np.shape(system.parameters["inertia"])
    inertia = (1, 2) if shape == (3,) else (4, 8)
    unknown = {"inertia": inertia, "x0": (0, 1)}
    moved = co.prepare(
        co.systems.get(system.name, **{**system.parameters, "inertia": nearby(system)}), SCHEME, step=0.05
    )
    guess = x0 + 0.01 * np.eye(len(x0))[0]
    found = co.fit(moved, guess, (0, 8), {"angular_velocity": rates}, unknown, 4, sigma=GYRO)
    np.testing.assert_allclose(found.values["inertia"], system.parameters["inertia"], atol=1e-8)
    np.testing.assert_allclose(found.values["x0"], x0, atol=1e-8)

    def run(z):
        changed = np.array(system.parameters["inertia"], dtype=float)
        changed.ravel()[list(inertia)] += z[:2]
        start = x0 + np.r_[z[2:], np.zeros(len(x0) - 2)]
        other = co.systems.get(system.name, **{**system.parameters, "inertia": changed})
        return co.prepare(other, SCHEME, step=0.05).run(start, (0, 8), 4).angular_velocity.ravel() / 0.002

    J = np.array([(run(1e-5 * unit) - run(-1e-5 * unit)) / 2e-5 for unit in np.eye(4)]).T
    np.testing.assert_allclose(found.covariance @ (J.T @ J), np.eye(4), atol=2e-5)


def nearby(system):
    inertia = np.array(system.parameters["inertia"], dtype=float)
    return inertia + (0.02 * np.eye(3)[1] if inertia.ndim == 1 else 0.02 * np.diag([0, 1, 0]))


def test_observed_quantities_and_several_trajectories():
    """By functions and polynomials of the state, together with states."""
    square = co.Polynomial({(2, 0, 0): 1.0})
    observe = {"product": lambda x: x[0] * x[1], "square": square}
    starts = np.array([X0, (0.1, 1.0, 0.4)])
    exact = co.integrate(co.systems.rigid_body(INERTIA), starts, (0, 10), 0.05, SCHEME, save_every=4, observe=observe)
    ready = co.prepare(co.systems.rigid_body((1.0, 1.95, 2.6)), SCHEME, 0.05, observe=observe)
    measured = {**exact.observed, "x": exact.x}
    for names in (("product", "square"), ("product", "x")):
        chosen, sigma = {name: measured[name] for name in names}, dict.fromkeys(names, 0.1)
        found = co.fit(ready, starts * 1.01, (0, 10), chosen, {"inertia": (1, 2), "x0": True}, 4, sigma=sigma)
        np.testing.assert_allclose(found.values["inertia"], INERTIA, atol=1e-7)
        np.testing.assert_allclose(found.values["x0"], starts, atol=1e-7)


@pytest.mark.parametrize("members", [0, 2])
def test_vectors_are_measured_by_functions_of_the_state(members):
    """Two components of the closed form, with a deviation for each; the covariance is that of its differences."""
    sigma, times = np.array([0.01, 0.03]), np.linspace(0.0, 10.0, 41)
    starts = np.array([X0, (0.1, 1.0, 0.4)])[:members] if members else np.array(X0)

    def plane(z):
        exact = co.systems.rigid_body(INERTIA + np.r_[0, z[:2]]).exact
        found = [exact(x, times)[:, :2] for x in np.atleast_2d(starts) + np.r_[z[2:], np.zeros(3 - len(z[2:]))]]
        return np.stack(found, axis=1) if members else found[0]

    ready = co.prepare(co.systems.rigid_body(INERTIA + [0, 0.05, -0.05]), co.GaussLegendre(4), 0.05)
    given = {"plane": plane(np.zeros(2))}, {"inertia": (1, 2)}, 5
    observe = {"plane": lambda x, t: x[:2]}
    found = co.fit(ready, starts, (0, 10), *given, sigma={"plane": sigma}, observe=observe)
    np.testing.assert_allclose(found.values["inertia"], INERTIA, atol=1e-9)
    assert found.residuals.shape == (82 * max(1, members),) and found.degrees_of_freedom == len(found.residuals) - 2
    J = [(plane(1e-5 * unit) - plane(-1e-5 * unit)) / 2e-5 / sigma for unit in np.eye(2)]
    J = np.array([one.ravel() for one in J]).T
    np.testing.assert_allclose(found.covariance @ (J.T @ J), np.eye(2), atol=1e-5)


def test_sensors_of_bodies_with_attitudes_in_their_states():
    """Fields in the frame of the body, attitudes as rotations and as matrices, and positions of two bodies."""
    S, field = co.systems, np.array([0.6, 0.0, 0.8])
    craft = S.body((1.0, 1.7, 2.6))
    x0, wrong = craft.state(angular_velocity=(0.3, 0.2, 0.5)), co.prepare(S.body((1.0, 1.72, 2.6)), SCHEME, 0.05)
    exact = co.integrate(craft, x0, (0, 8), 0.05, SCHEME, save_every=4)
    fields = np.einsum("j,kji->ki", field, exact.rotation.as_matrix())
    both, unknown = {"observe": {"field": lambda x: field @ craft.attitudes(x)}}, {"inertia": (1, 2)}
    for name, value, more in (
        ("field", fields, both), ("attitude", exact.rotation, {}), ("attitude", exact.rotation.as_matrix(), {}),
    ):  # fmt: skip
        found = co.fit(wrong, x0, (0, 8), {name: value}, unknown, 4, sigma={name: 0.01}, **more)
        np.testing.assert_allclose(found.values["inertia"], (1.0, 1.7, 2.6), atol=1e-8)
        assert found.degrees_of_freedom == 3 * 41 - 2
    pair = S.gravitating_bodies()
    state = pair.state([[-1, 0, 0], [3, 0, 0]], [[0, -0.2, 0], [0, 0.6, 0]])
    ready, exact = co.prepare(pair, SCHEME, 0.05), co.integrate(pair, state, (0, 1), 0.05, SCHEME, save_every=4)
    found = co.fit(
        ready, state + 0.01 * np.eye(pair.dim)[-4], (0, 1), {"positions": exact.positions}, {"x0": (pair.dim - 4,)}, 4,
        sigma={"positions": 0.01},
    )  # fmt: skip
    np.testing.assert_allclose(found.values["x0"], state, atol=1e-8)


def test_coordinates_that_must_be_one_are_not_fitted():
    orbiting, x0 = co.systems.satellite(), np.array([0, 0, 0.2, 0, 40.0, 0, 5.0, 0.1, 0.2, 1.0])
    ready = co.prepare(orbiting, SCHEME, 0.05)
    exact = {"x": ready.run(x0, (0, 1), 4).x}
    found = co.fit(ready, 1.01 * x0 - 0.01 * np.eye(10)[9], (0, 1), exact, {"x0": True}, 4, sigma={"x": 0.01})
    assert found.unknowns == tuple(("x0", k) for k in range(9))
    np.testing.assert_allclose(found.values["x0"], x0, atol=1e-8)
    with refused(ValueError, "x0[9]", "must be 1"):
        co.fit(ready, x0, (0, 1), exact, {"x0": (0, 9)}, 4, sigma={"x": 0.01})
    starts = np.stack([x0, 1.01 * x0 - 0.01 * np.eye(10)[9]])
    both = co.fit(ready, starts, (0, 1), {"x": ready.run(starts, (0, 1), 4).x}, {"x0": True}, 4, sigma={"x": 0.01})
    assert both.unknowns == tuple(("x0", k) for k in range(20) if k not in (9, 19))


@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_residuals_that_contradict_sigma_are_reported(factor):
    """On both sides: of 123 numbers, twice as large errors have 354 squares too many, 23 standard deviations."""
    body, rng = co.systems.rigid_body(INERTIA), np.random.default_rng(7)
    exact = co.integrate(body, X0, (0, 10), 0.05, SCHEME, save_every=5).angular_velocity
    rates = {"angular_velocity": exact + 0.002 * factor * rng.standard_normal(exact.shape)}
    ready = co.prepare(co.systems.rigid_body((1.0, 1.9, 2.6)), SCHEME, 0.05)
    with warnings.catch_warnings(record=True) as noticed:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", co.LongWait)  # of a busy machine
        found = co.fit(ready, X0, (0, 10), rates, {"inertia": (1, 2), "x0": True}, 5, sigma=GYRO)
    assert found.degrees_of_freedom == 123 - 5 and "118 degrees of freedom" in repr(found)
    assert [("contradict sigma" in str(one.message)) for one in noticed] == [True] * (factor > 1.0)


@pytest.mark.filterwarnings("ignore:.*no body has")
@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("sigma", [0.002, 0.5])
@pytest.mark.parametrize("name", ["angular_velocity", "x"])
def test_rates_given_as_momenta_are_reported(name, sigma, known):
    """Whatever sigma is: of the moments 1, 1.8 and 2.4 they are fitted by others. Momenta are not reported."""
    body, rng = co.systems.rigid_body((1.0, 1.8, 2.4)), np.random.default_rng(5)
    sol = co.integrate(body, (1.0, 0.6, 0.3), (0, 10), 0.05, SCHEME, save_every=4)
    measured = getattr(sol, name) + 0.002 * rng.standard_normal(sol.x.shape)
    start, unknown = (sol.x[0], {}) if known else (measured[0], {"x0": True})
    with warnings.catch_warnings(record=True) as noticed:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", co.LongWait)  # of a busy machine
        co.fit(
            co.prepare(body, SCHEME, 0.05), start, (0, 10), {"x": measured}, {"inertia": (1, 2), **unknown}, 4,
            sigma={"x": sigma},
        )  # fmt: skip
    told = [str(one.message) for one in noticed if "angular velocities" in str(one.message)]
    assert len(told) == (name == "angular_velocity") and all('name them "angular_velocity"' in one for one in told)


def test_momenta_from_a_wrong_first_state_are_not_taken_for_rates():
    """Its errors are large, and angular velocities from another first state would have smaller ones."""
    body = co.systems.rigid_body((1.0, 1.2, 1.3))
    sol = co.integrate(body, (1.0, 0.6, 0.3), (0, 10), 0.05, SCHEME, save_every=4)
    with pytest.warns(UserWarning, match="contradict sigma"):
        co.fit(
            co.prepare(body, SCHEME, 0.05), (1.1, 0.5, 0.4), (0, 10), {"x": sol.x}, {"inertia": (1, 2)}, 4,
            sigma={"x": 0.002},
        )  # fmt: skip


def test_scalar_parameters_are_fitted():
    orbiting = co.systems.satellite_on_orbit((1.0, 1.7, 2.6), 0.8)
    x0 = orbiting.state(angular_velocity=(0.3, 0.2, 0.5))
    exact = co.integrate(orbiting, x0, (0, 8), 0.05, SCHEME, save_every=4)
    ready = co.prepare(co.systems.satellite_on_orbit((1.0, 1.7, 2.6), 0.82), SCHEME, 0.05)
    found = co.fit(ready, x0, (0, 8), {"x": exact.x}, {"mean_motion": True}, 4, sigma={"x": 0.01})
    assert found.values["mean_motion"] == pytest.approx(0.8, abs=1e-9)


def test_degrees_of_freedom_of_measured_attitudes():
    """A rotation is three numbers, a motion of space six."""
    for system, size in ((co.systems.rigid_body((1.0, 1.8, 2.4)), 3), (co.systems.heavy_top((1.0, 1.8, 2.4)), 6)):
        ready, x0 = co.prepare(system, SCHEME, 0.05, attitude=True), np.linspace(0.3, 1.0, system.dim)
        exact = ready.run(x0, (0, 2), save_every=4)
        found = co.fit(ready, x0, (0, 2), {"attitude": exact.attitude}, {"inertia": (0,)}, 4, sigma={"attitude": 0.01})
        assert found.degrees_of_freedom == size * len(exact.t) - 1


def w_first(rotations):
    """Quaternions w x y z, read as x y z w."""
    return Rotation.from_quat(rotations.as_quat()[:, [3, 0, 1, 2]])


# What is measured instead of the attitudes, and what is said.
MISREAD = {
    "none": (lambda log: log, "contradict sigma"),
    "inverse": (lambda log: log.inv(), "by their inverses.*space to body"),
    "w first": (w_first, r"as quaternions w x y z.*3, 0\]\]\)$"),
    "w first, inverse": (lambda log: w_first(log.inv()), r"as quaternions w x y z.*space.*inv\(\)$"),
    "degrees": (lambda log: Rotation.from_euler("xyz", log.as_euler("xyz", degrees=True)), "contradict sigma"),
}


def damped(inertia, rate):
    system = co.systems.rigid_body(inertia)
    system = system.with_forces(co.forces.LinearDamping(rate)) if rate else system
    return co.prepare(system, SCHEME, 0.05, attitude=True)


@pytest.mark.parametrize("start", ["of the log", pytest.param("of the body", marks=pytest.mark.long)])
@pytest.mark.parametrize("damping", [0.0, 0.04])
@pytest.mark.parametrize("mistake", MISREAD)
def test_rotations_that_were_read_wrongly_are_named(start, mistake, damping):
    """Residuals that contradict sigma are warned of either way, and the reading if it is the cause."""
    misread, words = MISREAD[mistake]
    rng, sigma = np.random.default_rng(3), 0.01
    turned = Rotation.from_rotvec([0.3, -0.2, 0.5])
    exact = damped((1.0, 2.0, 2.5), damping).run((1.0, 0.2, 0.5), (0, 10), 10, attitude=turned.as_matrix()).rotation
    log = misread(exact * Rotation.from_rotvec(3.0 * sigma * rng.standard_normal((len(exact), 3))))  # above sigma
    first = log[0] if start == "of the log" else turned
    options = {"sigma": {"attitude": sigma}, "attitude": first.as_matrix()}
    ready, unknown = damped((1.0, 2.0, 2.4), damping), {"inertia": (2,)}
    with warnings.catch_warnings(record=True) as noticed:
        warnings.simplefilter("always")
        try:
            co.fit(ready, (1.0, 0.2, 0.5), (0, 10), {"attitude": log}, unknown, 10, **options)
            said = [str(one.message) for one in noticed]
        except ValueError as error:  # of fits that were ended early
            assert mistake not in ("none", "degrees")
            said = [str(error)]
    assert re.search(words, said[0])  # before those of bodies that do not exist
    assert sum('"attitude"' in one for one in said) == (mistake not in ("none", "degrees"))


@pytest.mark.parametrize("mistake", ["inverse", pytest.param("w first", marks=pytest.mark.long)])
@pytest.mark.parametrize("sigma", [0.01, (0.01, 0.01, 0.02)], ids=["one sigma", "by axis"])
def test_fits_of_rotations_that_were_read_wrongly_end_early(mistake, sigma):
    """To the minimum they would take hundreds of evaluations, and a minute."""
    misread, words = MISREAD[mistake]
    rng = np.random.default_rng(7)
    exact = damped((1.0, 2.0, 2.5), 0.04).run((1.0, 0.2, 0.5), (0, 20), 20, attitude=A0).rotation
    log = misread(exact * Rotation.from_rotvec(0.01 * rng.standard_normal((len(exact), 3))))
    ready, measured = damped((1.1, 2.0, 2.4), 0.02), {"attitude": log}
    unknown = {"inertia": (0, 2), "LinearDamping.rate": True, "x0": True, "attitude0": True}
    with pytest.raises(ValueError, match="not found in 20 evaluations.*" + words):
        co.fit(ready, (1.05, 0.2, 0.55), (0, 20), measured, unknown, 20, sigma={"attitude": sigma}, attitude=A0)


def test_attitudes_of_the_other_direction_are_named_where_they_leave_unknowns_undetermined():
    """Of a damped body the point reached is far away, and there the measurements determine nothing."""
    rng = np.random.default_rng(132)

    def body(inertia):
        damped = co.systems.rigid_body(inertia).with_forces(co.forces.LinearDamping(0.03))
        return co.prepare(damped, co.Splitting(order=2), 0.1, attitude=True)

    x0, turned = rng.standard_normal(3), Rotation.from_rotvec(rng.standard_normal(3))
    exact = body((1, 1.8, 2.4)).run(x0, (0, 4), 5, attitude=turned.as_matrix()).rotation
    log = (exact * Rotation.from_rotvec(0.01 * rng.standard_normal((len(exact), 3)))).inv()
    unknown = {"x0": True, "inertia": (0, 1), "LinearDamping.rate": True}
    options = {"sigma": {"attitude": 0.01}, "attitude": log[0].as_matrix()}
    with refused(ValueError, "inverses", "space to body"):
        co.fit(body((1, 1.7, 2.6)), x0, (0, 4), {"attitude": log}, unknown, 5, **options)


def test_quaternions_are_refused_with_the_rotations_to_give():
    """Their order is not guessed."""
    ready = co.prepare(co.systems.rigid_body((1.0, 2.0, 2.5)), co.Splitting(), 0.1, attitude=True)
    with refused(ValueError, "(3, 4)", "Rotation.from_quat"):
        co.fit(ready, (0.3, 1.0, 0.2), (0, 0.2), {"attitude": np.ones((3, 4))}, {"x0": True}, sigma={"attitude": 0.1})


def warnings_of(call):
    """The result of a call, and its warnings of bodies that do not exist."""
    with warnings.catch_warnings(record=True) as noticed:
        warnings.simplefilter("always")
        found = call()
    return found, [one for one in noticed if "no body has" in str(one.message)]


def test_trial_points_do_not_warn_of_their_inertia(exact):
    """The steps from this guess leave the inertia of bodies; other threads warn, whatever a fit does meanwhile."""
    in_thread, calls = [], itertools.count()
    with ThreadPoolExecutor(1) as pool:
        pool.submit(int).result()  # the thread starts before the fit

        def third(x):
            if next(calls) % 50 == 0:  # once in each run
                in_thread.append(pool.submit(co.systems.rigid_body, (1.0, 1.0, 3.0)).result())
            return x[2]

        ready, x = body((1.4, 2.0, 3.3)), exact.x[:, 2]
        measured, sigma = {"attitude": exact.attitude, "third": x}, {"attitude": SIGMA, "third": 1.0}
        found, noticed = warnings_of(
            lambda: co.fit(
                ready, 1.3 * X0, SPAN, measured, {"inertia": (0, 2), "x0": True}, EVERY, sigma=sigma, attitude=A0,
                observe={"third": third},
            )
        )  # fmt: skip
    np.testing.assert_allclose(found.values["inertia"], INERTIA, rtol=1e-8)
    assert len(noticed) == len(in_thread) > 10


def test_results_warn_of_their_inertia():
    """Of moments (0.3, 2, 2.5), from the guess of a body."""
    with pytest.warns(UserWarning, match="no body has"):
        thin = body((0.3, 2.0, 2.5))
    rates = {"angular_velocity": thin.run(X0, (0, 2), 4).angular_velocity}
    run = (X0, (0, 2), rates, {"inertia": (0,)}, 4)
    found, noticed = warnings_of(lambda: co.fit(body((0.55, 2.0, 2.5)), *run, sigma=GYRO))
    assert found.values["inertia"][0] == pytest.approx(0.3, rel=1e-6) and noticed


@pytest.mark.filterwarnings("ignore:inertia:UserWarning")  # of the point reached
@pytest.mark.parametrize("first", [0.1, 0.5])
def test_a_fit_that_ends_where_nothing_is_determined_asks_for_a_better_guess(first):
    """Rates of +1 and -1 by turns are best fitted by a body at rest, where inertia and momentum count alike."""
    ready, rates = co.prepare(co.systems.rigid_body(INERTIA), SCHEME, 0.1), np.zeros((51, 3))
    rates[:-1, 0] = (-1.0) ** np.arange(50)
    start, measured, unknown = np.full(3, first), {"angular_velocity": rates}, {"inertia": (0,), "x0": True}
    sigma = {"angular_velocity": 0.01}
    named = ["at the point reached", "5e+05 for 149", "far from the minimum", "a better guess, or omit, for instance"]
    with refused(ValueError, *named):
        co.fit(ready, start, (0, 5), measured, unknown, sigma=sigma)
    with refused(ValueError, "at the guess", "inertia; omit"):
        co.fit(ready, np.zeros(3), (0, 5), measured, unknown, sigma=sigma)
