// The loop of splittings for one trajectory: that of the library, without members as lanes
// and group elements.
#include "flows/flow_alone.hpp"

namespace coadjoint {

static void advance(const FlowLoop& loop, const MemberRange& range) {
    const int64_t member = range.members[range.first];
    if (loop.arrays.status[member] != DONE) return;
    loop.tables.compensated ? advance_alone<CORRECTED, false, double>(loop, member)
                            : advance_alone<PLAIN, false, double>(loop, member);
}

static int64_t memory_size(const FlowTables&) { return 0; }

EXPORT_LOOP(flow_advance, FlowTables, advance, memory_size)

}  // namespace coadjoint
