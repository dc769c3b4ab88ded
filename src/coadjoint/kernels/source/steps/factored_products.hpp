// Sums of products of coordinates, written as fewer products: of a coordinate and a sum that may occur more than once.
#pragma once

#include <algorithm>
#include <map>
#include <vector>

#include "field/row_lanes.hpp"

namespace coadjoint {

// The coordinates of a product in order, and its weight: a number of one member, or of members as lanes.
template <class N>
using SumOfProductsOf = std::map<std::vector<int64_t>, Stored<N>>;
typedef SumOfProductsOf<double> SumOfProducts;

// scale x[coordinate] sum
template <class N>
struct FactoredProduct {
    Stored<N> scale;
    int64_t coordinate;
    SumOfProductsOf<N> sum;
};

// The first weight of a sum without its digits, unless others would lose some of theirs in a division by it.
template <class N>
N scale_of(const SumOfProductsOf<N>& sum) {
    const N first = sum.begin()->second;
    if (sum.size() == 1) return first;
    const N power = leading_power(first), scale = select(first < N(0.0), -power, power);
    auto exact = first == first;
    for (const auto& [factors, stored] : sum) {
        const N weight = stored;
        exact = exact & (weight / scale * scale == weight);
    }
    return select(exact, scale, N(1.0));
}

// Divide products by the coordinate that most of them contain, until none is left; of several, by another one than
// `avoided`. Sums are scaled so that more of them are equal, by powers of two, so that nothing is rounded.
template <class N>
std::vector<FactoredProduct<N>> factored(SumOfProductsOf<N> left, int64_t avoided = -1) {
    std::vector<FactoredProduct<N>> found;
    while (!left.empty()) {
        std::map<int64_t, int64_t> counts;
        for (const auto& [factors, weight] : left)
            for (size_t f = 0; f < factors.size(); ++f) counts[factors[f]] += f == 0 || factors[f] != factors[f - 1];
        int64_t common = counts.begin()->first;
        for (const auto& [i, count] : counts)
            if (count > counts[common] || (count == counts[common] && common == avoided)) common = i;
        FactoredProduct<N> product{N(1.0), common, {}};
        for (auto it = left.begin(); it != left.end();) {
            const auto place = std::find(it->first.begin(), it->first.end(), common);
            if (place == it->first.end()) {
                ++it;
                continue;
            }
            std::vector<int64_t> rest(it->first.begin(), place);
            rest.insert(rest.end(), place + 1, it->first.end());
            product.sum[std::move(rest)] = it->second;
            it = left.erase(it);
        }
        product.scale = scale_of<N>(product.sum);
        for (auto& [factors, weight] : product.sum) weight = N(weight) / N(product.scale);
        found.push_back(std::move(product));
    }
    return found;
}

}  // namespace coadjoint
