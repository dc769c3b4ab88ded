// The Cayley transform of a skew-Hermitian matrix, by the BLAS routine given in the tables.
#pragma once

#include <vector>

#include "matrices/products.hpp"

namespace coadjoint {

inline void set(double& entry, double real, double) { entry = real; }
inline void set(Complex& entry, double real, double imaginary) { entry = {real, imaginary}; }

// X := (1 - X)^-1 - 1 =: C, so that the Cayley transform (1 + X)(1 - X)^-1 is 1 + 2 C. No difference from 1 is formed,
// so rounding errors are relative to C. Rows may be columns: the transposed matrix has the transposed result.
template <class T>
class Cayley {
  public:
    Cayley(int64_t gemm, int64_t size)
        : gemm(reinterpret_cast<Gemm<T>>(gemm)), n(int(size)), copy((size / 2 + 1) * (size / 2 + 1)) {}

    // No pivoting is needed, since the Hermitian part of 1 - X is positive.
    void transform(T* X) { sweep(X, n); }

  private:
    // Rows that are swept without splitting, which fit in the first cache; rows are padded to multiples of WIDTH.
    static constexpr int LEAF = 32, WIDTH = 8;
    const Gemm<T> gemm;
    const int n;
    std::vector<T> copy;

    // Here a matrix is stored column by column, as in Fortran, and the columns of a block are `n` apart.
    void sweep(T* X, int size) {
        if (size <= LEAF) return sweep_leaf(X, size);
        const int first = size / 2, second = size - first;
        T *X21 = X + first, *X12 = X + int64_t(first) * n, *X22 = X12 + first, *E = copy.data();
        sweep(X, first);
        // X12 := (1 + C11) X12, X22 += X21 X12, X21 := X21 (1 + C11)
        save(X12, first, second);
        add(first, second, first, X, n, E, first, X12);
        add(second, second, first, X21, n, X12, n, X22);
        save(X21, second, first);
        add(second, first, first, E, second, X, n, X21);
        sweep(X22, second);
        // X21 := (1 + C22) X21, C11 += X12 X21, X12 := X12 (1 + C22)
        save(X21, second, first);
        add(second, first, second, X22, n, E, second, X21);
        add(first, first, second, X12, n, X21, n, X);
        save(X12, first, second);
        add(first, second, second, E, first, X22, n, X12);
    }

    void save(const T* block, int rows, int columns) {
        for (int j = 0; j < columns; ++j) std::copy_n(block + int64_t(j) * n, rows, copy.data() + int64_t(j) * rows);
    }

    // c += a b
    void add(int rows, int columns, int inner, const T* a, int lda, const T* b, int ldb, T* c) const {
        const char plain = 'N';
        const T one(1.0);
        gemm(&plain, &plain, &rows, &columns, &inner, &one, a, &lda, b, &ldb, &one, c, &n);
    }

    // The same for one pivot after the other: with s = 1 / (1 - X_kk), X_ij += X_ik s X_kj, X_ik *= s, X_kj *= s and
    // X_kk *= s. Real and imaginary parts are apart, and columns padded to full vectors.
    void sweep_leaf(T* X, int size) {
        constexpr bool COMPLEX_NUMBERS = sizeof(T) > sizeof(double);
        alignas(64) double re[LEAF][LEAF], im[LEAF][LEAF], pivot_re[LEAF], pivot_im[LEAF];
        const int width = (size + WIDTH - 1) / WIDTH * WIDTH;
        for (int j = 0; j < size; ++j)
            for (int i = 0; i < width; ++i) {
                const Complex entry = i < size ? X[i + int64_t(j) * n] : T(0.0);
                re[j][i] = entry.real(), im[j][i] = entry.imag();
            }
        for (int k = 0; k < size; ++k) {
            const Complex own(re[k][k], im[k][k]), s = inverse(1.0 - own), diagonal = times(own, s);
            for (int i = 0; i < width; ++i) {
                pivot_re[i] = re[k][i] * s.real() - im[k][i] * s.imag();
                pivot_im[i] = re[k][i] * s.imag() + im[k][i] * s.real();
            }
            for (int j = 0; j < size; ++j) {
                const double a = re[j][k], b = im[j][k];
                double *to_re = re[j], *to_im = im[j];
                if (j == k) {
                    std::copy_n(pivot_re, width, to_re), std::copy_n(pivot_im, width, to_im);
                    to_re[k] = diagonal.real(), to_im[k] = diagonal.imag();
                    continue;
                }
                if (COMPLEX_NUMBERS) {
                    for (int i = 0; i < width; ++i) {
                        to_re[i] += a * pivot_re[i] - b * pivot_im[i];
                        to_im[i] += a * pivot_im[i] + b * pivot_re[i];
                    }
                } else {
                    for (int i = 0; i < width; ++i) to_re[i] += a * pivot_re[i];
                }
                to_re[k] = a * s.real() - b * s.imag(), to_im[k] = a * s.imag() + b * s.real();
            }
        }
        for (int j = 0; j < size; ++j)
            for (int i = 0; i < size; ++i) set(X[i + int64_t(j) * n], re[j][i], im[j][i]);
    }
};

}  // namespace coadjoint
