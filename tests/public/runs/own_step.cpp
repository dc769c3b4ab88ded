// Euler's method on the field, and where a number of the scheme is not zero a look at the clock of the kernels in each
// step, as long iterations do.
#include "steps/step_scheme.hpp"

namespace coadjoint {

namespace {

struct OwnStep final : StepScheme {
    const StepTables& tables;
    const MemberConstants constants;
    FieldWorkspace<double> room;
    std::vector<double> u, f;

    OwnStep(const StepTables& tables, const MemberConstants& constants)
        : tables(tables), constants(constants), room(tables.field), u(tables.field.size), f(tables.field.size) {
        work = work_of(tables.field);
    }

    int64_t step(double* x, double*, double*, double*, double t, double h) override {
        if (tables.whole[0]) InterruptCheck::of_this_call().after(int64_t(1) << 40);
        gradient(tables.field, constants, x, t, u.data(), room);
        product(tables.field, constants, x, u.data(), h, f.data(), room);
        for (int64_t i = 0; i < tables.field.size; ++i) x[i] = fma(tables.coefficients[0], f[i], x[i]);
        evaluations = 1;
        return DONE;
    }
};

}  // namespace

STEP_SCHEME(own_step, OwnStep)

}  // namespace coadjoint
