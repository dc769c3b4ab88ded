"""Random numbers of the kernels: the published answers of the generator, NumPy's, and the normal distribution."""

import ctypes

import numpy as np
import pytest
from scipy import special, stats

from coadjoint.kernels.library import kernels
from coadjoint.kernels.tables.structures import address
from coadjoint.systems.forces.base import normal_deviates, random_words

U = 2.0**-53


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
