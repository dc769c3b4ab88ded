// What Python calls for flow methods.
#include "flow_alone.hpp"
#include "flow_crowd.hpp"

template <Care care, bool carry>
static void advance_crew(const FlowLoop& loop, const Crew& crew, const Varied* varied) {
    typedef Lanes<CROWD> Crowd;
    const auto shared = [](int64_t) { return Shared{}; };
    const auto own = [&](int64_t place) { return Varied{varied->stride, place}; };
    int64_t place = crew.first;
    const bool narrow = loop.state.size <= WIDEST;
    while (place < crew.last && (varied || (narrow && crew.last - place >= FEWEST))) {
        const int64_t next = std::min<int64_t>(place + BLOCKS * CROWD, crew.last);
        if (varied)
            follow_together<care, carry, Crowd>(loop, own, crew.members, place, next);
        else
            follow_together<care, carry, Crowd>(loop, shared, crew.members, place, next);
        place = next;
    }
    for (; place < crew.last; ++place) {
        const int64_t member = crew.members[place];
        if (loop.report.status[member] != DONE) continue;
        if (narrow)
            follow_alone<care, carry, Crowd>(loop, member);
        else
            follow_alone<care, carry, double>(loop, member);
    }
}

// Take the steps k0 + 1 to k1 for the positions first to last - 1 of a crew. With a stride the constants of the tables
// differ by position, `stride` of them side by side. Unfinished between calls: the outer flow of a step is merged with
// the next one, and the finish acts on a copy.
EXPORT void flow_advance(const FlowTables* tables, const Watch* watch, const Saves* saves, const Schedule* schedule,
                         const State* state, const int64_t* members, int64_t first, int64_t last, int64_t k0,
                         int64_t k1, const Report* report, int64_t stride) {
    const FlowLoop loop{*tables, *watch, *saves, *schedule, *state, *report, k0, k1};
    const Crew crew{members, first, last};
    const Varied own{stride, 0}, *varied = stride ? &own : nullptr;
    const bool carry = state->square > 0;
    if (tables->compensated)
        carry ? advance_crew<CORRECTED, true>(loop, crew, varied) : advance_crew<CORRECTED, false>(loop, crew, varied);
    else
        carry ? advance_crew<PLAIN, true>(loop, crew, varied) : advance_crew<PLAIN, false>(loop, crew, varied);
}

// The dimension up to which members go side by side.
EXPORT int64_t widest_crowd() { return WIDEST; }
