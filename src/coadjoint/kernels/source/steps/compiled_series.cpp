// Explicit instantiations of compiled_series.hpp.
#define COMPILES_SERIES
#include "steps/compiled_series.hpp"

namespace coadjoint {

COMPILED_SERIES()

}  // namespace coadjoint
