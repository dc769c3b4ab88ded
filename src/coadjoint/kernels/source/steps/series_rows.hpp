// A polynomial field as sums of products of two series: of one member, or of members as lanes.
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
template <int W, class N>
struct SeriesRows {
    static constexpr int V = W < NATIVE ? W : NATIVE;
    typedef std::vector<SparseSumOf<N>> Rows;
    int64_t n, blocks;         // coordinates, and their vectors, which are padded to W
    int64_t extended;          // vectors of coordinates and of the products behind them, padded too
    bool written_out = false;  // whether y is x
    bool factored = false;     // whether `products` are x[right_e] sum_e c_e x[left_e], see `outputs`
    bool alike = true;         // whether all members have these rows; else they are of no use
    Rows products, linear, gradient, factors, outputs;
    std::vector<Stored<N>> offsets;

    template <class C>
    NOINLINE SeriesRows(const Field& field, const C& constants, int64_t order)
        : n(field.size), blocks(padded(n)), extended(blocks), products(blocks * V), gradient(blocks * V),
          offsets(blocks * V, N(0.0)) {
        read_gradient(field.terms, constants);
        for (int64_t i = 0; i < n; ++i)
            for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q)
                products[i].push_back({constants.template number_at<N>(field.constant, q), field.state[q],
                                       field.column[q]});
        for (Rows* rows : {&products, &gradient})
            for (auto& row : *rows) merge(row);
        extended = padded(extended * V);
        Rows pairs(products.size()), single(products.size());
        if (extended != blocks || !write_out(pairs, single)) return;
        const double each = 0.5 * double(order) + 2.0;
        const double apart = each * vectors(products) + vectors(gradient);
        written_out = each * vectors(pairs) + vectors(single) <= apart;
        if (fits(n)) write_factored(pairs);
        if (!written_out) return;
        linear.swap(single);
        if (!factored) products.swap(pairs);
    }

  private:
    std::map<std::vector<int64_t>, int64_t> known;  // a product of coordinates, and its index

    // Whether rows fit in registers: one of four numbers, or two of eight.
    static bool fits(int64_t rows) { return rows <= (W == 8 ? 2 * W : W); }
    static int64_t padded(int64_t rows) { return blocks_of<W>(rows) * (W / V); }

    // Counted in W, as on any processor, which would choose other products else.
    static double vectors(const Rows& sums) {
        double count = 0.0;
        for (size_t r = 0; r < sums.size(); r += W) count += double(Sums<W>::longest(sums, r));
        return count;
    }

    // Whether something holds for all members.
    template <class Mask>
    bool holds(const Mask& mask) {
        const bool everywhere = all(mask);
        alike &= everywhere || !any(mask);
        return everywhere;
    }

    // Merge entries of the same series, and drop those that cancel.
    void merge(SparseSumOf<N>& row) {
        std::map<std::pair<int64_t, int64_t>, Stored<N>> sums;
        for (const auto& entry : row) add<N>(sums[{entry.left, entry.right}], entry.weight);
        row.clear();
        for (const auto& [positions, weight] : sums)
            if (!holds(N(weight) == N(0.0))) row.push_back({weight, positions.first, positions.second});
    }

    template <class C>
    void read_gradient(const Terms& terms, const C& constants) {
        for (int64_t k = 0; k < terms.size; ++k)
            if (terms.kind[k] == LINEAR)
                for (uint32_t row = terms.row[k]; row < terms.row[k + 1]; ++row) {
                    const uint32_t i = terms.target[row];
                    add<N>(offsets[i], constants.template number_at<N>(terms.offset, row));
                    for (uint32_t e = terms.entry[row]; e < terms.entry[row + 1]; ++e)
                        gradient[i].push_back({constants.template number_at<N>(terms.weight, e),
                                                int64_t(terms.column[e]), 0});
                }
        size_t longest = 0;
        each_derivative(terms, constants, [&](int64_t, const N&, const std::vector<int64_t>& rest) {
            longest = std::max(longest, rest.size());
        });
        // Products of few factors come first, so that those of more factors can be built from them.
        for (size_t count = 2; count <= longest; ++count) {
            Rows made;
            each_derivative(terms, constants, [&](int64_t, const N&, const std::vector<int64_t>& rest) {
                if (rest.size() < count) return;
                const std::vector<int64_t> some(rest.begin(), rest.begin() + int64_t(count));
                if (known.count(some)) return;
                const std::vector<int64_t> fewer(some.begin(), some.end() - 1);
                known[some] = extended * V + int64_t(made.size());
                made.push_back({{N(1.0), count == 2 ? fewer[0] : known.at(fewer), some.back()}});
            });
            // Every degree begins with a vector of its own.
            made.resize(blocks_of<V>(int64_t(made.size())) * V);
            extended += int64_t(made.size()) / V;
            factors.insert(factors.end(), made.begin(), made.end());
        }
        each_derivative(terms, constants, [&](int64_t i, const N& weight, const std::vector<int64_t>& rest) {
            if (rest.empty())
                add<N>(offsets[i], weight);
            else
                gradient[i].push_back({weight, rest.size() == 1 ? rest[0] : known.at(rest), 0});
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
                    const N weight = constants.template number_at<N>(terms.coefficient, monomial);
                    visit(terms.target[terms.factor_row[chosen]], weight * N(double(terms.exponent[chosen])), rest);
                }
        }
    }

    // Factor products where that is faster. The rows are then sums of products that have lanes of their own.
    void write_factored(const Rows& pairs) {
        Rows sums, totals(pairs.size());
        std::vector<FactoredProduct<N>> found;
        for (size_t r = 0; r < pairs.size(); ++r) {
            SumOfProductsOf<N> row;
            for (const auto& [weight, i, j] : pairs[r]) row[{i, j}] = weight;
            for (auto& product : coadjoint::factored<N>(std::move(row))) {
                size_t place = 0;
                while (place < found.size() && !same(found[place], product)) ++place;
                totals[r].push_back({product.scale, int64_t(place), 0});
                if (place < found.size()) continue;
                sums.emplace_back();
                for (const auto& [other, weight] : product.sum)
                    sums.back().push_back({weight, other[0], product.coordinate});
                found.push_back(std::move(product));
            }
        }
        const int64_t count = int64_t(sums.size());
        const double now = PRODUCT_COST * vectors(written_out ? pairs : products) +
                           (written_out ? 0.0 : GRADIENT_COST * vectors(gradient));
        const double each = fits(count) ? FACTORED_COST : PRODUCT_COST, more = fits(count) ? 0.0 : MEMORY_COST;
        const double then = each * double(blocks_of<W>(count)) + ENTRY_COST * (vectors(sums) + vectors(totals)) +
                            CHAIN_COST + more;
        factored = then < now;
        if (!factored) return;
        written_out = true;
        products.swap(sums), outputs.swap(totals);
    }

    // Whether two products differ in their scale at most.
    bool same(const FactoredProduct<N>& one, const FactoredProduct<N>& other) {
        if (one.coordinate != other.coordinate || one.sum.size() != other.sum.size()) return false;
        for (auto a = one.sum.begin(), b = other.sum.begin(); a != one.sum.end(); ++a, ++b)
            if (a->first != b->first) return false;
        auto equal = N(0.0) == N(0.0);
        for (auto a = one.sum.begin(), b = other.sum.begin(); a != one.sum.end(); ++a, ++b)
            equal = equal & (N(a->second) == N(b->second));
        return holds(equal);
    }

    // Replace products with a gradient by products of coordinates; false if these are far more.
    bool write_out(Rows& pairs, Rows& single) {
        size_t here = 0, there = 0;
        for (int64_t r = 0; r < n; ++r) {
            here += products[r].size() + gradient[r].size();
            for (const auto& entry : products[r]) there += gradient[entry.right].size();
        }
        if (there > 16 * here) return false;
        for (int64_t r = 0; r < n; ++r) {
            for (const auto& entry : products[r]) {
                for (const auto& weighted : gradient[entry.right])
                    pairs[r].push_back({N(entry.weight) * N(weighted.weight), std::min(entry.left, weighted.left),
                                        std::max(entry.left, weighted.left)});
                single[r].push_back({N(entry.weight) * N(offsets[entry.right]), entry.left, 0});
            }
            merge(pairs[r]), merge(single[r]);
        }
        return true;
    }
};

}  // namespace coadjoint
