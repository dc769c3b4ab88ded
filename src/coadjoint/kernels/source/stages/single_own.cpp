// Single trajectories with constants of their own: they are few, so one width of lanes serves them, with the same bits.
#include "stages/traveller.hpp"

namespace coadjoint {

std::unique_ptr<Single> single_of(const RungeKuttaTables& tables, const Own& constants) {
    if (one_at_a_time(tables)) return std::make_unique<SingleOf<MemberLanes<double>, Own>>(tables, constants);
    return std::make_unique<SingleOf<StageLanes<8>, Own>>(tables, constants);
}

}  // namespace coadjoint
