// Restarted GMRES for large linear systems without a matrix, in a fixed order of operations.
#pragma once

#include <cmath>
#include <vector>

#include "boundary/interrupts.hpp"
#include "numbers/lanes.hpp"
#include "numbers/thread_team.hpp"

namespace coadjoint {

constexpr int64_t RESTART = 24;     // dimension of the Krylov space
constexpr int64_t CYCLES = 16;
constexpr double REDUCTION = 0x1p-26;  // of the residual; the next correction removes the rest

struct Krylov {
    typedef Called<void(const double*, double*)> Operate;
    int64_t size;
    std::vector<double> basis, residual, hessenberg, cosine, sine, right;

    explicit Krylov(int64_t size)
        : size(size), basis((RESTART + 1) * size), residual(size), hessenberg((RESTART + 1) * RESTART), cosine(RESTART),
          sine(RESTART), right(RESTART + 1) {}

    static double dot(const double* a, const double* b, int64_t size) {
        return shared_sum<double>(size, [=](int64_t first, int64_t last) {
            Lanes<8> sum(0.0);
            int64_t i = first;
            for (; i + 8 <= last; i += 8) sum = fma(load<Lanes<8>>(a + i), load<Lanes<8>>(b + i), sum);
            double total = 0.0;
            for (int lane = 0; lane < 8; ++lane) total += sum[lane];
            for (; i < last; ++i) total = fma(a[i], b[i], total);
            return total;
        });
    }

    // y += factor x.
    static void add(double factor, const double* x, double* y, int64_t size) {
        share(size, [=](int64_t first, int64_t last) {
            const Lanes<8> by(factor);
            int64_t i = first;
            for (; i + 8 <= last; i += 8) store(y + i, fma(by, load<Lanes<8>>(x + i), load<Lanes<8>>(y + i)));
            for (; i < last; ++i) y[i] = fma(factor, x[i], y[i]);
        });
    }
    // y = x / divisor.
    static void divide(const double* x, double divisor, double* y, int64_t size) {
        share(size, [=](int64_t first, int64_t last) {
            const Lanes<8> by(divisor);
            int64_t i = first;
            for (; i + 8 <= last; i += 8) store(y + i, load<Lanes<8>>(x + i) / by);
            for (; i < last; ++i) y[i] = x[i] / divisor;
        });
    }

    // Overwrite the right-hand side r by an approximate solution y of operate(y) = r, of which the given share of r is
    // left; false without convergence.
    NOINLINE bool solve(double* r, const Operate& operate, double share_left = REDUCTION) {
        std::vector<double> y(size, 0.0), image(size);
        std::copy_n(r, size, residual.begin());
        const double goal = share_left * std::sqrt(dot(r, r, size));
        for (int64_t cycle = 0; cycle < CYCLES; ++cycle) {
            const double norm = std::sqrt(dot(residual.data(), residual.data(), size));
            if (!(norm - norm == 0.0)) return false;
            if (norm <= goal) {
                std::copy_n(y.begin(), size, r);
                return true;
            }
            const int64_t count = build(norm, goal, operate);
            std::vector<double> weights(count);
            for (int64_t i = count - 1; i >= 0; --i) {
                double total = right[i];
                for (int64_t k = i + 1; k < count; ++k) total = fma(-at(i, k), weights[k], total);
                weights[i] = total / at(i, i);
            }
            for (int64_t k = 0; k < count; ++k) add(weights[k], basis.data() + k * size, y.data(), size);
            operate(y.data(), image.data());
            share(size, [&](int64_t first, int64_t last) {
                for (int64_t i = first; i < last; ++i) residual[i] = r[i] - image[i];
            });
        }
        return false;
    }

  private:
    double& at(int64_t row, int64_t column) { return hessenberg[column * (RESTART + 1) + row]; }

    // Build an orthonormal basis by modified Gram-Schmidt, and return the number of vectors needed to reach the
    // tolerance.
    NOINLINE int64_t build(double norm, double goal, const Operate& operate) {
        divide(residual.data(), norm, basis.data(), size);
        std::fill(right.begin(), right.end(), 0.0);
        right[0] = norm;
        for (int64_t k = 0; k < RESTART; ++k) {
            InterruptCheck::of_this_call().after((k + 2) * size);
            double* next = basis.data() + (k + 1) * size;
            operate(basis.data() + k * size, next);
            for (int64_t j = 0; j <= k; ++j) {
                const double* old = basis.data() + j * size;
                const double along = dot(next, old, size);
                at(j, k) = along;
                add(-along, old, next, size);
            }
            const double left = std::sqrt(dot(next, next, size));
            for (int64_t j = 0; j < k; ++j) {
                const double above = at(j, k), below = at(j + 1, k);
                at(j, k) = fma(cosine[j], above, sine[j] * below);
                at(j + 1, k) = fma(-sine[j], above, cosine[j] * below);
            }
            const double whole = std::sqrt(fma(at(k, k), at(k, k), left * left));
            if (!(whole > 0.0)) return k;
            cosine[k] = at(k, k) / whole;
            sine[k] = left / whole;
            at(k, k) = whole;
            right[k + 1] = -sine[k] * right[k];
            right[k] = cosine[k] * right[k];
            if (!(std::fabs(right[k + 1]) > goal)) return k + 1;
            divide(next, left, next, size);
        }
        return RESTART;
    }
};

}  // namespace coadjoint
