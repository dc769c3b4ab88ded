// The maximum of many numbers, in eight rows side by side.
#pragma once

#include <cmath>
#include <cstdint>

#include "numbers/thread_team.hpp"

namespace coadjoint {

// The largest |value(k)|, k < count, which is called once for each k; NaN if one of them is not finite.
template <class Value>
double largest_of(int64_t count, const Value& value) {
    constexpr int64_t ROWS = 8;
    double most[ROWS] = {}, nan_sum[ROWS] = {};
    const auto take = [&](int64_t k, int64_t row) {
        const double size = std::fabs(value(k));
        most[row] = size > most[row] ? size : most[row];
        nan_sum[row] += size - size;
    };
    int64_t k = 0;
    for (; k + ROWS <= count; k += ROWS)
        for (int64_t row = 0; row < ROWS; ++row) take(k + row, row);
    for (; k < count; ++k) take(k, 0);
    for (int64_t row = 1; row < ROWS; ++row) {
        most[0] = most[row] > most[0] ? most[row] : most[0];
        nan_sum[0] += nan_sum[row];
    }
    return most[0] + nan_sum[0];
}

// The larger of two results of `largest_of`.
inline void keep_larger(double& most, double other) { most = (other > most ? other : most) + (other - other); }

// The same on the threads of a team.
template <class Value>
double shared_largest(int64_t count, const Value& value) {
    double most = 0.0;
    shared_results<double>(
        count, 1, &most,
        [&](int64_t first, int64_t last, double* to) {
            *to = largest_of(last - first, [&](int64_t k) { return value(first + k); });
        },
        [](double* to, const double* more) { keep_larger(*to, *more); });
    return most;
}

}  // namespace coadjoint
