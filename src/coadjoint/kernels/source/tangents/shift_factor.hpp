// The factor exp(Y) of group elements for the Casimirs subtracted from the Hamiltonian, with its derivatives: Y = h sum
// factors[c] x[j] turning[c, j] is linear in the momentum x.
#pragma once

#include <limits>
#include <vector>

#include "boundary/interrupts.hpp"
#include "numbers/arithmetic.hpp"

namespace coadjoint {

// to += factor A B, for matrices of d rows, row after row.
inline void add_matrix_product(int64_t d, double factor, const double* A, const double* B, double* to) {
    for (int64_t i = 0; i < d; ++i)
        for (int64_t k = 0; k < d; ++k) {
            const double by = factor * A[i * d + k];
            for (int64_t j = 0; j < d; ++j) to[i * d + j] = fma(by, B[k * d + j], to[i * d + j]);
        }
}

inline void transpose_matrix(int64_t d, const double* from, double* to) {
    for (int64_t i = 0; i < d; ++i)
        for (int64_t j = 0; j < d; ++j) to[i * d + j] = from[j * d + i];
}

// The exponential of a matrix by a scaled series, with its derivatives.
class MatrixExponential {
  public:
    explicit MatrixExponential(int64_t d)
        : d(d), square(d * d), Y(square), step(square), other(square), sum(square), transposed(square),
          powers((MOST_TERMS + 1) * square) {}

    // exp(factor matrix)
    const double* of(double factor, const double* matrix) {
        double norm = 0.0;
        for (int64_t i = 0; i < d; ++i) {
            double row = 0.0;
            for (int64_t j = 0; j < d; ++j) row += absolute(Y[i * d + j] = factor * matrix[i * d + j]);
            norm = std::max(norm, row);
        }
        if (!(norm <= std::numeric_limits<double>::max())) norm = std::numeric_limits<double>::quiet_NaN();
        squarings = 0;
        for (double left = norm; left > 0.5; left *= 0.5) ++squarings;
        scale = power_of_two(-squarings);
        for (double& entry : Y) entry *= scale;
        InterruptCheck::of_this_call().after((MOST_TERMS + squarings) * d * square);
        std::fill(powers.begin(), powers.end(), 0.0);
        for (int64_t i = 0; i < d; ++i) powers[i * (d + 1)] = 1.0;
        stages.assign(powers.begin(), powers.begin() + square);
        double bound = 1.0;
        for (terms = 0; terms < MOST_TERMS && bound > NEGLIGIBLE;) {
            const double* last = powers.data() + terms++ * square;
            double* next = powers.data() + terms * square;
            bound *= norm * scale / double(terms);
            add_matrix_product(d, 1.0 / double(terms), Y.data(), last, next);
            for (int64_t e = 0; e < square; ++e) stages[e] += next[e];
        }
        stages.resize((squarings + 1) * square, 0.0);
        for (int64_t k = 0; k < squarings; ++k) {
            const double* last = stages.data() + k * square;
            add_matrix_product(d, 1.0, last, last, stages.data() + (k + 1) * square);
        }
        return stages.data() + squarings * square;
    }

    // Set out to the derivative along a change of the matrix times its factor.
    void along(const double* direction, double* out) {
        InterruptCheck::of_this_call().after(2 * (MOST_TERMS + squarings) * d * square);
        std::fill(step.begin(), step.end(), 0.0);
        std::fill_n(out, square, 0.0);
        for (int64_t k = 1; k <= terms; ++k) {
            std::fill(other.begin(), other.end(), 0.0);
            add_matrix_product(d, scale / double(k), direction, powers.data() + (k - 1) * square, other.data());
            add_matrix_product(d, 1.0 / double(k), Y.data(), step.data(), other.data());
            step.swap(other);
            for (int64_t e = 0; e < square; ++e) out[e] += step[e];
        }
        for (int64_t k = 0; k < squarings; ++k) {
            std::fill(sum.begin(), sum.end(), 0.0);
            const double* stage = stages.data() + k * square;
            add_matrix_product(d, 1.0, out, stage, sum.data());
            add_matrix_product(d, 1.0, stage, out, sum.data());
            std::copy_n(sum.data(), square, out);
        }
    }

    // Set out to the cotangent of the matrix times its factor for that of the exponential: the derivative is symmetric
    // under transposition of all matrices.
    void pull(const double* cotangent, double* out) {
        transpose_matrix(d, cotangent, out);
        transposed.assign(out, out + square);
        along(transposed.data(), out);
        transposed.assign(out, out + square);
        transpose_matrix(d, transposed.data(), out);
    }

  private:
    static constexpr int64_t MOST_TERMS = 20;
    static constexpr double NEGLIGIBLE = 0x1p-60;
    const int64_t d, square;
    double scale = 1.0;
    int64_t squarings = 0, terms = 0;
    std::vector<double> Y, step, other, sum, transposed, powers, stages;  // Y^k/k!, and the exponential at each squaring
};

class ShiftFactor {
  public:
    ShiftFactor(int64_t n, int64_t d, int64_t casimirs, const double* factors, const double* turning)
        : n(n), d(d), casimirs(casimirs), square(d * d), factors(factors), turning(turning), generator(square),
          pulled(square), exponential(d) {}

    // The factor at a momentum, for a time h.
    const double* at(const double* momentum, double h) {
        x = momentum, time = h;
        generate(x, factors, nullptr, nullptr);
        return exponential.of(1.0, generator.data());
    }

    // Set out (count, d, d) to the derivatives of the factor along changes of the momentum (count, n), and of the factors of
    // the Casimirs, in rows of so many numbers. Many directions are combined from those of a basis.
    void along(int64_t count, const double* dx, const double* of_factors, int64_t stride, double* out) {
        const int64_t basis = n + casimirs;
        if (count <= basis) {
            for (int64_t v = 0; v < count; ++v) along_one(dx + v * n, of_factors + v * stride, out + v * square);
            return;
        }
        units.assign(basis, 0.0), of_units.resize(basis * square);
        for (int64_t b = 0; b < basis; ++b) {
            units[b] = 1.0;
            along_one(units.data(), units.data() + n, of_units.data() + b * square);
            units[b] = 0.0;
        }
        std::fill_n(out, count * square, 0.0);
        for (int64_t v = 0; v < count; ++v)
            for (int64_t b = 0; b < basis; ++b) {
                const double by = b < n ? dx[v * n + b] : of_factors[v * stride + b - n];
                for (int64_t e = 0; e < square; ++e)
                    out[v * square + e] = fma(by, of_units[b * square + e], out[v * square + e]);
            }
    }

    // Add the cotangents of the momentum and of the factors of the Casimirs for that of the factor.
    void pull(const double* of_factor, double* of_x, double* of_factors) {
        exponential.pull(of_factor, pulled.data());
        for (int64_t c = 0; c < casimirs; ++c)
            for (int64_t j = 0; j < n; ++j) {
                const double* matrix = turning + (c * n + j) * square;
                double along_matrix = 0.0;
                for (int64_t e = 0; e < square; ++e) along_matrix = fma(pulled[e], matrix[e], along_matrix);
                of_x[j] = fma(time * factors[c], along_matrix, of_x[j]);
                of_factors[c] = fma(time * x[j], along_matrix, of_factors[c]);
            }
    }

  private:
    const int64_t n, d, casimirs, square;
    const double *factors, *turning, *x = nullptr;
    double time = 0.0;
    std::vector<double> generator, pulled, units, of_units;
    MatrixExponential exponential;

    void along_one(const double* dx, const double* of_factors, double* out) {
        generate(dx, factors, x, of_factors);
        exponential.along(generator.data(), out);
    }

    void generate(const double* one, const double* by, const double* other, const double* by_other) {
        std::fill(generator.begin(), generator.end(), 0.0);
        for (int64_t c = 0; c < casimirs; ++c)
            for (int64_t j = 0; j < n; ++j) {
                const double length = time * (by[c] * one[j] + (by_other ? by_other[c] * other[j] : 0.0));
                const double* matrix = turning + (c * n + j) * square;
                for (int64_t e = 0; e < square; ++e) generator[e] = fma(length, matrix[e], generator[e]);
            }
    }
};

}  // namespace coadjoint
