// The members that one call moves, and how many of them go side by side.
#pragma once

#include <limits>

#include "watching.hpp"

// The members of a call: positions first to last - 1 of a crew; state, schedule and report are those of all members.
struct Crew {
    const int64_t* members;
    int64_t first, last;
};

// What a call is given, for a family of schemes with tables of its own.
template <class Tables>
struct Loop {
    const Tables& tables;
    const Watch& watch;
    const Saves& saves;
    const Schedule& schedule;
    const State& state;
    const Report& report;
    int64_t k0, k1;

    double* memory_of(int64_t member) const { return state.memory + member * state.remembered; }
    void fail(int64_t member, int64_t step, int64_t status, double residual) const {
        report.status[member] = status;
        report.step[member] = step;
        report.residual[member] = residual;
    }
    void overflow(int64_t member, int64_t step) const {
        fail(member, step, OVERFLOWED, std::numeric_limits<double>::quiet_NaN());
    }
};

// Members as lanes, from rows of `length` numbers for each; the last member fills what is left of the lanes.
template <class A>
void read_lanes(A* to, const double* from, int64_t length, const int64_t* members, int64_t count) {
    for (int64_t i = 0; i < length; ++i)
        for (int64_t lane = 0; lane < Numbers<A>::lanes; ++lane)
            set_lane(to[i], int(lane), from[members[std::min(lane, count - 1)] * length + i]);
}

// The row of one member, from its lane.
template <class A>
void write_lane(const A* from, double* to, int64_t length, int64_t member, int lane) {
    for (int64_t i = 0; i < length; ++i) to[member * length + i] = lane_of(from[i], lane);
}

constexpr int CROWD = 4 * NATIVE;    // members side by side: four vectors hide each other's latency
constexpr int64_t WIDEST = 1024;     // dimension up to which lanes of states stay in the cache
constexpr int64_t FEWEST = 3;        // members that are worth a block of lanes
