// Products of square matrices, by the BLAS routines given in the tables. Matrices are stored row by row.
//
// An element has one matrix, or two: X = X0 + eps X1 with eps^2 = 0, of a semidirect product. Or it has several that are
// multiplied one by one, of a direct product.
#pragma once

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstdint>
#include <vector>

#include "numbers/thread_team.hpp"

namespace coadjoint {

typedef std::complex<double> Complex;

inline double conjugate(double value) { return value; }
inline float conjugate(float value) { return value; }
template <class R>
std::complex<R> conjugate(const std::complex<R>& value) { return std::conj(value); }

// Products without the tests for infinities of the standard library, and inverses without overflow.
inline double times(double a, double b) { return a * b; }
template <class R>
std::complex<R> times(const std::complex<R>& a, const std::complex<R>& b) {
    return {a.real() * b.real() - a.imag() * b.imag(), a.real() * b.imag() + a.imag() * b.real()};
}

// Without the function hypot of the C library, whose last bits differ between systems.
inline double magnitude(double a) { return std::fabs(a); }
inline double magnitude(const Complex& a) { return std::sqrt(a.real() * a.real() + a.imag() * a.imag()); }

inline Complex inverse(const Complex& a) {
    const double size = std::max(std::fabs(a.real()), std::fabs(a.imag())), re = a.real() / size, im = a.imag() / size;
    const double divisor = size * (re * re + im * im);
    return {re / divisor, -im / divisor};
}

// Call use(row) for the numbers of all rows of a triangle, long and short ones in turns, on the threads of a team.
template <class Use>
void each_row_shared(int64_t rows, const Use& use) {
    share_blocks((rows + 1) / 2, [&](int64_t first, int64_t last) {
        for (int64_t pair = first; pair < last; ++pair) {
            use(pair);
            if (rows - 1 - pair > pair) use(rows - 1 - pair);
        }
    });
}

// Call use(e, f) for the index e of each entry on or below the diagonal, and f of the opposite one; by blocks, which
// stay in the cache.
template <class Use>
void each_pair(int64_t n, const Use& use) {
    constexpr int64_t BLOCK = 8;
    for (int64_t first = 0; first < n; first += BLOCK)
        for (int64_t second = 0; second <= first; second += BLOCK)
            for (int64_t i = first; i < std::min(first + BLOCK, n); ++i)
                for (int64_t j = second; j < std::min(second + BLOCK, i + 1); ++j) use(i * n + j, j * n + i);
}

// to = factor (A - A*), or to += that.
template <class T>
void skew_part(int64_t n, const T* A, double factor, T* to, bool add) {
    each_pair(n, [=](int64_t e, int64_t f) {
        const T value = factor * (A[e] - conjugate(A[f])), sum = add ? to[e] + value : value;
        to[f] = -conjugate(sum);
        to[e] = sum;
    });
}

// Project a skew-Hermitian matrix on an algebra of blocks on the diagonal: four times the block of each row, with bits.
constexpr int64_t REAL_BLOCK = 1, TRACELESS_BLOCK = 2;
template <class T>
void project_on_blocks(int64_t n, const int64_t* block, T* X) {
    for (int64_t i = 0; i < n; ++i)
        for (int64_t j = 0; j < n; ++j) {
            T& entry = X[i * n + j];
            if (block[i] != block[j]) entry = T(0.0);
            if (block[i] & REAL_BLOCK) entry = T(std::real(entry));
        }
    for (int64_t first = 0, last; first < n; first = last) {
        T sum(0.0);
        for (last = first; last < n && block[last] == block[first]; ++last) sum += X[last * (n + 1)];
        for (int64_t i = first; i < last && (block[first] & TRACELESS_BLOCK); ++i) X[i * (n + 1)] -= sum / double(last - first);
    }
}

// General matrices times general matrices, in Fortran's convention.
template <class R>
using Gemm = void (*)(const char*, const char*, const int*, const int*, const int*, const R*, const R*, const int*,
                      const R*, const int*, const R*, R*, const int*);

template <class T>
struct RealType {
    typedef T type;
};
template <class R>
struct RealType<std::complex<R>> {
    typedef R type;
};

// The entries of a matrix in planes of real numbers: one, or of complex numbers three, the real parts, the imaginary
// parts, and their sums. Three products of planes of two factors give a complex product ("3M": N. J.
// Higham, SIAM J. Matrix Anal. Appl. 13 (1992) 681), with errors that are small beside the norms of both factors.
template <class T>
struct Planes {
    typedef T Real;
    static constexpr int COUNT = 1;
    T* plane[COUNT];

    T at(int64_t e) const { return plane[0][e]; }
    void set(int64_t e, T value) const { plane[0][e] = value; }
    T product(int64_t e) const { return plane[0][e]; }
};

template <class R>
struct Planes<std::complex<R>> {
    typedef R Real;
    typedef std::complex<R> T;
    static constexpr int COUNT = 3;
    R* plane[COUNT];

    T at(int64_t e) const { return {plane[0][e], plane[1][e]}; }
    void set(int64_t e, const T& value) const {
        plane[0][e] = value.real(), plane[1][e] = value.imag(), plane[2][e] = value.real() + value.imag();
    }
    // Of (a + ib)(c + id), from ac, bd and (a + b)(c + d).
    T product(int64_t e) const {
        const R first = plane[0][e], second = plane[1][e];
        return {first - second, plane[2][e] - (first + second)};
    }
};

// Planes with their memory, of some matrices.
template <class T>
class PlanesOf {
  public:
    typedef typename Planes<T>::Real Real;
    explicit PlanesOf(int64_t square, int64_t layers = 1)
        : distance(square + APART), numbers(Planes<T>::COUNT * distance * layers) {}

    Planes<T> layer(int64_t l = 0) {
        Planes<T> found;
        for (int k = 0; k < Planes<T>::COUNT; ++k)
            found.plane[k] = numbers.data() + (l * Planes<T>::COUNT + k) * distance;
        return found;
    }

  private:
    // An odd number of cache lines: equal entries of different planes are not in the same set of the cache.
    static constexpr int64_t APART = 9 * 64 / int64_t(sizeof(Real));
    const int64_t distance;
    std::vector<Real> numbers;
};

// The parts of a range of `size` numbers: `most`, or a little more or less, and from multiples of a vector.
struct Parts {
    int size, width, count;
    Parts(int size, int most) : size(size) {
        const int wanted = (size + most - 1) / most;
        width = ((size + wanted - 1) / wanted + 7) / 8 * 8, count = (size + width - 1) / width;
    }
    int begin(int part) const { return part * width; }
    int end(int part) const { return std::min(size, (part + 1) * width); }
    int length(int part) const { return end(part) - begin(part); }
};

// Of the parts of a triangle, the one whose turn it is: long and short ones alternate, so that threads have equal work.
inline int in_turns(int turn, int count) { return turn % 2 ? count - 1 - turn / 2 : turn / 2; }

// Products of planes, by the routine for their real numbers. Each call computes a block, on one thread of a team: which
// blocks depends on the size alone, so that their rounding does not depend on the threads.
template <class T>
class PlaneProducts {
  public:
    typedef typename Planes<T>::Real Real;
    PlaneProducts(int64_t gemm, int64_t size)
        : gemm(reinterpret_cast<Gemm<Real>>(gemm)), n(int(size)), inner(n, uncopied() ? 256 : n),
          rows(n, uncopied() ? 48 : sizeof(Real) == 8 ? panel() : n),
          columns(n, uncopied() ? 64 : sizeof(Real) == 8 ? n : panel()),
          narrow(n, uncopied() ? 16 : std::max(n / (n < 256 ? 4 : 8), 16)) {}

    // c = a b, or c += a b.
    void multiply(const Planes<T>& a, const Planes<T>& b, const Planes<T>& c, bool add = false) const {
        by_blocks(a, b, c, add, rows, false);
    }

    // Of a skew-Hermitian product the entries on and below the diagonal, and some others.
    void lower(const Planes<T>& a, const Planes<T>& b, const Planes<T>& c, bool add = false) const {
        by_blocks(a, b, c, add, narrow, true);
    }

    // The part of a product that `lower` computes.
    double lower_part() const {
        int64_t entries = 0;
        for (int down = 0; down < narrow.count; ++down)
            for (int right = 0; right < columns.count; ++right)
                entries += int64_t(narrow.length(down)) * std::max(0, lower_end(down, right) - columns.begin(right));
        return double(entries) / (double(n) * n);
    }

    // Blocks of planes in Fortran's order: c = a b, whose columns are `n` apart in a and b, and adjacent in c.
    void multiply_blocks(int rows, int columns, int inner, const Planes<T>& a, int64_t at_a, const Planes<T>& b,
                         int64_t at_b, const Planes<T>& c, int64_t at_c) const {
        for (int k = 0; k < Planes<T>::COUNT; ++k)
            call(rows, columns, inner, a.plane[k] + at_a, b.plane[k] + at_b, 0.0, c.plane[k] + at_c, rows);
    }

  private:
    const Gemm<Real> gemm;
    const int n;
    const Parts inner, rows, columns, narrow;

    // Whether blocks are so small that OpenBLAS does not copy them, which it can with these instructions, and which is
    // faster up to this size.
    bool uncopied() const {
#if defined(__AVX512F__)
        return n <= 512;
#else
        return false;
#endif
    }

    // The width of a panel: of columns in Fortran's order in double precision, and of rows in single, as is faster.
    int panel() const { return n < 64 ? n : n < 256 ? n / 2 : std::max(128, std::min(n / 4, 256)); }

    // Of the entries on and below the diagonal in a block, the last column, and one.
    int lower_end(int down, int right) const { return std::min(columns.end(right), narrow.end(down)); }

    void by_blocks(const Planes<T>& a, const Planes<T>& b, const Planes<T>& c, bool add, const Parts& rows,
                   bool lower) const {
        const int64_t blocks = int64_t(rows.count) * columns.count;
        share_blocks(Planes<T>::COUNT * blocks, [&](int64_t first, int64_t last) {
            for (int64_t e = first; e < last; ++e) {
                const int down = in_turns(int(e % blocks / columns.count), rows.count), right = int(e % columns.count);
                const int k = int(e / blocks), end = lower ? lower_end(down, right) : columns.end(right);
                block(a.plane[k], b.plane[k], c.plane[k], rows.begin(down), rows.end(down), columns.begin(right), end,
                      add);
            }
        });
    }

    // Fortran reads columns: it sees the transposed matrices, and their product in the opposite order.
    void block(const Real* a, const Real* b, Real* c, int top, int bottom, int left, int right, bool add) const {
        if (right <= left) return;
        for (int p = 0; p < inner.count; ++p)
            call(right - left, bottom - top, inner.length(p), b + int64_t(inner.begin(p)) * n + left,
                 a + int64_t(top) * n + inner.begin(p), add || p > 0 ? 1.0 : 0.0, c + int64_t(top) * n + left, n);
    }

    void call(int rows, int columns, int inner, const Real* a, const Real* b, double factor, Real* c, int apart) const {
        const char plain = 'N';
        const Real one(1.0), beta(factor);
        gemm(&plain, &plain, &rows, &columns, &inner, &one, a, &n, b, &n, &beta, c, &apart);
    }
};

// Products of matrices whose complex entries are adjacent, by the routine for these.
template <class T>
class Products {
  public:
    Products(int64_t gemm, int64_t size, int64_t layers, bool direct = false)
        : gemm(reinterpret_cast<Gemm<T>>(gemm)), n(int(size)), square(size * size), layers(layers), direct(direct) {}

    // c = a b. Fortran reads columns: it sees the transposed matrices, and their product in the opposite order.
    void multiply(const T* a, const T* b, T* c) const { of_layers(a, b, c, false, false); }

    // The same for a skew-Hermitian product: some entries above the diagonal are in panels that are not computed, and
    // all are taken from below.
    void multiply_skew(const T* a, const T* b, T* c) const { of_layers(a, b, c, false, true); }

    // c = a b*, b* the conjugate transpose, for a skew-Hermitian product.
    void multiply_skew_by_adjoint(const T* a, const T* b, T* c) const { of_layers(a, b, c, true, true); }

  private:
    // Panels, which threads share, of which only the lower half is computed if that suffices, and sizes below which one
    // panel is faster.
    static constexpr int PANELS = 4, SMALL = 32;
    const Gemm<T> gemm;
    const int n;
    const int64_t square, layers;
    const bool direct;

    void of_layers(const T* a, const T* b, T* c, bool adjoint, bool skew) const {
        by_panels(a, b, c, adjoint, skew, false);
        for (int64_t l = 1; direct && l < layers; ++l)
            by_panels(a + l * square, b + l * square, c + l * square, adjoint, skew, false);
        if (layers == 2 && !direct) {
            by_panels(a, b + square, c + square, adjoint, skew, false);
            by_panels(a + square, b, c + square, adjoint, skew, true);
        }
        if (skew)
            for (int64_t l = 0; l < layers; ++l) mirror(c + l * square);
    }

    void by_panels(const T* a, const T* b, T* c, bool adjoint, bool skew, bool add) const {
        const int panels = n < SMALL ? 1 : std::max(PANELS, n / 256);
        share_blocks(panels, [=, this](int64_t begin, int64_t end) {
            for (int turn = int(begin); turn < end; ++turn) {
                const int p = in_turns(turn, panels), first = n * p / panels, last = n * (p + 1) / panels;
                const int64_t row = int64_t(first) * n;
                panel(a + row, b, c + row, last - first, skew ? last : n, adjoint, add);
            }
        });
    }

    // The first `columns` entries of some rows of the product.
    void panel(const T* a, const T* b, T* c, int rows, int columns, bool adjoint, bool add) const {
        const T one(1.0), beta(add ? 1.0 : 0.0);
        const char plain = 'N', other = adjoint ? 'C' : 'N';
        gemm(&other, &plain, &columns, &rows, &n, &one, b, &n, a, &n, &beta, c, &n);
    }

    void mirror(T* c) const {
        for (int64_t i = 0; i < n; ++i)
            for (int64_t j = 0; j < i; ++j) c[j * n + i] = -conjugate(c[i * n + j]);
    }
};

}  // namespace coadjoint
