// Explicit instantiations of compiled_transforms.hpp.
#define COMPILES_TRANSFORMS
#include "matrices/compiled_transforms.hpp"

namespace coadjoint {

COMPILED_TRANSFORMS()

}  // namespace coadjoint
