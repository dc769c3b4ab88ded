// LU factors with partial pivoting of large banded systems.
#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "boundary/interrupts.hpp"
#include "numbers/lanes.hpp"

namespace coadjoint {

// A matrix with `reach` diagonals on either side; the upper factor has twice as many.
struct Banded {
    const int64_t size, reach, width;
    std::vector<double> entries;
    std::vector<int64_t> pivots;

    Banded(int64_t size, int64_t reach)
        : size(size), reach(reach), width(3 * reach + 1), entries(size * width), pivots(size) {}

    double& at(int64_t row, int64_t column) { return entries[row * width + column - row + reach]; }

    bool factorize() {
        InterruptCheck& interrupts = InterruptCheck::of_this_call();
        for (int64_t k = 0; k < size; ++k) {
            const int64_t low = std::min(size, k + reach + 1), right = std::min(size, k + 2 * reach + 1);
            interrupts.after((low - k) * (right - k));
            int64_t pivot = k;
            for (int64_t i = k + 1; i < low; ++i)
                if (absolute(at(i, k)) > absolute(at(pivot, k))) pivot = i;
            pivots[k] = pivot;
            const double most = absolute(at(pivot, k));
            if (!(most > 0.0 && most - most == 0.0)) return false;
            if (pivot != k)
                for (int64_t j = k; j < right; ++j) std::swap(at(k, j), at(pivot, j));
            for (int64_t i = k + 1; i < low; ++i) {
                double &first = at(i, k), *row = &at(k, k), *other = &at(i, k);
                if (first == 0.0) continue;
                const double factor = first / row[0];
                first = factor;
                for (int64_t j = 1; j < right - k; ++j) other[j] = fma(-factor, row[j], other[j]);
            }
        }
        return true;
    }

    void solve(double* right) {
        for (int64_t k = 0; k < size; ++k) {
            std::swap(right[k], right[pivots[k]]);
            for (int64_t i = k + 1; i < std::min(size, k + reach + 1); ++i)
                right[i] = fma(-at(i, k), right[k], right[i]);
        }
        for (int64_t k = size - 1; k >= 0; --k) {
            right[k] /= at(k, k);
            for (int64_t i = std::max<int64_t>(0, k - 2 * reach); i < k; ++i)
                right[i] = fma(-at(i, k), right[k], right[i]);
        }
    }
};

}  // namespace coadjoint
