// Projection to the level set of polynomial invariants: y = z + G(z)^T lambda with C(y) = C_0, by Newton's iteration
// for lambda with the Gram matrix of the gradients at z.
#pragma once

#include "boundary/codes.hpp"
#include "numbers/arithmetic.hpp"
#include "steps/invariant_rows.hpp"
#include "numbers/sparse_factors.hpp"

namespace coadjoint {

// Relative defect that counts as rounding; codes.hpp has its multiple.
constexpr double EXACT = double(PROJECTION_EXACT) * UNIT_ROUNDOFF;
static_assert(DEPENDENT == power_of_two(-DEPENDENT_BITS), "the plain reading finds the same rows dependent");

// Add to x + dx, where dx is the compensation.
template <class A>
INLINE void add_to(A& x, A& dx, const A& more) {
    const A old = x;
    two_sum(old, dx + more, x, dx);
}

template <int W, class C>
struct Projection {
    typedef Lanes<W> Row;
    InvariantRows<W, C> rows;
    const size_t size;
    std::vector<double> defects, curvature;
    AlignedArray<Row> moved;
    SparseFactors factors;
    int64_t corrections = 0;
    double residual = 0.0;

    NOINLINE Projection(const Watch& watch, const C& constants, int64_t n)
        : rows(watch, constants, n), size(rows.invariants.size()), defects(size), curvature(size), moved(blocks_of<W>(n)) {
        factors.analyse(rows.coupled());
    }

    // The target values, and the allowed defects.
    int64_t memory_size() const { return 2 * int64_t(size); }
    NOINLINE void begin(const Row* x, double* targets) {
        for (size_t a = 0; a < size; ++a) {
            targets[a] = rows.template value<true>(a, Newest<0, W>(x), x);
            targets[size + a] = EXACT * rows.terms_of(a, x);
        }
    }

    // Move x + dx back to the level set `targets` of all invariants; false without convergence.
    NOINLINE bool restore(Row* x, Row* dx, int64_t blocks, double* targets) {
        corrections = 0;
        if (rows.few) {
            if constexpr (W == 8)
                if (blocks == 2) return restore_few<2>(x, dx, targets);
            return restore_few<1>(x, dx, targets);
        }
        if (exact<true>(x, blocks, targets)) return true;
        rows.gram(factors);
        factors.factorize();
        bound_curvature(x, blocks, factors.pivot.data());
        std::fill_n(moved.at, blocks, Row(0.0));
        for (corrections = 1; corrections <= PROJECTION_CORRECTIONS; ++corrections) {
            const double before = residual;
            if (!(before - before == 0.0)) return false;
            factors.solve(defects.data());
            Row least(0.0), total(0.0);
            for (int64_t b = 0; b < blocks; ++b) {
                const Row more = rows.direction(b, defects.data());
                moved.at[b] = moved.at[b] + more;
                add_to(x[b], dx[b], more);
                least = least + absolute(more), total = total + absolute(moved.at[b]);
            }
            const double product = sum_of_lanes(least) * sum_of_lanes(total);
            if (rows.bounded && negligible(product, targets)) return true;
            if (exact<false>(x, blocks, targets) || (residual >= 0.5 * before && settled(x, targets))) return true;
        }
        return false;
    }

    // If corrections stagnate: whether the defects are explained by the rounding of cancelling terms.
    NOINLINE bool settled(const Row* x, const double* targets) {
        bool all = true;
        for (size_t a = 0; a < size; ++a)
            all &= std::fabs(targets[a] - rows.template value<false>(a, Newest<0, W>(x), x)) <=
                   double(PROJECTION_STAGNANT) * EXACT * rows.terms_of(a, x);
        return all;
    }

  private:
    // Up to four invariants of coordinates in K blocks, all in registers.
    template <int K>
    bool restore_few(Row* x, Row* dx, double* targets) {
        if (size == 1) return restore_these<1, K>(x, dx, targets);
        if (size == 2) return restore_these<2, K>(x, dx, targets);
        if (size == 3) return restore_these<3, K>(x, dx, targets);
        return restore_these<4, K>(x, dx, targets);
    }

    template <int R, int K>
    NOINLINE bool restore_these(Row* state, Row* remainder, double* targets) {
        Row x[K], dx[K], slope[R][K];
        double defect[R], L[R][R], inverse[R];
        for (int b = 0; b < K; ++b) x[b] = state[b], dx[b] = remainder[b];
        if (few<R, K>(x, targets, slope, defect)) return true;
#pragma GCC unroll 4
        for (int i = 0; i < R; ++i)
#pragma GCC unroll 4
            for (int j = 0; j <= i; ++j) {
                Row product = slope[i][0] * slope[j][0];
                if constexpr (K == 2) product = fma(slope[i][1], slope[j][1], product);
                L[i][j] = sum_of_lanes(product);
            }
#pragma GCC unroll 4
        for (int j = 0; j < R; ++j) {
            const double square = L[j][j];
#pragma GCC unroll 4
            for (int k = 0; k < j; ++k) L[j][j] = fma(-L[j][k] * L[j][k], inverse[k], L[j][j]);
            inverse[j] = L[j][j] > DEPENDENT * square ? 1.0 / L[j][j] : 0.0;
#pragma GCC unroll 4
            for (int i = j + 1; i < R; ++i)
#pragma GCC unroll 4
                for (int k = 0; k < j; ++k) L[i][j] = fma(-L[i][k] * L[j][k], inverse[k], L[i][j]);
        }
        bound_curvature(x, K, inverse);
        Row unused[R][K], total[K];
        for (int b = 0; b < K; ++b) total[b] = Row(0.0);
        bool restored = false;
        for (corrections = 1; corrections <= PROJECTION_CORRECTIONS; ++corrections) {
            const double before = residual;
            if (!(before - before == 0.0)) break;
#pragma GCC unroll 4
            for (int j = 0; j < R; ++j) {
#pragma GCC unroll 4
                for (int k = 0; k < j; ++k) defect[j] = fma(-L[j][k], defect[k], defect[j]);
                defect[j] *= inverse[j];
            }
#pragma GCC unroll 4
            for (int j = R - 1; j >= 0; --j)
#pragma GCC unroll 4
                for (int k = j + 1; k < R; ++k) defect[j] = fma(-L[k][j] * inverse[j], defect[k], defect[j]);
            Row now(0.0), all(0.0);
#pragma GCC unroll 2
            for (int b = 0; b < K; ++b) {
                Row more(0.0);
#pragma GCC unroll 4
                for (int i = 0; i < R; ++i) more = fma(Row(defect[i]), slope[i][b], more);
                add_to(x[b], dx[b], more);
                total[b] = total[b] + more;
                now = b ? now + absolute(more) : absolute(more), all = b ? all + absolute(total[b]) : absolute(total[b]);
            }
            restored = negligible(sum_of_lanes(now) * sum_of_lanes(all), targets) ||
                       few<R, K>(x, targets, unused, defect) || (residual >= 0.5 * before && settled(x, targets));
            if (restored) break;
        }
        for (int b = 0; b < K; ++b) state[b] = x[b], remainder[b] = dx[b];
        return restored;
    }

    template <int R, int K>
    INLINE bool few(const Row* x, double* targets, Row (*slope)[K], double* defect) {
        const Newest<K, W> newest(x);
        bool all = true;
        residual = 0.0;
#pragma GCC unroll 4
        for (int i = 0; i < R; ++i) {
            Row total, whole;
#pragma GCC unroll 2
            for (int b = 0; b < K; ++b) {
                slope[i][b] = rows.slope(i * K + b, newest, x[b], whole);
                total = b ? fma(x[b], whole, total) : x[b] * whole;
            }
            defect[i] = targets[i] - (rows.invariants[i].constant + 0.5 * sum_of_lanes(total));
            all &= rounding_alone(i, defect[i], newest, x, targets[R + i]);
            residual += std::fabs(defect[i]);
        }
        return all;
    }

    // Set the bounds on second derivatives at x, once, since corrections hardly change them. Corrections do not restore
    // an invariant whose gradient depends on others, `inverse` zero: what is left of its defect has no bound.
    INLINE void bound_curvature(const Row* x, int64_t blocks, const double* inverse) {
        Row largest(0.0);
        for (int64_t b = 0; b < blocks && !rows.quadratic; ++b) largest = larger(largest, absolute(x[b]));
        const double most = rows.quadratic ? 0.0 : largest_lane(largest);
        for (size_t a = 0; a < size; ++a)
            curvature[a] = inverse[a] == 0.0 ? INFINITY : rows.second_derivative(a, most);
    }

    // Whether the error after a correction is within rounding. It is the second derivatives times the correction times
    // the sum of all corrections.
    INLINE bool negligible(double product, const double* targets) const {
        bool all = true;
        for (size_t a = 0; a < size; ++a) all &= product * curvature[a] <= 0.25 * targets[size + a];
        return all;
    }

    // Whether the defect of an invariant is within rounding. The bound is recomputed if terms have grown.
    template <class Take>
    INLINE bool rounding_alone(size_t a, double defect, const Take& newest, const Row* x, double& least) {
        if (std::fabs(defect) <= least) return true;
        if (!(std::fabs(defect) <= 0x1p4 * least)) return false;
        least = larger(least, EXACT * rows.terms_of(a, newest, x));
        return std::fabs(defect) <= least;
    }

    // Compute the defects, and whether all are within rounding.
    template <bool with_gradient>
    bool exact(const Row* x, int64_t blocks, double* targets) {
        if constexpr (W == 8) {
            if (blocks == 2) return exact_by<with_gradient>(Newest<2, W>(x), x, targets);
            if (blocks == 3) return exact_by<with_gradient>(Newest<3, W>(x), x, targets);
        }
        return exact_by<with_gradient>(Newest<0, W>(x), x, targets);
    }

    template <bool with_gradient, class Take>
    NOINLINE bool exact_by(const Take& newest, const Row* x, double* targets) {
        bool all = true;
        residual = 0.0;
        for (size_t a = 0; a < size; ++a) {
            defects[a] = targets[a] - rows.template value<with_gradient>(a, newest, x);
            all &= rounding_alone(a, defects[a], newest, x, targets[size + a]);
            residual += std::fabs(defects[a]);
        }
        return all;
    }
};

}  // namespace coadjoint
