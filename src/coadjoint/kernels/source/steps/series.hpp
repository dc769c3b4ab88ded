// The Taylor series of a motion with a polynomial field: x_(k+1) = h / (k + 1) * (the k-th coefficient of the field).
#pragma once

#include <utility>

#include "steps/series_field.hpp"

namespace coadjoint {

// Up to this order, an even one, the sums of few rows are unrolled, to avoid branch mispredictions at the end of loops.
// Instrumented builds, which would take an hour, unroll fewer.
#ifndef COADJOINT_UNROLLED
#define COADJOINT_UNROLLED 24
#endif
// Computed in vectors of V rows, and read in vectors of W. A vector of W rows that needs several registers is slower than
// several vectors: registers of zeros are left out.
template <int W>
struct Series {
    static constexpr int V = SeriesField<W>::V;
    typedef Lanes<V> Row;
    const SeriesField<W> field;
    const int64_t order, blocks, stride;  // vectors of coordinates, and from one coefficient to the next
    AlignedArray<Lanes<W>> x;             // coefficients of x, order by order
    AlignedArray<Row> u;                  // of the gradient, the newest
    // Coefficients of both factors of a product.
    struct Factors {
        Row left, right;
    };
    AlignedArray<Factors> factors, made;  // of every product, one after the other, and of those behind the coordinates
    AlignedArray<Row> later, made_later;  // known contributions to the next order
    AlignedArray<Row> scaled;             // first factors on the right of every product, times its weight
    AlignedArray<Row> results;            // factored products, the newest

    template <class C>
    Series(const Field& system_field, const C& constants, int64_t order)
        : field(system_field, constants, order), order(order), blocks(blocks_of<W>(field.n)),
          stride(field.extended * V / W), x((order + 1) * stride), u(field.blocks),
          factors(field.series_of_products() * order), made(field.factors.size() * order),
          later(2 * std::max(field.blocks, field.products.blocks)), made_later(2 * field.factors.blocks),
          scaled(field.products.size()), results(field.products.blocks) {}

    // Approximate number of multiplications of the coefficients.
    int64_t work() const {
        int64_t entries = field.gradient.size() + field.linear.size();
        if (field.factored) entries += field.products.size() + field.outputs.size();
        return order * V * (entries + order * (field.series_of_products() + field.factors.size()));
    }

    // Set the coefficients x_1 h, ..., x_p h^p of the motion from x_0. Defined in series.cpp, since its
    // cases take long to compile.
    void expand(double h);

    // x_1 h + ... + x_p h^p of one block of rows: four sums, each from its smallest terms.
    INLINE Lanes<W> increment(int64_t block) const {
        return every_fourth(block, 1) + (every_fourth(block, 2) + (every_fourth(block, 3) + every_fourth(block, 4)));
    }

  private:
    INLINE double* numbers(int64_t k) const { return reinterpret_cast<double*>(x.at + k * stride); }

    // Sums over products that every coefficient needs: in registers for E of them, else in memory.
    static constexpr int register_count(int count) { return count <= 4 ? count : 0; }
    template <int E, class = void>
    struct ProductCache {
        typename Sums<V>::Vector products[E];
        Factors firsts[E];
        Row scaled[E];
        INLINE ProductCache(const Series& series) {
            for (int e = 0; e < E; ++e) products[e] = series.field.products.at.at[e];
        }
        INLINE const auto& product(int64_t e) const { return products[e]; }
        INLINE const Row& first(int64_t e) const { return firsts[e].left; }
        INLINE const Row& weighted(int64_t e) const { return scaled[e]; }
        INLINE void begin(int64_t e, const Factors& now) { firsts[e] = now, scaled[e] = products[e].weight * now.right; }
    };
    template <class Any>
    struct ProductCache<0, Any> {
        const typename Sums<V>::Vector* const products;
        const Factors* const factors;
        Row* const scaled;
        const int64_t order;
        INLINE ProductCache(const Series& series)
            : products(series.field.products.at.at), factors(series.factors.at), scaled(series.scaled.at),
              order(series.order) {}
        INLINE const auto& product(int64_t e) const { return products[e]; }
        INLINE const Row& first(int64_t e) const { return factors[e * order].left; }
        INLINE const Row& weighted(int64_t e) const { return scaled[e]; }
        INLINE void begin(int64_t e, const Factors& now) { scaled[e] = products[e].weight * now.right; }
    };

    // Copies of members, which the compiler would read again after each store. Vectors that only pad the coordinates stay
    // zero.
    struct Local {
        const int64_t blocks, order, made, vectors;
        const int64_t *const first, *const linear_first, *const output_first;
        const typename Sums<V>::Vector *const products, *const linear, *const outputs;
        Factors* const factors;
        Row *const later, *const results;
        INLINE Local(const Series& series)
            : blocks(blocks_of<V>(series.field.n)), order(series.order), made(series.field.factors.blocks),
              vectors(series.field.products.blocks), first(series.field.products.first.data()),
              linear_first(series.field.linear.first.data()), output_first(series.field.outputs.first.data()),
              products(series.field.products.at.at), linear(series.field.linear.at.at),
              outputs(series.field.outputs.at.at), factors(series.factors.at), later(series.later.at),
              results(series.results.at) {}
    };

    INLINE Lanes<W> every_fourth(int64_t block, int64_t first) const {
        Lanes<W> sum(0.0);
        for (int64_t k = first + (order - first + 4) / 4 * 4 - 4; k >= first; k -= 4)
            sum = sum + x.at[k * stride + block];
        return sum;
    }

    template <bool written_out>
    NOINLINE void expand_written(int64_t blocks, double h) {
        const int64_t most = field.products.size() == blocks * field.products.most ? field.products.most : 0;
        if constexpr (V == W) {
            if (blocks == 1 && most == 1) return expand_unrolled<1, written_out, 1>(h);
            if (blocks == 1 && most == 2) return expand_unrolled<1, written_out, 2>(h);
            if (blocks == 1 && most == 3) return expand_unrolled<1, written_out, 3>(h);
            if (blocks == 1 && most == 4) return expand_unrolled<1, written_out, 4>(h);
        }
        if constexpr (V == 8) {
            if (blocks == 2 && most == 2) return expand_unrolled<2, written_out, 2>(h);
            if (blocks == 3 && most == 2) return expand_unrolled<3, written_out, 2>(h);
            // Rows of any numbers of products.
            if (blocks == 1) return expand_unrolled<1, written_out, 0>(h);
            if (blocks == 2) return expand_unrolled<2, written_out, 0>(h);
            if (blocks == 3) return expand_unrolled<3, written_out, 0>(h);
        }
        expand_unrolled<0, written_out, 0>(h);
    }

    NOINLINE void expand_factored(int64_t blocks, double h) {
        const int64_t vectors = field.products.blocks;
        if constexpr (V == W) {
            if (blocks == 1 && vectors == 1) return expand_factored<1, 1>(h);
            if (V == 4 && blocks == 1) return expand_factored<1, 0>(h);
        }
        if constexpr (V == 8) {
            if (blocks == 1 && vectors == 2) return expand_factored<1, 2>(h);
            if (blocks == 2 && vectors == 1) return expand_factored<2, 1>(h);
            if (blocks == 2 && vectors == 2) return expand_factored<2, 2>(h);
            if (blocks == 1) return expand_factored<1, 0>(h);
            if (blocks == 2) return expand_factored<2, 0>(h);
        }
        expand_factored<0, 0>(h);
    }

    // K: blocks of rows, E: products of each row; both are 0 if they are read from the tables.
    template <int K, bool written_out, int E>
    NOINLINE void expand_unrolled(double h) {
        const Local here(*this);
        ProductCache<register_count(K * E)> cached(*this);
        Newest<K, V> newest(numbers(0));
        each_order<K>(here.order, [&](auto in_line, int64_t k) __attribute__((always_inline)) {
            coefficient<K, written_out, E, decltype(in_line)::value>(here, cached, newest, k, h);
        });
    }

    // The coefficients just computed, in registers or in memory, are the newest.
    template <int K>
    static INLINE void renew(Newest<K, V>& newest, const Row* registers, const double* memory) {
        if constexpr (K > 0)
            newest = Newest<K, V>(registers);
        else
            newest = Newest<K, V>(memory);
    }

    // Visit the orders, the first ones unrolled: one after the other, not by recursion, since the compiler would
    // optimize the last ones in every level again.
    template <int K, class Visit>
    static INLINE void each_order(int64_t order, const Visit& visit) {
        constexpr int unrolled = K > 0 ? COADJOINT_UNROLLED : std::min(COADJOINT_UNROLLED, 4);
        static_assert(unrolled % 2 == 0, "the loop below begins with an even order");
        each_of_the_first(order, visit, std::make_integer_sequence<int, unrolled>());
        for (int64_t k = unrolled; k < order; k += 2) {
            visit(std::false_type(), k);
            if (k + 1 < order) visit(std::false_type(), k + 1);
        }
    }
    template <class Visit, int... k>
    static INLINE void each_of_the_first(int64_t order, const Visit& visit, std::integer_sequence<int, k...>) {
        ((k < order && (visit(std::true_type(), k), true)) && ...);
    }

    // The terms j (odd) and j + 1 of both orders, see `convolve`.
    static INLINE void add_two_terms(const Factors* f, int64_t k, int64_t j, Row* sums) {
        sums[1] = fma(f[j].left, f[k - j].right, sums[1]);
        sums[3] = fma(f[j].left, f[k + 1 - j].right, sums[3]);
        sums[0] = fma(f[j + 1].left, f[k - 1 - j].right, sums[0]);
        sums[2] = fma(f[j + 1].left, f[k - j].right, sums[2]);
    }

    // The sums of a_j b_(k - j) for the orders k (even) and k + 1, as far as coefficients before k go. Both orders are
    // summed together, since they read the same coefficients. The newest come last, so that the sums are nearly
    // complete when these are known. Each order has two independent sums.
    template <bool unrolled>
    static INLINE void convolve(const Factors* f, int64_t k, Row* sums) {
        if (k < 2) return;
        if (k > 3) sums[0] = fma(f[2].left, f[k - 2].right, sums[0]);
        if constexpr (unrolled) {
#pragma GCC unroll 16
            for (int64_t j = 3; j < k - 2; j += 2) add_two_terms(f, k, j, sums);
        } else {
            for (int64_t j = 3; j < k - 2; j += 2) add_two_terms(f, k, j, sums);
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
    template <bool unrolled>
    static INLINE void begin(const Factors* f, int64_t order, int64_t count, int64_t k, Row* stored, Row& even,
                             Row& odd) {
        if (k % 2 == 1) {
            even = stored[0], odd = stored[1];
        } else {
            Row sums[4] = {0.0, 0.0, 0.0, 0.0};
            for (int64_t e = 0; e < count; ++e) convolve<unrolled>(f + e * order, k, sums);
            even = sums[0], odd = sums[1], stored[0] = sums[2], stored[1] = sums[3];
        }
        for (int64_t e = 0; e < count; ++e) add_left(f + e * order, k, even, odd);
    }

    template <int K, bool written_out, int E, bool unrolled>
    INLINE void coefficient(const Local& here, ProductCache<register_count(K * E)>& cached, Newest<K, V>& newest,
                            int64_t k, double h) {
        const int64_t blocks = K ? K : here.blocks;
        double *now = numbers(k), *then = numbers(k + 1);
        if constexpr (K == 0)
            if (here.made > 0) make_products(k, now);
        // In registers, since memory would delay the next order.
        Row slopes[K ? K : 1], next[K ? K : 1];
        if constexpr (!written_out) {
            const Sums<V>& sums = field.gradient;
#pragma GCC unroll 4
            for (int64_t b = 0; b < blocks; ++b) {
                Row even = k ? Row(0.0) : load<Row>(field.offsets.data() + b * V), odd(0.0);
                int64_t e = sums.first[b];
                for (; e + 1 < sums.first[b + 1]; e += 2) {
                    even = fma(sums.at.at[e].weight, newest(sums.at.at[e].left), even);
                    odd = fma(sums.at.at[e + 1].weight, newest(sums.at.at[e + 1].left), odd);
                }
                if (e < sums.first[b + 1]) even = fma(sums.at.at[e].weight, newest(sums.at.at[e].left), even);
                (K ? slopes : u.at)[b] = even + odd;
            }
        }
        const Newest<K, V> other = written_out ? newest : Newest<K, V>(K ? slopes : u.at);
        const Row length(h / double(k + 1));
#pragma GCC unroll 4
        for (int64_t b = 0; b < blocks; ++b) {
            const int64_t first = E ? E * b : here.first[b], count = E ? E : here.first[b + 1] - first;
            Factors* f = here.factors + first * here.order;
            Row even, odd;
            begin<unrolled>(f, here.order, count, k, here.later + 2 * b, even, odd);
            // The part independent of the newest coefficients is multiplied by the length beforehand.
            even = length * even, odd = length * odd;
            for (int64_t e = 0; e < count; ++e, f += here.order) {
                const Row y = newest(cached.product(first + e).left), z = other(cached.product(first + e).right);
                const Factors now{cached.product(first + e).weight * y, z};
                f[k] = now;
                if (k == 0) cached.begin(first + e, now);
                if (k > 0) odd = fma(y, length * cached.weighted(first + e), odd);
                even = fma(length * cached.first(first + e), z, even);
            }
            if constexpr (written_out)
                for (int64_t e = here.linear_first[b]; e < here.linear_first[b + 1]; ++e)
                    odd = fma(length * here.linear[e].weight, newest(here.linear[e].left), odd);
            const Row coefficient = even + odd;
            store(then + b * V, coefficient);
            if constexpr (K > 0) next[b] = coefficient;
        }
        renew<K>(newest, next, then);
    }

    // Factored products: K blocks of rows and P vectors of products; either is 0 if it is in memory.
    template <int K, int P>
    NOINLINE void expand_factored(double h) {
        const Local here(*this);
        Newest<K, V> newest(numbers(0));
        Factors firsts[P ? P : 1];
        each_order<K>(here.order, [&](auto in_line, int64_t k) __attribute__((always_inline)) {
            factored_coefficient<K, P, decltype(in_line)::value>(here, firsts, newest, k, h);
        });
    }

    template <int K, int P, bool unrolled>
    INLINE void factored_coefficient(const Local& here, Factors* firsts, Newest<K, V>& newest, int64_t k, double h) {
        const int64_t blocks = K ? K : here.blocks, vectors = P ? P : here.vectors;
        const Row length(h / double(k + 1));
        Row made[P ? P : 1], next[K ? K : 1];
#pragma GCC unroll 2
        for (int64_t v = 0; v < vectors; ++v) {
            Factors* const f = here.factors + v * here.order;
            Row even, odd;
            begin<unrolled>(f, here.order, 1, k, here.later + 2 * v, even, odd);
            int64_t e = here.first[v];
            Factors now;
            now.left = newest(here.products[e].right);
            now.right = here.products[e].weight * newest(here.products[e].left);
            while (++e < here.first[v + 1])
                now.right = fma(here.products[e].weight, newest(here.products[e].left), now.right);
            f[k] = now;
            if (P > 0 && k == 0) firsts[v] = now;
            const Factors& begun = P > 0 ? firsts[v] : f[0];
            // The sum of the newest coefficients is known last.
            Row sum = length * (even + odd);
            if (k > 0) sum = fma(length * begun.right, now.left, sum);
            (P ? made : here.results)[v] = fma(length * begun.left, now.right, sum);
        }
        const Newest<P, V> products(P ? made : here.results);
        double* const then = numbers(k + 1);
#pragma GCC unroll 2
        for (int64_t b = 0; b < blocks; ++b) {
            Row sum(0.0);
            for (int64_t e = here.linear_first[b]; e < here.linear_first[b + 1]; ++e)
                sum = fma(length * here.linear[e].weight, newest(here.linear[e].left), sum);
            for (int64_t e = here.output_first[b]; e < here.output_first[b + 1]; ++e)
                sum = fma(here.outputs[e].weight, products(here.outputs[e].left), sum);
            store(then + b * V, sum);
            if constexpr (K > 0) next[b] = sum;
        }
        renew<K>(newest, next, then);
    }

    // The k-th coefficients of the products behind the coordinates; each is one product.
    NOINLINE void make_products(int64_t k, double* now) {
        for (int64_t b = 0; b < field.factors.blocks; ++b) {
            const auto& product = field.factors.at.at[b];
            Factors* f = made.at + b * order;
            Row even, odd;
            begin<false>(f, order, 1, k, made_later.at + 2 * b, even, odd);
            f[k].left = take<V>(now, product.left), f[k].right = take<V>(now, product.right);
            even = fma(f[0].left, f[k].right, even);
            if (k > 0) odd = fma(f[k].left, f[0].right, odd);
            store(now + (field.blocks + b) * V, even + odd);
        }
    }
};

}  // namespace coadjoint
