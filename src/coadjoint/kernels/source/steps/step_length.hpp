// Length of a step of a series, from the sizes of its terms: A. Jorba, M. Zou, A software package for the numerical
// integration of ODEs by means of high-order Taylor methods, Experimental Mathematics 14 (2005), section 3.2.
// `coadjoint.methods.numerics.taylor_series` is the same in Python, operation by operation.
#pragma once

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

// 2^whole, for integers from -1022 to 1023.
inline double whole_power_of_two(double whole) {
    const int64_t bits = int64_t(whole + 1023.0) << 52;
    double power;
    std::memcpy(&power, &bits, sizeof power);
    return power;
}

// 2^a with a relative error below 4e-6, for a from -1000 to 1000.
inline double near_power_of_two(double a) {
    const double whole = std::floor(a + 0.5), r = (a - whole) * LN2;
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

    StepLength(int64_t order, double tolerance)
        : order(order), last(std::max<int64_t>(1, order + 1 - DECIDING)),
          middle(order >= 2 * DECIDING ? order / 2 + 1 - DECIDING : 0), tolerance(near_log2(tolerance) / double(order)) {}

    // The sizes of these terms.
    struct Sizes {
        double last[DECIDING] = {0.0, 0.0, 0.0, 0.0}, largest = 0.0, sum = 0.0;  // of the last terms
        double before = 0.0;                                                     // the largest of those in the middle
    };

    template <class SizeOf>
    INLINE Sizes sizes(SizeOf size_of) const {
        Sizes found;
#pragma GCC unroll 4
        for (int64_t k = 0; k < DECIDING; ++k) {
            if (last + k > order) break;
            const double term = found.last[k] = size_of(last + k);
            found.largest = larger(found.largest, term), found.sum += term;
        }
        if (middle > 0)
#pragma GCC unroll 4
            for (int64_t k = 0; k < DECIDING; ++k) found.before = larger(found.before, size_of(middle + k));
        return found;
    }

    // The logarithm of the length in units of h at which the last terms would equal the tolerance times `size`, if they
    // fell as a geometric sequence from `size` on; but at most half the radius of convergence, estimated from the
    // middle and the last terms: the truncation error is then less than the last term, and decaying components decay in
    // the series too.
    INLINE double logarithm(double size, const Sizes& terms) const {
        const double whole = near_log2(size);
        double radius = 2.0 * NO_LIMIT, of_largest = 0.0;
#pragma GCC unroll 4
        for (int64_t k = 0; k < DECIDING; ++k) {
            const double one = near_log2(terms.last[k]);
            if (terms.last[k] > 0.0) radius = smaller(radius, (whole - one) / double(last + k));
            if (terms.last[k] == terms.largest) of_largest = one;
        }
        double length = radius + tolerance;
        if (terms.largest > 0.0 && terms.before > 0.0) {
            const double converging = (near_log2(terms.before) - of_largest) / double(order - order / 2);
            length = smaller(length, converging - 1.0);
        }
        return larger(smaller(length, NO_LIMIT), -NO_LIMIT);
    }
};

}  // namespace coadjoint
