// The loop of splittings for one trajectory: that of the library, without members as lanes and compensated momenta.
#include "flows/flow_alone.hpp"

namespace coadjoint {

static void advance(const FlowLoop& loop, const MemberRange& range) {
    const int64_t member = range.members[range.first];
    if (loop.arrays.status[member] != DONE) return;
    if (loop.tables.compensated) __builtin_trap();  // no table of the page
    loop.arrays.square > 0 ? advance_alone<PLAIN, true, double>(loop, member)
                           : advance_alone<PLAIN, false, double>(loop, member);
}

static int64_t memory_size(const FlowTables&) { return 0; }

EXPORT_LOOP(flow_advance, FlowTables, advance, memory_size)

}  // namespace coadjoint
