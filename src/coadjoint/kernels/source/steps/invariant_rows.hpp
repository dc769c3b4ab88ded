// Invariants that are polynomials, with their gradients as rows of lanes that stand where the coordinates do.
#pragma once

#include <limits>
#include <set>

#include "field/row_lanes.hpp"
#include "numbers/sparse_factors.hpp"
#include "recording/watching.hpp"

namespace coadjoint {

// The invariants of a table, from the last to the first. The first is the energy, which is coupled to most of the
// others. Each invariant has a row of lanes for every block of coordinates that it depends on. Quadratic terms are
// sparse sums; other terms are added to them.
template <int W, class C>
struct InvariantRows {
    typedef Lanes<W> Row;
    struct Invariant {
        int64_t first, last;  // rows of lanes
        double constant;
        std::vector<int64_t> terms;  // those that are not quadratic
    };
    struct Pair {
        int64_t target, left, right;  // an entry of the Gram matrix, from two rows of lanes
    };
    const Watch& watch;
    const C constants;
    std::vector<Invariant> invariants;
    Sums<W> linear;
    std::vector<int64_t> own;           // of each row: how many of its first vectors are the coordinates themselves
    std::vector<int64_t> block;         // of each row: its block of coordinates
    std::vector<double> offsets, bends;  // no second derivative of a quadratic invariant is larger than its bend
    std::vector<std::vector<std::pair<int64_t, int64_t>>> users;  // invariants and rows of a block of coordinates
    std::vector<int64_t> place;         // of each row of a term that is not quadratic: its place in `gradients`
    std::vector<Pair> pairs;
    std::vector<double> products;
    Room<double> gradients;
    bool few = false;      // all in one block, up to four, and quadratic
    bool bounded = true;   // all are quadratic

    InvariantRows(const Watch& watch, const C& constants, int64_t n)
        : watch(watch), constants(constants), users(blocks_of<W>(n)), place(watch.terms.row[watch.terms.size], -1),
          products(watch.longest + 1), gradients(0) {
        for (int64_t i = watch.size; i-- > 0;) lay_out(i, n);
        linear.finish();
        gradients.clear(int64_t(offsets.size()));
        few = n <= W && watch.size >= 1 && watch.size <= 4 && bounded;
        for (size_t a = 0; a < invariants.size(); ++a)
            for (int64_t row = invariants[a].first; row < invariants[a].last; ++row)
                users[block[row]].push_back({int64_t(a), row});
    }

    // Which invariants stand in rows of the same block, as columns of a Gram matrix.
    std::vector<std::set<int64_t>> coupled() const {
        std::vector<std::set<int64_t>> below(invariants.size());
        for (const auto& list : users)
            for (size_t p = 0; p < list.size(); ++p)
                for (size_t q = p + 1; q < list.size(); ++q)
                    if (meet(list[p].second, list[q].second)) below[list[p].first].insert(list[q].first);
        return below;
    }

    void gram(SparseFactors& factors) {
        if (pairs.empty()) couple(factors);
        for (size_t a = 0; a < invariants.size(); ++a) {
            Row total(0.0);
            for (int64_t row = invariants[a].first; row < invariants[a].last; ++row)
                total = fma(gradient(row), gradient(row), total);
            factors.diagonal[a] = sum_of_lanes(total);
        }
        std::fill(factors.entry.begin(), factors.entry.end(), 0.0);
        for (size_t k = 0; k < pairs.size();) {
            const int64_t target = pairs[k].target;
            Row total(0.0);
            for (; k < pairs.size() && pairs[k].target == target; ++k)
                total = fma(gradient(pairs[k].left), gradient(pairs[k].right), total);
            factors.entry[target] = sum_of_lanes(total);
        }
    }

    // sum_a lambda_a dC_a/dx in a block of coordinates.
    INLINE Row direction(int64_t b, const double* lambda) const {
        Row total(0.0);
        for (const auto& [a, row] : users[b]) total = fma(Row(lambda[a]), gradient(row), total);
        return total;
    }

    // The quadratic part of a row of the gradient.
    template <class Take>
    INLINE Row slope(int64_t row, const Take& newest, const Row& x, const Row& offset) const {
        Row total = offset;
        int64_t e = linear.first[row];
        for (const int64_t stop = e + own[row]; e < stop; ++e) total = fma(linear.at.at[e].weight, x, total);
        for (; e < linear.first[row + 1]; ++e) total = fma(linear.at.at[e].weight, newest(linear.at.at[e].left), total);
        return total;
    }

    // Invariant a; its gradient is left in `gradients`.
    template <bool with_gradient, class Take>
    INLINE double value(size_t a, const Take& newest, const Row* x) {
        Row total(0.0);
        for (int64_t row = invariants[a].first; row < invariants[a].last; ++row) {
            const Row offset = load<Row>(offsets.data() + row * W);
            const Row rising = slope(row, newest, x[block[row]], offset);
            if (with_gradient) store(gradients.at + row * W, rising);
            total = fma(x[block[row]], rising + offset, total);
        }
        double result = invariants[a].constant + 0.5 * sum_of_lanes(total);
        for (const int64_t k : invariants[a].terms) result += further<with_gradient>(k, x, gradients.at);
        return result;
    }

    // The sum of |x_i dC/dx_i|, and of the terms of dC/dx_i where it is linear.
    NOINLINE double terms_of(size_t a, const Row* x) {
        double result = quadratic_terms_of(a, x);
        for (const int64_t k : invariants[a].terms) {
            std::vector<double> slopes(offsets.size(), 0.0);
            further<true>(k, x, slopes.data());
            for (int64_t row = invariants[a].first; row < invariants[a].last; ++row)
                for (int lane = 0; lane < W; ++lane) result += std::fabs(x[block[row]][lane] * slopes[row * W + lane]);
        }
        return result;
    }

    // The sum of all terms of x . dC/dx: the same, but where terms of a dC/dx_i cancel.
    NOINLINE double single_terms_of(size_t a, const Row* x) const {
        double result = quadratic_terms_of(a, x);
        for (const int64_t k : invariants[a].terms) result += monomials_of(k, reinterpret_cast<const double*>(x));
        return result;
    }

  private:
    INLINE Row gradient(int64_t row) const { return load<Row>(gradients.at + row * W); }

    double quadratic_terms_of(size_t a, const Row* x) const {
        Row total(0.0);
        for (int64_t row = invariants[a].first; row < invariants[a].last; ++row) {
            Row rising = absolute(load<Row>(offsets.data() + row * W));
            for (int64_t e = linear.first[row]; e < linear.first[row + 1]; ++e)
                rising = fma(absolute(linear.at.at[e].weight), absolute(Newest<0, W>(x)(linear.at.at[e].left)), rising);
            total = fma(absolute(x[block[row]]), rising, total);
        }
        return sum_of_lanes(total);
    }

    double monomials_of(int64_t k, const double* x) const {
        const Terms& terms = watch.terms;
        double total = 0.0;
        for (uint32_t monomial = terms.monomial[k]; monomial < terms.monomial[k + 1]; ++monomial) {
            double product = constants.template number_at<double>(terms.coefficient, monomial), degree = 0.0;
            for (uint32_t f = terms.factor[monomial]; f < terms.factor[monomial + 1]; ++f) {
                product *= power(x[terms.target[terms.factor_row[f]]], terms.exponent[f]);
                degree += double(terms.exponent[f]);
            }
            total += degree * std::fabs(product);
        }
        return total;
    }

    // Whether two rows of a block have a coordinate in common.
    bool meet(int64_t one, int64_t other) const {
        for (int lane = 0; lane < W; ++lane)
            if (there[one * W + lane] && there[other * W + lane]) return true;
        return false;
    }

    // The rows of invariant i.
    void lay_out(int64_t i, int64_t n) {
        const Terms& terms = watch.terms;
        std::map<int64_t, SparseSum> sums;  // by coordinate
        std::map<int64_t, double> offset;
        Invariant found{int64_t(block.size()), 0, constants.template number_at<double>(watch.constant, i), {}};
        for (uint32_t k = watch.first[i]; k < watch.first[i + 1]; ++k) {
            if (terms.kind[k] != LINEAR) found.terms.push_back(k), bounded = false;
            for (uint32_t row = terms.row[k]; row < terms.row[k + 1]; ++row) {
                SparseSum& sum = sums[terms.target[row]];
                if (terms.kind[k] != LINEAR) continue;
                offset[terms.target[row]] += constants.template number_at<double>(terms.offset, row);
                for (uint32_t e = terms.entry[row]; e < terms.entry[row + 1]; ++e)
                    sum.push_back({constants.template number_at<double>(terms.weight, e), int64_t(terms.column[e]), 0});
            }
        }
        if (n <= W) sums[0];  // one block of coordinates has a row of every invariant
        double most = 0.0;
        for (auto it = sums.begin(); it != sums.end();) {
            const int64_t b = it->first / W;
            std::vector<SparseSum> lanes(W);
            offsets.resize((block.size() + 1) * W, 0.0);
            there.resize((block.size() + 1) * W, false);
            bool diagonal = false;
            for (; it != sums.end() && it->first / W == b; ++it) {
                const int64_t lane = it->first % W, at = int64_t(block.size()) * W + lane;
                SparseSum& sum = it->second;
                // The coordinate itself first.
                std::stable_partition(sum.begin(), sum.end(), [&](const Entry& e) { return e.left == it->first; });
                diagonal |= !sum.empty() && sum.front().left == it->first;
                offsets[at] = offset.count(it->first) ? offset[it->first] : 0.0;
                there[at] = true;
                double total = 0.0;
                for (const Entry& entry : sum) total += std::fabs(entry.weight);
                most = larger(most, total);
                lanes[lane] = sum;
            }
            if (diagonal)
                for (int lane = 0; lane < W; ++lane)
                    if (SparseSum& sum = lanes[lane]; sum.empty() || sum.front().left != b * W + lane)
                        sum.insert(sum.begin(), Entry{0.0, b * W + lane, 0});
            own.push_back(diagonal);
            linear.add(lanes);
            block.push_back(b);
        }
        for (const int64_t k : found.terms)
            for (uint32_t row = terms.row[k]; row < terms.row[k + 1]; ++row)
                for (size_t r = found.first; r < block.size(); ++r)
                    if (block[r] == terms.target[row] / W) place[row] = int64_t(r) * W + terms.target[row] % W;
        bends.push_back(found.terms.empty() ? most : std::numeric_limits<double>::infinity());
        found.last = int64_t(block.size());
        invariants.push_back(found);
    }

    void couple(const SparseFactors& factors) {
        for (const auto& list : users)
            for (size_t p = 0; p < list.size(); ++p)
                for (size_t q = p + 1; q < list.size(); ++q)
                    if (meet(list[p].second, list[q].second))
                        pairs.push_back(
                            {factors.place.at({list[q].first, list[p].first}), list[p].second, list[q].second});
        std::stable_sort(pairs.begin(), pairs.end(), [](const Pair& a, const Pair& b) { return a.target < b.target; });
    }

    // Returns the value of a polynomial of a higher degree, and adds its gradient, by the products before and behind
    // each factor.
    template <bool with_gradient>
    NOINLINE double further(int64_t k, const Row* from, double* slopes) {
        const Terms& terms = watch.terms;
        const double* x = reinterpret_cast<const double*>(from);
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
                slopes[place[terms.factor_row[f]]] += (products[f - low] * behind) * (double(terms.exponent[f]) * rest);
                behind *= rest * y;
            }
        }
        return total;
    }

    std::vector<bool> there;  // whether a lane of a row is a coordinate of its invariant
};

}  // namespace coadjoint
