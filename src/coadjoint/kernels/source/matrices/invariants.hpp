// The quadratic invariants of a state of matrices, at the cost of its stream: the energy, and tr W^2 of one matrix, tr
// Theta^2 and tr W Theta of two fields, tr W^2 of each of independent layers; complex skew-Hermitian matrices count as
// -i W.
#pragma once

#include <memory>
#include <vector>

#include "matrices/stream.hpp"

namespace coadjoint {

struct MatrixInvariants {
    virtual ~MatrixInvariants() = default;
    // The number of values.
    virtual int64_t count() const = 0;
    virtual int64_t work() const = 0;
    // Compute them; return whether the stream is defined there.
    virtual bool of(const double* x, double t, double* values) = 0;
};

template <class T>
struct InvariantsOf final : MatrixInvariants {
    const int64_t n, square, layers;
    const bool general;
    const double factor, sign_of_trace;
    const T* const constant;
    Stream<T> stream;
    std::vector<T> Y;

    InvariantsOf(const int64_t* whole, double energy_factor, const double* numbers)
        : n(whole[0]), square(n * n), layers(whole[1]), general(whole[7]), factor(energy_factor),
          sign_of_trace(double(whole[8])),
          constant(whole[4] ? reinterpret_cast<const T*>(numbers) : nullptr), stream(whole, numbers), Y(layers * square) {}

    int64_t count() const override { return 1 + layers; }
    int64_t work() const override { return stream.work() + 8 * layers * square; }

    bool of(const double* x, double t, double* values) override {
        const T* const X = reinterpret_cast<const T*>(x);
        if (!stream.apply(X, t, Y.data())) return false;
        double energy = 0.0;
        for (int64_t l = 0; l < layers; ++l) {
            // the stream is H's derivative by the other layer, and half of it gives H up to its constant part
            const int64_t other = stream.direct ? l : layers - 1 - l;
            const T *const of = X + other * square, *const y = Y.data() + l * square;
            energy += 0.5 * stream.weight(l) * pairing(y, of);
            if (constant) energy += 0.5 * stream.weight(l) * pairing(constant + l * square, of);
        }
        values[0] = factor * energy;
        for (int64_t l = 0; l < layers; ++l)
            values[1 + l] = sign_of_trace * trace(stream.direct ? X + l * square : X, X + l * square);
        return true;
    }

  private:
    static double real(const double& value) { return value; }
    static double real(const Complex& value) { return value.real(); }
    static double imaginary(const double&) { return 0.0; }
    static double imaginary(const Complex& value) { return value.imag(); }

    // The real part of tr(a* b), for matrices that are not skew-Hermitian that of tr(a b). Row sums are added, so that
    // rounding grows with the number of rows only.
    double pairing(const T* a, const T* b) const {
        if (general) return trace(a, b);
        double total = 0.0;
        for (int64_t i = 0; i < n; ++i) {
            double row = 0.0;
            for (int64_t e = i * n; e < (i + 1) * n; ++e)
                row += real(a[e]) * real(b[e]) + imaginary(a[e]) * imaginary(b[e]);
            total += row;
        }
        return total;
    }

    // The real part of tr(a b).
    double trace(const T* a, const T* b) const {
        double total = 0.0;
        for (int64_t i = 0; i < n; ++i) {
            double row = 0.0;
            for (int64_t j = 0; j < n; ++j) {
                const T &left = a[i * n + j], &right = b[j * n + i];
                row += real(left) * real(right) - imaginary(left) * imaginary(right);
            }
            total += row;
        }
        return total;
    }
};

// The integers are those that a stream reads, with size zero if the state is not a matrix, then whether entries are
// complex, whether they are not skew-Hermitian, and the sign of the trace. The first number is the factor of the energy.
inline std::unique_ptr<MatrixInvariants> matrix_invariants(const int64_t* whole, const double* numbers) {
    std::unique_ptr<MatrixInvariants> found;
    if (!whole[0]) return found;
    if (whole[6]) found.reset(new InvariantsOf<Complex>(whole, numbers[0], numbers + 1));
    else found.reset(new InvariantsOf<double>(whole, numbers[0], numbers + 1));
    return found;
}

}  // namespace coadjoint
