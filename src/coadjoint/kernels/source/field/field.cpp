// Explicit instantiations of the headers of this folder.
#define COMPILES_FIELD
#include "field/derivatives.hpp"

namespace coadjoint {

COMPILED_TERMS()
COMPILED_DERIVATIVES(, SharedConstants)
COMPILED_DERIVATIVES(, MemberConstants)

}  // namespace coadjoint
