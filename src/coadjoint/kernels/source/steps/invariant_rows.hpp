// Polynomial invariants, with their gradients as rows of lanes aligned with the coordinates.
#pragma once

#include <limits>
#include <set>

#include "field/row_lanes.hpp"
#include "numbers/sparse_factors.hpp"
#include "steps/invariant_gradient.hpp"
#include "steps/product_rows.hpp"

namespace coadjoint {

// The invariants of a table, from the last to the first. The first is the energy, which is coupled to most of the
// others. Each invariant has a row of lanes for every block of coordinates on which it depends. The gradient is a
// sparse sum there, of coordinates and of products of coordinates; products of very many factors are added to it.
template <int W, class C>
struct InvariantRows {
    typedef Lanes<W> Row;
    struct Invariant {
        int64_t first, last;  // rows of lanes
        double constant;
        std::vector<int64_t> terms;  // terms that are not written out
    };
    struct Pair {
        int64_t target, left, right;  // an entry of the Gram matrix, from two rows of lanes
    };
    static constexpr int64_t MOST_HELD = W == 8 ? 2 : 1;  // blocks that fit in registers
    const Watch& watch;
    const C constants;
    std::vector<Invariant> invariants;
    Sums<W> linear;
    std::vector<int64_t> diagonal_vectors;  // of each row: how many of its first vectors are the coordinates themselves
    std::vector<int64_t> block;         // of each row: its block of coordinates
    ProductRows<W> products;
    std::vector<double> offsets;
    // Bounds on the second derivatives: their sum in a row of an invariant is at most the sum of these factors times
    // powers of the largest coordinate, as (power, factor).
    std::vector<std::vector<std::pair<size_t, double>>> second_derivatives;
    std::vector<std::vector<std::pair<int64_t, int64_t>>> users;  // invariants and rows of a block of coordinates
    std::vector<int64_t> position;  // of each row of a non-quadratic term: its index in `gradients`
    std::vector<Pair> pairs;
    std::vector<double> before;
    AlignedArray<double> gradients;
    bool few = false;       // up to four, written out, and in two blocks at most
    bool quadratic = true;  // all of them are
    bool bounded = true;    // all are written out

    NOINLINE InvariantRows(const Watch& watch, const C& constants, int64_t n)
        : watch(watch), constants(constants), users(blocks_of<W>(n)), position(watch.terms.row[watch.terms.size], -1),
          before(watch.longest + 1), gradients(0) {
        for (int64_t i = watch.size; i-- > 0;) lay_out(i, n);
        linear.finish(), products.finish();
        gradients.clear(int64_t(offsets.size()));
        few = n <= MOST_HELD * W && watch.size >= 1 && watch.size <= 4 && bounded;
        for (size_t a = 0; a < invariants.size(); ++a)
            for (int64_t row = invariants[a].first; row < invariants[a].last; ++row)
                users[block[row]].push_back({int64_t(a), row});
    }

    // The invariants with rows of the same block, as columns of a Gram matrix.
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

    // A row of the gradient, without products of very many factors. `whole` times the coordinates is twice the
    // invariant.
    template <class Take>
    INLINE Row slope(int64_t row, const Take& newest, const Row& x, Row& whole) const {
        const Row offset = load<Row>(offsets.data() + row * W);
        Row total = offset;
        int64_t e = linear.first[row];
        for (const int64_t stop = e + diagonal_vectors[row]; e < stop; ++e)
            total = fma(linear.at.at[e].weight, x, total);
        for (; e < linear.first[row + 1]; ++e) total = fma(linear.at.at[e].weight, newest(linear.at.at[e].left), total);
        whole = total + offset;
        for (int64_t s = products.first[row]; s < products.first[row + 1]; ++s) {
            const Row more = products.sum(products.segments[s], newest);
            total = total + more;
            whole = fma(Row(2.0 / double(products.segments[s].factors + 1)), more, whole);
        }
        return total;
    }

    // Invariant a; its gradient is stored in `gradients`.
    template <bool with_gradient, class Take>
    INLINE double value(size_t a, const Take& newest, const Row* x) {
        Row total(0.0);
        for (int64_t row = invariants[a].first; row < invariants[a].last; ++row) {
            Row whole;
            const Row rising = slope(row, newest, x[block[row]], whole);
            if (with_gradient) store(gradients.at + row * W, rising);
            total = fma(x[block[row]], whole, total);
        }
        double result = invariants[a].constant + 0.5 * sum_of_lanes(total);
        for (const int64_t k : invariants[a].terms) result += further<with_gradient>(k, x, gradients.at);
        return result;
    }

    // The bound on the sum of second derivatives in a row of invariant a, for coordinates up to `largest`.
    double second_derivative(size_t a, double largest) const {
        double total = 0.0;
        for (const auto& [exponent, factor] : second_derivatives[a])
            total += exponent == 0 ? factor : factor * power(largest, uint32_t(exponent));
        return total;
    }

    // The sum of the sizes of all terms of x . dC/dx, to which the rounding of C is proportional, even if terms of a
    // dC/dx_i cancel.
    double terms_of(size_t a, const Row* x) const { return terms_of(a, Newest<0, W>(x), x); }
    template <class Take>
    NOINLINE double terms_of(size_t a, const Take& newest, const Row* x) const {
        Row total(0.0);
        for (int64_t row = invariants[a].first; row < invariants[a].last; ++row) {
            Row rising = absolute(load<Row>(offsets.data() + row * W));
            for (int64_t e = linear.first[row]; e < linear.first[row + 1]; ++e)
                rising = fma(absolute(linear.at.at[e].weight), absolute(newest(linear.at.at[e].left)), rising);
            for (int64_t s = products.first[row]; s < products.first[row + 1]; ++s)
                rising = rising + products.sum_of_sizes(products.segments[s], newest);
            total = fma(absolute(x[block[row]]), rising, total);
        }
        double result = sum_of_lanes(total);
        for (const int64_t k : invariants[a].terms) result += monomials_of(k, reinterpret_cast<const double*>(x));
        return result;
    }

  private:
    INLINE Row gradient(int64_t row) const { return load<Row>(gradients.at + row * W); }

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

    // Construct the rows of invariant i.
    void lay_out(int64_t i, int64_t n) {
        InvariantGradient<double> gradient(watch, constants, i);
        Invariant found{int64_t(block.size()), 0, gradient.constant, gradient.terms};
        bounded &= found.terms.empty();
        if (n <= MOST_HELD * W)
            for (int64_t b = 0; b < n; b += W) gradient.linear[b];  // every block has a row of every invariant
        std::map<size_t, double> second_derivative;
        for (auto it = gradient.linear.begin(); it != gradient.linear.end();) {
            const int64_t b = it->first / W;
            bool diagonal;
            const std::vector<SparseSum> lanes = gradient.template block<W>(b * W, diagonal);
            std::vector<typename ProductRows<W>::Sum> longer(W);
            offsets.resize((block.size() + 1) * W, 0.0);
            there.resize((block.size() + 1) * W, false);
            for (; it != gradient.linear.end() && it->first / W == b; ++it) {
                const int64_t lane = it->first % W, at = int64_t(block.size()) * W + lane;
                offsets[at] = gradient.offset_of(it->first);
                there[at] = true;
                second_derivative[0] = larger(second_derivative[0], sum_of_sizes(lanes[lane]));
                if (!gradient.products.empty()) longer[lane].swap(gradient.products[it->first]);
                for (const auto& [factors, some] : longer[lane]) {
                    double all = 0.0;
                    for (const auto& [product, weight] : some) all += double(factors) * std::fabs(weight);
                    second_derivative[factors - 1] = larger(second_derivative[factors - 1], all);
                }
            }
            diagonal_vectors.push_back(diagonal);
            linear.add(lanes), products.add(longer, b * W);
            block.push_back(b);
        }
        for (const int64_t k : found.terms)
            for (uint32_t row = watch.terms.row[k]; row < watch.terms.row[k + 1]; ++row)
                for (size_t r = found.first; r < block.size(); ++r)
                    if (block[r] == watch.terms.target[row] / W)
                        position[row] = int64_t(r) * W + watch.terms.target[row] % W;
        quadratic &= second_derivative.size() <= 1;
        second_derivatives.emplace_back(second_derivative.begin(), second_derivative.end());
        found.last = int64_t(block.size());
        invariants.push_back(found);
    }

    void couple(const SparseFactors& factors) {
        for (const auto& list : users)
            for (size_t p = 0; p < list.size(); ++p)
                for (size_t q = p + 1; q < list.size(); ++q)
                    if (meet(list[p].second, list[q].second))
                        pairs.push_back(
                            {factors.position.at({list[q].first, list[p].first}), list[p].second, list[q].second});
        std::stable_sort(pairs.begin(), pairs.end(), [](const Pair& a, const Pair& b) { return a.target < b.target; });
    }

    // Return the value of a polynomial of a higher degree, and add its gradient, by the products before and after each
    // factor.
    template <bool with_gradient>
    NOINLINE double further(int64_t k, const Row* from, double* slopes) {
        const Terms& terms = watch.terms;
        const double* x = reinterpret_cast<const double*>(from);
        double total = 0.0;
        for (uint32_t monomial = terms.monomial[k]; monomial < terms.monomial[k + 1]; ++monomial) {
            const uint32_t low = terms.factor[monomial], high = terms.factor[monomial + 1];
            double product = constants.template number_at<double>(terms.coefficient, monomial), behind = 1.0;
            for (uint32_t f = low; f < high; ++f) {
                before[f - low] = product;
                product *= power(x[terms.target[terms.factor_row[f]]], terms.exponent[f]);
            }
            total += product;
            for (uint32_t f = high; with_gradient && f-- > low;) {
                const double y = x[terms.target[terms.factor_row[f]]], rest = power(y, terms.exponent[f] - 1);
                slopes[position[terms.factor_row[f]]] +=
                    (before[f - low] * behind) * (double(terms.exponent[f]) * rest);
                behind *= rest * y;
            }
        }
        return total;
    }

    std::vector<bool> there;  // whether a lane of a row is a coordinate of its invariant
};

}  // namespace coadjoint
