// Isospectral Gauss methods: W' = s [P, W], P = stream(W), in a Lie algebra of skew-Hermitian matrices.
//
// One stage: W = M - (h/2)[P, M] - (h^2/4) P M P is solved for the middle M with P = s stream(M), and W += h [P, M].
// Several: V_i = 1 + h sum_j a_ij P_j V_j, M_i = V_i W V_i*, and W += h sum_i b_i [P_i, M_i].
#include <cmath>
#include <limits>

#include "boundary/hearing.hpp"
#include "matrices/products.hpp"
#include "matrices/stream.hpp"
#include "numbers/lanes.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

namespace {

constexpr int64_t FIRST_TESTED = 3;     // early corrections may rise before they fall
constexpr int64_t MOST_ITERATIONS = 192;
constexpr double SMALL = 0x1p-36;       // of the entries: only below it may a correction be round-off
constexpr int64_t HISTORY = 3;          // middles of earlier steps, through which the next one is guessed

template <class T>
struct Isospectral : StepScheme {
    const int64_t n, square, stages;
    const double sign;
    const double *a, *b;
    const Products<T> products;
    Stream<T> stream;

    explicit Isospectral(const StepTables& tables)
        : n(tables.whole[1]), square(n * n), stages(tables.whole[3]), sign(tables.coefficients[0]),
          a(tables.coefficients + 1), b(a + stages * stages), products(tables.whole[2], n),
          stream(tables.whole[0], n, b + stages) {
        work = 16 * stages * (n * n * n * int64_t(sizeof(T) / sizeof(double)) + stream.work());
    }

    static double size_of(const T& value) { return std::abs(value); }

    // The largest entry; NaN where one of them is.
    double largest(const T* values) const {
        double most = 0.0, spoilt = 0.0;
        for (int64_t e = 0; e < square; ++e) {
            const double size = size_of(values[e]);
            most = size > most ? size : most;
            spoilt += size - size;
        }
        return most + spoilt;
    }

    // The commutator of P and M from their product A: A - A*, skew-Hermitian to the last bit.
    void commutator(const T* A, double factor, T* to, bool add) const {
        for (int64_t i = 0; i < n; ++i)
            for (int64_t j = 0; j <= i; ++j) {
                const T value = factor * (A[i * n + j] - conjugate(A[j * n + i]));
                T &lower = to[i * n + j], &upper = to[j * n + i];
                lower = add ? lower + value : value;
                upper = i == j ? lower : -conjugate(lower);
            }
    }

    // Add an increment to W, with what earlier sums owe.
    void advance(double* W, double* owed, const T* increment) const {
        const double* move = reinterpret_cast<const double*>(increment);
        const int64_t numbers = square * int64_t(sizeof(T) / sizeof(double));
        for (int64_t k = 0; k < numbers; ++k) add_owing_rest(W[k], move[k] + owed[k], W[k], owed[k]);
    }

    // Whether an iteration has come to its end, after a correction `change` of entries as large as `size`; the outcome
    // is in `status` then.
    bool ended(double change, double size) {
        ++iterations;
        if (iterations == 1) first = least = change;
        Hearing::of_this_call().after(work / 16);
        const bool small = change <= SMALL * size;
        if (change == 0.0 || (small && iterations >= FIRST_TESTED && !(change < least))) return status = DONE, true;
        if (!(change - change == 0.0)) return status = OVERFLOWED, true;
        if (iterations >= MOST_ITERATIONS || change > std::ldexp(first, int(GROWTH_BITS)))
            return status = NOT_CONVERGED, true;
        least = std::min(least, change);
        return false;
    }

    int64_t status = DONE;

  private:
    double first = 0.0, least = 0.0;
};

template <class T>
struct Midpoint final : Isospectral<T> {
    typedef Isospectral<T> Base;
    using Base::square, Base::n, Base::products, Base::stream, Base::sign;
    std::vector<T> M, P, A, B, move;
    double* const none = nullptr;

    explicit Midpoint(const StepTables& tables)
        : Base(tables), M(square), P(square), A(square), B(square), move(square) {
        this->remembered = 2 + HISTORY * square * int64_t(sizeof(T) / sizeof(double));
    }

    // memory: how many middles there are, the step that they are of, and the middles, the last one first.
    void guess(const T* W, double h) {
        double* memory = this->memory;
        const bool usable = memory && memory[0] == memory[0] && memory[1] == h;
        const int64_t known = usable ? int64_t(memory[0]) : 0;
        const T* past = memory ? reinterpret_cast<const T*>(memory + 2) : nullptr;
        for (int64_t e = 0; e < square; ++e) {
            const T last = known > 0 ? past[e] : W[e];
            const T middle = known > 1 ? past[square + e] : last;
            const T first = known > 2 ? past[2 * square + e] : T(0.0);
            M[e] = known > 2 ? first + 3.0 * (last - middle) : known == 2 ? last + (last - middle) : W[e];
        }
    }

    void remember(double h) {
        double* memory = this->memory;
        if (!memory) return;
        const bool usable = memory[0] == memory[0] && memory[1] == h;
        const int64_t known = usable ? int64_t(memory[0]) : 0;
        T* past = reinterpret_cast<T*>(memory + 2);
        for (int64_t k = HISTORY - 1; k > 0; --k) std::copy_n(past + (k - 1) * square, square, past + k * square);
        std::copy_n(M.data(), square, past);
        memory[0] = double(std::min(known + 1, HISTORY));
        memory[1] = h;
    }

    int64_t step(double* x, double* dx, double*, double*, double, double h) override {
        const T *W = reinterpret_cast<const T*>(x), *owed = reinterpret_cast<const T*>(dx);
        const double size = this->largest(W), half = 0.5 * h, quarter = half * half;
        guess(W, h);
        this->iterations = 0;
        for (;;) {
            stream.apply(M.data(), P.data());
            for (T& entry : P) entry *= sign;
            products.multiply(P.data(), M.data(), A.data());
            products.multiply_skew(A.data(), P.data(), B.data());
            this->commutator(A.data(), h, move.data(), false);
            double change = 0.0, spoilt = 0.0;
            for (int64_t e = 0; e < square; ++e) {
                const T next = W[e] + (owed[e] + (0.5 * move[e] + quarter * B[e]));
                const double moved = this->size_of(next - M[e]);
                change = moved > change ? moved : change;
                spoilt += moved - moved;
                M[e] = next;
            }
            if (this->ended(change + spoilt, size)) {
                this->residual = change + spoilt;
                break;
            }
        }
        this->evaluations = this->iterations;
        if (this->status != DONE) return this->status;
        remember(h);
        this->advance(x, dx, move.data());
        return DONE;
    }
};

template <class T>
struct Stages final : Isospectral<T> {
    typedef Isospectral<T> Base;
    using Base::square, Base::n, Base::products, Base::stream, Base::sign, Base::stages;
    std::vector<T> V, P, K, M, A, move;

    explicit Stages(const StepTables& tables)
        : Base(tables), V(square * stages), P(square * stages), K(square * stages), M(square * stages), A(square),
          move(square) {}

    int64_t step(double* x, double* dx, double*, double*, double, double h) override {
        const T* W = reinterpret_cast<const T*>(x);
        for (int64_t e = 0; e < square; ++e) A[e] = W[e] + reinterpret_cast<const T*>(dx)[e];
        std::copy_n(A.data(), square, M.data());
        start(h);
        this->iterations = 0;
        for (;;) {
            for (int64_t i = 0; i < stages; ++i) {
                const int64_t at = i * square;
                products.multiply(V.data() + at, W, A.data());
                products.multiply_skew_by_adjoint(A.data(), V.data() + at, M.data() + at);
                stream.apply(M.data() + at, P.data() + at);
                for (int64_t e = at; e < at + square; ++e) P[e] *= sign;
                products.multiply(P.data() + at, V.data() + at, K.data() + at);
            }
            const double change = restage(h);
            if (this->ended(change, 1.0)) {
                this->residual = change;
                break;
            }
        }
        this->evaluations = this->iterations * stages;
        if (this->status != DONE) return this->status;
        for (int64_t i = 0; i < stages; ++i) {
            products.multiply(P.data() + i * square, M.data() + i * square, A.data());
            this->commutator(A.data(), h * this->b[i], move.data(), i > 0);
        }
        this->advance(x, dx, move.data());
        return DONE;
    }

    // V_i := 1 + c_i h P(W).
    void start(double h) {
        stream.apply(M.data(), P.data());
        for (int64_t i = 0; i < stages; ++i) {
            double c = 0.0;
            for (int64_t j = 0; j < stages; ++j) c += this->a[i * stages + j];
            for (int64_t e = 0; e < square; ++e)
                V[i * square + e] = T(e % (n + 1) ? 0.0 : 1.0) + (c * h * sign) * P[e];
        }
    }

    double restage(double h) {
        double change = 0.0, spoilt = 0.0;
        for (int64_t i = 0; i < stages; ++i)
            for (int64_t e = 0; e < square; ++e) {
                T sum(0.0);
                for (int64_t j = 0; j < stages; ++j) sum += this->a[i * stages + j] * K[j * square + e];
                const T next = T(e % (n + 1) ? 0.0 : 1.0) + h * sum;
                const double moved = this->size_of(next - V[i * square + e]);
                change = moved > change ? moved : change;
                spoilt += moved - moved;
                V[i * square + e] = next;
            }
        return change + spoilt;
    }
};

template <class T>
StepScheme* made(const StepTables& tables) {
    if (tables.whole[3] == 1) return new Midpoint<T>(tables);
    return new Stages<T>(tables);
}

}  // namespace

// `whole`: the kind of the stream, n, the address of the product, the stages, whether entries are complex.
EXPORT StepScheme* isospectral_gauss_step(const StepTables& tables, const Own&) {
    return tables.whole[4] ? made<Complex>(tables) : made<double>(tables);
}

}  // namespace coadjoint
