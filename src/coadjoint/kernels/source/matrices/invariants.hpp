// The energy of a matrix and the trace of its square, in as many operations as its stream takes.
#pragma once

#include <memory>
#include <vector>

#include "matrices/stream.hpp"

namespace coadjoint {

struct MatrixInvariants {
    virtual ~MatrixInvariants() = default;
    // Set two values: the energy, and tr W^2 of a real W, -tr W^2 of a complex one.
    virtual void of(const double* x, double* values) = 0;
    virtual int64_t work() const = 0;
};

// `numbers`: the sign of the energy, the matrix beside the stream where there is one, and the table of the stream.
template <class T>
struct InvariantsOf final : MatrixInvariants {
    const int64_t n, square;
    const double sign;
    const T* const linear;
    Stream<T> stream;
    std::vector<T> P;

    InvariantsOf(int64_t kind, int64_t n, bool beside, const double* numbers)
        : n(n), square(n * n), sign(numbers[0]), linear(beside ? reinterpret_cast<const T*>(numbers + 1) : nullptr),
          stream(kind, n, numbers + 1 + (beside ? square * int64_t(sizeof(T) / sizeof(double)) : 0)), P(square) {}

    int64_t work() const override { return stream.work() + 8 * square; }

    static double real(const T& value) { return reinterpret_cast<const double&>(value); }

    // Sums of rows are added up, so that rounding grows with the rows alone.
    void of(const double* x, double* values) override {
        const T* const W = reinterpret_cast<const T*>(x);
        stream.apply(W, P.data());
        double energy = 0.0, trace = 0.0;
        for (int64_t i = 0; i < n; ++i) {
            double half = 0.0, beside = 0.0, product = 0.0;
            for (int64_t j = 0; j < n; ++j) {
                const T entry = W[i * n + j];
                half += real(conjugate(P[i * n + j]) * entry);
                product += real(W[j * n + i] * entry);
                if (linear) beside += real(conjugate(linear[i * n + j]) * entry);
            }
            energy += 0.5 * half + beside;
            trace += product;
        }
        values[0] = sign * energy;
        values[1] = sizeof(T) == sizeof(double) ? trace : -trace;
    }
};

// Of the whole numbers n, zero where the state is no matrix, the kind of the stream, whether entries are complex, and
// whether there is a matrix beside the stream.
inline std::unique_ptr<MatrixInvariants> matrix_invariants(const int64_t* whole, const double* numbers) {
    if (!whole[0]) return nullptr;
    if (whole[2]) return std::unique_ptr<MatrixInvariants>(new InvariantsOf<Complex>(whole[1], whole[0], whole[3], numbers));
    return std::unique_ptr<MatrixInvariants>(new InvariantsOf<double>(whole[1], whole[0], whole[3], numbers));
}

}  // namespace coadjoint
