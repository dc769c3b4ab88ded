"""The correctly rounded functions of the kernels against many digits, at random and at hard arguments."""

import ctypes
import math
import re
from pathlib import Path

import mpmath
import numpy as np

import coadjoint
from coadjoint.kernels.library import kernels
from coadjoint.kernels.tables.compiled import address

SOURCE = Path(coadjoint.__file__).parent / "kernels" / "source"
SINE, EXPONENTIAL, HALF_EXPONENTIAL, LOGARITHM, ANGLE = range(5)
LARGEST, LEAST, INF = np.finfo(float).max, 5e-324, math.inf


def values(what, first, second=None):
    """Return a function of the kernels at arrays of arguments."""
    first = np.array(first, dtype=float)
    second = np.zeros_like(first) if second is None else np.array(second, dtype=float)
    out = np.empty(first.size)
    kernels().probe_rounded(
        ctypes.c_int64(what), address(first), address(second), ctypes.c_int64(first.size), address(out)
    )
    return out


def rounded(exact):
    """Return the double nearest to a number of mpmath, ties to even, also below the normal numbers."""
    if exact == 0:
        return 0.0
    size, (_, exponent) = abs(exact), mpmath.frexp(abs(exact))
    unit = max(int(exponent) - 53, -1074)
    whole = mpmath.ldexp(size, -unit)
    digits = int(mpmath.floor(whole))
    rest = whole - digits
    digits += rest > 0.5 or (rest == 0.5 and digits % 2)
    try:
        return math.copysign(math.ldexp(digits, unit), exact)
    except OverflowError:
        return math.copysign(INF, exact)


def assert_rounded(found, function, *arguments, digits=50):
    for value, *point in zip(found.tolist(), *(np.asarray(a, dtype=float).tolist() for a in arguments), strict=True):
        with mpmath.workdps(digits):
            expected = rounded(function(*map(mpmath.mpf, point)))
        assert value == expected, (point, value.hex(), expected.hex())


def any_doubles(count, seed):
    """Return positive doubles of every exponent, subnormal ones too."""
    drawn = np.random.default_rng(seed).integers(0, 0x7FF0000000000000, count, dtype=np.uint64).view(np.float64)
    return np.concatenate([drawn, np.random.default_rng(seed + 1).integers(1, 2**52, count // 8) * LEAST])


def test_sines_of_large_angles():
    """Also of that closest to a multiple of pi/2, 2^-61 away from it, and of twice that, whose sine is as small."""
    rng = np.random.default_rng(1)
    hard = [6381956970095103.0 * 2.0**797, 6381956970095103.0 * 2.0**798, LARGEST, 2.0**1023, 1e22, 1e6]
    multiples = rng.integers(636619, 10**9, 200) * (math.pi / 2)
    angles = np.concatenate([hard, multiples, 10.0 ** rng.uniform(5, 308, 400), 10.0 ** rng.uniform(-3, 5, 100)])
    angles *= rng.choice([-1.0, 1.0], angles.size)
    assert_rounded(values(SINE, angles), mpmath.sin, angles, digits=400)
    assert np.isnan(values(SINE, [INF, -INF, math.nan])).all()


def test_exponentials():
    """Also where the result is subnormal, and on both sides of the ends of the range."""
    rng = np.random.default_rng(2)
    ends = np.array([709.782712893384, -708.3964185322641, -745.1332191019412])
    x = np.concatenate([ends, np.nextafter(ends, INF), np.nextafter(ends, -INF), rng.uniform(-745.2, -708.0, 300)])
    x = np.concatenate([x, rng.uniform(-710, 710, 300), rng.choice([-1, 1], 100) * 10 ** rng.uniform(-20, 0, 100)])
    assert_rounded(values(EXPONENTIAL, x), mpmath.exp, x)
    assert_rounded(values(HALF_EXPONENTIAL, x), lambda y: mpmath.exp(y) / 2, x)
    far = [0.0, -0.0, 1e300, INF, -1e300, -INF]
    assert values(EXPONENTIAL, far).tolist() == [1.0, 1.0, INF, INF, 0.0, 0.0]
    assert np.isnan(values(EXPONENTIAL, [math.nan])).all()


def test_logarithms():
    rng = np.random.default_rng(3)
    near_one = 1.0 + rng.choice([-1, 1], 300) * 10.0 ** rng.uniform(-16, -1, 300)
    root = np.array([math.sqrt(0.5), math.sqrt(2.0), 1.0])
    near = [root, np.nextafter(root, 0.0), np.nextafter(root, 2.0), 2.0 ** np.arange(-1074, 1024, 31)]
    x = np.concatenate([*near, near_one, any_doubles(400, 4), [LEAST, LARGEST]])
    assert_rounded(values(LOGARITHM, x), mpmath.log, x)
    assert values(LOGARITHM, [0.0, -0.0, INF]).tolist() == [-INF, -INF, INF]
    assert not np.signbit(values(LOGARITHM, [1.0]))[0] and np.isnan(values(LOGARITHM, [-1.0, math.nan])).all()


def test_angles():
    """In all quadrants, near multiples of pi/4, near quotients k/16, and where the quotient is subnormal."""
    rng = np.random.default_rng(5)
    whole = rng.choice(np.delete(np.arange(-16.0, 17.0), 16), (2, 60))
    beside = whole * [[1.0 + 2.0**-52], [1.0]]
    wide = 10.0 ** rng.uniform(-30, 30, (2, 200)) * rng.choice([-1.0, 1.0], (2, 200))
    every = np.stack([any_doubles(160, 6), rng.permutation(any_doubles(160, 7))])
    every *= rng.choice([-1.0, 1.0], every.shape)
    pairs = np.concatenate([rng.standard_normal((2, 400)), whole, beside, wide, every], axis=1)
    assert_rounded(values(ANGLE, *pairs), mpmath.atan2, *pairs)
    tiny = np.stack([rng.integers(1, 2**40, 100) * LEAST, 10.0 ** rng.uniform(0, 4, 100)])
    halves = np.stack([rng.integers(1, 2**20, 30) * LEAST, np.full(30, 2.0)])
    # The angle is less than a quotient q by q^3/3, which decides where q is in the middle between two doubles.
    pairs = np.concatenate([tiny, halves], axis=1)
    assert_rounded(values(ANGLE, *pairs), mpmath.atan2, *pairs, digits=660)


def test_angles_of_zeros_and_infinities():
    special = [0.0, -0.0, 1.0, -1.0, LEAST, -LEAST, LARGEST, -LARGEST, INF, -INF]
    for y in special:
        for x in special:
            (found,), expected = values(ANGLE, [y], [x]), math.atan2(y, x)
            assert abs(found - expected) <= math.ulp(expected) and math.copysign(1, found) == math.copysign(1, expected)
    assert np.isnan(values(ANGLE, [math.nan, 1.0], [1.0, math.nan])).all()


# Their last bits differ between C libraries.
OF_THE_C_LIBRARY = (
    "sin cos tan sincos asin acos atan atan2 exp exp2 exp10 expm1 log log2 log10 log1p sinh cosh tanh asinh acosh "
    "atanh pow cbrt hypot erf erfc tgamma lgamma polar"
).split()
CALL = re.compile(rf"(?<![\w.>])(?:std::|::|__builtin_)?(?:{'|'.join(OF_THE_C_LIBRARY)})[fl]?\s*\(")


def calls_of_the_c_library(text):
    code = re.sub(r"//[^\n]*|/\*.*?\*/|\"[^\"\n]*\"", "", text, flags=re.DOTALL)
    return CALL.findall(code)


def test_no_kernel_calls_an_elementary_function_of_the_c_library():
    sources = [*SOURCE.rglob("*.[ch]pp"), *(SOURCE.parents[1] / "methods").glob("*.cpp")]
    assert len(sources) > 80
    found = {path.name: calls for path in sources if (calls := calls_of_the_c_library(path.read_text()))}
    assert found == {}


def test_a_call_of_the_c_library_is_found():
    text = "double a = std::sin(x); // std::exp(x)\n b = pow (x, y) + at.exp(1) + own_log(2);"
    assert calls_of_the_c_library(text) == ["std::sin(", "pow ("]
