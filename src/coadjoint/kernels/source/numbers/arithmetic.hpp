// Sine with cosine minus one, and their hyperbolic counterparts, for one number or for lanes.
#pragma once

#include "numbers/elementary.hpp"
#include "numbers/lanes.hpp"

namespace coadjoint {

// pi/2 in three doubles. For |q| < 2^20 the fused phi - q*P1 is exact; P2 and P3 correct it.
constexpr double UNIT_ROUNDOFF = 0x1p-53;

constexpr double power_of_two(int64_t exponent) {
    return exponent == 0 ? 1.0 : exponent > 0 ? 2.0 * power_of_two(exponent - 1) : 0.5 * power_of_two(exponent + 1);
}

// P1 + P2 + P3 is pi/2 to three times the precision.
constexpr double P1 = 1.5707963267948966;
constexpr double P2 = 6.123233995736766e-17;
constexpr double P3 = -1.4973849048591698e-33;
constexpr double TWO_OVER_PI = 0.63661977236758134308;
constexpr double ROUND = 6755399441055744.0;  // 1.5 * 2^52: adding and subtracting it rounds to the nearest integer
constexpr double UNREDUCED = 0.785;           // just below pi/4: q is 0
constexpr double HALF = 0.5 + 0x1p-20;       // above what is left of a number rounded to the nearest integer
constexpr double LARGEST_REDUCED = 1.0e6;     // |q| < 2^20

template <class A>
struct Rotation {
    A sine, cosm1;  // sin(phi) and cos(phi) - 1
};

// z = r^2, (sin(r)/r - 1)/z and (cos(r) - 1)/z for |r| <= pi/4: the minimax polynomials of fdlibm in Estrin's order,
// since this chain is the latency of each step of a splitting.
template <class A>
INLINE void circular_series(const A& r, A& z, A& s, A& c) {
    z = r * r;
    A zz = z * z;
    s = fma(z, A(8.33333333332248946124e-03), A(-1.66666666666666324348e-01));
    s = fma(zz, fma(z, A(2.75573137070700676789e-06), A(-1.98412698298579493134e-04)), s);
    s = fma(zz * zz, fma(z, A(1.58969099521155010221e-10), A(-2.50507602534068634195e-08)), s);
    c = fma(z, A(4.16666666666666019037e-02), A(-0.5));
    c = fma(zz, fma(z, A(2.48015872894767294178e-05), A(-1.38888888888741095749e-03)), c);
    A high = fma(z, A(2.08757232129817482790e-09), A(-2.75573143513906633035e-07));
    c = fma(zz * zz, fma(zz, A(-1.13596475577881948265e-11), high), c);
}

// ROUND plus the integer nearest to x times a factor, also where rounding is up or down (boundary/rounding.cpp): there
// the sum alone is off by one.
template <class A>
INLINE A nearest_multiple(const A& x, double factor) {
    const A shifted = fma(x, A(factor), A(ROUND)), rest = fma(x, A(factor), A(ROUND) - shifted);
    if (__builtin_expect(!any(absolute(rest) > A(HALF)), 1)) return shifted;
    return shifted + select(rest > A(HALF), A(1.0), select(rest < A(-HALF), A(-1.0), A(0.0)));
}

// `near` marks lanes that need no reduction; they get the bits of the unreduced formula.
template <class A>
INLINE Rotation<A> reduced_rotation(const A& phi, const typename Numbers<A>::Mask& near) {
    const A shifted = nearest_multiple(phi, TWO_OVER_PI);
    A q = shifted - ROUND;
    A large = fma(-q, A(P1), phi), small = -q * P2;
    A r = large + small;
    A added = r - large;
    A lost = (large - (r - added)) + (small - added) + fma(-q, A(P2), -small);  // rounding of the sum and the product
    A tail = fma(-q, A(P3), lost);
    A z, s, c;
    circular_series(r, z, s, c);
    A sine = fma(r * z, s, r + tail), cosm1 = fma(-r, tail, z * c);
    auto odd = odd_bit(shifted, 0, 0), second = odd_bit(shifted, 1, 0), third = odd_bit(shifted, 1, 1);
    A sign = select(second, A(-1.0), A(1.0)), rotated = select(third, A(-1.0), A(1.0));
    A below = select(odd, A(-1.0), select(second, A(-2.0), A(0.0)));
    return {select(near, fma(phi * z, s, phi), fma(sign, select(odd, cosm1, sine), select(odd, sign, A(0.0)))),
            select(near, z * c, fma(rotated, select(odd, sine, cosm1), below))};
}

NOINLINE static Rotation<double> far_rotation(double phi) {
    const double half = rounded_sine(0.5 * phi);
    return {rounded_sine(phi), -2.0 * half * half};
}

// sin(phi) and cos(phi) - 1, each within 3 units in the last place up to |phi| = 10^6 by Cody-Waite reduction. cos - 1
// in place of cos, so that a small rotation adds a small increment with full relative accuracy. The branch for small
// angles skips operations that would not change the bits.
INLINE Rotation<double> rotation_by(double phi) {
    if (absolute(phi) <= UNREDUCED) {
        double z, s, c;
        circular_series(phi, z, s, c);
        return {fma(phi * z, s, phi), z * c};
    }
    if (__builtin_expect(!(absolute(phi) <= LARGEST_REDUCED), 0)) return far_rotation(phi);
    return reduced_rotation(phi, false);
}

template <int N>
INLINE Rotation<Lanes<N>> rotation_by(const Lanes<N>& phi) {
    typedef Lanes<N> A;
    A size = absolute(phi);
    auto near = size <= A(UNREDUCED);
    if (__builtin_expect(all(near), 1)) {
        A z, s, c;
        circular_series(phi, z, s, c);
        return {fma(phi * z, s, phi), z * c};
    }
    Rotation<A> rotation = reduced_rotation(phi, near);
    auto far = !(size <= A(LARGEST_REDUCED));
    if (__builtin_expect(any(far), 0)) {
        for (int lane = 0; lane < N; ++lane) {
            if (at(far, lane)) {
                Rotation<double> rotation_of_lane = far_rotation(phi[lane]);
                rotation.sine.set(lane, rotation_of_lane.sine);
                rotation.cosm1.set(lane, rotation_of_lane.cosm1);
            }
        }
    }
    return rotation;
}

// Sine and cosine minus one of the angle 2 atan(phi/2): a rotation, and rational in phi.
template <class A>
INLINE Rotation<A> rational_rotation(const A& phi) {
    A half = 0.5 * phi;
    A sine = phi / fma(half, half, A(1.0));
    return {sine, -(half * sine)};
}

// The angle of the generator represented by a rational rotation of this frequency; phi itself for 0.
template <class A>
INLINE A rational_angle(const A& phi, const A& frequency) {
    A angle = phi;
    for (int lane = 0; lane < Numbers<A>::lanes; ++lane) {
        double w = lane_of(frequency, lane);
        if (w > 0.0) set_lane(angle, lane, 2.0 * rounded_angle(0.5 * w * lane_of(phi, lane), 1.0) / w);
    }
    return angle;
}

// The d with which 1 + s D + (c + d) D^2 keeps lengths, for a rounded rotation with D^3 = -square D: (s^2 - 2 c + c^2
// square)/2, which is rounding. It has a constant sign if the angle keeps its size, so without d lengths would drift
// linearly in time.
template <class A>
INLINE A shortfall(const A& s, const A& c, const A& square) {
    A curved = c * square;
    A power = c * curved;
    return 0.5 * (fma(s, s, -2.0 * c) + power + fma(c, curved, -power));
}

// 1 / ln 2.
constexpr double LOG2_E = 1.4426950408889634;
constexpr double LN2 = 0.6931471805599453, LN2_REST = 2.3190468138462996e-17;  // the sum is ln 2 to twice the precision
constexpr double FAR_GROWTH = 700.0;  // beyond it powers of two overflow or lose digits

template <class A>
struct Growth {
    A exp, expm1;  // exp(x) and exp(x) - 1
};

// exp(x) and exp(x) - 1, each within 2 units in the last place: the Taylor polynomial of degree 13 on |r| <= ln(2)/2,
// with a remainder below 2^-56 r.
template <class A>
INLINE Growth<A> growth_by(const A& x) {
    const A shifted = nearest_multiple(x, LOG2_E);
    const A k = shifted - ROUND;
    const A r = fma(-k, A(LN2_REST), fma(-k, A(LN2), x));
    const A z = r * r, zz = z * z;
    A q = fma(z, fma(r, A(1.0 / 120.0), A(1.0 / 24.0)), fma(r, A(1.0 / 6.0), A(0.5)));
    q = fma(zz, fma(z, fma(r, A(1.0 / 362880.0), A(1.0 / 40320.0)), fma(r, A(1.0 / 5040.0), A(1.0 / 720.0))), q);
    const A last = fma(z, fma(r, A(1.0 / 6227020800.0), A(1.0 / 479001600.0)),
                       fma(r, A(1.0 / 39916800.0), A(1.0 / 3628800.0)));
    q = fma(zz * zz, last, q);
    const A p = fma(z, q, r), scale = power_of_two(shifted);
    Growth<A> growth{fma(p, scale, scale), fma(p, scale, scale - 1.0)};
    const auto near = absolute(x) <= A(FAR_GROWTH);
    if (__builtin_expect(!all(near), 0))
        for (int lane = 0; lane < Numbers<A>::lanes; ++lane)
            if (!at(near, lane)) {
                const double argument = lane_of(x, lane), whole = rounded_exponential(argument);
                set_lane(growth.exp, lane, whole);
                set_lane(growth.expm1, lane, argument < 0.0 ? -1.0 : whole);
            }
    return growth;
}

template <class A>
INLINE A hyperbolic_sine(const A& x) {
    const A size = absolute(x), expm1 = growth_by(size).expm1;
    A sine = 0.5 * (expm1 + expm1 / (expm1 + 1.0));
    const auto near = size <= A(FAR_GROWTH);
    if (__builtin_expect(!all(near), 0))
        sine = select(near, sine, map(size, [](double a) { return rounded_exponential(a, 1); }));
    return select(x < A(0.0), -sine, sine);
}

template <class A>
INLINE Rotation<A> hyperbolic_rotation(const A& phi) {
    const A half = hyperbolic_sine(0.5 * phi);
    return {hyperbolic_sine(phi), 2.0 * half * half};
}

// sinh(w)/w and cosh(w) - 1 for w*w = z near 0, by the series (the first neglected term is below 2^-53 of the sum).
template <class A>
INLINE Rotation<A> entire_series(const A& z) {
    A s(1.0), c(1.0);
    for (int k = 9; k > 0; --k) {
        s = fma(s, z / (2.0 * k * (2.0 * k + 1.0)), A(1.0));
        c = fma(c, z / ((2.0 * k + 1.0) * (2.0 * k + 2.0)), A(1.0));
    }
    return {s, 0.5 * z * c};
}

// sinh(w)/w and cosh(w) - 1 for w*w = z of either sign: one entire function of z, without a branch on the discriminant.
INLINE Rotation<double> entire_pair(double z) {
    if (absolute(z) < 0.25) return entire_series(z);
    double w = std::sqrt(absolute(z));
    Rotation<double> rotation = z < 0.0 ? rotation_by(w) : hyperbolic_rotation(w);
    return {rotation.sine / w, rotation.cosm1};
}
template <int N>
INLINE Rotation<Lanes<N>> entire_pair(const Lanes<N>& z) {
    Rotation<Lanes<N>> pair = entire_series(z);
    auto near = absolute(z) < Lanes<N>(0.25);
    if (all(near)) return pair;
    for (int lane = 0; lane < N; ++lane) {
        if (!at(near, lane)) {
            Rotation<double> rotation_of_lane = entire_pair(z[lane]);
            pair.sine.set(lane, rotation_of_lane.sine);
            pair.cosm1.set(lane, rotation_of_lane.cosm1);
        }
    }
    return pair;
}

}  // namespace coadjoint
