"""Frequencies of sums of lines that are known, and of runs."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(3)

U = 2.0**-53


def random_lines(seed: int, count: int):
    """Return times, frequencies, amplitudes over six decades, and phases; the lines at least ten bins apart."""
    rng = np.random.default_rng(seed)
    samples, span = int(rng.integers(4000, 9000)), rng.uniform(500.0, 1500.0)
    t = rng.uniform(-50.0, 50.0) + span / samples * np.arange(samples)
    apart = 10 * 2 * np.pi / span
    while True:
        w = rng.uniform(apart, 0.9 * np.pi * samples / span, count)
        if count == 1 or np.min(np.diff(np.sort(w))) > apart:
            return t, w, 10.0 ** -np.linspace(0.0, 6.0, count), rng.uniform(0.0, 2 * np.pi, count)


@pytest.mark.thinned(24)
@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("count", [1, 2, 4, 6])
def test_lines_over_six_decades(seed: int, count: int):
    t, w, a, phase = random_lines(100 * count + seed, count)
    found = co.frequencies(t, 0.3 + np.cos(np.multiply.outer(t, w) + phase) @ a, count=count)
    # Arguments up to w t are rounded, by u w t each; relative to the line, over the span.
    span = t[-1] - t[0]
    rounding = 8 * U * (1.0 + np.max(w) * np.max(np.abs(t)))
    assert np.all(np.abs(found.frequency - w) <= rounding / a / span)
    assert np.all(np.abs(found.frequency - w) <= 1e-10 * w)
    assert np.all(np.abs(found.amplitude - a * np.exp(1j * phase)) <= 4 * rounding)
    assert found.mean == pytest.approx(0.3, abs=rounding)
    assert np.all(np.abs(found.frequency - w) <= 10 * found.uncertainty)
    assert np.all(found.uncertainty <= rounding / a / span * 10)
    assert found(t[:9]) == pytest.approx(0.3 + np.cos(np.multiply.outer(t[:9], w) + phase) @ a, abs=8 * rounding)


def test_complex_signals_have_frequencies_of_both_signs():
    t = np.arange(3000) * 0.3 - 200.0
    signal = (2 + 1j) * np.exp(0.7j * t) + 1e-3j * np.exp(-1.3j * t) + 0.25j
    found = co.frequencies(t, signal, count=2)
    assert found.frequency == pytest.approx([0.7, -1.3], abs=1e-13)
    assert found.amplitude == pytest.approx([2 + 1j, 1e-3j], abs=1e-12)
    assert found.mean == pytest.approx(0.25j, abs=1e-13)
    assert found(t) == pytest.approx(signal, abs=1e-12)


def test_channels_share_their_frequencies():
    t = np.arange(4000) * 0.2
    first = np.cos(t) + 1e-4 * np.cos(np.sqrt(3) * t)
    second = 1e-4 * np.sin(t) + np.sin(np.sqrt(3) * t + 0.2)
    found = co.frequencies(t, np.stack([first, second, 5.0 + 0 * t], axis=1), count=2)
    order = np.argsort(found.frequency)
    assert found.frequency[order] == pytest.approx([1.0, np.sqrt(3)], abs=1e-13)
    expected = [[1.0, -1e-4j, 0.0], [1e-4, np.exp(0.2j) / 1j, 0.0]]
    assert found.amplitude[order] == pytest.approx(np.array(expected), abs=1e-12)
    assert found.mean == pytest.approx([0.0, 0.0, 5.0], abs=1e-12)


def test_members_have_their_own_means_orders_and_numbers_of_lines():
    """One line, two lines in either order of frequency, none; with two channels of different means."""
    t = np.arange(2000) * 0.3 - 100.0
    slow, fast = np.exp(0.5j * t), np.exp(2.1j * t)
    waves = [2.0 * slow, 0.1 * slow + 1.0 * fast, 3.0 * slow + 0.2 * fast, 0.0 * slow]
    means = np.array([[1.0, -2.0], [0.0, 5.0], [-7.0, 0.5], [4.0, 3.0]])
    signal = np.stack([np.stack([wave.real, -2.0 * wave.imag], axis=1) for wave in waves], axis=1) + means
    found = co.frequencies(t, signal, count=2)
    wanted = [[0.5, np.nan], [2.1, 0.5], [0.5, 2.1], [np.nan, np.nan]]
    np.testing.assert_allclose(found.frequency, wanted, rtol=0, atol=1e-12)
    sizes = [[2.0, np.nan], [1.0, 0.1], [3.0, 0.2], [np.nan, np.nan]]
    expected = np.multiply.outer(sizes, [1.0, 2.0j])  # -2 Im z is Re(2i z)
    np.testing.assert_allclose(found.amplitude, expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.mean, means, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found(t[::50]), signal[::50], rtol=0, atol=1e-10)
    np.testing.assert_allclose(found(t[7]), signal[7], rtol=0, atol=1e-10)
    alone = co.frequencies(t, signal[:, 0], count=2)
    np.testing.assert_allclose(alone(t[7]), signal[7, 0], rtol=0, atol=1e-10)
    assert co.frequencies(t, signal[:, 0, 0], count=2)(t[7]) == pytest.approx(signal[7, 0, 0], abs=1e-10)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("kind", ["real", "complex", "complex, negative"])
def test_diffusion_is_the_later_frequency_minus_the_earlier_one(kind: str, sense: float):
    """Of w + 2 c t the halves have mean frequencies that differ by c times the span; later is further along."""
    t = sense * np.arange(1501) * 0.2
    rate, c = (-1.5 if kind == "complex, negative" else 1.5), 2e-5
    phase = rate * t + c * t * np.abs(t)
    signal = np.cos(phase) if kind == "real" else np.exp(1j * phase)
    found = co.frequencies(t, signal, count=1)
    # The window weights a half symmetrically, and the chirp is slow: 0.05 radians off a line over the span.
    assert found.diffusion[0] == pytest.approx(sense * c * abs(t[-1]) * sense, rel=1e-3)
    assert found.uncertainty[0] > 0.0


@pytest.mark.parametrize("complex_signal", [False, True])
def test_the_residual_is_the_root_mean_square_of_what_is_left(complex_signal: bool):
    t = np.arange(4000) * 0.2
    weak = np.array([[0.03, 0.04], [0.0, 0.1]])  # members and channels
    wave, left = np.exp(0.7j * t), np.exp(2.2j * t)
    signal = wave[:, None, None] + left[:, None, None] * weak
    found = co.frequencies(t, signal if complex_signal else signal.real, count=1)
    size = np.sqrt(np.sum(weak**2, axis=1)) / (1.0 if complex_signal else np.sqrt(2.0))
    assert found.residual == pytest.approx(size, rel=1e-3)


def test_a_wider_window_suppresses_the_lines_that_are_left_out():
    """By m^-(2p+1) at m bins, here 19.6: by some 380 for each power."""
    t = np.arange(2001) * 0.1
    # One more line than wanted is taken along, so that two are needed here.
    weak = 0.1 * np.cos((1.0 + 19.6 * 2 * np.pi / 200.0) * t) + 0.2 * np.cos(17.0 * t)
    errors = [abs(co.frequencies(t, np.cos(t) + weak, 1, p).frequency[0] - 1.0) for p in (1, 2, 3)]
    assert errors[0] > 20.0 * errors[1] > 400.0 * errors[2] > 0.0


def test_as_many_lines_as_the_samples_resolve():
    t = np.arange(16 * 8) * 0.5
    assert co.frequencies(t, np.cos(t), count=8, window=1).frequency.shape == (8,)
    with refused(ValueError, "count", "9", "128", "8"):
        co.frequencies(t, np.cos(t), count=9, window=1)
    for window in (0, 13):
        with refused(ValueError, "window"):
            co.frequencies(t, np.cos(t), window=window)


def test_what_is_not_there_is_no_line():
    t = np.arange(3000) * 0.25
    found = co.frequencies(t, np.cos(t) + 1e-3 * np.cos(1.7 * t), count=4)
    assert np.isfinite(found.frequency).tolist() == [True, True, False, False]
    assert np.isnan(found.amplitude[2:]).all() and found.residual < 1e-12
    constant = co.frequencies(t, np.full(3000, 2.5), count=2)
    assert np.isnan(constant.frequency).all() and constant.mean == pytest.approx(2.5)


def test_attitude_has_two_frequencies():
    body, x0 = co.systems.rigid_body(inertia=(1, 2, 3)), np.array([1.0, 0.2, 0.5])
    run = co.integrate(body, x0, (0.0, 800.0), 0.1, co.GaussLegendre(6), attitude=True)
    nutation = 2 * np.pi / co.analysis.period(body.vector_field, x0).time
    found = co.frequencies(run, "attitude", count=8)
    lines = found.combinations([found.frequency[0], nutation])
    assert np.all(lines.found) and np.max(np.abs(lines.misfit)) < 1e-11
    free = found.combinations()
    assert free.basis.shape == (2,) and np.all(free.found)


def lines_at(w, uncertainty, real=True):
    """Return lines of amplitude one."""
    w = np.asarray(w)
    return co.Frequencies(w, np.ones(len(w), complex), np.asarray(uncertainty), 0.0 * w, 0.0, 0.0, real)


def test_combinations_stay_within_the_largest_integer():
    found = lines_at([5.0], [1e-9])
    assert found.combinations([1.0], largest=5).integers.tolist() == [[5]]
    near = found.combinations([1.0], largest=4)
    assert (near.integers.tolist(), near.misfit.tolist(), near.found.tolist()) == ([[4]], [1.0], [False])
    # 5 is 5 + 0 and 1 + 2 * 2: the sum of the integers decides.
    assert found.combinations([1.0, 2.0], largest=5).integers.tolist() == [[1, 2]]
    # The uncertainty of a line that is chosen as basis counts as often as it occurs: 5 - 5 * 0.99 is 0.05.
    pair = lines_at([0.99, 5.0], [3e-3, 0.0])
    assert pair.combinations(largest=5).integers.tolist() == [[1], [5]]
    assert pair.combinations([0.99], largest=5).found.tolist() == [True, False]


def drawn_combinations(seed: int):
    """Return basic frequencies, their uncertainties, and integers of either sign, no row twice."""
    rng = np.random.default_rng(seed)
    d = int(rng.integers(1, 4))
    basis = rng.choice([-1.0, 1.0], d) * np.sqrt([2.0, 3.0, 5.0])[:d] * rng.uniform(0.5, 2.0, d)
    integers = np.array([row for row in rng.integers(-3, 4, (40, d)) if np.sum(np.abs(row)) > 1])
    return rng, basis, 10.0 ** rng.uniform(-11.0, -9.0, d), np.unique(integers, axis=0)


@pytest.mark.parametrize("seed", range(12))
def test_the_uncertainties_of_all_lines_of_a_combination_add_up(seed: int):
    """Whatever the signs of the integers: off by 0.9 of the sum it is found, by 1.1 it is not."""
    rng, basis, known, integers = drawn_combinations(seed)
    own = 10.0 ** rng.uniform(-11.0, -9.0, len(integers))
    slack = 4.0 * own + np.abs(integers) @ (4.0 * known)
    side = rng.choice([-1.0, 1.0], len(integers))
    for factor, found in ((0.9, True), (1.1, False)):
        w = np.concatenate([basis, integers @ basis + factor * side * slack])
        # A line of which nothing is known stands among the others, and is left out.
        w, uncertainty = (np.insert(row, len(basis), np.nan) for row in (w, np.concatenate([known, own])))
        lines = lines_at(w, uncertainty)
        combined = lines.combinations(basis=None if found else basis, largest=3)
        assert np.array_equal(combined.basis, basis)
        # 343 combinations of numbers up to 20 are farther apart than 1e-7, except by a coincidence.
        assert np.array_equal(combined.integers, np.concatenate([np.eye(len(basis)), integers]))
        if found:
            assert combined.found.all()
            np.testing.assert_allclose(combined.misfit[len(basis) :], 0.9 * side * slack, rtol=1e-3)
    # Without a combination within the uncertainty, a line is a basic frequency of its own.
    extra = integers[:1] @ basis + 1.1 * side[:1] * slack[:1]
    w, uncertainty = np.concatenate([basis, extra]), np.concatenate([known, own[:1]])
    lines = lines_at(w, uncertainty)
    assert np.array_equal(lines.combinations(largest=3).basis, w)


def test_round_off_of_a_line_is_within_its_uncertainty():
    w = 4.5 + np.array([0, 3, -3, 4, -4]) * 8.0 * U  # the uncertainty of 4 u w is 18 u, the rounding of 3 (1.5) is 9 u
    for sign in (1, -1):
        lines = lines_at(sign * w, np.zeros(5), False)
        combined = lines.combinations([1.5])
        assert combined.integers.tolist() == [[3 * sign]] * 5 and combined.found.tolist() == [True] * 3 + [False] * 2
    t = np.arange(2000) * 0.3
    assert np.all(co.frequencies(t, np.cos(1.7 * t), count=1).uncertainty >= U * 1.7)


def test_basic_frequencies_are_chosen_wherever_they_stand():
    """3 is 3 times 1 within its large uncertainty, 5.25 is not within integers up to 4; the last is 2 * 5.25 - 1."""
    w, known = np.array([1.0, 3.01, 5.25, 9.5 + 3e-5]), np.array([1e-6, 3e-3, 4e-6, 0.0])
    lines = lines_at(w, known)
    combined = lines.combinations(largest=4)
    assert combined.basis.tolist() == [1.0, 5.25] and combined.found.all()
    assert combined.integers.tolist() == [[1, 0], [3, 0], [0, 1], [-1, 2]]
    # 4 (2 * 4e-6 + 1e-6) is 3.6e-5.
    w[3] = 9.5 + 4e-5
    assert lines.combinations([1.0, 5.25], largest=4).found.tolist() == [True, True, True, False]
    assert lines.combinations(largest=4).basis.tolist() == [1.0, 5.25, w[3]]
    with refused(ValueError, "combinations"):
        lines.combinations([1.0, 1.1, 1.2, 1.3, 1.4], largest=20)
    for basis in ([[1.0, 5.25]], [1e308]):
        with refused(ValueError, "float64"):
            lines.combinations(basis)


@pytest.mark.parametrize("size", [1e-15, 1.0, 1e10 / 3])
def test_times_that_were_summed_are_equidistant(size: float):
    """Up to eight units in the last place of the largest time for each of them."""
    t = 5.0 * size + np.cumsum(np.full(30_000, 0.001 * size))
    found = co.frequencies(t, np.cos(3.0 / size * t), count=1)
    assert found.frequency[0] == pytest.approx(3.0 / size, rel=1e-9)
    rounding = 16 * 2.0**-53 * t[-1] * len(t)
    for share in (0.8, 1.3):
        moved = 5.0 * size + 0.001 * size * np.arange(len(t))
        moved[len(t) // 2] += share * rounding
        if share < 1.0:
            co.frequencies(moved, np.cos(3.0 / size * moved), count=1)
            continue
        with refused(ValueError, "equidistant times"):
            co.frequencies(moved, np.cos(3.0 / size * moved), count=1)


@pytest.mark.thinned(48)
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("complex_signal", [False, True])
@pytest.mark.parametrize("power", [1, 3, 5])
@pytest.mark.parametrize("samples", [101, 801])
def test_the_effect_of_noise_is_neither_too_small_nor_too_large(samples, power, complex_signal, channels):
    """One line in white noise: true spread over claimed spread, real and complex, of all windows."""
    members, level = 400, 0.1
    rng = np.random.default_rng(samples + power)
    t = np.linspace(-1.0, 1.0, samples)
    w = 40.0 + rng.uniform(0.0, 3.0, members)
    wave = np.exp(1j * np.multiply.outer(t, w))[..., None] * np.arange(1.0, channels + 1.0)
    noise = rng.standard_normal((2, samples, members, channels))
    signal = wave + level * (noise[0] + 1j * noise[1])
    found = co.frequencies(t, signal if complex_signal else signal.real, 1, power)
    true = np.sqrt(np.mean((found.frequency[:, 0] - w) ** 2))
    claimed = np.sqrt(np.mean(found.uncertainty[:, 0] ** 2))
    # The spread of 400 draws is known to 1 / sqrt(800); six per cent more cover the median of few bins.
    assert abs(np.log(true / claimed)) < 4 / np.sqrt(2 * members) + 0.06
