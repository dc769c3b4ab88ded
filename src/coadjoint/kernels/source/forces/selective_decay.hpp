// Decay of a quadratic Casimir at constant energy, x' = rate [u, [u, x]] with u = grad H, for brackets that are
// antisymmetric in the sum of squares: vectors with such structure constants, and skew-Hermitian matrices.
#pragma once

#include "field/derivatives.hpp"
#include "matrices/stream.hpp"
#include "numbers/krylov.hpp"
#include "recording/watching.hpp"

namespace coadjoint {

class SelectiveDecay {
  public:
    const int64_t n;
    int64_t iterations = 0, evaluations = 0;
    double residual = 0.0;

    explicit SelectiveDecay(int64_t size) : n(size), krylov(size), m(n), u(n), k(n), r(n), s(n), a(n), b(n) {}
    virtual ~SelectiveDecay() = default;

    // The midpoint rule m = x + (rate tau/2) [u, [u, m]], u = grad H(m), by Newton's method with GMRES; then x becomes
    // 2 m - x, so that an error of m is one of the energy only in second order.
    int64_t flow(double rate, double* x, double t, double tau) {
        const double c = 0.5 * rate * tau, middle = t + 0.5 * tau;
        double first = 0.0;
        std::copy_n(x, n, m.data());
        for (iterations = 1, evaluations = 0;; ++iterations) {
            ++evaluations;
            if (!gradient(m.data(), middle, u.data())) return UNDEFINED;
            bracket(u.data(), m.data(), k.data());
            bracket(u.data(), k.data(), r.data());
            double size = residual = 0.0;
            for (int64_t i = 0; i < n; ++i) {
                r[i] = fma(c, r[i], x[i] - m[i]);
                residual = larger(residual, absolute(r[i]));
                size = larger(size, absolute(m[i]));
            }
            if (!finite(n, r.data())) return OVERFLOWED;
            if (residual <= LAST_DIGIT * size) break;
            if (iterations == 1) first = residual;
            if (iterations > MOST_CORRECTIONS || residual > GROWN * (first + size)) return NOT_CONVERGED;
            const bool last = residual <= NEAR * size;
            const double share = last ? LAST_DIGIT * size / residual : std::min(ROUGH, residual / size);
            const auto operate = [&](const double* d, double* out) { linearized(c, middle, d, out); };
            if (!krylov.solve(r.data(), Krylov::Operate(operate), larger(share, REDUCTION))) return NOT_CONVERGED;
            for (int64_t i = 0; i < n; ++i) m[i] += r[i];
            if (last) break;
        }
        for (int64_t i = 0; i < n; ++i) x[i] += 2.0 * (m[i] - x[i]);
        return finite(n, x) ? DONE : OVERFLOWED;
    }

    virtual bool gradient(const double* x, double t, double* out) = 0;
    // Set out = H''(x, t) v.
    virtual void hessian(const double* x, const double* v, double t, double* out) = 0;
    virtual void bracket(const double* v, const double* y, double* out) = 0;
    // Replace a cotangent by its part in the algebra, in which brackets are antisymmetric.
    virtual void project(double*) {}

  private:
    Krylov krylov;
    std::vector<double> m, u, k, r, s, a, b;

    // out = d - c times the derivative of [u, [u, m]] along d; k = [u, m].
    void linearized(double c, double t, const double* d, double* out) {
        ++evaluations;
        hessian(m.data(), d, t, s.data());
        bracket(u.data(), d, a.data());
        bracket(s.data(), m.data(), b.data());
        for (int64_t i = 0; i < n; ++i) a[i] += b[i];
        bracket(u.data(), a.data(), b.data());
        bracket(s.data(), k.data(), a.data());
        for (int64_t i = 0; i < n; ++i) out[i] = d[i] - c * (a[i] + b[i]);
    }

    // Relative to the state: residuals that are round-off, and from which one correction reaches it; share of the
    // residual that an early correction leaves; growth at which the iteration diverges.
    static constexpr double LAST_DIGIT = 0x1p-53, NEAR = 0x1p-26, ROUGH = 0x1p-6, GROWN = 0x1p20;
    static constexpr int64_t MOST_CORRECTIONS = 24;
};

class VectorDecay final : public SelectiveDecay {
  public:
    VectorDecay(const Field& field, const MemberConstants& constants)
        : SelectiveDecay(field.size), field(field), constants(constants), workspace(field) {}

    bool gradient(const double* x, double t, double* out) override {
        coadjoint::gradient(field, constants, x, t, out, workspace.field);
        return finite(n, out);
    }

    void hessian(const double* x, const double* v, double t, double* out) override {
        hessian_times(field, constants, x, v, t, out, workspace);
    }

    void bracket(const double* v, const double* y, double* out) override {
        product(field, constants, y, v, 1.0, out, workspace.field);
    }

  private:
    const Field& field;
    const MemberConstants constants;
    DerivativeWorkspace<double> workspace;
};

// Of one matrix of the state. `whole` is that of its stream, then the address of a BLAS routine, and whether entries are
// complex.
template <class T>
class MatrixDecay final : public SelectiveDecay {
  public:
    enum Index { BLAS = 6, COMPLEX };  // in `whole`

    MatrixDecay(const int64_t* whole, const double* numbers)
        : SelectiveDecay(whole[0] * whole[0] * int64_t(sizeof(T) / sizeof(double))), rows(whole[0]),
          products(whole[BLAS], rows, 1), stream(whole, numbers), constant(whole[4] ? numbers : nullptr),
          scratch(rows * rows) {}

    bool gradient(const double* x, double t, double* out) override {
        return stream.apply(matrix(x), t, matrix(out)) && finite(n, out);
    }

    void hessian(const double*, const double* v, double t, double* out) override {
        if (stream.linear()) return stream.apply_linear(matrix(v), matrix(out));
        // A function is linear too, up to the constant.
        stream.apply(matrix(v), t, matrix(out));
        for (int64_t i = 0; i < n && constant; ++i) out[i] -= constant[i];
    }

    void bracket(const double* v, const double* y, double* out) override {
        InterruptCheck::of_this_call().after(rows * n / 16);
        products.multiply(matrix(v), matrix(y), scratch.data());
        skew_part(rows, scratch.data(), 1.0, matrix(out), false);
    }

    void project(double* x) override {
        std::copy_n(matrix(x), rows * rows, scratch.data());
        skew_part(rows, scratch.data(), 0.5, matrix(x), false);
    }

  private:
    const int64_t rows;
    const Products<T> products;
    Stream<T> stream;
    const double* const constant;
    std::vector<T> scratch;

    static const T* matrix(const double* x) { return reinterpret_cast<const T*>(x); }
    static T* matrix(double* x) { return reinterpret_cast<T*>(x); }
};

// The decay that a table describes, of a matrix of `extent` rows, or of a vector if that is zero.
inline std::unique_ptr<SelectiveDecay> selective_decay(const ForceTable& table, const Field& field,
                                                       const MemberConstants& constants) {
    const int64_t* whole = table.direction;
    if (!table.extent) return std::unique_ptr<SelectiveDecay>(new VectorDecay(field, constants));
    if (whole[MatrixDecay<Complex>::COMPLEX]) return std::unique_ptr<SelectiveDecay>(new MatrixDecay<Complex>(whole, table.basis));
    return std::unique_ptr<SelectiveDecay>(new MatrixDecay<double>(whole, table.basis));
}

}  // namespace coadjoint
