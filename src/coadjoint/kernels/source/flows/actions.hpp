// exp(theta D) of one part on vectors side by side: a state, or the rows of a group element (the operation `act`).
#pragma once

#include "flows/sparse_blocks.hpp"

namespace coadjoint {

// The last single angle of a part and its sine. Other blocks of the part, and the group element, often rotate by the
// same angle.
template <class A>
struct Turned {
    A phi = A(NAN);
    Rotation<A> turn;

    INLINE Rotation<A> by(const A& angle, bool again) {
        if (again && all(angle == phi)) return turn;
        phi = angle;
        return turn = rotation_by(angle);
    }
};

constexpr int SPREAD = 8;  // rotations of one trajectory whose sines are computed side by side

// The rotations of a run, each with an angle of its own.
template <Care care, class A, class V, class C>
NOINLINE void rotate_several(const Action& action, const C& constants, uint32_t run, double tau, const A* theta,
                             Vectors<V> x) {
    const uint32_t repeat = action.repeat[run], count = action.angles[run];
    const uint32_t* index = action.indices + action.place[run];
    const int64_t place = action.constant[run];
    uint32_t q = 0;
    if constexpr (Numbers<A>::lanes == 1) {
        for (; q + SPREAD <= count; q += SPREAD) {
            typedef Lanes<SPREAD> Spread;
            const Spread phi = load<Spread>(theta + q) * (Spread(tau) * load<Spread>(action.constants + place + q));
            const Rotation<Spread> turns = rotation_by(phi);
            double sines[SPREAD], lowereds[SPREAD];
            store(sines, turns.sine);
            store(lowereds, turns.lowered);
            for (int lane = 0; lane < SPREAD; ++lane, index += 2 * repeat)
                rotate<care>(Rotation<A>{A(sines[lane]), A(lowereds[lane])}, index, repeat, x);
        }
    }
    for (; q < count; ++q, index += 2 * repeat)
        rotate<care>(rotation_by(theta[q] * (tau * constants.template number_at<A>(action.constants, place + q))),
                     index, repeat, x);
}

// Runs that are rare, or so long that the cost of a call is negligible; not inlined.
template <Care care, class A, class V, class C>
NOINLINE void act_apart(const Action& action, const C& constants, uint32_t run, double tau, const A* theta,
                        Vectors<V> x) {
    auto constant = [&](int64_t place) { return constants.template number_at<A>(action.constants, place); };
    const int kind = action.kind[run];
    const uint32_t repeat = action.repeat[run], count = action.angles[run];
    const uint32_t* index = action.indices + action.place[run];
    int64_t place = action.constant[run];
    if (kind == ROTATE) {
        rotate_several<care>(action, constants, run, tau, theta, x);
    } else if (kind == SHEAR) {
        for (uint32_t q = 0; q < count; ++q) {
            const A turn = tau * theta[q];
            for (uint32_t block = 0; block < repeat; ++block, ++place, index += 2)
                shear<care>(turn * constant(place), index, x);
        }
    } else if (kind == RATIONAL_ROTATE) {
        for (uint32_t q = 0; q < count; ++q, index += 2 * repeat)
            rotate<care>(rational_rotation(theta[q] * (tau * constant(place + q))), index, repeat, x);
    } else if (kind == CUBIC || kind == RATIONAL_CUBIC) {
        cubic<care>(action, constants, run, tau * theta[0], x);
    } else if (kind == SCALE) {
        for (uint32_t q = 0; q < count; ++q, index += repeat)
            scale<care>(growth_by(theta[q] * (tau * constant(place + q))).beyond, index, repeat, x);
    } else if (kind == PLANE) {
        for (uint32_t q = 0; q < count; ++q, place += 4, index += 2 * repeat)
            plane<care, A, V>(constant(place), constant(place + 1), constant(place + 2), constant(place + 3), index,
                              repeat, tau * theta[q], x);
    } else {
        series<care>(action, constants, run, tau * theta[0], x);
    }
}

// The runs of a part with a lone angle, one after the other.
template <Care care, class A, class V, class C>
NOINLINE void act_in_turn(const Action& action, const C& constants, uint32_t part, double tau, A lone,
                          Turned<A>& turned, Vectors<V> x) {
    for (uint32_t run = action.run[part], last = action.run[part + 1]; run < last; ++run) {
        if (action.kind[run] == ROTATE) {
            const A w = constants.template number_at<A>(action.constants, action.constant[run]);
            const uint32_t* index = action.indices + action.place[run];
            rotate<care>(turned.by(lone * (tau * w), true), index, action.repeat[run], x);
        } else {
            act_apart<care>(action, constants, run, tau, &lone, x);
        }
    }
}

// Move vectors by exp(tau sum theta_a D_a) of one part. CORRECTED also adds the rounding error of the increment itself,
// so that rounding has no systematic sign. A single angle with a single run stays in registers, since memory would
// delay the step. With `again` the part has just moved other vectors, by the angle in `turned`.
template <Care care, bool again, class A, class V, class C>
INLINE void act(const Action& action, const C& constants, uint32_t part, double tau, bool single, A lone,
                const A* theta, Turned<A>& turned, const Vectors<V>& x) {
    constexpr bool number = Numbers<V>::lanes == 1;
    const uint32_t run = action.run[part], last = action.run[part + 1];
    const bool alone = single && last == run + 1;
    const int kind = last > run ? action.kind[run] : -1;
    auto constant = [&](int64_t place) { return constants.template number_at<A>(action.constants, place); };
    if (__builtin_expect(alone && kind == ROTATE, 1)) {
        const uint32_t* index = action.indices + action.place[run];
        rotate<care>(turned.by(lone * (tau * constant(action.constant[run])), again), index, action.repeat[run], x);
    } else if (number && alone && kind == SHEAR) {
        const A turn = tau * lone;
        const uint32_t* index = action.indices + action.place[run];
        for (uint32_t block = 0, repeat = action.repeat[run]; block < repeat; ++block, index += 2)
            shear<care>(turn * constant(action.constant[run] + block), index, x);
    } else if (number && alone && kind == CUBIC) {
        cubic<care>(action, constants, run, tau * lone, x);
    } else if (single) {
        Turned<A> apart = turned;
        act_in_turn<care>(action, constants, part, tau, lone, apart, x);
        turned = apart;
    } else {
        for (uint32_t several = run; several < last; ++several)
            act_apart<care>(action, constants, several, tau, theta + action.angle[several], x);
    }
}

}  // namespace coadjoint
