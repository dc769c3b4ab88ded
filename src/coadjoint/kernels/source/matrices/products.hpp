// Products of square matrices, by the BLAS whose routine the tables bring. Matrices stand row by row.
#pragma once

#include <algorithm>
#include <complex>
#include <cstdint>

namespace coadjoint {

typedef std::complex<double> Complex;

inline double conjugate(double value) { return value; }
inline Complex conjugate(const Complex& value) { return std::conj(value); }

// General matrices times general matrices, in Fortran's convention.
template <class T>
using Gemm = void (*)(const char*, const char*, const int*, const int*, const int*, const T*, const T*, const int*,
                      const T*, const int*, const T*, T*, const int*);

template <class T>
class Products {
  public:
    Products(int64_t gemm, int64_t size) : gemm(reinterpret_cast<Gemm<T>>(gemm)), n(int(size)) {}

    // c = a b. Fortran reads columns: it sees the transposed matrices, and their product in the other order.
    void multiply(const T* a, const T* b, T* c) const { panel(a, b, c, n, n, false); }

    // c = a b*, the conjugate transpose.
    void multiply_by_adjoint(const T* a, const T* b, T* c) const { panel(a, b, c, n, n, true); }

    // The same where the product is skew-Hermitian: of the entries above the diagonal some stand in panels that are
    // not computed, and all are taken from below.
    void multiply_skew(const T* a, const T* b, T* c) const {
        by_panels(a, b, c, false);
        mirror(c);
    }

    // c = a b*, where that is skew-Hermitian.
    void multiply_skew_by_adjoint(const T* a, const T* b, T* c) const {
        by_panels(a, b, c, true);
        mirror(c);
    }

  private:
    static constexpr int PANELS = 4, SMALL = 32;
    const Gemm<T> gemm;
    const int n;

    // The first `columns` entries of some rows of the product.
    void panel(const T* a, const T* b, T* c, int rows, int columns, bool adjoint) const {
        const T one(1.0), zero(0.0);
        const char plain = 'N', other = adjoint ? 'C' : 'N';
        gemm(&other, &plain, &columns, &rows, &n, &one, b, &n, a, &n, &zero, c, &n);
    }

    void by_panels(const T* a, const T* b, T* c, bool adjoint) const {
        const int panels = n < SMALL ? 1 : PANELS;
        for (int p = 0; p < panels; ++p) {
            const int first = n * p / panels, last = n * (p + 1) / panels;
            const int64_t row = int64_t(first) * n;
            panel(a + row, b, c + row, last - first, last, adjoint);
        }
    }

    void mirror(T* c) const {
        for (int64_t i = 0; i < n; ++i)
            for (int64_t j = 0; j < i; ++j) c[j * n + i] = -conjugate(c[i * n + j]);
    }
};

}  // namespace coadjoint
