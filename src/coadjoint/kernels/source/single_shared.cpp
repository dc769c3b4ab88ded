// Single trajectories whose constants are those of all.
#include "traveller.hpp"

std::unique_ptr<Single> single_of(const RungeKuttaTables& tables, const Shared& constants) {
    return make_single(tables, constants);
}
