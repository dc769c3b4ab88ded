// Explicit instantiations of compiled_rows.hpp.
#define COMPILES_ROWS
#include "flows/compiled_rows.hpp"

namespace coadjoint {

COMPILED_ROWS()

}  // namespace coadjoint
