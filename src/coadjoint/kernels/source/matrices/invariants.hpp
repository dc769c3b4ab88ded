// Changes of the quadratic invariants of a state of matrices, at the cost of its stream: the energy, and tr W^2 of one
// matrix, tr Theta^2 and tr W Theta of two fields, tr W^2 of each of independent layers; complex skew-Hermitian matrices
// count as -i W. A change is a product of the change of the state with a mean, so that its rounding is relative to that
// change: the energy of a slow flow on a planet is far below what its rotation adds to the pairing of P and W.
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
    // Set the state from which changes count; return whether the stream is defined there.
    virtual bool begin(const double* x, double t) = 0;
    // Compute the changes since the last state, and take this one in its place; return whether the stream is defined.
    virtual bool change(const double* x, double t, double* values) = 0;
};

template <class T>
struct InvariantsOf final : MatrixInvariants {
    const int64_t n, square, layers;
    const bool general;
    const double factor, sign_of_trace;
    Stream<T> stream;
    std::vector<T> X, Y, mean, moved;

    InvariantsOf(const int64_t* whole, double energy_factor, const double* numbers)
        : n(whole[0]), square(n * n), layers(whole[1]), general(whole[7]), factor(energy_factor),
          sign_of_trace(double(whole[8])), stream(whole, numbers), X(layers * square), Y(X), mean(X), moved(X) {}

    int64_t count() const override { return 1 + layers; }
    int64_t work() const override { return stream.work() + 8 * layers * square; }

    bool begin(const double* x, double t) override {
        std::copy_n(reinterpret_cast<const T*>(x), X.size(), X.data());
        return stream.apply(X.data(), t, Y.data());
    }

    bool change(const double* x, double t, double* values) override {
        const T* const now = reinterpret_cast<const T*>(x);
        if (!stream.apply(now, t, mean.data())) return false;
        Y.swap(mean);  // of the last state
        for (int64_t e = 0; e < layers * square; ++e) mean[e] = 0.5 * (mean[e] + Y[e]), moved[e] = now[e] - X[e];
        double energy = 0.0;
        for (int64_t l = 0; l < layers; ++l) {
            // The stream is H's derivative by the other layer.
            const int64_t other = stream.direct ? l : layers - 1 - l;
            energy += stream.weight(l) * pairing(mean.data() + l * square, moved.data() + other * square);
        }
        values[0] = factor * energy;
        for (int64_t e = 0; e < layers * square; ++e) mean[e] = 0.5 * (X[e] + now[e]), X[e] = now[e];
        for (int64_t l = 0; l < layers; ++l) {
            const int64_t other = stream.direct ? l * square : 0;
            values[1 + l] = sign_of_trace * (trace(mean.data() + other, moved.data() + l * square) +
                                             trace(moved.data() + other, mean.data() + l * square));
        }
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
