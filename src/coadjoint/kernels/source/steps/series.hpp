// The Taylor series of a motion with a polynomial field: x_(k+1) = h / (k + 1) * (the k-th coefficient of the field).
#pragma once

#include <utility>

#include "steps/series_field.hpp"

namespace coadjoint {

// Up to this order every sum is unrolled, to avoid branch mispredictions at the end of loops. Instrumented builds,
// which would take an hour, unroll fewer.
#ifndef COADJOINT_UNROLLED
#define COADJOINT_UNROLLED 24
#endif
// Rows of several vectors have several times the statements, which would take minutes to compile.
template <int W>
constexpr int UNROLLED = W <= NATIVE ? COADJOINT_UNROLLED : std::min(COADJOINT_UNROLLED, 8);

template <int W>
struct Series {
    typedef Lanes<W> Row;
    const SeriesField<W> field;
    const int64_t order;
    AlignedArray<Row> x, u;  // coefficients of x, order by order; of the gradient, the newest
    // Coefficients of both factors of a product.
    struct Factors {
        Row left, right;
    };
    AlignedArray<Factors> factors, made;  // of every product, one after the other, and of those behind the coordinates
    AlignedArray<Row> later, made_later;  // known contributions to the next order

    template <class C>
    Series(const Field& system_field, const C& constants, int64_t order)
        : field(system_field, constants, order), order(order), x((order + 1) * field.extended), u(field.blocks),
          factors(field.products.size() * order), made(field.factors.size() * order), later(2 * field.blocks),
          made_later(2 * field.factors.blocks) {}

    // Approximate number of multiplications of the coefficients.
    int64_t work() const {
        const int64_t entries = field.gradient.size() + field.linear.size();
        return order * W * (entries + order * int64_t(field.products.size() + field.factors.size()));
    }

    // Set the coefficients x_1 h, ..., x_p h^p of the motion from x_0. Defined in series.cpp, since its
    // cases take long to compile.
    void expand(double h);

    // x_1 h + ... + x_p h^p of one block of rows: four sums, each from its smallest terms.
    INLINE Row increment(int64_t block) const {
        return every_fourth(block, 1) + (every_fourth(block, 2) + (every_fourth(block, 3) + every_fourth(block, 4)));
    }

  private:
    // Sums over products that every coefficient needs: in registers for E of them, else in memory.
    static constexpr int register_count(int count) { return count <= 4 ? count : 0; }
    template <int E, class = void>
    struct ProductCache {
        typename Sums<W>::Vector products[E];
        Factors firsts[E];
        Row scaled[E];
        INLINE ProductCache(const Sums<W>& table, const Factors*, int64_t) {
            for (int e = 0; e < E; ++e) products[e] = table.at.at[e];
        }
        INLINE const auto& product(int64_t e) const { return products[e]; }
        INLINE const Factors& first(int64_t e) const { return firsts[e]; }
        INLINE const Row& weighted(int64_t e) const { return scaled[e]; }
        INLINE void begin(int64_t e, const Factors& now) { firsts[e] = now, scaled[e] = products[e].weight * now.right; }
    };
    template <class Any>
    struct ProductCache<0, Any> {
        const Sums<W>& table;
        const Factors* factors;
        const int64_t order;
        INLINE ProductCache(const Sums<W>& table, const Factors* factors, int64_t order)
            : table(table), factors(factors), order(order) {}
        INLINE const auto& product(int64_t e) const { return table.at.at[e]; }
        INLINE const Factors& first(int64_t e) const { return factors[e * order]; }
        INLINE Row weighted(int64_t e) const { return product(e).weight * first(e).right; }
        INLINE void begin(int64_t, const Factors&) {}
    };

    INLINE Row every_fourth(int64_t block, int64_t first) const {
        Row sum(0.0);
        for (int64_t k = first + (order - first + 4) / 4 * 4 - 4; k >= first; k -= 4)
            sum = sum + x.at[k * field.extended + block];
        return sum;
    }

    template <bool written_out>
    void expand_written(int64_t blocks, double h) {
        const int64_t most = field.products.size() == blocks * field.products.most ? field.products.most : 0;
        if (blocks == 1 && most == 1) return expand_unrolled<1, written_out, 1>(h);
        if (blocks == 1 && most == 2) return expand_unrolled<1, written_out, 2>(h);
        if (blocks == 1 && most == 3) return expand_unrolled<1, written_out, 3>(h);
        if (blocks == 1 && most == 4) return expand_unrolled<1, written_out, 4>(h);
        if constexpr (W == 8) {
            if (blocks == 2 && most == 2) return expand_unrolled<2, written_out, 2>(h);
            if (blocks == 3 && most == 2) return expand_unrolled<3, written_out, 2>(h);
            // Rows of any numbers of products.
            if (blocks == 1) return expand_unrolled<1, written_out, 0>(h);
            if (blocks == 2) return expand_unrolled<2, written_out, 0>(h);
            if (blocks == 3) return expand_unrolled<3, written_out, 0>(h);
        }
        ProductCache<0> cached(field.products, factors.at, order);
        Newest<0, W> newest(x.at);
        for (int64_t k = 0; k < order; ++k) coefficient<0, written_out, 0>(cached, newest, k, h);
    }

    // K: blocks of rows, E: products of each row; both are 0 if they are read from the tables.
    template <int K, bool written_out, int E>
    NOINLINE void expand_unrolled(double h) {
        ProductCache<register_count(K * E)> cached(field.products, factors.at, order);
        Newest<K, W> newest(x.at);
        first_coefficients<K, written_out, E>(cached, newest, h, std::make_integer_sequence<int, UNROLLED<W>>());
        for (int64_t k = UNROLLED<W>; k < order; ++k) coefficient<K, written_out, E>(cached, newest, k, h);
    }

    // One after the other, not by recursion, since the compiler would optimize the last ones in every level again.
    template <int K, bool written_out, int E, int... k>
    INLINE void first_coefficients(ProductCache<register_count(K * E)>& cached, Newest<K, W>& newest, double h,
                                   std::integer_sequence<int, k...>) {
        ((k < order && (coefficient<K, written_out, E>(cached, newest, k, h), true)) && ...);
    }

    // The sums of a_j b_(k - j) for the orders k (even) and k + 1, as far as coefficients before k go. Both orders are
    // summed together, since they read the same coefficients. The newest come last, so that the sums are nearly
    // complete when these are known. Each order has two independent sums.
    static INLINE void convolve(const Factors* f, int64_t k, Row* sums) {
        if (k < 2) return;
#pragma GCC unroll 32
        for (int64_t j = 2; j < k - 1; ++j) {
            sums[j % 2] = fma(f[j].left, f[k - j].right, sums[j % 2]);
            if (j > 2) sums[2 + j % 2] = fma(f[j].left, f[k + 1 - j].right, sums[2 + j % 2]);
        }
        sums[0] = fma(f[1].left, f[k - 1].right, sums[0]);
        if (k == 2) return;
        sums[1] = fma(f[k - 1].left, f[1].right, sums[1]);
        sums[2] = fma(f[2].left, f[k - 1].right, sums[2]);
        sums[3] = fma(f[k - 1].left, f[2].right, sums[3]);
    }

    // Add the remaining terms of coefficients before k for odd k, see `convolve`.
    static INLINE void add_left(const Factors* f, int64_t k, Row& even, Row& odd) {
        if (k % 2 == 0 || k == 1) return;
        even = fma(f[1].left, f[k - 1].right, even);
        odd = fma(f[k - 1].left, f[1].right, odd);
    }

    // Both sums of some products before the coefficients of order k are known.
    INLINE void begin(const Factors* f, int64_t count, int64_t k, Row* stored, Row& even, Row& odd) {
        if (k % 2 == 1) {
            even = stored[0], odd = stored[1];
        } else {
            Row sums[4] = {0.0, 0.0, 0.0, 0.0};
            for (int64_t e = 0; e < count; ++e) convolve(f + e * order, k, sums);
            even = sums[0], odd = sums[1], stored[0] = sums[2], stored[1] = sums[3];
        }
        for (int64_t e = 0; e < count; ++e) add_left(f + e * order, k, even, odd);
    }

    template <int K, bool written_out, int E>
    INLINE void coefficient(ProductCache<register_count(K * E)>& cached, Newest<K, W>& newest, int64_t k, double h) {
        const int64_t blocks = K ? K : field.blocks;
        Row *now = x.at + k * field.extended, *then = now + field.extended;
        if constexpr (K == 0) make_products(k, now);
        // In registers, since memory would delay the next order.
        Row slopes[K ? K : 1], next[K ? K : 1];
        if constexpr (!written_out) {
            const Sums<W>& sums = field.gradient;
#pragma GCC unroll 4
            for (int64_t b = 0; b < blocks; ++b) {
                Row even = k ? Row(0.0) : load<Row>(field.offsets.data() + b * W), odd(0.0);
                int64_t e = sums.first[b];
                for (; e + 1 < sums.first[b + 1]; e += 2) {
                    even = fma(sums.at.at[e].weight, newest(sums.at.at[e].left), even);
                    odd = fma(sums.at.at[e + 1].weight, newest(sums.at.at[e + 1].left), odd);
                }
                if (e < sums.first[b + 1]) even = fma(sums.at.at[e].weight, newest(sums.at.at[e].left), even);
                (K ? slopes : u.at)[b] = even + odd;
            }
        }
        const Newest<K, W> other = written_out ? newest : Newest<K, W>(K ? slopes : u.at);
        const Row length(h / double(k + 1));
#pragma GCC unroll 4
        for (int64_t b = 0; b < blocks; ++b) {
            const int64_t first = E ? E * b : field.products.first[b], count = E ? E : field.products.first[b + 1] - first;
            Factors* f = factors.at + first * order;
            Row even, odd;
            begin(f, count, k, later.at + 2 * b, even, odd);
            // The part independent of the newest coefficients is multiplied by the length beforehand.
            even = length * even, odd = length * odd;
            for (int64_t e = 0; e < count; ++e, f += order) {
                const Row y = newest(cached.product(first + e).left), z = other(cached.product(first + e).right);
                const Factors now{cached.product(first + e).weight * y, z};
                f[k] = now;
                if (k == 0) cached.begin(first + e, now);
                if (k > 0) odd = fma(y, length * cached.weighted(first + e), odd);
                even = fma(length * cached.first(first + e).left, z, even);
            }
            if constexpr (written_out)
                for (int64_t e = field.linear.first[b]; e < field.linear.first[b + 1]; ++e)
                    odd = fma(length * field.linear.at.at[e].weight, newest(field.linear.at.at[e].left), odd);
            then[b] = even + odd;
            if constexpr (K > 0) next[b] = then[b];
        }
        newest = Newest<K, W>(K ? next : then);
    }

    // The k-th coefficients of the products behind the coordinates; each is one product.
    void make_products(int64_t k, Row* now) {
        const double* from = reinterpret_cast<const double*>(now);
        for (int64_t b = 0; b < field.factors.blocks; ++b) {
            const auto& product = field.factors.at.at[b];
            Factors* f = made.at + b * order;
            Row even, odd;
            begin(f, 1, k, made_later.at + 2 * b, even, odd);
            f[k].left = take<W>(from, product.left), f[k].right = take<W>(from, product.right);
            even = fma(f[0].left, f[k].right, even);
            if (k > 0) odd = fma(f[k].left, f[0].right, odd);
            now[field.blocks + b] = even + odd;
        }
    }
};

}  // namespace coadjoint
