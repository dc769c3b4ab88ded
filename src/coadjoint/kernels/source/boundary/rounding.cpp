// The floating-point mode for Python: of the thread that calls, and of loops that are repeated in others to measure what
// rounding changes.
#include "boundary/tables.hpp"
#include "numbers/float_mode.hpp"

namespace coadjoint {

// Let the loops that this thread calls round to nearest (0), up (1) or down (-1); returns 0 if the processor can.
EXPORT int set_rounding(int64_t direction) {
    const FloatMode present = float_mode(), mode = direction > 0   ? UPWARD_MODE
                                                   : direction < 0 ? DOWNWARD_MODE
                                                                   : STANDARD_MODE;
    set_float_mode(mode);
    const bool set = float_mode() == mode;
    set_float_mode(present);
    if (set) mode_of_loops = mode;
    return !set;
}

// Set the standard mode in this thread, and return the present one.
EXPORT int64_t set_standard_mode() {
    const FloatMode present = float_mode();
    set_float_mode(STANDARD_MODE);
    return int64_t(present);
}

EXPORT void restore_mode(int64_t mode) { set_float_mode(FloatMode(mode)); }

}  // namespace coadjoint
