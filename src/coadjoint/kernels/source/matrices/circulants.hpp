// Circulant matrices times the cyclic diagonals of a skew-Hermitian matrix of odd size, by Fourier transforms of eight
// diagonals side by side. From n = 5 on that is faster than the sums.
#pragma once

#include "matrices/fourier.hpp"
#include "matrices/products.hpp"
#include "numbers/thread_team.hpp"

namespace coadjoint {

// Diagonals that are transformed together: one vector of the widest processors.
constexpr int64_t SIDE_BY_SIDE = 8;
typedef Lanes<SIDE_BY_SIDE> Eight;

// The real parts of eight numbers, followed by their imaginary parts.
inline double* numbers_of(ComplexNumber<Eight>& numbers) { return reinterpret_cast<double*>(&numbers); }
inline const double* numbers_of(const ComplexNumber<Eight>& numbers) {
    return reinterpret_cast<const double*>(&numbers);
}

template <class T>
class Circulants {
  public:
    // `columns`: for each cyclic diagonal up to (n - 1)/2 the first column of its matrix, even.
    NOINLINE Circulants(int64_t n, const double* columns)
        : n(n), diagonals((n + 1) / 2), groups((diagonals + SIDE_BY_SIDE - 1) / SIDE_BY_SIDE), fourier(n),
          spectrum(n * groups) {
        ComplexNumber<Eight>* const row = fourier.input();
        for (int64_t g = 0; g < groups; ++g) {
            for (int64_t k = 0; k < n; ++k)
                for (int64_t lane = 0; lane < SIDE_BY_SIDE; ++lane) {
                    const int64_t d = g * SIDE_BY_SIDE + lane;
                    put(row, k, lane, d < diagonals ? columns[d * n + k] : 0.0, 0.0);
                }
            const ComplexNumber<Eight>* found = fourier.transform(row);
            for (int64_t k = 0; k < n; ++k) spectrum.at[g * n + k] = found[k].re / Eight(double(n));
        }
    }

    int64_t work() const { return groups * (2 * fourier.work() + n) * SIDE_BY_SIDE; }

    NOINLINE void apply(const T* W, T* P) {
        share_with_copies(fourier, groups, [&](Fourier<Eight>& own, int64_t g) { apply(W, P, g, own); });
    }

  private:
    const int64_t n, diagonals, groups;
    Fourier<Eight> fourier;
    AlignedArray<Eight> spectrum;

    // Eight diagonals.
    void apply(const T* W, T* P, int64_t g, Fourier<Eight>& own) const {
        ComplexNumber<Eight>* const row = own.input();
        const int64_t first = g * SIDE_BY_SIDE, lanes = std::min(SIDE_BY_SIDE, diagonals - first);
        for (int64_t a = 0; a < n; ++a)
            for (int64_t lane = 0; lane < lanes; ++lane) {
                const Complex value = W[a * n + wrapped(a + first + lane)];
                put(row, a, lane, value.real(), value.imag());
            }
        ComplexNumber<Eight>* transformed = own.transform(row);
        for (int64_t k = 0; k < n; ++k) {
            transformed[k].re *= spectrum.at[g * n + k];
            transformed[k].im *= spectrum.at[g * n + k];
        }
        transformed = own.transform(transformed);
        for (int64_t a = 0; a < n; ++a)
            for (int64_t lane = 0; lane < lanes; ++lane) {
                const int64_t c = wrapped(a + first + lane);
                const double* at = numbers_of(transformed[a ? n - a : 0]) + lane;  // forward twice: reversed
                // the real part of the main diagonal is only rounding
                store(P[a * n + c], a == c ? 0.0 : at[0], at[SIDE_BY_SIDE]);
                if (a != c) P[c * n + a] = -conjugate(P[a * n + c]);
            }
    }

    int64_t wrapped(int64_t column) const { return column < n ? column : column - n; }
    static void put(ComplexNumber<Eight>* row, int64_t k, int64_t lane, double re, double im) {
        numbers_of(row[k])[lane] = re;
        numbers_of(row[k])[SIDE_BY_SIDE + lane] = im;
    }
    static void store(double& to, double real, double) { to = real; }
    static void store(Complex& to, double real, double imaginary) { to = Complex(real, imaginary); }
};

}  // namespace coadjoint
