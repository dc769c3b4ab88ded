// Blocks of several coordinates given by the entries of D: CUBIC ones by a closed form, others by a series.
#pragma once

#include <algorithm>

#include "flows/blocks.hpp"
#include "boundary/interrupts.hpp"

namespace coadjoint {

constexpr int64_t OVERFLOW_CHECK_INTERVAL = 64;  // substeps between checks for blocks that have overflowed

// A CUBIC or SERIES block: its coordinates and the compressed sparse rows of D in them.
struct BlockRows {
    const uint32_t *coordinates, *starts, *columns;
    uint32_t width;
    int64_t constant, entries;

    INLINE BlockRows(const Action& action, uint32_t run)
        : coordinates(action.indices + action.position[run]), starts(coordinates + action.width[run]),
          columns(starts + action.width[run] + 1), width(action.width[run]), constant(action.constant[run]),
          entries(action.entries[run]) {}
};

// target = factor D source in the coordinates of the block (the operation `apply`).
template <class A, class V, class C>
INLINE void apply_block(const Action& action, const C& constants, const BlockRows& block, int64_t values,
                        const V* source, const A& factor, V* target, int64_t rows) {
    for (uint32_t k = 0; k < block.width; ++k) {
        for (int64_t row = 0; row < rows; ++row) {
            V total(0.0);
            for (uint32_t entry = block.starts[k]; entry < block.starts[k + 1]; ++entry) {
                V value(constants.template number_at<A>(action.constants, values + entry));
                total = fma(value, source[block.columns[entry] * rows + row], total);
            }
            target[k * rows + row] = V(factor) * total;
        }
    }
}

template <class V>
INLINE void gather(const BlockRows& block, const Vectors<V>& x) {
    for (uint32_t k = 0; k < block.width; ++k)
        for (int64_t row = 0; row < x.rows; ++row)
            x.workspace[k * x.rows + row] = x.at[block.coordinates[k] * x.rows + row];
}

// Sine and cosine minus one of root * theta for lam < 0, their hyperbolic counterparts otherwise.
template <class A>
INLINE Rotation<A> cubic_rotation(const A& lam, const A& phi) {
    auto circular = lam < A(0.0);
    if (all(circular)) return rotation_by(phi);
    Rotation<A> hyperbolic = hyperbolic_rotation(phi);
    if (!any(circular)) return hyperbolic;
    Rotation<A> rotation = rotation_by(phi);
    return {select(circular, rotation.sine, hyperbolic.sine), select(circular, rotation.cosm1, hyperbolic.cosm1)};
}

// D^3 = lam D: exp(theta D) = 1 + S D + C D^2, Rodrigues' formula for lam < 0 and its hyperbolic counterpart for lam >
// 0.
template <class A>
struct CubicFactors {
    A lam, s, c;

    template <class C>
    INLINE CubicFactors(const Action& action, const C& constants, uint32_t run, const A& theta) {
        const int64_t base = action.constant[run];
        auto constant = [&](int64_t position) { return constants.template number_at<A>(action.constants, base + position); };
        lam = constant(0);
        const A phi = constant(1) * theta;
        Rotation<A> rotation = action.kind[run] == RATIONAL_CUBIC ? rational_rotation(phi) : cubic_rotation(lam, phi);
        // The rounding error of the constants is added, since it would stretch every step in the same way.
        s = fma(rotation.sine, constant(2), rotation.sine * constant(3));
        c = fma(rotation.cosm1, constant(4), rotation.cosm1 * constant(5));
    }
};

template <Summation summation, class A, class V, class C>
INLINE void cubic_by(const Action& action, const C& constants, uint32_t run, const CubicFactors<A>& factors,
                     const Vectors<V>& x) {
    const BlockRows block(action, run);
    const int64_t values = block.constant + CUBIC_HEADER, squares = values + block.entries,
                  rests = squares + block.entries;
    auto constant = [&](int64_t position) { return constants.template number_at<A>(action.constants, position); };
    const int64_t length = block.width * x.rows;
    const V along(factors.s), across(factors.c);
    if constexpr (summation == CORRECTED) {
        // D (D x) and not D^2 x: the rounding of the entries of D^2 has a systematic sign.
        apply_block(action, constants, block, values, x.workspace, A(1.0), x.workspace + length, x.rows);
        apply_block(action, constants, block, values, x.workspace + length, A(1.0), x.workspace + 2 * length, x.rows);
        const V deficit(shortfall(factors.s, factors.c, -factors.lam));
        for (uint32_t k = 0; k < block.width; ++k) {
            int64_t i = block.coordinates[k] * x.rows;
            for (int64_t row = 0; row < x.rows; ++row) {
                V first = x.workspace[length + k * x.rows + row], second = x.workspace[2 * length + k * x.rows + row];
                add_compensated(x.at, x.errors, i + row, x.at[i + row], fma(along, first, across * second),
                                x.errors[i + row], deficit * second);
            }
        }
        return;
    }
    // Rows of D and D^2 are summed in registers, during the latency of the sine.
    for (uint32_t k = 0; k < block.width; ++k) {
        int64_t i = block.coordinates[k] * x.rows;
        for (int64_t row = 0; row < x.rows; ++row) {
            V first(0.0), second(0.0), rest(0.0);
            for (uint32_t entry = block.starts[k]; entry < block.starts[k + 1]; ++entry) {
                V v = x.workspace[block.columns[entry] * x.rows + row];
                first = fma(V(constant(values + entry)), v, first);
                second = fma(V(constant(squares + entry)), v, second);
                rest = fma(V(constant(rests + entry)), v, rest);
            }
            second += rest;
            add<summation>(x.at, x.errors, i + row, x.at[i + row], fma(along, first, across * second));
        }
    }
}

template <Summation summation, class A, class V, class C>
INLINE void cubic(const Action& action, const C& constants, uint32_t run, const A& theta, const Vectors<V>& x) {
    gather(BlockRows(action, run), x);
    cubic_by<summation>(action, constants, run, CubicFactors<A>(action, constants, run, theta), x);
}

// Up to the norm r = REACH[m - 1] the series is truncated after the degree m. There r^m / (m + 1)! is below 2^-65. It
// must be so small, since the truncation error has one sign and adds up over the steps.
constexpr double REACH[] = {5.42e-20, 4.03e-10, 8.66e-07, 4.24e-05, 0.000455, 0.00227, 0.00728, 0.0177, 0.0358,
                            0.0635, 0.102, 0.153, 0.217, 0.293, 0.383, 0.485, 0.6, 0.727,
                            0.866, 1.02};

INLINE uint32_t degree_of(double r, uint32_t most) {
    uint32_t degree = 1;
    while (degree < most && r > REACH[degree - 1]) ++degree;
    return degree;
}

// Whether all coordinates of a block are finite, for each lane of members separately.
template <class A, class V>
INLINE auto finite_block(const BlockRows& block, const Vectors<V>& x) {
    V total(0.0);
    for (uint32_t k = 0; k < block.width; ++k)
        for (int64_t row = 0; row < x.rows; ++row) total = total + 0.0 * x.at[block.coordinates[k] * x.rows + row];
    if constexpr (Numbers<A>::lanes == 1)
        return all(total == V(0.0));
    else
        return total == V(0.0);
}

// The sum of theta^k D^k / k!: finite if D is nilpotent, else in substeps of norm at most 1.
template <Summation summation, class A, class V, class C>
NOINLINE void series(const Action& action, const C& constants, uint32_t run, const A& theta, const Vectors<V>& x) {
    const BlockRows block(action, run);
    const int64_t length = block.width * x.rows;
    A step = theta, substeps(1.0), degrees(1.0);
    const A norm = constants.template number_at<A>(action.constants, block.constant);
    int64_t most = 1;
    uint32_t longest = 1;
    for (int lane = 0; lane < Numbers<A>::lanes; ++lane) {
        double needed = std::ceil(absolute(lane_of(theta, lane)) * lane_of(norm, lane));
        if (needed <= double(MOST_SUBSTEPS)) {
            double lane_substeps = needed > 1.0 ? needed : 1.0;
            const double reached = absolute(lane_of(theta, lane)) * lane_of(norm, lane) / lane_substeps;
            const uint32_t degree = reached > 0.0 ? degree_of(reached, action.degree[run]) : action.degree[run];
            set_lane(step, lane, lane_of(theta, lane) / lane_substeps);
            set_lane(substeps, lane, lane_substeps);
            set_lane(degrees, lane, double(degree));
            longest = std::max(longest, degree);
            most = lane_substeps > double(most) ? int64_t(lane_substeps) : most;
        } else {
            // No step of an integration needs more. Near a blow-up the loop would not end; NaN stops it.
            set_lane(step, lane, NAN);
        }
    }
    InterruptCheck& interrupts = InterruptCheck::of_this_call();
    for (int64_t done = 0; done < most; ++done) {
        interrupts.after(longest * (block.entries + block.width) * x.rows * Numbers<V>::lanes);
        auto active = A(double(done)) < substeps;
        // In Horner's order. Added one by one, terms below half a unit in the last place would all be lost with the
        // same sign.
        gather(block, x);
        V *start = x.workspace, *inner = x.workspace + length, *total = x.workspace + 2 * length;
        std::copy_n(start, length, inner);
        for (uint32_t k = longest; k > 0; --k) {
            apply_block(action, constants, block, block.constant + 1, inner, step / double(k), total, x.rows);
            const auto begun = A(double(k)) <= degrees;
            for (int64_t position = 0; k > 1 && position < length; ++position) {
                inner[position] = start[position] + total[position];
                if constexpr (Numbers<A>::lanes > 1) inner[position] = select(begun, inner[position], start[position]);
            }
        }
        for (uint32_t k = 0; k < block.width; ++k) {
            int64_t i = block.coordinates[k] * x.rows;
            for (int64_t row = 0; row < x.rows; ++row) {
                V before = x.at[i + row], error = summation == PLAIN ? before : x.errors[i + row];
                add<summation == PLAIN ? PLAIN : COMPENSATED>(x.at, x.errors, i + row, before, total[k * x.rows + row]);
                if constexpr (Numbers<A>::lanes > 1) {
                    x.at[i + row] = select(active, x.at[i + row], before);
                    if constexpr (summation != PLAIN) x.errors[i + row] = select(active, x.errors[i + row], error);
                }
            }
        }
        if (done % OVERFLOW_CHECK_INTERVAL != OVERFLOW_CHECK_INTERVAL - 1) continue;
        // A NaN block remains NaN; the remaining substeps are skipped.
        substeps = select(finite_block<A>(block, x), substeps, A(0.0));
        if (!any(A(double(done)) < substeps)) return;
    }
}

}  // namespace coadjoint
