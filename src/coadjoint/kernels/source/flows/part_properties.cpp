// Properties of the parts of a program that follow from its structure alone, found once for its tables.
#include <algorithm>
#include <new>
#include <vector>

#include "boundary/codes.hpp"
#include "flows/flow_rows.hpp"

namespace coadjoint {

namespace {

bool are_linear(const FlowTables& tables, uint32_t part) {
    const uint8_t* kind = tables.terms.kind;
    return std::all_of(kind + tables.share[part], kind + tables.share[part + 1],
                       [](uint8_t one) { return one == LINEAR; });
}

// Whether a part has linear shares and many runs that move different coordinates, as those of copies of an algebra:
// threads may share them run by run. Parts with a few long runs are shared within these.
bool runs_are_apart(const FlowTables& tables, uint32_t part, std::vector<int64_t>& moved_by) {
    const Action& action = tables.state;
    const uint32_t first = action.run[part], last = action.run[part + 1];
    if (last - first < LEAST_SHARED || !are_linear(tables, part)) return false;
    moved_by.assign(action.size, -1);
    for (uint32_t run = first; run < last; ++run) {
        if (action.kind[run] == SERIES) return false;
        const uint32_t* index = action.indices + action.position[run];
        const uint64_t blocks = uint64_t(action.angles[run]) * action.repeat[run];
        const bool listed = action.entries[run] > 0;  // sparse rows follow its coordinates
        const uint64_t count = listed ? action.width[run] : blocks * action.width[run];
        for (uint64_t k = 0; k < count; ++k) {
            int64_t& mover = moved_by[index[k]];  // blocks of one angle may share coordinates
            if (mover >= 0 && mover != int64_t(run)) return false;
            mover = run;
        }
    }
    return true;
}

// Whether a part has many linear shares and rotations whose angles depend on no coordinate that the part moves, as those
// of a lattice of spins: every rotation may follow its angle, while the coordinates are in the cache.
bool rotations_may_follow(const FlowTables& tables, uint32_t part, std::vector<uint8_t>& moved) {
    const Action& action = tables.state;
    const Terms& terms = tables.terms;
    const uint32_t first = terms.row[tables.share[part]], last = terms.row[tables.share[part + 1]];
    if (last - first < FUSED || !are_linear(tables, part)) return false;
    moved.assign(action.size, 0);
    for (uint32_t run = action.run[part]; run < action.run[part + 1]; ++run) {
        if (action.kind[run] != ROTATE) return false;
        const uint32_t* index = action.indices + action.position[run];
        const uint64_t count = uint64_t(2) * action.angles[run] * action.repeat[run];
        for (uint64_t k = 0; k < count; ++k) moved[index[k]] = 1;
    }
    for (uint32_t row = first; row < last; ++row) {
        const uint32_t shape = terms.repeated ? terms.shape[row] : row;
        const uint32_t origin = terms.repeated ? terms.target[row] : 0;
        for (uint32_t e = terms.entry[shape]; e < terms.entry[shape + 1]; ++e)
            if (moved[uint32_t(origin + terms.column[e])]) return false;
    }
    return true;
}

}  // namespace

// Add these properties to those of `tables`, of `parts` parts; return a negative number if memory is short.
EXPORT int64_t flow_properties(const FlowTables* tables, int64_t parts) {
    try {
        std::vector<int64_t> moved_by;
        std::vector<uint8_t> moved;
        for (uint32_t part = 0; part < parts; ++part) {
            if (is_called(*tables, part)) continue;
            if (runs_are_apart(*tables, part, moved_by)) tables->properties[part] |= APART;
            if (rotations_may_follow(*tables, part, moved)) tables->properties[part] |= FOLLOWING;
        }
    } catch (const std::bad_alloc&) {
        return NO_MEMORY;
    }
    return 0;
}

}  // namespace coadjoint
