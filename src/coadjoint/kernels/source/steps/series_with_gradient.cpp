#include "steps/series.hpp"

namespace coadjoint {

template void Series<4>::expand_written<false>(int64_t, double);
template void Series<8>::expand_written<false>(int64_t, double);

}  // namespace coadjoint
