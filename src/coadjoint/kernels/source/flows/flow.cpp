// Entry points of flow methods for Python.
#include "flows/flow_alone.hpp"
#include "flows/flow_crowd.hpp"

namespace coadjoint {

template <Care care, bool carry>
static void advance_crew(const FlowLoop& loop, const Crew& crew) {
    typedef Lanes<CROWD> Crowd;
    const auto shared = [](int64_t) { return Shared{}; };
    const auto own = [&](int64_t place) { return Varied{crew.stride, place}; };
    int64_t place = crew.first;
    const bool narrow = loop.arrays.size <= WIDEST;
    while (place < crew.last && (crew.stride || (narrow && crew.last - place >= FEWEST))) {
        const int64_t next = std::min<int64_t>(place + CROWDS * CROWD, crew.last);
        if (crew.stride)
            follow_together<care, carry, Crowd>(loop, own, crew.members, place, next);
        else
            follow_together<care, carry, Crowd>(loop, shared, crew.members, place, next);
        place = next;
    }
    for (; place < crew.last; ++place) {
        const int64_t member = crew.members[place];
        if (loop.arrays.status[member] != DONE) continue;
        if (narrow)
            follow_alone<care, carry, Crowd>(loop, member);
        else
            follow_alone<care, carry, double>(loop, member);
    }
}

// Between calls the state is unfinished: the last flow of a step is merged with the first of the next one, and the
// finish acts on a copy.
static void follow(const FlowLoop& loop, const Crew& crew) {
    const bool carry = loop.arrays.square > 0;
    if (loop.tables.compensated)
        carry ? advance_crew<CORRECTED, true>(loop, crew) : advance_crew<CORRECTED, false>(loop, crew);
    else
        carry ? advance_crew<PLAIN, true>(loop, crew) : advance_crew<PLAIN, false>(loop, crew);
}

static int64_t remembered_by(const FlowTables&) { return 0; }

EXPORT_LOOP(flow_advance, FlowTables, follow, remembered_by)

}  // namespace coadjoint
