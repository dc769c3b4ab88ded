// Sparse sums of products of several coordinates, the rows in blocks of W.
#pragma once

#include <deque>
#include <map>

#include "field/row_lanes.hpp"

namespace coadjoint {

// weight x[factors[0]] x[factors[1]] ...
struct WeightedProduct {
    double weight;
    std::vector<int64_t> factors;
};
typedef std::map<size_t, std::vector<WeightedProduct>> SumOfProducts;  // by the number of factors

// Every block of rows has segments. The products of a segment have the same number of factors. Shorter rows of a block
// are padded with products of weight zero.
template <int W>
struct ProductRows {
    typedef Lanes<W> Row;
    struct Segment {
        int64_t factors, count;
        const Row* weight;
        const Positions<W>* position;
    };
    std::vector<Segment> segments;
    std::vector<int64_t> first{0};  // block b has the segments first[b] to first[b + 1]

    // Add W rows; some may be empty.
    void add(const std::vector<SumOfProducts>& rows) {
        std::map<size_t, size_t> longest;
        for (const auto& row : rows)
            for (const auto& [factors, products] : row) longest[factors] = std::max(longest[factors], products.size());
        for (const auto& [factors, count] : longest) {
            weights.emplace_back(int64_t(count)), positions.emplace_back(int64_t(count * factors));
            for (size_t e = 0; e < count; ++e)
                for (int lane = 0; lane < W; ++lane) {
                    const auto found = rows[lane].find(factors);
                    const bool there = found != rows[lane].end() && e < found->second.size();
                    weights.back().at[e].set(lane, there ? found->second[e].weight : 0.0);
                    for (size_t f = 0; f < factors; ++f)
                        positions.back().at[e * factors + f].lane[lane] = there ? found->second[e].factors[f] : 0;
                }
            segments.push_back({int64_t(factors), int64_t(count), weights.back().at, positions.back().at});
        }
        first.push_back(int64_t(segments.size()));
    }

    // The sums of a segment.
    template <class Take>
    INLINE Row sum(const Segment& segment, const Take& newest) const {
        Row total(0.0);
        const Positions<W>* position = segment.position;
        for (int64_t e = 0; e < segment.count; ++e) {
            Row product = segment.weight[e];
            for (int64_t f = 1; f < segment.factors; ++f) product = product * newest(*position++);
            total = fma(product, newest(*position++), total);
        }
        return total;
    }

    // The sums of the absolute values of the products.
    template <class Take>
    Row sum_of_sizes(const Segment& segment, const Take& newest) const {
        Row total(0.0);
        for (int64_t e = 0; e < segment.count; ++e) {
            Row product = segment.weight[e];
            for (int64_t f = 0; f < segment.factors; ++f)
                product = product * newest(segment.position[e * segment.factors + f]);
            total = total + absolute(product);
        }
        return total;
    }

  private:
    std::deque<AlignedArray<Row>> weights;
    std::deque<AlignedArray<Positions<W>>> positions;
};

}  // namespace coadjoint
