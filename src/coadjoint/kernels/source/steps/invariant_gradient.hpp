// The gradient of a polynomial invariant: of one member, or of members as lanes.
#pragma once

#include "field/row_lanes.hpp"
#include "recording/watching.hpp"
#include "steps/factored_products.hpp"

namespace coadjoint {

constexpr uint32_t MOST_FACTORS = 8;  // products of more factors are not written out

// The sum of the sizes of the weights.
template <class N>
N sum_of_sizes(const SparseSumOf<N>& row) {
    N total(0.0);
    for (const auto& entry : row) total = total + absolute(N(entry.weight));
    return total;
}

// Sums of coordinates and of products of coordinates, by the component of the gradient; products by their number of
// factors too. The components of `terms` are not written out, since their products have too many factors.
template <class N>
struct InvariantGradient {
    N constant;
    std::map<int64_t, SparseSumOf<N>> linear;
    std::map<int64_t, std::map<size_t, SumOfProductsOf<N>>> products;
    std::map<int64_t, Stored<N>> offset;
    std::vector<int64_t> terms;

    // The gradient of invariant i.
    template <class C>
    InvariantGradient(const Watch& watch, const C& constants, int64_t i)
        : constant(constants.template number_at<N>(watch.constant, i)) {
        for (uint32_t k = watch.first[i]; k < watch.first[i + 1]; ++k) read(watch.terms, constants, k);
    }

    N offset_of(int64_t i) const {
        const auto found = offset.find(i);
        return found == offset.end() ? N(0.0) : N(found->second);
    }

    // The linear sums of the W components from `low` on, all of one length, of which the component itself comes first if
    // it is in one of them: an entry of weight zero pads the others.
    template <int W>
    std::vector<SparseSumOf<N>> block(int64_t low, bool& diagonal) const {
        std::vector<SparseSumOf<N>> rows(W);
        diagonal = false;
        size_t longest = 0;
        for (auto it = linear.lower_bound(low); it != linear.end() && it->first < low + W; ++it) {
            SparseSumOf<N>& row = rows[it->first - low];
            for (const bool itself : {true, false})
                for (const auto& entry : it->second)
                    if ((entry.left == it->first) == itself) row.push_back(entry);
            diagonal |= !row.empty() && row.front().left == it->first;
        }
        for (int lane = 0; lane < W && diagonal; ++lane)
            if (SparseSumOf<N>& row = rows[lane]; row.empty() || row.front().left != low + lane)
                row.insert(row.begin(), EntryOf<N>{N(0.0), low + lane, 0});
        for (const auto& row : rows) longest = std::max(longest, row.size());
        for (auto& row : rows) row.resize(longest, EntryOf<N>{N(0.0), 0, 0});
        return rows;
    }

  private:
    // Add the gradient of a term, written out unless a product has too many factors.
    template <class C>
    void read(const Terms& terms, const C& constants, uint32_t k) {
        for (uint32_t row = terms.row[k]; row < terms.row[k + 1]; ++row) {
            SparseSumOf<N>& sum = linear[terms.target[row]];
            if (terms.kind[k] != LINEAR) continue;
            add<N>(offset[terms.target[row]], constants.template number_at<N>(terms.offset, row));
            for (uint32_t e = terms.entry[row]; e < terms.entry[row + 1]; ++e)
                sum.push_back({constants.template number_at<N>(terms.weight, e), int64_t(terms.column[e]), 0});
        }
        if (terms.kind[k] == LINEAR) return;
        std::vector<std::vector<int64_t>> monomials;
        for (uint32_t monomial = terms.monomial[k]; monomial < terms.monomial[k + 1]; ++monomial) {
            std::vector<int64_t> factors;
            for (uint32_t f = terms.factor[monomial]; f < terms.factor[monomial + 1]; ++f) {
                if (factors.size() + terms.exponent[f] > MOST_FACTORS) {
                    this->terms.push_back(k);
                    return;
                }
                factors.insert(factors.end(), terms.exponent[f], terms.target[terms.factor_row[f]]);
            }
            monomials.push_back(factors);
        }
        for (size_t m = 0; m < monomials.size(); ++m) {
            const N weight = constants.template number_at<N>(terms.coefficient, terms.monomial[k] + m);
            if (monomials[m].empty()) constant += weight;
            differentiate(monomials[m], weight);
        }
    }

    // Add the derivatives of a product; equal factors are adjacent.
    void differentiate(const std::vector<int64_t>& factors, const N& weight) {
        for (size_t f = 0, next; f < factors.size(); f = next) {
            const int64_t i = factors[f];
            for (next = f + 1; next < factors.size() && factors[next] == i;) ++next;
            std::vector<int64_t> rest = factors;
            rest.erase(rest.begin() + int64_t(f));
            const N times = weight * N(double(next - f));
            if (rest.empty())
                add<N>(offset[i], times);
            else if (rest.size() == 1)
                linear[i].push_back({times, rest[0], 0});
            else
                add<N>(products[i][rest.size()][rest], times);
        }
    }
};

}  // namespace coadjoint
