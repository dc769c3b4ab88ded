// Base class of schemes with their own compiled step. A file beside its Python file derives from this, and ends with
// STEP_SCHEME(name, Type), or with that function itself if the type depends on the tables. The Python file gives the
// name.
#pragma once

#include <memory>

#include "stages/stagnation.hpp"
#include "recording/event_series.hpp"
#include "recording/watching.hpp"

namespace coadjoint {

// A step of members as lanes, each with the same bits as alone.
template <class Number>
struct StepOfLanes {
    typedef Number A;
    static constexpr int lanes = Numbers<A>::lanes;
    int64_t work = 0;       // approximate number of multiplications of a step of all of them
    int64_t number[lanes];  // of each member in the run
    // Of each member after a step.
    int64_t status[lanes], evaluations[lanes], iterations[lanes];
    double residual[lanes];

    virtual ~StepOfLanes() = default;
    // Load and store the memory of a member.
    virtual void read(int /* lane */, const double* /* memory */) {}
    virtual void write(int /* lane */, double* /* memory */) const {}
    // Take one step from the times t of the lengths h in place, for the members that are `active`.
    virtual void step(A* x, A* dx, const A& t, const A& h, const int64_t* active) = 0;
};
typedef StepOfLanes<Lanes<NATIVE>> LaneStep;
// Of members that have the same times and lengths of steps, and no events.
typedef StepOfLanes<Lanes<MEMBER_LANES>> WideStep;

struct StepScheme {
    int64_t work = 0;       // approximate number of multiplications of a step
    double residual = 0.0;  // the last correction of the last step
    int64_t evaluations = 0, iterations = 0;
    int64_t memory_size = 0;   // numbers per member that are stored from step to step; set by constructors
    int64_t member = 0;        // number in the run of the member whose step is taken
    double* memory = nullptr;  // these numbers, NaN before the first step; null if there are none

    virtual ~StepScheme() = default;
    // Take one step of length h from time t in place, with compensations dx and dgroup; return a status. Both are
    // aligned rows of eight, zero beyond the last coordinate. The group element is transposed.
    virtual int64_t step(double* x, double* dx, double* group, double* dgroup, double t, double h) = 0;
    // The same step of members as lanes, with constants of their `own` or those of these tables, which must outlive it;
    // null if lanes are no faster, or if the members take different operations.
    virtual std::unique_ptr<LaneStep> lane_step(const StepTables&, const LaneConstants* /* own */) { return nullptr; }
    // The same for more members.
    virtual std::unique_ptr<WideStep> wide_step(const LaneConstants* /* own */) { return nullptr; }
    // The Taylor series of the motion over the last step, if the scheme has one.
    virtual StepSeries series_of_step() const { return {}; }
};

#if defined(COADJOINT_APART)
// Called with the functions of the kernels before the steps of a separate library.
extern "C" __attribute__((visibility("default"), weak)) void import_interrupts(const InterruptFunctions* from) {
    imported_functions = *from;
}
#endif

#define STEP_SCHEME(name, Type)                                                             \
    EXPORT coadjoint::StepScheme* name##_step(const coadjoint::StepTables& tables,          \
                                              const coadjoint::MemberConstants& constants) { \
        return new Type(tables, constants);                                                 \
    }

}  // namespace coadjoint
