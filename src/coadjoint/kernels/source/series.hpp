// The Taylor series of a motion whose field is a polynomial: x_(k+1) = h / (k + 1) * (the k-th coefficient of the field).
#pragma once

#include "series_field.hpp"

// Where the newest coefficients of all series are: in K registers, or in memory.
template <int K, int W>
struct Newest {
    Lanes<W> at[K];
    INLINE explicit Newest(const Lanes<W>* from) { for (int b = 0; b < K; ++b) at[b] = from[b]; }
    INLINE Lanes<W> operator()(const Places<W>& places) const { return take<K>(at, places); }
};
template <int W>
struct Newest<0, W> {
    const double* at;
    INLINE explicit Newest(const Lanes<W>* from) : at(reinterpret_cast<const double*>(from)) {}
    INLINE Lanes<W> operator()(const Places<W>& places) const { return take<W>(at, places); }
};

constexpr int UNROLLED = 24;  // orders up to which every sum has its own code: a loop would have to guess where it ends

template <int W>
struct Series {
    typedef Lanes<W> Row;
    const SeriesField<W> field;
    const int64_t order;
    Room<Row> x, u;                     // coefficients of x, order by order; of the gradient, the newest
    Room<Row> left, right;              // of both factors of every product, product by product
    Room<Row> made_left, made_right;    // and of the products behind the coordinates
    Room<Row> later, made_later;        // what is known of the next order

    template <class C>
    Series(const Field& given, const C& constants, int64_t order)
        : field(given, constants, order), order(order), x((order + 1) * field.extended), u(field.blocks),
          left(field.products.size() * order), right(field.products.size() * order),
          made_left(field.factors.size() * order), made_right(field.factors.size() * order),
          later(2 * field.blocks), made_later(2 * field.factors.blocks) {}

    // Set the coefficients x_1 h, ..., x_p h^p of the motion from x_0.
    void expand(double h) {
        const int64_t blocks = field.extended == field.blocks && (W == 8 || field.blocks == 1) ? field.blocks : 0;
        if (field.written_out)
            expand_written<true>(blocks, h);
        else
            expand_written<false>(blocks, h);
    }

    // x_1 h + ... + x_p h^p of one block of rows: four sums, each from its smallest terms.
    INLINE Row increment(int64_t block) const {
        return every_fourth(block, 1) + (every_fourth(block, 2) + (every_fourth(block, 3) + every_fourth(block, 4)));
    }

  private:
    INLINE Row every_fourth(int64_t block, int64_t first) const {
        Row sum(0.0);
        for (int64_t k = first + (order - first + 4) / 4 * 4 - 4; k >= first; k -= 4)
            sum = sum + x.at[k * field.extended + block];
        return sum;
    }

    template <bool written_out>
    void expand_written(int64_t blocks, double h) {
        if (blocks == 1) return field.products.most == 1   ? expand_unrolled<1, written_out, 1>(h)
                                : field.products.most == 2 ? expand_unrolled<1, written_out, 2>(h)
                                                           : expand_unrolled<1, written_out, 0>(h);
        if constexpr (W == 8) {
            if (blocks == 2) return expand_unrolled<2, written_out, 0>(h);
            if (blocks == 3) return expand_unrolled<3, written_out, 0>(h);
            if (blocks == 4) return expand_unrolled<4, written_out, 0>(h);
        }
        for (int64_t k = 0; k < order; ++k) coefficient<0, written_out, 0>(k, h);
    }

    // K: blocks of rows, E: products of each; 0 where they are read from the tables.
    template <int K, bool written_out, int E>
    NOINLINE void expand_unrolled(double h) {
        stage<K, written_out, E, 0>(h);
        for (int64_t k = UNROLLED; k < order; ++k) coefficient<K, written_out, E>(k, h);
    }

    template <int K, bool written_out, int E, int k>
    INLINE void stage(double h) {
        if (k == order) return;
        coefficient<K, written_out, E>(k, h);
        if constexpr (k + 1 < UNROLLED) stage<K, written_out, E, k + 1>(h);
    }

    // The sums a_j b_(k - j) of the orders k, which is even, and k + 1 as far as the coefficients before k go: together,
    // since both read the same, and the newest last, so that they are nearly done when those are known. In two sums
    // each that do not wait for each other: even and odd, then even and odd of order k + 1.
    static INLINE void convolve(const Row* a, const Row* b, int64_t k, Row* sums) {
        if (k < 2) return;
        Row before = b[k - 2];
#pragma GCC unroll 32
        for (int64_t j = 2; j < k - 1; ++j) {
            const Row now = b[k - j];
            sums[j % 2] = fma(a[j], now, sums[j % 2]);
            if (j > 2) sums[2 + j % 2] = fma(a[j], before, sums[2 + j % 2]);
            before = now;
        }
        sums[0] = fma(a[1], b[k - 1], sums[0]);
        if (k == 2) return;
        sums[1] = fma(a[k - 1], b[1], sums[1]);
        sums[2] = fma(a[2], b[k - 1], sums[2]);
        sums[3] = fma(a[k - 1], b[2], sums[3]);
    }

    // Add what the coefficients of order k, y and z of the factors a and b, contribute to that order, and to the one
    // after an even k.
    static INLINE void add_newest(Row* a, Row* b, int64_t k, const Row& y, const Row& z, Row& even, Row& odd) {
        a[k] = y, b[k] = z;
        if (k % 2 == 1 && k > 1) {
            even = fma(a[1], b[k - 1], even);
            odd = fma(a[k - 1], b[1], odd);
        }
        even = fma(a[0], z, even);
        if (k > 0) odd = fma(y, b[0], odd);
    }

    // Both sums of block b of some products before the coefficients of order k are known.
    INLINE void begin(const Row* a, const Row* b, int64_t low, int64_t high, int64_t k, Row* kept, Row& even, Row& odd) {
        if (k % 2 == 1) {
            even = kept[0], odd = kept[1];
            return;
        }
        Row sums[4] = {0.0, 0.0, 0.0, 0.0};
        for (int64_t e = low; e < high; ++e) convolve(a + e * order, b + e * order, k, sums);
        even = sums[0], odd = sums[1], kept[0] = sums[2], kept[1] = sums[3];
    }

    template <int K, bool written_out, int E>
    INLINE void coefficient(int64_t k, double h) {
        const int64_t blocks = K ? K : field.blocks;
        Row *now = x.at + k * field.extended, *then = now + field.extended;
        if constexpr (K == 0) make_products(k, now);
        const Newest<K, W> newest(now);
        if constexpr (!written_out) {
            const Sums<W>& sums = field.gradient;
            for (int64_t b = 0; b < blocks; ++b) {
                Row even = k ? Row(0.0) : load<Row>(field.offsets.data() + b * W), odd(0.0);
                int64_t e = sums.first[b];
                for (; e + 1 < sums.first[b + 1]; e += 2) {
                    even = fma(sums.weight.at[e], newest(sums.left.at[e]), even);
                    odd = fma(sums.weight.at[e + 1], newest(sums.left.at[e + 1]), odd);
                }
                if (e < sums.first[b + 1]) even = fma(sums.weight.at[e], newest(sums.left.at[e]), even);
                u.at[b] = even + odd;
            }
        }
        const Newest<K, W> other(written_out ? now : u.at);
        const Row length(h / double(k + 1));
        for (int64_t b = 0; b < blocks; ++b) {
            const int64_t low = E ? 0 : field.products.first[b], high = E ? E : field.products.first[b + 1];
            Row even, odd;
            begin(left.at, right.at, low, high, k, later.at + 2 * b, even, odd);
            if constexpr (written_out)
                for (int64_t e = field.linear.first[b]; e < field.linear.first[b + 1]; ++e)
                    odd = fma(field.linear.weight.at[e], newest(field.linear.left.at[e]), odd);
            for (int64_t e = low; e < high; ++e)
                add_newest(left.at + e * order, right.at + e * order, k,
                           field.products.weight.at[e] * newest(field.products.left.at[e]),
                           other(field.products.right.at[e]), even, odd);
            then[b] = length * (even + odd);
        }
    }

    // The k-th coefficients of the products behind the coordinates; each is one product.
    void make_products(int64_t k, Row* now) {
        const double* from = reinterpret_cast<const double*>(now);
        for (int64_t b = 0; b < field.factors.blocks; ++b) {
            Row even, odd, *kept = made_later.at + 2 * b;
            begin(made_left.at, made_right.at, b, b + 1, k, kept, even, odd);
            add_newest(made_left.at + b * order, made_right.at + b * order, k, take<W>(from, field.factors.left.at[b]),
                       take<W>(from, field.factors.right.at[b]), even, odd);
            now[field.blocks + b] = even + odd;
        }
    }
};
