// The discrete Fourier transform of any length, X_k = sum over j of x_j exp(-2 pi i j k / n), lanes side by side.
//
// A length is factored into 4 and primes, with one pass for each, in Stockham's order. Small primes are summed
// directly, terms j and p - j together. For a large prime p, Rader's permutation gives a cyclic convolution of p - 1
// numbers, or a longer one of small factors if p - 1 has large primes itself.
#pragma once

#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "numbers/arithmetic.hpp"
#include "numbers/aligned_array.hpp"

namespace coadjoint {

constexpr int64_t LARGEST_SUMMED = 53;  // larger primes are convolutions: about where the costs are equal

template <class A>
struct ComplexNumber {
    A re, im;
    INLINE friend ComplexNumber operator+(const ComplexNumber& a, const ComplexNumber& b) {
        return {a.re + b.re, a.im + b.im};
    }
    INLINE friend ComplexNumber operator-(const ComplexNumber& a, const ComplexNumber& b) {
        return {a.re - b.re, a.im - b.im};
    }
    // a times the complex number c + i s, for numbers or lanes.
    template <class B>
    INLINE ComplexNumber times(const B& c, const B& s) const {
        return {fma(re, A(c), -(im * A(s))), fma(re, A(s), im * A(c))};
    }
};

// cos and sin of 2 pi k / n, by angles of at most a quarter turn.
inline ComplexNumber<double> root_of_unity(int64_t k, int64_t n) {
    constexpr double QUARTER = 1.5707963267948966;
    k %= n;
    const int64_t quarter = 4 * k / n;
    const Rotation<double> rotation = rotation_by(QUARTER * (double(4 * k - quarter * n) / double(n)));
    const double c = 1.0 + rotation.cosm1, s = rotation.sine;
    const ComplexNumber<double> rotated[] = {{c, s}, {-s, c}, {-c, -s}, {s, -c}};
    return rotated[quarter];
}

// c^2 + s^2 - 1 to about a hundred bits.
inline double beyond_circle(double c, double s) {
    const double square = c * c, other = s * s, rest = fma(c, c, -square) + fma(s, s, -other);
    return (square > other ? (square - 1.0) + other : (other - 1.0) + square) + rest;
}

// All roots. If their sum of squares deviates, a few are changed by a unit in the last place: a transform and its
// inverse, applied millions of times, would otherwise scale their argument a little every time.
inline std::vector<ComplexNumber<double>> roots_of_unity(int64_t n) {
    constexpr int MOST_MOVED = 4;
    std::vector<ComplexNumber<double>> roots(n, ComplexNumber<double>{1.0, 0.0});
    double beyond = 0.0;
    for (int64_t k = 1; 2 * k < n; ++k) {
        roots[k] = root_of_unity(k, n);
        beyond += beyond_circle(roots[k].re, roots[k].im);
    }
    for (int moved = 0; moved < MOST_MOVED; ++moved) {
        double least = 0.5 * std::fabs(beyond), change = 0.0;
        double *best = nullptr, better = 0.0;
        for (int64_t k = 1; 2 * k < n; ++k)
            for (double* part : {&roots[k].re, &roots[k].im})
                for (double way : {-2.0, 2.0}) {
                    const double next = std::nextafter(*part, way), other = (next - *part) * (next + *part);
                    if (std::fabs(beyond + other) < least)
                        least = std::fabs(beyond + other), change = other, best = part, better = next;
                }
        if (!best) break;
        *best = better;
        beyond += change;
    }
    for (int64_t k = 1; k < n; ++k)
        if (2 * k > n) roots[k] = {roots[n - k].re, -roots[n - k].im};
    if (n % 2 == 0) roots[n / 2] = {-1.0, 0.0};
    return roots;
}

inline int64_t power_modulo(int64_t base, int64_t exponent, int64_t p) {
    int64_t result = 1;
    for (int64_t k = 0; k < exponent; ++k) result = result * base % p;
    return result;
}

// Factors 4 as often as possible, then primes in ascending order.
inline std::vector<int64_t> factors_of(int64_t n) {
    std::vector<int64_t> found;
    for (; n % 4 == 0; n /= 4) found.push_back(4);
    for (int64_t p = 2; n > 1; ++p)
        for (; n % p == 0; n /= p) found.push_back(p);
    return found;
}

template <class A>
class Rader;

template <class A>
class Fourier {
  public:
    NOINLINE explicit Fourier(int64_t n)
        : n(n), factors(factors_of(n)), roots(roots_of_unity(n)), first(n), second(n), column(columns()) {
        for (int64_t p : factors)
            if (p > LARGEST_SUMMED) rader.emplace_back(p);
    }
    // For another thread: the same transform with memory of its own.
    Fourier(const Fourier& other)
        : n(other.n), factors(other.factors), roots(other.roots), rader(other.rader), first(n), second(n),
          column(columns()) {}

    // Approximate number of multiplications of one transform.
    int64_t work() const {
        int64_t total = 0;
        for (int64_t p : factors) total += n * (p > LARGEST_SUMMED ? 64 : p + 4);
        return total;
    }

    // Memory for numbers to be transformed.
    ComplexNumber<A>* input() { return first.at; }

    // Transform the numbers at x, and return the address of the result: x, or memory of this object. The contents of x
    // are lost.
    ComplexNumber<A>* transform(ComplexNumber<A>* x) { return transform(x, x == first.at ? second.at : first.at); }

    // The same with other memory in place of that of this object.
    NOINLINE ComplexNumber<A>* transform(ComplexNumber<A>* x, ComplexNumber<A>* spare) {
        ComplexNumber<A>*from = x, *to = spare;
        int64_t stride = 1, convolution = 0;
        for (int64_t p : factors) {
            if (p == 4) pass_of_four(from, to, stride);
            else if (p == 2) pass<2>(from, to, p, stride, nullptr);
            else if (p == 3) pass<3>(from, to, p, stride, nullptr);
            else if (p == 5) pass<5>(from, to, p, stride, nullptr);
            else if (p == 7) pass<7>(from, to, p, stride, nullptr);
            else pass<0>(from, to, p, stride, p > LARGEST_SUMMED ? &rader[convolution++] : nullptr);
            stride *= p;
            std::swap(from, to);
        }
        return from;
    }

  private:
    const int64_t n;
    const std::vector<int64_t> factors;
    const std::vector<ComplexNumber<double>> roots;
    std::vector<Rader<A>> rader;
    AlignedArray<ComplexNumber<A>> first, second, column;

    int64_t columns() const {
        int64_t largest = 1;
        for (int64_t p : factors) largest = std::max(largest, p);
        return 4 * largest;
    }

    // x exp(-2 pi i k / n)
    INLINE ComplexNumber<A> rotated(const ComplexNumber<A>& x, int64_t k) const {
        return k ? x.times(roots[k].re, -roots[k].im) : x;
    }

    void pass_of_four(const ComplexNumber<A>* from, ComplexNumber<A>* to, int64_t stride) const {
        const int64_t m = n / stride / 4, quarter = stride * m;
        for (int64_t q = 0; q < m; ++q)
            for (int64_t k = 0; k < stride; ++k) {
                const ComplexNumber<A>* x = from + k + stride * q;
                ComplexNumber<A>* y = to + k + stride * 4 * q;
                const ComplexNumber<A> a = x[0] + x[2 * quarter], b = x[0] - x[2 * quarter];
                const ComplexNumber<A> c = x[quarter] + x[3 * quarter], d = x[quarter] - x[3 * quarter];
                y[0] = a + c;
                y[stride] = rotated(ComplexNumber<A>{b.re + d.im, b.im - d.re}, q * stride);
                y[2 * stride] = rotated(a - c, 2 * q * stride);
                y[3 * stride] = rotated(ComplexNumber<A>{b.re - d.im, b.im + d.re}, 3 * q * stride);
            }
    }

    // A pass of a prime, in registers where it is a constant.
    template <int fixed>
    void pass(ComplexNumber<A>* from, ComplexNumber<A>* to, int64_t prime, int64_t stride, Rader<A>* convolution) {
        const int64_t p = fixed ? fixed : prime, m = n / stride / p;
        if (!fixed && p == n) return direct<fixed>(from, to, p, convolution);
        ComplexNumber<A> registers[fixed ? 2 * fixed : 1];
        ComplexNumber<A>*x = fixed ? registers : column.at, *X = x + p;
        for (int64_t q = 0; q < m; ++q)
            for (int64_t k = 0; k < stride; ++k) {
                for (int64_t j = 0; j < p; ++j) x[j] = from[k + stride * (q + m * j)];
                direct<fixed>(x, X, p, convolution);
                ComplexNumber<A>* y = to + k + stride * p * q;
                for (int64_t r = 0; r < p; ++r) y[r * stride] = rotated(X[r], q * r * stride);
            }
    }

    // The transform of a prime length; x is overwritten.
    template <int fixed>
    INLINE void direct(ComplexNumber<A>* x, ComplexNumber<A>* X, int64_t p, Rader<A>* convolution) {
        if (!fixed && convolution) convolution->transform(x, X);
        else sum<fixed>(x, X, p);
    }

    // The same by direct sums.
    template <int fixed>
    INLINE void sum(ComplexNumber<A>* x, ComplexNumber<A>* X, int64_t prime) const {
        const int64_t p = fixed ? fixed : prime, half = (p - 1) / 2, step = n / p;
        if (p == 2) {
            X[0] = x[0] + x[1];
            X[1] = x[0] - x[1];
            return;
        }
        X[0] = x[0];
        for (int64_t j = 1; j <= half; ++j) {
            const ComplexNumber<A> a = x[j], b = x[p - j];
            x[j] = a + b;
            x[p - j] = a - b;
            X[0] = X[0] + x[j];
        }
        int64_t k = 1;
        for (; k + 1 <= half; k += 2) sums<2>(x, X, p, k, half, step);
        if (k <= half) sums<1>(x, X, p, k, half, step);
    }

    // The terms k, k + 1, ... and p - k, p - k - 1, ...: several at once share their loads.
    template <int count>
    INLINE void sums(const ComplexNumber<A>* x, ComplexNumber<A>* X, int64_t p, int64_t k, int64_t half,
                     int64_t step) const {
        ComplexNumber<A> even[count], odd[count];
        int64_t phase[count];
        for (int c = 0; c < count; ++c) {
            even[c] = x[0];
            odd[c] = {A(0.0), A(0.0)};
            phase[c] = 0;
        }
        for (int64_t j = 1; j <= half; ++j)
            for (int c = 0; c < count; ++c) {
                phase[c] = phase[c] + k + c < p ? phase[c] + k + c : phase[c] + k + c - p;
                const A cosine(roots[phase[c] * step].re), sine(roots[phase[c] * step].im);
                even[c].re = fma(x[j].re, cosine, even[c].re);
                even[c].im = fma(x[j].im, cosine, even[c].im);
                odd[c].re = fma(x[p - j].re, sine, odd[c].re);
                odd[c].im = fma(x[p - j].im, sine, odd[c].im);
            }
        for (int c = 0; c < count; ++c) {
            X[k + c] = {even[c].re + odd[c].im, even[c].im - odd[c].re};
            X[p - k - c] = {even[c].re - odd[c].im, even[c].im + odd[c].re};
        }
    }
};

// A transform of a prime length as a convolution.
template <class A>
class Rader {
  public:
    explicit Rader(int64_t p) : p(p), length(convolved(p)), inner(length), kernel(length) {
        int64_t generator = 1;
        for (bool found = false; !found;) {
            ++generator;
            found = true;
            for (int64_t prime : factors_of(p - 1))
                found = found && power_modulo(generator, (p - 1) / (prime == 4 ? 2 : prime), p) != 1;
        }
        const int64_t inverse = power_modulo(generator, p - 2, p);
        for (int64_t j = 0, up = 1, down = 1; j < p - 1; ++j, up = up * generator % p, down = down * inverse % p) {
            from.push_back(up);
            to.push_back(down);
        }
        Fourier<double> once(length);
        ComplexNumber<double>* roots = once.input();
        for (int64_t j = 0; j < p - 1; ++j) {
            const ComplexNumber<double> root = root_of_unity(p - to[j], p);
            roots[j] = {root.re / double(length), root.im / double(length)};
            // a longer convolution starts with the end of the previous period
            if (j > 0) roots[length - (p - 1) + j] = roots[j];
        }
        std::copy_n(once.transform(roots), length, kernel.begin());
    }

    void transform(const ComplexNumber<A>* x, ComplexNumber<A>* X) {
        ComplexNumber<A>* y = inner.input();
        for (int64_t j = 0; j < p - 1; ++j) y[j] = x[from[j]];
        for (int64_t j = p - 1; j < length; ++j) y[j] = {A(0.0), A(0.0)};
        y = inner.transform(y);
        const ComplexNumber<A> first = x[0];
        X[0] = first + y[0];
        for (int64_t k = 0; k < length; ++k) y[k] = y[k].times(kernel[k].re, kernel[k].im);
        y = inner.transform(y);
        // two forward transforms reverse the order: index -j
        for (int64_t j = 0; j < p - 1; ++j) X[to[j]] = first + y[j ? length - j : 0];
    }

  private:
    const int64_t p, length;
    std::vector<int64_t> from, to;
    Fourier<A> inner;
    std::vector<ComplexNumber<double>> kernel;

    static int64_t convolved(int64_t p) {
        if (factors_of(p - 1).back() <= LARGEST_SUMMED) return p - 1;
        int64_t length = 2 * (p - 1) - 1;
        while (factors_of(length).back() > 5) ++length;
        return length;
    }
};

}  // namespace coadjoint
