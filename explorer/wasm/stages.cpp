// The loop of Runge-Kutta methods for one trajectory: that of the library, with two stages side by side.
#include "stages/runge_kutta_loop.hpp"

namespace coadjoint {

static std::unique_ptr<Single> stages_of(const RungeKuttaTables& tables) {
    const SharedConstants shared;
    if (one_at_a_time(tables)) return std::make_unique<SingleOf<MemberLanes<double>>>(tables, shared);
    return std::make_unique<SingleOf<StageLanes<2>>>(tables, shared);
}

static void advance(const RungeKuttaLoop& loop, const MemberRange& range) {
    const int64_t member = range.members[range.first];
    if (loop.arrays.status[member] != DONE) return;
    const auto stages = stages_of(loop.tables);
    advance_alone<double>(loop, *stages, member, SharedConstants{});
}

EXPORT_LOOP(runge_kutta_advance, RungeKuttaTables, advance, memory_size)

}  // namespace coadjoint
