// Fused multiply-add for WebAssembly, which has no instruction for it. Included before every source of the kernels, whose
// `__builtin_fma` and fused products of lanes it replaces.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

namespace explorer {

constexpr double SPLITTER = 134217729.0;              // 2^27 + 1
constexpr double LARGEST_FACTOR = 0x1p400, LEAST_FACTOR = 0x1p-400, LARGEST_SUMMAND = 0x1p900;
constexpr double LEAST_PRODUCT = 0x1p-900;

// a b + c, rounded once: the product and the sums as unevaluated pairs (Dekker, Knuth), the small parts rounded to odd
// (Boldo and Melquiond, 2008). Products whose parts could underflow or overflow take the function of the C library.
__attribute__((noinline)) inline double fused(double a, double b, double c) {
    const double size_a = __builtin_fabs(a), size_b = __builtin_fabs(b);
    if (!(size_a <= LARGEST_FACTOR && size_a >= LEAST_FACTOR && size_b <= LARGEST_FACTOR && size_b >= LEAST_FACTOR &&
          __builtin_fabs(c) <= LARGEST_SUMMAND)) {
        if (a == 0.0 || b == 0.0) return a * b + c;
        return ::fma(a, b, c);
    }
    const double p = a * b;
    const double wide_a = SPLITTER * a, high_a = wide_a - (wide_a - a), low_a = a - high_a;
    const double wide_b = SPLITTER * b, high_b = wide_b - (wide_b - b), low_b = b - high_b;
    const double e = low_a * low_b - (((p - high_a * high_b) - low_a * high_b) - high_a * low_b);
    const double t = c + e, from_t = t - c, t_rest = (c - (t - from_t)) + (e - from_t);
    const double v = p + t, from_v = v - p, v_rest = (p - (v - from_v)) + (t - from_v);
    double z = t_rest + v_rest;
    const double from_z = z - t_rest, z_rest = (t_rest - (z - from_z)) + (v_rest - from_z);
    if (z_rest != 0.0) {  // round to odd
        uint64_t bits;
        std::memcpy(&bits, &z, 8);
        if ((bits & 1) == 0) {
            bits += (z_rest > 0.0) == (z > 0.0) ? 1 : -1;
            std::memcpy(&z, &bits, 8);
        }
    }
    return v + z;
}

typedef double Pair __attribute__((vector_size(16)));
typedef int64_t PairOfBits __attribute__((vector_size(16)));

inline Pair absolute(Pair a) { return (Pair)((PairOfBits)a & INT64_MAX); }
inline bool both(PairOfBits mask) { return mask[0] & mask[1]; }

// The same for two numbers side by side; zeros are frequent beyond the last coordinate of a row.
__attribute__((noinline)) inline Pair fused_pair(Pair a, Pair b, Pair c) {
    const Pair p = a * b;
    const PairOfBits no_factor = (a == 0.0) | (b == 0.0);
    if (!both((absolute(a) + absolute(b) + absolute(c) <= LARGEST_SUMMAND) &
              ((absolute(p) >= LEAST_PRODUCT) | no_factor)))
        return Pair{fused(a[0], b[0], c[0]), fused(a[1], b[1], c[1])};
    const Pair wide_a = SPLITTER * a, high_a = wide_a - (wide_a - a), low_a = a - high_a;
    const Pair wide_b = SPLITTER * b, high_b = wide_b - (wide_b - b), low_b = b - high_b;
    const Pair e = low_a * low_b - (((p - high_a * high_b) - low_a * high_b) - high_a * low_b);
    const Pair t = c + e, from_t = t - c, t_rest = (c - (t - from_t)) + (e - from_t);
    const Pair v = p + t, from_v = v - p, v_rest = (p - (v - from_v)) + (t - from_v);
    const Pair z = t_rest + v_rest, from_z = z - t_rest, z_rest = (t_rest - (z - from_z)) + (v_rest - from_z);
    const PairOfBits bits = (PairOfBits)z, to_odd = (z_rest != 0.0) & ((bits & 1) == 0);
    const PairOfBits outward = (z_rest > 0.0) == (z > 0.0);
    const Pair found = v + (Pair)(bits + (to_odd & ((outward & 2) - 1)));
    return (Pair)((no_factor & (PairOfBits)(p + c)) | (~no_factor & (PairOfBits)found));
}

}  // namespace explorer

#define __builtin_fma(a, b, c) explorer::fused(a, b, c)

#include "numbers/lanes.hpp"

#define FUSED_LANES(N)                                                                                              \
    template <>                                                                                                     \
    inline coadjoint::Lanes<N>::Vector coadjoint::Lanes<N>::fused_by_lane(Vector a, Vector b, Vector c) {           \
        return (Vector)explorer::fused_pair((explorer::Pair)a, (explorer::Pair)b, (explorer::Pair)c);               \
    }
FUSED_LANES(2)
FUSED_LANES(4)
FUSED_LANES(8)
