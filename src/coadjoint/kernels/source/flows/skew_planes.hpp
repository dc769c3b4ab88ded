// The invariant planes of a skew matrix with their frequencies, and products of small matrices, column after column.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "numbers/lanes.hpp"

namespace coadjoint {

typedef std::vector<double> Matrix;

// Some rows of a few columns of C += A B, in registers.
template <class A, int COLUMNS>
INLINE void add_tile(const double* a, const double* b, double* c, int64_t rows, int64_t inner) {
    A sum[COLUMNS];
    for (int j = 0; j < COLUMNS; ++j) sum[j] = load<A>(c + j * rows);
    for (int64_t k = 0; k < inner; ++k) {
        const A from = load<A>(a + k * rows);
        for (int j = 0; j < COLUMNS; ++j) sum[j] += from * A(b[j * inner + k]);
    }
    for (int j = 0; j < COLUMNS; ++j) store(c + j * rows, sum[j]);
}

template <class A>
INLINE void add_strip(const double* a, const double* b, double* c, int64_t rows, int64_t inner, int64_t columns) {
    int64_t j = 0;
    for (; j + 4 <= columns; j += 4) add_tile<A, 4>(a, b + j * inner, c + j * rows, rows, inner);
    if (columns - j == 3) return add_tile<A, 3>(a, b + j * inner, c + j * rows, rows, inner);
    if (columns - j == 2) return add_tile<A, 2>(a, b + j * inner, c + j * rows, rows, inner);
    if (columns - j == 1) add_tile<A, 1>(a, b + j * inner, c + j * rows, rows, inner);
}

// C += A B for any sizes: sums in the order of k.
inline void add_product(const double* a, const double* b, double* c, int64_t rows, int64_t inner, int64_t columns) {
    int64_t i = 0;
    for (; i + 8 <= rows; i += 8) add_strip<Lanes<8>>(a + i, b, c + i, rows, inner, columns);
    if (rows - i >= 4) add_strip<Lanes<4>>(a + i, b, c + i, rows, inner, columns), i += 4;
    if (rows - i >= 2) add_strip<Lanes<2>>(a + i, b, c + i, rows, inner, columns), i += 2;
    if (rows - i >= 1) add_strip<double>(a + i, b, c + i, rows, inner, columns);
}

inline Matrix product(const double* a, const double* b, int64_t m) {
    Matrix c(m * m);
    add_product(a, b, c.data(), m, m, m);
    return c;
}

inline double dot(const double* a, const double* b, int64_t count) {
    double sum = 0.0;
    for (int64_t i = 0; i < count; ++i) sum += a[i] * b[i];
    return sum;
}

// Plane p has the columns u = 2 p and w = 2 p + 1 of `vectors`: D u = f w and D w = -f u, f = frequency[p] > 0.
struct SkewPlanes {
    std::vector<double> frequency;
    Matrix vectors;
};

class SkewPlanesOf {
  public:
    // Householder reflections make D tridiagonal. A tridiagonal skew matrix couples its even coordinates with its odd
    // ones, by a bidiagonal matrix, whose rows are made orthogonal by rotations. The planes are orthonormal to
    // rounding, even for nearly equal frequencies.
    SkewPlanesOf(Matrix skew, int64_t m) : m(m), odd(m / 2), even(m - m / 2), T(std::move(skew)), Q(m * m), v(m), image(m) {
        for (int64_t i = 0; i < m; ++i) Q[i * (m + 1)] = 1.0;
        for (int64_t k = 0; k + 2 < m; ++k) reflect(k);
        rows.assign(odd * even, 0.0);
        mixed.assign(odd * odd, 0.0);
        for (int64_t a = 0; a < odd; ++a) {
            rows[a * even + a] = T[2 * a * m + 2 * a + 1];
            if (a + 1 < even) rows[a * even + a + 1] = T[(2 * a + 2) * m + 2 * a + 1];
            mixed[a * (odd + 1)] = 1.0;
        }
        make_orthogonal();
    }

    SkewPlanes operator()() const {
        std::vector<double> all(odd);
        double fastest = 0.0;
        for (int64_t a = 0; a < odd; ++a) {
            all[a] = std::sqrt(dot(&rows[a * even], &rows[a * even], even));
            fastest = std::max(fastest, all[a]);
        }
        SkewPlanes found;
        found.vectors.resize(2 * odd * m);
        double* u = found.vectors.data();
        for (int64_t a = 0; a < odd; ++a) {
            // Rounding must not rotate the kernel of D.
            if (all[a] <= 4.0 * double(m) * UNIT_ROUNDOFF * fastest) continue;
            double* w = u + m;
            for (int64_t e = 0; e < even; ++e) {
                const double factor = rows[a * even + e] / all[a];
                for (int64_t i = 0; i < m; ++i) u[i] += Q[2 * e * m + i] * factor;
            }
            for (int64_t o = 0; o < odd; ++o)
                for (int64_t i = 0; i < m; ++i) w[i] += Q[(2 * o + 1) * m + i] * mixed[a * odd + o];
            found.frequency.push_back(all[a]);
            u = w + m;
        }
        found.vectors.resize(u - found.vectors.data());
        return found;
    }

  private:
    static constexpr int64_t SWEEPS = 40;  // sweeps of Jacobi's method, which needs six or seven
    const int64_t m, odd, even;
    Matrix T, Q, rows, mixed, v, image;

    // Eliminate the entries of column k below the subdiagonal by a reflection 1 - factor v v^T on both sides.
    void reflect(int64_t k) {
        const double* column = &T[k * m];
        const double beyond = dot(column + k + 2, column + k + 2, m - k - 2);
        if (beyond == 0.0) return;
        std::fill(v.begin(), v.end(), 0.0);
        std::copy(column + k + 1, column + m, v.begin() + k + 1);
        const double length = std::sqrt(fma(v[k + 1], v[k + 1], beyond));
        v[k + 1] += v[k + 1] < 0.0 ? -length : length;
        const double factor = 2.0 / fma(v[k + 1], v[k + 1], beyond);
        std::fill(image.begin(), image.end(), 0.0);
        add_product(T.data(), v.data(), image.data(), m, m, 1);
        for (double& value : image) value *= factor;
        // v^T T v is 0, and in the columns before k the other rows are zero already.
        for (int64_t j = k; j < m; ++j)
            for (int64_t i = k; i < m; ++i) T[j * m + i] += v[i] * image[j] - image[i] * v[j];
        std::fill(image.begin(), image.end(), 0.0);
        add_product(Q.data(), v.data(), image.data(), m, m, 1);
        for (int64_t j = k + 1; j < m; ++j)
            for (int64_t i = 0; i < m; ++i) Q[j * m + i] -= factor * image[i] * v[j];
    }

    // One-sided Jacobi: rotate pairs of rows, and those of `mixed` with them, until all are orthogonal.
    void make_orthogonal() {
        bool rotated = true;
        std::vector<double> square(odd);
        for (int64_t sweep = 0; rotated && sweep < SWEEPS; ++sweep) {
            rotated = false;
            for (int64_t a = 0; a < odd; ++a) square[a] = dot(&rows[a * even], &rows[a * even], even);
            for (int64_t a = 0; a < odd; ++a)
                for (int64_t b = a + 1; b < odd; ++b) {
                    double *one = &rows[a * even], *other = &rows[b * even];
                    const double between = dot(one, other, even);
                    if (between * between <= 4.0 * UNIT_ROUNDOFF * UNIT_ROUNDOFF * (square[a] * square[b])) continue;
                    rotated = true;
                    const double slope = (square[b] - square[a]) / (2.0 * between);
                    const double tangent =
                        (slope < 0.0 ? -1.0 : 1.0) / (absolute(slope) + std::sqrt(fma(slope, slope, 1.0)));
                    const double c = 1.0 / std::sqrt(fma(tangent, tangent, 1.0));
                    square[a] -= tangent * between;
                    square[b] += tangent * between;
                    rotate(one, other, even, c, c * tangent);
                    rotate(&mixed[a * odd], &mixed[b * odd], odd, c, c * tangent);
                }
        }
    }

    // Explicit fma: compilers may contract a product that is added in one place and subtracted in another.
    static void rotate(double* a, double* b, int64_t count, double c, double s) {
        for (int64_t i = 0; i < count; ++i) {
            const double one = a[i], other = b[i];
            a[i] = fma(c, one, -(s * other));
            b[i] = fma(c, other, s * one);
        }
    }
};

}  // namespace coadjoint
