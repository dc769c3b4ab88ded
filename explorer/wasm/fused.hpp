// Fused multiply-add for WebAssembly, which has no instruction for it. Included before every source of the kernels, whose
// `__builtin_fma` it replaces.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

namespace explorer {

constexpr double SPLITTER = 134217729.0;              // 2^27 + 1
constexpr double LARGEST_FACTOR = 0x1p400, LEAST_FACTOR = 0x1p-400, LARGEST_SUMMAND = 0x1p900;

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

}  // namespace explorer

#define __builtin_fma(a, b, c) explorer::fused(a, b, c)
