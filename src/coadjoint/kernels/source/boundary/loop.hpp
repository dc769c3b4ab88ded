// The loop over the steps of one call: its members, its entry points for Python, and members as lanes.
#pragma once

#include <limits>
#include <new>

#include "boundary/interrupts.hpp"
#include "recording/recorder.hpp"

namespace coadjoint {

// The members of a call: the entries first to last - 1 of `members`, ascending. With a stride the constants of the
// tables differ by position, in rows of `stride` numbers.
struct MemberRange {
    const int64_t* members;
    int64_t first, last, stride;
};

// Clear the results of the members, and save their start from the momenta and groups of the state.
void begin(const Watch& watch, const Arrays& arrays, const Schedule& schedule, const MemberRange& range);

// Return the number of failed members. If the run has ended, saved states that were left out and non-finite energies are
// failures too.
int64_t count_failed(const Watch& watch, const Arrays& arrays, const MemberRange& range, bool ended);

// The loop over the steps of one call, for a family of schemes with its own tables; the arrays are those of all
// members.
template <class Tables>
struct Loop {
    const Tables& tables;
    const Watch& watch;
    const Schedule& schedule;
    const Arrays& arrays;
    InterruptCheck& interrupts;
    int64_t k0, k1;

    double* memory_of(int64_t member) const { return arrays.memory + member * arrays.memory_size; }
    void fail(int64_t member, int64_t step, int64_t status, double residual) const {
        // A saved state that was left out before is the first failure.
        if (arrays.step[member] > 0) return void(arrays.status[member] = OVERFLOWED);
        arrays.status[member] = status;
        arrays.step[member] = step;
        arrays.residual[member] = residual;
    }
    void overflow(int64_t member, int64_t step, bool too_long = false) const {
        fail(member, step, too_long ? TOO_LONG : OVERFLOWED, std::numeric_limits<double>::quiet_NaN());
    }
};

// Return the result of the work of a call, or the outcome that ended it.
template <class Work>
int64_t outcome_of(Work work) {
    try {
        return work();
    } catch (const Interrupted&) {
        return INTERRUPTED;
    } catch (const std::bad_alloc&) {
        return NO_MEMORY;
    }
}

// Take the steps k0 + 1 to k1 of some members by `advance(loop, range)`, from the start if k0 is 0; return
// `count_failed`. If not all steps were taken, return the outcome; the results of these members are then invalid.
template <class Tables, class Advance>
int64_t take_steps(const Tables& tables, const Watch& watch, const MemberRange& range, const Arrays& arrays,
                   const Schedule& schedule, int64_t k0, int64_t k1, InterruptCheck& interrupts, Advance advance) {
    return outcome_of([&] {
        if (k0 == 0) begin(watch, arrays, schedule, range);
        const Loop<Tables> loop{tables, watch, schedule, arrays, interrupts, k0, k1};
        if (k0 < k1) advance(loop, range);
        return count_failed(watch, arrays, range, k1 == schedule.steps);
    });
}

// The loop called by a step of another scheme, inside of which interrupts of the outer call are checked.
typedef int64_t (*InnerLoop)(const void* tables, const Watch* watch, const MemberRange* range, const Arrays* arrays,
                             const Schedule* schedule, int64_t k0, int64_t k1);

// The entry points of a family of schemes for Python: its loop, all steps of a run with the start in `momenta`, and the
// size of its memory per member. If a start is not finite, no step is taken, and all members count as failed.
#define EXPORT_LOOP(name, Tables, advance, memory_size)                                                              \
    EXPORT int64_t name##_memory_size(const Tables* tables) {                                                        \
        return outcome_of([&] { return memory_size(*tables); });                                                     \
    }                                                                                                                \
    EXPORT int64_t name(const Tables* tables, const Watch* watch, const int64_t* members, int64_t first,             \
                        int64_t last, int64_t stride, const Extent* extent, const Schedule* schedule,                \
                        double* saved, double* state, int64_t k0, int64_t k1, const int64_t* stop) {                 \
        InterruptCheck interrupts(stop);                                                                             \
        return take_steps(*tables, *watch, MemberRange{members, first, last, stride},                                \
                          Arrays(*extent, saved, state), *schedule, k0, k1, interrupts, advance);                    \
    }                                                                                                                \
    EXPORT int64_t name##_whole(const WholeRun* run, double* arrays_of_run) {                                        \
        const Schedule& schedule = *reinterpret_cast<const Schedule*>(run->schedule);                                \
        const Arrays arrays(*reinterpret_cast<const Extent*>(run->extent), arrays_of_run);                           \
        if (!finite(arrays.members * arrays.size, arrays.momenta)) return arrays.members;                            \
        InterruptCheck interrupts(reinterpret_cast<const int64_t*>(run->stop));                                      \
        return take_steps(*reinterpret_cast<const Tables*>(run->tables), *reinterpret_cast<const Watch*>(run->watch), \
                          MemberRange{reinterpret_cast<const int64_t*>(run->members), run->first, run->last,         \
                                      run->stride},                                                                  \
                          arrays, schedule, 0, schedule.steps, interrupts, advance);                                 \
    }                                                                                                                \
    EXPORT int64_t name##_inside(const Tables* tables, const Watch* watch, const MemberRange* range,                 \
                                 const Arrays* arrays, const Schedule* schedule, int64_t k0, int64_t k1) {           \
        return take_steps(*tables, *watch, *range, *arrays, *schedule, k0, k1, InterruptCheck::of_this_call(),       \
                          advance);                                                                                  \
    }

// Load members as lanes, from rows of `length` numbers for each; the last member fills unused lanes.
template <class A>
void read_lanes(A* to, const double* from, int64_t length, const int64_t* members, int64_t count) {
    for (int64_t i = 0; i < length; ++i)
        for (int64_t lane = 0; lane < Numbers<A>::lanes; ++lane)
            set_lane(to[i], int(lane), from[members[std::min(lane, count - 1)] * length + i]);
}

// Store the row of one member from its lane.
template <class A>
void write_lane(const A* from, double* to, int64_t length, int64_t member, int lane) {
    for (int64_t i = 0; i < length; ++i) to[member * length + i] = lane_of(from[i], lane);
}

constexpr int64_t MIN_LANES = 3;  // with fewer members, lanes are slower than one member after the other
static_assert(MOST_LANES % MEMBER_LANES == 0, "member ranges begin at multiples of MOST_LANES");

}  // namespace coadjoint
