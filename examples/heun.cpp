#include "steps/step_scheme.hpp"

namespace coadjoint {

namespace {

struct Heun final : StepScheme {
    const StepTables& tables;         // the system, and the numbers of the scheme
    const MemberConstants constants;  // passed to the functions of the library
    FieldWorkspace<double> workspace;
    std::vector<double> u, first, second, middle;

    Heun(const StepTables& tables, const MemberConstants& constants)
        : tables(tables), constants(constants), workspace(tables.field), u(tables.field.size), first(u), second(u),
          middle(u) {
        work = 2 * work_of(tables.field);  // approximate number of multiplications of a step
    }

    // Set f = h f(x, t).
    void field(const double* x, double t, double h, std::vector<double>& f) {
        gradient(tables.field, constants, x, t, u.data(), workspace);
        product(tables.field, constants, x, u.data(), h, f.data(), workspace);
    }

    int64_t step(double* x, double*, double*, double*, double t, double h) override {
        const int64_t n = tables.field.size;
        const double share = tables.coefficients[0];  // from `constants` in Python
        field(x, t, h, first);
        for (int64_t i = 0; i < n; ++i) middle[i] = fma(share, first[i], x[i]);
        field(middle.data(), t + share * h, h, second);
        for (int64_t i = 0; i < n; ++i) {
            const double late = 0.5 / share;
            x[i] = x[i] + fma(1.0 - late, first[i], late * second[i]);
        }
        evaluations = 2;
        return DONE;
    }
};

}  // namespace

STEP_SCHEME(heun, Heun)

}  // namespace coadjoint
