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

enum Care { PLAIN, COMPENSATED, CORRECTED };

// Add an increment to a component of known value. With compensation, the rounding error is stored and added the next
// time.
template <Care care, class V>
INLINE void add(V* vectors, V* errors, int64_t place, const V& old, V increment) {
    if constexpr (care == PLAIN) {
        vectors[place] = old + increment;
    } else {
        increment = increment + errors[place];
        add_owing_rest(old, increment, vectors[place], errors[place]);
    }
}

// Add an increment with compensation. The rounding error of the increment, and that of adding the error to it, are
// stored as well, off the critical path of the next rotation.
template <class V>
INLINE void add_owing(V* vectors, V* errors, int64_t place, const V& old, const V& increment, const V& error,
                      const V& owed) {
    V whole = increment + error;
    V now = old + whole;
    V kept = now - old;
    // If the error is larger than the increment, both are so small that the rounding of their sum is negligible.
    errors[place] = (old - (now - kept)) + (whole - kept) + ((increment - whole) + error) + owed;
    vectors[place] = now;
}

// The rounding error of an increment. A stored error is multiplied in each flow by the norm of the flow minus the unit
// matrix, and would grow without bound if that is above 1. So it is added at once if the square of that norm (2 (1 -
// cos) for a rotation) is above this.
constexpr double WIDE = 0.25;

template <class V, class Mask>
INLINE void add_owing(V* vectors, V* errors, int64_t place, const V& old, const V& increment, V error, V owed,
                      bool some, const Mask& wide) {
    if (__builtin_expect(some, 0)) {
        error = select(wide, error + owed, error);
        owed = select(wide, V(0.0), owed);
    }
    add_owing(vectors, errors, place, old, increment, error, owed);
}

// The target of an action: `rows` vectors and their compensation. Scratch memory is three times their length.
template <class V>
struct Vectors {
    V *at, *errors;
    int64_t rows;
    V* room;
};

// Many blocks that rotate by one angle. Their coordinates are disjoint, so loads need not wait for stores.
NOINLINE inline void rotate_many(double sine, double lowered, const uint32_t* index, uint32_t repeat, double* x) {
    constexpr int together = 4;
    uint32_t block = 0;
    for (; block + together <= repeat; block += together, index += 2 * together) {
        double a[together], b[together];
#pragma GCC unroll 4
        for (int k = 0; k < together; ++k) a[k] = x[index[2 * k]], b[k] = x[index[2 * k + 1]];
#pragma GCC unroll 4
        for (int k = 0; k < together; ++k) {
            x[index[2 * k]] = a[k] + fma(lowered, a[k], -(sine * b[k]));
            x[index[2 * k + 1]] = b[k] + fma(lowered, b[k], sine * a[k]);
        }
    }
    for (; block < repeat; ++block, index += 2) {
        const double a = x[index[0]], b = x[index[1]];
        x[index[0]] = a + fma(lowered, a, -(sine * b));
        x[index[1]] = b + fma(lowered, b, sine * a);
    }
}

template <Care care, class A, class V>
INLINE void rotate(const Rotation<A>& turn, const uint32_t* index, uint32_t repeat, const Vectors<V>& x) {
    if constexpr (care == PLAIN && Numbers<V>::lanes == 1)
        if (repeat >= MANY) return rotate_many(turn.sine, turn.lowered, index, repeat, x.at);
    const V sine(turn.sine), lowered(turn.lowered);
    const V dearth(care == CORRECTED ? shortfall(turn.sine, -turn.lowered, A(1.0)) : A(0.0));
    const auto wide = lowered < V(-0.5 * WIDE);
    const bool some = care == CORRECTED && any(wide);
    for (uint32_t block = 0; block < repeat; ++block, index += 2) {
        int64_t i = index[0] * x.rows, j = index[1] * x.rows;
        for (int64_t row = 0; row < x.rows; ++row) {
            V a = x.at[i + row], b = x.at[j + row];
            V forth = sine * a, back = sine * b;
            if constexpr (care == CORRECTED) {
                // The rotation of the errors, the rounding of a product, and the defect of the rotation in length.
                V e = x.errors[i + row], f = x.errors[j + row];
                V first = fma(lowered, e, -fma(sine, f, fma(sine, b, -back))) - dearth * a;
                V second = fma(lowered, f, fma(sine, e, fma(sine, a, -forth))) - dearth * b;
                add_owing(x.at, x.errors, i + row, a, fma(lowered, a, -back), e, first, some, wide);
                add_owing(x.at, x.errors, j + row, b, fma(lowered, b, forth), f, second, some, wide);
            } else {
                add<care>(x.at, x.errors, i + row, a, fma(lowered, a, -back));
                add<care>(x.at, x.errors, j + row, b, fma(lowered, b, forth));
            }
        }
    }
}

template <Care care, class A, class V>
INLINE void shear(const A& factor, const uint32_t* index, const Vectors<V>& x) {
    const V by(factor);
    const auto wide = V(WIDE) < by * by;
    const bool some = care == CORRECTED && any(wide);
    int64_t i = index[0] * x.rows, j = index[1] * x.rows;
    for (int64_t row = 0; row < x.rows; ++row) {
        V source = x.at[j + row];
        V moved = by * source;
        if constexpr (care == CORRECTED) {
            V owed = fma(by, x.errors[j + row], fma(by, source, -moved));
            add_owing(x.at, x.errors, i + row, x.at[i + row], moved, x.errors[i + row], owed, some, wide);
        } else {
            add<care>(x.at, x.errors, i + row, x.at[i + row], moved);
        }
    }
}

template <Care care, class A, class V>
INLINE void scale(const A& factor, const uint32_t* index, uint32_t repeat, const Vectors<V>& x) {
    const V by(factor);
    for (uint32_t block = 0; block < repeat; ++block) {
        int64_t i = index[block] * x.rows;
        for (int64_t row = 0; row < x.rows; ++row)
            add<care == PLAIN ? PLAIN : COMPENSATED>(x.at, x.errors, i + row, x.at[i + row], by * x.at[i + row]);
    }
}

// exp(theta B) = e^(theta mean) (C + S N), N = B - mean, N^2 = delta: entire in delta theta^2, of either sign.
template <Care care, class A, class V>
NOINLINE void plane(const A& mean, const A& half, const A& upper, const A& lower, const uint32_t* index,
                    uint32_t repeat, const A& theta, const Vectors<V>& x) {
    A delta = fma(half, half, upper * lower);
    Rotation<A> pair = entire_pair(theta * theta * delta);
    // Not from expm1 alone: if the mean decays and cosh grows, the rounding of 1 + expm1 would be amplified.
    const Growth<A> growth = growth_by(theta * mean);
    const V diagonal(fma(growth.whole, pair.lowered, growth.beyond)), s(growth.whole * (theta * pair.sine));
    for (uint32_t block = 0; block < repeat; ++block, index += 2) {
        int64_t i = index[0] * x.rows, j = index[1] * x.rows;
        for (int64_t row = 0; row < x.rows; ++row) {
            V a = x.at[i + row], b = x.at[j + row];
            constexpr Care kept = care == PLAIN ? PLAIN : COMPENSATED;
            add<kept>(x.at, x.errors, i + row, a, fma(diagonal, a, s * fma(V(half), a, V(upper) * b)));
            add<kept>(x.at, x.errors, j + row, b, fma(diagonal, b, s * fma(V(lower), a, -(V(half) * b))));
        }
    }
}

}  // namespace coadjoint
