// A step given as a function: x_new = step(x, t, h), written in Python, compiled or not.
#include "field/points.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

namespace {

// Write the new state, and return 0, or 1 on an exception, which ends the loop and is raised again by Python.
typedef int64_t (*Function)(const SystemView* system, const double* x, double t, double h, double* out);

struct StepFunction final : StepScheme {
    const Function function;
    const SystemView system;
    const int64_t n;
    std::vector<double> out;

    StepFunction(const StepTables& tables, const MemberConstants& constants)
        : function(reinterpret_cast<Function>(tables.whole[0])),
          system{tables.field.size, tables.field.sign, tables.coefficients[0], &tables.field, tables.values, constants},
          n(tables.field.size), out(n) {
        work = WORK_OF_A_CALL + 8 * work_of(tables.field);
    }

    int64_t step(double* x, double*, double*, double*, double t, double h) override {
        std::fill(out.begin(), out.end(), std::numeric_limits<double>::quiet_NaN());
        if (function(&system, x, t, h, out.data()) != 0) throw Interrupted{};
        evaluations = 1;
        std::copy(out.begin(), out.end(), x);
        if (finite(n, x)) return DONE;
        residual = std::numeric_limits<double>::quiet_NaN();
        return UNDEFINED;
    }
};

}  // namespace

STEP_SCHEME(step_function, StepFunction)

}  // namespace coadjoint
