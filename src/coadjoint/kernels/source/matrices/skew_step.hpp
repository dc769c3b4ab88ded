// Steps of skew-Hermitian matrices in planes: what the midpoint rule and the schemes with several stages share.
//
// All of it holds for X0 + eps X1 with eps^2 = 0, and for independent layers: a matrix then has planes for each of them.
#pragma once

#include "matrices/cayley.hpp"
#include "matrices/isospectral.hpp"
#include "matrices/tiles.hpp"

namespace coadjoint {

template <class T>
struct SkewStep : Isospectral<T> {
    typedef Isospectral<T> Base;
    using Base::n, Base::square, Base::all, Base::stream;

    static constexpr int64_t PARTS = sizeof(T) / sizeof(double);
    static constexpr double LAST_DIGIT = 0x1p-52;
    static constexpr double GROWN = 2.0;  // an iteration shrinks a residual by up to this factor less than the one before
    enum Matrix { STATE, INVERSE, FIRST, SECOND, MATRICES };

    const int64_t layers, moving;  // of a state, and those of P that are not zero
    const PlaneProducts<T> products;
    Cayley<T> cayley;
    PlanesOf<T> planes;
    std::vector<T> G, image;  // what a stream reads, and its result

    explicit SkewStep(const StepTables& tables, int64_t matrices = MATRICES)
        : Base(tables), layers(tables.whole[1]), moving(stream.carries() ? 1 : layers),
          products(tables.whole[REAL_GEMM], n), cayley(tables.whole[REAL_GEMM], n), planes(square, matrices * layers),
          G(all), image(all) {}

    Planes<T> whole(int64_t matrix, int64_t l) { return planes.layer(matrix * layers + l); }

    // Store Z_i = h a_ii P_i V_i of the step taken last, by stages, layers that move, and parts.
    virtual void store_changes(double h, double* to) = 0;

    void load_state(const T* W) {
        for (int64_t l = 0; l < layers; ++l) {
            const Planes<T> to = whole(STATE, l);
            share(square, [=](int64_t first, int64_t last) {
                for (int64_t e = first; e < last; ++e) to.set(e, W[l * square + e]);
            });
        }
    }

    // Call use(i, j, l, add) for the products of layers i and j of two factors that make the layers of a product, from
    // `from` on; layers that factors do not have are zero.
    template <class Use>
    void each_product(int64_t in_first, int64_t in_second, int64_t from, const Use& use) const {
        for (int64_t l = from; l < std::max(in_first, in_second); ++l) {
            const bool same = stream.direct || l == 0;
            if (same || in_second > l) use(same ? l : 0, l, l, false);
            if (!same && in_first > l) use(l, 0, l, in_second > l);
        }
    }

    // c := a b, of matrices of `in_a` and `in_b` layers, or with `opposite` the negative adjoint of that.
    void multiply(int64_t a, int64_t b, int64_t c, int64_t in_a, int64_t in_b, bool opposite) {
        each_product(in_a, in_b, 0, [&](int64_t i, int64_t j, int64_t l, bool add) {
            products.multiply(whole(a, i), whole(b, j), whole(c, l), add);
        });
        for (int64_t l = 0; l < std::max(in_a, in_b); ++l)
            opposite ? combine_opposites(n, whole(c, l)) : combine_products(square, whole(c, l));
    }

    // FIRST := -Z*, Z = A W, and SECOND := the parts of the skew-Hermitian A W A* = A (-Z*).
    void multiply_state(int64_t A) {
        multiply(A, STATE, FIRST, moving, layers, true);
        each_product(moving, layers, 0, [&](int64_t i, int64_t j, int64_t l, bool add) {
            products.lower(whole(A, i), whole(FIRST, j), whole(SECOND, l), add);
        });
    }

    // to := the sum of the stages' Z of a layer times factor(stage).
    template <class Factor>
    void add_stages(const Planes<T>& to, const double* Z, int64_t l, const Factor& factor) const {
        for (int64_t p = 0; p < PARTS; ++p) {
            double* const sum = to.plane[p];
            std::fill_n(sum, square, 0.0);
            for (int64_t j = 0; j < this->stages; ++j) {
                const double *from = Z + ((j * moving + l) * PARTS + p) * square, share = factor(j);
                for (int64_t e = 0; e < square; ++e) sum[e] += share * from[e];
            }
        }
        add_parts(square, to);
    }

    // matrix := the factor times a skew-Hermitian stream, of which entries below the diagonal may be left out.
    void load_stream(int64_t matrix, const T* stream, double factor) {
        for (int64_t l = 0; l < moving; ++l) {
            const T* const from = stream + l * square;
            const Planes<T> to = whole(matrix, l);
            each_tile(n, [=](const TileRange& range) {
                Tile<T> P;
                P.clear(range);
                range.each_row([&](int i, int64_t e, int count) {
                    P.load(i, reinterpret_cast<const double*>(from + e), count);
                });
                if (range.diagonal()) P.mirror();
                store(range, P, factor, to);
                if (!range.diagonal()) store(range.opposite(), P.opposite(), factor, to);
            });
        }
    }

    // INVERSE := (1 - X)^-1 - 1 for the X in it.
    void invert() {
        for (int64_t l = 0; l < moving; ++l)
            if (l == 0 || stream.direct) cayley.transform(whole(INVERSE, l));
        if (moving > 1 && !stream.direct) invert_second();
    }

    // Store a tile on or above the diagonal of G, and the opposite one if a stream reads it.
    void store_for_stream(const TileRange& range, const Tile<T>& from, T* to) const {
        store(range, from, to);
        if (!range.diagonal() && !stream.upper_suffices()) store(range.opposite(), from.opposite(), to);
    }

    // Of the skew-Hermitian V = Z C*, whose entries on and below the diagonal are computed, the tile above and that
    // below it.
    static void load_both(const TileRange& range, const Planes<T>& V, Tile<T>& above, Tile<T>& below) {
        load_product(range.opposite(), V, below);
        above = below.opposite();
        if (range.diagonal()) above.mirror(), below = above;
    }

    // The tile of 2 (Z - Z*) + 4 V, the change of W by conjugation with 1 + 2 C, Z = C W, V = Z C*.
    Tile<T> load_change(const TileRange& range, int64_t l) {
        const Planes<T> opposite = whole(FIRST, l), V = whole(SECOND, l);
        Tile<T> v, below, own, other, move;
        load(range, opposite, own), load(range.opposite(), opposite, other);
        const Tile<T> z = other.opposite();
        load_both(range, V, v, below);
        move.set([&](int p, int i) { return 4.0 * v.row[p][i] + 2.0 * (z.row[p][i] + own.row[p][i]); });
        return move;
    }

    // Add a tile and the opposite one to a state, with compensation.
    static void add_both(const TileRange& range, Tile<T>& move, double* x, double* dx) {
        if (range.diagonal()) move.mirror();
        add(range, move, x, dx);
        if (!range.diagonal()) add(range.opposite(), move.opposite(), x, dx);
    }

  private:
    // The second layer of C for X0 + eps X1: B0 X1 B0.
    void invert_second() {
        const Planes<T> C = whole(INVERSE, 0), X = whole(INVERSE, 1), left = whole(FIRST, 0), both = whole(SECOND, 0);
        const auto add = [=, this](const Planes<T>& from, const Planes<T>& to) {
            share(square, [=](int64_t first, int64_t last) {
                for (int64_t e = first; e < last; ++e) to.set(e, from.at(e) + both.product(e));
            });
        };
        products.multiply(C, X, both);
        add(X, left);
        products.multiply(left, C, both);
        add(left, X);
    }

    static void add(const TileRange& range, const Tile<T>& move, double* x, double* dx) {
        Tile<T> to, rest;
        range.each_row([&](int i, int64_t e, int count) {
            to.load(i, x + PARTS * e, count), rest.load(i, dx + PARTS * e, count);
            for (int p = 0; p < PARTS; ++p)
                two_sum(to.row[p][i], move.row[p][i] + rest.row[p][i], to.row[p][i], rest.row[p][i]);
            to.store(i, x + PARTS * e, count), rest.store(i, dx + PARTS * e, count);
        });
    }
};

}  // namespace coadjoint
