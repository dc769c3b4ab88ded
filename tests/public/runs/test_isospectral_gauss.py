"""Isospectral Gauss methods: the compiled step against its formula, the spectrum, far steps, ensembles, reversal."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import coadjoint as co

pytestmark = pytest.mark.thinned(3)


def body(n: int) -> co.MatrixSystem:
    """Return a free body of n dimensions."""
    inertia = 1.0 + np.arange(n) / n
    return co.MatrixSystem(
        co.MatrixAlgebra("so", n), co.systems.Weights(1 / np.add.outer(inertia, inertia)), name="body"
    )


SYSTEMS = {
    **{f"sphere {n}": (lambda n=n: co.systems.sphere_euler(N=n)) for n in (2, 5, 8, 33)},
    **{f"torus {n}": (lambda n=n: co.systems.torus_euler(N=n)) for n in (3, 9)},
    **{f"so({n})": (lambda n=n: body(n)) for n in (3, 4, 7, 35)},
}


def start(system: co.MatrixSystem, seed: int = 1, members: int | None = None) -> np.ndarray:
    """Return random matrices of spectral radius one; smooth where a stream smooths."""
    shape = system.shape if members is None else (members, *system.shape)
    rng = np.random.default_rng(seed)
    W = rng.standard_normal(shape)
    if system.complex:
        W = W + 1j * rng.standard_normal(shape)
    W = system.stream(system.algebra.projected(W))
    return W / np.abs(np.linalg.eigvals(W)).max()


def turning(system: co.MatrixSystem, W: np.ndarray, share: float) -> float:
    """Return the step in which the fastest mode of the stream turns by `share` of a half turn."""
    return float(share * np.pi / np.abs(np.linalg.eigvals(system.stream(W))).max())


@pytest.mark.thinned(15)
@pytest.mark.parametrize("stages", [1, 2, 3])
@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("direction", [1, -1])
def test_the_compiled_step_is_the_formula(name: str, stages: int, direction: int) -> None:
    """Also after steps from which the loop guesses the next one."""
    system, scheme = SYSTEMS[name](), co.IsospectralGauss(stages)
    W = start(system)
    h = direction * turning(system, W, 0.05)
    run = co.integrate(system, W, t_span=(0, 3 * h), step=abs(h), method=scheme).x
    for before, after in pairwise(run):
        formula = scheme.step(system, before, 0.0, h)
        # The stages end where corrections of 1 stop falling; products of N entries round by some N^(1/2) units.
        assert np.abs(after - formula).max() < 16 * np.sqrt(system.shape[-1]) * np.finfo(float).eps


@pytest.mark.parametrize("name", ["sphere 8", "sphere 33", "so(7)", "torus 9"])
def test_a_step_of_a_stage_turns_the_matrix(name: str) -> None:
    """W = M - (h/2)[P, M] - (h^2/4) P M P and W + h [P, M]: both have the spectrum of W."""
    system = SYSTEMS[name]()
    W = start(system)
    h = turning(system, W, 0.2)
    after = co.integrate(system, W, t_span=(0, h), step=h, method=co.IsospectralGauss()).x[-1]
    # From both ends the middle is found: (1 - h P/2) M (1 + h P/2) = W, (1 + h P/2) M (1 - h P/2) = W', P = stream(M).
    middle = 0.5 * (W + after)
    for _ in range(60):
        P = system.stream(middle)
        middle = 0.5 * (W + after) + 0.25 * h**2 * P @ middle @ P
    P, one = system.stream(middle), np.eye(len(W))
    below, above = one - 0.5 * h * P, one + 0.5 * h * P
    assert np.abs(below @ middle @ above - W).max() < 1e-14
    assert np.abs(above @ middle @ below - after).max() < 1e-14


def dense_step(system: co.MatrixSystem, W: np.ndarray, h: float) -> np.ndarray:
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
def test_every_step_solves_the_equation_of_the_midpoint(name: str, share: float) -> None:
    """The first steps, whose stream is predicted from few earlier ones, and later ones, which replace the oldest."""
    system = co.systems.sphere_euler(N=65) if name == "sphere 65" else SYSTEMS[name]()
    W = start(system)
    h = turning(system, W, share)
    run = co.integrate(system, W, t_span=(0, 24 * h), step=h, method=co.IsospectralGauss()).x
    for before, after in pairwise(run):
        # Products of N entries round by some N^(1/2) units; the unsaved compensation is below half a unit.
        assert np.abs(after - dense_step(system, before, h)).max() < 16 * np.sqrt(len(W)) * np.finfo(float).eps


def test_predictions_of_the_stream_save_evaluations() -> None:
    """A short step evaluates the stream of W, that of the midpoint, and one correction."""
    system = co.systems.sphere_euler(N=16)
    W = start(system)
    h = turning(system, W, 0.02)
    short, long = (
        co.integrate(system, W, t_span=(0, steps * h), step=h, method=co.IsospectralGauss()).stats.evaluations
        for steps in (30, 130)
    )
    assert 300 <= long - short < 350


def test_short_steps_round_in_proportion_to_their_length() -> None:
    """A step of the fraction 1/1000 of a half turn moves W by a fraction of that size, and rounds as little of it."""
    system = co.systems.sphere_euler(N=8)
    W = start(system)
    steps, h = 40000, turning(system, W, 0.001)
    run = co.integrate(system, W, t_span=(0, steps * h), step=h, method=co.IsospectralGauss(), save_every=1000)
    # Rounding by a unit of W in each step would add up to sqrt(40000) / 3 units or more; LAPACK's are about N units.
    assert np.abs(system.spectrum(run.x) - system.spectrum(W)).max() < 2 * 8 * np.finfo(float).eps


@pytest.mark.parametrize("size", [10.0, 1000.0])
@pytest.mark.parametrize("kind", ["so", "u"])
def test_steps_far_longer_than_a_turn_keep_the_spectrum(kind: str, size: float) -> None:
    """A constant part of the stream for which the condition of 1 - (h/2) P is about (h/2) |P| = `size`."""
    n, steps, h, rng = 40, 50, 2.0, np.random.default_rng(2)
    algebra = co.MatrixAlgebra(kind, n)
    draws = rng.standard_normal((2, n, n)) + (1j * rng.standard_normal((2, n, n)) if algebra.complex else 0.0)
    W, constant = (A / np.abs(np.linalg.eigvals(A)).max() for A in algebra.projected(draws))
    stream = co.systems.Weights(1 / np.add.outer(1.0 + np.arange(n) / n, 1.0 + np.arange(n) / n))
    system = co.MatrixSystem(algebra, stream, linear=size * constant, name="turned")
    end = co.integrate(system, W, t_span=(0, steps * h), step=h, method=co.IsospectralGauss()).x[-1]
    found, before = (np.sort(np.linalg.eigvals(A).imag) for A in (end, W))
    # Without pivots, entries of an elimination grow up to the condition, and their rounding by the condition again.
    assert np.abs(found - before).max() < (2 * n + size**2 * np.sqrt(steps)) * np.finfo(float).eps


@pytest.mark.parametrize("share", [0.3, 0.6, 1.0])
def test_a_long_step_is_solved_or_refused(share: float) -> None:
    """Far from where the iteration begins, and with a rough vorticity."""
    system = co.systems.sphere_euler(N=24)
    rng = np.random.default_rng(3)
    W = system.algebra.projected(rng.standard_normal((24, 24)) + 1j * rng.standard_normal((24, 24)))
    h = turning(system, W, share)
    try:
        run = co.integrate(system, W, t_span=(0, 3 * h), step=h, method=co.IsospectralGauss())
    except co.IntegrationError as error:
        assert "step" in str(error)
        return
    size = np.abs(system.spectrum(W)).max()
    assert np.abs(system.spectrum(run.x) - system.spectrum(W)).max() < 1e-13 * size


@pytest.mark.parametrize(
    ("n", "steps"),
    [
        (16, 5000),
        pytest.param(16, 10**6, marks=pytest.mark.long),
        pytest.param(64, 10**4, marks=pytest.mark.long),
    ],
)
def test_the_spectrum_stays(n: int, steps: int) -> None:
    """And the energy is bounded by the square of the step, without a trend."""
    system = co.systems.sphere_euler(N=n)
    W = start(system, seed=7)
    h = turning(system, W, 0.1)
    every = steps // 100
    run = co.integrate(system, W, t_span=(0, steps * h), step=h, method=co.IsospectralGauss(), save_every=every)
    found = system.spectrum(run.x)
    # Each step rounds the middle once, by which W moves h |P| times as much; the roundings add up like a walk.
    walk = 0.3 * np.finfo(float).eps * np.sqrt(steps)
    assert np.abs(found - found[0]).max() < max(walk, 2 * n * np.finfo(float).eps) * np.abs(found).max()
    away = (run.energy - run.energy[0]) / run.energy[0]
    half = len(away) // 2
    assert np.abs(away).max() < 0.02
    # The mean of a half of the run differs from that of the other by less than the energy goes to and fro.
    assert abs(away[half:].mean() - away[:half].mean()) < 4 * away.std()


@pytest.mark.thinned(6)
@pytest.mark.parametrize("stages", [2, 3])
@pytest.mark.parametrize(("kind", "n"), [("gl", 3), ("so", 5), ("u", 5)])
def test_slow_iterations_come_to_their_end(kind: str, n: int, stages: int) -> None:
    """With complex eigenvalues corrections rise and fall while they shrink; none of the rises is the end."""
    algebra, rng = co.MatrixAlgebra(kind, n), np.random.default_rng(n)
    seen = 0
    for share in (0.15, 0.2, 0.25, 0.3, 0.35, 0.4) * 3:
        weights = rng.random((n, n))
        system = co.MatrixSystem(algebra, co.systems.Weights(weights + weights.T), name="random")
        W = rng.standard_normal((n, n)) + 1j * system.complex * rng.standard_normal((n, n))
        W = algebra.projected(W if system.complex else W.real)
        W = W / np.abs(np.linalg.eigvals(W)).max()
        h = turning(system, W, share)
        try:
            run = co.integrate(system, W, t_span=(0, 4 * h), step=h, method=co.IsospectralGauss(stages))
        except co.IntegrationError:
            continue
        seen += 1
        largest = np.abs(run.x).max() * n
        for name, trace in system.casimirs.items():
            values, power = np.array([trace(x) for x in run.x]), int(name.partition("^")[2] or 1)
            assert np.abs(values - values[0]).max() < 1e-13 * max(1.0, largest) ** power, (share, name)
    assert seen > 4


@pytest.mark.parametrize("kind", [co.systems.sphere_euler, co.systems.reduced_mhd], ids=["one layer", "two layers"])
def test_a_plain_step_that_fails_names_its_time(kind) -> None:
    system, rng = kind(N=5), np.random.default_rng(2)
    W = 100 * rng.standard_normal(system.dim)
    for state in (W, system.matrices(W)):
        for run in (co.IsospectralGauss().step, co.IsospectralGauss().tangent):
            with pytest.raises(co.IntegrationError) as failed:
                run(system, state, -3.0, 1.0)
            assert failed.value.time == -3.0 and failed.value.step == 1


@pytest.mark.parametrize("stages", [1, 2])
def test_the_tangent_of_two_layers_takes_matrices_and_coordinates(stages) -> None:
    system, rng = co.systems.reduced_mhd(N=3), np.random.default_rng(2)
    W, scheme = 0.1 * rng.standard_normal(system.dim), co.IsospectralGauss(stages)
    after, by_numbers = scheme.tangent(system, W, 0.5, 0.25)
    moved, by_matrices = scheme.tangent(system, system.matrices(W), 0.5, 0.25)
    assert np.array_equal(after, moved) and np.array_equal(by_numbers, by_matrices)
    assert np.array_equal(after, scheme.step(system, W, 0.5, 0.25))


def test_tangents_along_a_nonlinear_stream_converge_wherever_the_steps_do() -> None:
    """Steps of up to a hundred iterations, in which the errors of differences could end in a cycle."""
    system = co.MatrixSystem(
        co.MatrixAlgebra("gl", 3), lambda W: (W + W**3).T, energy=lambda W: np.sum(W**2 / 2 + W**4 / 4)
    )
    scheme, d = co.IsospectralGauss(), 2.0**-17
    for seed in (0, 11, 12, 17):
        x = np.random.default_rng(seed).uniform(-0.5, 0.5, 9)
        ends = [[scheme.step(system, x + side * unit, 0.0, 0.5) for unit in d * np.eye(9)] for side in (1, -1)]
        differences = (np.array(ends[0]) - np.array(ends[1])).T / (2 * d)
        # Both are central differences, with rounding errors of some 2^17 u = 1.5e-11.
        np.testing.assert_allclose(scheme.tangent(system, x, 0.0, 0.5)[1], differences, rtol=0, atol=1e-9)


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
