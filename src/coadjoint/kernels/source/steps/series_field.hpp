// A polynomial field as sums of products of two series.
#pragma once

#include <map>

#include "field/field.hpp"
#include "field/row_lanes.hpp"
#include "steps/factored_products.hpp"

namespace coadjoint {

// Costs of a coefficient, relative to a product of two vectors of coefficients, measured with AVX-512 at order 12: of a
// vector of products, of one of the gradient, of factored products in registers or in memory, of each entry of the sums
// around them, and of their longer chains of dependent operations.
constexpr double PRODUCT_COST = 11.4, GRADIENT_COST = 2.9, FACTORED_COST = 6.0, ENTRY_COST = 2.5, CHAIN_COST = 10.0,
                 MEMORY_COST = 18.0;

// In vectors of V rows, where W rows are the vector of a processor whose registers are long enough,
//     x'_r = sum_e c_e x[left_e] y[right_e] + sum_e l_e x[left_e],
// where y is the gradient of H, or x itself if the products of a quadratic H are written out. Gradients of a higher
// degree are linear in further products of series, which are stored behind the coordinates, degree after degree.
// Products that are written out may be factored: x_j times a sum of coordinates is one product, and so is a product
// that several rows contain. The lanes are then those products, and the rows are sums of them.
template <int W>
struct SeriesField {
    static constexpr int V = W < NATIVE ? W : NATIVE;
    int64_t n, blocks;         // coordinates, and their vectors, which are padded to W
    int64_t extended;          // vectors of coordinates and of the products behind them, padded too
    bool written_out = false;  // whether y is x
    bool factored = false;     // whether the lanes of `products` are x[right_e] sum_e c_e x[left_e], see `outputs`
    Sums<V> products, linear, gradient, factors, outputs;
    std::vector<double> offsets;

    template <class C>
    NOINLINE SeriesField(const Field& field, const C& constants, int64_t order)
        : n(field.size), blocks(padded(n)), extended(blocks), offsets(blocks * V, 0.0), rows(blocks * V),
          gradients(blocks * V) {
        read_gradient(field.terms, constants);
        for (int64_t i = 0; i < n; ++i)
            for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q)
                rows[i].push_back({constants.template number_at<double>(field.constant, q), field.state[q],
                                   field.column[q]});
        for (auto* sums : {&rows, &gradients})
            for (SparseSum& row : *sums) merge(row);
        extended = padded(extended * V);
        std::vector<SparseSum> pairs(rows.size()), single(rows.size());
        if (extended == blocks && write_out(pairs, single)) {
            const double each = 0.5 * double(order) + 2.0;
            const double apart = each * vectors(rows) + vectors(gradients);
            written_out = each * vectors(pairs) + vectors(single) <= apart;
            if (fits(n)) write_factored(pairs);
        }
        if (!factored) products.add(written_out ? pairs : rows);
        if (written_out) linear.add(single);
        gradient.add(gradients);
        for (Sums<V>* sums : {&products, &linear, &gradient, &factors, &outputs}) sums->finish();
    }

    // The number of vectors of products whose factors are series.
    int64_t series_of_products() const { return factored ? products.blocks : products.size(); }

  private:
    std::vector<SparseSum> rows, gradients;
    std::map<std::vector<int64_t>, int64_t> known;  // a product of coordinates, and its index

    // Whether rows fit in registers: one of four numbers, or two of eight.
    static bool fits(int64_t rows) { return rows <= (W == 8 ? 2 * W : W); }
    static int64_t padded(int64_t rows) { return blocks_of<W>(rows) * (W / V); }

    // Counted in W, as on any processor, which would choose other products else.
    static double vectors(const std::vector<SparseSum>& sums) {
        double count = 0.0;
        for (size_t r = 0; r < sums.size(); r += W) count += double(Sums<W>::longest(sums, r));
        return count;
    }

    // Merge entries of the same series, and drop those that cancel.
    static void merge(SparseSum& row) {
        std::map<std::pair<int64_t, int64_t>, double> sums;
        for (const auto& entry : row) sums[{entry.left, entry.right}] += entry.weight;
        row.clear();
        for (const auto& [positions, weight] : sums)
            if (weight != 0.0) row.push_back({weight, positions.first, positions.second});
    }

    template <class C>
    void read_gradient(const Terms& terms, const C& constants) {
        for (int64_t k = 0; k < terms.size; ++k)
            if (terms.kind[k] == LINEAR)
                for (uint32_t row = terms.row[k]; row < terms.row[k + 1]; ++row) {
                    const uint32_t i = terms.target[row];
                    offsets[i] += constants.template number_at<double>(terms.offset, row);
                    for (uint32_t e = terms.entry[row]; e < terms.entry[row + 1]; ++e)
                        gradients[i].push_back({constants.template number_at<double>(terms.weight, e),
                                                int64_t(terms.column[e]), 0});
                }
        size_t longest = 0;
        each_derivative(terms, constants, [&](int64_t, double, const std::vector<int64_t>& rest) {
            longest = std::max(longest, rest.size());
        });
        // Products of few factors come first, so that those of more factors can be built from them.
        for (size_t count = 2; count <= longest; ++count) {
            std::vector<SparseSum> made;
            each_derivative(terms, constants, [&](int64_t, double, const std::vector<int64_t>& rest) {
                if (rest.size() < count) return;
                const std::vector<int64_t> some(rest.begin(), rest.begin() + int64_t(count));
                if (known.count(some)) return;
                const std::vector<int64_t> fewer(some.begin(), some.end() - 1);
                known[some] = extended * V + int64_t(made.size());
                made.push_back({{1.0, count == 2 ? fewer[0] : known.at(fewer), some.back()}});
            });
            factors.add(made);
            extended += blocks_of<V>(int64_t(made.size()));
        }
        each_derivative(terms, constants, [&](int64_t i, double weight, const std::vector<int64_t>& rest) {
            if (rest.empty())
                offsets[i] += weight;
            else
                gradients[i].push_back({weight, rest.size() == 1 ? rest[0] : known.at(rest), 0});
        });
    }

    // Visit d(monomial)/dx_i as a weight and the coordinates in its product, in order.
    template <class C, class Visit>
    static void each_derivative(const Terms& terms, const C& constants, Visit visit) {
        for (int64_t k = 0; k < terms.size; ++k) {
            if (terms.kind[k] != POLYNOMIAL) continue;
            for (uint32_t monomial = terms.monomial[k]; monomial < terms.monomial[k + 1]; ++monomial)
                for (uint32_t chosen = terms.factor[monomial]; chosen < terms.factor[monomial + 1]; ++chosen) {
                    std::vector<int64_t> rest;
                    for (uint32_t f = terms.factor[monomial]; f < terms.factor[monomial + 1]; ++f)
                        rest.insert(rest.end(), terms.exponent[f] - (f == chosen), terms.target[terms.factor_row[f]]);
                    std::sort(rest.begin(), rest.end());
                    const double weight = constants.template number_at<double>(terms.coefficient, monomial);
                    visit(terms.target[terms.factor_row[chosen]], weight * double(terms.exponent[chosen]), rest);
                }
        }
    }

    // Factor products where that is faster. The rows are then sums of products that have lanes of their own.
    void write_factored(const std::vector<SparseSum>& pairs) {
        std::vector<SparseSum> sums, totals(pairs.size());
        std::map<std::pair<int64_t, SumOfProducts>, int64_t> indices;  // of a coordinate and a sum
        for (size_t r = 0; r < pairs.size(); ++r) {
            SumOfProducts row;
            for (const auto& [weight, i, j] : pairs[r]) row[{i, j}] = weight;
            for (const auto& [scale, coordinate, sum] : coadjoint::factored(row)) {
                const auto [place, fresh] = indices.insert({{coordinate, sum}, int64_t(sums.size())});
                if (fresh) {
                    sums.emplace_back();
                    for (const auto& [other, weight] : sum) sums.back().push_back({weight, other[0], coordinate});
                }
                totals[r].push_back({scale, place->second, 0});
            }
        }
        const int64_t count = int64_t(sums.size());
        const double now = written_out ? PRODUCT_COST * vectors(pairs)
                                       : PRODUCT_COST * vectors(rows) + GRADIENT_COST * vectors(gradients);
        const double each = fits(count) ? FACTORED_COST : PRODUCT_COST, more = fits(count) ? 0.0 : MEMORY_COST;
        const double then = each * double(blocks_of<W>(count)) + ENTRY_COST * (vectors(sums) + vectors(totals)) +
                            CHAIN_COST + more;
        factored = then < now;
        if (!factored) return;
        written_out = true;
        products.add(sums), outputs.add(totals);
    }

    // Replace products with a gradient by products of coordinates; false if these are far more.
    bool write_out(std::vector<SparseSum>& pairs, std::vector<SparseSum>& single) const {
        size_t here = 0, there = 0;
        for (int64_t r = 0; r < n; ++r) {
            here += rows[r].size() + gradients[r].size();
            for (const auto& entry : rows[r]) there += gradients[entry.right].size();
        }
        if (there > 16 * here) return false;
        for (int64_t r = 0; r < n; ++r) {
            for (const auto& entry : rows[r]) {
                for (const auto& weighted : gradients[entry.right])
                    pairs[r].push_back({entry.weight * weighted.weight, std::min(entry.left, weighted.left),
                                        std::max(entry.left, weighted.left)});
                single[r].push_back({entry.weight * offsets[entry.right], entry.left, 0});
            }
            merge(pairs[r]), merge(single[r]);
        }
        return true;
    }
};

}  // namespace coadjoint
