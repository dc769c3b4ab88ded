// The action of the exponential of a matrix-free operator: scaled and truncated Taylor series, in Horner's order.
#pragma once

#include <cmath>
#include <vector>

#include "boundary/codes.hpp"
#include "boundary/interrupts.hpp"

namespace coadjoint {

constexpr double NEGLIGIBLE = 0x1p-56;  // of the first term: truncation error of a series

class ExponentialAction {
  public:
    std::vector<double> move;  // (exp(D) - 1) y, after `act`

    explicit ExponentialAction(int64_t longest) : move(longest), total(longest), image(longest) {}

    // Compute the number of substeps for rows of D with these sums of absolute entries, and the truncation of the
    // series; false if there are too many. `work` is that of one product, in multiplications.
    bool measure(const double* sums, int64_t rows, int64_t work) {
        double norm = 0.0;
        for (int64_t i = 0; i < rows; ++i) norm = sums[i] > norm || sums[i] != sums[i] ? sums[i] : norm;
        if (!(norm <= double(MOST_SUBSTEPS))) return false;
        substeps = std::max<int64_t>(1, int64_t(std::ceil(norm)));
        const double theta = norm / double(substeps);
        degree = 1;
        for (double term = 0.5 * theta; term > NEGLIGIBLE; term *= theta / double(degree + 1)) ++degree;
        InterruptCheck::of_this_call().after(substeps * degree * work);
        return true;
    }

    // Set `move` to (exp(D) - 1) y, where `apply(from, factor, to)` multiplies by D and a factor.
    template <class Apply>
    void act(const double* y, int64_t size, Apply apply) {
        std::fill_n(move.data(), size, 0.0);
        for (int64_t passed = 0; passed < substeps; ++passed) {
            for (int64_t i = 0; i < size; ++i) total[i] = y[i] + move[i];
            for (int64_t power = degree; power > 0; --power) {
                apply(total.data(), 1.0 / double(power * substeps), image.data());
                if (power > 1)
                    for (int64_t i = 0; i < size; ++i) total[i] = (y[i] + move[i]) + image[i];
            }
            for (int64_t i = 0; i < size; ++i) move[i] += image[i];
        }
    }

  private:
    std::vector<double> total, image;
    int64_t substeps = 1, degree = 1;
};

}  // namespace coadjoint
