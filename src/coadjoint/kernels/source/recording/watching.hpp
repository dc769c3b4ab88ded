// Invariants along a run, their largest deviations, and saved points, for all families of schemes.
#pragma once

#include <vector>

#include "boundary/arrays.hpp"
#include "numbers/aligned_array.hpp"
#include "field/terms.hpp"

namespace coadjoint {

// Whether every component is finite: then 0 times it is 0.
template <class A>
INLINE auto finite(int64_t size, const A* x) {
    return shared_sum<A>(size, [=](int64_t first, int64_t last) {
        A total(0.0);
        for (int64_t i = first; i < last; ++i) total = total + 0.0 * x[i];
        return total;
    }) == A(0.0);
}

INLINE int64_t tenth_of(const Schedule& schedule, int64_t k) {
    return k > 0 ? (k - 1) * TENTHS / schedule.steps : 0;
}

// Invariant i at x; `y` is scratch memory for watch.longest numbers, `workspace` for watch.longest + 1.
template <class A, class C>
NOINLINE A value_of(const Watch& watch, const C& constants, int64_t i, const A* x, const A& t, A* y,
                    double* workspace) {
    A total = constants.template number_at<A>(watch.constant, i);
    for (uint32_t term = watch.first[i]; term < watch.first[i + 1]; ++term)
        total = total + value_of_term(watch.terms, constants, watch.addresses, term, x, t, y, workspace);
    return total;
}

// A value of a multivalued invariant, shifted by whole periods next to the previous value.
INLINE double unwrapped(double now, double last, double period) {
    return now + period * std::floor((last - now) / period + 0.5);
}

// Whether some invariant is multivalued: its periods are counted at every step, watched or not.
template <class A, class C>
bool has_periods(const Watch& watch, const C& constants) {
    for (int64_t i = 0; i < watch.size; ++i)
        if (!all(constants.template number_at<A>(watch.period, i) <= A(0.0))) return true;
    return false;
}

// Whether a deviation is larger than the largest one, or the first that is NaN.
INLINE bool exceeds(double deviation, double worst) { return !(deviation <= worst) && worst == worst; }

// Record the value of invariant i of a member at step k; for steps that are not watched only its whole periods.
INLINE void record_value(const Arrays& arrays, int64_t count, int64_t i, double period, int64_t member, int64_t k,
                         int64_t slot, int64_t tenth, bool watched, double now) {
    int64_t position = member * count + i;
    if (k == 0)
        arrays.first[position] = now;
    else if (period > 0.0)
        now = unwrapped(now, arrays.last[position], period);
    arrays.last[position] = now;
    if (!watched) return;
    double deviation = std::fabs(now - arrays.first[position]);
    double& worst = arrays.worst[(member * TENTHS + tenth) * count + i];
    if (exceeds(deviation, worst)) worst = deviation;
    if (slot >= 0) arrays.values[(slot * arrays.members + member) * count + i] = now;
}

template <class A>
INLINE void save_state(const Arrays& arrays, int64_t member, int64_t slot, int64_t size, const A* x, int lane) {
    double* to = arrays.x + (slot * arrays.members + member) * size;
    share(size, [=](int64_t first, int64_t last) {
        for (int64_t i = first; i < last; ++i) to[i] = lane_of(x[i], lane);
    });
}

// Record the first `count` lanes, consecutive steps of one member: deviations of the invariants, and saved points, each
// at its index or -1; `saving` is whether there are any.
template <class A, class C>
void record_steps(const Watch& watch, const C& constants, const Arrays& arrays, const Schedule& schedule,
                  int64_t member, int64_t count, const int64_t* step, bool saving, const int64_t* slots, const A* x,
                  A* y, double* workspace) {
    A t(schedule.t0);
    for (int lane = 0; lane < Numbers<A>::lanes; ++lane)
        set_lane(t, lane, start_of(schedule, member, step[lane < count ? lane : count - 1] + 1));
    // Steps within a tenth share its largest deviation.
    const int64_t tenth = tenth_of(schedule, step[0]);
    const bool together = !saving && step[0] > 0 && tenth == tenth_of(schedule, step[count - 1]);
    for (int64_t i = 0; i < watch.size; ++i) {
        A period = constants.template number_at<A>(watch.period, i);
        if (!schedule.watching && !saving && all(period <= A(0.0))) continue;
        A now = value_of(watch, constants, i, x, t, y, workspace);
        if (together && !(lane_of(period, 0) > 0.0)) {
            int64_t position = member * watch.size + i;
            A deviation = absolute(now - A(arrays.first[position]));
            arrays.last[position] = lane_of(now, int(count) - 1);
            double& worst = arrays.worst[(member * TENTHS + tenth) * watch.size + i];
            if (all(deviation <= A(worst))) continue;
            for (int64_t lane = 0; lane < count; ++lane)
                if (exceeds(lane_of(deviation, lane), worst)) worst = lane_of(deviation, lane);
            continue;
        }
        for (int64_t lane = 0; lane < count; ++lane)
            record_value(arrays, watch.size, i, lane_of(period, lane), member, step[lane], slots[lane],
                         tenth_of(schedule, step[lane]), schedule.watching || slots[lane] >= 0, lane_of(now, lane));
    }
    if (!saving) return;
    for (int64_t lane = 0; lane < count; ++lane)
        if (slots[lane] >= 0) save_state(arrays, member, slots[lane], arrays.size, x, lane);
}

// `declared` is `extern`, or empty in watching.cpp.
#define COMPILED_VALUE(declared, A, C)                                                                             \
    declared template A value_of(const Watch&, const C&, int64_t, const A*, const A&, A*, double*);

#define COMPILED_RECORD(declared, A, C)                                                                            \
    COMPILED_VALUE(declared, A, C)                                                                                 \
    declared template void record_steps(const Watch&, const C&, const Arrays&, const Schedule&, int64_t, int64_t,  \
                                        const int64_t*, bool, const int64_t*, const A*, A*, double*);

#define COMPILED_WATCHING(declared)                                    \
    COMPILED_RECORD(declared, double, SharedConstants)                 \
    COMPILED_RECORD(declared, double, MemberConstants)                 \
    COMPILED_RECORD(declared, Lanes<MEMBER_LANES>, SharedConstants)    \
    COMPILED_VALUE(declared, Lanes<MEMBER_LANES>, LaneConstants)

#if !defined(COADJOINT_APART)
COMPILED_WATCHING(extern)
#endif

}  // namespace coadjoint
