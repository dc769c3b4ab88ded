// Isospectral Gauss methods: W' = [P, W], P = stream(W, t), in a Lie algebra of matrices.
//
// One stage: W = M - (h/2)[P, M] - (h^2/4) P M P is solved for the midpoint M with P = stream(M), and W += h [P, M].
// Several: V_i = 1 + h sum_j a_ij P_j V_j, U_i = 1 - h sum_j a_ij U_j P_j, M_i = V_i W U_i, and W += h sum_i b_i [P_i,
// M_i]. Skew-Hermitian matrices, where U_i = V_i*, have schemes of their own.
#include "matrices/compiled_transforms.hpp"
#include "matrices/isospectral.hpp"
#include "matrices/skew_midpoint.hpp"
#include "matrices/skew_stages.hpp"

namespace coadjoint {

namespace {

constexpr int64_t HISTORY = 3;  // midpoints of earlier steps, from which the next one is extrapolated

// Schemes of matrices that are not skew-Hermitian.
template <class T>
struct GeneralStep : Isospectral<T> {
    const Products<T> products;

    explicit GeneralStep(const StepTables& tables)
        : Isospectral<T>(tables), products(tables.whole[GEMM], this->n, tables.whole[1], layered(tables.whole)),
          other(this->all) {}

    // The commutator of P and M times a factor, where A = P M.
    void commutator(const T* P, const T* M, const T* A, double factor, T* to, bool add) {
        products.multiply(M, P, other.data());
        for (int64_t e = 0; e < this->all; ++e) {
            const T value = factor * (A[e] - other[e]);
            to[e] = add ? to[e] + value : value;
        }
    }

    // Add an increment to W, with compensation.
    void advance(double* W, double* remainder, const T* increment) const {
        const double* move = reinterpret_cast<const double*>(increment);
        for (int64_t k = 0; k < this->numbers; ++k) two_sum(W[k], move[k] + remainder[k], W[k], remainder[k]);
    }

  private:
    std::vector<T> other;
};

// One stage.
template <class T>
struct Midpoint final : GeneralStep<T> {
    typedef GeneralStep<T> Base;
    using Base::all, Base::numbers, Base::products, Base::stream;
    std::vector<T> M, P, A, B, move;

    explicit Midpoint(const StepTables& tables) : Base(tables), M(all), P(all), A(all), B(all), move(all) {
        this->memory_size = 2 + HISTORY * all * int64_t(sizeof(T) / sizeof(double));
    }

    // memory: the number of midpoints, the step that they belong to, and the midpoints, the last one first.
    void extrapolate(const T* W, double h) {
        double* memory = this->memory;
        const int64_t known = this->known_steps(h) ? int64_t(memory[0]) : 0;
        const T* past = memory ? reinterpret_cast<const T*>(memory + 2) : nullptr;
        for (int64_t e = 0; e < all; ++e) {
            const T last = known > 0 ? past[e] : W[e];
            const T middle = known > 1 ? past[all + e] : last;
            const T first = known > 2 ? past[2 * all + e] : T(0.0);
            M[e] = known > 2 ? first + 3.0 * (last - middle) : known == 2 ? last + (last - middle) : W[e];
        }
    }

    void store_history(double h) {
        double* memory = this->memory;
        if (!memory) return;
        const int64_t known = this->known_steps(h) ? int64_t(memory[0]) : 0;
        T* past = reinterpret_cast<T*>(memory + 2);
        for (int64_t k = HISTORY - 1; k > 0; --k) std::copy_n(past + (k - 1) * all, all, past + k * all);
        std::copy_n(M.data(), all, past);
        memory[0] = double(std::min(known + 1, HISTORY));
        memory[1] = h;
    }

    int64_t step(double* x, double* dx, double*, double*, double t, double h) override {
        const double size = largest_of(numbers, [=](int64_t k) { return x[k]; }), half = 0.5 * h, quarter = half * half;
        extrapolate(reinterpret_cast<const T*>(x), h);
        this->iterations = 0;
        for (;;) {
            if (!stream.apply(M.data(), t + half, P.data())) return UNDEFINED;
            products.multiply(P.data(), M.data(), A.data());
            products.multiply(A.data(), P.data(), B.data());
            this->commutator(P.data(), M.data(), A.data(), h, move.data(), false);
            double *middle = numbers_of(M.data()), *moved = numbers_of(move.data()), *rotated = numbers_of(B.data());
            this->residual = largest_of(numbers, [=](int64_t k) {
                const double next = x[k] + (dx[k] + (0.5 * moved[k] + quarter * rotated[k])), change = next - middle[k];
                middle[k] = next;
                return change;
            });
            if (this->ended(this->residual, size)) break;
        }
        this->evaluations = this->iterations;
        if (this->status != DONE) return this->status;
        store_history(h);
        this->advance(x, dx, move.data());
        return DONE;
    }
};

// Several stages.
template <class T>
struct Stages final : GeneralStep<T> {
    typedef GeneralStep<T> Base;
    using Base::square, Base::n, Base::all, Base::numbers, Base::products, Base::stream, Base::stages;
    std::vector<T> V, U, P, K, L, M, A, next, move;

    explicit Stages(const StepTables& tables)
        : Base(tables), V(all * stages), U(all * stages), P(all * stages), K(all * stages),
          L(all * stages), M(all * stages), A(all), next(all), move(all) {}

    int64_t step(double* x, double* dx, double*, double*, double t, double h) override {
        for (int64_t e = 0; e < all; ++e) M[e] = reinterpret_cast<const T*>(x)[e] + reinterpret_cast<const T*>(dx)[e];
        const T* W = reinterpret_cast<const T*>(x);
        if (!stream.apply(M.data(), t, A.data())) return UNDEFINED;
        for (int64_t i = 0; i < stages; ++i) {
            std::copy_n(A.data(), all, K.data() + i * all);
            std::copy_n(A.data(), all, L.data() + i * all);
        }
        update_points(K, V, h);
        update_points(L, U, -h);
        this->iterations = 0;
        for (;;) {
            for (int64_t i = 0; i < stages; ++i) {
                T *v = V.data() + i * all, *m = M.data() + i * all, *p = P.data() + i * all;
                products.multiply(v, W, A.data());
                products.multiply(A.data(), U.data() + i * all, m);
                if (!stream.apply(m, t + this->c[i] * h, p)) return UNDEFINED;
                products.multiply(p, v, K.data() + i * all);
                products.multiply(U.data() + i * all, p, L.data() + i * all);
            }
            const double change = std::max(update_points(K, V, h), update_points(L, U, -h));
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
    double update_points(std::vector<T>& slopes, std::vector<T>& to, double h) {
        double change = 0.0;
        for (int64_t i = 0; i < stages; ++i) {
            const double* row = this->a + i * stages;
            double* now = numbers_of(next.data());
            std::fill_n(now, numbers, 0.0);
            for (int64_t j = 0; j < stages; ++j) {
                const double *slope = numbers_of(slopes.data() + j * all), factor = row[j];
                for (int64_t k = 0; k < numbers; ++k) now[k] += factor * slope[k];
            }
            for (int64_t k = 0; k < numbers; ++k) now[k] *= h;
            // The unit of two layers has only the first one.
            const int64_t units = this->stream.direct ? all : square;
            for (int64_t first = 0; first < units; first += square)
                for (int64_t e = 0; e < square; e += n + 1) next[first + e] += 1.0;
            double* old = numbers_of(to.data() + i * all);
            const double moved = largest_of(numbers, [=](int64_t k) { return now[k] - old[k]; });
            std::copy_n(now, numbers, old);
            if (!(moved <= change)) change = moved;
        }
        return change;
    }
};

template <class T>
StepScheme* made(const StepTables& tables) {
    const bool several = tables.whole[STAGES] > 1;
    if (tables.whole[GENERAL]) return several ? static_cast<StepScheme*>(new Stages<T>(tables)) : new Midpoint<T>(tables);
    return several ? static_cast<StepScheme*>(new SkewStages<T>(tables)) : new SkewMidpoint<T>(tables);
}

}  // namespace

// The part of a skew-Hermitian product of n rows that is computed.
EXPORT double lower_part_of_product(int64_t n) { return PlaneProducts<double>(0, n).lower_part(); }

// `whole`: the integers that a stream reads, then those that `TableIndex` names.
EXPORT StepScheme* isospectral_gauss_step(const StepTables& tables, const MemberConstants&) {
    return tables.whole[COMPLEX] ? made<Complex>(tables) : made<double>(tables);
}

}  // namespace coadjoint
