#include "steps/step_scheme.hpp"

namespace coadjoint {

namespace {

typedef MemberLanes<double> Layout;  // one member at a time

struct Gauss final : StepScheme {
    const StepTables& tables;
    const MemberConstants constants;
    const int64_t n, s;  // coordinates and stages
    const double *node, *scale, *mix, *out;
    FieldWorkspace<double> workspace;
    Unknowns<Layout> y;
    std::vector<double> u;

    Gauss(const StepTables& tables, const MemberConstants& constants)
        : tables(tables), constants(constants), n(tables.field.size), s(tables.whole[0]), node(tables.coefficients),
          scale(node + s), mix(scale + s), out(mix + s * s), workspace(tables.field), y(s, n, mix), u(n) {
        y.work += s * work_of(tables.field);  // of an iteration
        work = 8 * y.work;
    }

    int64_t step(double* x, double* dx, double*, double*, double t, double h) override {
        y.base = x;
        y.error = dx;
        y.start_at_base();
        const auto set_slopes = [&] {
            for (int64_t i = 0; i < s; ++i) {
                const double* X = y.points.at + i * n;
                gradient(tables.field, constants, X, fma(node[i], h, t), u.data(), workspace);
                product(tables.field, constants, X, u.data(), scale[i] * h, y.slopes.at + i * n, workspace);
            }
        };
        const auto outcome = settle(y, true, set_slopes, [](bool, bool) {});
        iterations = int64_t(outcome.iterations);
        evaluations = s * iterations;
        residual = outcome.residual;
        if (!outcome.settled) return residual == residual ? NOT_CONVERGED : OVERFLOWED;
        add_slopes<Layout>(out, s, y.slopes.at, n, x, dx);  // a compensated sum
        return DONE;
    }
};

}  // namespace

STEP_SCHEME(gauss, Gauss)

}  // namespace coadjoint
