// Sparse sums of products of several coordinates, the rows in blocks of W: of one member, or of members as lanes.
#pragma once

#include <deque>
#include <map>

#include "field/row_lanes.hpp"
#include "steps/factored_products.hpp"

namespace coadjoint {

// Every block of rows has segments. The products of a segment have the same number of factors. Shorter rows of a block
// are padded with products of weight zero. Products of three or more factors may be factored: the rows are then sums of
// products of a coordinate and one of a few sums, which fit in registers.
template <int W, class N = double>
struct ProductRows {
    static constexpr bool one_member = std::is_same_v<N, double>;
    typedef Lanes<W> Row;
    typedef std::conditional_t<one_member, Row, N> Weight;  // of members as lanes, each row has weights of its own
    typedef std::map<size_t, SumOfProductsOf<N>> Sum;       // by the number of factors
    static constexpr int MOST_INNER = W == 8 ? 2 : 1;   // vectors of sums
    static constexpr int64_t MOST_FACTORED = 256;       // products of a row, since factoring more of them takes long
    struct Segment {
        int64_t factors, count;
        const Weight* weight;
        const Positions<W>* position;
        int64_t first_inner = 0, last_inner = 0, outer = 0;  // segments of the sums, and the rows; none if not factored
    };
    std::vector<Segment> segments, inner;
    Sums<W> outer;
    std::vector<std::vector<SparseSumOf<N>>> totals;  // in place of `outer`, of members as lanes
    std::vector<int64_t> first{0};                    // block b has the segments first[b] to first[b + 1]
    bool alike = true;                                // whether all members have these rows; else they are of no use

    // Add rows of the coordinates from `low` on; some may be empty.
    void add(const std::vector<Sum>& rows, int64_t low) {
        std::map<size_t, std::vector<SumOfProductsOf<N>>> found;
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

    // Of members as lanes: add the sums of a segment to gradients, and their parts to twice the values.
    NOINLINE void add_sums(const Segment& segment, int64_t n, const N* x, N* gradient, N* whole) const {
        N sums[MOST_INNER * W];
        for (int64_t i = segment.first_inner; i < segment.last_inner; ++i)
            for (int r = 0; r < W; ++r) sums[(i - segment.first_inner) * W + r] = sum_in_row(inner[i], r, x);
        const N share(2.0 / double(segment.factors + 1));
        for (int64_t c = 0; c < n; ++c) {
            N more(0.0);
            if (segment.last_inner == 0)
                more = sum_in_row(segment, int(c), x);
            else
                for (const auto& product : totals[segment.outer][c])
                    more = fma(N(product.weight) * x[product.left], sums[product.right], more);
            gradient[c] = gradient[c] + more;
            whole[c] = fma(share, more, whole[c]);
        }
    }

    // Of members as lanes: the sum of the absolute values of the products of a row.
    N sizes_in_row(const Segment& segment, int row, const N* x) const {
        N total(0.0);
        for (int64_t e = 0; e < segment.count; ++e) {
            N product = segment.weight[e * W + row];
            for (int64_t f = 0; f < segment.factors; ++f)
                product = product * x[segment.position[e * segment.factors + f].lane[row]];
            total = total + absolute(product);
        }
        return total;
    }

  private:
    std::deque<AlignedArray<Weight>> weights;
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

    INLINE N sum_in_row(const Segment& segment, int row, const N* x) const {
        N total(0.0);
        for (int64_t e = 0; e < segment.count; ++e) {
            const Positions<W>* const position = segment.position + e * segment.factors;
            N product = segment.weight[e * W + row];
            for (int64_t f = 0; f + 1 < segment.factors; ++f) product = product * x[position[f].lane[row]];
            total = fma(product, x[position[segment.factors - 1].lane[row]], total);
        }
        return total;
    }

    // Up to W rows, whose products have the same number of factors.
    Segment segment(size_t factors, const SumOfProductsOf<N>* rows, size_t size) {
        size_t count = 0;
        for (size_t lane = 0; lane < size; ++lane) count = std::max(count, rows[lane].size());
        weights.emplace_back(int64_t(count) * (one_member ? 1 : W)), positions.emplace_back(int64_t(count * factors));
        for (size_t lane = 0; lane < size; ++lane) {
            size_t e = 0;
            for (const auto& [product, weight] : rows[lane]) {
                if constexpr (one_member)
                    weights.back().at[e].set(int(lane), weight);
                else
                    weights.back().at[e * W + lane] = weight;
                for (size_t f = 0; f < factors; ++f) positions.back().at[e * factors + f].lane[lane] = product[f];
                ++e;
            }
        }
        return {int64_t(factors), int64_t(count), weights.back().at, positions.back().at};
    }

    // Factor a segment where fewer numbers are taken then.
    void factor(Segment& plain, const std::vector<SumOfProductsOf<N>>& rows, int64_t low) {
        std::vector<SumOfProductsOf<N>> sums;
        std::vector<SparseSumOf<N>> found(W);
        for (int lane = 0; lane < W; ++lane) {
            for (const auto& [scale, coordinate, sum] : factored<N>(rows[lane], low + lane)) {
                size_t place = 0;
                while (place < sums.size() && !same(sums[place], sum)) ++place;
                if (place == sums.size()) sums.push_back(sum);
                found[lane].push_back({scale, coordinate, int64_t(place)});
            }
            if (sums.size() > size_t(MOST_INNER * W)) return;
        }
        const size_t size = sums.size();
        const int64_t longest = Sums<W>::longest(found, 0);
        int64_t taken = 2 * longest;
        const size_t begun = inner.size();
        for (size_t k = 0; k < size; k += W) {
            inner.push_back(segment(plain.factors - 1, sums.data() + k, std::min(size - k, size_t(W))));
            taken += inner.back().count * inner.back().factors;
        }
        if (taken >= plain.count * plain.factors) return inner.resize(begun);
        plain.first_inner = int64_t(begun), plain.last_inner = int64_t(inner.size());
        if constexpr (one_member) {
            plain.outer = outer.blocks;
            outer.add(found);
        } else {
            plain.outer = int64_t(totals.size());
            for (auto& row : found) row.resize(longest, EntryOf<N>{N(0.0), 0, 0});
            totals.push_back(found);
        }
    }

    // Whether two sums are equal, for all members.
    bool same(const SumOfProductsOf<N>& one, const SumOfProductsOf<N>& other) {
        if (one.size() != other.size()) return false;
        for (auto a = one.begin(), b = other.begin(); a != one.end(); ++a, ++b)
            if (a->first != b->first) return false;
        if constexpr (one_member) {
            return one == other;
        } else {
            auto equal = N(0.0) == N(0.0);
            for (auto a = one.begin(), b = other.begin(); a != one.end(); ++a, ++b)
                equal = equal & (N(a->second) == N(b->second));
            alike &= all(equal) || !any(equal);
            return all(equal);
        }
    }
};

}  // namespace coadjoint
