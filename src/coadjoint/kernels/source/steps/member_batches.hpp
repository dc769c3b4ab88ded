// Steps of several members at once, where what a step calls takes them together in less time.
#pragma once

#include "steps/step_scheme.hpp"

namespace coadjoint {

// A member of a batch: its state and compensation, its number in the run, and the result of a step.
struct BatchMember {
    double *x, *dx;
    int64_t number, status, evaluations, iterations;
    double residual;
};

struct BatchScheme : StepScheme {
    static constexpr int64_t MOST_MEMBERS = 64;  // lanes of two groups of members of a flow

    // Whether it has no memory and no group element.
    virtual bool takes_batches() const = 0;
    // Take one step of members whose status is DONE, with the bits of `step`; the others stay as they are.
    virtual void step_batch(BatchMember* members, int64_t count, double t, double h) = 0;
};

}  // namespace coadjoint
