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
        : products(gemm, size), n(int(size)), made((size / 2 + 1) * (size / 2 + 1)) {}

    // No pivoting is needed, since the Hermitian part of 1 - X is positive.
    void transform(const Planes<T>& X) { sweep(X, 0, n); }

  private:
    // Rows that are swept without splitting, which fit in the first cache; rows are padded to multiples of WIDTH.
    // Products have parts of at least PART columns, which threads share.
    static constexpr int LEAF = 32, WIDTH = 8, PART = 32;
    const PlaneProducts<T> products;
    const int n;
    PlanesOf<T> made;

    // Here a matrix is stored column by column, as in Fortran, and the columns of a block are `n` apart.
    void sweep(const Planes<T>& X, int64_t X11, int size) {
        if (size <= LEAF) return sweep_leaf(X, X11, size);
        const int first = size / 2, second = size - first;
        const int64_t X21 = X11 + first, X12 = X11 + int64_t(first) * n, X22 = X12 + first;
        sweep(X, X11, first);
        add(X, first, second, first, X11, X12, X12);
        add(X, second, second, first, X21, X12, X22);
        add(X, second, first, first, X21, X11, X21);
        sweep(X, X22, second);
        add(X, second, first, second, X22, X21, X21);
        add(X, first, first, second, X12, X21, X11);
        add(X, first, second, second, X12, X22, X12);
    }

    // The block at c += that at a times that at b, one of which may be c. Its columns are computed in parts, or its rows
    // if c replaces a: a part does not read what others replace.
    void add(const Planes<T>& X, int rows, int columns, int inner, int64_t a, int64_t b, int64_t c) {
        const Planes<T> product = made.layer();
        const bool by_rows = a == c;
        const Parts parts(by_rows ? rows : columns, std::max(PART, std::max(rows, columns) / 8));
        share_blocks(parts.count, [&](int64_t first, int64_t last) {
            for (int p = int(first); p < last; ++p) {
                const int down = by_rows ? parts.begin(p) : 0, right = by_rows ? 0 : parts.begin(p);
                const int high = by_rows ? parts.length(p) : rows, wide = by_rows ? columns : parts.length(p);
                const int64_t own = int64_t(parts.begin(p)) * (by_rows ? columns : rows);
                const int64_t to = c + down + int64_t(right) * n;
                products.multiply_blocks(high, wide, inner, X, a + down, X, b + int64_t(right) * n, product, own);
                for (int j = 0; j < wide; ++j)
                    for (int i = 0; i < high; ++i) {
                        const int64_t e = to + int64_t(j) * n + i;
                        X.set(e, X.at(e) + product.product(own + j * high + i));
                    }
            }
        });
    }

    // The same for one pivot after the other: with s = 1 / (1 - X_kk), X_ij += X_ik s X_kj, X_ik *= s, X_kj *= s and
    // X_kk *= s. Real and imaginary parts are apart, and columns padded to full vectors.
    void sweep_leaf(const Planes<T>& X, int64_t X11, int size) {
        constexpr bool COMPLEX_NUMBERS = sizeof(T) > sizeof(double);
        alignas(64) double re[LEAF][LEAF], im[LEAF][LEAF], pivot_re[LEAF], pivot_im[LEAF];
        const int width = (size + WIDTH - 1) / WIDTH * WIDTH;
        for (int j = 0; j < size; ++j)
            for (int i = 0; i < width; ++i) {
                const Complex entry = i < size ? X.at(X11 + i + int64_t(j) * n) : T(0.0);
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
            for (int i = 0; i < size; ++i) {
                T entry;
                set(entry, re[j][i], im[j][i]);
                X.set(X11 + i + int64_t(j) * n, entry);
            }
    }
};

}  // namespace coadjoint
