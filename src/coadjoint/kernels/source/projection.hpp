// Back to the level set of invariants that are polynomials: y = z + G(z)^T lambda with C(y) = C_0, by Newton's iteration
// for lambda with the Gram matrix of the gradients at z.
#pragma once

#include "row_lanes.hpp"
#include "sparse_factors.hpp"
#include "watching.hpp"

constexpr double EXACT = 0x1p-51;   // of the sum of the terms of x . dC/dx: a defect that rounding alone leaves
constexpr double STAGNANT = 0x1p8;  // times that: where corrections no longer help
constexpr int64_t MOST_CORRECTIONS = 64;

// Add to x + dx, where dx is what rounding left.
template <class A>
INLINE void add_to(A& x, A& dx, const A& more) {
    const A increment = dx + more, now = x + increment, kept = now - x;
    dx = (x - (now - kept)) + (increment - kept);
    x = now;
}

// The invariants of a table from the last to the first, the energy, which is coupled to most. Each has blocks of W rows,
// the components of its gradient.
template <int W, class C>
struct Projection {
    typedef Lanes<W> Row;
    struct Invariant {
        int64_t first, last;  // blocks of rows
        double constant;
        std::vector<int64_t> terms;  // those that are not quadratic
    };
    struct Pair {
        int64_t target, left, right;  // of the Gram matrix, from two rows; below zero, its diagonal entry ~target
    };
    const Watch& watch;
    const C constants;
    std::vector<Invariant> invariants;
    Sums<W> linear;
    std::vector<double> offsets, gradients, directions, defects, products;
    std::vector<int64_t> coordinates, used;
    std::vector<int64_t> row_of;  // of each row of a term that is not quadratic
    std::vector<Pair> pairs;
    Room<Places<W>> places;
    Room<double> increments, moved;
    SparseFactors factors;
    std::vector<double> bends;  // no second derivative of a quadratic invariant is larger; infinite for others
    bool in_registers = false;
    int64_t corrections = 0;
    double residual = 0.0;

    Projection(const Watch& watch, const C& constants, int64_t n)
        : watch(watch), constants(constants), products(watch.longest + 1), row_of(watch.terms.row[watch.terms.size], -1),
          places(0), increments(blocks_of<W>(n) * W),
          moved(blocks_of<W>(n) * W) {
        // A row for each coordinate then, and no map from one to the other.
        in_registers = n <= W && watch.size >= 1 && watch.size <= 4;
        for (int64_t k = 0; k < watch.terms.size; ++k) in_registers &= watch.terms.kind[k] == LINEAR;
        for (int64_t i = watch.size; i-- > 0;) lay_out(i, n);
        linear.finish();
        const int64_t rows = int64_t(offsets.size());
        places.clear(rows / W);
        std::copy_n(coordinates.data(), rows, reinterpret_cast<int64_t*>(places.at));
        gradients.resize(rows), directions.resize(rows), defects.resize(watch.size);
        couple(n);
        for (const Invariant& own : invariants) {
            double most = 0.0;
            for (int64_t b = own.first; b < own.last; ++b) {
                Row total(0.0);
                for (int64_t e = linear.first[b]; e < linear.first[b + 1]; ++e)
                    total = total + absolute(linear.at.at[e].weight);
                for (int row = 0; row < W; ++row) most = larger(most, total[row]);
            }
            bends.push_back(own.terms.empty() ? most : std::numeric_limits<double>::infinity());
        }
    }

    // The values that are to be kept, and up to which defect: 2 * size numbers.
    void begin(const Row* x, double* kept) {
        const double* at = reinterpret_cast<const double*>(x);
        const int64_t size = int64_t(invariants.size());
        for (int64_t a = 0; a < size; ++a) {
            kept[a] = value<true>(a, Newest<0, W>(x), at);
            kept[size + a] = EXACT * terms_of(a, at);
        }
    }

    // Move x + dx back to where all invariants have the values of `kept`; false where that does not converge.
    bool restore(Row* x, Row* dx, int64_t blocks, double* kept) {
        corrections = 0;
        if (in_registers) {
            const size_t size = invariants.size();
            if (size == 1) return restore_few<1>(*x, *dx, kept);
            if (size == 2) return restore_few<2>(*x, *dx, kept);
            if (size == 3) return restore_few<3>(*x, *dx, kept);
            return restore_few<4>(*x, *dx, kept);
        }
        if (exact<true>(x, blocks, kept)) return true;
        gram();
        factors.factorize();
        std::copy(gradients.begin(), gradients.end(), directions.begin());
        std::fill_n(moved.at, blocks * W, 0.0);
        for (corrections = 1; corrections <= MOST_CORRECTIONS; ++corrections) {
            const double before = residual;
            if (!(before - before == 0.0)) return false;
            factors.solve(defects.data());
            std::fill_n(increments.at, blocks * W, 0.0);
            for (size_t a = 0; a < invariants.size(); ++a)
                for (int64_t row = W * invariants[a].first, stop = row + used[a]; row < stop; ++row) {
                    double& increment = increments.at[coordinates[row]];
                    increment = fma(defects[a], directions[row], increment);
                }
            Row least(0.0), total(0.0);
            for (int64_t b = 0; b < blocks; ++b) {
                const Row more = load<Row>(increments.at + b * W), together = load<Row>(moved.at + b * W) + more;
                store(moved.at + b * W, together);
                add_to(x[b], dx[b], more);
                least = least + absolute(more), total = total + absolute(together);
            }
            if (negligible(sum_of_lanes(least) * sum_of_lanes(total), kept)) return true;
            if (exact<false>(x, blocks, kept) || (residual >= 0.5 * before && settled(x, kept))) return true;
        }
        return false;
    }

  private:
    // Up to four quadratic invariants of coordinates in one block.
    template <int R>
    NOINLINE bool restore_few(Row& x, Row& dx, double* kept) {
        Row slope[R];
        double defect[R], L[R][R], inverse[R];
        bool all = few<R>(x, kept, slope, defect);
        if (all) return true;
#pragma GCC unroll 4
        for (int i = 0; i < R; ++i)
#pragma GCC unroll 4
            for (int j = 0; j <= i; ++j) L[i][j] = sum_of_lanes(slope[i] * slope[j]);
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
        Row unused[R], total(0.0);
        for (corrections = 1; corrections <= MOST_CORRECTIONS; ++corrections) {
            const double before = residual;
            if (!(before - before == 0.0)) return false;
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
            Row more(0.0);
#pragma GCC unroll 4
            for (int i = 0; i < R; ++i) more = fma(Row(defect[i]), slope[i], more);
            add_to(x, dx, more);
            total = total + more;
            if (negligible(sum_of_lanes(absolute(more)) * sum_of_lanes(absolute(total)), kept)) return true;
            if (few<R>(x, kept, unused, defect) || (residual >= 0.5 * before && settled(&x, kept))) return true;
        }
        return false;
    }

    template <int R>
    INLINE bool few(const Row& x, double* kept, Row* slope, double* defect) {
        bool all = true;
        residual = 0.0;
#pragma GCC unroll 4
        for (int i = 0; i < R; ++i) {
            const Row offset = load<Row>(offsets.data() + i * W);
            slope[i] = offset;
            for (int64_t e = linear.first[i]; e < linear.first[i + 1]; ++e)
                slope[i] = fma(linear.at.at[e].weight, take<1>(&x, linear.at.at[e].left), slope[i]);
            const Row terms = x * slope[i];
            defect[i] = kept[i] - (invariants[i].constant + 0.5 * sum_of_lanes(fma(x, offset, terms)));
            all &= rounding_alone(i, defect[i], reinterpret_cast<const double*>(&x), kept[R + i]);
            residual += std::fabs(defect[i]);
        }
        return all;
    }

    // Whether a correction leaves no more than rounding: it leaves second derivatives times itself, times all corrections
    // together.
    INLINE bool negligible(double product, const double* kept) const {
        const size_t size = bends.size();
        bool all = true;
        for (size_t a = 0; a < size; ++a) all &= product * bends[a] <= 0.25 * kept[size + a];
        return all;
    }

    // The rows of invariant i: for every coordinate that it depends on, a sparse sum, to which other terms add.
    void lay_out(int64_t i, int64_t n) {
        const Terms& terms = watch.terms;
        std::map<int64_t, int64_t> place;
        std::vector<SparseSum> sums;
        std::vector<double> offset;
        const int64_t base = int64_t(offsets.size());
        Invariant found{base / W, 0, constants.template number_at<double>(watch.constant, i), {}};
        if (in_registers)
            for (int64_t row = 0; row < n; ++row) {
                place[row] = row;
                sums.emplace_back(), offset.push_back(0.0), coordinates.push_back(row);
            }
        for (uint32_t k = watch.first[i]; k < watch.first[i + 1]; ++k) {
            if (terms.kind[k] != LINEAR) found.terms.push_back(k);
            for (uint32_t row = terms.row[k]; row < terms.row[k + 1]; ++row) {
                const auto [it, fresh] = place.emplace(terms.target[row], int64_t(sums.size()));
                if (fresh) {
                    sums.emplace_back(), offset.push_back(0.0);
                    coordinates.push_back(terms.target[row]);
                }
                if (terms.kind[k] != LINEAR) {
                    row_of[row] = base + it->second;
                    continue;
                }
                offset[it->second] += constants.template number_at<double>(terms.offset, row);
                for (uint32_t e = terms.entry[row]; e < terms.entry[row + 1]; ++e)
                    sums[it->second].push_back({constants.template number_at<double>(terms.weight, e),
                                                int64_t(terms.column[e]), 0});
            }
        }
        linear.add(sums);
        offsets.insert(offsets.end(), offset.begin(), offset.end());
        used.push_back(int64_t(sums.size()));
        // What fills the last block has the gradient zero.
        offsets.resize(base + W * blocks_of<W>(int64_t(sums.size())), 0.0);
        coordinates.resize(offsets.size(), 0);
        found.last = int64_t(offsets.size()) / W;
        invariants.push_back(found);
    }

    void couple(int64_t n) {
        std::vector<std::vector<std::pair<int64_t, int64_t>>> users(n);  // invariant and row, by coordinate
        std::vector<std::set<int64_t>> below(invariants.size());
        for (size_t a = 0; a < invariants.size(); ++a)
            for (int64_t k = 0, row = W * invariants[a].first; k < used[a]; ++k, ++row)
                users[coordinates[row]].push_back({int64_t(a), row});
        for (const auto& list : users)
            for (size_t p = 0; p < list.size(); ++p)
                for (size_t q = p + 1; q < list.size(); ++q) below[list[p].first].insert(list[q].first);
        factors.analyse(below);
        for (const auto& list : users)
            for (size_t p = 0; p < list.size(); ++p)
                for (size_t q = p + 1; q < list.size(); ++q)
                    pairs.push_back(
                        {factors.place.at({list[q].first, list[p].first}), list[p].second, list[q].second});
        std::stable_sort(pairs.begin(), pairs.end(),
                         [](const Pair& a, const Pair& b) { return a.target < b.target; });
    }

    void gram() {
        for (size_t a = 0; a < invariants.size(); ++a) {
            Row total(0.0);
            for (int64_t b = invariants[a].first; b < invariants[a].last; ++b) {
                const Row slope = load<Row>(gradients.data() + b * W);
                total = fma(slope, slope, total);
            }
            factors.diagonal[a] = sum_of_lanes(total);
        }
        std::fill(factors.entry.begin(), factors.entry.end(), 0.0);
        for (size_t k = 0; k < pairs.size();) {
            const int64_t target = pairs[k].target;
            double total = 0.0;
            for (; k < pairs.size() && pairs[k].target == target; ++k)
                total = fma(gradients[pairs[k].left], gradients[pairs[k].right], total);
            factors.entry[target] = total;
        }
    }

    // Invariant a, and its gradient, which is left in `gradients`.
    template <bool with_gradient, class Take>
    INLINE double value(size_t a, const Take& newest, const double* x) {
        const Invariant& own = invariants[a];
        Row total(0.0);
        for (int64_t b = own.first; b < own.last; ++b) {
            const Row offset = load<Row>(offsets.data() + b * W);
            Row slope = offset;
            for (int64_t e = linear.first[b]; e < linear.first[b + 1]; ++e)
                slope = fma(linear.at.at[e].weight, newest(linear.at.at[e].left), slope);
            if (with_gradient) store(gradients.data() + b * W, slope);
            total = fma(newest(places.at[b]), slope + offset, total);
        }
        double result = own.constant + 0.5 * sum_of_lanes(total);
        for (const int64_t k : own.terms) result += further<with_gradient>(k, x, gradients.data());
        return result;
    }

    // The value of a polynomial of a higher degree, by the products before and behind each of its factors; its gradient
    // is added.
    template <bool with_gradient>
    NOINLINE double further(int64_t k, const double* x, double* slopes) {
        const Terms& terms = watch.terms;
        double total = 0.0;
        for (uint32_t monomial = terms.monomial[k]; monomial < terms.monomial[k + 1]; ++monomial) {
            const uint32_t low = terms.factor[monomial], high = terms.factor[monomial + 1];
            double before = constants.template number_at<double>(terms.coefficient, monomial), behind = 1.0;
            for (uint32_t f = low; f < high; ++f) {
                products[f - low] = before;
                before *= power(x[terms.target[terms.factor_row[f]]], terms.exponent[f]);
            }
            total += before;
            for (uint32_t f = high; with_gradient && f-- > low;) {
                const double y = x[terms.target[terms.factor_row[f]]], rest = power(y, terms.exponent[f] - 1);
                slopes[row_of[terms.factor_row[f]]] += (products[f - low] * behind) * (double(terms.exponent[f]) * rest);
                behind *= rest * y;
            }
        }
        return total;
    }

    // Whether the defect of an invariant is no more than rounding leaves, which is noted where its terms have grown.
    INLINE bool rounding_alone(size_t a, double defect, const double* x, double& least) {
        if (std::fabs(defect) <= least) return true;
        if (!(std::fabs(defect) <= 0x1p4 * least)) return false;
        least = larger(least, EXACT * terms_of(a, x));
        return std::fabs(defect) <= least;
    }

    // Whether corrections that no longer help leave no more than rounding does where terms cancel.
    NOINLINE bool settled(const Row* x, const double* kept) {
        const double* at = reinterpret_cast<const double*>(x);
        bool all = true;
        for (size_t a = 0; a < invariants.size(); ++a)
            all &= std::fabs(kept[a] - value<false>(a, Newest<0, W>(x), at)) <= STAGNANT * EXACT * terms_of(a, at);
        return all;
    }

    // The sum of |x_i dC/dx_i|, and of the terms of dC/dx_i where it is linear.
    NOINLINE double terms_of(size_t a, const double* x) {
        const Invariant& own = invariants[a];
        Row total(0.0);
        for (int64_t b = own.first; b < own.last; ++b) {
            Row slope = absolute(load<Row>(offsets.data() + b * W));
            for (int64_t e = linear.first[b]; e < linear.first[b + 1]; ++e)
                slope = fma(absolute(linear.at.at[e].weight), absolute(take<W>(x, linear.at.at[e].left)), slope);
            total = fma(absolute(take<W>(x, places.at[b])), slope, total);
        }
        double result = sum_of_lanes(total);
        for (const int64_t k : own.terms) {
            std::vector<double> slopes(offsets.size(), 0.0);
            further<true>(k, x, slopes.data());
            for (size_t row = 0; row < slopes.size(); ++row) result += std::fabs(x[coordinates[row]] * slopes[row]);
        }
        return result;
    }

    // Note the defects, and whether none is more than rounding leaves.
    template <bool with_gradient>
    bool exact(const Row* x, int64_t blocks, double* kept) {
        if constexpr (W == 8) {
            if (blocks == 2) return exact_by<with_gradient>(Newest<2, W>(x), x, kept);
            if (blocks == 3) return exact_by<with_gradient>(Newest<3, W>(x), x, kept);
        }
        return exact_by<with_gradient>(Newest<0, W>(x), x, kept);
    }

    template <bool with_gradient, class Take>
    NOINLINE bool exact_by(const Take& newest, const Row* x, double* kept) {
        const double* at = reinterpret_cast<const double*>(x);
        const size_t size = invariants.size();
        bool all = true;
        residual = 0.0;
        for (size_t a = 0; a < size; ++a) {
            defects[a] = kept[a] - value<with_gradient>(a, newest, at);
            all &= rounding_alone(a, defects[a], at, kept[size + a]);
            residual += std::fabs(defects[a]);
        }
        return all;
    }
};
