"""The splitting of the fluid on the torus into lines: its order, what it keeps, and what it refuses."""

import itertools

import numpy as np
import pytest
from torus_flows import first_modes, last_modes, smooth, translation

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF

ORDERS = [2, 4, 6]


def last(system, W, span, steps, method):
    return co.integrate(system, W, span, abs(span[1] - span[0]) / steps, method, save_every=steps, watch=False).x[-1]


@pytest.mark.thinned(2)
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("N", [3, 5, 7])
def test_order_against_forty_digits(N, order):
    system = co.systems.torus_euler(N=N)
    start, end = system.from_modes(first_modes(N)), system.from_modes(last_modes(N))
    counts = {2: (16, 32, 64), 4: (2, 4, 8), 6: (1, 2, 4)}[order]
    errors = [np.abs(last(system, start, (0.0, 1.0), n, co.LineSplitting(order)) - end).max() for n in counts]
    kept = [e for e in errors if e > 2e-15]  # below, there is rounding
    slopes = [np.log2(a / b) for a, b in itertools.pairwise(kept)]
    assert all(abs(slope - order) < 0.35 for slope in slopes)
    assert len(slopes) >= (2 if order == 2 else 0 if N == 3 and order == 6 else 1)
    # 64 steps of order 6, and 256 of order 4, leave 1e-12
    if order > 2:
        steps = 256 if order == 4 else 64
        assert np.abs(last(system, start, (0.0, 1.0), steps, co.LineSplitting(order)) - end).max() < 1e-12


@pytest.mark.thinned(2)
@pytest.mark.parametrize("N", [5, 7, 17, 19, 37, 61])
def test_the_kernels_do_the_plain_reading(N):
    """Every way of a transform: fewer lanes than eight, eight side by side, columns around the end, convolutions.

    For N = 17 the last of the diagonals 0 to 8 is alone in its group of eight.
    """
    system = co.systems.torus_euler(N=N)
    W = smooth(system, N)
    for h in (0.2, -0.3):
        found = last(system, W, (0.0, h), 1, co.LineSplitting())
        plain = co.LineSplitting().step(system, W, 0.0, h)
        assert np.abs(found - plain).max() < 16 * N * UNIT_ROUNDOFF * np.abs(W).max()
        assert np.abs(found - W).max() > 1e-3 * np.abs(W).max()
        flat = co.LineSplitting().step(system, system.to_vector(W), 0.0, h)
        assert np.array_equal(flat, system.to_vector(plain))


def test_another_stream_of_modes():
    """Any factors by which a stream multiplies modes are split, such as those of waves with a finite radius."""
    N, rng = 7, np.random.default_rng(5)
    factors = rng.uniform(-1.0, 1.0, (N, N))
    back = -np.arange(N) % N
    factors = (factors + factors[back][:, back]) / 2
    factors[0, 0] = 0.0
    spectrum = np.empty((N, N))
    spectrum[:, 2 * np.arange(N) % N] = factors.T
    # the same for d and N - d, even in k: what a circulant stream is
    spectrum = (spectrum + spectrum[back] + spectrum[:, back] + spectrum[back][:, back]) / 4
    system = co.MatrixSystem(co.MatrixAlgebra("su", N), co.systems.Circulants(spectrum), name="waves")
    W = smooth(system, 3)
    exact = last(system, W, (0.0, 1.0), 32, co.IsospectralGauss(6))
    assert np.abs(last(system, W, (0.0, 1.0), 64, co.LineSplitting(6)) - exact).max() < 1e-12 * np.abs(W).max()


@pytest.mark.parametrize("order", [2, 6])
def test_spectrum_energy_and_reality(order):
    """The spectrum moves by rounding alone, like the root of time; W stays skew-Hermitian to the last bit."""
    system = co.systems.torus_euler(N=11)
    W = smooth(system, 8)
    span = (0.0, 400.0 if order == 2 else 80.0)
    sol = co.integrate(system, W, span, 0.2, co.LineSplitting(order), save_every=100)
    spectrum = system.spectrum(sol.x)
    assert np.abs(spectrum - spectrum[0]).max() < 1e-14 * np.abs(spectrum[0]).max()
    assert np.array_equal(sol.x[-1], -np.conj(sol.x[-1].T))
    assert np.abs(np.trace(sol.x[-1])) < 1e-14 * np.abs(W).max()
    half = co.integrate(system, W, span, 0.1, co.LineSplitting(order), save_every=200)
    ratio = sol.drift()["energy"] / half.drift()["energy"]
    if order == 2:
        assert 3.0 < ratio < 5.5
    assert 1e-15 < sol.drift()["energy"] < 0.01


def test_rounding_prefers_no_sign():
    """Fifty thousand steps: what one of them rounds, a hundredth of a unit, adds up like a root, not in a line."""
    system = co.systems.torus_euler(N=5)
    W = smooth(system, 3)
    sol = co.integrate(system, W, (0.0, 1e4), 0.2, co.LineSplitting(), save_every=10000, watch=False)
    spectrum = system.spectrum(sol.x)
    assert np.abs(spectrum - spectrum[0]).max() < 32 * UNIT_ROUNDOFF * np.abs(spectrum[0]).max()


def test_a_line_alone_rests():
    """Modes of one line commute: the fluid rests, and no step moves it beyond rounding."""
    system = co.systems.torus_euler(N=7)
    W = system.from_modes({(1, 2): 0.7 - 0.2j, (2, -3): 0.4j})
    assert np.abs(system.vector_field(W)).max() < 1e-15
    assert np.abs(last(system, W, (0.0, 20.0), 100, co.LineSplitting(4)) - W).max() < 2e-14


def test_backward_in_time_is_the_mirrored_fluid():
    """-W moves as W does backward."""
    system = co.systems.torus_euler(N=7)
    W = smooth(system, 10)
    back = last(system, W, (0.0, -2.0), 20, co.LineSplitting(4))
    assert np.abs(last(system, -W, (0.0, 2.0), 20, co.LineSplitting(4)) + back).max() < 1e-14 * np.abs(W).max() * 20


@pytest.mark.parametrize("m", [(1, 0), (2, -3)])
def test_a_translated_fluid_moves_as_before(m):
    """T W T* is W, translated: every mode turns by a phase."""
    system = co.systems.torus_euler(N=7)
    T, W = translation(7, m), smooth(system, 11)
    translated = system.algebra.projected(T @ W @ np.conj(T.T))
    seen = system.mode_array(translated)
    assert np.abs(np.abs(seen) - np.abs(system.mode_array(W))).max() < 1e-14
    assert np.abs(seen - system.mode_array(W)).max() > 0.1
    method = co.LineSplitting()
    moved = last(system, W, (0.0, 3.0), 30, method)
    again = last(system, translated, (0.0, 3.0), 30, method)
    assert np.abs(again - T @ moved @ np.conj(T.T)).max() < 1e-13 * np.abs(W).max()


def test_refusals():
    method = co.LineSplitting()
    for system in (co.systems.sphere_euler(N=5), co.systems.rigid_body((1, 2, 3))):
        with refused(ValueError, "LineSplitting", system.name):
            method.properties(system)
    body = co.MatrixSystem(co.MatrixAlgebra("so", 5), co.systems.Weights(np.ones((5, 5))), name="body")
    with refused(ValueError, "LineSplitting", "body"):
        co.integrate(body, np.zeros((5, 5)), (0, 1), 0.1, method)
    for N in (9, 15, 49):
        with refused(ValueError, "N of torus_euler", N):
            method.properties(co.systems.torus_euler(N=N))
    for order in (1, 3, 5, 12, "two", 2.5):
        with refused((ValueError, TypeError), "order", order):
            co.LineSplitting(order)


def test_properties():
    said = co.LineSplitting(4).properties(co.systems.torus_euler(N=5))
    assert said.poisson and said.casimirs == "all" and not said.energy
    assert co.LineSplitting(4).fractions == pytest.approx(co.LineSplitting(4).fractions[::-1], abs=0)
    assert sum(co.LineSplitting(6).fractions) == pytest.approx(1.0, abs=1e-15)
