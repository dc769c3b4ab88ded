// The action of one block of a part on vectors side by side: rotations, shears, scalings, and planes.
//
// An angle is an A, a component of a vector is a V: both one number, or both lanes of members, or one angle for the
// rows of a group element as lanes. Component i of vector r is at i * rows + r.
#pragma once

#include "boundary/codes.hpp"
#include "numbers/arithmetic.hpp"
#include "numbers/constants.hpp"

namespace coadjoint {

// Rational rotations, tan(phi/2) = half the angle: the same blocks with other sines and cosines.
constexpr int64_t RATIONAL_ROTATE = ROTATE + RATIONAL, RATIONAL_CUBIC = CUBIC + RATIONAL;

constexpr uint32_t MANY = 4;  // blocks of one angle for which a call pays off

enum Summation { PLAIN, COMPENSATED, CORRECTED };

// Add an increment to a component of known value. With compensation, the rounding error is stored and added the next
// time.
template <Summation summation, class V>
INLINE void add(V* vectors, V* errors, int64_t position, const V& old, V increment) {
    if constexpr (summation == PLAIN) {
        vectors[position] = old + increment;
    } else {
        increment = increment + errors[position];
        two_sum(old, increment, vectors[position], errors[position]);
    }
}

// Add an increment with compensation. The rounding error of the increment, and that of adding the error to it, are
// stored as well, off the critical path of the next rotation.
template <class V>
INLINE void add_compensated(V* vectors, V* errors, int64_t position, const V& old, const V& increment, const V& error,
                            const V& remainder) {
    V whole = increment + error;
    V now = old + whole;
    V added = now - old;
    // If the error is larger than the increment, both are so small that the rounding of their sum is negligible.
    errors[position] = (old - (now - added)) + (whole - added) + ((increment - whole) + error) + remainder;
    vectors[position] = now;
}

// The rounding error of an increment. A stored error is multiplied in each flow by the norm of the flow minus the unit
// matrix, and would grow without bound if that is above 1. So it is added at once if the square of that norm (2 (1 -
// cos) for a rotation) is above this.
constexpr double WIDE = 0.25;

template <class V, class Mask>
INLINE void add_compensated(V* vectors, V* errors, int64_t position, const V& old, const V& increment, V error,
                            V remainder, bool some, const Mask& wide) {
    if (__builtin_expect(some, 0)) {
        error = select(wide, error + remainder, error);
        remainder = select(wide, V(0.0), remainder);
    }
    add_compensated(vectors, errors, position, old, increment, error, remainder);
}

// The target of an action: `rows` vectors and their compensation. Scratch memory is three times their length. Lanes of
// angles beyond MOST_SUBSTEPS are marked as `too_long`, unless null.
template <class V>
struct Vectors {
    V *at, *errors;
    int64_t rows;
    V* workspace;
    int64_t* too_long = nullptr;
};

// Many blocks that rotate by one angle. Their coordinates are disjoint, so loads need not wait for stores.
NOINLINE inline void rotate_many(double sine, double cosm1, const uint32_t* index, uint32_t repeat, double* x) {
    constexpr int together = 4;
    uint32_t block = 0;
    for (; block + together <= repeat; block += together, index += 2 * together) {
        double a[together], b[together];
#pragma GCC unroll 4
        for (int k = 0; k < together; ++k) a[k] = x[index[2 * k]], b[k] = x[index[2 * k + 1]];
#pragma GCC unroll 4
        for (int k = 0; k < together; ++k) {
            x[index[2 * k]] = a[k] + fma(cosm1, a[k], -(sine * b[k]));
            x[index[2 * k + 1]] = b[k] + fma(cosm1, b[k], sine * a[k]);
        }
    }
    for (; block < repeat; ++block, index += 2) {
        const double a = x[index[0]], b = x[index[1]];
        x[index[0]] = a + fma(cosm1, a, -(sine * b));
        x[index[1]] = b + fma(cosm1, b, sine * a);
    }
}

template <Summation summation, class A, class V>
INLINE void rotate(const Rotation<A>& rotation, const uint32_t* index, uint32_t repeat, const Vectors<V>& x) {
    if constexpr (summation == PLAIN && Numbers<V>::lanes == 1)
        if (repeat >= MANY && x.rows == 1) return rotate_many(rotation.sine, rotation.cosm1, index, repeat, x.at);
    const V sine(rotation.sine), cosm1(rotation.cosm1);
    const V deficit(summation == CORRECTED ? shortfall(rotation.sine, -rotation.cosm1, A(1.0)) : A(0.0));
    const auto wide = cosm1 < V(-0.5 * WIDE);
    const bool some = summation == CORRECTED && any(wide);
    for (uint32_t block = 0; block < repeat; ++block, index += 2) {
        int64_t i = index[0] * x.rows, j = index[1] * x.rows;
        for (int64_t row = 0; row < x.rows; ++row) {
            V a = x.at[i + row], b = x.at[j + row];
            V sine_a = sine * a, sine_b = sine * b;
            if constexpr (summation == CORRECTED) {
                // The rotation of the errors, the rounding of a product, and the defect of the rotation in length.
                V e = x.errors[i + row], f = x.errors[j + row];
                V first = fma(cosm1, e, -fma(sine, f, fma(sine, b, -sine_b))) - deficit * a;
                V second = fma(cosm1, f, fma(sine, e, fma(sine, a, -sine_a))) - deficit * b;
                add_compensated(x.at, x.errors, i + row, a, fma(cosm1, a, -sine_b), e, first, some, wide);
                add_compensated(x.at, x.errors, j + row, b, fma(cosm1, b, sine_a), f, second, some, wide);
            } else {
                add<summation>(x.at, x.errors, i + row, a, fma(cosm1, a, -sine_b));
                add<summation>(x.at, x.errors, j + row, b, fma(cosm1, b, sine_a));
            }
        }
    }
}

template <Summation summation, class A, class V>
INLINE void shear(const A& factor, const uint32_t* index, const Vectors<V>& x) {
    const V by(factor);
    const auto wide = V(WIDE) < by * by;
    const bool some = summation == CORRECTED && any(wide);
    int64_t i = index[0] * x.rows, j = index[1] * x.rows;
    for (int64_t row = 0; row < x.rows; ++row) {
        V source = x.at[j + row];
        V moved = by * source;
        if constexpr (summation == CORRECTED) {
            V remainder = fma(by, x.errors[j + row], fma(by, source, -moved));
            add_compensated(x.at, x.errors, i + row, x.at[i + row], moved, x.errors[i + row], remainder, some, wide);
        } else {
            add<summation>(x.at, x.errors, i + row, x.at[i + row], moved);
        }
    }
}

template <Summation summation, class A, class V>
INLINE void scale(const A& factor, const uint32_t* index, uint32_t repeat, const Vectors<V>& x) {
    const V by(factor);
    for (uint32_t block = 0; block < repeat; ++block) {
        int64_t i = index[block] * x.rows;
        for (int64_t row = 0; row < x.rows; ++row)
            add<summation == PLAIN ? PLAIN : COMPENSATED>(x.at, x.errors, i + row, x.at[i + row], by * x.at[i + row]);
    }
}

// exp(theta B) = e^(theta mean) (C + S N), N = B - mean, N^2 = delta: entire in delta theta^2, of either sign.
template <Summation summation, class A, class V>
NOINLINE void plane(const A& mean, const A& half, const A& upper, const A& lower, const uint32_t* index,
                    uint32_t repeat, const A& theta, const Vectors<V>& x) {
    A delta = fma(half, half, upper * lower);
    Rotation<A> pair = entire_pair(theta * theta * delta);
    // Not from expm1 alone: if the mean decays and cosh grows, the rounding of 1 + expm1 would be amplified.
    const Growth<A> growth = growth_by(theta * mean);
    const V diagonal(fma(growth.exp, pair.cosm1, growth.expm1)), s(growth.exp * (theta * pair.sine));
    for (uint32_t block = 0; block < repeat; ++block, index += 2) {
        int64_t i = index[0] * x.rows, j = index[1] * x.rows;
        for (int64_t row = 0; row < x.rows; ++row) {
            V a = x.at[i + row], b = x.at[j + row];
            constexpr Summation limited = summation == PLAIN ? PLAIN : COMPENSATED;
            add<limited>(x.at, x.errors, i + row, a, fma(diagonal, a, s * fma(V(half), a, V(upper) * b)));
            add<limited>(x.at, x.errors, j + row, b, fma(diagonal, b, s * fma(V(lower), a, -(V(half) * b))));
        }
    }
}

}  // namespace coadjoint
