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
    std::vector<double> offsets, sizes, gradients, directions, defects, slopes, arguments, room;
    std::vector<int64_t> coordinates;
    std::map<int64_t, std::vector<int64_t>> rows_of;  // of a term that is not quadratic
    std::vector<Pair> pairs;
    Room<Places<W>> places;
    Room<double> increments;
    SparseFactors factors;
    bool in_registers = false;
    int64_t corrections = 0;
    double residual = 0.0;

    Projection(const Watch& watch, const C& constants, int64_t n)
        : watch(watch), constants(constants), slopes(watch.longest), arguments(watch.longest + 1),
          room(2 * watch.longest + 2), places(0), increments(blocks_of<W>(n) * W) {
        // A row for each coordinate then, and no map from one to the other.
        in_registers = n <= W && watch.size >= 1 && watch.size <= 4;
        for (int64_t k = 0; k < watch.terms.size; ++k) in_registers &= watch.terms.kind[k] == LINEAR;
        for (int64_t i = watch.size; i-- > 0;) lay_out(i, n);
        linear.finish();
        const int64_t rows = int64_t(offsets.size());
        places.clear(rows / W);
        std::copy_n(coordinates.data(), rows, reinterpret_cast<int64_t*>(places.at));
        gradients.resize(rows), defects.resize(watch.size);
        couple(n);
    }

    // The values that are to be kept, and up to which defect: 2 * size numbers.
    void begin(const Row* x, double* kept) {
        const double* at = reinterpret_cast<const double*>(x);
        const int64_t size = int64_t(invariants.size());
        for (int64_t a = 0; a < size; ++a) {
            kept[a] = value(a, at);
            kept[size + a] = EXACT * terms_of(a, at);
        }
    }

    // Move x + dx back to where all invariants have the values of `kept`; false where that does not converge.
    bool restore(Row* x, Row* dx, int64_t blocks, const double* kept) {
        corrections = 0;
        if (in_registers) {
            const size_t size = invariants.size();
            if (size == 1) return restore_few<1>(*x, *dx, kept);
            if (size == 2) return restore_few<2>(*x, *dx, kept);
            if (size == 3) return restore_few<3>(*x, *dx, kept);
            return restore_few<4>(*x, *dx, kept);
        }
        if (exact(x, kept)) return true;
        gram();
        factors.factorize();
        directions = gradients;
        for (corrections = 1; corrections <= MOST_CORRECTIONS; ++corrections) {
            const double before = residual;
            if (!(before - before == 0.0)) return false;
            factors.solve(defects.data());
            std::fill_n(increments.at, blocks * W, 0.0);
            for (size_t a = 0; a < invariants.size(); ++a)
                for (int64_t row = W * invariants[a].first; row < W * invariants[a].last; ++row)
                    increments.at[coordinates[row]] =
                        fma(defects[a], directions[row], increments.at[coordinates[row]]);
            for (int64_t b = 0; b < blocks; ++b) add_to(x[b], dx[b], load<Row>(increments.at + b * W));
            if (exact(x, kept) || (residual >= 0.5 * before && settled(x, kept))) return true;
        }
        return false;
    }

  private:
    // Up to four quadratic invariants of coordinates in one block.
    template <int R>
    NOINLINE bool restore_few(Row& x, Row& dx, const double* kept) {
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
        Row unused[R];
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
            if (few<R>(x, kept, unused, defect) || (residual >= 0.5 * before && settled(&x, kept))) return true;
        }
        return false;
    }

    template <int R>
    INLINE bool few(const Row& x, const double* kept, Row* slope, double* defect) {
        bool all = true;
        residual = 0.0;
#pragma GCC unroll 4
        for (int i = 0; i < R; ++i) {
            const Row offset = load<Row>(offsets.data() + i * W);
            slope[i] = offset;
            for (int64_t e = linear.first[i]; e < linear.first[i + 1]; ++e)
                slope[i] = fma(linear.weight.at[e], take<1>(&x, linear.left.at[e]), slope[i]);
            const Row terms = x * slope[i];
            defect[i] = kept[i] - (invariants[i].constant + 0.5 * sum_of_lanes(fma(x, offset, terms)));
            if (__builtin_expect(!(std::fabs(defect[i]) <= kept[R + i]), 0))
                all &= std::fabs(defect[i]) <= 0x1p20 * kept[R + i] &&
                       std::fabs(defect[i]) <= EXACT * terms_of(i, reinterpret_cast<const double*>(&x));
            residual += std::fabs(defect[i]);
        }
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
                    rows_of[k].push_back(base + it->second);
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
        sizes.push_back(double(sums.size()));
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
            for (int64_t k = 0, row = W * invariants[a].first; k < int64_t(sizes[a]); ++k, ++row)
                users[coordinates[row]].push_back({int64_t(a), row});
        for (const auto& list : users)
            for (size_t p = 0; p < list.size(); ++p)
                for (size_t q = p + 1; q < list.size(); ++q) below[list[p].first].insert(list[q].first);
        factors.analyse(below);
        for (const auto& list : users)
            for (size_t p = 0; p < list.size(); ++p)
                for (size_t q = p; q < list.size(); ++q)
                    pairs.push_back({p == q ? ~list[p].first : factors.place.at({list[q].first, list[p].first}),
                                     list[p].second, list[q].second});
    }

    void gram() {
        std::fill(factors.diagonal.begin(), factors.diagonal.end(), 0.0);
        std::fill(factors.entry.begin(), factors.entry.end(), 0.0);
        for (const Pair& pair : pairs) {
            double& target = pair.target < 0 ? factors.diagonal[~pair.target] : factors.entry[pair.target];
            target = fma(gradients[pair.left], gradients[pair.right], target);
        }
    }

    // Invariant a; its gradient is left in `gradients`.
    INLINE double value(size_t a, const double* x) {
        const Invariant& own = invariants[a];
        Row total(0.0);
        for (int64_t b = own.first; b < own.last; ++b) {
            const Row offset = load<Row>(offsets.data() + b * W);
            Row slope = offset;
            for (int64_t e = linear.first[b]; e < linear.first[b + 1]; ++e)
                slope = fma(linear.weight.at[e], take<W>(x, linear.left.at[e]), slope);
            store(gradients.data() + b * W, slope);
            total = fma(take<W>(x, places.at[b]), Row(0.5) * (slope + offset), total);
        }
        double result = own.constant + sum_of_lanes(total);
        for (const int64_t k : own.terms) result += further(k, x);
        return result;
    }

    void further_slopes(int64_t k, const double* x) {
        gradient_rows(watch.terms, constants, watch.addresses, k, x, 0.0, slopes.data(), watch.terms.row[k],
                      arguments.data(), room.data());
    }

    // The value of a term that is not quadratic; its gradient is added.
    NOINLINE double further(int64_t k, const double* x) {
        further_slopes(k, x);
        const std::vector<int64_t>& rows = rows_of.at(k);
        for (size_t i = 0; i < rows.size(); ++i) gradients[rows[i]] += slopes[i];
        return value_of_term(watch.terms, constants, watch.addresses, k, x, 0.0, arguments.data(), room.data());
    }

    // Whether the defect of an invariant is no more than rounding leaves: where the run began, or where its terms are as
    // large as they are now.
    INLINE bool rounding_alone(size_t a, const double* x, double least) {
        const double defect = std::fabs(defects[a]);
        if (defect <= least) return true;
        return defect <= 0x1p20 * least && defect <= EXACT * terms_of(a, x);
    }

    // Whether corrections that no longer help leave no more than rounding does where terms cancel.
    NOINLINE bool settled(const Row* x, const double* kept) {
        const double* at = reinterpret_cast<const double*>(x);
        bool all = true;
        for (size_t a = 0; a < invariants.size(); ++a)
            all &= std::fabs(kept[a] - value(a, at)) <= STAGNANT * EXACT * terms_of(a, at);
        return all;
    }

    // The sum of |x_i dC/dx_i|, and of the terms of dC/dx_i where it is linear.
    NOINLINE double terms_of(size_t a, const double* x) {
        const Invariant& own = invariants[a];
        Row total(0.0);
        for (int64_t b = own.first; b < own.last; ++b) {
            Row slope = absolute(load<Row>(offsets.data() + b * W));
            for (int64_t e = linear.first[b]; e < linear.first[b + 1]; ++e)
                slope = fma(absolute(linear.weight.at[e]), absolute(take<W>(x, linear.left.at[e])), slope);
            total = fma(absolute(take<W>(x, places.at[b])), slope, total);
        }
        double result = sum_of_lanes(total);
        for (const int64_t k : own.terms) {
            further_slopes(k, x);
            const std::vector<int64_t>& rows = rows_of.at(k);
            for (size_t i = 0; i < rows.size(); ++i) result += std::fabs(x[coordinates[rows[i]]] * slopes[i]);
        }
        return result;
    }

    // Note the defects, and whether none is more than rounding leaves.
    bool exact(const Row* x, const double* kept) {
        const double* at = reinterpret_cast<const double*>(x);
        const size_t size = invariants.size();
        bool all = true;
        residual = 0.0;
        for (size_t a = 0; a < size; ++a) {
            defects[a] = kept[a] - value(a, at);
            all &= rounding_alone(a, at, kept[size + a]);
            residual += std::fabs(defects[a]);
        }
        return all;
    }
};
