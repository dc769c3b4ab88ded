// A scheme that brings one compiled step of its own. A file beside its Python file derives from this, and ends with
// STEP_SCHEME(name, Type), or with that function itself where the type depends on the tables. The Python file says the
// name.
#pragma once

#include "stages/stagnation.hpp"
#include "recording/watching.hpp"

namespace coadjoint {

struct StepScheme {
    int64_t work = 0;       // about how many multiplications a step takes
    double residual = 0.0;  // the last correction of the last step
    int64_t evaluations = 0, iterations = 0;
    int64_t remembered = 0;    // how many numbers the scheme remembers of a member from step to step: its constructor says
    int64_t member = 0;        // whose step is taken: its number in the run
    double* memory = nullptr;  // where they stand, NaN before the first step; null where there are none

    virtual ~StepScheme() = default;
    // Take one step of length h from time t in place, with what compensated sums owe; return a status. Both are aligned
    // rows of eight, zero beyond the last coordinate. The group element is transposed.
    virtual int64_t step(double* x, double* dx, double* group, double* dgroup, double t, double h) = 0;
};

#if defined(COADJOINT_APART)
// What the kernels lend to a library of its own before its steps are called.
extern "C" __attribute__((visibility("default"), weak)) void borrow(const Lent* from) { lent = *from; }
#endif

#define STEP_SCHEME(name, Type)                                                                                   \
    EXPORT coadjoint::StepScheme* name##_step(const coadjoint::StepTables& tables, const coadjoint::Own& own) { \
        return new Type(tables, own);                                                                             \
    }

}  // namespace coadjoint
