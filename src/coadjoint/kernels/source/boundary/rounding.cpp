// The rounding direction of the calling thread: steps are repeated in others to measure what rounding changes.
#include <cfenv>

#include "boundary/tables.hpp"

namespace coadjoint {

// To nearest (0), up (1) or down (-1); returns 0 if the processor has it.
EXPORT int set_rounding(int64_t direction) {
    return std::fesetround(direction > 0 ? FE_UPWARD : direction < 0 ? FE_DOWNWARD : FE_TONEAREST);
}

}  // namespace coadjoint
