// What a step that is a function is told of its system.
#pragma once

#include "field/derivatives.hpp"

namespace coadjoint {

// The field with the compiled values of the terms of H, the constants of the member, and what is added to the energy.
// `size` and `sign` are read by the function itself.
struct Seen {
    int64_t size;
    double sign, constant;
    const Field* field;
    const int64_t* values;
    Own constants;
};

}  // namespace coadjoint
