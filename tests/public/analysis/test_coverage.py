"""Coverage of standard errors: how often one and two of them hold a known truth, over many seeds."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(1)

SEEDS = 200
SO3 = co.algebras.so(3)
BODY = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5))


def check_coverage(errors, deviations, one=0.90, two=0.95):
    """Two deviations hold the fraction `two` of the truth, one 0.68 up to `one`, where Student's factor is large.

    Each less three standard deviations of a binomial count, and 0.03 for errors that are not exactly normal.
    """
    z = np.abs(errors) / deviations
    assert np.all(np.isfinite(z)), "an error bar that is zero, or unknown"
    within, count = [np.mean(z < k) for k in (1, 2)], z.size
    few = [3 * np.sqrt(p * (1 - p) / count) + 0.03 for p in (0.68, two)]
    assert 0.68 - few[0] < within[0] < one + few[0], f"{within[0]:.2f} within one"
    assert within[1] > two - few[1], f"{within[1]:.2f} within two"


def oscillating(size, angle):
    return 2.0 * size * np.cos(angle), -(size**2)


# Coefficients of autoregressions: white, correlated, anticorrelated and oscillating noise.
NOISES = {
    "white": (),
    "correlated": (0.8,),
    "anticorrelated": (-0.5,),
    "alternating": (-0.9,),
    "oscillating": oscillating(0.9, 1.0),
    "ringing": oscillating(0.98, 0.5),
}


def noise_of(kind, shape, seed=1, burn=1000):
    drawn = np.random.default_rng(seed).normal(size=(shape[0] + burn, *shape[1:]))
    return lfilter([1.0], [1.0, *(-c for c in NOISES[kind])], drawn, axis=0)[burn:]


def integrated_time(kind):
    """The power at zero over twice the variance, both from the response to one impulse."""
    response = lfilter([1.0], [1.0, *(-c for c in NOISES[kind])], np.eye(1, 4000)[0])
    return 0.5 * response.sum() ** 2 / np.sum(response**2)


@pytest.mark.parametrize("kind", NOISES)
@pytest.mark.parametrize("count", [100, 2000, pytest.param(20000, marks=pytest.mark.long)])
@pytest.mark.thinned(2)
def test_means_and_times_of_series(kind, count):
    series = noise_of(kind, (count, SEEDS), count)
    found = co.spectra.autocorrelation(0.5 * np.arange(count), series)  # every series a channel
    known = np.isfinite(found.time)
    assert np.mean(known) > (0.95 if count < 1000 else 0.999) and np.array_equal(known, np.isfinite(found.mean_error))
    check_coverage(found.mean[known], found.mean_error[known])
    # Times of few samples are skewed; the mean over the seeds of many is right within a tenth.
    check_coverage((found.time - 0.5 * integrated_time(kind))[known], found.error[known], 0.95, 0.85)
    if count > 1000:
        assert np.mean(found.time) == pytest.approx(0.5 * integrated_time(kind), rel=0.1)
        assert np.median(found.mean_error) == pytest.approx(np.std(found.mean), rel=0.15)


@pytest.mark.parametrize("kind", ["white", "correlated", "oscillating"])
@pytest.mark.parametrize(("count", "members"), [(16, 5), (64, 8)])
def test_means_of_members(kind, count, members):
    series = noise_of(kind, (count, members, SEEDS), members)
    found = co.spectra.autocorrelation(np.arange(count), series)
    check_coverage(found.mean, found.mean_error)


@pytest.mark.parametrize("members", [1, 2])
def test_times_of_short_series_are_not_biased(members):
    """Of 16 samples the time has 4 to 6 degrees of freedom; one too many takes a sixth from it."""
    found = co.spectra.autocorrelation(np.arange(16), noise_of("white", (16, members, 800), members))
    # The mean of 800 times is uncertain by 3 per cent, and autoregressions of few samples raise it by as much.
    assert np.nanmean(found.time) == pytest.approx(integrated_time("white"), rel=0.1)


def test_members_with_means_of_their_own_are_seen_in_the_error():
    """What each member keeps for ever is as uncertain as the scatter of 40 means, whatever the length of the series."""
    rng = np.random.default_rng(2)
    series = rng.normal(size=(500, 40, 1)) + rng.normal(size=(1, 40, 1))
    found = co.spectra.autocorrelation(np.arange(500.0), series)
    assert 0.7 < found.mean_error[0] * np.sqrt(40) < 1.4 and np.isnan(found.time[0])


def test_an_oscillation_alone_has_an_error_above_zero():
    """Momenta of bodies: the mean over part of a period is off, as its error is."""
    t = 0.1 * np.arange(1000)
    phases = np.random.default_rng(1).uniform(0, 7, SEEDS)
    series = np.cos(0.83 * t[:, None] + phases)
    found = co.spectra.autocorrelation(t, series)
    assert np.all(np.abs(found.mean) < 3 * found.mean_error)
    assert np.all((found.time > 0) & (found.time < 0.1))


DRIFTS = {
    "white": lambda rng, n: rng.normal(size=n),
    "anticorrelated": lambda rng, n: lfilter([1.0], [1.0, 0.5], rng.normal(size=n + 50))[50:],
    "oscillating": lambda rng, n: np.cos(rng.uniform(12 * np.pi / n, 2.8) * np.arange(n) + rng.uniform(0, 7)),
    "a memory of a twentieth": lambda rng, n: lfilter([1.0], [1.0, -np.exp(-20 / n)], rng.normal(size=2 * n))[n:],
}


@pytest.mark.thinned(2)
@pytest.mark.parametrize("kind", DRIFTS)
@pytest.mark.parametrize("count", [16, 32, 64])
def test_slopes_of_short_series(kind, count):
    t = 0.25 * np.arange(count)
    lines = [
        co.analysis.drift_of_series(t, DRIFTS[kind](np.random.default_rng(seed), count) - 2.0 * t)
        for seed in range(SEEDS)
    ]
    errors, deviations = (np.array([getattr(line, name) for line in lines]) for name in ("slope", "uncertainty"))
    errors = errors + 2.0
    if kind == "oscillating":  # not random: each slope is bounded by what the ends have
        assert np.all(np.abs(errors) < 2.5 * deviations) and np.median(deviations / np.abs(errors)) < 10
    else:
        check_coverage(errors, deviations)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("count", [16, 40, 300])
@pytest.mark.parametrize(("sums", "least"), [(1, 0.75), (2, 0.70)])
def test_slopes_of_walks(count, sums, least):
    """Where the memory exceeds the span, the claim is weaker."""
    z = []
    for seed in range(SEEDS):
        series = np.random.default_rng(seed).normal(size=count)
        for _ in range(sums):
            series = np.cumsum(series)
        line = co.analysis.drift_of_series(np.arange(count), series)
        z.append(abs(line.slope) / line.uncertainty)
    assert np.mean(np.array(z) < 2) > least - 0.09


@pytest.mark.parametrize("members", [2, 3, 8, 64])
def test_biases_of_walks_are_normal(members):
    walks = np.cumsum(np.random.default_rng(members).normal(size=(8, members, 2000)), axis=0)
    bias = np.array([co.analysis.random_walk(walks[..., k], 1).bias for k in range(2000)])
    assert np.std(bias) == pytest.approx(1.0, abs=0.06) and abs(np.mean(bias)) < 0.08
    assert np.mean(np.abs(bias) > 3) < 0.007  # 0.0027, and three standard deviations
    assert [np.isnan(co.analysis.random_walk(np.ones((3, one)), 1).bias) for one in (1, 4)] == [True, True]


@pytest.mark.parametrize("noise", [3e-5, 1e-3])
@pytest.mark.parametrize("steps", [6, 10])
def test_orders_above_a_noisy_plateau(noise, steps):
    h, found = 0.4 * 2.0 ** -np.arange(steps), []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        errors = np.abs(h**2 * (1 + rng.uniform(-0.5, 0.5) * h) + noise * rng.normal(size=steps))
        found.append(co.analysis.fit_order(h, errors))
    z = np.array([abs(one.order - 2) / one.uncertainty for one in found])
    assert np.mean(z < 1) > 0.6 and np.mean(z < 2) > 0.8
    assert np.median([one.uncertainty for one in found]) < 0.5, "not to the safe side by much"


def test_intensities_of_few_members():
    """Of an isotropic hot chain, from the members of one ensemble in groups; the truth is the mean of all."""
    ring = co.systems.spin_lattice("ring", 8)
    states = co.thermal_states(ring, 1.0, members=96, sweeps=20, seed=7)
    for members in (2, 4):
        found = []
        for first in range(0, 96, members):
            sol = co.integrate(ring, states.x[first : first + members], (0, 6), 0.1, save_every=5)
            found.append(co.spectra.structure_factor(sol, path=[1 / 8, 1 / 2]))
        intensities, errors = (np.array([getattr(one, name) for one in found]) for name in ("intensity", "error"))
        check_coverage(intensities - intensities.mean(axis=0), errors, two=0.90)


def test_few_equations_have_students_factor():
    """With one degree of freedom two standard deviations are seven of those of the residuals."""
    rng = np.random.default_rng(1)
    sol = co.integrate(BODY, rng.normal(size=(3, 3)), (0, 20), 0.1)
    noisy = sol.x + 0.01 * rng.normal(size=sol.x.shape)
    few, many = (co.identify(SO3, sol.t, noisy, 2, sign=-1, radius=r) for r in (96, 16))
    expected = few.noise.max() / many.noise.max() * 13.968 / 2
    ratio = few.standard_deviation.max() / many.standard_deviation.max()
    assert ratio > 0.5 * expected


@pytest.mark.parametrize("count", [12, pytest.param(100, marks=pytest.mark.long)])
@pytest.mark.parametrize("transient", [0.0, 100.0])
def test_exponents_of_regular_and_chaotic_motions(count, transient):
    rng = np.random.default_rng(0)
    x0 = rng.normal(size=(count, 3))
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    unit = x0 / np.linalg.norm(x0, axis=1)[:, None]
    found = co.lyapunov(body, unit, (0, 300 + transient), 0.1, exponents=1, transient=transient)
    z = found.exponents / found.uncertainty
    assert np.all(z < 2.0) and np.mean(z < 1.25) > 0.6 and np.median(z) > 0.4  # the exponents are zero
    H = co.Quadratic([1.0, 0.5, 0.4, 0.0, 0.0, 0.0], linear=[0.0, 0.0, 0.0, 0.5, 0.25, 1.0])
    top = co.LiePoissonSystem(co.algebras.e(3), H, sign=-1)
    orbit = co.integrate(top, (1.0, 0.5, -0.75, 0.6, 0.0, 0.8), (0, 100.0 * count), 0.05, save_every=2000)
    found = co.lyapunov(top, orbit.x[:count], (0, 500 + transient), 0.05, exponents=1, transient=transient)
    z = (found.exponents - np.mean(found.exponents)) / found.uncertainty
    assert np.mean(np.abs(z) < 2) > 0.8 and np.sqrt(np.mean(z**2)) > 0.4


@pytest.mark.parametrize("count", [2, pytest.param(25, marks=pytest.mark.long)])
@pytest.mark.parametrize("name, transient", [("so(2,1)", 40.0), ("sl(2)", 0.0), ("A5,40", 40.0), ("A4,7", 40.0)])
def test_exponents_by_long_steps(count, name, transient):
    """Of H = l . x, known from eigenvalues: the error is that of the step, or log(t)/t for those of a Jordan block."""
    algebra, z, dominated = co.algebras.so(2, 1) if name == "so(2,1)" else co.algebras.get(name), [], []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        linear, x0 = rng.uniform(0.25, 1.0, algebra.dim), 1e-30 * rng.uniform(0.1, 0.2, algebra.dim)
        system = co.LiePoissonSystem(algebra, co.Quadratic(np.zeros(algebra.dim), linear=linear), casimirs={})
        wanted = np.sort(np.linalg.eigvals(system.jacobian(x0)).real)[::-1]
        for scheme in (co.Splitting(order=2), co.GaussLegendre(1), co.GaussLegendre(2)):
            found = co.lyapunov(system, x0, (0, 80.1), 0.1, scheme, transient=transient)
            z.append(np.abs(np.sort(found.exponents)[::-1] - wanted) / np.hypot(found.uncertainty, 1e-12))
            dominated.append(found.step_error > 0.99 * np.hypot(found.uncertainty, 1e-12))
    z, dominated = np.array(z), np.array(dominated)
    assert np.mean(z < 2) > 0.97 and np.mean(z < 1.1) > 0.6
    assert not dominated.any() or 0.8 < np.median(z[dominated]) < 1.1, "neither too small nor too large"


INERTIA, X0, START = np.array([1.0, 2.0, 2.5]), np.array([1.0, 0.2, 0.5]), Rotation.from_rotvec([0.3, -0.2, 0.5])


@pytest.mark.parametrize("count", [3, pytest.param(100, marks=pytest.mark.long)])
@pytest.mark.parametrize("each", [False, True])
def test_fits_to_a_tracker_that_is_bad_about_one_axis(count, each):
    """Its standard deviations are those of the rotation vector in the frame of the body, the same or at each time."""
    sigma, scheme = np.array([0.002, 0.002, 0.04]), co.Splitting(order=4)
    ready = co.prepare(co.systems.rigid_body(inertia=INERTIA), scheme, 0.05, attitude=True)
    exact = ready.run(X0, (0, 10), 10, attitude=START.as_matrix()).attitude
    given = np.tile(sigma, (len(exact), 1)) if each else sigma
    z, sums = [], []
    for seed in range(count):
        errors = Rotation.from_rotvec(sigma * np.random.default_rng(seed).normal(size=(len(exact), 3))).as_matrix()
        unknown, start = {"x0": True, "attitude0": True}, START.as_matrix()
        measured = {"attitude": exact @ errors}
        found = co.fit(ready, X0 * 1.2, (0, 10), measured, unknown, 10, sigma={"attitude": given}, attitude=start)
        turned = Rotation.from_matrix(found.values["attitude0"] @ START.as_matrix().T).as_rotvec()
        error = np.concatenate([found.values["x0"] - X0, turned])
        z.append(error @ np.linalg.solve(found.covariance, error))
        sums.append(np.sum(found.residuals**2))
    assert found.residuals.shape == (3 * len(exact),) and found.degrees_of_freedom == 3 * len(exact) - 6
    assert abs(np.mean(z) - 6) < 4 * np.sqrt(2 * 6 / count)
    assert abs(np.mean(sums) - found.degrees_of_freedom) < 4 * np.sqrt(2 * found.degrees_of_freedom / count)


@pytest.mark.parametrize("name", ["e(3)", "so(4)", "se(2)"])
def test_sums_of_squares_of_group_elements(name):
    """Of errors exp(xi) in the group: chi-squared, for a number and for a number of each coordinate."""
    algebra = {"e(3)": co.algebras.e(3), "so(4)": co.algebras.so(4), "se(2)": co.algebras.e(2)}[name]
    system = co.LiePoissonSystem(algebra, co.Quadratic(np.linspace(0.5, 1.0, algebra.dim)))
    ready, x0 = co.prepare(system, None, 0.05, attitude=True), np.linspace(0.3, 0.8, algebra.dim)
    exact, n = ready.run(x0, (0, 4), 2).attitude, algebra.dim
    rng, sigma = np.random.default_rng(4), 1e-3 * np.linspace(1.0, 2.0, algebra.dim)
    for scale, given in ((1e-3 * np.ones(n), 1e-3), (sigma, sigma)):
        errors = np.array([expm(np.tensordot(scale * rng.normal(size=n), ready.representation, 1)) for _ in exact])
        arguments = (ready, x0, (0, 4), {"attitude": exact @ errors}, {"x0": True}, 2)
        found = co.fit(*arguments, sigma={"attitude": given})
        freedom = n * len(exact) - n
        assert found.degrees_of_freedom == freedom
        assert abs(np.sum(found.residuals**2) - freedom) < 4 * np.sqrt(2 * freedom)
        with pytest.warns(UserWarning, match="contradict sigma"):
            co.fit(*arguments, sigma={"attitude": 0.5 * given})
    with refused(ValueError, "sigma of attitude", "(7,)"):
        co.fit(*arguments, sigma={"attitude": np.ones(7)})


def test_a_line_is_followed_only_where_a_window_separates_it():
    """By default half of the span; a shorter run or window is refused with the width that suffices."""
    run = co.integrate(BODY, (1.0, 0.2, 0.5), (0, 400), 0.1, co.Splitting(order=2, parts="coordinates"), save_every=4)
    w = co.frequencies(run, 1, count=1).frequency[0]
    whole, drift = co.analysis.line_drift(run, w, signal=1), co.phase_drift(run)
    assert whole.slope / w == pytest.approx(drift.slope, rel=1e-2)
    assert abs(whole.t[0] - 100) < 1 and abs(whole.t[-1] - 300) < 1
    needed = 8 * np.pi / (2 * w)  # from its mirror image
    near = 1.01 * needed
    assert co.analysis.line_drift(run, w, signal=1, width=near).slope == pytest.approx(whole.slope, rel=0.05)
    with refused(ValueError, "another line", f"{needed:.4g}"):
        co.analysis.line_drift(run, w, signal=1, width=0.9 * needed)
    short = co.integrate(BODY, (1.0, 0.2, 0.5), (0, 0.1 * int(19 * needed)), 0.1, save_every=1)
    with refused(ValueError, "another line"):
        co.analysis.line_drift(short, w, signal=1)


def test_a_line_beside_a_large_mean_is_followed_by_a_wider_window():
    """Its amplitude is a 20 000th of the mean, whose side lobes a window of four bins leaves twenty times as large."""
    body, x0 = co.systems.rigid_body(inertia=(1.471, 1.640, 2.6)), (0.017, 0.022, -1.0)
    scheme, w = co.Splitting(order=2, parts="coordinates"), 0.51560091727729
    short, run = (co.integrate(body, x0, (0, span), 0.1, scheme, save_every=2) for span in (100, 300))
    with refused(ValueError, "another line", "give a width of at least"):
        co.analysis.line_drift(short, w, signal=2)
    assert co.analysis.line_drift(run, w, signal=2).slope / w == pytest.approx(co.phase_drift(run).slope, rel=0.01)


@pytest.mark.long
@pytest.mark.parametrize("span", [60, 150, 300])
def test_drifts_of_lines_of_random_bodies(span, count=30):
    """Each is refused, or right within its uncertainty: the truth is the drift of a long run."""
    rng, scheme, errors, deviations = np.random.default_rng(5), co.Splitting(order=2, parts="coordinates"), [], []
    bodies = []
    while len(bodies) < count:
        inertia, x0 = np.sort(rng.uniform(1, 3, 3)), rng.normal(size=3)
        if inertia[0] + inertia[1] < inertia[2] or np.diff(inertia).min() < 0.1:
            continue
        body, x0 = co.systems.rigid_body(inertia=inertia), x0 / np.linalg.norm(x0)
        bodies.append(body)
        truth = co.phase_drift(co.integrate(body, x0, (0, 4000), 0.1, scheme, save_every=20))
        exact = co.integrate(body, x0, (0, 1000), 0.1, co.GaussLegendre(4), save_every=5)
        run = co.integrate(body, x0, (0, span), 0.1, scheme, save_every=2)
        for k in range(3):
            w = co.frequencies(exact, k, count=1).frequency[0]
            try:
                drift = co.analysis.line_drift(run, w, signal=k)
            except ValueError as error:
                assert "give a width of at least" in str(error)
                continue
            errors.append(abs(drift.slope / w - truth.slope) / abs(truth.slope))
            deviations.append(np.hypot(drift.uncertainty / w, truth.uncertainty) / abs(truth.slope))
    errors, deviations = np.array(errors), np.array(deviations)
    assert np.all(errors < 0.1) and np.all(errors < np.maximum(0.01, 5 * deviations))
    assert span < 200 or len(errors) > 0.3 * 3 * count


def test_errors_of_steps_at_and_near_an_equilibrium():
    """Of M x + l parallel to x, which the parts of a splitting leave: NaN at rest, a number where the field counts."""
    x, M = np.array([0.6, 0.0, 0.8]), np.array([1.0, 0.5, 1 / 3])
    system = co.LiePoissonSystem(SO3, co.Quadratic(np.diag(M), linear=2.0 * x - M * x), sign=-1)
    found = []
    for distance in (0.0, 1e-10, 0.1):
        start = x + distance * np.array([0.3, 1.0, 0.0])
        sol = co.integrate(system, start, (0, 20), 0.05, co.Splitting(order=2, parts="coordinates"))
        assert 1e-4 < sol.error_estimate() < 1e-3
        found.append(sol.step_error())
    assert np.isnan(found[:2]).all() and 1e-3 < found[2] < 2e-3


@pytest.mark.parametrize("method", ["heat bath", "Metropolis"])
def test_energies_of_thermal_states(method):
    """Two spins, whose mean energy is -(coth(1/kT) - kT): each chain has the error of its own record."""
    states = co.thermal_states(co.systems.spin_lattice(), 0.5, members=SEEDS, sweeps=300, seed=1, method=method)
    found = co.spectra.autocorrelation(np.arange(260), states.energy[41:])
    check_coverage(found.mean + 1 / np.tanh(2.0) - 0.5, found.mean_error)
