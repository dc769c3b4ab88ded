// Modes of a skew-Hermitian matrix, diagonal by diagonal: their coefficients are computed, changed, and the change is
// added.
#pragma once

#include <vector>

#include "boundary/codes.hpp"
#include "boundary/interrupts.hpp"
#include "matrices/fourier.hpp"
#include "matrices/products.hpp"
#include "numbers/thread_team.hpp"

namespace coadjoint {

// Contents of `basis` by kind; a mode is a unit vector along its diagonal:
//   HARMONICS: for each mode the first half of its entries (i, i + d), including the middle one if there is one. It is
//              even about the middle if its number minus d is even, else odd.
//   WAVES:     cos(2 pi k/n), then sin(2 pi k/n), k = 0, ..., n - 1. The mode k of the cyclic diagonal d has the entries
//              exp(2 pi i k (d + 2 a)/n)/sqrt(n) at (a, a + d mod n), d from 0 to (n - 1)/2.
class Modes {
  public:
    explicit Modes(const ForceTable& table)
        : table(table), n(table.extent), waves(table.shape == WAVES), last(waves ? (n + 1) / 2 : n),
          harmonics(last), memory(n, waves) {
        const double* harmonic = table.basis;
        for (int64_t d = 0; d < last && !waves; ++d) {
            harmonics[d] = harmonic;
            harmonic += (table.begin[d + 1] - table.begin[d]) * ((n - d + 1) / 2);
        }
        numbers = waves ? 2 * n : harmonic - table.basis;
    }

    int64_t size() const { return n; }
    int64_t count() const { return table.begin[last]; }
    int64_t diagonals() const { return last; }
    int64_t basis_size() const { return numbers; }

    // Add to W its modes times `move(e, c)` of their indices e in the table and their coefficients c, which are those of
    // `from` without `rest`, or zero if it is null. On the main diagonal waves of opposite numbers are combined if
    // `paired`. Threads of this member share a few diagonals after the other.
    template <class Move>
    void change(Complex* W, const Complex* from, const Complex* rest, bool paired, Move move) {
        aim = rest;
        for (int64_t begin = 0; begin < last; begin += TOGETHER) {
            const int64_t end = std::min(last, begin + TOGETHER);
            int64_t work = 0;
            for (int64_t d = begin; d < end; ++d) work += work_of(d);
            InterruptCheck::of_this_call().after(work);
            share_with_copies(memory, end - begin, [&](Memory& own, int64_t d) {
                change(W, from, begin + d, paired, move, own);
            });
        }
    }

    static Complex times(const Complex& a, const Complex& b) {
        return Complex(a.real() * b.real() - a.imag() * b.imag(), a.real() * b.imag() + a.imag() * b.real());
    }

  private:
    static constexpr int64_t TOGETHER = 64;  // diagonals between two checks for interrupts

    // Of one diagonal; real parts, then imaginary ones.
    struct Memory {
        std::vector<double> first, second, even, odd;
        std::vector<Complex> coefficients;
        Fourier<double> fourier;  // of waves
        Memory(int64_t n, bool waves)
            : first(2 * n), second(2 * n), even(2 * n), odd(2 * n), fourier(waves ? n : 1) {}
    };

    const ForceTable& table;
    const int64_t n;
    const bool waves;
    const int64_t last;
    int64_t numbers;  // of the basis
    std::vector<const double*> harmonics;  // the first one of each diagonal
    Memory memory;
    const Complex* aim = nullptr;  // the matrix at rest of the layer that is read

    int64_t work_of(int64_t d) const {
        const int64_t count = table.begin[d + 1] - table.begin[d];
        return waves ? (count ? 2 * memory.fourier.work() : 0) : 4 * (n - d) * count;
    }

    template <class Move>
    void change(Complex* W, const Complex* read, int64_t d, bool paired, Move move, Memory& own) const {
        const int64_t from = table.begin[d], to = table.begin[d + 1], length = waves ? n : n - d;
        if (from == to) return;
        if (read) fold(read, d, length, own);
        std::fill(own.even.begin(), own.even.end(), 0.0);
        std::fill(own.odd.begin(), own.odd.end(), 0.0);
        if (waves) change_waves(d, from, to, read, move, own);
        const double* harmonic = harmonics[d];
        for (int64_t e = from; e < to && !waves; ++e) {
            const int64_t k = table.direction[e];
            const int64_t half = (length + 1) / 2;
            const bool is_odd = (k - d) % 2;
            const double* part = (is_odd ? own.second : own.first).data();
            const Complex c(read ? dot(harmonic, part, half) : 0.0, read ? dot(harmonic, part + n, half) : 0.0);
            const Complex moved = move(e, c);
            double* sum = (is_odd ? own.odd : own.even).data();
            for (int64_t i = 0; i < half; ++i) {
                sum[i] += moved.real() * harmonic[i];
                sum[n + i] += moved.imag() * harmonic[i];
            }
            harmonic += half;
        }
        add(W, d, length, paired, own);
    }

    Complex moving(const Complex* W, int64_t e) const {
        return aim ? W[e] - aim[e] : W[e];
    }

    // The diagonal; for harmonics its even and its odd part.
    void fold(const Complex* W, int64_t d, int64_t length, Memory& own) const {
        for (int64_t a = 0; a < length; ++a) {
            const int64_t b = length - 1 - a;
            const Complex here = moving(W, a * n + (a + d) % n);
            const Complex there = waves || a == b ? Complex(0.0) : moving(W, b * n + b + d);
            own.first[a] = here.real() + there.real(), own.first[n + a] = here.imag() + there.imag();
            own.second[a] = here.real() - there.real(), own.second[n + a] = here.imag() - there.imag();
        }
    }

    // In four sums, in a fixed order.
    static double dot(const double* a, const double* b, int64_t length) {
        double sum[4] = {0.0, 0.0, 0.0, 0.0};
        int64_t i = 0;
        for (; i + 4 <= length; i += 4)
            for (int lane = 0; lane < 4; ++lane) sum[lane] += a[i + lane] * b[i + lane];
        for (; i < length; ++i) sum[0] += a[i] * b[i];
        return (sum[0] + sum[1]) + (sum[2] + sum[3]);
    }

    // exp(2 pi i k d/n)/sqrt(n), the first entry of a mode.
    Complex first_of(int64_t k, int64_t d) const {
        const int64_t at = k * d % n;
        return Complex(table.basis[at], table.basis[n + at]) / std::sqrt(double(n));
    }

    // The change of a cyclic diagonal, by Fourier transforms: the phase of mode k advances by 2 k from entry to entry.
    template <class Move>
    void change_waves(int64_t d, int64_t from, int64_t to, const Complex* read, Move move, Memory& own) const {
        std::vector<Complex>& coefficients = own.coefficients;
        coefficients.assign(to - from, Complex(0.0));
        ComplexNumber<double>* x = own.fourier.input();
        if (read) {
            for (int64_t a = 0; a < n; ++a) x[a] = {own.first[a], own.first[n + a]};
            const ComplexNumber<double>* transformed = own.fourier.transform(x);
            for (int64_t e = from; e < to; ++e) {
                const int64_t k = table.direction[e];
                const ComplexNumber<double>& value = transformed[2 * k % n];
                coefficients[e - from] = times(std::conj(first_of(k, d)), Complex(value.re, value.im));
            }
        }
        std::fill_n(x, n, ComplexNumber<double>{0.0, 0.0});
        for (int64_t e = from; e < to; ++e) {
            const int64_t k = table.direction[e];
            const Complex rotated = times(first_of(k, d), move(e, coefficients[e - from]));
            ComplexNumber<double>& sum = x[2 * k % n];  // of all rates of a mode
            sum = {sum.re + rotated.real(), sum.im + rotated.imag()};
        }
        const ComplexNumber<double>* sums = own.fourier.transform(x);
        for (int64_t a = 0; a < n; ++a) {
            const ComplexNumber<double>& sum = sums[a ? n - a : 0];  // backward: forward in reversed order
            own.even[a] = sum.re, own.even[n + a] = sum.im;
        }
    }

    void add(Complex* W, int64_t d, int64_t length, bool paired, const Memory& own) const {
        for (int64_t a = 0; a < length; ++a) {
            const int64_t b = length - 1 - a, c = (a + d) % n;
            const bool upper = waves || a <= b;
            const int64_t i = upper ? a : b;
            const double sign = upper ? 1.0 : -1.0;
            const Complex sum(own.even[i] + sign * own.odd[i], own.even[n + i] + sign * own.odd[n + i]);
            if (d == 0) {
                W[a * n + a] += Complex(0.0, (paired ? 2.0 : 1.0) * sum.imag());
                continue;
            }
            W[a * n + c] += sum;
            W[c * n + a] = -conjugate(W[a * n + c]);
        }
    }
};

}  // namespace coadjoint
