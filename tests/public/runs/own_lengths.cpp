// Euler's method in steps of its own: each as long as a number of the scheme over the size of the field.
#include "steps/own_steps.hpp"

namespace coadjoint {

namespace {

struct OwnLengths final : OwnSteps {
    const StepTables& tables;
    const MemberConstants constants;
    FieldWorkspace<double> room;
    std::vector<double> u, f;

    OwnLengths(const StepTables& tables, const MemberConstants& constants)
        : OwnSteps(tables.field.size, 0, 0), tables(tables), constants(constants), room(tables.field),
          u(tables.field.size), f(tables.field.size) {
        work = work_of(tables.field);
    }

  private:
    void slope(const Base& base, double t0) {
        gradient(tables.field, constants, base.x, t0 + base.since, u.data(), room);
        product(tables.field, constants, base.x, u.data(), 1.0, f.data(), room);
    }

    int64_t begin(const Base& base, double t0) override { return propose(base, t0); }

    int64_t propose(const Base& base, double t0) override {
        slope(base, t0);
        ++evaluations;
        double square = 0.0;
        for (int64_t i = 0; i < size; ++i) square = fma(f[i], f[i], square);
        base.length = std::copysign(tables.coefficients[0] / std::sqrt(square), base.length);
        return DONE;
    }

    int64_t part(const Base& base, double t0, double time, double* x, double* dx, double*, double*) override {
        slope(base, t0);
        for (int64_t i = 0; i < size; ++i) x[i] = fma(time, f[i], base.x[i]), dx[i] = base.dx[i];
        return DONE;
    }

    int64_t finish(const Base& base, double t0) override {
        slope(base, t0);
        for (int64_t i = 0; i < size; ++i) base.x[i] = fma(base.length, f[i], base.x[i]);
        return DONE;
    }
};

}  // namespace

STEP_SCHEME(own_lengths, OwnLengths)

}  // namespace coadjoint
