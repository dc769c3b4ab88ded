"""Arithmetic of the kernels against 50 digits, LU factors against exact solutions, and random numbers."""

import ctypes
import math
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from scipy import special, stats

from coadjoint.kernels.library import kernels
from coadjoint.kernels.tables.compiled import address
from coadjoint.systems.forces.base import normal_deviates, random_words
from float_modes import MODES, float_mode
from rounding import UNIT_ROUNDOFF as U


def has_compiled_bracket(what, values):
    """Return pairs of numbers by the compiled functions: 0, sine and cosine minus one; 1, their hyperbolic kin."""
    values = np.array(values, dtype=float)
    out = np.empty((values.size, 2))
    kernels().probe_pairs(ctypes.c_int64(what), address(values), ctypes.c_int64(values.size), address(out))
    return out


rotations, hyperbolics = 0, 1


def fused(a, b, c):
    probe = kernels().probe_fma
    probe.restype = ctypes.c_double
    return probe(*(ctypes.c_double(number) for number in (a, b, c)))


def around_multiples_of_half_pi():
    rng = np.random.default_rng(1)
    numbers = np.concatenate([np.arange(1, 40), rng.integers(40, 636619, 400), 10 ** np.arange(1, 6)])
    near = numbers * (math.pi / 2)
    steps = [near]
    for _ in range(3):
        steps.append(np.nextafter(steps[-1], np.inf))
    return np.concatenate([*steps, near * (1 + 1e-9), near * (1 - 1e-6)])


def random_magnitudes(low, high, count, seed):
    rng = np.random.default_rng(seed)
    return rng.choice([-1.0, 1.0], count) * 10 ** rng.uniform(low, high, count)


ANGLES = {
    "every magnitude": random_magnitudes(-150, 6, 1500, 2),
    "one turn": np.random.default_rng(3).uniform(-2 * math.pi, 2 * math.pi, 3000),
    "around multiples of pi/2": around_multiples_of_half_pi(),
    "at the octants": np.arange(-40, 41) * (math.pi / 4),
    "beyond 10^6": random_magnitudes(6, 15, 300, 4),
    "at the edge": np.array([1e6, np.nextafter(1e6, 0), np.nextafter(1e6, 2e6), -1e6]),
}


def ulps(value, exact):
    return abs(mpmath.mpf(float(value)) - exact) / mpmath.mpf(float(np.spacing(abs(float(exact)))))


@pytest.mark.thinned(2)
@pytest.mark.parametrize("where", ANGLES)
def test_sine_and_cosine_minus_one_within_3_ulp(where):
    angles = ANGLES[where]
    with mpmath.workdps(50):
        for angle, (sine, lowered) in zip(angles, has_compiled_bracket(rotations, angles), strict=True):
            phi = mpmath.mpf(float(angle))
            assert ulps(sine, mpmath.sin(phi)) <= 3, angle
            assert ulps(lowered, -2 * mpmath.sin(phi / 2) ** 2) <= 3, angle


GROWTHS = {
    "every magnitude": random_magnitudes(-300, 2.84, 1500, 7),
    "about one": np.random.default_rng(8).uniform(-3, 3, 3000),
    "at halves of ln 2": np.concatenate(
        [np.arange(-80, 81) * (math.log(2) / 2) * f for f in (1, 1 + 1e-15, 1 - 1e-15)]
    ),
    "far": np.array([699.9, 700.1, 709.7, -699.9, -700.1, -708.0]),
}


@pytest.mark.parametrize("where", GROWTHS)
def test_exponentials_within_2_ulp_and_hyperbolic_sines_within_4(where):
    values = GROWTHS[where][GROWTHS[where] != 0.0]
    with mpmath.workdps(400 if where == "every magnitude" else 50):
        for value, (whole, beyond) in zip(values, has_compiled_bracket(3, values), strict=True):
            x = mpmath.mpf(float(value))
            assert ulps(whole, mpmath.exp(x)) <= 2, value
            assert ulps(beyond, mpmath.expm1(x)) <= 2, value
        kept = values[np.abs(values) > 1e-150]  # below, the square of half of it underflows
        for value, (sine, lowered) in zip(kept, has_compiled_bracket(4, kept), strict=True):
            x = mpmath.mpf(float(value))
            assert ulps(sine, mpmath.sinh(x)) <= 4, value
            assert ulps(lowered, 2 * mpmath.sinh(x / 2) ** 2) <= 8, value


def test_exponentials_beyond_all_numbers():
    inf = np.inf
    assert np.array_equal(
        has_compiled_bracket(3, [0.0, 710.0, inf, -750.0, -inf]), [[1, 0], [inf, inf], [inf, inf], [0, -1], [0, -1]]
    )
    assert np.all(np.isnan(has_compiled_bracket(3, [np.nan])))


def test_rotations_of_zero_and_of_no_number():
    assert np.array_equal(has_compiled_bracket(rotations, [0.0]), [[0.0, 0.0]])
    assert np.all(np.isnan(has_compiled_bracket(rotations, [np.nan, np.inf, -np.inf])))


def test_rotations_are_odd_and_even():
    angles = np.concatenate([ANGLES["one turn"], ANGLES["every magnitude"]])
    there, back = has_compiled_bracket(rotations, angles), has_compiled_bracket(rotations, -angles)
    assert np.array_equal(there[:, 0], -back[:, 0]) and np.array_equal(there[:, 1], back[:, 1])


def test_rotations_have_no_bias_in_their_length():
    """(1 + c)^2 + s^2 - 1 = 2c + c^2 + s^2 is rounding: at most 8 u, and its mean is that of unbiased errors."""
    out = has_compiled_bracket(rotations, np.random.default_rng(5).uniform(-0.2, 0.2, 20000))
    with mpmath.workdps(40):
        excess = np.array([float(2 * mpmath.mpf(c) + mpmath.mpf(c) ** 2 + mpmath.mpf(s) ** 2) for s, c in out.tolist()])
    assert abs(excess).max() <= 8 * U
    assert abs(excess.mean()) <= 5 * excess.std() / math.sqrt(excess.size)


def compiled_rotations(angles, out):
    pairs = np.empty((angles.size, 2))
    kernels().probe_pairs(ctypes.c_int64(2), address(angles), ctypes.c_int64(angles.size), address(pairs))
    out[:, :2] = pairs
    angle, short = kernels().probe_rational_angle, kernels().probe_shortfall
    angle.restype = short.restype = ctypes.c_double
    for k, (sine, lowered) in enumerate(pairs.tolist()):
        out[k, 2] = angle(ctypes.c_double(angles[k]), ctypes.c_double(1.5))
        out[k, 3] = short(*(ctypes.c_double(number) for number in (sine, -lowered, 1.0)))


def test_rational_rotations():
    """Sine and cosine minus one of 2 atan(phi/2) within 4 u, and what the rounded pair lacks in length."""
    rng = np.random.default_rng(2)
    angles = rng.choice([-1.0, 1.0], 500) * 10 ** rng.uniform(-8, 1, 500)
    out = np.empty((angles.size, 4))
    compiled_rotations(angles, out)
    with mpmath.workdps(50):
        for phi, (sine, lowered, angle, short) in zip(angles.tolist(), out.tolist(), strict=True):
            half = mpmath.mpf(phi) / 2
            assert abs(sine - 2 * half / (1 + half**2)) <= 4 * U * abs(sine)
            assert abs(lowered + 2 * half**2 / (1 + half**2)) <= 4 * U * abs(lowered)
            assert abs(angle - mpmath.atan(half * 1.5) * 2 / 1.5) <= 4 * U * abs(angle)
            s, c = mpmath.mpf(sine), -mpmath.mpf(lowered)
            missing = (s**2 - 2 * c + c**2) / 2
            assert abs(missing) <= 8 * U * abs(lowered)
            assert abs(short - missing) <= 2 * U * lowered**2


@pytest.mark.parametrize(
    "arguments",
    [
        random_magnitudes(-300, 0, 400, 6),
        np.random.default_rng(7).uniform(-1.0, 1.0, 1000),
        random_magnitudes(0, 4, 400, 8),
        np.array([0.0, 0.25, -0.25, np.nextafter(0.25, 0), np.nextafter(-0.25, 0), math.pi**2 * -4, -1e11]),
    ],
)
def test_entire_pair(arguments):
    """sinh(w)/w and cosh(w) - 1: 8 u relative to the largest terms, and what rounding of w = sqrt z moves, u w each."""
    with mpmath.workdps(50):
        for z, (s, c) in zip(arguments, has_compiled_bracket(hyperbolics, arguments), strict=True):
            w = mpmath.sqrt(mpmath.mpf(float(z)))
            exact_s = mpmath.re(mpmath.sinh(w) / w) if z else mpmath.mpf(1)
            exact_c = 2 * mpmath.re(mpmath.sinh(w / 2) ** 2)
            moved = float(abs(w))
            size_s = float(abs(exact_s)) if z >= 0 else min(1.0, 1 / moved)
            size_c = float(abs(exact_c)) if z >= 0 else min(0.5 * abs(z), 2.0)
            assert abs(mpmath.mpf(float(s)) - exact_s) <= (8 + moved) * U * size_s
            assert abs(mpmath.mpf(float(c)) - exact_c) <= (8 + moved) * U * size_c


def test_fma_rounds_once():
    rng = np.random.default_rng(9)
    for a, b in rng.standard_normal((200, 2)):
        error = fused(a, b, -(a * b))
        with mpmath.workdps(50):
            assert mpmath.mpf(error) == mpmath.mpf(a) * mpmath.mpf(b) - mpmath.mpf(a * b)
    assert fused(1 + 2.0**-52, 1 - 2.0**-52, -1.0) == -(2.0**-104)


def solve(A, B):
    """Return whether the matrix is regular, and the solution; four systems as lanes have the same bits, or it is -1."""
    matrix, right = A.copy(), B.copy()
    probe = kernels().probe_solve
    probe.restype = ctypes.c_int64
    size, count = ctypes.c_int64(len(A)), ctypes.c_int64(B.shape[1])
    return probe(address(matrix), size, address(right), count), right


def exact_solution(A, B):
    A = [[Fraction(v) for v in row] for row in A.tolist()]
    B = [[Fraction(v) for v in row] for row in B.tolist()]
    size = len(A)
    for k in range(size):
        pivot = next(i for i in range(k, size) if A[i][k])
        A[k], A[pivot], B[k], B[pivot] = A[pivot], A[k], B[pivot], B[k]
        for i in range(size):
            if i != k:
                factor = A[i][k] / A[k][k]
                A[i] = [a - factor * b for a, b in zip(A[i], A[k], strict=True)]
                B[i] = [a - factor * b for a, b in zip(B[i], B[k], strict=True)]
    return np.array([[float(v / A[i][i]) for v in B[i]] for i in range(size)])


@pytest.mark.parametrize("size", [1, 2, 5, 12])
@pytest.mark.parametrize("lanes", [1, 3])
def test_solution(size, lanes):
    rng = np.random.default_rng(size)
    A, B = rng.standard_normal((size, size)), rng.standard_normal((size, lanes))
    if size > 1:
        A[0, 0] = 0.0  # needs an exchange of rows
    sound, found = solve(A, B)
    assert sound == 1
    expected = exact_solution(A, B)
    # Backward stable: the error is n^2 u times the condition number times the solution.
    bound = 4 * size**2 * U * np.linalg.cond(A) * np.max(np.abs(expected))
    assert np.max(np.abs(found - expected)) <= bound


@pytest.mark.parametrize("A", [np.zeros((2, 2)), np.ones((3, 3)), np.array([[np.nan, 1.0], [1.0, 1.0]])])
def test_singular_and_undefined_matrices_are_told(A):
    assert solve(A, np.ones((len(A), 1)))[0] == 0


def philox(counter, key):
    given, out = np.array(counter, dtype=np.uint64), np.empty(4, dtype=np.uint64)
    kernels().probe_philox(address(given), *(ctypes.c_uint64(word) for word in key), address(out))
    return out.tolist()


def normals(words):
    given, out = np.array(words, dtype=np.uint64), np.empty(len(words))
    kernels().probe_normal(address(given), ctypes.c_int64(len(words)), address(out))
    return out


def deviates(seed, stream, moment, count, part=0):
    out = np.empty(count)
    numbers = ctypes.c_uint64(seed), ctypes.c_uint64(stream), ctypes.c_double(moment), ctypes.c_uint64(part)
    numbers += (ctypes.c_int64(count),)
    kernels().probe_deviates(*numbers, address(out))
    return out


# kat_vectors of Random123: philox4x64, 10 rounds.
ALL = 0xFFFFFFFFFFFFFFFF
KNOWN = [
    ((0, 0, 0, 0), (0, 0), (0x16554D9ECA36314C, 0xDB20FE9D672D0FDC, 0xD7E772CEE186176B, 0x7E68B68AEC7BA23B)),
    ((ALL,) * 4, (ALL,) * 2, (0x87B092C3013FE90B, 0x438C3C67BE8D0224, 0x9CC7D7C69CD777B6, 0xA09CAEBF594F0BA0)),
    (
        (0x243F6A8885A308D3, 0x13198A2E03707344, 0xA4093822299F31D0, 0x082EFA98EC4E6C89),
        (0x452821E638D01377, 0xBE5466CF34E90C6C),
        (0xA528F45403E61D95, 0x38C72DBD566E9788, 0xA5A1610E72FD18B5, 0x57BD43B5E52B7FE6),
    ),
]


@pytest.mark.parametrize(("counter", "key", "answer"), KNOWN)
def test_the_generator_has_its_known_answers(counter, key, answer):
    assert philox(counter, key) == list(answer)


def test_the_generator_is_that_of_numpy():
    rng = np.random.default_rng(0)
    for _ in range(20):
        counter, key = rng.integers(0, 2**63, 4, dtype=np.uint64), rng.integers(0, 2**63, 2, dtype=np.uint64)
        counter[0] = 5
        other = np.random.Philox(counter=counter - np.array([1, 0, 0, 0], dtype=np.uint64), key=key)
        assert philox(counter, key.tolist()) == other.random_raw(4).tolist()


def test_a_deviate_is_the_inverse_of_the_distribution_function():
    """Within some units in the last place, into the last of the tails, of both signs."""
    rng = np.random.default_rng(1)
    words = rng.integers(0, 2**64, 20_000, dtype=np.uint64)
    small = (np.uint64(1) << np.arange(12, 64, dtype=np.uint64)) - np.uint64(1)  # far in the tail
    words = np.concatenate(
        [words, small, small & ~np.uint64(1), small ^ np.uint64(1), np.array([0, 1], dtype=np.uint64)]
    )
    tail = (np.asarray(words >> np.uint64(12), dtype=np.float64) + 0.5) * U
    exact = np.where(words & np.uint64(1), special.ndtri(tail), -special.ndtri(tail))
    # The relative condition of the inverse is bounded where the size is; near zero its absolute error is that of U.
    assert np.max(np.abs(normals(words) - exact) / (np.abs(exact) + 1.0)) < 16 * U
    assert normals([0])[0] == -normals([1])[0] > 8.2


def test_deviates_are_normal_and_independent():
    """Moments, Kolmogorov's distance and tails of 400 000 deviates of a fixed seed, each within four deviations."""
    members, moments, coordinates = 100, 40, 100
    z = np.array([[deviates(3, m, 0.25 * k, coordinates) for k in range(moments)] for m in range(members)])
    n = z.size
    for power, mean in ((1, 0.0), (2, 1.0), (3, 0.0), (4, 3.0)):
        spread = np.sqrt(stats.norm.moment(2 * power) - mean**2)
        assert abs(np.mean(z**power) - mean) < 4 * spread / np.sqrt(n)
    assert stats.kstest(z.ravel(), "norm").pvalue > 1e-4
    for edge in (2.0, 3.0, 4.0):
        share = 2 * special.ndtr(-edge)
        assert abs(np.mean(np.abs(z) > edge) - share) < 4 * np.sqrt(share / n)
    for axis in range(3):
        one, other = np.moveaxis(z, axis, 0)[:-1], np.moveaxis(z, axis, 0)[1:]
        assert abs(np.mean(one * other)) < 4 / np.sqrt(one.size)
    assert abs(
        np.mean(z * np.array([[deviates(4, m, 0.25 * k, coordinates) for k in range(moments)] for m in range(members)]))
    ) < 4 / np.sqrt(n)


def test_the_plain_reading_draws_the_same():
    for seed, stream, moment, part, count in ((0, 0, 0.0, 0, 1), (2**63 - 1, 5, -1.75, 1, 7), (12, 2**62, 1e300, 1, 4)):
        drawn = deviates(seed, stream, moment, count, part)
        assert np.max(np.abs(drawn - normal_deviates(seed, stream, moment, part, count))) < 64 * U
    assert random_words(7, 3, -0.0, 0, 4).tolist() == random_words(7, 3, 0.0, 0, 4).tolist()
    assert deviates(7, 3, -0.0, 4).tolist() == deviates(7, 3, 0.0, 4).tolist()
    assert deviates(7, 3, 0.5, 9)[:4].tolist() == deviates(7, 3, 0.5, 4).tolist()
    every = [
        deviates(*which, 4, part).tolist()
        for which in ((7, 3, 0.5), (8, 3, 0.5), (7, 4, 0.5), (7, 3, 0.25))
        for part in (0, 1)
    ]
    assert len({tuple(one) for one in every}) == 8


TURNS = ("every magnitude", "one turn", "around multiples of pi/2", "at the octants")


@pytest.mark.parametrize("mode", [mode for mode in MODES if mode.endswith("ward")])
@pytest.mark.parametrize(
    ("what", "where"), [*((rotations, where) for where in TURNS), *((what, "growth") for what in (hyperbolics, 3, 4))]
)
def test_functions_rounded_up_or_down_are_near_those_rounded_to_nearest(mode, what, where):
    """To a unit of round-off for each of the 32 operations of a series at most."""
    arguments = np.random.default_rng(5).uniform(-20.0, 20.0, 4000) if where == "growth" else ANGLES[where]
    nearest = has_compiled_bracket(what, arguments)
    with float_mode(mode):
        rounded = has_compiled_bracket(what, arguments)
    assert 0.0 < np.max(np.abs(rounded - nearest) / np.maximum(1.0, np.abs(nearest))) <= 32 * U
