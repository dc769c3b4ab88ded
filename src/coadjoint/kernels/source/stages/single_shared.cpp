// Single trajectories with shared constants.
#include "stages/staged_state.hpp"

namespace coadjoint {

std::unique_ptr<Single> single_of(const RungeKuttaTables& tables, const SharedConstants& constants) {
    if (one_at_a_time(tables))
        return std::make_unique<SingleOf<MemberLanes<double>>>(tables, constants);
    if (tables.stages <= 2) return std::make_unique<SingleOf<StageLanes<2>>>(tables, constants);
    if (tables.stages <= 4) return std::make_unique<SingleOf<StageLanes<4>>>(tables, constants);
    if (tables.stages <= 8) return std::make_unique<SingleOf<StageLanes<8>>>(tables, constants);
    return std::make_unique<SingleOf<StageLanes<16>>>(tables, constants);
}

}  // namespace coadjoint
