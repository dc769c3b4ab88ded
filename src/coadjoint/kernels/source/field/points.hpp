// Data of the system passed to a step that is a function.
#pragma once

#include "field/derivatives.hpp"

namespace coadjoint {

// The field with the compiled values of the terms of H, the constants of the member, and the constant of the energy.
// The function itself reads `size` and `sign`.
struct SystemView {
    int64_t size;
    double sign, constant;
    const Field* field;
    const int64_t* values;
    MemberConstants constants;
};

}  // namespace coadjoint
