// Exact flow of the free rigid body: the quaternion of its rotation, and the derivative of that by the momentum.
//
// On coordinates z of so(3) with H = (m1 z1^2 + m2 z2^2 + m3 z3^2)/2 the motion z' = (m z) cross z is
//     z_i(s) = (z_i C_j C_k + s a_i C_i z_j z_k)/D,    C_i^2 = D + s^2 p_i,    D = s^2 (P(s) - p),
// with a_1 = m2 - m3 and so on, p_1 = a2 a3 z1^2 and so on, 3 p = p1 + p2 + p3, and the Weierstrass function P, whose
// roots are e_i = p - p_i: the addition theorem from the pole of P. It holds for moments of any sign and order, equal
// ones too, on a separatrix and at rest, without cancellation. Time is divided into pieces so short that the series of
// P and of the roots converge in a few terms. Of a long time only the rest after whole periods is: over a period of z,
// 2 pi over the arithmetic-geometric mean of the roots of e_1 - e_3 and e_1 - e_2, the body rotates about z.
//
// The body rotates by the shortest rotation from z to z(s), and then about z(s) by an angle whose rate is a smooth
// function of z(s): Gauss quadrature with five points is exact to rounding over such a piece.
#pragma once

#include <cmath>
#include <utility>

#include "numbers/dual.hpp"

namespace coadjoint {

// The five points of the quadrature, the end of the piece, and padding of the lanes.
constexpr int POINTS = 6, WIDTH = 8;
constexpr double NODE[WIDTH] = {0.046910077030668004, 0.23076534494715845, 0.5,
                                0.7692346550528415, 0.953089922969332, 1.0, 1.0, 1.0};
constexpr double SHARE[POINTS - 1] = {0.11846344252809454, 0.23931433524968324, 0.28444444444444444,
                                      0.23931433524968324, 0.11846344252809454};

constexpr double PIECE = 0.125;     // the longest time, in units of 1/(|z| max |a|)
constexpr double MOST_PIECES = 64;  // of this length; for longer times the period is computed
constexpr double MOST_PERIODS = 1073741824.0;  // in one flow, 2^30: after more, few digits would be left
constexpr double LEAST_GAP = 0x1p-60;          // of e_1 - e_2 over e_1 - e_3; smaller ones are rounding

template <class A>
struct Quaternion {
    A whole, vector[3];
};

template <class A>
INLINE void cross(const A* u, const A* v, A* w) {
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        w[i] = fma(u[j], v[k], -(u[k] * v[j]));
    }
}

template <class A>
INLINE A dot(const A* u, const A* v) {
    return fma(u[2], v[2], fma(u[1], v[1], u[0] * v[0]));
}

// The data of one piece of time that all of its points share: m, a, z, p, and s^2 P(s) = 1 + c2 s^4 + c3 s^6 + ... + c6
// s^12.
template <class A>
struct BodyPiece {
    A m[3], a[3], z[3], p[3], middle, energy, length2, c[5];

    BodyPiece() = default;

    INLINE BodyPiece(const A* moments, const A* differences, const A* momentum) {
        A e[3];
        for (int i = 0; i < 3; ++i) m[i] = moments[i], a[i] = differences[i], z[i] = momentum[i];
        for (int i = 0; i < 3; ++i) p[i] = (a[(i + 1) % 3] * a[(i + 2) % 3]) * (z[i] * z[i]);
        middle = (p[0] + p[1] + p[2]) * A(1.0 / 3.0);
        for (int i = 0; i < 3; ++i) e[i] = middle - p[i];
        A rotation[3];
        for (int i = 0; i < 3; ++i) rotation[i] = m[i] * z[i];
        energy = dot(rotation, z);
        length2 = dot(z, z);
        c[0] = dot(e, e) * A(1.0 / 10.0);
        c[1] = (e[0] * e[1] * e[2]) * A(1.0 / 7.0);
        c[2] = (c[0] * c[0]) * A(1.0 / 3.0);
        c[3] = (c[0] * c[1]) * A(3.0 / 11.0);
        c[4] = fma(c[0] + c[0], c[2], c[1] * c[1]) * A(1.0 / 13.0);
    }

    // The same numbers on wider lanes.
    template <class B>
    INLINE explicit BodyPiece(const BodyPiece<B>& other)
        : middle(widened(other.middle)), energy(widened(other.energy)), length2(widened(other.length2)) {
        for (int i = 0; i < 3; ++i) {
            m[i] = widened(other.m[i]), a[i] = widened(other.a[i]);
            z[i] = widened(other.z[i]), p[i] = widened(other.p[i]);
        }
        for (int k = 0; k < 5; ++k) c[k] = widened(other.c[k]);
    }

    template <class B>
    static INLINE A widened(const B& b) { return A(b); }
    template <class B>
    static INLINE A widened(const Dual<B>& b) {
        typedef decltype(A().value) V;
        return A(V(b.value), V(b.slope[0]), V(b.slope[1]), V(b.slope[2]));
    }

    // At s, with square = s^2: the change of z, and the rate of the rotation about z(s), over |z|.
    INLINE A at(const A& s, const A& square, A* change) const {
        const A fourth = square * square;
        const A r = fourth * fma(fourth, fma(fourth, c[4], fma(square, c[3], c[2])), fma(square, c[1], c[0]));
        const A cosm1 = fma(-square, middle, r);    // D - 1
        A root[3];                                  // C_i - 1
        for (int i = 0; i < 3; ++i) root[i] = sqrt1pm1(fma(square, p[i], cosm1));
        const A inverse = A(1.0) / (cosm1 + A(1.0));
        for (int i = 0; i < 3; ++i) {
            const int j = (i + 1) % 3, k = (i + 2) % 3;
            const A along = fma(root[j], root[k], root[j] + root[k]) - cosm1;
            const A across = (s * a[i]) * (z[j] * z[k]);
            change[i] = fma(z[i], along, fma(across, root[i], across)) * inverse;
        }
        A rotation[3];
        for (int i = 0; i < 3; ++i) rotation[i] = m[i] * z[i];
        return (dot(rotation, change) + (energy + energy)) / (dot(z, change) + (length2 + length2));
    }

    // sqrt(1 + e) - 1 for |e| < 0.011, by the binomial series: the first neglected term is below 2^-57 of it.
    static INLINE A sqrt1pm1(const A& e) {
        const A ee = e * e;
        const A low = fma(ee, fma(e, A(-5.0 / 128), A(1.0 / 16)), fma(e, A(-1.0 / 8), A(1.0 / 2)));
        const A high = fma(ee, fma(e, A(-429.0 / 32768), A(33.0 / 2048)), fma(e, A(-21.0 / 1024), A(7.0 / 256)));
        return e * fma(ee * ee, high, low);
    }
};

// Evaluation of all points of a piece for one number and for lanes: side by side, or one after the other. Each point is
// computed by the same operations.
typedef Lanes<WIDTH> Wide;

template <class A>
INLINE A added_up(const A* rates) {
    return fma(A(SHARE[2]), rates[2], A(SHARE[0]) * rates[0] + A(SHARE[1]) * rates[1]) +
           (A(SHARE[3]) * rates[3] + A(SHARE[4]) * rates[4]);
}

INLINE double through_points(const BodyPiece<double>& piece, double* change) {
    const BodyPiece<Wide> wide(piece);
    const Wide s = load<Wide>(NODE);
    Wide changes[3];
    double rates[WIDTH];
    store(rates, wide.at(s, s * s, changes));
    for (int i = 0; i < 3; ++i) change[i] = changes[i][POINTS - 1];
    return added_up(rates);
}

INLINE Dual<double> through_points(const BodyPiece<Dual<double>>& piece, Dual<double>* change) {
    const BodyPiece<Dual<Wide>> wide(piece);
    const Dual<Wide> s(load<Wide>(NODE));
    Dual<Wide> changes[3];
    const Dual<Wide> found = wide.at(s, s * s, changes);
    const auto lane = [](const Dual<Wide>& d, int k) {
        return Dual<double>(d.value[k], d.slope[0][k], d.slope[1][k], d.slope[2][k]);
    };
    Dual<double> rates[POINTS];
    for (int k = 0; k < POINTS; ++k) rates[k] = lane(found, k);
    for (int i = 0; i < 3; ++i) change[i] = lane(changes[i], POINTS - 1);
    return added_up(rates);
}

template <class A>
NOINLINE A through_points(const BodyPiece<A>& piece, A* change) {
    A rates[POINTS];
    for (int k = 0; k < POINTS; ++k) {
        const A s(NODE[k]);
        rates[k] = piece.at(s, s * s, change);
    }
    return added_up(rates);
}

// The quaternion of one piece of time, whose length is contained in m and a; moves z.
template <class A, class Mask>
INLINE Quaternion<A> rotation_in_piece(const A* m, const A* a, A* z, const Mask& moving) {
    BodyPiece<A> piece(m, a, z);
    piece.length2 = select(moving, piece.length2, A(1.0));
    A change[3], shortest[3], about[3];
    const A rate = through_points(piece, change);
    const A length2 = piece.length2, length = square_root(length2);
    const Rotation<A> rotation = rotation_by(A(0.5) * (length * rate));
    const A cosine = rotation.cosm1 + A(1.0), sine = rotation.sine / length;
    const A doubled = length2 + length2;
    const A whole = square_root(A(1.0) - dot(change, change) / (doubled + doubled));
    cross(z, change, shortest);
    const A by = A(1.0) / (doubled * whole);
    for (int i = 0; i < 3; ++i) shortest[i] = shortest[i] * by, z[i] = z[i] + change[i];
    cross(z, shortest, about);
    Quaternion<A> found;
    found.whole = cosine * whole;
    for (int i = 0; i < 3; ++i)
        found.vector[i] = fma(cosine, shortest[i], sine * fma(whole, z[i], about[i]));
    return found;
}

// q after p.
template <class A>
INLINE Quaternion<A> after(const Quaternion<A>& q, const Quaternion<A>& p) {
    A crossed[3];
    cross(q.vector, p.vector, crossed);
    Quaternion<A> found;
    found.whole = fma(q.whole, p.whole, -dot(q.vector, p.vector));
    for (int i = 0; i < 3; ++i)
        found.vector[i] = fma(q.whole, p.vector[i], fma(p.whole, q.vector[i], crossed[i]));
    return found;
}

INLINE double value_of(double a) { return a; }
template <int N>
INLINE Lanes<N> value_of(const Lanes<N>& a) { return a; }
template <class A>
INLINE A value_of(const Dual<A>& a) { return a.value; }

// The quaternion of the rotation of a body with three equal moments: about the momentum, by the angle moment tau |z|.
template <class A, class R>
INLINE Quaternion<R> spherical_rotation(const A& moment, const R* momentum, const A& tau) {
    const A size = larger(absolute(value_of(momentum[0])),
                          larger(absolute(value_of(momentum[1])), absolute(value_of(momentum[2]))));
    const A power = leading_power(size), inverse = inverse_power(power);
    R z[3];
    for (int i = 0; i < 3; ++i) z[i] = momentum[i] * R(inverse);
    const R length = square_root(select(A(0.0) < size, dot(z, z), R(1.0)));
    const Rotation<R> rotation = rotation_by(R(0.5 * (moment * (tau * power))) * length);
    const R sine = rotation.sine / length;
    return Quaternion<R>{rotation.cosm1 + R(1.0), {sine * z[0], sine * z[1], sine * z[2]}};
}

// A value whose derivative is not resolved.
INLINE double unresolved(double a) { return a; }
INLINE Dual<double> unresolved(const Dual<double>& a) { return {a.value, NAN, NAN, NAN}; }

// The quaternion after `count` pieces of the time, on which R may depend; moves z.
template <class R>
Quaternion<R> rotation_in_pieces(const double* moments, const double* differences, R* z, const R& time, double count) {
    const R each = time / R(count);
    R m[3], a[3];
    for (int i = 0; i < 3; ++i) m[i] = R(moments[i]) * each, a[i] = R(differences[i]) * each;
    Quaternion<R> total = rotation_in_piece(m, a, z, true);
    for (double k = 1.0; k < count; k += 1.0) total = after(rotation_in_piece(m, a, z, true), total);
    return total;
}

// The quaternion over a time of more than MOST_PIECES: whole periods of the momentum, and the rest, in pieces that are
// short for the motion on this orbit, since (e_1 - e_3) s^2 bounds all s^2 p_i on it. NaN beyond MOST_PERIODS.
template <class R>
NOINLINE Quaternion<R> long_rotation(const double* moments, const double* differences, const R* z, double time) {
    const double widest = larger(absolute(differences[0]), larger(absolute(differences[1]), absolute(differences[2])));
    R p[3], moved[3] = {z[0], z[1], z[2]};
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        p[i] = R((differences[j] / widest) * (differences[k] / widest)) * (z[i] * z[i]);
    }
    for (int i : {0, 1, 0})
        if (value_of(p[i + 1]) < value_of(p[i])) std::swap(p[i], p[i + 1]);
    const R wide = p[2] - p[0];
    const double speed = widest * (std::sqrt(value_of(wide)) * (1.0 / PIECE));
    const auto pieces = [&](double length) { return larger(1.0, std::ceil(speed * absolute(length))); };
    if (speed * absolute(time) <= MOST_PIECES)
        return rotation_in_pieces(moments, differences, moved, R(time), pieces(time));
    const double least = value_of(wide) * LEAST_GAP;
    R gap = p[1] - p[0], mean = square_root(wide);
    if (value_of(gap) < least) gap = unresolved(R(least));
    R other = square_root(gap);
    for (int k = 0; k < 9; ++k) {  // from the least gap on, the tenth digit is reached by eight
        const R next = R(0.5) * (mean + other);
        other = square_root(mean * other);
        mean = next;
    }
    const R period = R((time < 0.0 ? -6.2831853071795865 : 6.2831853071795865) / widest) / mean;
    const double periods = std::floor(time / value_of(period) + 0.5);
    Quaternion<R> total{R(1.0), {R(0.0), R(0.0), R(0.0)}};
    if (!(periods <= MOST_PERIODS)) return {R(NAN), {R(NAN), R(NAN), R(NAN)}};
    if (periods > 0.0) {
        // The power of a unit complex number, by squares.
        const Quaternion<R> one = rotation_in_pieces(moments, differences, moved, period, pieces(value_of(period)));
        const R length = square_root(dot(z, z)), along = dot(one.vector, z) / length;
        const R size = square_root(fma(one.whole, one.whole, along * along));
        R cosine = one.whole / size, sine = along / size, whole(1.0), about(0.0);
        for (double left = periods; left > 0.0; left = std::floor(0.5 * left)) {
            if (left != 2.0 * std::floor(0.5 * left)) {
                const R next = fma(whole, cosine, -(about * sine));
                about = fma(whole, sine, about * cosine);
                whole = next;
            }
            const R next = fma(cosine, cosine, -(sine * sine)), twice = R(2.0) * (cosine * sine);
            const R by = fma(R(-0.5), fma(next, next, twice * twice), R(1.5));  // keeps its length 1
            cosine = next * by, sine = twice * by;
        }
        total.whole = whole;
        for (int i = 0; i < 3; ++i) total.vector[i] = about * (z[i] / length), moved[i] = z[i];
    }
    const R rest = fma(R(-periods), period, R(time));
    return after(rotation_in_pieces(moments, differences, moved, rest, pieces(value_of(rest))), total);
}

// One lane of a number.
template <class A>
INLINE Dual<double> lane_of(const Dual<A>& a, int lane) {
    return {lane_of(a.value, lane), lane_of(a.slope[0], lane), lane_of(a.slope[1], lane), lane_of(a.slope[2], lane)};
}
template <class A>
INLINE void set_lane(Dual<A>& a, int lane, const Dual<double>& value) {
    set_lane(a.value, lane, value.value);
    for (int k = 0; k < 3; ++k) set_lane(a.slope[k], lane, value.slope[k]);
}

// The quaternion of the rotation over the time tau from the momentum z along the principal axes. R is A, or A with its
// derivatives by z.
template <class A, class R>
INLINE Quaternion<R> body_rotation(const A* moments, const R* momentum, const A& tau) {
    R z[3];
    const A size = larger(absolute(value_of(momentum[0])),
                          larger(absolute(value_of(momentum[1])), absolute(value_of(momentum[2]))));
    const A power = leading_power(size), inverse = inverse_power(power);
    for (int i = 0; i < 3; ++i) z[i] = momentum[i] * R(inverse);
    const A time = tau * power;
    A differences[3];
    for (int i = 0; i < 3; ++i) differences[i] = moments[(i + 1) % 3] - moments[(i + 2) % 3];
    const A widest = larger(absolute(differences[0]), larger(absolute(differences[1]), absolute(differences[2])));
    const A y[3] = {value_of(z[0]), value_of(z[1]), value_of(z[2])};
    const A reach = (widest * absolute(time)) * square_root(dot(y, y)) * A(1.0 / PIECE);
    const auto valid = reach <= A(MOST_PIECES);
    const A near = select(valid, reach, A(1.0)), rounded = (near + A(ROUND)) - A(ROUND);
    const A count = larger(A(1.0), select(rounded < near, rounded + A(1.0), rounded));
    const A each = __builtin_expect(all(count == A(1.0)), 1) ? time : time / count;
    const auto moving = A(0.0) < size;
    R m[3], a[3], moved[3] = {z[0], z[1], z[2]};
    for (int i = 0; i < 3; ++i) m[i] = R(moments[i] * each), a[i] = R(differences[i] * each);
    Quaternion<R> total;
    double k = 0.0;
    do {
        const Quaternion<R> piece = rotation_in_piece(m, a, moved, moving);
        if (__builtin_expect(k == 0.0, 1)) {
            total = piece;
        } else {
            const auto more = A(k) < count;
            const Quaternion<R> next = after(piece, total);
            total.whole = select(more, next.whole, total.whole);
            for (int i = 0; i < 3; ++i) total.vector[i] = select(more, next.vector[i], total.vector[i]);
        }
        k += 1.0;
    } while (__builtin_expect(any(A(k) < count), 0));
    if (__builtin_expect(all(valid), 1)) return total;
    for (int lane = 0; lane < Numbers<A>::lanes; ++lane) {
        if (lane_of(reach, lane) <= MOST_PIECES) continue;
        double own[3], between[3];
        for (int i = 0; i < 3; ++i) own[i] = lane_of(moments[i], lane), between[i] = lane_of(differences[i], lane);
        const decltype(lane_of(z[0], lane)) start[3] = {lane_of(z[0], lane), lane_of(z[1], lane), lane_of(z[2], lane)};
        const auto found = long_rotation(own, between, start, lane_of(time, lane));
        set_lane(total.whole, lane, found.whole);
        for (int i = 0; i < 3; ++i) set_lane(total.vector[i], lane, found.vector[i]);
    }
    return total;
}

}  // namespace coadjoint
