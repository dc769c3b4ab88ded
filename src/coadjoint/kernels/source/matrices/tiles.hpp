// Square tiles of matrices in vectors, with real and imaginary parts apart: operations on an entry and the opposite one
// read and write whole rows of a tile and of its adjoint.
#pragma once

#include <algorithm>
#include <cstring>
#include <type_traits>

#include "matrices/products.hpp"

namespace coadjoint {

constexpr int TILE = 8;

template <class Real>
struct RowType {
    typedef Real type __attribute__((vector_size(TILE * sizeof(Real))));
    typedef std::conditional_t<sizeof(Real) == 8, int64_t, int32_t> Index;
    typedef Index Mask __attribute__((vector_size(TILE * sizeof(Index))));
};
template <class Real>
using Row = typename RowType<Real>::type;

// The numbers at these indices of a and, from TILE on, of b.
template <class Real, int... INDEX>
inline Row<Real> chosen(const Row<Real>& a, const Row<Real>& b) {
#if defined(__clang__)
    return __builtin_shufflevector(a, b, INDEX...);
#else
    return __builtin_shuffle(a, b, typename RowType<Real>::Mask{INDEX...});
#endif
}

// The first numbers of a row, followed by zeros.
template <class Real>
inline Row<Real> load_row(const Real* from, int count) {
    Row<Real> found = {};
    if (count == TILE) std::memcpy(&found, from, sizeof(found));
    else for (int k = 0; k < count; ++k) found[k] = from[k];
    return found;
}

template <class Real>
inline void store_row(const Row<Real>& from, int count, Real* to) {
    if (count == TILE) std::memcpy(to, &from, sizeof(from));
    else for (int k = 0; k < count; ++k) to[k] = from[k];
}

// The rows and columns of a tile in an n x n matrix.
struct TileRange {
    int64_t n, row, column;
    int rows, columns;

    TileRange(int64_t n, int64_t row, int64_t column)
        : n(n), row(row), column(column), rows(int(std::min<int64_t>(TILE, n - row))),
          columns(int(std::min<int64_t>(TILE, n - column))) {}
    TileRange opposite() const { return {n, column, row}; }
    bool diagonal() const { return row == column; }

    // Call use(i, index of the first entry, count) for each row.
    template <class Use>
    void each_row(const Use& use) const {
        if (rows == TILE && columns == TILE)
            for (int i = 0; i < TILE; ++i) use(i, (row + i) * n + column, TILE);
        else
            for (int i = 0; i < rows; ++i) use(i, (row + i) * n + column, columns);
    }
};

// Call use(range) for each tile on and above the diagonal, on the threads of a team.
template <class Use>
void each_tile(int64_t n, const Use& use) {
    each_row_shared((n + TILE - 1) / TILE, [&](int64_t row) {
        for (int64_t column = TILE * row; column < n; column += TILE) use(TileRange(n, TILE * row, column));
    });
}

template <class T>
struct Tile {
    typedef typename RealType<T>::type Real;
    static constexpr int PARTS = sizeof(T) / sizeof(Real);
    Row<Real> row[PARTS][TILE];

    // Zero rows beyond those of a range at the edge of a matrix, before others are loaded.
    void clear(const TileRange& range) {
        if (range.rows < TILE) set([](int, int) { return Row<Real>{}; });
    }

    // Set each row to value(part, row).
    template <class Value>
    void set(const Value& value) {
        for (int p = 0; p < PARTS; ++p)
            for (int i = 0; i < TILE; ++i) row[p][i] = value(p, i);
    }

    // The negative adjoint, which a skew-Hermitian matrix has on the other side of the diagonal.
    Tile opposite() const {
        Tile found;
        for (int p = 0; p < PARTS; ++p) {
            Row<Real> to[TILE];
            for (int i = 0; i < TILE; ++i) to[i] = p ? row[p][i] : -row[p][i];
            exchange<0, 8, 2, 10, 4, 12, 6, 14, 1, 9, 3, 11, 5, 13, 7, 15>(to, 1);
            exchange<0, 1, 8, 9, 4, 5, 12, 13, 2, 3, 10, 11, 6, 7, 14, 15>(to, 2);
            exchange<0, 1, 2, 3, 8, 9, 10, 11, 4, 5, 6, 7, 12, 13, 14, 15>(to, 4);
            for (int i = 0; i < TILE; ++i) found.row[p][i] = to[i];
        }
        return found;
    }

    // Make a tile on the diagonal skew-Hermitian, from its entries above the diagonal.
    void mirror() {
        const Tile other = opposite();
        for (int i = 0; i < TILE; ++i) {
            row[0][i][i] = Real(0);
            for (int j = 0; j < i; ++j)
                for (int p = 0; p < PARTS; ++p) row[p][i][j] = other.row[p][i][j];
        }
    }

    // The numbers of a row, those of an entry beside each other.
    void load(int i, const Real* from, int count) {
        const Row<Real> first = load_row(from, std::min(PARTS * count, TILE));
        if constexpr (PARTS == 1) {
            row[0][i] = first;
        } else {
            const Row<Real> second = load_row(from + TILE, std::max(PARTS * count - TILE, 0));
            row[0][i] = chosen<Real, 0, 2, 4, 6, 8, 10, 12, 14>(first, second);
            row[1][i] = chosen<Real, 1, 3, 5, 7, 9, 11, 13, 15>(first, second);
        }
    }
    void store(int i, Real* to, int count) const {
        if constexpr (PARTS == 1) {
            store_row(row[0][i], count, to);
        } else {
            const Row<Real> first = chosen<Real, 0, 8, 1, 9, 2, 10, 3, 11>(row[0][i], row[1][i]);
            const Row<Real> second = chosen<Real, 4, 12, 5, 13, 6, 14, 7, 15>(row[0][i], row[1][i]);
            store_row(first, std::min(PARTS * count, TILE), to);
            store_row(second, std::max(PARTS * count - TILE, 0), to + TILE);
        }
    }

  private:
    // Of each two rows this far apart: the numbers at the first eight indices, and at the others.
    template <int... INDEX>
    static inline void exchange(Row<Real>* rows, int apart) {
        constexpr int at[] = {INDEX...};
#pragma GCC unroll 8
        for (int i = 0; i < TILE; ++i) {
            if (i & apart) continue;
            Row<Real> &a = rows[i], &b = rows[i + apart];
            const Row<Real> first = chosen<Real, at[0], at[1], at[2], at[3], at[4], at[5], at[6], at[7]>(a, b);
            b = chosen<Real, at[8], at[9], at[10], at[11], at[12], at[13], at[14], at[15]>(a, b);
            a = first;
        }
    }
};

template <class T>
inline void load(const TileRange& range, const Planes<T>& from, Tile<T>& to) {
    to.clear(range);
    for (int p = 0; p < Tile<T>::PARTS; ++p)
        range.each_row([&](int i, int64_t e, int count) { to.row[p][i] = load_row(from.plane[p] + e, count); });
}

// Load products of planes.
template <class T>
inline void load_product(const TileRange& range, const Planes<T>& from, Tile<T>& to) {
    to.clear(range);
    range.each_row([&](int i, int64_t e, int count) {
        const auto first = load_row(from.plane[0] + e, count);
        if constexpr (Tile<T>::PARTS == 1) {
            to.row[0][i] = first;
        } else {
            const auto second = load_row(from.plane[1] + e, count), third = load_row(from.plane[2] + e, count);
            to.row[0][i] = first - second;
            to.row[1][i] = third - (first + second);
        }
    });
}

// Store a tile, times a factor, in planes of its precision or of a lower one.
template <class T, class L>
inline void store(const TileRange& range, const Tile<T>& from, double factor, const Planes<L>& to) {
    typedef typename Planes<L>::Real Real;
    const auto scale = typename Tile<T>::Real(factor);
    range.each_row([&](int i, int64_t e, int count) {
        const auto first = __builtin_convertvector(scale * from.row[0][i], Row<Real>);
        store_row<Real>(first, count, to.plane[0] + e);
        if constexpr (Tile<T>::PARTS == 2) {
            const auto second = __builtin_convertvector(scale * from.row[1][i], Row<Real>);
            store_row<Real>(second, count, to.plane[1] + e);
            store_row<Real>(first + second, count, to.plane[2] + e);
        }
    });
}

// Store a tile in a matrix whose complex entries are adjacent.
template <class T>
inline void store(const TileRange& range, const Tile<T>& from, T* to) {
    range.each_row([&](int i, int64_t e, int count) { from.store(i, reinterpret_cast<double*>(to + e), count); });
}

// Packed matrices have the entries on and above the diagonal, row by row: the index of an entry.
inline int64_t packed_index(int64_t n, int64_t i, int64_t j) { return i * n - i * (i + 1) / 2 + j; }

template <class T>
inline void store_packed(const TileRange& range, const Tile<T>& from, double* to) {
    constexpr int PARTS = Tile<T>::PARTS;
    range.each_row([&](int i, int64_t, int count) {
        double* const at = to + PARTS * packed_index(range.n, range.row + i, range.column);
        if (!range.diagonal()) return from.store(i, at, count);
        for (int j = i; j < count; ++j)
            for (int p = 0; p < PARTS; ++p) at[PARTS * j + p] = from.row[p][i][j];
    });
}

// Load the skew-Hermitian tile of a packed matrix. Rows of a tile on the diagonal begin before it, with numbers that
// are not used.
template <class T>
inline void load_packed(const TileRange& range, const typename RealType<T>::type* from, Tile<T>& to) {
    to.clear(range);
    range.each_row([&](int i, int64_t, int count) {
        to.load(i, from + Tile<T>::PARTS * packed_index(range.n, range.row + i, range.column), count);
    });
    if (range.diagonal()) to.mirror();
}

// Fill planes with the skew-Hermitian matrix `factor` times a packed one.
template <class T, class L>
void unpack(int64_t n, const typename RealType<T>::type* packed, double factor, const Planes<L>& to) {
    each_tile(n, [=](const TileRange& range) {
        Tile<T> tile;
        load_packed(range, packed, tile);
        store(range, tile, factor, to);
        if (!range.diagonal()) store(range.opposite(), tile.opposite(), factor, to);
    });
}

// Set planes to the products that they hold the parts of.
template <class T>
void combine_products(int64_t count, const Planes<T>& planes) {
    if constexpr (Planes<T>::COUNT == 3)
        share(count, [=](int64_t begin, int64_t end) {
            auto *__restrict first = planes.plane[0], *__restrict second = planes.plane[1];
            auto* __restrict third = planes.plane[2];
            for (int64_t e = begin; e < end; ++e) {
                const auto real = first[e] - second[e], imaginary = third[e] - (first[e] + second[e]);
                first[e] = real, second[e] = imaginary, third[e] = real + imaginary;
            }
        });
}

// The same of the negative adjoints.
template <class T>
void combine_opposites(int64_t n, const Planes<T>& planes) {
    each_tile(n, [=](const TileRange& range) {
        Tile<T> own, other;
        load_product(range, planes, own);
        if (!range.diagonal()) {
            load_product(range.opposite(), planes, other);
            store(range, other.opposite(), 1.0, planes);
        }
        store(range.opposite(), own.opposite(), 1.0, planes);
    });
}

// Round planes to those of a lower precision.
template <class T, class L>
void round_planes(int64_t count, const Planes<T>& from, const Planes<L>& to) {
    typedef typename Planes<L>::Real Real;
    for (int p = 0; p < std::min(Planes<T>::COUNT, 2); ++p) {
        const auto* __restrict whole = from.plane[p];
        auto* __restrict low = to.plane[p];
        share(count, [=](int64_t first, int64_t last) {
            for (int64_t e = first; e < last; ++e) low[e] = Real(whole[e]);
        });
    }
}

// The third plane, of sums, of the first two.
template <class T>
void add_parts(int64_t count, const Planes<T>& planes) {
    if constexpr (Planes<T>::COUNT == 3) {
        const auto *__restrict first = planes.plane[0], *__restrict second = planes.plane[1];
        auto* __restrict sum = planes.plane[2];
        share(count, [=](int64_t begin, int64_t end) {
            for (int64_t e = begin; e < end; ++e) sum[e] = first[e] + second[e];
        });
    }
}

}  // namespace coadjoint
