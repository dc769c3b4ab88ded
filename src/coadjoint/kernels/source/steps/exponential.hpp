// The action of the exponential of a matrix-free operator: scaled and truncated Taylor series, in Horner's order.
#pragma once

#include <cmath>
#include <vector>

#include "boundary/codes.hpp"
#include "boundary/interrupts.hpp"

namespace coadjoint {

constexpr double NEGLIGIBLE = 0x1p-56;  // of the first term: truncation error of a series
constexpr int64_t FEW_OF_ACTION = 64;   // substeps that are taken one after the other

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
        work_of_product = work;
        return true;
    }

    // Set `move` to (exp(D) - 1) y, where `apply(from, factor, to)` multiplies by D and a factor. With `edge`, y is a
    // matrix of so many rows and columns, and D multiplies from the left.
    template <class Apply>
    void act(const double* y, int64_t size, Apply apply, int64_t edge = 0) {
        int64_t halvings = 0;
        while (int64_t(1) << halvings < substeps) ++halvings;
        const int64_t rows = edge ? edge : size, columns = (edge ? 1 : size) * degree * work_of_product;
        if (substeps > FEW_OF_ACTION && columns + halvings * rows * rows * rows < substeps * degree * work_of_product)
            return act_by_squares(y, rows, edge ? edge : 1, halvings, columns, apply);
        InterruptCheck::of_this_call().after(substeps * degree * work_of_product);
        take(y, size, substeps, substeps, apply);
    }

  private:
    std::vector<double> total, image;
    int64_t substeps = 1, degree = 1, work_of_product = 0;

    // Set `move` to the change of y by `count` of `parts` substeps.
    template <class Apply>
    void take(const double* y, int64_t size, int64_t count, int64_t parts, const Apply& apply) {
        std::fill_n(move.data(), size, 0.0);
        for (int64_t passed = 0; passed < count; ++passed) {
            for (int64_t i = 0; i < size; ++i) total[i] = y[i] + move[i];
            for (int64_t power = degree; power > 0; --power) {
                apply(total.data(), 1.0 / double(power * parts), image.data());
                if (power > 1)
                    for (int64_t i = 0; i < size; ++i) total[i] = (y[i] + move[i]) + image[i];
            }
            for (int64_t i = 0; i < size; ++i) move[i] += image[i];
        }
    }

    // The same by the matrix of the change in a part of the time, doubled `halvings` times: (1 + F)^2 - 1 = 2 F + F^2.
    template <class Apply>
    NOINLINE void act_by_squares(const double* y, int64_t size, int64_t vectors, int64_t halvings, int64_t work,
                                 const Apply& apply) {
        InterruptCheck& interrupts = InterruptCheck::of_this_call();
        interrupts.after(work);
        std::vector<double> unit(size * vectors, 0.0), rows(size * size), doubled(size * size);
        for (int64_t j = 0; j < size; j += vectors) {
            for (int64_t v = 0; v < vectors; ++v) unit[(j + v) * vectors + v] = 1.0;
            take(unit.data(), size * vectors, 1, int64_t(1) << halvings, apply);
            for (int64_t v = 0; v < vectors; ++v) unit[(j + v) * vectors + v] = 0.0;
            for (int64_t i = 0; i < size; ++i)
                for (int64_t v = 0; v < vectors; ++v) rows[i * size + j + v] = move[i * vectors + v];
        }
        for (; halvings > 0; --halvings) {
            interrupts.after(size * size * size);
            for (int64_t k = 0; k < size * size; ++k) doubled[k] = 2.0 * rows[k];
            for (int64_t i = 0; i < size; ++i)
                for (int64_t j = 0; j < size; ++j)
                    for (int64_t k = 0; k < size; ++k)
                        doubled[i * size + k] = fma(rows[i * size + j], rows[j * size + k], doubled[i * size + k]);
            rows.swap(doubled);
        }
        for (int64_t i = 0; i < size; ++i)
            for (int64_t v = 0; v < vectors; ++v) {
                double sum = 0.0;
                for (int64_t j = 0; j < size; ++j) sum = fma(rows[i * size + j], y[j * vectors + v], sum);
                move[i * vectors + v] = sum;
            }
    }
};

}  // namespace coadjoint
