// Length of a step of a series, from the sizes of its terms: A. Jorba, M. Zou, A software package for the numerical
// integration of ODEs by means of high-order Taylor methods, Experimental Mathematics 14 (2005), section 3.2.
// `coadjoint.methods.numerics.taylor_series` is the same in Python, operation by operation.
#pragma once

#include "field/row_lanes.hpp"
#include "numbers/arithmetic.hpp"

namespace coadjoint {

// The binary logarithm of a positive number within 2e-5, without a library, so that it is the same on every machine.
// Zero and nearly zero numbers give -1022.
inline double near_log2(double a) {
    int64_t bits;
    std::memcpy(&bits, &a, sizeof bits);
    const int64_t exponent = (bits >> 52) - 1023;
    if (exponent < -1022) return -1022.0;
    bits = (bits & ((int64_t(1) << 52) - 1)) | (int64_t(1023) << 52);
    double mantissa;
    std::memcpy(&mantissa, &bits, sizeof mantissa);
    const double z = (mantissa - 1.0) / (mantissa + 1.0), zz = z * z;
    const double series = 2.885390081777927 + zz * (0.9617966939259757 + zz * (0.5770780163555854 + zz * 0.41219858311113244));
    return double(exponent) + z * series;
}

// The same for eight numbers, with the same bits.
INLINE Lanes<8> near_log2(const Lanes<8>& a) {
    typedef Lanes<8> Eight;
    Eight exponent, mantissa;
    for (int k = 0; k < Eight::count; ++k) {
        const auto bits = (typename Eight::Unsigned)a.part[k];
        exponent.part[k] = (typename Eight::Vector)((bits >> 52) | UNIT_OF_2_52) - (0x1p52 + 1023.0);
        mantissa.part[k] =
            (typename Eight::Vector)((bits & ((uint64_t(1) << 52) - 1)) | (uint64_t(1023) << 52));
    }
    const Eight z = (mantissa - Eight(1.0)) / (mantissa + Eight(1.0)), zz = z * z;
    const Eight last = Eight(0.5770780163555854) + zz * Eight(0.41219858311113244);
    const Eight series = Eight(2.885390081777927) + zz * (Eight(0.9617966939259757) + zz * last);
    return select(exponent < Eight(-1022.0), Eight(-1022.0), exponent + z * series);
}

// The sums of the lanes of eight rows, with the bits of `sum_of_lanes`: of row k in lane 2 k, and of row 4 + k in lane
// 2 k + 1.
template <int W>
INLINE Lanes<8> sums_of_lanes(const Lanes<W>* rows) {
    Lanes<8> sums;
#if defined(__AVX512F__)
    if constexpr (W == 8) {
        auto row = [&](int k) { return (__m512d)rows[k].part[0]; };
        auto halves = [&](int k) {
            return _mm512_add_pd(_mm512_shuffle_f64x2(row(k), row(k + 1), 0x44),
                                 _mm512_shuffle_f64x2(row(k), row(k + 1), 0xEE));
        };
        auto quarters = [&](int k) {
            const __m512d a = halves(k), b = halves(k + 2);
            return _mm512_add_pd(_mm512_shuffle_f64x2(a, b, 0x88), _mm512_shuffle_f64x2(a, b, 0xDD));
        };
        const __m512d a = quarters(0), b = quarters(4);
        sums.part[0] = (typename Lanes<8>::Vector)_mm512_add_pd(_mm512_unpacklo_pd(a, b), _mm512_unpackhi_pd(a, b));
        return sums;
    }
#elif defined(__AVX2__)
    __m128d pairs[4];
    for (int k = 0; k < 4; ++k)
        pairs[k] = _mm_hadd_pd(sums_of_every_second(rows[k]), sums_of_every_second(rows[4 + k]));
    for (int k = 0; k < 2; ++k)
        sums.part[k] = (typename Lanes<8>::Vector)_mm256_set_m128d(pairs[2 * k + 1], pairs[2 * k]);
    return sums;
#endif
    for (int k = 0; k < 8; ++k) sums.set(k % 4 * 2 + k / 4, sum_of_lanes(rows[k]));
    return sums;
}

// 2^whole, for integers from -1022 to 1023.
inline double whole_power_of_two(double whole) {
    const int64_t bits = int64_t(whole + 1023.0) << 52;
    double power;
    std::memcpy(&power, &bits, sizeof power);
    return power;
}

// 2^a with a relative error below 4e-6, for a from -1000 to 1000.
inline double near_power_of_two(double a) {
    const double whole = nearest_multiple(a, 1.0) - ROUND, r = (a - whole) * LN2;
    return (1.0 + r * (1.0 + r * (0.5 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0)))))) *
           whole_power_of_two(whole);
}

// The number of terms x_k h^k whose sizes determine the length: the last ones, of which some may vanish, as even and
// odd ones do, and as many in the middle.
constexpr int64_t DECIDING = 4;
constexpr double NO_LIMIT = 900.0;  // a length beyond 2^900 is unlimited

struct StepLength {
    const int64_t order, last, middle;  // the first of the last terms, and of those in the middle, 0 for none
    const double tolerance;             // its logarithm over the order
    const double farther;               // 1 over the distance of the last terms from those in the middle
    Lanes<8> inverses{0.0};             // 1 over the numbers of the last terms

    StepLength(int64_t order, double tolerance)
        : order(order), last(std::max<int64_t>(1, order + 1 - DECIDING)),
          middle(order >= 2 * DECIDING ? order / 2 + 1 - DECIDING : 0), tolerance(near_log2(tolerance) / double(order)),
          farther(1.0 / double(order - order / 2)) {
        for (int64_t k = 0; k < DECIDING; ++k) inverses.set(int(2 * k), 1.0 / double(last + k));
    }

    // The sizes of these terms, as lanes: the last ones in the even lanes, and those in the middle in the odd ones.
    struct Sizes {
        Lanes<8> terms;
        double largest, before, sum = 0.0;  // the largest of either, and the sum of the last ones
    };

    // `row_of` returns the absolute values of a term, whose sum is its size.
    template <class Row, class RowOf>
    INLINE Sizes sizes(RowOf row_of) const {
        Row rows[2 * DECIDING];
        for (int64_t k = 0; k < DECIDING; ++k) {
            rows[k] = last + k <= order ? row_of(last + k) : Row(0.0);
            rows[DECIDING + k] = middle > 0 ? row_of(middle + k) : Row(0.0);
        }
        Sizes found;
        found.terms = sums_of_lanes(rows);
        double sizes[2 * DECIDING];
        store(sizes, found.terms);
        found.largest = larger(larger(sizes[0], sizes[2]), larger(sizes[4], sizes[6]));
        found.before = larger(larger(sizes[1], sizes[3]), larger(sizes[5], sizes[7]));
        for (int64_t k = 0; k < DECIDING; ++k) found.sum += sizes[2 * k];
        return found;
    }

    // The logarithm of the length in units of h at which the last terms would equal the tolerance times `size`, if they
    // fell as a geometric sequence from `size` on; but at most half the radius of convergence, estimated from the
    // middle and the last terms: the truncation error is then less than the last term, and decaying components decay in
    // the series too.
    INLINE double logarithm(double size, const Sizes& terms) const {
        typedef Lanes<8> Eight;
        const Eight logarithms = near_log2(terms.terms), unlimited(2.0 * NO_LIMIT);
        const Eight radii = (Eight(near_log2(size)) - logarithms) * inverses;
        double radius[2 * DECIDING];
        // Odd lanes are in the middle, and have no limit.
        store(radius, select((terms.terms > Eight(0.0)) & (inverses > Eight(0.0)), radii, unlimited));
        double length = smaller(smaller(radius[0], radius[2]), smaller(radius[4], radius[6]));
        length = smaller(length, 2.0 * NO_LIMIT) + tolerance;
        if (terms.largest > 0.0 && terms.before > 0.0) {
            const double converging = (near_log2(terms.before) - near_log2(terms.largest)) * farther;
            length = smaller(length, converging - 1.0);
        }
        return larger(smaller(length, NO_LIMIT), -NO_LIMIT);
    }
};

}  // namespace coadjoint
