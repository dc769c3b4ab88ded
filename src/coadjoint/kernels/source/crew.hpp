// The members that one call moves, and how many of them go side by side.
#pragma once

#include "watching.hpp"

// The members of a call: positions first to last - 1 of a crew; state, schedule and report are those of all members.
struct Crew {
    const int64_t* members;
    int64_t first, last;
};

constexpr int CROWD = 4 * NATIVE;    // members side by side: four vectors hide each other's latency
constexpr int64_t WIDEST = 1024;     // dimension up to which lanes of states stay in the cache
constexpr int64_t FEWEST = 3;        // members that are worth a block of lanes
