// Radau IIA on the energy surface: function iteration for the stages, with a Newton iteration for the multipliers in
// each.
#include "numbers/linear_solve.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

namespace {

typedef MemberLanes<double> Layout;

struct RadauEnergy final : StepScheme {
    const StepTables& tables;
    const MemberConstants constants;
    const Field& field;
    const int64_t n, s;
    const double *weight, *mu;
    FieldWorkspace<double> workspace;
    Unknowns<Layout> y;
    std::vector<double> u, matrix, pivots, excess, multipliers, ones;

    RadauEnergy(const StepTables& tables, const MemberConstants& constants)
        : tables(tables), constants(constants), field(tables.field), n(field.size), s(tables.whole[0]),
          weight(tables.coefficients), mu(weight + s), workspace(field), y(s, n, mu), u(n), matrix(s * s), pivots(s),
          excess(s), multipliers(s), ones(s, 1.0) {
        work = 8 * s * (work_of(field) + s * (n + s));
    }

    int64_t step(double* x, double* dx, double*, double*, double t, double h) override {
        y.base = x;
        y.error = dx;
        y.start_at_base();
        std::fill(multipliers.begin(), multipliers.end(), 0.0);
        const double target_energy = energy(field, tables.values, constants, x, t, workspace);
        double orientation = 0.0;
        bool crossed = false, undefined = false, begun = false;
        const auto evaluate = [&] {
            crossed = false;
            for (int64_t i = 0; i < s; ++i) {
                const double* X = y.points.at + i * n;
                double* L = y.slopes.at + i * n;
                slope_at(field, constants, X, t, h * weight[i], u.data(), L, workspace);
                for (int64_t c = 0; c < n; ++c) L[c] = fma(multipliers[i], X[c], L[c]);
                for (int64_t j = 0; j < s; ++j) {
                    double total = 0.0;
                    for (int64_t c = 0; c < n; ++c) total = fma(u[c], y.points.at[j * n + c], total);
                    matrix[i * s + j] = mu[i * s + j] * total;
                    if (i != j) continue;
                    if (!begun) orientation = total;
                    crossed |= !(total * orientation > 0.0);
                }
            }
            begun = true;
            for (int64_t i = 0; i < s; ++i) {
                mix_each<Layout>(mu + i * s, s, y.slopes.at, n, dx,
                                 [&](int64_t c, double sum) { u[c] = x[c] + sum; });
                excess[i] = target_energy - energy(field, tables.values, constants, u.data(), t, workspace);
            }
            // If the iteration has overflowed before, the failure is not an undefined multiplier.
            const bool valid = finite(s * s, matrix.data());
            undefined |= !factorize(matrix.data(), s, pivots.data()) && valid;
            substitute(matrix.data(), s, pivots.data(), excess.data(), 1);
            for (int64_t j = 0; j < s; ++j) {
                multipliers[j] += excess[j];
                for (int64_t c = 0; c < n; ++c)
                    y.slopes.at[j * n + c] = fma(excess[j], y.points.at[j * n + c], y.slopes.at[j * n + c]);
            }
        };
        Outcome<double> outcome = settle(y, true, evaluate, [](bool, bool) {});
        outcome.settled = outcome.settled || (!undefined && at_round_off(y, evaluate));
        iterations = int64_t(outcome.iterations);
        evaluations = s * iterations;
        residual = outcome.residual;
        if (undefined || (outcome.settled && crossed)) {
            residual = std::numeric_limits<double>::quiet_NaN();
            return UNDEFINED;
        }
        if (!outcome.settled) return residual == residual ? NOT_CONVERGED : OVERFLOWED;
        add_slopes<Layout>(ones.data(), s, y.slopes.at, n, x, dx);
        return DONE;
    }
};

}  // namespace

STEP_SCHEME(radau_energy, RadauEnergy)

}  // namespace coadjoint
