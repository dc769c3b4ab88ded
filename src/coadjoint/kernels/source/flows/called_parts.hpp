// Parts with called flows: their generators do not commute, and their angles change along the flow.
//
// A called flow moves by a group element, which is written as a product of rotations about fixed generators. So the
// blocks of the table act on any algebra and group element, as they do for other parts. For the free body on e1, e2, e3
// the rotations are about e3, e1, e2, e3, in this order; the first one is zero unless the rotation about e2 is near a
// right angle.
//
// A bond is a spherical body whose momentum is the sum of two: it rotates both about their sum.
#pragma once

#include <vector>

#include "flows/actions.hpp"
#include "flows/free_body.hpp"

namespace coadjoint {

// Of a step of a free body: about the third, first, second and third axis.
constexpr int BODY_ROTATIONS = 4;
constexpr int BODY_COLUMNS = 6;       // the triple, and the other one of a bond; repeated for a free body
constexpr int BODY_CONSTANTS = 15;    // moments, principal axes in rows of components, lengths of the generators
constexpr double UPRIGHT = 0.9;       // the sine above which a rotation about e2 counts as near a right angle
constexpr int64_t WORK_OF_A_BODY = 500;  // multiplications of a short flow of a body
constexpr int64_t WORK_OF_A_BOND = 60;
// Properties of parts, bits of FlowTables::properties: bodies whose blocks all rotate by the angle itself; bonds of unit
// scale; runs that move different coordinates; rotations that may follow their angles.
constexpr uint8_t DIRECT = 1, BONDS = 2, APART = 4, FOLLOWING = 8;
constexpr double TWO_PI = 6.2831853071795865;

// The rotations of a called flow: each by sine and cosine minus one, or by its angle.
template <class A>
struct Rotations {
    A *angle, *sine, *cosm1;
    bool direct;  // every block rotates by the angle itself: angles are not needed
};

// The free body or the bond that a share calls, in the numbers of one member or of lanes.
template <class A>
struct CalledBody {
    A moments[3], axes[9], scale[3], momentum[3];
    const uint32_t* column;
    bool bond;

    template <class C>
    CalledBody(const FlowTables& tables, const C& constants, int64_t body, const A* x)
        : column(tables.body_column + BODY_COLUMNS * body), bond(column[3] != column[0]) {
        const auto constant = [&](int k) {
            return constants.template number_at<A>(tables.body, BODY_CONSTANTS * body + k);
        };
        for (int i = 0; i < 3; ++i) moments[i] = constant(i), scale[i] = constant(12 + i);
        for (int i = 0; i < 9; ++i) axes[i] = constant(3 + i);
        A body_momentum[3];
        for (int i = 0; i < 3; ++i)
            body_momentum[i] = scale[i] * (bond ? x[column[i]] + x[column[3 + i]] : x[column[i]]);
        for (int c = 0; c < 3; ++c) {
            const A axis[3] = {axes[c], axes[3 + c], axes[6 + c]};
            momentum[c] = dot(axis, body_momentum);
        }
    }

    // Of register k of more lanes.
    template <int N>
    CalledBody(const CalledBody<Lanes<N>>& all, int k) : column(all.column), bond(all.bond) {
        for (int i = 0; i < 3; ++i) {
            moments[i].part[0] = all.moments[i].part[k], scale[i].part[0] = all.scale[i].part[k];
            momentum[i].part[0] = all.momentum[i].part[k];
        }
        for (int i = 0; i < 9; ++i) axes[i].part[0] = all.axes[i].part[k];
    }

    // The quaternion of the rotation along the principal axes.
    template <class R>
    NOINLINE Quaternion<R> rotation(const R* z, const A& tau) const {
        return bond ? spherical_rotation(moments[0], z, tau) : body_rotation(moments, z, tau);
    }

    // From the principal axes to the coordinates.
    template <class R>
    void outward(const R* along, R* v) const {
        for (int i = 0; i < 3; ++i)
            v[i] = fma(R(axes[3 * i + 2]), along[2], fma(R(axes[3 * i + 1]), along[1], R(axes[3 * i]) * along[0]));
    }
};

// The angle in (-pi, pi] of a sine and a cosine.
inline double angle_of(double sine, double cosine) {
    const double size = absolute(cosine);
    double t = sine / (1.0 + size);  // of half the angle, then of an eighth
    t = t / (1.0 + std::sqrt(fma(t, t, 1.0)));
    t = t / (1.0 + std::sqrt(fma(t, t, 1.0)));
    const double z = -t * t;
    double sum = 0.0;
    for (int k = 14; k > 0; --k) sum = z * (sum + 1.0 / (2 * k + 1));
    const double angle = 8.0 * fma(t, sum, t);
    return cosine < 0.0 ? (sine < 0.0 ? -0.5 * TWO_PI : 0.5 * TWO_PI) - angle : angle;
}

// The rotation by the angle of (along, across), whose length is `size`.
template <class A>
INLINE void set_rotation(const Rotations<A>& rotations, int k, const A& across, const A& along, const A& size) {
    const A sum = along + size, inverse = A(1.0) / (size * sum);
    rotations.sine[k] = across * sum * inverse;
    rotations.cosm1[k] = -(across * across) * inverse;
    const auto backward = along < A(0.0);
    if (__builtin_expect(any(backward), 0)) {
        rotations.sine[k] = select(backward, across / size, rotations.sine[k]);
        rotations.cosm1[k] = select(backward, along / size - A(1.0), rotations.cosm1[k]);
    }
    if (!rotations.direct)
        for (int lane = 0; lane < Numbers<A>::lanes; ++lane)
            set_lane(rotations.angle[k], lane,
                     angle_of(lane_of(rotations.sine[k], lane), 1.0 + lane_of(rotations.cosm1[k], lane)));
}

// Whether the product of four rotations is minus a quaternion, which matters if a block rotates by half the angle.
inline bool opposite(const double* angle, const Quaternion<double>& q) {
    Quaternion<double> total{1.0, {0.0, 0.0, 0.0}};
    const int axis[BODY_ROTATIONS] = {2, 0, 1, 2};
    for (int k = 0; k < BODY_ROTATIONS; ++k) {
        const Rotation<double> half = rotation_by(0.5 * angle[k]);
        Quaternion<double> one{half.cosm1 + 1.0, {0.0, 0.0, 0.0}};
        one.vector[axis[k]] = half.sine;
        total = after(one, total);
    }
    return fma(total.whole, q.whole, dot(total.vector, q.vector)) < 0.0;
}

// A quaternion as rotations about e3, e1, e2, e3.
template <class A>
INLINE void rotations_of(const Quaternion<A>& q, const Rotations<A>& rotations) {
    const A w = q.whole, x = q.vector[0], y = q.vector[1], z = q.vector[2];
    const A ww = w * w, xx = x * x, yy = y * y, zz = z * z, wx = w * x, wy = w * y, wz = w * z;
    const A size = (ww + xx) + (yy + zz);
    const A tilt = 2.0 * (wy - x * z);                              // -R31
    const A a = 2.0 * fma(y, z, wx), b = (ww + zz) - (xx + yy);     // R32, R33
    const A c = 2.0 * fma(x, y, wz), d = (ww + xx) - (yy + zz);     // R21, R11
    const A level = square_root(fma(a, a, b * b));
    A across[BODY_ROTATIONS] = {A(0.0), a, tilt, c}, along[BODY_ROTATIONS] = {A(1.0), b, level, d};
    A length[BODY_ROTATIONS] = {A(1.0), level, size, level};
    const auto upright = A(UPRIGHT) * size < absolute(tilt);
    if (__builtin_expect(any(upright), 0)) {
        const A f = 2.0 * (y * z - wx), g = 2.0 * fma(x, z, wy);    // R23, R13
        const A beside = square_root(fma(a, a, tilt * tilt)), one(1.0), zero(0.0);
        const A other_across[BODY_ROTATIONS] = {a, zero, beside, f}, other_along[BODY_ROTATIONS] = {tilt, one, b, g};
        const A other_length[BODY_ROTATIONS] = {beside, one, size, beside};
        for (int k = 0; k < BODY_ROTATIONS; ++k) {
            across[k] = select(upright, other_across[k], across[k]);
            along[k] = select(upright, other_along[k], along[k]);
            length[k] = select(upright, other_length[k], length[k]);
        }
    }
    for (int k = 0; k < BODY_ROTATIONS; ++k) set_rotation(rotations, k, across[k], along[k], length[k]);
    if (rotations.direct || all(A(0.5) * size < ww * select(w < A(0.0), A(0.0), A(1.0)))) return;
    for (int lane = 0; lane < Numbers<A>::lanes; ++lane) {
        double angle[BODY_ROTATIONS];
        for (int k = 0; k < BODY_ROTATIONS; ++k) angle[k] = lane_of(rotations.angle[k], lane);
        const Quaternion<double> quaternion{lane_of(w, lane), {lane_of(x, lane), lane_of(y, lane), lane_of(z, lane)}};
        if (opposite(angle, quaternion)) set_lane(rotations.angle[0], lane, angle[0] + TWO_PI);
    }
}

// The rotations that a share calls, over the time tau. Lanes of times beyond MOST_PERIODS are marked as `too_long`.
template <class A, class C>
NOINLINE void called_rotations(const FlowTables& tables, const C& constants, int64_t body, const A& tau, const A* x,
                               const Rotations<A>& rotations, int64_t* too_long) {
    const CalledBody<A> called(tables, constants, body, x);
    Quaternion<A> along = called.rotation(called.momentum, tau), q{along.whole, {}};
    if (__builtin_expect(any(!(along.whole == along.whole)), 0) && too_long) {
        const A still = dot(called.momentum, called.momentum) * A(0.0);
        for (int lane = 0; lane < Numbers<A>::lanes; ++lane)
            if (lane_of(still, lane) == 0.0 && std::isnan(lane_of(along.whole, lane))) too_long[lane] = 1;
    }
    called.outward(along.vector, q.vector);
    rotations_of(q, rotations);
    const A lengths[BODY_ROTATIONS] = {called.scale[2], called.scale[0], called.scale[1], called.scale[2]};
    for (int k = 0; k < BODY_ROTATIONS; ++k) {
        rotations.sine[k] = rotations.sine[k] * lengths[k];
        if (!rotations.direct) rotations.angle[k] = rotations.angle[k] * lengths[k];
    }
}

// The derivative of the rotation of a called share, by row: the change along a coordinate for each component of the
// momentum along the principal axes.
template <class A>
NOINLINE void derivative_in_registers(const CalledBody<A>& called, double tau, A* jacobian) {
    typedef Dual<A> R;
    R momentum[3];
    for (int i = 0; i < 3; ++i)
        momentum[i] = R(called.momentum[i], A(double(i == 0)), A(double(i == 1)), A(double(i == 2)));
    const Quaternion<R> q = called.rotation(momentum, A(tau));
    const A vector[3] = {q.vector[0].value, q.vector[1].value, q.vector[2].value};
    const A size = larger(absolute(called.momentum[0]),
                          larger(absolute(called.momentum[1]), absolute(called.momentum[2])));
    const auto moving = A(0.0) < size;
    for (int c = 0; c < 3; ++c) {
        const A slope[3] = {q.vector[0].slope[c], q.vector[1].slope[c], q.vector[2].slope[c]};
        A crossed[3], along[3], outward[3];
        cross(slope, vector, crossed);
        for (int i = 0; i < 3; ++i) {
            // At rest, where the direction of the axis is not defined, the angular velocity is that of a small momentum.
            const A at_rest = i == c ? called.moments[called.bond ? 0 : i] * A(tau) : A(0.0);
            along[i] = 2.0 * (fma(q.whole.value, slope[i], -(q.whole.slope[c] * vector[i])) - crossed[i]);
            along[i] = select(moving, along[i], at_rest);
        }
        called.outward(along, outward);
        for (int i = 0; i < 3; ++i) jacobian[3 * i + c] = outward[i];
    }
}

// The same, for lanes one register after the other: dual numbers of more do not fit into registers.
template <class A>
void derivative_of_call(const CalledBody<A>& called, double tau, A* jacobian) {
    if constexpr (Numbers<A>::lanes <= NATIVE) {
        derivative_in_registers(called, tau, jacobian);
    } else {
        typedef Lanes<A::width> Register;
        for (int k = 0; k < A::count; ++k) {
            Register found[9];
            derivative_in_registers(CalledBody<Register>(called, k), tau, found);
            for (int i = 0; i < 9; ++i) jacobian[i].part[k] = found[i].part[0];
        }
    }
}

// The further rotation of the element of a called share under changes of the momentum: changes of its rotations about
// e1, e2, e3 that are applied last, for vectors side by side.
template <class A, class V, class C>
NOINLINE void called_changes(const FlowTables& tables, const C& constants, int64_t body, double tau, const A* x,
                             const V* vectors, int64_t rows, V* changes) {
    const CalledBody<A> called(tables, constants, body, x);
    const uint32_t* column = called.column;
    A jacobian[9];
    derivative_of_call(called, tau, jacobian);
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            const A axes[3] = {called.axes[3 * j], called.axes[3 * j + 1], called.axes[3 * j + 2]};
            const V by((called.scale[i] * called.scale[j]) * dot(jacobian + 3 * i, axes));
            for (int64_t b = 0; b < rows; ++b) {
                V& change = changes[(1 + i) % BODY_ROTATIONS * rows + b];
                const V moved = called.bond ? by * (vectors[column[j] * rows + b] + vectors[column[3 + j] * rows + b])
                                            : by * vectors[column[j] * rows + b];
                change = j == 0 ? moved : change + moved;
            }
        }
    for (int64_t b = 0; b < rows; ++b) changes[b] = V(0.0);
}

// Move vectors by the rotations of a part. A first rotation of zero is skipped, so that it changes no bits, of errors
// either.
template <Summation summation, class A, class V, class C>
NOINLINE void act_called(const Action& action, const C& constants, uint32_t part, const Rotations<A>& rotations,
                         const Vectors<V>& x, int64_t size) {
    for (uint32_t run = action.run[part], last = action.run[part + 1]; run < last; ++run) {
        const uint32_t first = action.angle[run];
        const auto rotate_all = [&] {
            if (!rotations.direct) return act_run<summation>(action, constants, run, 1.0, rotations.angle + first, x);
            share(action.angles[run], [&](int64_t low, int64_t above) {
                const uint32_t repeat = action.repeat[run];
                const uint32_t* index = action.indices + action.position[run] + uint64_t(2) * repeat * low;
                for (uint32_t q = uint32_t(low); q < above; ++q, index += 2 * repeat) {
                    const A w = constants.template number_at<A>(action.constants, action.constant[run] + q);
                    rotate<summation>(Rotation<A>{rotations.sine[first + q] * w, rotations.cosm1[first + q]}, index,
                                      repeat, x);
                }
            });
        };
        if (first % BODY_ROTATIONS != 0) {
            rotate_all();
            continue;
        }
        const auto rotated = !((rotations.direct ? rotations.cosm1[first] : rotations.angle[first]) == A(0.0));
        if (__builtin_expect(!any(rotated), 1)) continue;
        if constexpr (Numbers<A>::lanes > 1) {
            std::vector<V> before(x.at, x.at + size * x.rows), remainder;
            if (summation != PLAIN) remainder.assign(x.errors, x.errors + size * x.rows);
            rotate_all();
            for (int64_t i = 0; i < size * x.rows; ++i) {
                x.at[i] = select(rotated, x.at[i], before[i]);
                if (summation != PLAIN) x.errors[i] = select(rotated, x.errors[i], remainder[i]);
            }
        } else {
            rotate_all();
        }
    }
}

}  // namespace coadjoint
