// The stages of a rigid body and its kin in registers: three coordinates, each moved by the other two, and a diagonal
// quadratic Hamiltonian. The same operations as by the tables, and so the same bits.
#pragma once

#include "stagnation.hpp"

// Entries of a row follow each other by column; the state of each is the third coordinate.
constexpr uint32_t TRIAD_COLUMNS[6] = {1, 2, 0, 2, 0, 1}, TRIAD_STATES[6] = {2, 1, 2, 0, 1, 0};

inline bool is_triad(const Field& field) {
    const Terms& terms = field.terms;
    if (field.size != 3 || field.nonlinear || terms.size != 1 || terms.kind[0] != LINEAR || terms.row[1] != 3) return false;
    for (uint32_t i = 0; i <= 3; ++i)
        if (field.first[i] != 2 * i || terms.entry[i] != i) return false;
    for (uint32_t i = 0; i < 3; ++i)
        if (terms.target[i] != i || terms.column[i] != i) return false;
    return std::equal(TRIAD_COLUMNS, TRIAD_COLUMNS + 6, field.column) &&
           std::equal(TRIAD_STATES, TRIAD_STATES + 6, field.state);
}

// One iteration after the other, for stages that are one block of lanes.
template <class Layout>
struct Triad {
    typedef typename Layout::A A;
    Unknowns<Layout>& y;
    A* const gradients;
    const A length;
    A weight[3], offset[3], constant[6];
    A x0, x1, x2;  // by name: an array would not stay in registers from one iteration to the next
    double base[3], error[3];

    template <class C>
    INLINE Triad(const Field& field, const C& constants, Unknowns<Layout>& y, A* gradients, const A& length)
        : y(y), gradients(gradients), length(length), x0(y.points.at[0]), x1(y.points.at[1]), x2(y.points.at[2]) {
        for (int c = 0; c < 3; ++c) {
            weight[c] = constants.template number_at<A>(field.terms.weight, c);
            offset[c] = constants.template number_at<A>(field.terms.offset, c);
            base[c] = y.base[c], error[c] = y.error[c];
        }
        for (int q = 0; q < 6; ++q) constant[q] = constants.template number_at<A>(field.constant, q);
    }

    template <bool watched>
    INLINE void iterate(int64_t stages) {
        A x[3] = {x0, x1, x2}, u[3], slopes[3], sums[3], far(0.0);
        for (int c = 0; c < 3; ++c) u[c] = fma(weight[c], x[c], offset[c]);
        for (int c = 0; c < 3; ++c) {
            A total(0.0);
            for (int q = 2 * c; q < 2 * c + 2; ++q)
                total = fma(constant[q] * x[TRIAD_STATES[q]], u[TRIAD_COLUMNS[q]], total);
            slopes[c] = length * total;
        }
        Layout::template mix_one<3>(y.mix, stages, slopes, error, sums);
        for (int c = 0; c < 3; ++c) {
            const A point = Layout::spread(base[c]) + sums[c];
            if constexpr (watched) {
                const A distance = absolute(point - x[c]);
                gradients[c] = u[c], y.slopes.at[c] = slopes[c], y.points.at[c] = point, y.change.at[c] = distance;
                far = far + distance;
            }
            x[c] = point;
        }
        x0 = x[0], x1 = x[1], x2 = x[2];
        if constexpr (watched) y.moved.at[0] = far;
    }
};
