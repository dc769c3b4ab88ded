// exp(theta D) of one part on vectors side by side: a state, or the rows of a group element (the operation `act`).
#pragma once

#include "flows/sparse_blocks.hpp"

namespace coadjoint {

// The last single angle of a part and its sine. Other blocks of the part, and the group element, often rotate by the
// same angle.
template <class A>
struct CachedRotation {
    A phi = A(NAN);
    Rotation<A> rotation;

    INLINE Rotation<A> by(const A& angle, bool again) {
        if (again && all(angle == phi)) return rotation;
        phi = angle;
        return rotation = rotation_by(angle);
    }
};

constexpr int SPREAD = 8;  // rotations of one trajectory whose sines are computed side by side

// Rotate pairs of coordinates, all of them different, of a single vector, each by an angle of its own.
template <class Spread>
INLINE void rotate_pairs(const Rotation<Spread>& rotations, const uint32_t* index, double* x) {
    constexpr int count = Numbers<Spread>::lanes;
    double first[count], second[count];
    for (int k = 0; k < count; ++k) first[k] = x[index[2 * k]], second[k] = x[index[2 * k + 1]];
    const Spread a = load<Spread>(first), b = load<Spread>(second);
    store(first, a + fma(rotations.cosm1, a, -(rotations.sine * b)));
    store(second, b + fma(rotations.cosm1, b, rotations.sine * a));
    for (int k = 0; k < count; ++k) x[index[2 * k]] = first[k], x[index[2 * k + 1]] = second[k];
}

// The rotations first to count - 1 of a run, each by a different angle; `theta` is that of the first.
template <Summation summation, class A, class V, class C>
NOINLINE void rotate_several(const Action& action, const C& constants, uint32_t run, double tau, const A* theta,
                             Vectors<V> x, uint32_t first, uint32_t count) {
    const uint32_t repeat = action.repeat[run];
    const uint32_t* index = action.indices + action.position[run] + uint64_t(2) * repeat * first;
    const int64_t position = action.constant[run];
    uint32_t q = first;
    if constexpr (Numbers<A>::lanes == 1) {
        for (; q + SPREAD <= count; q += SPREAD) {
            typedef Lanes<SPREAD> Spread;
            const Spread phi = load<Spread>(theta + (q - first)) * (Spread(tau) * load<Spread>(action.constants + position + q));
            const Rotation<Spread> rotations = rotation_by(phi);
            if constexpr (summation == PLAIN && Numbers<V>::lanes == 1)
                if (repeat == 1 && x.rows == 1) {
                    rotate_pairs(rotations, index, x.at);
                    index += 2 * SPREAD;
                    continue;
                }
            double sines[SPREAD], cosm1s[SPREAD];
            store(sines, rotations.sine);
            store(cosm1s, rotations.cosm1);
            for (int lane = 0; lane < SPREAD; ++lane, index += 2 * repeat)
                rotate<summation>(Rotation<A>{A(sines[lane]), A(cosm1s[lane])}, index, repeat, x);
        }
    }
    for (; q < count; ++q, index += 2 * repeat)
        rotate<summation>(
            rotation_by(theta[q - first] * (tau * constants.template number_at<A>(action.constants, position + q))),
            index, repeat, x);
}

// The angles first to count - 1 of a run.
template <Summation summation, class A, class V, class C>
NOINLINE void act_slice(const Action& action, const C& constants, uint32_t run, double tau, const A* theta,
                        Vectors<V> x, uint32_t first, uint32_t count) {
    auto constant = [&](int64_t position) { return constants.template number_at<A>(action.constants, position); };
    const int kind = action.kind[run];
    const uint32_t repeat = action.repeat[run];
    const uint64_t blocks = uint64_t(repeat) * first, coordinates = kind == SCALE ? 1 : 2;
    const uint32_t* index = action.indices + action.position[run] + coordinates * blocks;
    int64_t position = action.constant[run];
    if (kind == ROTATE) {
        rotate_several<summation>(action, constants, run, tau, theta + first, x, first, count);
    } else if (kind == SHEAR) {
        position += int64_t(blocks);
        for (uint32_t q = first; q < count; ++q) {
            const A scaled = tau * theta[q];
            for (uint32_t block = 0; block < repeat; ++block, ++position, index += 2)
                shear<summation>(scaled * constant(position), index, x);
        }
    } else if (kind == RATIONAL_ROTATE) {
        for (uint32_t q = first; q < count; ++q, index += 2 * repeat)
            rotate<summation>(rational_rotation(theta[q] * (tau * constant(position + q))), index, repeat, x);
    } else if (kind == CUBIC || kind == RATIONAL_CUBIC) {
        cubic<summation>(action, constants, run, tau * theta[0], x);
    } else if (kind == SCALE) {
        for (uint32_t q = first; q < count; ++q, index += repeat)
            scale<summation>(growth_by(theta[q] * (tau * constant(position + q))).expm1, index, repeat, x);
    } else if (kind == PLANE) {
        position += 4 * int64_t(first);
        for (uint32_t q = first; q < count; ++q, position += 4, index += 2 * repeat)
            plane<summation, A, V>(constant(position), constant(position + 1), constant(position + 2),
                                   constant(position + 3), index, repeat, tau * theta[q], x);
    } else {
        series<summation>(action, constants, run, tau * theta[0], x);
    }
}

// Runs that are rare, or so long that the cost of a call is negligible; not inlined. Their blocks are disjoint.
template <Summation summation, class A, class V, class C>
NOINLINE void act_run(const Action& action, const C& constants, uint32_t run, double tau, const A* theta,
                      Vectors<V> x) {
    share(action.angles[run], [&](int64_t first, int64_t last) {
        act_slice<summation>(action, constants, run, tau, theta, x, uint32_t(first), uint32_t(last));
    });
}

// Whether `SPREAD` runs, from the given one, are CUBIC blocks with an angle each, all of them circular rotations.
template <class C>
INLINE bool are_cubic(const Action& action, const C& constants, uint32_t run) {
    for (uint32_t k = run; k < run + SPREAD; ++k)
        if (action.kind[k] != CUBIC || !(constants.template number_at<double>(action.constants, action.constant[k]) < 0.0))
            return false;
    return true;
}

// `SPREAD` runs of CUBIC blocks of one trajectory, as at the sites of a lattice; their sines are computed side by side.
template <Summation summation, class V, class C>
NOINLINE void cubic_several(const Action& action, const C& constants, uint32_t run, double tau, const double* theta,
                            const Vectors<V>& x) {
    typedef Lanes<SPREAD> Spread;
    double phi[SPREAD], sines[SPREAD], cosm1s[SPREAD];
    for (uint32_t k = 0; k < SPREAD; ++k)
        phi[k] = constants.template number_at<double>(action.constants, action.constant[run + k] + 1) *
                 (tau * theta[action.angle[run + k]]);
    const Rotation<Spread> rotations = rotation_by(load<Spread>(phi));
    store(sines, rotations.sine);
    store(cosm1s, rotations.cosm1);
    for (uint32_t k = 0; k < SPREAD; ++k) {
        const BlockRows block(action, run + k);
        const CubicFactors<double> factors(action, constants, run + k, Rotation<double>{sines[k], cosm1s[k]});
        if constexpr (summation != CORRECTED && Numbers<V>::lanes == 1) {
            if (block.width == 3 && block.entries == 9 && x.rows == 1) {
                cubic_triple<summation>(action, constants, block, factors, x.at, x.errors);
                continue;
            }
        }
        gather(block, x);
        cubic_by<summation>(action, constants, run + k, factors, x);
    }
}

// The runs of a part with a single angle, one after the other.
template <Summation summation, class A, class V, class C>
NOINLINE void act_runs(const Action& action, const C& constants, uint32_t part, double tau, A single_angle,
                       CachedRotation<A>& cached, Vectors<V> x) {
    for (uint32_t run = action.run[part], last = action.run[part + 1]; run < last; ++run) {
        if (action.kind[run] == ROTATE) {
            const A w = constants.template number_at<A>(action.constants, action.constant[run]);
            const uint32_t* index = action.indices + action.position[run];
            rotate<summation>(cached.by(single_angle * (tau * w), true), index, action.repeat[run], x);
        } else {
            act_run<summation>(action, constants, run, tau, &single_angle, x);
        }
    }
}

// Move vectors by exp(tau sum theta_a D_a) of one part. CORRECTED also adds the rounding error of the increment itself,
// so that rounding has no systematic sign. A single angle with a single run stays in registers, since memory would
// delay the step. With `again` the part has just moved other vectors, by the angle in `cached`.
template <Summation summation, bool again, class A, class V, class C>
INLINE void act(const Action& action, const C& constants, uint32_t part, double tau, bool single, A single_angle,
                const A* theta, CachedRotation<A>& cached, const Vectors<V>& x) {
    constexpr bool number = Numbers<V>::lanes == 1;
    const uint32_t run = action.run[part], last = action.run[part + 1];
    const bool alone = single && last == run + 1;
    const int kind = last > run ? action.kind[run] : -1;
    auto constant = [&](int64_t position) { return constants.template number_at<A>(action.constants, position); };
    if (__builtin_expect(alone && kind == ROTATE, 1)) {
        const uint32_t* index = action.indices + action.position[run];
        rotate<summation>(cached.by(single_angle * (tau * constant(action.constant[run])), again), index,
                          action.repeat[run], x);
    } else if (number && alone && kind == SHEAR) {
        const A scaled = tau * single_angle;
        const uint32_t* index = action.indices + action.position[run];
        for (uint32_t block = 0, repeat = action.repeat[run]; block < repeat; ++block, index += 2)
            shear<summation>(scaled * constant(action.constant[run] + block), index, x);
    } else if (number && alone && kind == CUBIC) {
        cubic<summation>(action, constants, run, tau * single_angle, x);
    } else if (single) {
        CachedRotation<A> local = cached;
        act_runs<summation>(action, constants, part, tau, single_angle, local, x);
        cached = local;
    } else {
        for (uint32_t several = run; several < last; ++several) {
            if constexpr (Numbers<A>::lanes == 1)
                if (several + SPREAD <= last && are_cubic(action, constants, several)) {
                    cubic_several<summation>(action, constants, several, tau, theta, x);
                    several += SPREAD - 1;
                    continue;
                }
            act_run<summation>(action, constants, several, tau, theta + action.angle[several], x);
        }
    }
}

}  // namespace coadjoint
