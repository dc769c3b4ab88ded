// What the integers of a step with forces say: its inner loops, the tables of its forces, and its substeps.
#pragma once

#include <cstring>
#include <vector>

#include "boundary/tables.hpp"

namespace coadjoint {

struct Substep {
    double begin, length;  // in units of the step
    int64_t loop;
};

// `whole`: the addresses of the first inner loop, the number of forces, the addresses of their tables, the number of
// other inner loops and their addresses, the number of substeps, the bits of their lengths and their loops, and what
// `matrix_invariants` reads.
struct ForcedLayout {
    std::vector<const int64_t*> loops;  // the addresses of each
    std::vector<const ForceTable*> forces;
    std::vector<Substep> substeps;
    const int64_t* rest;

    explicit ForcedLayout(const int64_t* whole) : loops{whole} {
        for (int64_t k = 0; k < whole[ADDRESSES]; ++k)
            forces.push_back(reinterpret_cast<const ForceTable*>(whole[ADDRESSES + 1 + k]));
        const int64_t* at = whole + ADDRESSES + 1 + whole[ADDRESSES];
        const int64_t others = *at++;
        for (int64_t k = 0; k < others; ++k, at += ADDRESSES) loops.push_back(at);
        const int64_t count = *at++;
        double elapsed = 0.0;
        for (int64_t k = 0; k < count; ++k, at += 2) {
            Substep substep{elapsed, 0.0, at[1]};
            std::memcpy(&substep.length, at, sizeof(double));
            substeps.push_back(substep);
            elapsed += substep.length;
        }
        rest = at;
    }

    static constexpr int64_t ADDRESSES = 5;  // of an inner loop
};

}  // namespace coadjoint
