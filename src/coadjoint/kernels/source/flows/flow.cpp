// Entry points of flow methods for Python.
#include "flows/compiled_rows.hpp"
#include "flows/flow_lanes.hpp"

namespace coadjoint {

template <Summation summation, bool with_group>
static void advance_range(const FlowLoop& loop, const MemberRange& range) {
    typedef Lanes<MEMBER_LANES> LaneNumbers;
    const LaneSweeps<LaneNumbers, SharedConstants> shared{
        sweep_groups<summation, with_group, LaneNumbers, LaneNumbers, SharedConstants>,
        sweep_groups<summation, false, LaneNumbers, LaneNumbers, SharedConstants>};
    const LaneSweeps<LaneNumbers, LaneConstants> varied{
        sweep_groups<summation, with_group, LaneNumbers, LaneNumbers, LaneConstants>,
        sweep_groups<summation, false, LaneNumbers, LaneNumbers, LaneConstants>};
    int64_t position = range.first;
    const bool narrow = loop.arrays.size <= WIDEST;
    while (position < range.last && (range.stride || (narrow && range.last - position >= MIN_LANES))) {
        const int64_t next = std::min<int64_t>(position + LANE_GROUPS * MEMBER_LANES, range.last);
        if (range.stride)
            advance_lanes(loop, varied, range, position, next);
        else
            advance_lanes(loop, shared, range, position, next);
        position = next;
    }
    for (; position < range.last; ++position) {
        const int64_t member = range.members[position];
        if (loop.arrays.status[member] == DONE) advance_alone<summation, with_group, LaneNumbers>(loop, member);
    }
}

// Between calls the state is unfinished: the last flow of a step is merged with the first of the next one, and the
// finish acts on a copy.
static void advance(const FlowLoop& loop, const MemberRange& range) {
    const bool with_group = loop.arrays.square > 0;
    if (loop.tables.compensated)
        with_group ? advance_range<CORRECTED, true>(loop, range) : advance_range<CORRECTED, false>(loop, range);
    else
        with_group ? advance_range<PLAIN, true>(loop, range) : advance_range<PLAIN, false>(loop, range);
}

static int64_t memory_size(const FlowTables&) { return 0; }

EXPORT_LOOP(flow_advance, FlowTables, advance, memory_size)

}  // namespace coadjoint
