// The elementary functions and linear solves of the kernels on arrays, for tests of each by itself.
#include <vector>

#include "forces/random.hpp"
#include "numbers/arithmetic.hpp"
#include "numbers/linear_solve.hpp"
#include "numbers/aligned_array.hpp"
#include "boundary/tables.hpp"

namespace coadjoint {

// For every argument: sine and cosine minus one (what = 0), sinh(w)/w and cosh(w) - 1 (1), rational rotation (2), exp
// and exp minus one (3), sinh and cosh minus one (4).
EXPORT void probe_pairs(int64_t what, const double* arguments, int64_t count, double* out) {
    for (int64_t k = 0; k < count; ++k) {
        if (what == 3) {
            const Growth<double> growth = growth_by(arguments[k]);
            out[2 * k] = growth.exp;
            out[2 * k + 1] = growth.expm1;
            continue;
        }
        const auto pair = what == 0   ? rotation_by(arguments[k])
                          : what == 1 ? entire_pair(arguments[k])
                          : what == 4 ? hyperbolic_rotation(arguments[k])
                                      : rational_rotation(arguments[k]);
        out[2 * k] = pair.sine;
        out[2 * k + 1] = pair.cosm1;
    }
}

// A block of the generator; the normal deviate of each word; the deviates of a member from a time on.
EXPORT void probe_philox(const uint64_t* counter, uint64_t key, uint64_t other, uint64_t* out) {
    const auto words = philox<uint64_t>({{counter[0], counter[1], counter[2], counter[3]}}, key, other);
    for (int k = 0; k < 4; ++k) out[k] = words.at[k];
}
EXPORT void probe_normal(const uint64_t* words, int64_t count, double* out) {
    for (int64_t k = 0; k < count; ++k) out[k] = normal_of(words[k]);
}
EXPORT void probe_deviates(uint64_t seed, uint64_t stream, double moment, uint64_t part, int64_t count, double* out) {
    DeviateStream(seed, stream, moment, part).fill(count, out);
}

// Correctly rounded functions: the sine (what = 0), the exponential (1) and half of it (2), the logarithm (3), and the
// angle of (second, first).
EXPORT void probe_rounded(int64_t what, const double* first, const double* second, int64_t count, double* out) {
    for (int64_t k = 0; k < count; ++k)
        out[k] = what == 0   ? rounded_sine(first[k])
                 : what == 1 ? rounded_exponential(first[k])
                 : what == 2 ? rounded_exponential(first[k], 1)
                 : what == 3 ? rounded_logarithm(first[k])
                             : rounded_angle(first[k], second[k]);
}

EXPORT double probe_fma(double a, double b, double c) { return fma(a, b, c); }
EXPORT double probe_rational_angle(double phi, double frequency) { return rational_angle(phi, frequency); }
EXPORT double probe_shortfall(double s, double c, double square) { return shortfall(s, c, square); }

// Solve a dense system for `count` right-hand sides, side by side; 0 if the matrix is singular or not finite. The same
// system in every lane must give the same bits, else -1.
EXPORT int64_t probe_solve(double* matrix, int64_t size, double* right, int64_t count) {
    typedef Lanes<4> Four;
    std::vector<double> pivots(size);
    AlignedArray<Four> wide(size * size), sides(size * count), exchanged(size);
    for (int64_t k = 0; k < size * size; ++k) wide.at[k] = Four(matrix[k]);
    for (int64_t k = 0; k < size * count; ++k) sides.at[k] = Four(right[k]);
    const bool valid = factorize(matrix, size, pivots.data());
    if (all(factorize(wide.at, size, exchanged.at)) != valid) return -1;
    if (!valid) return 0;
    substitute(matrix, size, pivots.data(), right, count);
    substitute(wide.at, size, exchanged.at, sides.at, count);
    for (int64_t k = 0; k < size * count; ++k)
        for (int lane = 0; lane < 4; ++lane)
            if (sides.at[k][lane] != right[k]) return -1;
    return 1;
}

}  // namespace coadjoint
