// Interface of one trajectory of a Runge-Kutta method, for any layout of its stages.
#pragma once

#include <memory>

#include "numbers/constants.hpp"

namespace coadjoint {

struct Single {
    double *x, *dx, *g, *dg;  // the momentum, the group element, and their compensations
    double newton = 0.0;      // number of further steps that begin with Newton's method
    std::shared_ptr<const void> own_tables;  // with the constants of the member

    virtual ~Single() = default;
    // Compute the slopes of a substep: `iterations` and `evaluations` are increased, `residual` is the last correction.
    virtual bool solve(double t, double h, int64_t part) = 0;
    virtual void add() = 0;
    virtual void read_slopes(const double* from) = 0;
    virtual void write_slopes(double* to) = 0;
    int64_t iterations = 0, evaluations = 0;
    double residual = 0.0;
};

std::unique_ptr<Single> single_of(const RungeKuttaTables& tables, const SharedConstants& constants);
std::unique_ptr<Single> single_of(const RungeKuttaTables& tables, const MemberConstants& constants);

}  // namespace coadjoint
