// The stages of a few small algebras in registers: their brackets, and whether M is diagonal, are known at compile
// time. The same operations as by the tables, and so the same bits.
#pragma once

#include <utility>

#include "stages/stagnation.hpp"

namespace coadjoint {

// Call a function with each of the numbers 0 to n - 1 as a constant, so that arrays stay in registers.
template <class Function, int... i>
INLINE void each_of(Function function, std::integer_sequence<int, i...>) {
    (function(std::integral_constant<int, i>()), ...);
}
template <int n, class Function>
INLINE void each(Function function) {
    each_of(function, std::make_integer_sequence<int, n>());
}

// Nonzero structure constants, row by row: f_i = sum of sign x_state u_column. Those of a field may all have the
// opposite sign; of three coordinates that move each other they may be any.
struct So3 {
    static constexpr bool unit = true;
    static constexpr int n = 3, entries = 6, first[] = {0, 2, 4, 6};
    static constexpr int column[] = {1, 2, 0, 2, 0, 1}, state[] = {2, 1, 2, 0, 1, 0}, sign[] = {1, -1, -1, 1, 1, -1};
};
struct Triad : So3 {
    static constexpr bool unit = false;
};
struct E3 {
    static constexpr bool unit = true;
    static constexpr int n = 6, entries = 18, first[] = {0, 4, 8, 12, 14, 16, 18};
    static constexpr int column[] = {1, 2, 4, 5, 0, 2, 3, 5, 0, 1, 3, 4, 1, 2, 0, 2, 0, 1};
    static constexpr int state[] = {2, 1, 5, 4, 2, 0, 5, 3, 1, 0, 4, 3, 5, 4, 5, 3, 4, 3};
    static constexpr int sign[] = {1, -1, 1, -1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, 1, -1};
};
struct So4 {
    static constexpr bool unit = true;
    static constexpr int n = 6, entries = 24, first[] = {0, 4, 8, 12, 16, 20, 24};
    static constexpr int column[] = {1, 2, 3, 4, 0, 2, 3, 5, 0, 1, 4, 5, 0, 1, 4, 5, 0, 2, 3, 5, 1, 2, 3, 4};
    static constexpr int state[] = {3, 4, 1, 2, 3, 5, 0, 2, 4, 5, 0, 1, 1, 0, 5, 4, 2, 0, 5, 3, 2, 1, 4, 3};
    static constexpr int sign[] = {-1, -1, 1, 1, 1, -1, -1, 1, 1, 1, -1, -1, -1, 1, -1, 1, -1, 1, 1, -1, -1, 1, -1, 1};
};

enum class KnownAlgebra { NONE, TRIAD, SO3, SO3_FULL, E3, E3_FULL, SO4, SO4_FULL };

template <class Bracket, class C>
NOINLINE bool has_bracket(const Field& field, const C& constants) {
    if (field.nonlinear || field.separated || field.size != Bracket::n) return false;
    for (int i = 0; i <= Bracket::n; ++i)
        if (field.first[i] != uint32_t(Bracket::first[i])) return false;
    for (uint32_t q = 0; q < Bracket::entries; ++q)
        if (field.column[q] != uint32_t(Bracket::column[q]) || field.state[q] != uint32_t(Bracket::state[q]))
            return false;
    if (!Bracket::unit) return true;
    const double orientation = Bracket::sign[0] * constants.template number_at<double>(field.constant, 0);
    for (int q = 0; q < Bracket::entries; ++q)
        if (constants.template number_at<double>(field.constant, q) != orientation * Bracket::sign[q]) return false;
    return absolute(orientation) == 1.0;
}

// Whether H is quadratic with a row for every coordinate, of at most one entry, on the diagonal, or of all of them.
inline bool has_rows(const Field& field, bool full) {
    const Terms& terms = field.terms;
    const uint32_t n = uint32_t(field.size);
    if (terms.size != 1 || terms.kind[0] != LINEAR || terms.row[1] != n) return false;
    for (uint32_t i = 0; i < n; ++i) {
        const uint32_t low = terms.entry[i], count = terms.entry[i + 1] - low;
        if (terms.target[i] != i || (full ? count != n : count > 1)) return false;
        for (uint32_t j = 0; j < count; ++j)
            if (terms.column[low + j] != (full ? j : i)) return false;
    }
    return true;
}

template <class C>
NOINLINE KnownAlgebra known_algebra(const Field& field, const C& constants) {
    const bool full = has_rows(field, true);
    if (!full && !has_rows(field, false)) return KnownAlgebra::NONE;
    if (has_bracket<So3>(field, constants)) return full ? KnownAlgebra::SO3_FULL : KnownAlgebra::SO3;
    if (!full && has_bracket<Triad>(field, constants)) return KnownAlgebra::TRIAD;
    if (has_bracket<E3>(field, constants)) return full ? KnownAlgebra::E3_FULL : KnownAlgebra::E3;
    if (has_bracket<So4>(field, constants)) return full ? KnownAlgebra::SO4_FULL : KnownAlgebra::SO4;
    return KnownAlgebra::NONE;
}

// Function iterations for stages that fit into one row of lanes.
template <class Layout, class Bracket, bool full>
struct Bracketed {
    typedef typename Layout::A A;
    static constexpr int n = Bracket::n, rows = full ? n : 1, entries = Bracket::entries;
    Unknowns<Layout>& y;
    A* const gradients;
    const A length, orientation;
    A x[n], offset[n], weight[n * rows], constant[Bracket::unit ? 1 : entries];
    double base[n], error[n];
    bool weighted[n];

    template <class C>
    INLINE Bracketed(const Field& field, const C& constants, Unknowns<Layout>& y, A* gradients, const A& length)
        : y(y), gradients(gradients), length(length),
          orientation(A(double(Bracket::sign[0])) * constants.template number_at<A>(field.constant, 0)) {
        const Terms& terms = field.terms;
        each<n>([&](auto c) __attribute__((always_inline)) {
            x[c] = y.points.at[c], base[c] = y.base[c], error[c] = y.error[c];
            offset[c] = constants.template number_at<A>(terms.offset, c);
            weighted[c] = terms.entry[c + 1] > terms.entry[c];
            each<rows>([&](auto j) __attribute__((always_inline)) {
                if (!weighted[c]) return;
                weight[c * rows + j] = constants.template number_at<A>(terms.weight, terms.entry[c] + j);
            });
        });
        if constexpr (!Bracket::unit)
            each<entries>([&](auto q) __attribute__((always_inline)) {
                constant[q] = constants.template number_at<A>(field.constant, q);
            });
    }

    template <bool watched>
    INLINE void iterate(int64_t stages) {
        A u[n], rotated[n], slopes[n], sums[n], far(0.0);
        each<n>([&](auto c) __attribute__((always_inline)) {
            u[c] = offset[c];
            rotated[c] = Bracket::unit ? orientation * x[c] : x[c];
            if constexpr (full)
                each<n>([&](auto j) __attribute__((always_inline)) { u[c] = fma(weight[c * n + j], x[j], u[c]); });
            else if (weighted[c])
                u[c] = fma(weight[c], x[c], u[c]);
        });
        each<n>([&](auto c) __attribute__((always_inline)) {
            constexpr int low = Bracket::first[c], count = Bracket::first[c + 1] - low;
            A total(0.0);
            each<count>([&](auto k) __attribute__((always_inline)) {
                constexpr int q = low + k;
                const A& state = rotated[Bracket::state[q]];
                const A& by = u[Bracket::column[q]];
                if constexpr (Bracket::unit)
                    total = fma(Bracket::sign[q] < 0 ? -state : state, by, total);
                else
                    total = fma(constant[q] * state, by, total);
            });
            slopes[c] = length * total;
        });
        each<n / 3>([&](auto third) __attribute__((always_inline)) {
            Layout::template mix_one<3>(y.mix, stages, slopes + 3 * third, error + 3 * third, sums + 3 * third);
        });
        each<n>([&](auto c) __attribute__((always_inline)) {
            const A point = Layout::spread(base[c]) + sums[c];
            if constexpr (watched) {
                const A distance = absolute(point - x[c]);
                gradients[c] = u[c], y.slopes.at[c] = slopes[c], y.points.at[c] = point, y.change.at[c] = distance;
                far = far + distance;
            }
            x[c] = point;
        });
        if constexpr (watched) y.moved.at[0] = far;
    }
};

}  // namespace coadjoint
