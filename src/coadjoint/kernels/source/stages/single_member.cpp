// Single trajectories with member constants: they are few, so one width of lanes suffices, with the same bits.
#include "stages/staged_state.hpp"

namespace coadjoint {

std::unique_ptr<Single> single_of(const RungeKuttaTables& tables, const MemberConstants& constants) {
    if (one_at_a_time(tables))
        return std::make_unique<SingleOf<MemberLanes<double>, MemberConstants>>(tables, constants);
    return std::make_unique<SingleOf<StageLanes<8>, MemberConstants>>(tables, constants);
}

}  // namespace coadjoint
