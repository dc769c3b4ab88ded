// Correctly rounded elementary functions of one double: the same bits with every C library.
//
// A function is evaluated as an unevaluated sum of two doubles with a relative error below 2^-97, and then rounded. The
// result is correctly rounded unless the exact value is that close to the midpoint of two doubles, and in every case it
// is determined by a fixed sequence of IEEE operations. For the logarithm and the angle a shorter sum is rounded first,
// and is accepted if its error cannot change the result.
#pragma once

#include <cmath>
#include <limits>

#include "numbers/lanes.hpp"

namespace coadjoint {

ONCE double rounded_sine(double x);  // for |x| > 2^-10; NaN if x is infinite
ONCE double rounded_exponential(double x, int halvings = 0);  // exp(x) / 2^halvings: also NaN, infinite or zero
ONCE double rounded_logarithm(double x);
ONCE double rounded_angle(double y, double x);  // atan2(y, x)

struct Pair {
    double high, low;  // the sum; |low| is at most half a unit in the last place of high
};

// 1/n!
constexpr Pair INVERSE_FACTORIALS[] = {
    {0x1p0, 0x0p0}, {0x1p0, 0x0p0}, {0x1p-1, 0x0p0}, {0x1.5555555555555p-3, 0x1.5555555555555p-57},
    {0x1.5555555555555p-5, 0x1.5555555555555p-59}, {0x1.1111111111111p-7, 0x1.1111111111111p-63},
    {0x1.6c16c16c16c17p-10, -0x1.f49f49f49f49fp-65}, {0x1.a01a01a01a01ap-13, 0x1.a01a01a01a01ap-73},
    {0x1.a01a01a01a01ap-16, 0x1.a01a01a01a01ap-76}, {0x1.71de3a556c734p-19, -0x1.c154f8ddc6cp-73},
    {0x1.27e4fb7789f5cp-22, 0x1.cbbc05b4fa99ap-76}, {0x1.ae64567f544e4p-26, -0x1.c062e06d1f209p-80},
    {0x1.1eed8eff8d898p-29, -0x1.2aec959e14c06p-83}, {0x1.6124613a86d09p-33, 0x1.f28e0cc748ebep-87},
    {0x1.93974a8c07c9dp-37, 0x1.05d6f8a2efd1fp-92}, {0x1.ae7f3e733b81fp-41, 0x1.1d8656b0ee8cbp-97},
    {0x1.ae7f3e733b81fp-45, 0x1.1d8656b0ee8cbp-101}, {0x1.952c77030ad4ap-49, 0x1.ac981465ddc6cp-103},
    {0x1.6827863b97d97p-53, 0x1.eec01221a8b0bp-107}, {0x1.2f49b46814157p-57, 0x1.2650f61dbdcb4p-112},
    {0x1.e542ba4020225p-62, 0x1.ea72b4afe3c2fp-120}, {0x1.71b8ef6dcf572p-66, -0x1.d043ae40c4647p-120},
    {0x1.0ce396db7f853p-70, -0x1.aebcdbd20331cp-124}, {0x1.761b41316381ap-75, -0x1.3423c7d91404fp-130},
    {0x1.f2cf01972f578p-80, -0x1.9ada5fcc1ab14p-135}, {0x1.3f3ccdd165fa9p-84, -0x1.58ddadf344487p-139},
    {0x1.88e85fc6a4e5ap-89, -0x1.71c37ebd1654p-143}, {0x1.d1ab1c2dccea3p-94, 0x1.054d0c78aea14p-149},
};

#if defined(COADJOINT_APART) || defined(COMPILES_ELEMENTARY)
// 1/(2k + 1), atan(k/16), ln 2 in three parts, and the bits of 2/pi from 2^63 on.
constexpr Pair INVERSE_ODDS[] = {
    {0x1p0, 0x0p0}, {0x1.5555555555555p-2, 0x1.5555555555555p-56},
    {0x1.999999999999ap-3, -0x1.999999999999ap-57}, {0x1.2492492492492p-3, 0x1.2492492492492p-57},
    {0x1.c71c71c71c71cp-4, 0x1.c71c71c71c71cp-58}, {0x1.745d1745d1746p-4, -0x1.745d1745d1746p-59},
    {0x1.3b13b13b13b14p-4, -0x1.3b13b13b13b14p-58}, {0x1.1111111111111p-4, 0x1.1111111111111p-60},
    {0x1.e1e1e1e1e1e1ep-5, 0x1.e1e1e1e1e1e1ep-61}, {0x1.af286bca1af28p-5, 0x1.af286bca1af28p-59},
    {0x1.8618618618618p-5, 0x1.8618618618618p-59}, {0x1.642c8590b2164p-5, 0x1.642c8590b2164p-60},
    {0x1.47ae147ae147bp-5, -0x1.eb851eb851eb8p-61}, {0x1.2f684bda12f68p-5, 0x1.2f684bda12f68p-59},
    {0x1.1a7b9611a7b96p-5, 0x1.1a7b9611a7b96p-61}, {0x1.0842108421084p-5, 0x1.0842108421084p-60},
    {0x1.f07c1f07c1f08p-6, -0x1.f07c1f07c1f08p-61}, {0x1.d41d41d41d41dp-6, 0x1.075075075075p-60},
    {0x1.bacf914c1badp-6, -0x1.bacf914c1badp-60}, {0x1.a41a41a41a41ap-6, 0x1.069069069069p-60},
    {0x1.8f9c18f9c18fap-6, -0x1.f3831f3831f38p-61}, {0x1.7d05f417d05f4p-6, 0x1.7d05f417d05f4p-62},
};
constexpr Pair ARCTANGENTS[] = {
    {0x0p0, 0x0p0}, {0x1.ff55bb72cfdeap-5, -0x1.c934d86d23f1dp-60},
    {0x1.fd5ba9aac2f6ep-4, -0x1.cd37686760c17p-59}, {0x1.7b97b4bce5b02p-3, 0x1.347b0b4f881cap-58},
    {0x1.f5b75f92c80ddp-3, 0x1.8ab6e3cf7afbdp-57}, {0x1.362773707ebccp-2, -0x1.963a544b672d8p-57},
    {0x1.6f61941e4def1p-2, -0x1.c63aae6f6e918p-56}, {0x1.a64eec3cc23fdp-2, -0x1.24dec1b50b7ffp-56},
    {0x1.dac670561bb4fp-2, 0x1.a2b7f222f65e2p-56}, {0x1.0657e94db30dp-1, -0x1.d5b495f6349e6p-56},
    {0x1.1e00babdefeb4p-1, -0x1.928df287a668fp-58}, {0x1.345f01cce37bbp-1, 0x1.1021137c71102p-55},
    {0x1.4978fa3269ee1p-1, 0x1.2419a87f2a458p-56}, {0x1.5d58987169b18p-1, 0x1.0028e4bc5e7cap-57},
    {0x1.700a7c5784634p-1, -0x1.8c34d25aadef6p-56}, {0x1.819d0b7158a4dp-1, -0x1.bf76229d3b917p-56},
    {0x1.921fb54442d18p-1, 0x1.1a62633145c07p-55},
};
constexpr double LN2_PARTS[] = {0x1.62e42fefa39efp-1, 0x1.abc9e3b39803fp-56, 0x1.7b57a079a1934p-111};
constexpr uint64_t TWO_OVER_PI_WORDS[] = {
    0, 0xa2f9836e4e441529, 0xfc2757d1f534ddc0, 0xdb6295993c439041, 0xfe5163abdebbc561, 0xb7246e3a424dd2e0,
    0x06492eea09d1921c, 0xfe1deb1cb129a73e, 0xe88235f52ebb4484, 0xe99c7026b45f7e41, 0x3991d639835339f4,
    0x9c845f8bbdf9283b, 0x1ff897ffde05980f, 0xef2f118b5a0a6d1f, 0x6d367ecf27cb09b7, 0x4f463f669e5fea2d,
    0x7527bac7ebe5f17b, 0x3d0739f78a5292ea, 0x6bfb5fb11f8d5d08, 0x56033046fc7b6bab, 0xf0cfbc209af4361d,
    0xa9e391615ee61b08,
};

// Requires |a| >= |b|, or a = 0.
INLINE Pair sum_in_order(double a, double b) {
    const double high = a + b;
    return {high, b - (high - a)};
}

INLINE Pair exact_sum(double a, double b) {
    Pair sum;
    two_sum(a, b, sum.high, sum.low);
    return sum;
}

INLINE Pair exact_product(double a, double b) {
    const double high = a * b;
    return {high, fma(a, b, -high)};
}

INLINE Pair negative(const Pair& a) { return {-a.high, -a.low}; }
INLINE Pair times_power_of_two(const Pair& a, double power) { return {a.high * power, a.low * power}; }

INLINE Pair plus(const Pair& a, const Pair& b) {
    const Pair high = exact_sum(a.high, b.high), low = exact_sum(a.low, b.low);
    const Pair sum = sum_in_order(high.high, high.low + low.high);
    return sum_in_order(sum.high, sum.low + low.low);
}

// Requires |b| <= |a|/2, or the same sign and |b| <= |a|, or a = 0.
INLINE Pair plus_smaller(const Pair& a, const Pair& b) {
    const Pair sum = sum_in_order(a.high, b.high);
    return sum_in_order(sum.high, sum.low + (a.low + b.low));
}

INLINE Pair times(const Pair& a, double b) {
    const Pair product = exact_product(a.high, b);
    return sum_in_order(product.high, fma(a.low, b, product.low));
}

INLINE Pair times(const Pair& a, const Pair& b) {
    const Pair product = exact_product(a.high, b.high);
    return sum_in_order(product.high, product.low + fma(a.high, b.low, a.low * b.high));
}

INLINE Pair ratio(const Pair& a, const Pair& b) {
    const double first = a.high / b.high;
    const double rest = fma(-first, b.high, a.high) + fma(-first, b.low, a.low);
    return sum_in_order(first, rest / b.high);
}

// The sum of coefficient[stride k] z^k for k < count: the first `paired` in pairs, the others in doubles. The terms
// after each coefficient are at most half of it.
template <int count, int paired, int stride = 1>
INLINE Pair power_series(const Pair& z, const Pair* coefficient) {
    double last = coefficient[stride * (count - 1)].high;
    for (int k = count - 2; k >= paired; --k) last = fma(last, z.high, coefficient[stride * k].high);
    Pair sum{last, 0.0};
    for (int k = paired - 1; k >= 0; --k) sum = plus_smaller(coefficient[stride * k], times(z, sum));
    return sum;
}

// Whether every number within the relative error of the pair rounds to the same double.
INLINE bool rounds_to_high(const Pair& a, double error) {
    const double margin = error * absolute(a.high);
    return a.high + (a.low - margin) == a.high + (a.low + margin);
}

// 2^exponent within the range of normal numbers.
INLINE double binary_power(int exponent) {
    const int64_t bits = int64_t(exponent + 1023) << 52;
    double power;
    std::memcpy(&power, &bits, 8);
    return power;
}

// The significand of a positive number, from 1/2 to 1, and its exponent.
INLINE double binary_digits(double x, int* exponent) {
    int64_t bits;
    *exponent = -1022;
    if (__builtin_expect(x < std::numeric_limits<double>::min(), 0)) x *= 0x1p54, *exponent -= 54;
    std::memcpy(&bits, &x, 8);
    *exponent += int(bits >> 52);
    bits = (bits & ~EXPONENT_BITS) | (int64_t(1022) << 52);
    std::memcpy(&x, &bits, 8);
    return x;
}

// The pair times 2^exponent, rounded once, including subnormal results. |a| is between 1/4 and 4.
NOINLINE inline double scaled(const Pair& a, int exponent) {
    if (exponent > 1020) return a.high * binary_power(1020) * binary_power(exponent - 1020 < 6 ? exponent - 1020 : 6);
    if (exponent > -1020) return a.high * binary_power(exponent);
    if (exponent < -1080) return a.high < 0.0 ? -0.0 : 0.0;
    // In units of the smallest number; below 2^52 such units, the integer is the bit pattern.
    const bool below = a.high < 0.0;
    const Pair units = times_power_of_two(below ? negative(a) : a, binary_power(exponent + 1074));
    if (units.high >= 0x1p52) return a.high * binary_power(exponent + 100) * 0x1p-100;
    double whole = (units.high + 0x1p52) - 0x1p52;
    const double rest = units.high - whole;
    if (rest == 0.5 && units.low > 0.0) whole += 1.0;
    if (rest == -0.5 && units.low < 0.0) whole -= 1.0;
    const int64_t bits = int64_t(whole);
    double result;
    std::memcpy(&result, &bits, 8);
    return below ? -result : result;
}

// x - quarter pi/2 for the nearest integer, of which the last two bits are returned, after M. Payne and R. Hanek,
// Radian reduction for trigonometric functions (1983). Digits of 2/pi whose product with x is a multiple of 4 are
// omitted, and the next 256 bits multiplied: the truncation error is below 2^-200, and x is no closer than 2^-62 to a
// multiple of pi/2. For finite |x| > 2^-10.
NOINLINE inline Pair reduced_angle(double x, int& quarter) {
    typedef unsigned __int128 Wide;
    int64_t bits;
    std::memcpy(&bits, &x, 8);
    const uint64_t digits = (uint64_t(bits) & ((uint64_t(1) << 52) - 1)) | (uint64_t(1) << 52);
    const int skipped = int((bits >> 52) & 0x7ff) - 1075 - 2 + 64, word = skipped / 64, shift = skipped % 64;
    uint64_t product[4], carry = 0;  // least significant word first; the unit of the whole is 2^-254
    for (int k = 3; k >= 0; --k) {
        const uint64_t* at = TWO_OVER_PI_WORDS + word + k;
        const uint64_t factor = shift ? (at[0] << shift) | (at[1] >> (64 - shift)) : at[0];
        const Wide wide = Wide(factor) * digits + carry;
        product[3 - k] = uint64_t(wide), carry = uint64_t(wide >> 64);
    }
    quarter = int(product[3] >> 62);
    const bool above = (product[3] >> 61) & 1;  // at least one half: the next integer is nearer
    if (above) {
        ++quarter;
        for (uint64_t& one : product) one = ~one;  // 1 - fraction, up to 2^-254
    }
    product[3] &= (uint64_t(1) << 62) - 1;
    Pair fraction{0.0, 0.0};
    for (int k = 7; k >= 0; --k) {
        const uint64_t half = (product[k / 2] >> (32 * (k % 2))) & 0xffffffff;
        fraction = plus_smaller(fraction, {double(half) * binary_power(32 * k - 254), 0.0});
    }
    const bool minus = above != (bits < 0);
    if (bits < 0) quarter = -quarter;
    const Pair angle = times(fraction, times_power_of_two(ARCTANGENTS[16], 2.0));
    return minus ? negative(angle) : angle;
}

NOINLINE double rounded_sine(double x) {
    if (!(absolute(x) <= std::numeric_limits<double>::max())) return x - x;
    int quarter;
    const Pair angle = reduced_angle(x, quarter), z = negative(times(angle, angle));
    const Pair sine = times(angle, power_series<14, 8, 2>(z, INVERSE_FACTORIALS + 1));
    const Pair cosine = power_series<14, 8, 2>(z, INVERSE_FACTORIALS);
    const double size = quarter & 1 ? cosine.high : sine.high;
    return quarter & 2 ? -size : size;
}

NOINLINE double rounded_exponential(double x, int halvings) {
    if (!(absolute(x) <= 800.0)) return x < 0.0 ? 0.0 : x * std::numeric_limits<double>::infinity();
    const double k = (x * 0x1.71547652b82fep0 + 0x1.8p52) - 0x1.8p52;  // x / ln 2, rounded to the nearest integer
    const Pair first = exact_product(-k, LN2_PARTS[0]), second = exact_product(-k, LN2_PARTS[1]);
    const Pair near = plus(plus({x, 0.0}, first), {second.high, fma(-k, LN2_PARTS[2], second.low)});
    return scaled(power_series<24, 13>(near, INVERSE_FACTORIALS), int(k) - halvings);
}

template <int count, int paired>
INLINE Pair logarithm_of(double digits, int exponent) {
    const Pair s = ratio({digits - 1.0, 0.0}, exact_sum(1.0, digits));
    const Pair near = times_power_of_two(times(s, power_series<count, paired>(times(s, s), INVERSE_ODDS)), 2.0);
    return exponent ? plus_smaller(times({LN2_PARTS[0], LN2_PARTS[1]}, double(exponent)), near) : near;
}

// log(digits) + exponent ln 2 for digits from sqrt(1/2) to sqrt(2): 2 artanh((digits - 1)/(digits + 1)).
NOINLINE double rounded_logarithm(double x) {
    if (!(x > 0.0)) return x == 0.0 ? -std::numeric_limits<double>::infinity() : std::numeric_limits<double>::quiet_NaN();
    if (x > std::numeric_limits<double>::max()) return x;
    int exponent;
    double digits = binary_digits(x, &exponent);
    if (digits < 0.70710678118654752) digits *= 2.0, --exponent;
    const Pair quick = logarithm_of<12, 2>(digits, exponent);
    if (__builtin_expect(rounds_to_high(quick, 0x1p-63), 1)) return quick.high;
    return logarithm_of<22, 11>(digits, exponent).high;
}

// atan(y/x) for 0 < y <= x: atan(k/16) for k/16 near y/x, and the arctangent of (y - x k/16)/(x + y k/16).
template <int count, int paired>
INLINE Pair arctangent_of(double y, double x) {
    const int k = int(16.0 * (y / x) + 0.5);
    const double near = 0.0625 * k;
    const Pair above = exact_product(near, x), below = exact_product(near, y);
    const Pair sum = sum_in_order(x, below.high);
    // y - above.high is exact.
    const Pair u = ratio(exact_sum(y - above.high, -above.low), {sum.high, sum.low + below.low});
    const Pair rest = times(u, power_series<count, paired>(negative(times(u, u)), INVERSE_ODDS));
    return k ? plus_smaller(ARCTANGENTS[k], rest) : rest;
}

// A point of the plane in polar coordinates, its angle from 0 to pi.
struct Direction {
    double least, most;  // the smaller and the larger coordinate, without sign and with a common power of two removed
    int exponent;        // additional power of two of the smaller one
    bool steep, left;    // the second coordinate is the larger one; the first one is negative
};

template <int count, int paired>
INLINE Pair angle_of(const Direction& at) {
    Pair angle;
    if (at.exponent < -60) {  // the angle is less than the quotient by less than 2^-120 of it
        angle = ratio({at.least, 0.0}, {at.most, 0.0});
        angle = times_power_of_two(angle, binary_power(at.exponent > -300 ? at.exponent : -300));
    } else {
        angle = arctangent_of<count, paired>(at.least * binary_power(at.exponent), at.most);
    }
    if (!at.steep && !at.left) return angle;
    const Pair whole = times_power_of_two(ARCTANGENTS[16], at.steep ? 2.0 : 4.0);
    return plus_smaller(whole, at.steep && at.left ? angle : negative(angle));
}

NOINLINE double rounded_angle(double y, double x) {
    constexpr double LARGEST = std::numeric_limits<double>::max();
    if (x != x || y != y) return x + y;
    const double across = absolute(y), along = absolute(x);
    Direction at{0.0, 1.0, 0, along < across, std::signbit(x)};
    double angle;
    if (along > LARGEST && across > LARGEST) {
        const Pair half = times_power_of_two(ARCTANGENTS[16], at.left ? 2.0 : 0.0);
        angle = plus_smaller(half, ARCTANGENTS[16]).high;
    } else if (along == 0.0 || across == 0.0 || along > LARGEST || across > LARGEST) {
        angle = at.steep ? 2.0 * ARCTANGENTS[16].high : at.left ? 4.0 * ARCTANGENTS[16].high : 0.0;
    } else {
        int least, most;
        at.least = binary_digits(at.steep ? along : across, &least);
        at.most = binary_digits(at.steep ? across : along, &most);
        at.exponent = least - most;
        if (at.exponent < -60 && !at.steep && !at.left) {
            Pair quotient = ratio({at.least, 0.0}, {at.most, 0.0});
            quotient.low -= 0x1p-115 * quotient.high;  // the angle is below the quotient, which decides a tie
            angle = scaled(quotient, at.exponent);
        } else {
            const Pair quick = angle_of<7, 1>(at);
            angle = rounds_to_high(quick, 0x1p-62) ? quick.high : angle_of<12, 5>(at).high;
        }
    }
    return std::signbit(y) ? -angle : angle;
}
#endif

}  // namespace coadjoint
