// The Taylor series of members as lanes, with the operations of `series.hpp`, row by row: the same bits.
#pragma once

#include "steps/series_rows.hpp"

namespace coadjoint {

// Every row of a series is a row of members; series are stored one after the other, order by order. The members have
// weights of their own.
template <int W, class A>
class SeriesLanes {
  public:
    static constexpr int V = SeriesRows<W, A>::V;
    const int64_t n, order;

    SeriesLanes(const SeriesRows<W, A>& rows, int64_t order)
        : n(rows.n), order(order), written_out(rows.written_out), factored(rows.factored), offsets(rows.offsets),
          positions(rows.extended * V, -1) {
        for (int64_t i = 0; i < n; ++i) positions[i] = i;
        int64_t count = n;
        for (size_t i = 0; i < rows.factors.size(); ++i)
            for (const auto& [weight, left, right] : rows.factors[i]) {
                positions[rows.blocks * V + int64_t(i)] = count++;
                made.push_back({series_of(left), series_of(right)});
            }
        const auto series_at = [this](int64_t position) { return series_of(position); };
        products.read(rows.products, series_at);
        gradients.read(rows.gradient, series_at);
        linear.read(rows.linear, series_at);
        outputs.read(rows.outputs, [](int64_t product) { return product; });
        series.clear(count * (order + 1));
        slopes.clear(written_out ? 0 : n * (order + 1));
        weighted.clear(series_of_products() * (order + 1));
        results.clear(series_of_products());
        later.clear(2 * std::max(n, series_of_products())), made_later.clear(2 * int64_t(made.size()));
        lengths.clear(order);
    }

    // Approximate number of multiplications of the coefficients of all members.
    int64_t work() const {
        int64_t entries = gradients.size() + linear.size();
        if (factored) entries += products.size() + outputs.size();
        return order * Numbers<A>::lanes * (entries + order * (series_of_products() + int64_t(made.size())));
    }

    // Approximate number of bytes that are read repeatedly.
    int64_t working_set() const {
        const int64_t slopes = written_out ? 0 : n;
        return int64_t(sizeof(A)) * order * (n + int64_t(made.size()) + series_of_products() + slopes);
    }

    // Set the coefficients x_1 h, ..., x_p h^p of the motions from x.
    void expand(const A* x, const A& h) {
        for (int64_t i = 0; i < n; ++i) of(i)[0] = x[i];
        if (order > 0 && !all(lengths.at[0] == h))
            for (int64_t k = 0; k < order; ++k) lengths.at[k] = h / A(double(k + 1));
        for (int64_t k = 0; k < order; ++k) {
            make_products(k);
            if (!written_out) take_slopes(k);
            if (factored)
                factored_coefficient(k, lengths.at[k]);
            else
                coefficient(k, lengths.at[k], written_out ? series.at : slopes.at);
        }
    }

    // x_1 h + ... + x_p h^p of one coordinate.
    INLINE A increment(int64_t i) const {
        return every_fourth(i, 1) + (every_fourth(i, 2) + (every_fourth(i, 3) + every_fourth(i, 4)));
    }

  private:
    // Where the series of two factors begin.
    struct Factors {
        int64_t left, right;
    };
    // Sparse sums, one row after the other.
    struct SumsOfMembers {
        std::vector<int64_t> first{0};
        std::vector<Factors> at;
        AlignedArray<A> weight{0};

        int64_t size() const { return int64_t(at.size()); }

        template <class At>
        void read(const typename SeriesRows<W, A>::Rows& rows, At place) {
            for (const auto& row : rows) {
                for (const auto& entry : row) at.push_back({place(entry.left), place(entry.right)});
                first.push_back(size());
            }
            weight.clear(size());
            A* to = weight.at;
            for (const auto& row : rows)
                for (const auto& entry : row) *to++ = entry.weight;
        }
    };
    const bool written_out, factored;
    const std::vector<Stored<A>> offsets;
    std::vector<int64_t> positions;  // indices of the rows of the field
    SumsOfMembers products, gradients, linear, outputs;
    std::vector<Factors> made;
    AlignedArray<A> series{0}, slopes{0}, weighted{0}, results{0}, later{0}, made_later{0}, lengths{0};

    INLINE A* of(int64_t i) const { return series.at + i * (order + 1); }
    int64_t series_of(int64_t position) const { return positions[position] * (order + 1); }

    // The number of products whose factors are series; factored ones are rows.
    int64_t series_of_products() const { return factored ? int64_t(products.first.size()) - 1 : products.size(); }

    INLINE A every_fourth(int64_t i, int64_t first) const {
        A sum(0.0);
        for (int64_t k = first + (order - first + 4) / 4 * 4 - 4; k >= first; k -= 4) sum = sum + of(i)[k];
        return sum;
    }

    // As `Series::convolve`, for even k.
    static INLINE void convolve(const A* left, const A* right, int64_t k, A* sums) {
        if (k < 2) return;
        A a = sums[0], b = sums[1], c = sums[2], d = sums[3];
        if (k > 3) a = fma(left[2], right[k - 2], a);
        for (int64_t j = 3; j < k - 2; j += 2) {
            b = fma(left[j], right[k - j], b);
            d = fma(left[j], right[k + 1 - j], d);
            a = fma(left[j + 1], right[k - 1 - j], a);
            c = fma(left[j + 1], right[k - j], c);
        }
        sums[0] = fma(left[1], right[k - 1], a), sums[1] = b, sums[2] = c, sums[3] = d;
        if (k == 2) return;
        sums[1] = fma(left[k - 1], right[1], b);
        sums[2] = fma(left[2], right[k - 1], c);
        sums[3] = fma(left[k - 1], right[2], d);
    }

    static INLINE void add_left(const A* left, const A* right, int64_t k, A& even, A& odd) {
        if (k % 2 == 0 || k == 1) return;
        even = fma(left[1], right[k - 1], even);
        odd = fma(left[k - 1], right[1], odd);
    }

    // As `Series::begin`; `left(e)` and `right(e)` are the factors of a product.
    template <class Left, class Right>
    INLINE void begin(int64_t first, int64_t last, int64_t k, A* stored, A& even, A& odd, Left left,
                      Right right) const {
        if (k % 2 == 1) {
            even = stored[0], odd = stored[1];
        } else {
            A sums[4] = {A(0.0), A(0.0), A(0.0), A(0.0)};
            for (int64_t e = first; e < last; ++e) convolve(left(e), right(e), k, sums);
            even = sums[0], odd = sums[1], stored[0] = sums[2], stored[1] = sums[3];
        }
        for (int64_t e = first; e < last; ++e) add_left(left(e), right(e), k, even, odd);
    }

    NOINLINE void coefficient(int64_t k, const A& length, const A* others) {
        for (int64_t i = 0; i < n; ++i) {
            const int64_t first = products.first[i], last = products.first[i + 1];
            A even, odd;
            begin(first, last, k, later.at + 2 * i, even, odd, [&](int64_t e) { return weighted.at + e * (order + 1); },
                  [&](int64_t e) { return others + products.at[e].right; });
            even = length * even, odd = length * odd;
            for (int64_t e = first; e < last; ++e) {
                const A* const right = others + products.at[e].right;
                const A y = series.at[products.at[e].left + k], z = right[k];
                const A weight = products.weight.at[e];
                A* const from = weighted.at + e * (order + 1);
                from[k] = weight * y;
                if (k > 0) odd = fma(y, length * (weight * right[0]), odd);
                even = fma(length * from[0], z, even);
            }
            if (written_out)
                for (int64_t e = linear.first[i]; e < linear.first[i + 1]; ++e)
                    odd = fma(length * linear.weight.at[e], series.at[linear.at[e].left + k], odd);
            of(i)[k + 1] = even + odd;
        }
    }

    NOINLINE void factored_coefficient(int64_t k, const A& length) {
        for (int64_t p = 0; p < series_of_products(); ++p) {
            const int64_t first = products.first[p], last = products.first[p + 1];
            const A* const left = series.at + products.at[first].right;
            A* const right = weighted.at + p * (order + 1);
            A even, odd;
            begin(first, first + 1, k, later.at + 2 * p, even, odd, [&](int64_t) { return left; },
                  [&](int64_t) { return right; });
            A now = products.weight.at[first] * series.at[products.at[first].left + k];
            for (int64_t e = first + 1; e < last; ++e)
                now = fma(products.weight.at[e], series.at[products.at[e].left + k], now);
            right[k] = now;
            A sum = length * (even + odd);
            if (k > 0) sum = fma(length * right[0], left[k], sum);
            results.at[p] = fma(length * left[0], now, sum);
        }
        for (int64_t i = 0; i < n; ++i) {
            A sum(0.0);
            for (int64_t e = linear.first[i]; e < linear.first[i + 1]; ++e)
                sum = fma(length * linear.weight.at[e], series.at[linear.at[e].left + k], sum);
            for (int64_t e = outputs.first[i]; e < outputs.first[i + 1]; ++e)
                sum = fma(outputs.weight.at[e], results.at[outputs.at[e].left], sum);
            of(i)[k + 1] = sum;
        }
    }

    INLINE void take_slopes(int64_t k) {
        for (int64_t i = 0; i < n; ++i) {
            A even = k ? A(0.0) : A(offsets[i]), odd(0.0);
            int64_t e = gradients.first[i];
            for (; e + 1 < gradients.first[i + 1]; e += 2) {
                even = fma(gradients.weight.at[e], series.at[gradients.at[e].left + k], even);
                odd = fma(gradients.weight.at[e + 1], series.at[gradients.at[e + 1].left + k], odd);
            }
            if (e < gradients.first[i + 1]) even = fma(gradients.weight.at[e], series.at[gradients.at[e].left + k], even);
            slopes.at[i * (order + 1) + k] = even + odd;
        }
    }

    INLINE void make_products(int64_t k) {
        for (int64_t p = 0; p < int64_t(made.size()); ++p) {
            const A *left = series.at + made[p].left, *right = series.at + made[p].right;
            A even, odd;
            begin(0, 1, k, made_later.at + 2 * p, even, odd, [&](int64_t) { return left; },
                  [&](int64_t) { return right; });
            even = fma(left[0], right[k], even);
            if (k > 0) odd = fma(left[k], right[0], odd);
            of(n + p)[k] = even + odd;
        }
    }
};

}  // namespace coadjoint
