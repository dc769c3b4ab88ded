"""Schemes for matrices: steps against their equations, references to 40 digits, the spectrum."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF as U
from torus import first_modes, last_modes, smooth

pytestmark = pytest.mark.thinned(3)

TORUS, SPHERE = co.systems.torus_euler, co.systems.sphere_euler


def body(n):
    """Return a free body of n dimensions."""
    inertia = 1.0 + np.arange(n) / n
    stream = co.systems.Weights(1 / np.add.outer(inertia, inertia))
    return co.MatrixSystem(co.MatrixAlgebra("so", n), stream, name="body")


SYSTEMS = {
    **{f"sphere {n}": (lambda n=n: SPHERE(N=n)) for n in (2, 5, 8, 33, 65)},
    **{f"torus {n}": (lambda n=n: TORUS(N=n)) for n in (3, 9)},
    **{f"so({n})": (lambda n=n: body(n)) for n in (3, 4, 7, 35)},
}


def start(system, seed=1):
    """Return a random matrix of spectral radius one; smooth where a stream smooths."""
    rng = np.random.default_rng(seed)
    W = rng.standard_normal(system.shape)
    if system.complex:
        W = W + 1j * rng.standard_normal(system.shape)
    W = system.stream(system.algebra.projected(W))
    return W / np.abs(np.linalg.eigvals(W)).max()


def turning(system, W, share):
    """Return the step in which the fastest mode of the stream turns by `share` of a half turn."""
    return float(share * np.pi / np.abs(np.linalg.eigvals(system.stream(W))).max())


def last(system, W, time, steps, method):
    return co.integrate(system, W, (0.0, time), abs(time) / steps, method, save_every=steps, watch=False).x[-1]


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    ("method", "N", "counts", "fine"),
    [(co.CommutatorFree(4), 7, (16, 32), 512)]
    + [(co.LineSplitting(2), N, (32, 64), None) for N in (3, 5, 7)]
    + [(co.LineSplitting(4), N, (4, 8), 256) for N in (3, 5, 7)]
    + [(co.LineSplitting(6), N, (1, 2), 64) for N in (5, 7)],
)
def test_modes_of_the_torus_against_forty_digits(method, N, counts, fine):
    """At t = 1: the slope, and the value that it leads to."""
    system = TORUS(N=N)
    W, exact = system.from_modes(first_modes(N)), system.from_modes(last_modes(N))
    errors = [np.abs(last(system, W, 1.0, n, method) - exact).max() for n in counts]
    assert abs(np.log2(errors[0] / errors[1]) - method.order) < 0.35
    assert fine is None or np.abs(last(system, W, 1.0, fine, method) - exact).max() < 1e-12


def dense_step(system, W, h):
    """Return a step of the midpoint rule, by dense inverses and fixed-point iteration for the stream matrix."""
    P, one = system.stream_of(W), np.eye(len(W))
    for _ in range(80):
        left = np.linalg.inv(one - 0.5 * h * P)
        P = system.stream_of(left @ W @ left.conj().T)
    turn = np.linalg.solve(one - 0.5 * h * P, one + 0.5 * h * P)
    return turn @ W @ turn.conj().T


@pytest.mark.thinned(6)
@pytest.mark.parametrize("name", ["sphere 2", "sphere 33", "sphere 65", "torus 9", "so(3)", "so(35)"])
@pytest.mark.parametrize("share", [0.05, 0.3])
def test_every_isospectral_step_solves_the_equation_of_the_midpoint(name, share):
    """The first steps, whose stream is predicted from few earlier ones, and later ones, which replace the oldest."""
    system = SYSTEMS[name]()
    W = start(system)
    h = turning(system, W, share)
    for before, after in pairwise(co.integrate(system, W, (0, 24 * h), h, co.IsospectralGauss()).x):
        # Products of N entries round by some N^(1/2) units; the unsaved compensation is below half a unit.
        assert np.abs(after - dense_step(system, before, h)).max() < 32 * np.sqrt(len(W)) * U


@pytest.mark.parametrize(
    ("name", "t0", "unit"),
    [("sphere 65", 0.0, 1.0), ("sphere 257", 0.0, 1.0), ("so(35)", -3.0, 1e30), ("torus 9", 7.0, 1e-7)],
)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_isospectral_steps_predicted_from_earlier_ones_are_those_without(name, t0, unit, side):
    system = SYSTEMS.get(name, lambda: SPHERE(N=257))()
    W, h = start(system), side * turning(system, start(system), 0.1)
    steps = 4 if name == "sphere 257" else 24
    run = co.integrate(system, unit * W, (t0, t0 + steps * h / unit), abs(h) / unit, co.IsospectralGauss())
    scheme = co.IsospectralGauss()
    for before, after in list(pairwise(run.x))[-2:]:
        plain = np.asarray(scheme.step(system, before, t0, h / unit))
        # Products round by sqrt(N) U, in the plain step and in this one; a state has lost its compensation, up to U.
        assert np.abs(after - plain).max() <= 4 * (1 + np.sqrt(system.algebra.N)) * U * unit * np.abs(W).max()


def test_predicted_isospectral_steps_take_few_products():
    system = SPHERE(N=65)
    W = start(system)
    h = turning(system, W, 0.1)
    counts = [co.integrate(system, W, (0.0, n * h), h, co.IsospectralGauss(), save_every=n).stats for n in (40, 80)]
    # The prediction, the midpoint and one slope are three; round-off of the prediction needs another one at times.
    assert counts[1].evaluations - counts[0].evaluations <= 40 * 3.75
    assert counts[1].iterations - counts[0].iterations == 40


def test_short_isospectral_steps_round_in_proportion_to_their_length():
    """A step of the fraction 1/1000 of a half turn moves W by a fraction of that size, and rounds as little of it."""
    system = SPHERE(N=8)
    W = start(system)
    steps, h = 20000, turning(system, W, 0.001)
    run = co.integrate(system, W, (0, steps * h), h, co.IsospectralGauss(), save_every=1000)
    # Rounding by a unit of W in each step would add up to sqrt(20000) / 3 units or more; LAPACK's are about N units.
    assert np.abs(system.spectrum(run.x) - system.spectrum(W)).max() < 4 * 8 * U


@pytest.mark.thinned(1)
@pytest.mark.parametrize("size", [10.0, 1000.0])
@pytest.mark.parametrize("kind", ["so", "u"])
def test_isospectral_steps_far_longer_than_a_turn_keep_the_spectrum(kind, size):
    """A constant part of the stream for which the condition of 1 - (h/2) P is about (h/2) |P| = `size`."""
    n, steps, h, rng = 40, 50, 2.0, np.random.default_rng(2)
    algebra = co.MatrixAlgebra(kind, n)
    draws = rng.standard_normal((2, n, n)) + (1j * rng.standard_normal((2, n, n)) if algebra.complex else 0.0)
    W, constant = (A / np.abs(np.linalg.eigvals(A)).max() for A in algebra.projected(draws))
    stream = co.systems.Weights(1 / np.add.outer(1.0 + np.arange(n) / n, 1.0 + np.arange(n) / n))
    system = co.MatrixSystem(algebra, stream, linear=size * constant, name="turned")
    end = co.integrate(system, W, (0, steps * h), h, co.IsospectralGauss()).x[-1]
    found, before = (np.sort(np.linalg.eigvals(A).imag) for A in (end, W))
    # Without pivots, entries of an elimination grow up to the condition, and their rounding by the condition again.
    assert np.abs(found - before).max() < (2 * n + size**2 * np.sqrt(steps)) * 2 * U


@pytest.mark.parametrize(("n", "steps"), [(16, 5000), pytest.param(64, 10**4, marks=pytest.mark.long)])
def test_the_spectrum_of_long_isospectral_runs_stays(n, steps):
    """And the energy is bounded by the square of the step, without a trend."""
    system = SPHERE(N=n)
    W = start(system, seed=7)
    h = turning(system, W, 0.1)
    run = co.integrate(system, W, (0, steps * h), h, co.IsospectralGauss(), save_every=steps // 100)
    found = system.spectrum(run.x)
    # Each step rounds the middle once, by which W moves h |P| times as much; the roundings add up like a walk.
    assert np.abs(found - found[0]).max() < max(0.6 * np.sqrt(steps), 4 * n) * U * np.abs(found).max()
    away = (run.energy - run.energy[0]) / run.energy[0]
    first, second = np.array_split(away, 2)
    assert np.abs(away).max() < 0.02 and abs(second.mean() - first.mean()) < 4 * away.std()


@pytest.mark.parametrize("kind", [SPHERE, co.systems.reduced_mhd], ids=["one layer", "two layers"])
def test_plain_isospectral_steps_that_fail_name_their_time(kind):
    system = kind(N=5)
    W = 100 * np.random.default_rng(2).standard_normal(system.dim)
    for state in (W, system.matrices(W)):
        for call in (co.IsospectralGauss().step, co.IsospectralGauss().tangent):
            with refused(co.IntegrationError) as failure:
                call(system, state, -3.0, 1.0)
            assert (failure.value.time, failure.value.step) == (-3.0, 1)


@pytest.mark.thinned(12)
@pytest.mark.parametrize("scheme", [co.IsospectralGauss(1), co.IsospectralGauss(2), co.CommutatorFree(3)], ids=str)
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("h", [0.3, -0.3])
def test_tangents_along_a_nonlinear_stream_that_depends_on_time(scheme, size, h):
    """States and steps of any scale: W -> size W and t -> t / size leave the derivative as it is."""

    def stream(W, t):
        return (1.0 + 0.5 * np.sin(3.0 * size * t)) * (W + W**3 / size**2).T

    def energy(W, t):
        return (1.0 + 0.5 * np.sin(3.0 * size * t)) * np.sum(W**2 / 2 + W**4 / (4 * size**2))

    system = co.MatrixSystem(co.MatrixAlgebra("gl", 3), stream, energy=energy)
    W = size * np.random.default_rng(5).uniform(-0.5, 0.5, (3, 3))
    step = co.stepper(system, scheme, h / size)
    x, e = system.to_vector(W), 2.0**-9 * size
    columns = []
    for unit in np.eye(9):
        ends = [step(system.from_vector(x + d * unit), t=0.4 / size) for d in (e, -e, e / 2, -e / 2)]
        wide, narrow = (ends[0] - ends[1]) / (2 * e), (ends[2] - ends[3]) / e
        columns.append(system.to_vector((4 * narrow - wide) / 3))
    # Streams given as functions are differentiated to nine digits; Richardson's difference has ten.
    np.testing.assert_allclose(step.tangent(W, t=0.4 / size), np.stack(columns, axis=1), rtol=0, atol=1e-7)
    assert step.tangent_by(W) == "differences"


def cubic_stream(algebra, *traceless):
    """Return the system of H = sum |W_ij|^4 / 4 on matrices without a trace in these blocks of rows."""
    blocks = np.array(traceless)

    def stream(W):
        P = np.zeros_like(W)
        for i in range(len(W)):
            for j in range(len(W)):
                P[j, i] = W[i, j].conjugate() * (W[i, j].real ** 2 + W[i, j].imag ** 2)
        for first, last in blocks:
            mean = 0.0 * P[0, 0]
            for i in range(first, last):
                mean += P[i, i] / (last - first)
            for i in range(first, last):
                P[i, i] -= mean
        return P

    return co.MatrixSystem(algebra, stream, energy=lambda W: np.sum(np.abs(W) ** 4) / 4)


MATRICES = co.MatrixAlgebra
TRACELESS = {
    "sl(3)": (MATRICES("sl", 3), (0, 3)),
    "sl(3, C)": (MATRICES("sl(C)", 3), (0, 3)),
    "sl(2) + gl(2) + sl(3)": (MATRICES.sum(MATRICES("sl", 2), MATRICES("gl", 2), MATRICES("sl", 3)), (0, 2), (4, 7)),
}


@pytest.mark.parametrize("name", TRACELESS)
def test_streams_of_stages_with_a_trace_are_those_without(name):
    """Stages leave an algebra of trace zero; the compiled function and the plain one see them in it."""
    system = cubic_stream(*TRACELESS[name])
    W = system.algebra.projected(system.from_vector(np.random.default_rng(1).uniform(-1.0, 1.0, system.dim)))
    for stages in (1, 2):
        scheme = co.IsospectralGauss(stages)
        found, plain = co.stepper(system, scheme, 0.2)(W), scheme.step(system, W, 0.0, 0.2)
        assert np.abs(found - plain).max() < 256 * U * np.abs(W).max()


@pytest.mark.parametrize("h", [1.0, -3.0])
def test_commutator_free_steps_for_streams_of_any_shape(h):
    """In one exponential, in several substeps; sums of rows and columns of the stream may differ."""
    for P in (np.diag([0.9, 0.0, -0.9, 0.4]), np.ones((4, 1)) * [1.2, 0.0, 0.0, -0.3], 2.0 * np.eye(4, k=2)):
        system = co.MatrixSystem(co.MatrixAlgebra("gl", 4), co.systems.Weights(np.zeros((4, 4))), P)
        W = np.random.default_rng(3).uniform(-1.0, 1.0, (4, 4))
        exact, scale = expm(h * P) @ W @ expm(-h * P), np.abs(expm(h * P)) @ np.abs(W) @ np.abs(expm(-h * P))
        for order in (2, 3, 4):
            method = co.CommutatorFree(order)
            for found in (method.step(system, W, 0.0, h), last(system, W, h, 1, method)):
                # Substeps of norm one, each a series with sums of at most exp(1): some roundings of each.
                assert np.abs(found - exact).max() < 256 * U * scale.max()


@pytest.mark.thinned(2)
@pytest.mark.parametrize("N", [5, 7, 17, 19, 37, 61])
def test_steps_of_lines_are_the_plain_ones(N):
    """Every way of a transform: fewer lanes than eight, eight side by side, columns around the end, convolutions.

    For N = 17 the last of the diagonals 0 to 8 is alone in its group of eight.
    """
    system = TORUS(N=N)
    W = smooth(system, N)
    for h in (0.2, -0.3):
        found, plain = last(system, W, h, 1, co.LineSplitting()), co.LineSplitting().step(system, W, 0.0, h)
        assert np.abs(found - plain).max() < 16 * N * U * np.abs(W).max()
        assert np.abs(found - W).max() > 1e-3 * np.abs(W).max()
        flat = co.LineSplitting().step(system, system.to_vector(W), 0.0, h)
        assert np.array_equal(flat, system.to_vector(plain))


def test_lines_of_another_stream_of_modes():
    """Any factors by which a stream multiplies modes are split, such as those of waves with a finite radius."""
    N, back = 7, -np.arange(7) % 7
    spectrum = np.random.default_rng(5).uniform(-1.0, 1.0, (N, N))
    spectrum[0, 0] = 0.0
    # The same for d and N - d, even in k: what a circulant stream is.
    spectrum = (spectrum + spectrum[back] + spectrum[:, back] + spectrum[back][:, back]) / 4
    system = co.MatrixSystem(co.MatrixAlgebra("su", N), co.systems.Circulants(spectrum), name="waves")
    W = smooth(system, 3)
    exact = last(system, W, 1.0, 32, co.IsospectralGauss(6))
    assert np.abs(last(system, W, 1.0, 64, co.LineSplitting(6)) - exact).max() < 1e-12 * np.abs(W).max()


def test_rounding_of_lines_has_no_preferred_sign():
    """Fifty thousand steps: what one of them rounds, a hundredth of a unit, adds up like a root, not in a line."""
    system = TORUS(N=5)
    W = smooth(system, 3)
    sol = co.integrate(system, W, (0.0, 1e4), 0.2, co.LineSplitting(), save_every=10000, watch=False)
    spectrum = system.spectrum(sol.x)
    assert np.abs(spectrum - spectrum[0]).max() < 32 * U * np.abs(spectrum[0]).max()
    assert np.array_equal(sol.x[-1], -np.conj(sol.x[-1].T))
