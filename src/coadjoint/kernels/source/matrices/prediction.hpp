// Predictions of slowly varying numbers, such as the unknowns of implicit steps, from their values in earlier steps.
#pragma once

#include <algorithm>
#include <cstdint>

#include "matrices/largest.hpp"
#include "numbers/thread_team.hpp"

namespace coadjoint {

constexpr int64_t MOST_ROWS = 14;  // of earlier values from which others are predicted

template <class A, class B>
double dot(int64_t count, const A* a, const B* b) {
    // Partial sums, in a fixed order on every processor.
    return shared_sum<double>(count, [=](int64_t first, int64_t last) {
        constexpr int64_t ROWS = 8;
        double sums[ROWS] = {};
        int64_t e = first;
        for (; e + ROWS <= last; e += ROWS)
            for (int64_t k = 0; k < ROWS; ++k) sums[k] += double(a[e + k]) * double(b[e + k]);
        for (; e < last; ++e) sums[0] += double(a[e]) * double(b[e]);
        for (int64_t k = 1; k < ROWS; ++k) sums[0] += sums[k];
        return sums[0];
    });
}

// Compute the factors of past(0), past(1), ..., rows of `numbers` values, the last one first, whose sum predicts the next
// row: those by which past(1), past(2), ... fit past(0). Least squares for samples, by orthogonalization; return the
// number of factors.
template <class Past>
int64_t fit_rows(int64_t numbers, int64_t rows, const Past& past, double* factor) {
    constexpr int64_t SAMPLES = 256, RUN = 8;  // values to which a prediction is fitted, in short runs
    constexpr double NOISE = 0x1p-40;          // of the last row: what earlier ones add below it is round-off
    if (rows < 2) return std::fill_n(factor, rows, 1.0), rows;
    const int64_t count = std::min(numbers, SAMPLES), run = numbers < SAMPLES ? numbers : RUN, runs = count / run;
    double sample[MOST_ROWS][SAMPLES], share[MOST_ROWS][MOST_ROWS];  // the last row in sample[0]
    for (int64_t j = 0; j < rows; ++j) {
        const double* row = past(j);
        for (int64_t k = 0; k < runs; ++k) std::copy_n(row + k * (numbers / runs), run, sample[j] + k * run);
    }
    const double* newest = sample[0];
    const double scale = 1.0 / largest_of(count, [=](int64_t k) { return newest[k]; });
    if (!(scale - scale == 0.0)) return 0;
    int64_t taken = 0;
    for (int64_t j = 0; j < rows; ++j)
        for (int64_t k = 0; k < count; ++k) sample[j][k] *= scale;
    for (int64_t j = 1; j < rows && taken < count / 2; ++j, ++taken) {
        const double square = dot(count, sample[j], sample[j]);
        if (!(square > NOISE * NOISE * double(count))) break;
        for (int64_t i = 0; i < rows; ++i) {
            if (i > 0 && i <= j) continue;
            const double part = share[j][i] = dot(count, sample[j], sample[i]) / square;
            for (int64_t k = 0; k < count; ++k) sample[i][k] -= part * sample[j][k];
        }
    }
    for (int64_t j = taken; j > 0; --j) {
        factor[j - 1] = share[j][0];
        for (int64_t i = j + 1; i <= taken; ++i) factor[j - 1] -= share[j][i] * factor[i - 1];
    }
    return taken;
}

// Add `count` rows times these factors to values, which stay in the first cache while all rows are added.
template <class Past>
void add_rows(int64_t numbers, int64_t count, const Past& past, const double* factor, double* values) {
    constexpr int64_t BLOCK = 2048;
    share(numbers, [&](int64_t first, int64_t last) {
        for (int64_t begin = first; begin < last; begin += BLOCK) {
            const int64_t end = std::min(begin + BLOCK, last);
            for (int64_t j = 0; j < count; ++j) {
                const double *row = past(j), share = factor[j];
                for (int64_t k = begin; k < end; ++k) values[k] += share * row[k];
            }
        }
    });
}

}  // namespace coadjoint
