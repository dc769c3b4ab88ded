// The members advanced by one call, and how many of them go side by side.
#pragma once

#include <limits>
#include <new>

#include "boundary/hearing.hpp"
#include "recording/recorder.hpp"

namespace coadjoint {

// The members of a call: positions first to last - 1 of a crew, adjacent in the arrays. With a stride the constants of
// the tables differ by position, `stride` of them side by side.
struct Crew {
    const int64_t* members;
    int64_t first, last, stride;
};

// Clear the results of the members of a crew, and save their start from the momenta and groups of the state.
void begin(const Watch& watch, const Arrays& arrays, const Schedule& schedule, const Crew& crew);

// The number of failed members of a crew. If the run has ended, a non-finite energy is a failure too.
int64_t wrong(const Watch& watch, const Arrays& arrays, const Crew& crew, bool ended);

// The loop over the steps of one call, for a family of schemes with tables of its own; the arrays are those of all
// members.
template <class Tables>
struct Loop {
    const Tables& tables;
    const Watch& watch;
    const Schedule& schedule;
    const Arrays& arrays;
    Hearing& hearing;
    int64_t k0, k1;

    double* memory_of(int64_t member) const { return arrays.memory + member * arrays.remembered; }
    void fail(int64_t member, int64_t step, int64_t status, double residual) const {
        arrays.status[member] = status;
        arrays.step[member] = step;
        arrays.residual[member] = residual;
    }
    void overflow(int64_t member, int64_t step) const {
        fail(member, step, OVERFLOWED, std::numeric_limits<double>::quiet_NaN());
    }
};

// Take the steps k0 + 1 to k1 of a crew by `follow(loop, crew)`, from the start if k0 is 0; return `wrong`. If not all
// steps were taken, return the outcome; the results of the crew are then invalid.
template <class Tables, class Follow>
int64_t take_steps(const Tables& tables, const Watch& watch, const Crew& crew, const Arrays& arrays,
                   const Schedule& schedule, int64_t k0, int64_t k1, Hearing& hearing, Follow follow) {
    try {
        if (k0 == 0) begin(watch, arrays, schedule, crew);
        const Loop<Tables> loop{tables, watch, schedule, arrays, hearing, k0, k1};
        if (k0 < k1) follow(loop, crew);
        return wrong(watch, arrays, crew, k1 == schedule.steps);
    } catch (const Interrupted&) {
        return INTERRUPTED;
    } catch (const std::bad_alloc&) {
        return NO_MEMORY;
    }
}

// The loop called by a step of another scheme, inside of which interrupts of the outer call are checked.
typedef int64_t (*InnerLoop)(const void* tables, const Watch* watch, const Crew* crew, const Arrays* arrays,
                             const Schedule* schedule, int64_t k0, int64_t k1);

// The entry point of a family of schemes for Python: its loop, and how many numbers a member remembers from step to
// step.
#define EXPORT_LOOP(name, Tables, follow, remembered_by)                                                             \
    EXPORT int64_t name##_remembers(const Tables* tables) {                                                          \
        try {                                                                                                        \
            return remembered_by(*tables);                                                                           \
        } catch (const std::bad_alloc&) {                                                                            \
            return NO_MEMORY;                                                                                        \
        }                                                                                                            \
    }                                                                                                                \
    EXPORT int64_t name(const Tables* tables, const Watch* watch, const int64_t* members, int64_t first,             \
                        int64_t last, int64_t stride, const Extent* extent, const Schedule* schedule,                \
                        double* saved, double* state, int64_t k0, int64_t k1, const int64_t* stop) {                \
        Hearing hearing(stop);                                                                                       \
        return take_steps(*tables, *watch, Crew{members, first, last, stride}, Arrays(*extent, saved, state),       \
                          *schedule, k0, k1, hearing, follow);                                                       \
    }                                                                                                                \
    EXPORT int64_t name##_inside(const Tables* tables, const Watch* watch, const Crew* crew, const Arrays* arrays,  \
                                 const Schedule* schedule, int64_t k0, int64_t k1) {                                \
        return take_steps(*tables, *watch, *crew, *arrays, *schedule, k0, k1, Hearing::of_this_call(), follow);     \
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

constexpr int CROWD = 4 * NATIVE;    // members side by side: four vectors hide each other's latency
constexpr int64_t FEWEST = 3;        // fewest members for which lanes pay off
static_assert(LARGEST_CROWD % CROWD == 0, "crews begin at multiples of LARGEST_CROWD, and crowds within them of CROWD");

}  // namespace coadjoint
