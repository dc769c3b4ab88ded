// Sparse sums of products of several coordinates, the rows in blocks of W.
#pragma once

#include <deque>
#include <map>

#include "field/row_lanes.hpp"
#include "steps/factored_products.hpp"

namespace coadjoint {

// Every block of rows has segments. The products of a segment have the same number of factors. Shorter rows of a block
// are padded with products of weight zero. Products of three or more factors may be factored: the rows are then sums of
// products of a coordinate and one of a few sums, which fit in registers.
template <int W>
struct ProductRows {
    typedef Lanes<W> Row;
    typedef std::map<size_t, SumOfProducts> Sum;  // by the number of factors
    static constexpr int MOST_INNER = W == 8 ? 2 : 1;   // vectors of sums
    static constexpr int64_t MOST_FACTORED = 256;       // products of a row, since factoring more of them takes long
    struct Segment {
        int64_t factors, count;
        const Row* weight;
        const Positions<W>* position;
        int64_t first_inner = 0, last_inner = 0, outer = 0;  // segments of the sums, and the rows; none if not factored
    };
    std::vector<Segment> segments, inner;
    Sums<W> outer;
    std::vector<int64_t> first{0};  // block b has the segments first[b] to first[b + 1]

    // Add rows of the coordinates from `low` on; some may be empty.
    void add(const std::vector<Sum>& rows, int64_t low) {
        std::map<size_t, std::vector<SumOfProducts>> found;
        for (int lane = 0; lane < W; ++lane)
            for (const auto& [factors, sum] : rows[lane]) {
                found[factors].resize(W);
                found[factors][lane] = sum;
            }
        for (const auto& [factors, sums] : found) {
            segments.push_back(segment(factors, sums.data(), W));
            if (factors > 2 && segments.back().count <= MOST_FACTORED) factor(segments.back(), sums, low);
        }
        first.push_back(int64_t(segments.size()));
    }

    // To be called after the last row.
    void finish() { outer.finish(); }

    // The sums of a segment.
    template <class Take>
    INLINE Row sum(const Segment& segment, const Take& newest) const {
        if (segment.last_inner == 0) return sum_of_products(segment, newest);
        Row sums[MOST_INNER], total(0.0);
        for (int i = 0; i < MOST_INNER; ++i)
            sums[i] = segment.first_inner + i < segment.last_inner
                          ? sum_of_products(inner[segment.first_inner + i], newest)
                          : Row(0.0);
        const Newest<MOST_INNER, W> found(sums);
        for (int64_t e = outer.first[segment.outer]; e < outer.first[segment.outer + 1]; ++e) {
            const auto& product = outer.at.at[e];
            total = fma(product.weight * newest(product.left), found(product.right), total);
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

    template <class Take>
    INLINE Row sum_of_products(const Segment& segment, const Take& newest) const {
        Row total(0.0);
        const Positions<W>* position = segment.position;
        for (int64_t e = 0; e < segment.count; ++e) {
            Row product = segment.weight[e];
            for (int64_t f = 1; f < segment.factors; ++f) product = product * newest(*position++);
            total = fma(product, newest(*position++), total);
        }
        return total;
    }

    // Up to W rows, whose products have the same number of factors.
    Segment segment(size_t factors, const SumOfProducts* rows, size_t size) {
        size_t count = 0;
        for (size_t lane = 0; lane < size; ++lane) count = std::max(count, rows[lane].size());
        weights.emplace_back(int64_t(count)), positions.emplace_back(int64_t(count * factors));
        for (size_t lane = 0; lane < size; ++lane) {
            size_t e = 0;
            for (const auto& [product, weight] : rows[lane]) {
                weights.back().at[e].set(int(lane), weight);
                for (size_t f = 0; f < factors; ++f) positions.back().at[e * factors + f].lane[lane] = product[f];
                ++e;
            }
        }
        return {int64_t(factors), int64_t(count), weights.back().at, positions.back().at};
    }

    // Factor a segment where fewer numbers are taken then.
    void factor(Segment& plain, const std::vector<SumOfProducts>& rows, int64_t low) {
        std::vector<SumOfProducts> sums;
        std::vector<SparseSum> totals(W);
        std::map<SumOfProducts, int64_t> indices;
        for (int lane = 0; lane < W; ++lane) {
            for (const auto& [scale, coordinate, sum] : factored<double>(rows[lane], low + lane)) {
                const auto [place, fresh] = indices.insert({sum, int64_t(sums.size())});
                if (fresh) sums.push_back(sum);
                totals[lane].push_back({scale, coordinate, place->second});
            }
            if (sums.size() > size_t(MOST_INNER * W)) return;
        }
        const size_t size = sums.size();
        int64_t taken = 2 * Sums<W>::longest(totals, 0);
        const size_t begun = inner.size();
        for (size_t k = 0; k < size; k += W) {
            inner.push_back(segment(plain.factors - 1, sums.data() + k, std::min(size - k, size_t(W))));
            taken += inner.back().count * inner.back().factors;
        }
        if (taken >= plain.count * plain.factors) return inner.resize(begun);
        plain.first_inner = int64_t(begun), plain.last_inner = int64_t(inner.size()), plain.outer = outer.blocks;
        outer.add(totals);
    }
};

}  // namespace coadjoint
