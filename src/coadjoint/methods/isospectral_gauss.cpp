// Isospectral Gauss methods: W' = [P, W], P = stream(W, t), in a Lie algebra of matrices.
//
// One stage: W = M - (h/2)[P, M] - (h^2/4) P M P is solved for the middle M with P = stream(M), and W += h [P, M].
// Several: V_i = 1 + h sum_j a_ij P_j V_j, U_i = 1 - h sum_j a_ij U_j P_j, M_i = V_i W U_i, and
// W += h sum_i b_i [P_i, M_i]. Of skew-Hermitian matrices U_i = V_i*.
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
    const int64_t n, square, all, stages;
    const bool skew;
    const double *a, *b, *c;
    const Products<T> products;
    Stream<T> stream;

    explicit Isospectral(const StepTables& tables)
        : n(tables.whole[0]), square(n * n), all(tables.whole[1] * square), stages(tables.whole[7]),
          skew(!tables.whole[9]), a(tables.coefficients), b(a + stages * stages), c(b + stages),
          products(tables.whole[6], n, tables.whole[1]), stream(tables.whole, c + stages) {
        work = 16 * stages * (all * n * int64_t(sizeof(T) / sizeof(double)) + stream.work());
    }

    static double size_of(const T& value) { return std::abs(value); }

    // The largest entry; NaN where one of them is.
    double largest(const T* values) const {
        double most = 0.0, spoilt = 0.0;
        for (int64_t e = 0; e < all; ++e) {
            const double size = size_of(values[e]);
            most = size > most ? size : most;
            spoilt += size - size;
        }
        return most + spoilt;
    }

    // The commutator of P and M: A = P M is given, and what is M P is A* where they are skew-Hermitian.
    void commutator(const T* P, const T* M, T* A, double factor, T* to, bool add) {
        if (!skew) {
            other.resize(all);
            products.multiply(M, P, other.data());
            for (int64_t e = 0; e < all; ++e) {
                const T value = factor * (A[e] - other[e]);
                to[e] = add ? to[e] + value : value;
            }
            return;
        }
        for (int64_t first = 0; first < all; first += square, A += square, to += square)
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
        const int64_t numbers = all * int64_t(sizeof(T) / sizeof(double));
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
    std::vector<T> other;
};

template <class T>
struct Midpoint final : Isospectral<T> {
    typedef Isospectral<T> Base;
    using Base::all, Base::products, Base::stream, Base::skew;
    std::vector<T> M, P, A, B, move;

    explicit Midpoint(const StepTables& tables) : Base(tables), M(all), P(all), A(all), B(all), move(all) {
        this->remembered = 2 + HISTORY * all * int64_t(sizeof(T) / sizeof(double));
    }

    // memory: how many middles there are, the step that they are of, and the middles, the last one first.
    void guess(const T* W, double h) {
        double* memory = this->memory;
        const bool usable = memory && memory[0] == memory[0] && memory[1] == h;
        const int64_t known = usable ? int64_t(memory[0]) : 0;
        const T* past = memory ? reinterpret_cast<const T*>(memory + 2) : nullptr;
        for (int64_t e = 0; e < all; ++e) {
            const T last = known > 0 ? past[e] : W[e];
            const T middle = known > 1 ? past[all + e] : last;
            const T first = known > 2 ? past[2 * all + e] : T(0.0);
            M[e] = known > 2 ? first + 3.0 * (last - middle) : known == 2 ? last + (last - middle) : W[e];
        }
    }

    void remember(double h) {
        double* memory = this->memory;
        if (!memory) return;
        const bool usable = memory[0] == memory[0] && memory[1] == h;
        const int64_t known = usable ? int64_t(memory[0]) : 0;
        T* past = reinterpret_cast<T*>(memory + 2);
        for (int64_t k = HISTORY - 1; k > 0; --k) std::copy_n(past + (k - 1) * all, all, past + k * all);
        std::copy_n(M.data(), all, past);
        memory[0] = double(std::min(known + 1, HISTORY));
        memory[1] = h;
    }

    int64_t step(double* x, double* dx, double*, double*, double t, double h) override {
        const T *W = reinterpret_cast<const T*>(x), *owed = reinterpret_cast<const T*>(dx);
        const double size = this->largest(W), half = 0.5 * h, quarter = half * half;
        guess(W, h);
        this->iterations = 0;
        for (;;) {
            if (!stream.apply(M.data(), t + half, P.data())) return UNDEFINED;
            products.multiply(P.data(), M.data(), A.data());
            if (skew) products.multiply_skew(A.data(), P.data(), B.data());
            else products.multiply(A.data(), P.data(), B.data());
            this->commutator(P.data(), M.data(), A.data(), h, move.data(), false);
            double change = 0.0, spoilt = 0.0;
            for (int64_t e = 0; e < all; ++e) {
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
    using Base::square, Base::n, Base::all, Base::products, Base::stream, Base::stages, Base::skew;
    std::vector<T> V, U, P, K, L, M, A, move;

    explicit Stages(const StepTables& tables)
        : Base(tables), V(all * stages), U(skew ? 0 : all * stages), P(all * stages), K(all * stages),
          L(skew ? 0 : all * stages), M(all * stages), A(all), move(all) {}

    int64_t step(double* x, double* dx, double*, double*, double t, double h) override {
        for (int64_t e = 0; e < all; ++e) M[e] = reinterpret_cast<const T*>(x)[e] + reinterpret_cast<const T*>(dx)[e];
        const T* W = reinterpret_cast<const T*>(x);
        if (!stream.apply(M.data(), t, A.data())) return UNDEFINED;
        for (int64_t i = 0; i < stages; ++i) {
            std::copy_n(A.data(), all, K.data() + i * all);
            if (!skew) std::copy_n(A.data(), all, L.data() + i * all);
        }
        restage(K, V, h);
        if (!skew) restage(L, U, -h);
        this->iterations = 0;
        for (;;) {
            for (int64_t i = 0; i < stages; ++i) {
                T *v = V.data() + i * all, *m = M.data() + i * all, *p = P.data() + i * all;
                products.multiply(v, W, A.data());
                if (skew) products.multiply_skew_by_adjoint(A.data(), v, m);
                else products.multiply(A.data(), U.data() + i * all, m);
                if (!stream.apply(m, t + this->c[i] * h, p)) return UNDEFINED;
                products.multiply(p, v, K.data() + i * all);
                if (!skew) products.multiply(U.data() + i * all, p, L.data() + i * all);
            }
            double change = restage(K, V, h);
            if (!skew) change = std::max(change, restage(L, U, -h));
            if (this->ended(change, 1.0)) {
                this->residual = change;
                break;
            }
        }
        this->evaluations = this->iterations * stages;
        if (this->status != DONE) return this->status;
        for (int64_t i = 0; i < stages; ++i) {
            const T *p = P.data() + i * all, *m = M.data() + i * all;
            products.multiply(p, m, A.data());
            this->commutator(p, m, A.data(), h * this->b[i], move.data(), i > 0);
        }
        this->advance(x, dx, move.data());
        return DONE;
    }

    // V_i := 1 + h sum_j a_ij K_j; return the largest change.
    double restage(const std::vector<T>& slopes, std::vector<T>& to, double h) {
        double change = 0.0, spoilt = 0.0;
        for (int64_t i = 0; i < stages; ++i)
            for (int64_t e = 0; e < all; ++e) {
                T sum(0.0);
                for (int64_t j = 0; j < stages; ++j) sum += this->a[i * stages + j] * slopes[j * all + e];
                const T next = T(e < square && e % (n + 1) == 0 ? 1.0 : 0.0) + h * sum;
                T& old = to[i * all + e];
                const double moved = this->size_of(next - old);
                change = moved > change ? moved : change;
                spoilt += moved - moved;
                old = next;
            }
        return change + spoilt;
    }
};

template <class T>
StepScheme* made(const StepTables& tables) {
    if (tables.whole[7] == 1) return new Midpoint<T>(tables);
    return new Stages<T>(tables);
}

}  // namespace

// `whole`: what a stream reads, the address of the product, the stages, whether entries are complex, and whether
// matrices are not skew-Hermitian.
EXPORT StepScheme* isospectral_gauss_step(const StepTables& tables, const Own&) {
    return tables.whole[8] ? made<Complex>(tables) : made<double>(tables);
}

}  // namespace coadjoint
