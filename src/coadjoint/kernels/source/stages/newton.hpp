// Stages by linear systems for their corrections: simplified Newton iteration, and linear schemes. For any layout: what
// depends on it is called.
#pragma once

#include "stages/stagnation.hpp"

namespace coadjoint {

// The stages of one trajectory that are corrected.
struct Corrected {
    typedef Called<void(const double*, double*)> Multiply;
    const RungeKuttaTables& tables;
    const StageNumbers points, change;
    const int64_t work;
    // Set the slopes at the points, and `change` to their defect.
    const Called<void()>&evaluate, &find_defect;

    // By factors of 1 - mix h scale times the Jacobian at the base, or, if corrections fall slowly, at the points. If it
    // is singular the outcome has the residual so far.
    Outcome<double> by_factors(const double* base, const StageNumbers& times, const StageNumbers& lengths,
                               double residual) const;

    // Large linear systems: `multiply` applies the derivative of the slopes to changes of the points, in the layout of
    // the points. By factors, if coupled coordinates are close to each other in the order `position`.
    Outcome<double> by_band(const Multiply& multiply) const;
    // Matrix-free: `subtract` takes off the sums over stages of the first from the second.
    Outcome<double> by_krylov(const Multiply& multiply, const Multiply& subtract) const;

  private:
    Outcome<double> correct(const Called<bool(double*)>& solve, const Called<bool()>& renew, int64_t enough = 0) const;
};

}  // namespace coadjoint
