// From a matrix W to its stream matrix P: linear maps that act on each diagonal of W by itself.
#pragma once

#include <vector>

#include "boundary/codes.hpp"
#include "matrices/products.hpp"

namespace coadjoint {

// What is at `numbers`, by kind:
//   TRIDIAGONAL: for each diagonal m from the main one upwards the factors L D L^T of a tridiagonal matrix, by rows:
//                n x n below the diagonal of L, then n x n inverse pivots. A pivot of the main diagonal whose inverse is
//                zero stands for a matrix that does not see the trace: then the mean is taken off.
//   CIRCULANT:   for each cyclic diagonal d up to (n - 1)/2 the n entries of a circulant matrix's first column.
//   WEIGHTS:     n x n factors of the entries.
template <class T>
class Stream {
  public:
    Stream(int64_t kind, int64_t size, const double* numbers)
        : kind(kind), n(size), numbers(numbers), row(kind == CIRCULANT ? 5 * size : 0) {}

    // About how many multiplications it takes.
    int64_t work() const { return kind == CIRCULANT ? n * n * n : 4 * n * n; }

    void apply(const T* W, T* P) {
        if (kind == TRIDIAGONAL) solve(W, P);
        if (kind == CIRCULANT) convolve(W, P);
        if (kind == WEIGHTS)
            for (int64_t e = 0; e < n * n; ++e) P[e] = numbers[e] * W[e];
    }

  private:
    const int64_t kind, n;
    const double* const numbers;
    std::vector<double> row;

    // Row by row, all diagonals at once: what one row needs of another stands side by side.
    void solve(const T* W, T* P) const {
        const double *below = numbers, *inverse = numbers + n * n;
        for (int64_t i = 0; i < n; ++i) {
            const T *from = W + i * n + i, *before = P + (i - 1) * n + i - 1;
            T* to = P + i * n + i;
            if (i == 0) std::copy_n(from, n, to);
            else
                for (int64_t m = 0; m < n - i; ++m) to[m] = from[m] - below[i * n + m] * before[m];
        }
        for (int64_t i = n - 1; i >= 0; --i) {
            T* to = P + i * n + i;
            const T* after = P + (i + 1) * n + i + 1;
            for (int64_t m = 0; m < n - i; ++m) to[m] *= inverse[i * n + m];
            for (int64_t m = 0; m < n - i - 1; ++m) to[m] -= below[(i + 1) * n + m] * after[m];
        }
        if (inverse[(n - 1) * n] == 0.0) {
            T mean(0.0);
            for (int64_t i = 0; i < n; ++i) mean += P[i * n + i];
            mean /= double(n);
            for (int64_t i = 0; i < n; ++i) P[i * n + i] -= mean;
        }
        for (int64_t i = 0; i < n; ++i)
            for (int64_t j = i + 1; j < n; ++j) P[j * n + i] = -conjugate(P[i * n + j]);
    }

    void convolve(const T* W, T* P) {
        double *twice = row.data(), *real = twice + 2 * n, *imaginary = real + n, *column = imaginary + n;
        for (int64_t d = 0; d <= (n - 1) / 2; ++d) {
            const double* kernel = numbers + d * n;
            for (int64_t j = 0; j < n; ++j) twice[j] = twice[n + j] = kernel[j];
            std::fill_n(real, 2 * n, 0.0);
            for (int64_t b = 0; b < n; ++b) {
                const Complex value = W[b * n + (b + d) % n];
                const double x = value.real(), y = value.imag(), *shifted = twice + n - b;
                for (int64_t a = 0; a < n; ++a) {
                    real[a] += x * shifted[a];
                    imaginary[a] += y * shifted[a];
                }
            }
            (void)column;
            for (int64_t a = 0; a < n; ++a) {
                const int64_t c = (a + d) % n;
                store(P[a * n + c], real[a], imaginary[a]);
                if (d) P[c * n + a] = -conjugate(P[a * n + c]);
            }
        }
    }

    static void store(double& to, double real, double) { to = real; }
    static void store(Complex& to, double real, double imaginary) { to = Complex(real, imaginary); }
};

}  // namespace coadjoint
