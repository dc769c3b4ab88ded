// Shared parts of the isospectral schemes: tables, and the stopping criterion of their iterations.
#pragma once

#include <cmath>
#include <limits>

#include "boundary/interrupts.hpp"
#include "matrices/largest.hpp"
#include "matrices/products.hpp"
#include "matrices/stream.hpp"
#include "numbers/lanes.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

// Indices in `whole` of the tables for the addresses of BLAS routines: products of matrices of the states, and of real
// ones in their precision and in the lower one.
enum TableIndex { STREAM = 0, GEMM = 6, REAL_GEMM, LOWER_GEMM, STAGES, COMPLEX, GENERAL };

constexpr int64_t FIRST_TESTED = 3;     // early corrections may rise before they fall
constexpr int64_t MOST_ITERATIONS = 192;
constexpr int64_t SLOW_FROM = 12;       // from this iteration on a single correction that does not fall may be chance
constexpr int64_t STAGNANT_CORRECTIONS = 3;  // number of such corrections in a row that count as stagnation
constexpr double SMALL = 0x1p-36;       // of the entries: only smaller corrections may be round-off
constexpr double ROUND_OFF = 0x1p-47;   // times sqrt(n), of the entries: below, one stagnating correction suffices

// The real numbers of a matrix.
inline double* numbers_of(double* matrix) { return matrix; }
inline double* numbers_of(Complex* matrix) { return reinterpret_cast<double*>(matrix); }

template <class T>
struct Isospectral : StepScheme {
    const int64_t n, square, all, numbers, stages;
    const double *a, *b, *c;
    Stream<T> stream;

    explicit Isospectral(const StepTables& tables)
        : n(tables.whole[0]), square(n * n), all(tables.whole[1] * square),
          numbers(all * int64_t(sizeof(T) / sizeof(double))), stages(tables.whole[STAGES]),
          a(tables.coefficients), b(a + stages * stages), c(b + stages), stream(tables.whole, c + stages) {
        work = 16 * stages * (all * n * int64_t(sizeof(T) / sizeof(double)) + stream.work());
    }

    // Whether the memory has earlier steps, of this length: their number and length are its first two numbers.
    bool known_steps(double h) const { return memory && memory[0] == memory[0] && memory[1] == h; }

    // Whether an iteration has ended, after a correction `change` of entries of size `size`; the outcome is then in
    // `status`.
    bool ended(double change, double size) {
        ++iterations;
        if (iterations == 1)
            first = least = change, stagnant = 0, status = DONE;
        else
            stagnant = change < least ? 0 : stagnant + 1;
        InterruptCheck::of_this_call().after(work / 16);
        const bool small = change <= SMALL * size, rounding = change <= ROUND_OFF * std::sqrt(double(n)) * size;
        // In a slow iteration with complex eigenvalues, corrections rise and fall while they shrink.
        const bool fast = rounding && iterations < SLOW_FROM;
        const bool stagnating = stagnant >= (fast ? 1 : std::max(STAGNANT_CORRECTIONS, iterations / 4));
        if (change == 0.0 || (small && iterations >= FIRST_TESTED && stagnating)) return status = DONE, true;
        if (!(change - change == 0.0)) return status = OVERFLOWED, true;
        if (iterations >= MOST_ITERATIONS || change > std::ldexp(first, int(GROWTH_BITS)))
            return status = NOT_CONVERGED, true;
        least = std::min(least, change);
        return false;
    }

    int64_t status = DONE;

  private:
    double first = 0.0, least = 0.0;
    int64_t stagnant = 0;
};

}  // namespace coadjoint
