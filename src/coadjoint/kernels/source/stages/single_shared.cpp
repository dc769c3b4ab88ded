// Single trajectories with shared constants.
#include "stages/traveller.hpp"

namespace coadjoint {

std::unique_ptr<Single> single_of(const RungeKuttaTables& tables, const Shared& constants) {
    if (one_at_a_time(tables)) return std::make_unique<SingleOf<MemberLanes<double>, Shared>>(tables, constants);
    if (tables.stages <= 2) return std::make_unique<SingleOf<StageLanes<2>, Shared>>(tables, constants);
    if (tables.stages <= 4) return std::make_unique<SingleOf<StageLanes<4>, Shared>>(tables, constants);
    if (tables.stages <= 8) return std::make_unique<SingleOf<StageLanes<8>, Shared>>(tables, constants);
    return std::make_unique<SingleOf<StageLanes<16>, Shared>>(tables, constants);
}

}  // namespace coadjoint
