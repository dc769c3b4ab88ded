// What Python calls for flow methods.
#include "flow.hpp"

// Take the steps k0 + 1 to k1 for the positions first to last - 1 of a crew. With a stride the constants of the tables
// differ by position, `stride` of them side by side. Unfinished between calls: the outer flow of a step is merged with
// the next one, and the finish acts on a copy.
EXPORT void flow_advance(const FlowTables* tables, const Watch* watch, const Saves* saves, const Schedule* schedule,
                  const State* state, const int64_t* members, int64_t first, int64_t last, int64_t k0, int64_t k1,
                  const Report* report, int64_t stride) {
    const Loop loop{*tables, *watch, *saves, *schedule, *state, *report, k0, k1};
    const Crew crew{members, first, last};
    const Varied own{stride, 0}, *varied = stride ? &own : nullptr;
    const bool carry = state->square > 0;
    if (tables->compensated)
        carry ? advance_crew<CORRECTED, true>(loop, crew, varied) : advance_crew<CORRECTED, false>(loop, crew, varied);
    else
        carry ? advance_crew<PLAIN, true>(loop, crew, varied) : advance_crew<PLAIN, false>(loop, crew, varied);
}
