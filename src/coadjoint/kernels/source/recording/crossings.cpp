// Explicit instantiations of crossings.hpp.
#include "recording/crossings.hpp"

namespace coadjoint {

COMPILED_CROSSINGS(, double)
COMPILED_CROSSINGS(, Lanes<MEMBER_LANES>)

}  // namespace coadjoint
