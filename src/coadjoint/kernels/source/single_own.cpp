// Single trajectories with constants of their own.
#include "traveller.hpp"

std::unique_ptr<Single> single_of(const RungeKuttaTables& tables, const Own& constants) {
    return make_single(tables, constants);
}
